"""What a course is, and how fast it goes, at any time: a polynomial through what was measured within reach of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .camera import Array

AT_ONCE = 4096
"""So many polynomials are fitted at once: an hour's would fill the memory."""
ROUNDING_S = 1e-9
"""Times a whole number of frames apart are so far from that in floating point."""
LEAST_SPREAD = 0.5
"""The measured times lie apart by more than this share of the reach, or they carry no polynomial: a choice."""


def local_fit(
    t_s: Array, values: Array, at_s: Array, reach_s: float, degree: int, without_s: float = -1.0
) -> tuple[Array, NDArray[np.bool_]]:
    """Coefficients (k, degree + 1, d) of ((t - at) / reach) to the powers 0, 1, .. about each time, and (k,) where they are told.

    Parameters
    ----------
    t_s : (n,) times, rising
    values : (n, d), finite
    at_s : (k,) times that are asked for
    reach_s : what was measured so long before and after counts alike ...
    degree : of the polynomial
    without_s : ... but for what lies as near as this (negative: nothing is left out)

    Examples
    --------
    >>> t_s = np.arange(0.0, 1.0, 0.1)
    >>> found, told = local_fit(t_s, 2.0 * t_s[:, None], np.array([0.5]), 0.25, 1)
    >>> found[0, :, 0].round(12) / [1.0, 0.25], told
    (array([1., 2.]), array([ True]))
    """
    found = np.zeros((len(at_s), degree + 1, values.shape[1]))
    told = np.zeros(len(at_s), dtype=bool)
    for k in range(0, len(at_s), AT_ONCE):
        some = slice(k, k + AT_ONCE)
        found[some], told[some] = _fitted(t_s, values, at_s[some], reach_s, degree, without_s)
    return found, told


def _fitted(
    t_s: Array, values: Array, at_s: Array, reach_s: float, degree: int, without_s: float
) -> tuple[Array, NDArray[np.bool_]]:
    first = np.searchsorted(t_s, at_s - reach_s - ROUNDING_S)
    last = np.searchsorted(t_s, at_s + reach_s + ROUNDING_S, side="right")
    at = first[:, None] + np.arange(max(int((last - first).max(initial=0)), 1))
    here = at < last[:, None]
    at = np.minimum(at, max(len(t_s) - 1, 0))
    away_s = t_s[at] - at_s[:, None] if len(t_s) else np.zeros(at.shape)
    here &= np.abs(away_s) > without_s + ROUNDING_S
    away = np.where(here, away_s / reach_s, 0.0)
    spread = np.where(here, away, -np.inf).max(axis=1) - np.where(here, away, np.inf).min(axis=1)
    told = (here.sum(axis=1) > degree) & (spread > LEAST_SPREAD)
    powers = (away[..., None] ** np.arange(degree + 1) * here[..., None])[told]
    found = np.zeros((len(at_s), degree + 1, values.shape[1]))
    across = powers.transpose(0, 2, 1)
    found[told] = np.linalg.solve(across @ powers, across @ values[at[told]])
    return found, told


__all__ = ["local_fit"]
