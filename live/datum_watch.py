"""Whether the camera stands still: what is seen about the datum points against what was seen there in the first second.

What the model or its wake hides is left out; a turn of the camera moves all that is left by one and the same turn
(``geometry.shake``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Array
from ..geometry.mapping import ProjectiveMapping
from ..geometry.shake import LEAST_POINTS, StillView
from ..record.schema import DatumPoint
from ..vision import Frame
from ..vision.spots.live import vertex

HALF_PX, REACH_PX = 8, 14
"""Half the side of the patch about a point, and how far from where it was it is looked for: choices; a turn beyond is seen as
points that are gone."""
EVERY = 3
"""Frames from one look to the next: ten looks a second of usual film."""
LEARN_LOOKS = 10
"""Looks by which a point's patch is learnt, and then as many by which its scatter is."""
LEARNT_FRAMES = EVERY * 2 * LEARN_LOOKS
"""Frames after which it is known how each point looks and scatters."""
LIKE = 0.7
"""Correlation with its patch below which a point is hidden: a choice."""
LEAST_TEXTURE_DN = 4.0
"""Standard deviation of a patch below which nothing stands there to be known again: a choice, twice usual noise."""
LEAST_SIGMA_PX = 0.05
"""What a place by correlation is known to at best: a choice; interpolating between pixels errs by about as much."""


@dataclass(frozen=True)
class Turn:
    """The camera in one look.

    Attributes
    ----------
    angle_rad, sd_rad : its turn against the first second, and the standard deviation of each of its three components
    shift_px : median way of the points
    points, of : so many were seen, of so many that can be
    """

    angle_rad: float
    sd_rad: float
    shift_px: float
    points: int
    of: int


class DatumWatch:
    """Looks at the datum points every few frames.

    Parameters
    ----------
    points : of run.toml
    mapping : of the datum
    """

    def __init__(self, points: Sequence[DatumPoint], mapping: ProjectiveMapping) -> None:
        self._points, self._view = list(points), StillView(points, mapping)
        self._places = np.array([point.pixel_px for point in self._points], dtype=float).reshape(-1, 2)
        self._picked = np.rint([point.pixel_px for point in self._points]).astype(int).reshape(-1, 2)
        self._sums: list[list[NDArray[np.float32]]] = [[] for _ in self._points]
        self._patches: list[NDArray[np.float32] | None] | None = None
        self._first: list[list[Array]] = [[] for _ in self._points]
        self._rest: Array | None = None
        self._sigma: Array = np.zeros((0, 2))
        self._frames = self._looks = 0

    def step(self, frame: Frame) -> Turn | None:
        """Take a frame; the camera's turn where it is looked at, and once the first looks are over."""
        self._frames += 1
        if (self._frames - 1) % EVERY:
            return None
        if self._patches is None:
            self._learn(frame.luma)
            return None
        places = np.array([self._find(k, frame.luma) for k in range(len(self._points))]).reshape(-1, 2)
        if self._rest is None:
            self._settle(places)
            return None
        return self._turn(places)

    @property
    def known(self) -> int:
        """Points that can be known again."""
        return sum(patch is not None for patch in self._patches or [])

    def _cut(self, k: int, luma: NDArray[np.uint8], half: int) -> NDArray[np.float32] | None:
        u, v = self._picked[k]
        rows, columns = luma.shape
        if not (half <= u < columns - half and half <= v < rows - half):
            return None
        return luma[v - half : v + half + 1, u - half : u + half + 1].astype(np.float32)

    def _learn(self, luma: NDArray[np.uint8]) -> None:
        for k, seen in enumerate(self._sums):
            cut = self._cut(k, luma, HALF_PX)
            if cut is not None:
                seen.append(cut)
        self._looks += 1
        if self._looks == LEARN_LOOKS:
            means = [np.mean(seen, axis=0) if len(seen) == LEARN_LOOKS else None for seen in self._sums]
            self._patches = [m if m is not None and m.std() > LEAST_TEXTURE_DN else None for m in means]
            self._sums = []

    def _find(self, k: int, luma: NDArray[np.uint8]) -> Array:
        """Where a point is against its pick, px; NaN where it is hidden."""
        import cv2

        assert self._patches is not None
        patch, about = self._patches[k], self._cut(k, luma, HALF_PX + REACH_PX)
        if patch is None or about is None:
            return np.full(2, np.nan)
        like = cv2.matchTemplate(about, patch, cv2.TM_CCOEFF_NORMED)
        _, most, _, (column, row) = cv2.minMaxLoc(like)
        if most < LIKE or not (0 < column < 2 * REACH_PX and 0 < row < 2 * REACH_PX):
            return np.full(2, np.nan)
        off = vertex(like[row, column - 1 : column + 2]), vertex(like[row - 1 : row + 2, column])
        return np.array([column + off[0], row + off[1]]) - REACH_PX

    def _settle(self, places: Array) -> None:
        for seen, place in zip(self._first, places, strict=True):
            if np.isfinite(place).all():
                seen.append(place)
        self._looks += 1
        if self._looks < 2 * LEARN_LOOKS:
            return
        whole = [len(seen) > LEARN_LOOKS // 2 for seen in self._first]
        self._rest = np.array(
            [np.median(seen, axis=0) if good else [np.nan] * 2 for seen, good in zip(self._first, whole, strict=True)]
        )
        sigma = [np.std(seen, axis=0) if good else [np.nan] * 2 for seen, good in zip(self._first, whole, strict=True)]
        self._sigma = np.maximum(np.array(sigma), LEAST_SIGMA_PX)

    def _turn(self, places: Array) -> Turn | None:
        assert self._rest is not None
        moved = places - self._rest
        seen = np.isfinite(moved).all(axis=1)
        able = int(np.isfinite(self._rest).all(axis=1).sum())
        if able < LEAST_POINTS:
            return None
        if seen.sum() < LEAST_POINTS:
            return Turn(np.nan, np.nan, np.nan, int(seen.sum()), able)
        # one point that something else has covered must not turn the camera
        middle = np.median(moved[seen], axis=0)
        off = np.abs(moved - middle).max(axis=1)
        seen &= off < max(3 * float(np.median(off[seen])), 1.0)
        if seen.sum() < LEAST_POINTS:
            return Turn(np.nan, np.nan, np.nan, int(seen.sum()), able)
        shake = self._view.turn(np.flatnonzero(seen), self._places[seen] + moved[seen], self._sigma[seen])
        spread = float(np.sqrt(np.trace(shake.covariance[0]) / 3))
        angle = float(np.linalg.norm(shake.turn_rad[0]))
        return Turn(angle, spread, float(np.median(np.linalg.norm(moved[seen], axis=1))), int(seen.sum()), able)


__all__ = ["EVERY", "LEARNT_FRAMES", "DatumWatch", "Turn"]
