"""What the runs of a fit say of its parameters at a point: information, what is known beside, and the noise beyond white.

The covariance of the fit is the sandwich inverse (information + meat) inverse; a budget takes the same parts one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..simulate.model import Array
from .colour.leftover import Leftover, Whitened, leftover
from .joint.arrow import Arrow, Inverse, Part, inverse_of
from .joint.problem import Answer, Problem
from .noise import Whitener
from .still import Colour


@dataclass(frozen=True)
class Informed:
    """Result of ``informed``.

    Attributes
    ----------
    prior, pull : information and score of what is known beside the motion
    inverse : of the whole information
    plain : information, had the residuals been white with the scatter they have
    white : each run's residuals and slopes, whitened
    slow : noise that the whitening leaves
    meat : of each run (k, k), variance of its score beyond white noise's
    parts : of each run, for ``joint.arrow.shares_of``
    """

    prior: Arrow
    pull: Array
    inverse: Inverse
    plain: Arrow
    white: tuple[Whitened, ...]
    slow: Leftover
    meat: tuple[Array, ...]
    parts: tuple[Part, ...]


def informed(
    problem: Problem,
    theta: Array,
    answers: Sequence[Answer],
    weights: Sequence[Whitener],
    known: Sequence[Colour | None],
) -> Informed:
    """Information at ``theta``.

    Parameters
    ----------
    problem : runs and what is free
    theta : parameter vector of ``problem``
    answers : of the runs there
    weights : of the runs
    known : colour of the runs' noise by static records, where there are any
    """
    prior, pull, _ = problem.prior(theta)
    information, plain, white, told = prior.copy(), prior.copy(), [], []
    for data, w, answer in zip(problem.runs, weights, answers, strict=True):
        e, j = w.along(answer.residual), w.along(answer.slope)
        white.append(Whitened(e, j, answer.columns, float(np.median(np.diff(data.t_s)))))
        block, told_of = j[0] @ j[0].T + j[1] @ j[1].T, j[0] @ e[0] + j[1] @ e[1]
        plain.add(answer.columns, information_as_white(w, answer))
        if answer.gauge is not None:
            left, slope = answer.gauge
            block, told_of = block + slope @ slope.T, told_of + slope @ left
            plain.add(answer.columns, slope @ slope.T)
        told.append((answer.columns, block, told_of))
        information.add(answer.columns, block)
    inverse = inverse_of(information, problem.free)
    unknown = [run for run, colour in zip(white, known, strict=True) if colour is None]
    slow = leftover(unknown, [inverse.of(run.columns) for run in unknown])
    more = [
        slow.meat(run) if colour is None else _known_meat(run.slope, colour.left)
        for run, colour in zip(white, known, strict=True)
    ]
    parts = tuple((*one, meat) for one, meat in zip(told, more, strict=True))
    return Informed(prior, pull, inverse, plain, tuple(white), slow, tuple(more), parts)


def _known_meat(slope: Array, correlations: tuple[Array, Array]) -> Array:
    """The information's variance beyond white noise: sum of rho_k (J_t' J_t+k + transposed); slope (2, k, n)."""
    matrix = np.zeros((slope.shape[1], slope.shape[1]))
    for rows, rho in zip(slope, correlations, strict=True):
        for lag in range(1, len(rho)):
            if rho[lag] <= 0:  # the initial positive sequence; beyond it the estimates are noise
                break
            cross = rows[:, :-lag] @ rows[:, lag:].T * rho[lag]
            matrix += cross + cross.T
    return matrix


def information_as_white(weight: Whitener, answer: Answer) -> Array:
    """A run's information, had its residuals been white.

    Parameters
    ----------
    weight : whitens residuals
    answer : response of the run
    """
    nothing = np.zeros(0)
    j = replace(weight, regression=(nothing, nothing), innovation=np.ones(2)).along(answer.slope)
    return j[0] @ j[0].T + j[1] @ j[1].T


__all__ = ["Informed", "information_as_white", "informed"]
