"""The windows of one mark over some frames, and smaller ones cut from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .candidates import Array


@dataclass(frozen=True)
class Stack:
    """One mark's windows over some frames.

    Attributes
    ----------
    values : (b, s, s) uint8, zero beyond the picture
    corner : (b, 2) int, picture pixel of each window's first pixel
    start_px : (b, 2), where the spot was seen
    size_px : (w, h) of the picture
    """

    values: NDArray[np.uint8]
    corner: Array
    start_px: Array
    size_px: tuple[int, int]

    def __len__(self) -> int:
        return len(self.values)

    def rows(self, index) -> Stack:
        """Some of the frames."""
        return Stack(self.values[index], self.corner[index], self.start_px[index], self.size_px)

    def cut(self, centre_px: Array, radius: int) -> tuple[Array, Array]:
        """Windows ``(b, n, n)`` about ``centre_px``, NaN beyond the picture or the stored window; and their corners."""
        corner = np.rint(centre_px).astype(int) - radius
        axis = np.arange(2 * radius + 1)
        u, v = corner[:, :1] + axis, corner[:, 1:] + axis
        a, b = u - self.corner[:, :1], v - self.corner[:, 1:]
        side = self.values.shape[1]
        inside_u = (a >= 0) & (a < side) & (u >= 0) & (u < self.size_px[0])
        inside_v = (b >= 0) & (b < side) & (v >= 0) & (v < self.size_px[1])
        rows = np.arange(len(self.values))[:, None, None]
        taken = self.values[rows, np.clip(b, 0, side - 1)[:, :, None], np.clip(a, 0, side - 1)[:, None, :]].astype(
            float
        )
        inside = inside_v[:, :, None] & inside_u[:, None, :]
        if not inside.all():
            taken[~inside] = np.nan
        return taken, corner.astype(float)
