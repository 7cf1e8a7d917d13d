"""Several starts as a check: do they all reach the optimum that the weak form's start reaches?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..record.errors import EstimationError
from ..simulate.model import Array
from .data import RunData
from .fit import Fit
from .joint.problem import Problem
from .joint.solve import minimise
from .joint.thin import thinned
from .noise import stated

SPREAD = 0.5
"""Sizes of the starts are drawn log-normal about the fit's, with this standard deviation."""
MOST_TRIES = 5
"""So many times as many are drawn where the motions of some run off: a hull at random is often unstable, and tells nothing."""
SAME = 0.1
"""Optima are the same where no derivative differs by more than this share of its standard deviation ..."""
SAME_CHI_SQUARE = 0.1
"""... or the chi-square by less than this."""


@dataclass(frozen=True)
class Multistart:
    """Result of ``multistart``.

    Attributes
    ----------
    starts : (k, 6), all whose motion can be simulated
    six : (k, 6), where each start ended
    chi_square : (k,), there
    reached : how many ended at the reference optimum
    better : how many found a lower one: the fit then stands in a side optimum
    """

    starts: Array
    six: Array
    chi_square: Array
    reached: int
    better: int


def multistart(fit: Fit, runs: list[RunData], rng: np.random.Generator, starts: int = 10) -> Multistart:
    """Fit block means from scattered starts and compare with the optimum near ``fit``.

    Parameters
    ----------
    fit : output error of ``runs``
    runs : as fitted
    rng : that draws
    starts : how many whose motion can be simulated; fewer where MOST_TRIES times as many hold not so many
    """
    few = [thinned(d) for d in runs]
    problem = Problem(few, fit.form, fit.speed_m_s)
    weights = [stated(d.covariance * np.outer(s, s), d.t_s) for d, s in zip(few, fit.scale, strict=True)]
    reference = minimise(problem, fit.theta[: problem.size], weights)
    sd = np.sqrt(np.diag(fit.covariance))
    begins, ends = list[Array](), []
    for _ in range(MOST_TRIES * starts):
        begin = fit.six * np.exp(SPREAD * rng.normal(size=6))
        try:
            found = minimise(problem, problem.from_six(begin), weights)
        except EstimationError:
            continue  # its motion runs off
        begins.append(begin)
        ends.append(found)
        if len(ends) == starts:
            break
    six, chi_square = np.array([e.theta[:6] for e in ends]).reshape(-1, 6), np.array([e.chi_square for e in ends])
    near = (np.abs(six - reference.theta[:6]) < SAME * sd).all(axis=1)
    near |= np.abs(chi_square - reference.chi_square) < SAME_CHI_SQUARE
    better = chi_square < reference.chi_square - SAME_CHI_SQUARE
    return Multistart(np.array(begins).reshape(-1, 6), six, chi_square, int(near.sum()), int(better.sum()))
