"""The Cramer-Rao bound of a set of runs: no unbiased estimator scatters less."""

from __future__ import annotations

import numpy as np

from ...simulate.model import Array
from ..data import RunData
from ..joint.begin import rough_optimum
from ..joint.problem import Problem
from ..joint.solve import minimise, normal
from ..noise import stated


def cramer_rao(runs: list[RunData], six: Array, form: str = "linear", speed_m_s: float | None = None) -> Array:
    """Covariance bound of the six derivatives, (6, 6), white noise of the stated sigmas, priors as in the runs.

    Parameters
    ----------
    runs : motions without noise; their priors say what may move
    six : (6,) the true derivatives at ``speed_m_s`` (default: the runs' mean speed)
    form : "full" or "linear"
    speed_m_s : at which the derivatives are quoted
    """
    speed = float(np.mean([d.tow.speed_m_s for d in runs])) if speed_m_s is None else speed_m_s
    return np.linalg.inv(information_of_six(*information(runs, six, form, speed)))


def information(runs: list[RunData], six: Array, form: str, speed_m_s: float) -> tuple[Array, Problem]:
    """Fisher information of the free parameters at the derivatives ``six`` and the runs' own starts.

    Parameters
    ----------
    runs : the runs, in their order
    six : (6,) derivatives, in the order of ``DERIVATIVE_UNITS``
    form : "full" or "linear"
    speed_m_s : at which the derivatives are quoted
    """
    weights = [stated(d.covariance, d.t_s) for d in runs]
    still = tuple(range(6))
    begin = rough_optimum(runs, speed_m_s, form, start=six, hold=still)
    fixed = Problem(runs, form, speed_m_s, still, path=begin.path)
    theta = np.concatenate([begin.theta, np.zeros(fixed.size - len(begin.theta))])
    theta = minimise(fixed, theta, weights).theta
    problem = Problem(runs, form, speed_m_s, path=fixed.path)
    matrix, _, _ = normal(problem, theta, problem.evaluate(theta), weights)
    return matrix.dense(), problem


def information_of_six(matrix: Array, problem: Problem) -> Array:
    """What is left of the information on the derivatives when all else is free, (6, 6).

    Parameters
    ----------
    matrix : information of the free parameters
    problem : runs and what is free
    """
    other = np.flatnonzero(problem.free)
    other = other[other >= 6]
    inner = matrix[np.ix_(other, other)]
    scale = 1 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
    cross = matrix[other, :6] * scale[:, None]
    return (
        matrix[:6, :6] - cross.T @ np.linalg.pinv(inner * scale[:, None] * scale, rcond=1e-14, hermitian=True) @ cross
    )
