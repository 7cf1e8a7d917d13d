"""Do the runs agree? Each run by itself and all runs without it, against the joint fit (8.3.4; tables 8.8, 8.10)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from ..record.each import Each, in_turn
from ..record.errors import EstimationError
from ..simulate.model import Array, alpha_from_y, line_force
from .colour.choose import as_fit
from .colour.innovations import maximise
from .data import RunData
from .fit import NEAR, Fit, Near, fit_runs, modes_along
from .joint.problem import Problem
from .joint.solve import minimise
from .joint.thin import thinned
from .limits.combinations import determined
from .noise import stated
from .static_records import colours
from .still import reweighted

LEAST_GAIN = 1e-3
"""A part whose variance is less than this share above the joint fit's holds all that the joint fit knows: no z."""
REFITTED = 4
"""Up to so many runs each is fitted alone, and all but each, to the end: what that takes grows with the square of their number."""
PINNED = 1e-6
"""A derivative is held at a value by a prior of this relative width."""


@dataclass(frozen=True)
class Part:
    """A fit to some of the runs, beside the joint one.

    Attributes
    ----------
    name : of the run (alone), or of the run that was left out
    six, sd : (6,), at the joint fit's speed; NaN where it could not be fitted
    z : (6,), difference to the joint fit over its own standard deviation sqrt(sd^2 - sd_joint^2); NaN where none
    fixed : (6,) bool, False: these runs do not determine it by itself
    problem : why it could not be fitted, or empty
    """

    name: str
    six: Array
    sd: Array
    z: Array
    fixed: NDArray[np.bool_]
    problem: str = ""


@dataclass(frozen=True)
class Consistency:
    """Result of ``consistency``.

    Attributes
    ----------
    alone : each run by itself
    without : all runs but one; empty for a single run
    mean, scatter : (6,), of the runs alone, as in table 8.8: plain mean and standard deviation, of the determined ones; NaN
        where fewer than two are
    chi_square, degrees, p_value : how much worse the runs are fitted with the joint six than each with its own: sum of the
        drops of -2 log L, on 6 (runs - 1) degrees of freedom (Wilks); None for one run, or where one could not be fitted
    stepped : ``alone`` and ``without`` are one step from the joint fit, not refits, and the test is Rao's
    """

    alone: tuple[Part, ...]
    without: tuple[Part, ...]
    mean: Array
    scatter: Array
    chi_square: float | None
    degrees: int
    p_value: float | None
    stepped: bool = False


def consistency(
    fit: Fit, runs: list[RunData], progress: Callable[[str], None] | None = None, each: Each = in_turn
) -> Consistency:
    """Fit each run alone and all but each, in the form and with the noise of ``fit``.

    Of more than ``REFITTED`` runs neither is searched for: one Gauss-Newton step from the joint fit, by each run's share of its
    information, gives both (``Shares``); its error is of the square of the step, and the drop is then Rao's, not Wilks's.

    A part's estimate and the joint one share the part's data: for efficient estimates the difference has the covariance
    cov(part) - cov(joint) (Hausman, Econometrica 46, 1978).

    Parameters
    ----------
    fit : the joint fit
    runs : as fitted
    progress : is told in a sentence what is done
    each : does a run's share, here or by workers
    """
    alone, without = _refitted(fit, runs, progress, each) if 1 < len(runs) <= REFITTED else _stepped(fit, runs)
    kept = np.array([np.where(p.fixed, p.part.six, np.nan) for p in alone])
    count = np.isfinite(kept).sum(axis=0)
    mean, scatter = np.full(6, np.nan), np.full(6, np.nan)
    for i in np.flatnonzero(count >= 2):
        values = kept[np.isfinite(kept[:, i]), i]
        mean[i], scatter[i] = values.mean(), values.std(ddof=1)
    degrees = 6 * (len(runs) - 1)
    square = sum(p.drop for p in alone) if degrees else np.nan
    told = bool(np.isfinite(square))
    return Consistency(
        tuple(p.part for p in alone),
        tuple(p.part for p in without),
        mean,
        scatter,
        float(square) if told else None,
        degrees,
        float(chdtrc(degrees, square)) if told else None,
        len(runs) > REFITTED,
    )


@dataclass(frozen=True)
class _Fitted:
    part: Part
    drop: float

    @property
    def fixed(self) -> NDArray[np.bool_]:
        return self.part.fixed


def _refitted(
    fit: Fit, runs: list[RunData], progress: Callable[[str], None] | None, each: Each
) -> tuple[list[_Fitted], list[_Fitted]]:
    """Each run alone, and all but each."""
    every = range(len(runs))
    parts = [(run.name, fit, runs, (k,)) for k, run in enumerate(runs)]
    parts += [(run.name, fit, runs, tuple(i for i in every if i != k)) for k, run in enumerate(runs)]
    # the longest first, so that no worker is left with one at the end
    say = None if progress is None else lambda done: progress(f"consistency: fit {done} of {len(parts)}")
    found = each(_part, parts[::-1], say)[::-1]
    return found[: len(runs)], found[len(runs) :]


def _stepped(fit: Fit, runs: list[RunData]) -> tuple[list[_Fitted], list[_Fitted]]:
    """The same by one step from the joint fit; a single run alone is the joint fit."""
    if len(runs) == 1:
        return [_Fitted(_judged(runs[0].name, fit, fit.six, fit.covariance), np.nan)], []
    shares = fit.shares
    assert shares is not None
    alone, without = [], []
    for k, run in enumerate(runs):
        step, covariance = shares.alone(k)
        part = _judged(run.name, fit, fit.six + step[:6], covariance[:6, :6])
        alone.append(_Fitted(part, max(shares.drop(k, 6), 0.0)))
        step, covariance = shares.without(k)
        without.append(_Fitted(_judged(run.name, fit, fit.six + step[:6], covariance[:6, :6]), np.nan))
    return alone, without


def _judged(name: str, fit: Fit, six: Array, covariance: Array) -> Part:
    """A part's estimate with its covariance (6, 6) beside the joint fit."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    fixed = np.zeros(6, dtype=bool)
    fixed[list(determined(six, covariance).single)] = True
    joint = np.diag(fit.covariance)
    gain = sd**2 - joint
    usable = fixed & (gain > LEAST_GAIN * joint)
    z = np.where(usable, (six - fit.six) / np.sqrt(np.where(usable, gain, 1.0)), np.nan)
    return Part(name, six, sd, z, fixed)


def _part(name: str, fit: Fit, runs: list[RunData], chosen: tuple[int, ...]) -> _Fitted:
    """A fit to the ``chosen`` of the ``runs``; of one alone, the drop of -2 log L as well."""
    some = [runs[k] for k in chosen]
    near = Near.of(fit, runs, chosen)
    try:
        found = fit_runs(some, fit.form, fit.speed_m_s, start=fit.six, near=near)
        if not found.converged:
            found = fit_runs(some, fit.form, fit.speed_m_s, start=fit.six)
        if fit.method == "innovations":
            along = [modes_along(d, p) for d, p in zip(some, found.response, strict=True)]
            found = as_fit(along, found, maximise(along, fit.form, fit.speed_m_s, found.theta), ())
    except EstimationError as error:
        nothing = np.full(6, np.nan)
        return _Fitted(Part(name, nothing, nothing, nothing, np.zeros(6, dtype=bool), str(error)), np.nan)
    drop = np.nan
    if len(chosen) == 1:
        drop = (_drop_innovations if found.method == "innovations" else _drop)(fit, found, some[0], chosen[0], near)
    return _Fitted(_judged(name, fit, found.six, found.covariance), drop)


def _drop(fit: Fit, alone: Fit, run: RunData, index: int, near: Near) -> float:
    """Chi-square of a run with the joint six held, less that with its own, both by one whitener: its own fit's."""
    data = [modes_along(run, fit.response[index])]
    colour = colours([run])[0] if run.still is not None else None
    weight = [reweighted(alone.residual[0], stated(run.covariance, run.t_s), colour)]
    costs = []
    for hold, start, path in (((), alone.theta, alone.path), (tuple(range(6)), near.theta, near.path)):
        problem = Problem(data, fit.form, fit.speed_m_s, hold, path=path)
        costs.append(minimise(problem, start, weight, damping=NEAR).chi_square)
    return costs[1] - costs[0]


def _drop_innovations(fit: Fit, alone: Fit, run: RunData, index: int, _: Near) -> float:
    """The same of the innovations' likelihood; the joint six are pinned."""
    data = [modes_along(run, fit.response[index])]
    pins = tuple((i, float(v), PINNED * abs(float(v))) for i, v in enumerate(fit.six))
    start = alone.theta.copy()
    free = maximise(data, fit.form, fit.speed_m_s, start)
    start[:6] = fit.six
    return maximise(data, fit.form, fit.speed_m_s, start, free.noise, extra=pins).deviance - free.deviance


@dataclass(frozen=True)
class Judged:
    """What is left of one run, for whiteness, and the input it must not hang on.

    Attributes
    ----------
    t_s : (n,)
    white : (n, 2), residuals of y and beta as the fit whitened them; of block means in the innovations form
    force_n : (n,), lateral line force T sin(alpha + beta) of the fitted motion: the input of the open loop (8.27)
    """

    t_s: Array
    white: Array
    force_n: Array


def judged(fit: Fit, runs: list[RunData]) -> list[Judged]:
    """Residuals and input of each run of ``fit``.

    Parameters
    ----------
    fit : the joint fit
    runs : as fitted
    """
    found = []
    for data, response, white in zip(runs, fit.response, fit.innovation, strict=True):
        tow = data.tow
        post, _ = tow.post_motion(data.t_s)
        alpha = np.nan_to_num(alpha_from_y(response[:, 0], response[:, 1], tow, post))
        tension = tow.tension_n if data.tension is None else np.interp(data.t_s, *data.tension)
        angle = alpha + response[:, 1]
        side, _ = line_force(tow, tension, np.sin(angle), np.cos(angle))
        force, times = -np.asarray(side), data.t_s
        if len(white) != len(times):
            times = thinned(data, keep_first=True, keep_modes=True).t_s
            force = np.interp(times, data.t_s, force)
        found.append(Judged(times, white, force))
    return found
