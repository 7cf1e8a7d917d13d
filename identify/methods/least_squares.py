"""Linear least squares by SVD (6.12): the estimate, its covariance, and how far the data hold it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array

RCOND = 1e-12
"""Singular values below this share of the largest are rounding."""


@dataclass(frozen=True)
class LeastSquares:
    """Result of ``least_squares_svd``.

    Attributes
    ----------
    theta, covariance : (k,), (k, k); the covariance takes the residuals as white and alike
    singular_values : (k,), of the column-scaled regressor matrix, falling
    condition : largest over smallest of them
    rank : singular values above RCOND of the largest; below k theta is the smallest of many solutions
    sigma : residual scatter
    residual : (n,)
    """

    theta: Array
    covariance: Array
    singular_values: Array
    condition: float
    rank: int
    sigma: float
    residual: Array


def least_squares_svd(regressors: Array, target: Array, rcond: float = RCOND) -> LeastSquares:
    """theta of ``regressors (n, k) @ theta = target (n,)`` (6.12), columns scaled, by SVD.

    Parameters
    ----------
    regressors : (n, k)
    target : (n,)
    rcond : singular values below this share of the largest count as 0

    Raises
    ------
    EstimationError : fewer rows than columns, or values that are not finite
    """
    phi, y = np.asarray(regressors, dtype=float), np.asarray(target, dtype=float)
    rows, columns = phi.shape
    if rows < columns:
        raise EstimationError(f"{rows} equations for {columns} unknowns")
    if not (np.isfinite(phi).all() and np.isfinite(y).all()):
        raise EstimationError("the regression holds values that are not finite")
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = 1.0
    u, s, vh = np.linalg.svd(phi / scale, full_matrices=False)
    kept = s > rcond * s[0]
    inverse = np.where(kept, 1 / np.where(kept, s, 1.0), 0.0)
    theta = vh.T @ (inverse * (u.T @ y)) / scale
    residual = y - phi @ theta
    rank = int(kept.sum())
    sigma = float(np.sqrt(residual @ residual / max(rows - rank, 1)))
    covariance = (vh.T * inverse**2) @ vh / scale[:, None] / scale * sigma**2
    condition = float(s[0] / s[-1]) if s[-1] > 0 else float("inf")
    return LeastSquares(theta, covariance, s, condition, rank, sigma, residual)
