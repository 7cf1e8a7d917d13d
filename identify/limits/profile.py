"""Profile likelihoods: how much worse the best fit gets when one derivative is held away from its estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from ..data import RunData
from ..fit import Fit
from ..joint.arrow import inverse_of
from ..joint.problem import Problem
from ..joint.solve import minimise, normal
from ..joint.thin import thinned
from ..noise import stated

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
    """Profile of derivative ``index`` of an output-error fit, on block means with the fit's own scatter."""
    few = [thinned(d) for d in runs]
    weights = [stated(d.covariance * np.outer(s, s), d.t_s) for d, s in zip(few, fit.scale, strict=True)]
    free = Problem(few, fit.form, fit.speed_m_s)
    best = minimise(free, fit.theta[: free.size], weights)
    centre = float(best.theta[index])
    matrix, _, _ = normal(free, best.theta, best.answers, weights)
    sd = float(np.sqrt(max(inverse_of(matrix, free.free).shared[index, index], 0.0)))
    sd = min(sd, 0.3 * abs(centre)) if np.isfinite(sd) and sd > 0 else 0.1 * abs(centre)
    held = Problem(few, fit.form, fit.speed_m_s, hold=(index,))
    below, above = (
        _walk(held, best.theta, best.chi_square, weights, index, sign * FIRST_STEP_SD * sd) for sign in (-1, 1)
    )
    value = np.array([*[v for v, _ in below][::-1], centre, *[v for v, _ in above]])
    rise = np.array([*[r for _, r in below][::-1], 0.0, *[r for _, r in above]])
    return Profile(index, value, rise, (_end(centre, below), _end(centre, above)))


def _walk(problem: Problem, theta: Array, least: float, weights, index: int, step: float) -> list[tuple[float, float]]:
    """(value, rise) outward from the optimum until the chi-square has risen beyond 3.84."""
    found: list[tuple[float, float]] = []
    centre, moved = float(theta[index]), 0.0
    low, high = sorted((centre * (1 - WIDEST_SHARE), centre * (1 + 10 * WIDEST_SHARE)))
    if index >= 2:
        low, high = centre - 10 * WIDEST_SHARE * abs(centre), centre + 10 * WIDEST_SHARE * abs(centre)
    for _ in range(MOST_STEPS):
        moved += step
        step *= GROWTH
        if not low < centre + moved < high:
            break
        trial = theta.copy()
        trial[index] = centre + moved
        optimum = minimise(problem, trial, weights)
        theta = optimum.theta
        found.append((centre + moved, max(optimum.chi_square - least, 0.0)))
        if found[-1][1] > CHI_SQUARE_95:
            break
    return found


def _end(centre: float, walked: list[tuple[float, float]]) -> float | None:
    if not walked or walked[-1][1] < CHI_SQUARE_95:
        return None
    # the root of the rise is nearly a straight line
    values = [centre, *[v for v, _ in walked]]
    roots = np.sqrt([0.0, *[r for _, r in walked]])
    return float(np.interp(np.sqrt(CHI_SQUARE_95), roots[-2:], values[-2:]))
