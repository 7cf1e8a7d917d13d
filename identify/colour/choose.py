"""Output error or innovations: which noise the residuals show, and the fit for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...record.each import Each, in_turn
from ...record.errors import EstimationError
from ...simulate.model import Array
from ..data import RunData
from ..fit import Fit, beside_of, common_errors, fit_runs, modes_along
from ..joint.problem import OWN, Answer, Problem
from ..joint.thin import thinned
from ..noise import ljung_box_p, measured, stated
from ..static_records import colours
from ..still import Colour
from .innovations import NOISE, LikelihoodFit, maximise

NOISES = ("auto", "output", "innovations")
WHITE_P = 0.008
"""Residuals are not white where the least Ljung-Box p of so many tests is less probable than this: 0.001 a test of four runs."""
MOST_ASKED = 8
"""Of more runs so many, those with the least p, say whether a force on the hull is seen at all; the filter costs much."""
LAGS = 200
"""Of the Ljung-Box test, at most (and an eighth of the record): a choice."""
CLEARLY = 10.0
"""A noise model is preferred where its BIC is lower by more than this."""


def fit_with_noise(
    runs: list[RunData],
    form: str = "full",
    speed_m_s: float | None = None,
    noise: str = "auto",
    progress: Callable[[str], None] | None = None,
    each: Each = in_turn,
) -> Fit:
    """``fit_runs``, and the Kalman filter's prediction-error fit where the residuals ask for it.

    Parameters
    ----------
    runs : as in ``fit_runs``
    form : as in ``fit_runs``
    speed_m_s : as in ``fit_runs``
    noise : "output": output error, colour whitened by an autoregression; "innovations": a coloured force on the hull;
        "auto": output error, unless its residuals are coloured and a force on the hull explains them better (BIC)
    progress : is told in a sentence what is done
    each : does what is one run's, here or by workers

    Where runs have a static record the measurement's colour is that record's, in both; what is looked for is what it leaves.

    Raises
    ------
    EstimationError : as ``fit_runs``; an unknown ``noise``
    """
    if noise not in NOISES:
        raise EstimationError(f"noise {noise!r}; expected {', '.join(NOISES)}")
    fit = fit_runs(runs, form, speed_m_s, progress)
    if noise == "output":
        return fit
    known = colours(runs)
    chances = _least_p(fit, known)
    lowest = min(chances)
    if noise == "auto" and 1 - (1 - lowest) ** (2 * len(runs)) > WHITE_P:
        what = "white" if not any(known) else "white once the static records' colour is taken out of them"
        return replace(fit, notes=(f"the residuals are {what} (least Ljung-Box p {lowest:.2g}): output error",))
    if noise == "auto" and len(runs) > 2 * MOST_ASKED:
        some = [runs[k] for k in sorted(np.argsort(chances, kind="stable")[:MOST_ASKED])]
        few = fit_runs(some, form, fit.speed_m_s, progress)
        asked = _asked(_along(some, few), few, form, noise, progress, each)
        if asked.found is None:
            return _without_force(runs, fit, form, asked, progress)
        begin = asked.found.noise
    else:
        begin = None
    along = _along(runs, fit)
    asked = _asked(along, fit, form, noise, progress, each, begin)
    if asked.found is None:
        return _without_force(runs, fit, form, asked, progress)
    return as_fit(along, fit, asked.found, (asked.words,))


@dataclass(frozen=True)
class _Asked:
    """Whether a force on the hull is seen: its fit (None: it is not) and a sentence; ``told``: by runs with static records."""

    found: LikelihoodFit | None
    words: str
    told: bool = False


def _asked(
    along: list[RunData],
    fit: Fit,
    form: str,
    noise: str,
    progress: Callable[[str], None] | None,
    each: Each,
    begin: Array | None = None,
) -> _Asked:
    """Fit a force to the residuals of ``fit`` to the runs ``along`` its path, and hold it against coloured measurement noise."""
    known = any(colours(along))
    what = "coloured beyond what the static records show" if known else "coloured"
    few = [thinned(d, keep_first=True, keep_modes=True) for d in along]
    answers = Problem(few, form, fit.speed_m_s).evaluate(fit.theta)
    measurement, margin = measurement_bic(few, answers), 0.0 if known else CLEARLY
    size = NOISE * float(np.log(sum(2 * len(d.t_s) for d in few)))

    def asked(few: list[RunData], answers: list[Answer]) -> float:
        return (measurement if known else min(measurement, white_bic(few, answers))) - margin - size

    try:
        ends = asked if noise == "auto" else None
        found = maximise(along, form, fit.speed_m_s, fit.theta, begin, progress, each=each, asked=ends)
    except EstimationError as error:
        if noise == "innovations":
            raise
        return _Asked(None, f"the residuals are {what}; no force on the hull could be fitted to them ({error})")
    force_bic = found.deviance + size
    gap = measurement - force_bic
    # an autoregression for every channel of every run costs much: a force must also be seen against plain white noise
    unseen = not known and white_bic(found.problem.runs, found.answers) - force_bic < CLEARLY
    if noise == "auto" and (unseen or gap < margin):
        against = "explains it as well as" if gap >= 0 else "explains it better than"
        words = f"the residuals are {what}, and " + (
            "a force on the hull explains none of it: output error, whitened by an autoregression"
            if unseen
            else f"colour of the measurement {against} a force on the hull (BIC {gap:+.0f} for the force): output error, "
            "whitened by an autoregression"
        )
        return _Asked(None, words, known)
    d = found.disturbance
    words = (
        f"the residuals are {what} as a force on the hull makes them "
        f"(BIC lower by {gap:.0f} than for coloured measurement noise): "
        if noise == "auto"
        else f"innovations form as asked for (BIC lower by {gap:.0f} than for coloured measurement noise): "
    ) + f"side force {d.force_n:.2g} N, moment {d.moment_n_m:.2g} N m, correlation time {d.time_s:.2g} s"
    return _Asked(found, words)


def _along(runs: list[RunData], fit: Fit) -> list[RunData]:
    return [modes_along(d, path) for d, path in zip(runs, fit.response, strict=True)]


def _without_force(
    runs: list[RunData], fit: Fit, form: str, asked: _Asked, progress: Callable[[str], None] | None
) -> Fit:
    if asked.told:
        fit = fit_runs([replace(d, still=None) for d in runs], form, fit.speed_m_s, progress)
    return replace(fit, notes=(asked.words,))


def _least_p(fit: Fit, known: list[Colour | None]) -> list[float]:
    """Every run's least Ljung-Box p of its channels: of the residuals, or of what a known colour leaves of them."""
    chances = []
    for residual, white, colour in zip(fit.residual, fit.innovation, known, strict=True):
        found = []
        for channel in range(2):
            lags = min(LAGS, len(residual) // 8)
            if colour is None:
                found.append(ljung_box_p(residual[:, channel], lags=lags))
            else:
                told_by = len(colour.regression[channel]), colour.samples
                found.append(ljung_box_p(white[:, channel], lags=lags, elsewhere=told_by))
        chances.append(min(found))
    return chances


def measurement_bic(few: list[RunData], answers: list[Answer]) -> float:
    """BIC of the output error with an autoregression per channel, on the same block means as the innovations.

    Parameters
    ----------
    few : block means of the runs
    answers : of the output error's optimum
    """
    total, orders, samples = 0.0, 0, 0
    for data, answer in zip(few, answers, strict=True):
        first = stated(data.covariance, data.t_s)
        weight = measured(answer.residual.T, first)
        white = weight.along(answer.residual)
        total += float((white**2).sum()) + float(np.log(np.linalg.det(data.covariance)).sum())
        total += 2 * len(data.t_s) * float(np.log(weight.scale * weight.innovation).sum())
        orders += sum(len(a) for a in weight.regression) + 2
        samples += 2 * len(data.t_s)
    return total + orders * float(np.log(samples))


def white_bic(few: list[RunData], answers: list[Answer]) -> float:
    """BIC of paths without the force: block means that scatter as white noise, in each channel so much in all runs.

    Parameters
    ----------
    few : block means of the runs
    answers : along the paths
    """
    white = np.concatenate(
        [stated(d.covariance, d.t_s).along(a.residual) for d, a in zip(few, answers, strict=True)], axis=1
    )
    count = white.shape[1]
    spread = count * float(np.log((white**2).mean(axis=1)).sum()) + 2 * count
    total = spread + sum(float(np.log(np.linalg.det(d.covariance)).sum()) for d in few)
    return total + 2 * float(np.log(2 * count))


def as_fit(runs: list[RunData], fit: Fit, found: LikelihoodFit, notes: tuple[str, ...]) -> Fit:
    """The likelihood's optimum in the form of ``fit_runs``'s answer; ``runs`` with every sample.

    Parameters
    ----------
    runs : the runs, in their order
    fit : of the output error
    found : the likelihood's optimum
    notes : sentences for the user
    """
    problem = Problem(runs, found.problem.form, found.problem.speed)
    answers = problem.evaluate(found.theta)
    covariance, sd = found.inverse.shared[:6, :6], np.sqrt(np.maximum(found.inverse.variance, 0.0))
    count = len(runs)
    weights = [stated(d.covariance, d.t_s) for d in runs]
    scale: Array = np.array(
        [np.sqrt(np.mean(w.along(a.residual) ** 2, axis=1)) for w, a in zip(weights, answers, strict=True)]
    )
    return replace(
        fit,
        six=found.theta[:6],
        covariance=covariance,
        filtered_covariance=covariance,
        own=found.theta[6 : problem.own_end].reshape(count, len(OWN)),
        own_sd=sd[6 : problem.own_end].reshape(count, len(OWN)),
        common=common_errors(problem, found.theta, sd),
        beside=beside_of(problem, found.theta, sd),
        modes={key: found.theta[at] for key, at in problem.mode_at.items()},
        response=[a.response.T for a in answers],
        residual=[a.residual.T for a in answers],
        scale=scale,
        innovation=[r.white for r in found.runs],
        orders=np.zeros((count, 2), dtype=int),
        steps=fit.steps + found.steps,
        converged=found.converged,
        theta=found.theta,
        method="innovations",
        disturbance=found.disturbance,
        notes=notes,
        shares=found.shares,
    )
