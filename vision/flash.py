"""Flashes in a film: a lamp that lights the picture for one frame or a few. Told by how bright the whole picture is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..geometry.camera import Array
from ..geometry.cameras.flash import Lit
from ..geometry.robust import robust_sd
from .recording import Frame
from .recording.beat import on_beat

THINNED = 4
"""Every so-manieth row and column is looked at: a lamp lights far more than one pixel."""
LONGEST_S, BASE_S = 0.5, 1.0
"""What lasts longer is a lamp that was switched on, or a camera that found another exposure. How bright it is without is told from
so long before to so long after, but for what lies nearer than the former."""
LEAST_NOISE = 1e-5
"""Of a picture's brightness, as a share of white: of films without any noise."""
SURE_SD, LEAST_SHARE = 8.0, 0.01
"""A frame is lit when it is brighter by so many standard deviations, and by this share of what it is without: choices, far
beyond what a wave's glitter does to a whole picture."""


def brightness(frames: Iterable[Frame]) -> tuple[Array, Array]:
    """Times (n,) and how bright the picture is on average (n,), as a share of white.

    Parameters
    ----------
    frames : of a film; damaged ones are left out
    """
    found = [(f.t_s, light(f), f.damaged, f.on_arrival) for f in frames]
    t_s, level, damaged, on_arrival = np.array(found, dtype=float).reshape(-1, 4).T
    if on_arrival.any():
        t_s = on_beat(t_s).t_s
    return t_s[damaged == 0], level[damaged == 0]


def light(frame: Frame) -> float:
    """How bright a picture is on average, as a share of white.

    Parameters
    ----------
    frame : as decoded
    """
    return float(frame.luma[::THINNED, ::THINNED].mean()) / frame.white_dn


def flashes(t_s: Array, level: Array, exposure_s: float = 0.0) -> list[Lit]:
    """The flashes of a film, in their order.

    Parameters
    ----------
    t_s, level : of ``brightness``
    exposure_s : of a frame; 0: not known
    """
    if len(t_s) < 5:
        return []
    step_s = float(np.median(np.diff(t_s)))
    half, near = max(4, round(BASE_S / step_s)), max(2, round(LONGEST_S / step_s))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(level, half, mode="edge"), 2 * half + 1)
    # before and after, so that what changes slowly is no flash
    without = (np.median(around[:, : half - near], axis=1) + np.median(around[:, half + near + 1 :], axis=1)) / 2
    rise = level - without
    noise = max(robust_sd(rise), robust_sd(np.diff(level)) / np.sqrt(2), LEAST_NOISE)
    lit = rise > np.maximum(SURE_SD * noise, LEAST_SHARE * without)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lit, [False]]).astype(int)))
    found = []
    for begin, end in edges.reshape(-1, 2):
        whole = begin > 0 and end < len(lit) and (end - begin) * step_s <= LONGEST_S
        if whole and np.diff(t_s[begin - 1 : end + 1]).max() < 1.5 * step_s:
            rows = slice(begin - 1, end + 1)
            found.append(Lit(t_s[rows], rise[rows], noise, step_s, exposure_s))
    return found


__all__ = ["brightness", "flashes", "light"]
