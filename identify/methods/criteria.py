"""The criteria of the thesis's appendix IV: h(Q) = tr(S Q) and h(Q) = det(Q) of the residuals' covariance Q.

tr(S Q) with a given S is weighted least squares; det(Q) is maximum likelihood for white Gaussian noise of unknown covariance,
found by taking S = Q^-1 again and again. Both lower h monotonically in Q (AIV-2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..data import RunData
from ..fit import check_runs
from ..joint.arrow import inverse_of, widened
from ..joint.begin import rough_optimum
from ..joint.problem import Problem
from ..joint.solve import minimise

CRITERIA = ("trace", "determinant")
TURNS = 20
"""Most alternations of fit and weight, for the determinant: a choice."""
CONVERGED = 1e-6
"""The weight has converged when no entry of Q, in units of the scatters, changes by more than this from one turn to the next."""


@dataclass(frozen=True)
class CriterionFit:
    """Result of ``fit_criterion``.

    Attributes
    ----------
    six, covariance : (6,) and (6, 6); the covariance counts the residuals as white with covariance ``q``
    q : (2, 2), residual covariance of (y m, beta rad)
    value : tr(S Q) or det(Q) at the optimum
    """

    six: Array
    covariance: Array
    q: Array
    value: float


@dataclass(frozen=True)
class _Weight:
    root: Array

    def along(self, values: Array) -> Array:
        flat = values.reshape(2, -1)
        return (self.root @ flat).reshape(values.shape)


def fit_criterion(
    runs: list[RunData],
    criterion: str = "determinant",
    s: Array | None = None,
    form: str = "linear",
    speed_m_s: float | None = None,
) -> CriterionFit:
    """Joint fit of the six derivatives by tr(S Q) or det(Q).

    Parameters
    ----------
    runs : as in ``fit_runs``
    criterion : "trace" or "determinant"
    s : (2, 2), S of tr(S Q); default: inverse of the mean stated covariance
    form : as in ``fit_runs``
    speed_m_s : as in ``fit_runs``

    Raises
    ------
    EstimationError : as ``fit_runs``; an unknown criterion; S not positive definite
    """
    if criterion not in CRITERIA:
        raise EstimationError(f"criterion {criterion!r}; expected {', '.join(CRITERIA)}")
    speed = check_runs(runs, form, speed_m_s)
    begin = rough_optimum(runs, speed, form)
    problem = Problem(runs, form, speed, path=begin.path)
    theta = np.concatenate([begin.theta, np.zeros(problem.size - len(begin.theta))])
    stated = np.mean([d.covariance.mean(axis=0) for d in runs], axis=0)
    weight = np.linalg.inv(stated) if s is None else np.asarray(s, dtype=float)
    if not np.allclose(weight, weight.T) or np.linalg.eigvalsh(weight)[0] <= 0:
        raise EstimationError(f"S = {weight.tolist()}; a symmetric positive definite matrix is expected")
    answers, q = None, stated
    for _ in range(TURNS if criterion == "determinant" else 1):
        root = _Weight(np.linalg.cholesky(weight).T)
        optimum = minimise(problem, theta, [root] * len(runs), answers=answers, damping=1e-7)
        theta, answers = optimum.theta, optimum.answers
        residual = np.concatenate([a.residual for a in answers], axis=1)
        before, q = q, residual @ residual.T / residual.shape[1]
        if criterion == "determinant":
            weight = np.linalg.inv(q)
            size = np.sqrt(np.diag(q))
            if np.abs((q - before) / size[:, None] / size[None, :]).max() < CONVERGED:
                break
    assert answers is not None
    bread, _, _ = problem.prior(theta)
    middle, more = weight @ q @ weight, []
    for answer in answers:
        crossed = [[answer.slope[i] @ answer.slope[j].T for j in range(2)] for i in range(2)]
        here, there = (
            np.sum([by[i, j] * crossed[i][j] for i in range(2) for j in range(2)], axis=0) for by in (weight, middle)
        )
        bread.add(answer.columns, here)
        more.append((answer.columns, there - here))
    covariance, _ = widened(inverse_of(bread, problem.free), more)
    value = float(np.trace(weight @ q)) if criterion == "trace" else float(np.linalg.det(q))
    return CriterionFit(theta[:6], covariance[:6, :6], q, value)
