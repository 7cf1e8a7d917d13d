"""A board seen through a lens: corners in pixels, and their derivatives by lens, pose and board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..camera import Array, Lens
from .boards import BoardView

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
COEFFICIENTS = {0: (), 1: ("k1",), 2: ("k1", "k2"), 4: ("k1", "k2", "p1", "p2"), 5: ("k1", "k2", "p1", "p2", "k3")}
"""Which distortion coefficients a number of them means."""


@dataclass(frozen=True)
class Poses:
    """Board axes -> camera axes, per view: ``rotation (v, 3, 3)``, ``translation_m (v, 3)``."""

    rotation: Array
    translation_m: Array

    def moved(self, turn_rad: Array, shift_m: Array) -> Poses:
        """Turned about the camera by small vectors ``(v, 3)`` and shifted ``(v, 3)``."""
        turn = Rotation.from_rotvec(turn_rad).as_matrix()
        return Poses(turn @ self.rotation, np.einsum("vij,vj->vi", turn, self.translation_m) + shift_m)


@dataclass(frozen=True)
class Corners:
    """The corners of all views, one after another.

    Attributes
    ----------
    board_m : (n, 3); pixel_px : (n, 2); view : (n,) index of the view; start : (v,) first corner of each view
    point : (n,) index into the board's seen corners; point_ids : (k,) which corners of the board these are
    """

    board_m: Array
    pixel_px: Array
    view: Array
    start: Array
    point: Array
    point_ids: Array

    @classmethod
    def of(cls, views: Sequence[BoardView]) -> Corners:
        """Put the views' corners into one list."""
        counts = np.array([len(view.ids) for view in views])
        point_ids, point = np.unique(np.concatenate([view.ids for view in views]), return_inverse=True)
        return cls(
            np.concatenate([view.board_m for view in views]),
            np.concatenate([view.pixel_px for view in views]),
            np.repeat(np.arange(len(views)), counts),
            np.concatenate([[0], np.cumsum(counts)[:-1]]),
            point,
            point_ids,
        )

    @property
    def counts(self) -> Array:
        """Corners per view, (v,)."""
        return np.diff(self.start, append=len(self.view))

    def sums(self, values: Array) -> Array:
        """Sums over the corners of each view, ``(n, ...)`` -> ``(v, ...)``."""
        return np.add.reduceat(values, self.start, axis=0)


def free_basis(coefficients: int = 5, square_pixels: bool = False) -> Array:
    """What is free, (9, m): focal lengths (one for both with ``square_pixels``), principal point, the coefficients asked for.

    Parameters
    ----------
    coefficients : how many of k1 k2 p1 p2 k3
    square_pixels : one focal length
    """
    names = ["cx", "cy", *COEFFICIENTS[coefficients]]
    focal = np.zeros((9, 1 if square_pixels else 2))
    focal[0, 0] = focal[1, -1] = 1.0
    return np.column_stack([focal, *(np.eye(9)[PARAMETERS.index(name)] for name in names)])


def nearest(theta: Array, basis: Array) -> Array:
    """The lens (9,) that is nearest to ``theta`` among those that ``basis`` can reach (what it holds is zero).

    Parameters
    ----------
    theta : (9,) lens, as ``Lens.vector``
    basis : (9, m), what is free
    """
    return basis @ np.linalg.pinv(basis) @ theta


def residuals(theta: Array, poses: Poses, corners: Corners, shape_m: Array | None = None) -> Array:
    """Measured minus projected, (n, 2) px; NaN behind the camera.

    Parameters
    ----------
    theta : (9,), or (v, 9) with a lens of its own for each view
    poses : of the board in each view
    corners : of all views, in one list
    shape_m : (k, 3), how far the board's corners are from where they should be, or (v, k, 3) for each view; None = nowhere
    """
    seen = _seen(poses, corners, shape_m)
    ideal = seen[:, :2] / np.where(seen[:, 2] > 0, seen[:, 2], np.nan)[:, None]
    projected = np.concatenate([lens.distort(ideal[part]) for lens, part in _lenses(theta, corners)])
    return corners.pixel_px - projected


def slopes(theta: Array, poses: Poses, corners: Corners, shape_m: Array | None = None) -> tuple[Array, Array, Array]:
    """Derivatives of the projected pixels.

    Parameters
    ----------
    theta : (9,) lens, as ``Lens.vector``
    poses : of the board in each view
    corners : of all views, in one list
    shape_m : (k, 3), how far the board's corners lie from where they should be; None: nowhere

    Returns
    -------
    by_lens : (n, 2, 9)
    by_pose : (n, 2, 6), by turn (rad) and shift (m) of the board in camera axes
    by_place : (n, 2, 3), by the corner's place in board axes, 1/m
    """
    seen = _seen(poses, corners, shape_m)
    ideal = seen[:, :2] / seen[:, 2:]
    parts = [lens.slopes(ideal[part]) for lens, part in _lenses(theta, corners)]
    by_ideal = np.concatenate([part[1] for part in parts])
    by_place = np.zeros((len(seen), 2, 3))
    by_place[:, 0, 0] = by_place[:, 1, 1] = 1 / seen[:, 2]
    by_place[:, :, 2] = -ideal / seen[:, 2:]
    by_place = by_ideal @ by_place
    turned = np.zeros((len(seen), 3, 3))
    x, y, z = seen.T
    turned[:, 0, 1], turned[:, 0, 2] = z, -y
    turned[:, 1, 0], turned[:, 1, 2] = -z, x
    turned[:, 2, 0], turned[:, 2, 1] = y, -x
    by_pose = np.concatenate([by_place @ turned, by_place], axis=2)
    return np.concatenate([part[2] for part in parts]), by_pose, by_place @ poses.rotation[corners.view]


def _seen(poses: Poses, corners: Corners, shape_m: Array | None) -> Array:
    """Corners in camera axes, (n, 3) m."""
    place = corners.board_m
    if shape_m is not None:
        place = place + (shape_m[corners.point] if shape_m.ndim == 2 else shape_m[corners.view, corners.point])
    return np.einsum("nij,nj->ni", poses.rotation[corners.view], place) + poses.translation_m[corners.view]


def _lenses(theta: Array, corners: Corners) -> list[tuple[Lens, slice]]:
    """Each lens and the corners that it sees."""
    if theta.ndim == 1:
        return [(Lens.from_vector(theta), slice(None))]
    ends = corners.start + corners.counts
    return [(Lens.from_vector(own), slice(a, b)) for own, a, b in zip(theta, corners.start, ends, strict=True)]
