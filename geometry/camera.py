"""The pinhole camera with OpenCV's lens: tank -> pixel, and pixel -> ideal (undistorted) picture.

Tank axes: x along the tow, y to starboard, z down (depth). Pixels: u right, v down, integers at pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..record.errors import GeometryError
from ..record.schema import CameraTable

Array = NDArray[Any]

_NEWTON_STEPS = 30
"""Newton steps of the undistortion at most; it ends earlier, at the tolerance below."""
_NEWTON_TOLERANCE = 1e-13
"""A last step in the ideal picture (tangents of the angle of view) of the size of rounding: about 1e-10 px."""


@dataclass(frozen=True)
class Lens:
    """Focal lengths, principal point and distortion (k1 k2 p1 p2 k3 of OpenCV's model).

    Attributes
    ----------
    fx_px, fy_px, cx_px, cy_px : float, px
    distortion : (5,), dimensionless
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: Array = field(default_factory=lambda: np.zeros(5))

    @classmethod
    def from_table(cls, table: CameraTable) -> Lens:
        """The lens of run.toml's [camera]."""
        return cls(table.fx_px, table.fy_px, table.cx_px, table.cy_px, np.array(table.distortion, dtype=float))

    @property
    def matrix(self) -> Array:
        """K, (3, 3) px."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    @classmethod
    def from_vector(cls, vector: Array) -> Lens:
        """The lens of fx fy cx cy k1 k2 p1 p2 k3, (9,)."""
        fx, fy, cx, cy = (float(v) for v in vector[:4])
        return cls(fx, fy, cx, cy, np.array(vector[4:9], dtype=float))

    @property
    def vector(self) -> Array:
        """fx fy cx cy k1 k2 p1 p2 k3, (9,)."""
        return np.concatenate([[self.fx_px, self.fy_px, self.cx_px, self.cy_px], self.distortion])

    def slopes(self, ideal: Array) -> tuple[Array, Array, Array]:
        """Pixels of ideal coordinates ``(n, 2)`` and their slopes by those and by the lens's own numbers.

        Returns
        -------
        pixel_px : (n, 2)
        per_ideal : (n, 2, 2) px
        per_lens : (n, 2, 9), by ``vector``
        """
        x, y = ideal[:, 0], ideal[:, 1]
        distorted, slope = _distorted(x, y, self.distortion)
        focal = np.array([self.fx_px, self.fy_px])
        square = x * x + y * y
        per_lens = np.zeros((len(ideal), 2, 9))
        per_lens[:, 0, 0], per_lens[:, 1, 1] = distorted
        per_lens[:, 0, 2] = per_lens[:, 1, 3] = 1.0
        for column, radial in ((4, square), (5, square**2), (8, square**3)):
            per_lens[:, 0, column], per_lens[:, 1, column] = x * radial, y * radial
        per_lens[:, 0, 6], per_lens[:, 1, 6] = 2 * x * y, square + 2 * y * y
        per_lens[:, 0, 7], per_lens[:, 1, 7] = square + 2 * x * x, 2 * x * y
        per_lens[:, :, 4:] *= focal[None, :, None]
        pixel = distorted.T * focal + [self.cx_px, self.cy_px]
        return pixel, slope * focal[None, :, None], per_lens

    def distort(self, ideal: Array) -> Array:
        """Normalised ideal coordinates ``(n, 2)`` -> pixels ``(n, 2)``."""
        u, v = _bent(ideal[:, 0], ideal[:, 1], self.distortion)
        return np.column_stack([self.fx_px * u + self.cx_px, self.fy_px * v + self.cy_px])

    def normalise(self, pixel_px: Array) -> tuple[Array, Array]:
        """Pixels ``(n, 2)`` -> normalised ideal coordinates and their derivative.

        Newton's method on the distortion (OpenCV's fixed-point iteration stops at about 1e-3 px for strong lenses).

        Returns
        -------
        ideal : (n, 2)
        jacobian : (n, 2, 2), d(ideal)/d(pixel), 1/px

        Raises
        ------
        GeometryError : the lens folds over at one of the pixels (its distortion has no inverse there).
        """
        pixel_px = np.asarray(pixel_px, dtype=float).reshape(-1, 2)
        target = (pixel_px - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px]
        ideal = target.copy()
        usable = np.asarray(np.isfinite(target).all(axis=1))
        slope = np.tile(np.eye(2), (len(ideal), 1, 1))
        for _ in range(_NEWTON_STEPS):
            value, slope = _distorted(ideal[:, 0], ideal[:, 1], self.distortion)
            gap = value.T - target
            (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
            determinant = a * d - b * c
            if (determinant[usable] <= 0.05).any():
                where = pixel_px[usable][int(np.argmin(determinant[usable]))]
                raise GeometryError(
                    f"camera.distortion: the lens model folds over at pixel ({where[0]:.0f}, {where[1]:.0f}); "
                    "k1, k2, k3 cannot be right there"
                )
            with np.errstate(invalid="ignore"):
                step = (
                    np.stack([d * gap[:, 0] - b * gap[:, 1], a * gap[:, 1] - c * gap[:, 0]], 1) / determinant[:, None]
                )
            ideal = ideal - np.where(usable[:, None], step, 0.0)
            if not usable.any() or np.abs(step[usable]).max() < _NEWTON_TOLERANCE:
                break
        _, slope = _distorted(ideal[:, 0], ideal[:, 1], self.distortion)
        jacobian = np.full_like(slope, np.nan)
        jacobian[usable] = inverse_2x2(slope[usable]) / np.array([self.fx_px, self.fy_px])[None, None, :]
        return ideal, jacobian


def inverse_2x2(matrices: Array) -> Array:
    """Inverse of ``(..., 2, 2)``; NaN passes through (LAPACK would raise or be slow on it).

    Parameters
    ----------
    matrices : to invert
    """
    a, b, c, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1]
    answer = np.empty_like(matrices)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / (a * d - b * c)
        answer[..., 0, 0], answer[..., 0, 1] = d * scale, -b * scale
        answer[..., 1, 0], answer[..., 1, 1] = -c * scale, a * scale
    return answer


def _distorted(x: Array, y: Array, coefficients: Array) -> tuple[Array, Array]:
    """OpenCV's distortion and its slope: returns ``(2, n)`` and ``(n, 2, 2)``."""
    k1, k2, p1, p2, k3 = coefficients
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    by_square = k1 + square * (2 * k2 + 3 * square * k3)
    slope = np.empty((len(x), 2, 2))
    slope[:, 0, 0] = radial + 2 * x * x * by_square + 2 * p1 * y + 6 * p2 * x
    slope[:, 0, 1] = 2 * x * y * by_square + 2 * p1 * x + 2 * p2 * y
    slope[:, 1, 0] = slope[:, 0, 1]
    slope[:, 1, 1] = radial + 2 * y * y * by_square + 6 * p1 * y + 2 * p2 * x
    return np.stack(_bent(x, y, coefficients)), slope


def _bent(x: Array, y: Array, coefficients: Array) -> tuple[Array, Array]:
    """OpenCV's distortion alone, (n,) each."""
    k1, k2, p1, p2, k3 = coefficients
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    v = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return u, v


@dataclass(frozen=True)
class Camera:
    """A lens at a place.

    Attributes
    ----------
    lens : Lens
    rotation : (3, 3), tank axes -> camera axes (X right, Y down, Z ahead)
    translation : (3,) m, the tank's origin in camera axes
    """

    lens: Lens
    rotation: Array
    translation: Array

    @classmethod
    def looking_at(cls, lens: Lens, place_m: Array, look_at_m: Array, roll_rad: float = 0.0) -> Camera:
        """A camera at ``place_m`` with ``look_at_m`` in the middle, turned by ``roll_rad`` clockwise seen from behind."""
        place, target = np.asarray(place_m, dtype=float), np.asarray(look_at_m, dtype=float)
        ahead = target - place
        distance = np.linalg.norm(ahead)
        down = np.array([0.0, 0.0, 1.0])
        right = np.cross(down, ahead)
        if distance < 1e-9 or np.linalg.norm(right) < 1e-9 * distance:
            raise GeometryError("pose: the camera stands at its target or straight above it; move look_at_m a little")
        ahead, right = ahead / distance, right / np.linalg.norm(right)
        level = np.stack([right, np.cross(ahead, right), ahead])
        rotation = Rotation.from_euler("z", -roll_rad).as_matrix() @ level
        return cls(lens, rotation, -rotation @ place)

    @property
    def place_m(self) -> Array:
        """The lens in tank axes, (3,) m."""
        return -self.rotation.T @ self.translation

    def project(self, tank_m: Array) -> Array:
        """Tank points ``(n, 3)`` m -> pixels ``(n, 2)``; NaN behind the camera."""
        seen = np.asarray(tank_m, dtype=float).reshape(-1, 3) @ self.rotation.T + self.translation
        ahead = np.where(seen[:, 2] > 0, seen[:, 2], np.nan)
        return self.lens.distort(seen[:, :2] / ahead[:, None])

    def rays(self, pixel_px: Array) -> Array:
        """Unit directions ``(n, 3)`` in tank axes of the rays through pixels ``(n, 2)``."""
        ideal, _ = self.lens.normalise(pixel_px)
        direction = np.column_stack([ideal, np.ones(len(ideal))]) @ self.rotation
        return direction / np.linalg.norm(direction, axis=1, keepdims=True)
