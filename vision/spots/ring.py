"""How much a place stands out of what lies around it, on any ground: the spot against a ring about it.

A mark is brighter (a dark one darker) than its surroundings in every direction but a few. The rim of a light plate, a line of print
or the ground beside a puck is not, however strong it is: there a run of neighbouring directions is as bright as the place itself.
So the answer at a place is its smoothed value less the highest level that three neighbouring directions of the ring reach together:
a lamp on one side does not hide a mark, and a rim does not look like one.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

RING_WIDTHS = 2.2
"""Radius of the ring in widths (standard deviations): a Gaussian has fallen to 9 %, a disc has ended 1.0 before, the rim of a plate
of three diameters is 1.3 away."""
SMOOTH_WIDTHS = 0.6
"""Smoothing before the comparison, in widths: a choice; twice it would fill the ring from the mark itself."""
DIRECTIONS = 8
"""On the ring."""
SMALL_PIXELS = 1600
"""A picture with fewer is compared in all directions at once: a choice, for its cost."""
BAND_ROWS = 48
"""A larger one by so many rows at a time, which a processor's cache holds: a choice, for time."""
LEAST_SMOOTH_PX = 0.55
"""Below it a picture's own sampling does as much."""


def stands_out(picture: Array, width_px: float) -> tuple[Array, int]:
    """By how much each place of ``picture (h, w)`` is brighter than the ring about it, and the rim in which that is not known.

    Parameters
    ----------
    picture : (h, w) float32 grey values; negate it for dark marks
    width_px : standard deviation of the mark looked for

    Returns
    -------
    rise : (h - 2 rim, w - 2 rim)
    rim : px
    """
    import cv2

    smooth = cv2.GaussianBlur(picture, (0, 0), smoothing_px(width_px), borderType=cv2.BORDER_REPLICATE)
    return rise_of(smooth, width_px)


def smoothing_px(width_px: float) -> float:
    """Standard deviation of the smoothing for marks of a width."""
    return max(LEAST_SMOOTH_PX, SMOOTH_WIDTHS * width_px)


def rise_of(smooth: Array, width_px: float) -> tuple[Array, int]:
    """The same of a picture that is smoothed already."""
    places, rim = _ring(round(float(width_px), 2))
    h, w = smooth.shape[0] - 2 * rim, smooth.shape[1] - 2 * rim
    if h <= 0 or w <= 0:
        return np.zeros((max(h, 0), max(w, 0)), np.float32), rim
    if h * w < SMALL_PIXELS:  # all directions at once: the calls cost more than their work
        ring = smooth.ravel()[_directions(places, rim, smooth.shape)]
        pairs = np.minimum(ring[:-1], ring[1:])
        highest = np.minimum(pairs[:-1], pairs[1:]).max(axis=0).reshape(h, w)
        return smooth[rim : rim + h, rim : rim + w] - highest, rim
    rise = np.empty((h, w), smooth.dtype)
    for top in range(0, h, BAND_ROWS):
        band = slice(top, min(top + BAND_ROWS, h))
        _rise_in(smooth[band.start : band.stop + 2 * rim], places, rim, rise[band])
    return rise, rim


def _rise_in(smooth: Array, places: tuple[tuple[int, int], ...], rim: int, rise: Array) -> None:
    """Fill some rows of the answer; ``smooth`` has ``rim`` rows more on either side."""
    h, w = rise.shape
    around = [smooth[rim + dv : rim + dv + h, rim + du : rim + du + w] for du, dv in places]
    three, highest = np.empty_like(rise), np.full_like(rise, -np.inf)
    for k in range(DIRECTIONS):
        np.minimum(around[k - 1], around[k], out=three)
        np.minimum(three, around[(k + 1) % DIRECTIONS], out=three)
        np.maximum(highest, three, out=highest)
    np.subtract(smooth[rim : rim + h, rim : rim + w], highest, out=rise)


@lru_cache(maxsize=64)
def _directions(places: tuple[tuple[int, int], ...], rim: int, shape: tuple[int, int]) -> NDArray[np.intp]:
    """(directions + 2, pixels) which pixels of a flat picture lie in each direction of its inner ones; two again at the end."""
    rows, columns = np.arange(rim, shape[0] - rim), np.arange(rim, shape[1] - rim)
    inner = rows[:, None] * shape[1] + columns
    return np.stack([(inner + dv * shape[1] + du).ravel() for du, dv in (*places, *places[:2])])


@lru_cache(maxsize=64)
def _ring(width_px: float) -> tuple[tuple[tuple[int, int], ...], int]:
    reach = max(2.0, RING_WIDTHS * width_px)
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    places = tuple((round(reach * np.cos(a)), round(reach * np.sin(a))) for a in angles)
    return places, round(reach)
