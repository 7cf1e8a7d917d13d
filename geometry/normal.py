"""Normal equations whose numbers differ by many powers of ten in size."""

from __future__ import annotations

import numpy as np

from .camera import Array

SMALLEST_SHARE = 1e-13
"""A direction that is told less than this share of the best told one counts as not told."""

NOTHING = 1e-200
"""A diagonal element below this is 0."""


def root_of_covariance(covariance: Array) -> Array:
    """A root R of a covariance (p, p): R R^T is it. Numbers may be known to very different shares of their size.

    What rounding has made of a direction that is known to many digits more than the others (a variance below 0) counts as none.

    Parameters
    ----------
    covariance : (p, p)

    Examples
    --------
    >>> root = root_of_covariance(np.array([[4.0, 2e-9], [2e-9, 1e-18]]))
    >>> np.allclose(root @ root.T, [[4.0, 2e-9], [2e-9, 1e-18]])
    True
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), NOTHING))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def inverse_of_normal(matrix: Array) -> Array:
    """Inverse of a normal matrix (p, p), scaled to a unit diagonal on the way; directions that are not told get 0."""
    told = np.diag(matrix)
    scale = np.where(told > NOTHING, 1 / np.sqrt(np.maximum(told, NOTHING)), 0.0)
    both = np.outer(scale, scale)
    return np.linalg.pinv(matrix * both, rcond=SMALLEST_SHARE, hermitian=True) * both
