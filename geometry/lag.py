"""How a codec holds a mark back behind its motion: errors that go with the way and the speed, shared by the runs of a camera.

A codec that makes a picture from the one before moves a slow mark too little and mends it later: like a gear with play. How far
a mark then lags depends on the codec, its settings, the mark's light, its speed and the codec's blocks, and is a number for none
of them beforehand; but it is the same number whenever all that is the same again. So the lag is

    play(path) (a(speed) + b(speed) over a seam along u + c(speed) along v + d(speed) over both) + e way since its own last picture

with a to d piecewise linear; their values at a few speeds are common modes, as a camera's errors are. Along u and v they are the
same functions of the speed along each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .camera import Array

SPEEDS_PX = (0.02, 0.035, 0.065, 0.1, 0.16, 0.22, 0.27, 0.34, 0.45)
"""Speeds, px a frame, at which the lag is a mode of its own. H.264 moves blocks by quarters of a pixel, so that a mark of 0.22 px
a frame is moved too far and one of 0.27 px not far enough."""
SEAM_SPEEDS_PX = (0.04, 0.12, 0.25)
"""The same for the lag on top over a seam, in fewer steps: a choice."""
BLOCK_PX = 16
"""A codec decides block by block, in H.264 of so many pixels; a mark that lies over the seam of two lags further."""
SEAM_PX = (2.5, 4.0)
"""A mark this near to a seam lies over it, beyond the second it does not."""
SEAM_SHARE = 0.4
"""How far it may lag on top, over what it may elsewhere: 0.2 to 0.5 in pictures by x264."""
PLAY_SHARE = 0.7
"""The play's half width over the mark's scatter: 0.4 to 1 in pictures by x264."""
OF_A_MARK = len(SPEEDS_PX) + 3 * len(SEAM_SPEEDS_PX) + 1
"""Modes of each mark: its lag by speed, over seams along u, v and both, and the way since its own last picture."""
RATE_S = 0.3
"""The rate of a mark is read from places so long before and after."""


def mark_rate(t_s: Array, path_px: Array, at_s: Array) -> Array:
    """Rate (k,) px/s of a coordinate ``path_px (n,)`` of a mark, measured at ``t_s``, about the times ``at_s (k,)``.

    Parameters
    ----------
    t_s : (n,) times of the path, s
    path_px : (n,) one coordinate of the mark
    at_s : (k,) times that are asked for, s
    """
    early, late = (np.clip(at_s + by, t_s[0], t_s[-1]) for by in (-RATE_S, RATE_S))
    way = np.interp(late, t_s, path_px) - np.interp(early, t_s, path_px)
    return np.divide(way, late - early, out=np.zeros_like(way), where=late > early)


def smooth_path(t_s: Array, path_px: Array) -> Array:
    """A mark's path (n,) without the scatter of its pixels: means over 2 RATE_S, over as many places before as after.

    Parameters
    ----------
    t_s : (n,) times, rising
    path_px : (n,) one coordinate of the mark
    """
    at = np.arange(len(t_s))
    first, last = np.searchsorted(t_s, t_s - RATE_S), np.searchsorted(t_s, t_s + RATE_S, side="right")
    half = np.minimum(at - first, last - 1 - at)
    total = np.concatenate([[0.0], np.cumsum(path_px - path_px[0])])
    return path_px[0] + (total[at + half + 1] - total[at - half]) / (2 * half + 1)


def lag_modes(frames: Array, t_s: Array, pixel_px: Array, sigma_px: Array, repeated: NDArray[np.bool_]) -> Array:
    """Change of the marks' pixels (k, n, m, 2) with each mode of unit variance; k = 0 where no mark can lag.

    Parameters
    ----------
    frames, t_s : (n,), numbers and times, rising; numbers may be left out
    pixel_px : (n, m, 2), NaN where not measured
    sigma_px : (m,), how far the lag of a mark may be (standard deviation) at each of the speeds; 0: it cannot lag
    repeated : (n, m), the picture about a mark is the one of the frame before
    """
    n, m = pixel_px.shape[:2]
    if not (sigma_px > 0).any() or n < 2:
        return np.zeros((0, n, m, 2))
    interval_s = float(np.median(np.diff(t_s) / np.diff(frames)))
    modes = np.zeros((m, OF_A_MARK, n, m, 2))
    for index, sigma in enumerate(sigma_px):
        seen = np.isfinite(pixel_px[:, index]).all(axis=1)
        if not sigma > 0 or seen.sum() < 2:
            continue
        times, places = t_s[seen], pixel_px[seen, index]
        shares = _shares(np.abs([mark_rate(times, path, times) for path in places.T]) * interval_s, places)
        last = _last_own(repeated[seen, index])
        for axis in (0, 1):
            path = smooth_path(times, places[:, axis])
            modes[index, :-1, seen, index, axis] = (-sigma * _taken_up(path, PLAY_SHARE * sigma) * shares[axis]).T
            modes[index, -1, seen, index, axis] = path[last] - path
    return modes.reshape(-1, n, m, 2)


def _shares(speed_px: Array, place_px: Array) -> Array:
    """(2, k, n): how much of each mode there is at speeds ``(2, n)`` along u and v, px a frame, and at places ``(n, 2)``."""
    off = np.abs((place_px + 0.5 + BLOCK_PX / 2) % BLOCK_PX - BLOCK_PX / 2)
    over_u, over_v = np.interp(off, SEAM_PX, (1.0, 0.0)).T
    found = []
    for speed in speed_px:
        seams = SEAM_SHARE * _hats(speed, SEAM_SPEEDS_PX)
        found.append(np.concatenate([_hats(speed, SPEEDS_PX), seams * over_u, seams * over_v, seams * over_u * over_v]))
    return np.array(found)


def _hats(speed_px: Array, at_px: tuple[float, ...]) -> Array:
    """(k, n): 1 at each of the speeds, falling to 0 at its neighbours; the first and the last hold beyond."""
    return np.array([np.interp(speed_px, at_px, hat) for hat in np.eye(len(at_px))])


def _taken_up(path_px: Array, play_px: float) -> Array:
    """(n,) -1 to 1: how much of the play is taken up, and to which side, when ``path_px (n,)`` moves something by it."""
    answer, ahead = np.zeros(len(path_px)), 0.0
    for k, step in enumerate(np.diff(path_px).tolist(), 1):
        ahead = min(max(ahead + step, -play_px), play_px)
        answer[k] = ahead
    return answer / play_px


def _last_own(repeated: NDArray[np.bool_]) -> NDArray[np.int_]:
    """(n,) where the last picture is that is not the one of the frame before it."""
    at = np.arange(len(repeated))
    return np.maximum.accumulate(np.where(repeated, 0, at))


__all__ = ["OF_A_MARK", "lag_modes", "mark_rate", "smooth_path"]
