"""A second light beside a mark, its reflection or a lamp: where it may stand, and which of two spots is the mark."""

from __future__ import annotations

import numpy as np

from .candidates import Array
from .model import HEIGHT, HEIGHT_2, P_UU, P_VV, Q_UU, Q_VV, U_2, V_2, U, V, expected, start_of, width_of

LEAST_WIDTHS = 1.5
"""A reflection is not nearer to its mark than this many of the mark's widths: a choice."""
MOST_WIDTHS, MOST_BESIDE_PX = 4.5, 2.0
"""... and is looked for as far as so many widths and so many pixels beside: choices."""
AROUND_WIDTHS = 1.6, 3.2
"""How far from a mark its reflection is tried in a stretch's mean picture, in widths ..."""
DIRECTIONS = 8
"""... and in so many directions: choices."""


def lights_around(mean: Array, at_px: Array, width_px: float, dark: bool) -> Array:
    """Starts of a fit of mark and reflection, one for each place that is tried.

    Parameters
    ----------
    mean : (1, n, n), the mean picture of the mark
    at_px : (1, 2), the mark in it
    width_px, dark : of the mark
    """
    turns = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    around = [(r * width_px * np.cos(a), r * width_px * np.sin(a)) for r in AROUND_WIDTHS for a in turns]
    start = np.repeat(start_of(mean, at_px, np.array([0.85 * width_px]), dark), len(around), axis=0)
    start[:, HEIGHT_2] = 0.3 * start[:, HEIGHT]
    start[:, U_2 : V_2 + 1] = start[:, U : V + 1] + np.array(around)
    start[:, Q_UU] = start[:, Q_VV] = 0.4 / width_px**2
    return start


def with_second_light(theta: Array, values: Array, corner: Array, width_px: float, dark: bool) -> Array:
    """Marks and a second light each, where the most is left over beside the mark.

    Parameters
    ----------
    theta : the marks alone
    values, corner : windows (b, n, n) and their corners (b, 2)
    width_px, dark : of the mark
    """
    theta, size = theta.copy(), values.shape[2]
    sign = -1.0 if dark else 1.0
    rest = np.nan_to_num(sign * (values - expected(theta, corner, size)[0]), nan=-np.inf)
    axis = np.arange(size)
    away = (axis - (theta[:, U] - corner[:, 0])[:, None])[:, None, :] ** 2
    away = away + ((axis - (theta[:, V] - corner[:, 1])[:, None]) ** 2)[:, :, None]
    rest[away < (LEAST_WIDTHS * width_px) ** 2] = -np.inf
    rest[away > (MOST_WIDTHS * width_px + MOST_BESIDE_PX) ** 2] = -np.inf
    flat = rest.reshape(len(rest), -1)
    top = flat.argmax(axis=1)
    theta[:, HEIGHT_2] = sign * np.maximum(flat[np.arange(len(flat)), top], 1.0)
    theta[:, U_2], theta[:, V_2] = corner[:, 0] + top % size, corner[:, 1] + top // size
    theta[:, Q_UU : Q_VV + 1] = theta[:, P_UU : P_VV + 1]
    return theta


def mark_first(theta: Array) -> Array:
    """Let the brighter (nearly as bright: the narrower) of the two spots be the mark."""
    swapped = exchanged(theta)
    with np.errstate(invalid="ignore", divide="ignore"):
        score = np.log(np.abs(theta[:, HEIGHT_2] / theta[:, HEIGHT])) - np.log(width_of(swapped) / width_of(theta))
    return np.where((score > 0)[:, None], swapped, theta)


def exchanged(theta: Array) -> Array:
    """The two spots' parameters in each other's place."""
    answer = theta.copy()
    for one, other in ((HEIGHT, HEIGHT_2), (U, U_2), (V, V_2), (P_UU, Q_UU), (P_UU + 1, Q_UU + 1), (P_VV, Q_VV)):
        answer[:, one], answer[:, other] = theta[:, other], theta[:, one]
    return answer
