"""Normal equations whose numbers differ by many powers of ten in size."""

from __future__ import annotations

import numpy as np

from .camera import Array

SMALLEST_SHARE = 1e-13
"""A direction that is told less than this share of the best told one counts as not told."""

NOTHING = 1e-200
"""A diagonal element below this is 0."""


def inverse_of_normal(matrix: Array) -> Array:
    """Inverse of a normal matrix (p, p), scaled to a unit diagonal on the way; directions that are not told get 0."""
    told = np.diag(matrix)
    scale = np.where(told > NOTHING, 1 / np.sqrt(np.maximum(told, NOTHING)), 0.0)
    both = np.outer(scale, scale)
    return np.linalg.pinv(matrix * both, rcond=SMALLEST_SHARE, hermitian=True) * both
