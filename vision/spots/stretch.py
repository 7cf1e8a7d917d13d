"""Some frames that are fitted together: the windows that were kept of them, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .candidates import Array
from .live import Filter, LiveMark
from .refine import Refiner
from .stack import Stack

CORE = 3
"""The inner part of a window, by which a picture is known again: its half size over this."""
GROUND_COLUMNS = "ground_u_px2", "ground_v_px2"
LIMIT_COLUMN = "largest_sigma_px"
"""Of the table: variance that an uneven ground adds to u and v; ``scatter`` puts it into the sigmas."""
Window = tuple[NDArray[np.uint8], tuple[int, int]]
"""Pixels, and the corner (u, v) where they were cut."""


class Mark:
    """One marker while it is followed; ``sigma_px`` is what its place was known to where it was seen last, NaN before."""

    def __init__(self, live: LiveMark, refiner: Refiner) -> None:
        self.live, self.refiner = live, refiner
        self.replay = live.filter.copy()
        self.brightness_dn = live.rise_dn
        self.sigma_px = float("nan")
        self.lost = 0

    @property
    def height_dn(self) -> float:
        """Its usual height over its ground, negative where it is darker."""
        return -self.brightness_dn if self.live.dark else self.brightness_dn

    def began(self, places_px: list[Array], t_s: list[float]) -> None:
        """It was seen in some frames before its filters begin: they know its rate from the last two."""
        self.replay = Filter(places_px[0], t_s[0])
        self.replay.began(places_px[1], t_s[1])
        self.live.filter = Filter(places_px[-2], t_s[-2])
        self.live.filter.began(places_px[-1], t_s[-1])
        self.live.filter.update(float(places_px[-1][0]), float(places_px[-1][1]), t_s[-1])


class Stretch:
    """Windows of all markers over some frames, in arrays of fixed size."""

    def __init__(self, markers: int) -> None:
        self.markers = markers
        self.frames: list[tuple[int, float, bool]] = []
        self.windows: list[list[tuple[int, NDArray[np.uint8], tuple[int, int], tuple[float, float], bool]]] = [
            [] for _ in range(markers)
        ]
        self.last: list[tuple[int, Window] | None] = [None] * markers

    def __len__(self) -> int:
        return len(self.frames)

    def clear(self) -> None:
        """Begin the next one."""
        self.frames = []
        self.windows = [[] for _ in range(self.markers)]

    def keep(self, marker: int, luma: NDArray[np.uint8], u: float, v: float, half: int) -> None:
        """Store one marker's window about ``u, v`` for the frame added last."""
        height, width = luma.shape
        u0, v0, side = round(u) - half, round(v) - half, 2 * half + 1
        if u0 >= 0 and v0 >= 0 and u0 + side <= width and v0 + side <= height:
            cut = luma[v0 : v0 + side, u0 : u0 + side].copy()
        else:
            cut = np.zeros((side, side), np.uint8)
            a, b = slice(max(u0, 0), min(u0 + side, width)), slice(max(v0, 0), min(v0 + side, height))
            if a.stop > a.start and b.stop > b.start:
                cut[b.start - v0 : b.stop - v0, a.start - u0 : a.stop - u0] = luma[b, a]
        frame, last, window = self.frames[-1][0], self.last[marker], (cut, (u0, v0))
        repeated = last is not None and last[0] == frame - 1 and _same(last[1], window)
        self.windows[marker].append((len(self.frames) - 1, *window, (u, v), repeated))
        self.last[marker] = frame, window

    def stack(self, marker: int, size_px: tuple[int, int]) -> tuple[NDArray[np.int64], Stack, NDArray[np.bool_]] | None:
        """The stored windows of one marker: their frames, the windows, which show what the frame before does, to the pixel."""
        kept = self.windows[marker]
        if not kept:
            return None
        rows, cuts, corners, starts, repeated = zip(*kept, strict=True)
        stack = Stack(np.stack(cuts), np.array(corners), np.array(starts), size_px)
        return np.array(rows), stack, np.array(repeated)


def _same(one: Window, other: Window) -> bool:
    """Two windows show the same about the second one's middle, to the pixel."""
    (before, (u_0, v_0)), (cut, (u, v)) = one, other
    du, dv, half = u - u_0, v - v_0, len(cut) // 2
    low, high = half - half // CORE, half + half // CORE + 1
    if before.shape != cut.shape or max(abs(du), abs(dv)) > low:
        return False
    return bool(np.array_equal(cut[low:high, low:high], before[low + dv : high + dv, low + du : high + du]))


@dataclass
class Found:
    """What a stretch gave, (markers, frames).

    Attributes
    ----------
    place, sigma : of each
    reason : why a place is missing ("" = measured)
    repeated : the picture about the mark is the frame's before, to the pixel
    ground_px2 : (markers, 2), variance that an uneven ground adds to each
    largest_sigma_px : (markers,), a place known less well than this, the ground's part included, is none
    """

    place: Array
    sigma: Array
    reason: NDArray[np.object_]
    brightness: Array
    repeated: NDArray[np.bool_]
    frames: list[tuple[int, float, bool]]
    ground_px2: Array
    largest_sigma_px: Array

    def forget_missing(self) -> int:
        """No place where there is a reason; how many there are."""
        missing = self.reason != ""
        self.place[missing] = np.nan
        self.sigma[missing] = np.nan
        return int(missing.sum())

    def both(self, i: int, j: int) -> NDArray[np.int64]:
        """Frames in which two markers were measured."""
        return np.flatnonzero((self.reason[i] == "") & (self.reason[j] == ""))


def table_of(done: list[Found], names: list[str]) -> pd.DataFrame:
    """Rows of tracks.csv, with the reasons, of all stretches.

    Parameters
    ----------
    done : the stretches
    names : of the markers
    """
    count = len(names)
    place = np.concatenate([f.place for f in done], axis=1).swapaxes(0, 1).reshape(-1, 2)
    sigma = np.concatenate([f.sigma for f in done], axis=1).swapaxes(0, 1).reshape(-1, 2)
    reason = np.concatenate([f.reason for f in done], axis=1).T.ravel()
    repeated = np.concatenate([f.repeated for f in done], axis=1).T.ravel()
    ground = np.concatenate([np.repeat(f.ground_px2[None], len(f.frames), axis=0) for f in done]).reshape(-1, 2)
    limit = np.concatenate([np.repeat(f.largest_sigma_px[None], len(f.frames), axis=0) for f in done]).ravel()
    index = np.concatenate([[i for i, _, _ in f.frames] for f in done])
    t_s = np.concatenate([[t for _, t, _ in f.frames] for f in done])
    return pd.DataFrame(
        {
            "frame": np.repeat(index, count),
            "t_s": np.repeat(t_s, count),
            "marker": np.tile(np.array(names, dtype=object), len(index)),
            "u_px": place[:, 0],
            "v_px": place[:, 1],
            "sigma_u_px": sigma[:, 0],
            "sigma_v_px": sigma[:, 1],
            "status": np.where(reason == "", "measured", "lost"),
            "reason": reason,
            "repeated": (repeated & (reason == "")).astype(int),
            GROUND_COLUMNS[0]: ground[:, 0],
            GROUND_COLUMNS[1]: ground[:, 1],
            LIMIT_COLUMN: limit,
        }
    )
