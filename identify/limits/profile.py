"""Profile likelihoods: how much worse the best fit gets when one derivative is held away from its estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from ..data import RunData
from ..fit import Fit
from ..joint.arrow import inverse_of
from ..joint.problem import Problem
from ..joint.solve import Optimum, minimise, normal
from ..joint.thin import thinned
from ..noise import Whitener, stated

CHI_SQUARE_95 = 3.841
"""95 % quantile of chi-square with one degree of freedom, 1.959964^2, to three decimals."""
FIRST_STEP_SD = 0.7
"""The walk's first step, in standard deviations; a parabola reaches the limit at 1.96."""
GROWTH = 1.5
"""Each step is longer than the one before by this factor."""
MOST_STEPS = 14
"""Of a walk: with this growth they reach 400 standard deviations."""
WIDEST_SHARE = 0.9
"""The search ends where a derivative has moved by this share of its value below, or ten times as much above."""


@dataclass(frozen=True)
class Profile:
    """Profile of one derivative.

    Attributes
    ----------
    index : of the derivative
    value : (k,), rising
    rise : (k,), of the chi-square over its least, all else refitted
    interval : 95 %; an end is None where the chi-square never rises by 3.84: the records do not bound it there
    """

    index: int
    value: Array
    rise: Array
    interval: tuple[float | None, float | None]


def profile(fit: Fit, runs: list[RunData], index: int) -> Profile:
    """Profile of derivative ``index`` of an output-error fit, on block means with the fit's own scatter.

    Parameters
    ----------
    fit : output error of ``runs``
    runs : the runs, in their order
    index : of the derivative
    """
    few = [thinned(d) for d in runs]
    weights = [stated(d.covariance * np.outer(s, s), d.t_s) for d, s in zip(few, fit.scale, strict=True)]
    free = Problem(few, fit.form, fit.speed_m_s)
    best = minimise(free, fit.theta[: free.size], weights)
    centre = float(best.theta[index])
    matrix, _, _ = normal(free, best.theta, best.answers, weights)
    sd = float(np.sqrt(max(inverse_of(matrix, free.free).shared[index, index], 0.0)))
    sd = min(sd, 0.3 * abs(centre)) if np.isfinite(sd) and sd > 0 else 0.1 * abs(centre)
    held = Problem(few, fit.form, fit.speed_m_s, hold=(index,))
    within = plausible(index, centre)
    below, above = (
        walked_outward(_rise(held, best, weights, index), centre, sign * FIRST_STEP_SD * sd, within) for sign in (-1, 1)
    )
    value = np.array([*[v for v, _ in below][::-1], centre, *[v for v, _ in above]])
    rise = np.array([*[r for _, r in below][::-1], 0.0, *[r for _, r in above]])
    return Profile(index, value, rise, (interval_end(centre, below), interval_end(centre, above)))


def _rise(problem: Problem, best: Optimum, weights: list[Whitener], index: int) -> Callable[[float], float]:
    """Value of the held derivative -> rise of the chi-square over its least, all else refitted from where the last refit ended."""
    theta = best.theta

    def rise(value: float) -> float:
        nonlocal theta
        trial = theta.copy()
        trial[index] = value
        optimum = minimise(problem, trial, weights)
        theta = optimum.theta
        return max(optimum.chi_square - best.chi_square, 0.0)

    return rise


def plausible(index: int, value: float) -> tuple[float, float]:
    """Range in which a derivative is looked for.

    Parameters
    ----------
    index : of the derivative, in the order of ``DERIVATIVE_UNITS``; the first two (m' and I') do not change sign
    value : its estimate

    Returns
    -------
    low, high : for m' and I' from a tenth of the value to ten times it; for the others nine times its size to either side
    """
    if index >= 2:
        return value - 10 * WIDEST_SHARE * abs(value), value + 10 * WIDEST_SHARE * abs(value)
    low, high = sorted((value * (1 - WIDEST_SHARE), value * (1 + 10 * WIDEST_SHARE)))
    return low, high


def walked_outward(
    rise: Callable[[float], float], centre: float, step: float, within: tuple[float, float]
) -> list[tuple[float, float]]:
    """Evaluate a rise at values ever farther from the optimum, until it exceeds CHI_SQUARE_95.

    Parameters
    ----------
    rise : value -> rise of the chi-square over its least; called in the order of the walk
    centre : the optimum
    step : first step, negative for a walk downward; each step is GROWTH times the last
    within : low and high; the walk ends before it would leave them, and after MOST_STEPS

    Returns
    -------
    walked : (value, rise) of every step; the last rise is the only one that may exceed CHI_SQUARE_95
    """
    walked: list[tuple[float, float]] = []
    distance = 0.0
    for _ in range(MOST_STEPS):
        distance += step
        step *= GROWTH
        if not within[0] < centre + distance < within[1]:
            break
        walked.append((centre + distance, rise(centre + distance)))
        if walked[-1][1] > CHI_SQUARE_95:
            break
    return walked


def interval_end(centre: float, walked: list[tuple[float, float]]) -> float | None:
    """Value at which the rise reaches CHI_SQUARE_95, by its square root, which is nearly a straight line.

    Parameters
    ----------
    centre : the optimum, where the rise is 0
    walked : (value, rise) from ``walked_outward``

    Returns
    -------
    end : of the 95 % interval; None where the walk never rose so far: the records do not bound the derivative there
    """
    if not walked or walked[-1][1] < CHI_SQUARE_95:
        return None
    values = [centre, *[v for v, _ in walked]]
    roots = np.sqrt([0.0, *[r for _, r in walked]])
    return float(np.interp(np.sqrt(CHI_SQUARE_95), roots[-2:], values[-2:]))
