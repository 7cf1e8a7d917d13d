"""Where the fit starts: no guess asked for, and a way in where the first simulated motion leaves the equations' range.

A long tow of large swings is sensitive: with derivatives some per cent wrong it goes past 90 degrees and has no residual.
The way in is to fit the records' beginning first and to let them grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..data import RunData
from ..noise import stated
from .guess import Path
from .problem import OWN, Problem
from .solve import Optimum, Progress, Weight, minimise, normal
from .thin import thinned

ROUGH_CONVERGED = 1e-3
"""A first fit ends when its next step would lower the chi-square by less than this share."""
POOR = {"constant": 30.0, "surge": 3000.0}
"""A start whose chi-square per residual exceeds this is led in by growing records; the linear form, whose tension is constant,
leaves more of a tow that swings on a line of constant length."""
DOUBTFUL = 1.3
"""Chi-square per residual, by the stated sigmas, above which an optimum is looked for on a second way."""
FAR_OFF = {"constant": 1e3, "surge": 3e3}
"""From more per residual the whole fit does not find its way by itself."""
SHARES = (0.25, 0.5, 1.0)
"""Of the records, one after the other: a quarter, half, all."""
LEAD_S = 90.0
"""Records longer than twice this are fitted from their beginning on, twice as much each time: over many swings a start that is a
little off in frequency ends far off in phase, and finds the valley beside."""
LEADING_CONVERGED = 1e-3
"""The same for fits to the records' beginnings."""
MOST_ROUGH = 8
"""Of more runs so many, spread over the tow points, say where the derivatives begin; the others' own starts follow from these."""
FEWEST_SAMPLES = 40
"""A beginning holds so many samples at least: a choice."""
Extra = tuple[tuple[int, float, float], ...]


@dataclass(frozen=True)
class Begin:
    """Where a fit may begin.

    Attributes
    ----------
    theta : parameter vector, without common modes
    steps : it took to get there
    path : of the full form there, or near; None: none is known
    """

    theta: Array
    steps: int
    path: Path | None = None


def rough_optimum(
    runs: list[RunData],
    speed_m_s: float,
    form: str,
    progress: Progress | None = None,
    start: Array | None = None,
    extra: Extra = (),
    hold: tuple[int, ...] = (),
) -> Begin:
    """Near the optimum, from block means and the stated sigmas.

    Parameters
    ----------
    runs : the runs, in their order
    speed_m_s : at which the derivatives are quoted
    form : that theta is for; the full form is led in from the linear one where all runs allow it
    progress : is told in a sentence what is done
    start : (6,) derivatives instead of the weak form's
    extra : knowledge of derivatives beside the priors: (index, value, sd)
    hold : indices of derivatives that keep the value of ``start``

    Raises
    ------
    EstimationError : no motion near the records can be simulated
    """
    longest = max(float(d.t_s[-1] - d.t_s[0]) for d in runs)
    if longest > 2 * LEAD_S:
        return _grown(runs, speed_m_s, form, longest, progress, start, extra, hold)
    if len(runs) > MOST_ROUGH and not any(knows_full_only(d) for d in runs):
        found = _by_some(runs, speed_m_s, form, progress, start, extra, hold)
        if found is not None:
            return found
    few = [thinned(d) for d in runs]
    # the linear form knows no rudder: what a rudder holds the model aside by is a bias to it
    problem = Problem([_biased(d) for d in few], "linear", speed_m_s, hold, extra)
    weights = [stated(d.covariance, d.t_s) for d in few]
    first = problem.start() if start is None else problem.from_six(start)
    linear_too = not any(knows_full_only(d) for d in runs)
    unbiased = Problem([_unbiased(d) for d in few], "linear", speed_m_s, hold, extra)
    if form == "linear":
        found = _linear_optimum(problem, unbiased, first, weights, progress)
        return Begin(found.theta, found.steps)
    whole = Problem(few, "full", speed_m_s, hold, extra, rough=True)
    begins, steps = [whole.from_linear(first)], 0
    if linear_too:
        try:
            found = _linear_optimum(problem, unbiased, first, weights, progress)
            begins.insert(0, whole.from_linear(found.theta))
            steps = found.steps
        except EstimationError:
            pass
    for turn, theta in enumerate(begins):
        near, answers = runs[0].tow.line == "constant" and linear_too and turn == 0, None
        if near:
            score = _per_residual(whole, theta, weights)
        else:  # the search goes on from what is found here
            with np.errstate(all="ignore"):
                answers = whole.evaluate(theta)
                cost = normal(whole, theta, answers, weights)[2]
            score = cost / sum(2 * len(d.t_s) for d in few) if np.isfinite(cost) else np.inf
        if score < POOR[runs[0].tow.line]:
            if near:
                return Begin(theta, steps, whole.path)
            found = minimise(whole, theta, weights, progress, answers, converged=ROUGH_CONVERGED)
            steps += found.steps
            if found.chi_square > DOUBTFUL * sum(2 * len(d.t_s) for d in few):
                # noise may be larger than stated, or this is a valley beside the right one: the longer way may end lower
                other, led = _led_in(few, speed_m_s, begins, progress, extra, hold)
                steps += led.steps
                if other < found.chi_square:
                    return replace(led, steps=steps)
            return Begin(found.theta, steps, whole.path)
    _, led = _led_in(few, speed_m_s, begins, progress, extra, hold)
    return replace(led, steps=steps + led.steps)


def _grown(
    runs: list[RunData],
    speed_m_s: float,
    form: str,
    longest_s: float,
    progress: Progress | None,
    start: Array | None,
    extra: Extra,
    hold: tuple[int, ...],
) -> Begin:
    """``rough_optimum`` of long records: of their first ``LEAD_S``, then of twice as much each time."""
    span_s = LEAD_S
    begin = rough_optimum([_until(d, span_s) for d in runs], speed_m_s, form, progress, start, extra, hold)
    few = [thinned(d) for d in runs]
    while span_s < longest_s:
        span_s *= 2
        problem = Problem([_until(d, span_s) for d in few], form, speed_m_s, hold, extra, rough=True)
        found = _followed(problem, begin.theta, progress, last=span_s >= longest_s)
        begin = Begin(found.theta, begin.steps + found.steps, problem.path)
    return begin


def _followed(problem: Problem, theta: Array, progress: Progress | None, last: bool) -> Optimum:
    """The optimum of a part of the records; roughly, where it is not the ``last``."""
    weights = [stated(d.covariance, d.t_s) for d in problem.runs]
    return minimise(problem, theta, weights, progress, converged=ROUGH_CONVERGED if last else LEADING_CONVERGED)


def _by_some(
    runs: list[RunData],
    speed_m_s: float,
    form: str,
    progress: Progress | None,
    start: Array | None,
    extra: Extra,
    hold: tuple[int, ...],
) -> Begin | None:
    """The derivatives by some of the runs, then every run's own with these held, then all together; None where that comes near
    none."""
    order = np.argsort([d.tow.tow_point_m for d in runs], kind="stable")
    chosen = order[np.round(np.linspace(0, len(runs) - 1, MOST_ROUGH)).astype(int)]
    some = [runs[k] for k in chosen]
    begin = rough_optimum(some, speed_m_s, form, progress, start, extra, hold)
    theta = begin.theta
    few = [thinned(d) for d in runs]
    weights = [stated(d.covariance, d.t_s) for d in few]
    linear = Problem([_biased(d) for d in few], "linear", speed_m_s, apart=True)
    if tuple(linear.common_at) != tuple(Problem(some, "linear", speed_m_s).common_at):
        return None
    first = linear.from_six(theta[:6])
    first[linear.own_end :] = theta[6 + len(OWN) * len(some) :]
    found = minimise(linear, first, weights, progress, converged=ROUGH_CONVERGED)
    whole = linear.sides_to_full(found.theta) if form == "full" else found.theta
    for place, k in enumerate(chosen):
        at = 6 + len(OWN) * place
        whole[linear.own_at(k) : linear.own_at(k) + len(OWN)] = theta[at : at + len(OWN)]
    steps = begin.steps + found.steps
    if form == "linear":
        return Begin(whole, steps)
    apart = Problem(few, "full", speed_m_s, rough=True, apart=True)
    if _per_residual(apart, whole, weights) > FAR_OFF[runs[0].tow.line]:
        return None
    alone = minimise(apart, whole, weights, progress, converged=ROUGH_CONVERGED)
    together = Problem(few, "full", speed_m_s, hold, extra, rough=True, path=apart.path)
    found = minimise(together, alone.theta, weights, progress, converged=ROUGH_CONVERGED)
    return Begin(found.theta, steps + alone.steps + found.steps, together.path)


def knows_full_only(data: RunData) -> bool:
    """The run holds what the linear form does not know."""
    return (
        bool(data.tow.post_amplitude_m) or data.tension is not None or data.speed is not None or data.rudder is not None
    )


def _unbiased(data: RunData) -> RunData:
    """Without biases, unless a rudder may hold the model aside."""
    none = {"y_bias_sd_m": 0.0, "beta_bias_sd_rad": 0.0}
    return _biased(data) if data.steered else replace(data, priors=data.priors.model_copy(update=none))


def _biased(data: RunData) -> RunData:
    free = {"y_bias_sd_m": None, "beta_bias_sd_rad": None}
    return replace(data, priors=data.priors.model_copy(update=free)) if data.steered else data


def _linear_optimum(
    problem: Problem, unbiased: Problem, first: Array, weights: Sequence[Weight], progress: Progress | None
) -> Optimum:
    """The lower of two ends: with the biases free from the beginning, and after a fit with none (``unbiased``).

    A tow near the end of its stability has a mode that hardly dies away: over a record it is as good as a bias, and a run whose
    beginning holds some tenths of a metre of the one against the other makes a valley of its own, beside the right one.
    """
    ends: list[Optimum] = []
    try:
        ends.append(minimise(problem, first, weights, progress, converged=ROUGH_CONVERGED))
        held = minimise(unbiased, first, weights, progress, converged=ROUGH_CONVERGED)
        end = minimise(problem, held.theta, weights, progress, converged=ROUGH_CONVERGED)
        ends.append(replace(end, steps=held.steps + end.steps))
    except EstimationError:
        if not ends:
            raise
    return replace(min(ends, key=lambda end: end.chi_square), steps=sum(end.steps for end in ends))


def _per_residual(problem: Problem, theta: Array, weights) -> float:
    """Chi-square over the residuals' number; no sensitivities are asked for."""
    with np.errstate(all="ignore"):
        left = problem.residuals(theta)
        cost = problem.prior(theta)[2]
        cost += sum(float((w.along(residual) ** 2).sum()) for w, residual in zip(weights, left, strict=True))
    return cost / sum(2 * len(d.t_s) for d in problem.runs) if np.isfinite(cost) else np.inf


def _led_in(
    runs: list[RunData], speed_m_s: float, begins: list[Array], progress: Progress | None, extra: Extra, hold
) -> tuple[float, Begin]:
    """The records' first part from the best of the starts, then more and more of it; chi-square and where it ends."""
    problems = [
        Problem([_first_part(d, share) for d in runs], "full", speed_m_s, hold, extra, rough=True) for share in SHARES
    ]
    weights = [stated(d.covariance, d.t_s) for d in problems[0].runs]
    theta, steps = min(begins, key=lambda t: _per_residual(problems[0], t, weights)), 0
    for problem in problems[:-1]:
        found = _followed(problem, theta, progress, last=False)
        theta, steps = found.theta, steps + found.steps
    found = _followed(problems[-1], theta, progress, last=True)
    return found.chi_square, Begin(found.theta, steps + found.steps, problems[-1].path)


def _until(data: RunData, span_s: float) -> RunData:
    return _first(data, int(np.searchsorted(data.t_s, data.t_s[0] + span_s, side="right")))


def _first_part(data: RunData, share: float) -> RunData:
    return _first(data, int(share * len(data.t_s)))


def _first(data: RunData, count: int) -> RunData:
    last = max(min(FEWEST_SAMPLES, len(data.t_s)), count)
    return replace(
        data,
        t_s=data.t_s[:last],
        y_m=data.y_m[:last],
        beta_rad=data.beta_rad[:last],
        covariance=data.covariance[:last],
        common=data.common[:, :last],
        lag=data.lag[:, :last],
    )
