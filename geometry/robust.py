"""Spread that a few wild values do not move."""

from __future__ import annotations

import numpy as np

from .camera import Array

MAD_TO_SD = 1.4826
"""Standard deviation over the median absolute deviation from the median, of a normal distribution."""


def robust_sd(values: Array) -> float:
    """Standard deviation of what most of the values are.

    Parameters
    ----------
    values : of any shape

    Examples
    --------
    >>> robust_sd(np.array([1.0, 2.0, 3.0, 4.0, 1e9]))
    1.4826
    """
    return MAD_TO_SD * float(np.median(np.abs(values - np.median(values))))


__all__ = ["MAD_TO_SD", "robust_sd"]
