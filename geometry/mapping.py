"""From a pixel to a place at a known depth, with its derivatives: what every camera model must offer."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from .camera import Array, Lens, inverse_2x2

_DEPTH_STEP_M = 1e-4
"""Of the difference that tells how a place changes with its depth: small against any tank, large against rounding."""


@dataclass(frozen=True)
class Places:
    """Places of pixels on the plane at one depth.

    Attributes
    ----------
    xy_m : (n, 2), tank axes
    per_px : (n, 2, 2), d(xy_m)/d(pixel), m/px
    modes_m : (k, n, 2), change of xy_m with each common mode of the camera (independent, unit variance)
    """

    xy_m: Array
    per_px: Array
    modes_m: Array


class Mapping(Protocol):
    """A camera over its datum."""

    @property
    def method(self) -> str:
        """How the camera was found."""
        ...

    def to_tank(self, pixel_px: Array, depth_m: float) -> Places:
        """Pixels ``(n, 2)`` -> places at ``depth_m`` below the datum plane; NaN in, NaN out."""
        ...

    def to_pixel(self, tank_m: Array) -> Array:
        """Tank points ``(n, 3)`` -> pixels ``(n, 2)``."""
        ...

    def homography(self, depth_m: float) -> Array:
        """Ideal (undistorted) pixel -> tank at ``depth_m``, (3, 3)."""
        ...


@dataclass(frozen=True)
class ProjectiveMapping:
    """A camera matrix behind a lens: the exact form, H(z) = [p1 p2 z p3 + p4] (theory.md 4).

    Attributes
    ----------
    method : how the matrix was found
    lens : of [camera], or the identity (pixels taken as ideal)
    matrix : (3, 4), tank (x, y, z, 1) -> ideal coordinates of ``lens``
    matrix_modes : (k, 3, 4), its change with each independent unit-variance mode of the datum's and the lens's uncertainty
    lens_modes : (k, 9), the lens's change (``Lens.vector``) with the same modes; (0, 9): the lens is exact
    """

    method: str
    lens: Lens
    matrix: Array
    matrix_modes: Array
    lens_modes: Array = field(default_factory=lambda: np.zeros((0, 9)))

    def exact(self) -> ProjectiveMapping:
        """The same camera without its uncertainty: places have no modes, and cost a third."""
        return replace(self, matrix_modes=self.matrix_modes[:0], lens_modes=self.lens_modes[:0])

    def to_pixel(self, tank_m: Array) -> Array:
        """Tank points ``(n, 3)`` -> pixels ``(n, 2)``."""
        seen = _homogeneous(np.asarray(tank_m, dtype=float).reshape(-1, 3)) @ self.matrix.T
        return self.lens.distort(seen[:, :2] / seen[:, 2:])

    def plane(self, depth_m: float) -> Array:
        """H(z): tank (x, y, 1) at ``depth_m`` -> ideal coordinates, (3, 3)."""
        return np.column_stack([self.matrix[:, 0], self.matrix[:, 1], depth_m * self.matrix[:, 2] + self.matrix[:, 3]])

    def homography(self, depth_m: float) -> Array:
        """Ideal pixel (px) -> tank at ``depth_m``, (3, 3), scaled to a unit last element."""
        inverse = np.linalg.inv(self.lens.matrix @ self.plane(depth_m))
        return inverse / inverse[2, 2]

    def to_tank(self, pixel_px: Array, depth_m: float) -> Places:
        """Pixels ``(n, 2)`` -> places; derivatives by the implicit function theorem."""
        ideal, ideal_per_px = self.lens.normalise(pixel_px)
        plane = self.plane(depth_m)
        back = _homogeneous(ideal) @ np.linalg.inv(plane).T
        xy = back[:, :2] / back[:, 2:]
        point = np.column_stack([xy, np.full(len(xy), depth_m), np.ones(len(xy))])
        seen = point @ self.matrix.T
        scale = seen[:, 2]
        forward = (plane[None, :2, :2] - ideal[:, :, None] * plane[None, 2:, :2]) / scale[:, None, None]
        inverse = inverse_2x2(forward)
        moved = point @ self.matrix_modes.transpose(0, 2, 1)
        moved = (moved[:, :, :2] - ideal[None] * moved[:, :, 2:]) / scale[None, :, None]
        if len(self.lens_modes):
            # a pixel stands still while the lens moves: its ideal place moves the other way
            _, per_ideal, per_lens = self.lens.slopes(ideal)
            moved += np.einsum("nij,njl,kl->kni", inverse_2x2(per_ideal), per_lens, self.lens_modes)
        return Places(xy, inverse @ ideal_per_px, -np.einsum("nij,knj->kni", inverse, moved))


def ray_slopes(mapping: Mapping, pixel_px: Array, depth_m: float) -> Array:
    """How far a pixel's ray goes aside for a metre of depth, m/m.

    Parameters
    ----------
    mapping : pixel -> tank
    pixel_px : (n, 2); NaN in, NaN out
    depth_m : below the datum plane, about which

    Returns
    -------
    (n, 2)
    """
    lower, higher = (mapping.to_tank(pixel_px, depth_m + by).xy_m for by in (_DEPTH_STEP_M, -_DEPTH_STEP_M))
    return (lower - higher) / (2 * _DEPTH_STEP_M)


def _homogeneous(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])
