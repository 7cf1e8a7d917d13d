"""Levenberg-Marquardt with Marquardt's scaling and Nielsen's damping for ``Problem``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...record.errors import EstimationError
from ...simulate.model import Array
from .arrow import Arrow
from .problem import Answer, Problem

MAX_STEPS = 60
"""Levenberg-Marquardt steps, refused ones included; a fit that needs more is said not to have settled."""
CONVERGED = 1e-8
"""Steps end when the next one is expected to lower the chi-square by less than this share of it."""
LARGEST_FACTOR = 0.5
"""Logarithm; beyond it a derivative is on its way through zero, or far off."""
SMALLEST_DAMPING = 1e-12
"""Marquardt's damping stays within these limits: below it a step is Gauss-Newton's ..."""
LARGEST_DAMPING = 1e12
"""... and beyond this it no longer moves anything: the fit stands."""
STRAIGHT = 0.9
"""After a step that gains less than this share of what was expected, the next ones are bent ..."""
PROBE = 0.1
"""... by the curvature seen over this share of them ..."""
BENT = 0.75
"""... unless that would change one by more than half this share of its length."""
Progress = Callable[[str], None]


class Weight(Protocol):
    """Whitens ``(2, n)`` or ``(2, k, n)`` of one run."""

    def along(self, values: Array) -> Array:
        """White, of unit variance, of the same shape."""
        ...


@dataclass(frozen=True)
class Optimum:
    """Where ``minimise`` ended.

    Attributes
    ----------
    theta : parameter vector
    answers : of the runs there
    chi_square : with priors
    steps : taken
    converged : the steps ended by themselves
    """

    theta: Array
    answers: list[Answer]
    chi_square: float
    steps: int
    converged: bool


def normal(
    problem: Problem, theta: Array, answers: Sequence[Answer], weights: Sequence[Weight]
) -> tuple[Arrow, Array, float]:
    """Normal matrix, gradient and chi-square with priors, over the whole parameter vector.

    Parameters
    ----------
    problem : runs and what is free
    theta : parameter vector of ``problem``
    answers : of the runs at ``theta``
    weights : of the runs
    """
    matrix, gradient, cost = problem.prior(theta)
    for answer, weight in zip(answers, weights, strict=True):
        e, j = weight.along(answer.residual), weight.along(answer.slope)
        matrix.add(answer.columns, j[0] @ j[0].T + j[1] @ j[1].T)
        gradient[answer.columns] += j[0] @ e[0] + j[1] @ e[1]
        cost += float((e * e).sum())
        if answer.gauge is not None:
            left, slope = answer.gauge
            matrix.add(answer.columns, slope @ slope.T)
            gradient[answer.columns] += slope @ left
            cost += float(left @ left)
    return matrix, gradient, cost


def damped_step(matrix: Arrow, gradient: Array, free: NDArray[np.bool_], damping: float) -> tuple[Array, float]:
    """A damped step over the whole parameter vector, 0 where not ``free``, and how far it should lower the chi-square.

    Parameters
    ----------
    matrix : normal matrix
    gradient : of the parameters
    free : (size,) of bool
    damping : Marquardt's
    """
    inner, slope = matrix.held(free), np.where(free, gradient, 0.0)
    scale = np.sqrt(np.maximum(inner.diagonal, 1e-300))
    step = inner.scaled(scale).solve(slope / scale, damping) / scale
    return step, float(step @ (2 * slope - inner.times(step)))


def _bent(
    problem: Problem,
    theta: Array,
    answers: Sequence[Answer],
    weights: Sequence[Weight],
    matrix: Arrow,
    step: Array,
    damping: float,
) -> Array:
    """The step with its second-order part: half of what undoes the residuals' curvature along it.

    Transtrum and Sethna, arXiv:1201.5885 (geodesic acceleration). In a long and curved valley, as a single long record makes one,
    straight steps must be short; the curvature costs one more evaluation.
    """
    with np.errstate(all="ignore"):
        probed = problem.residuals(theta + PROBE * step) if _usable(theta + PROBE * step) else []
        right = np.zeros_like(theta)
        for here, there, weight in zip(answers, probed, weights, strict=False):
            along = np.einsum("ckn,k->cn", here.slope, step[here.columns])
            bend = weight.along(2 / PROBE * ((there - here.residual) / PROBE + along))
            slope = weight.along(here.slope)
            right[here.columns] += slope[0] @ bend[0] + slope[1] @ bend[1]
    if not np.isfinite(right).all():
        return step
    more, _ = damped_step(matrix, right, problem.free, damping)
    size = np.sqrt(np.maximum(matrix.diagonal, 0.0))
    small = np.linalg.norm(size * more) <= BENT * np.linalg.norm(size * step)
    return step + more / 2 if small else step


def _usable(theta: Array) -> bool:
    return bool(theta[0] > 0 and theta[1] > 0 and np.isfinite(theta).all())


def _after_step(theta: Array, step: Array) -> Array:
    """``theta`` after the step; the six derivatives are multiplied by factors.

    Where T is not known, scaling all forces together hardly changes the motion. That direction is a curved valley of
    the chi-square, which factors follow and a straight step would leave.
    """
    trial = theta + step
    share = step[:6] / theta[:6]
    if np.abs(share).max() < LARGEST_FACTOR:
        trial[:6] = theta[:6] * np.exp(share)
    return trial


def minimise(
    problem: Problem,
    theta: Array,
    weights: Sequence[Weight],
    progress: Progress | None = None,
    answers: list[Answer] | None = None,
    damping: float = 1e-3,
    converged: float = CONVERGED,
) -> Optimum:
    """Lower the chi-square from ``theta``.

    Parameters
    ----------
    problem : runs and what is free
    theta : where it begins
    weights : of the runs
    progress : is told in a sentence what is done
    answers : at ``theta``, where they are known
    damping : to begin with; small where ``theta`` is near the optimum
    converged : share of the chi-square below which a step is not worth taking

    Raises
    ------
    EstimationError : the motion at ``theta`` grows beyond bounds
    """
    with np.errstate(all="ignore"):
        if answers is None:
            answers = problem.evaluate(theta)
        matrix, gradient, cost = normal(problem, theta, answers, weights)
    if not np.isfinite(cost):
        raise EstimationError(
            "the motion simulated from the weak-form start grows beyond bounds; is the tow stable (X_T > X_v)?"
        )
    growth, curved = 2.0, False
    for step_number in range(MAX_STEPS):
        step, expected = damped_step(matrix, gradient, problem.free, damping)
        if expected < converged * max(cost, 1.0):
            return Optimum(theta, answers, cost, step_number, True)
        if curved:
            step = _bent(problem, theta, answers, weights, matrix, step, damping)
        trial = theta + step if curved else _after_step(theta, step)
        new_cost, found, there = np.inf, None, answers
        if _usable(trial):
            with np.errstate(all="ignore"):
                there = problem.evaluate(trial)
                found = normal(problem, trial, there, weights)
            new_cost = found[2]
        if found is not None and np.isfinite(new_cost) and new_cost <= cost:
            gain = (cost - new_cost) / max(expected, 1e-300)
            curved = curved or gain < STRAIGHT
            theta, answers, (matrix, gradient, cost) = trial, there, found
            damping *= max(1 / 3, 1 - (2 * gain - 1) ** 3)
            damping, growth = max(damping, SMALLEST_DAMPING), 2.0
            if progress is not None:
                progress(f"{problem.form}: step {step_number + 1}, chi-square {cost:.6g}")
        else:
            curved, damping, growth = True, damping * growth, growth * 2
            if damping > LARGEST_DAMPING:
                return Optimum(theta, answers, cost, step_number + 1, False)
    return Optimum(theta, answers, cost, MAX_STEPS, False)
