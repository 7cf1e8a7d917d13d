"""How a program counts pixels, and the way to towline's: u right, v down, integers at pixel centres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Convention:
    """How a program counts pixels.

    Attributes
    ----------
    first_pixel : the coordinate that it gives to the middle of the first pixel: 0 (OpenCV, numpy), 0.5 (the picture's corner is
        0), 1 (MATLAB)
    y_up : y runs upward
    image_height_px : needed for y upward without ``origin_px``: y then starts at the lower edge
    origin_px : where x = y = 0 stands, in the program's own image position (from the upper left, y down); None: in the corner
    pixels_per_unit : 1 where lengths are in pixels
    """

    first_pixel: float = 0.0
    y_up: bool = False
    image_height_px: float | None = None
    origin_px: tuple[float, float] | None = None
    pixels_per_unit: float = 1.0

    def to_pixels(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Coordinates of the file -> u, v px of formats.md; any shape, NaN stays NaN."""
        x, y = np.asarray(x, dtype=float) * self.pixels_per_unit, np.asarray(y, dtype=float) * self.pixels_per_unit
        if self.origin_px is not None:
            right, down = self.origin_px
            return right + x - self.first_pixel, down + (-y if self.y_up else y) - self.first_pixel
        if not self.y_up:
            return x - self.first_pixel, y - self.first_pixel
        if self.image_height_px is None:
            raise ValueError("y_up needs image_height_px or origin_px")
        return x - self.first_pixel, self.image_height_px - 1 - (y - self.first_pixel)

    def from_pixels(self, u: Array, v: Array) -> tuple[Array, Array]:
        """The inverse of ``to_pixels``."""
        u_0, v_0 = self.to_pixels(np.zeros(1), np.zeros(1))
        sign = -1.0 if self.y_up else 1.0
        return (u - u_0) / self.pixels_per_unit, sign * (v - v_0) / self.pixels_per_unit
