"""Linear starts: camera matrices by direct linear transform, poses by SQPnP, a focal length from one plane."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ..record.errors import GeometryError
from .camera import Array


def pose_start(tank: Array, ideal: Array) -> Array:
    """Rotation vector and translation from normalised points, by OpenCV's SQPnP (global optimum, planar or not).

    Parameters
    ----------
    tank : (n, d) places in the tank, m
    ideal : (n, 2) normalised places in the picture
    """
    import cv2

    wrong = "datum: no camera pose fits the points; are tank_m and pixel_px in the same order?"
    centre = tank.mean(axis=0)
    try:
        found, rotation, translation = cv2.solvePnP(
            np.ascontiguousarray(tank - centre),
            np.ascontiguousarray(ideal),
            np.eye(3),
            np.zeros(5),
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:
        raise GeometryError(wrong) from None
    if not found or not np.isfinite(rotation).all():
        raise GeometryError(wrong)
    matrix = Rotation.from_rotvec(rotation.ravel()).as_matrix()
    shift = translation.ravel() - matrix @ centre
    if ((tank @ matrix.T + shift)[:, 2] <= 0).any():
        raise GeometryError("datum: the points fit only a camera that has some of them behind it; check tank_m's signs")
    return np.concatenate([rotation.ravel(), shift])


def normaliser(points: Array) -> Array:
    """Hartley's similarity: points to zero mean and unit spread, (d+1, d+1)."""
    centre = points.mean(axis=0)
    spread = np.sqrt(((points - centre) ** 2).sum(axis=1).mean())
    size = points.shape[1]
    similarity = np.eye(size + 1)
    similarity[:size, :size] /= spread
    similarity[:size, size] = -centre / spread
    return similarity


def linear_camera(source: Array, pixel: Array) -> Array:
    """Direct linear transform of homogeneous ``source (n, d+1)`` to pixels; (3, d+1).

    Parameters
    ----------
    source : (n, d+1) homogeneous points
    pixel : (n, 2) places in the picture
    """
    rows = []
    for point, (u, v) in zip(source, pixel, strict=True):
        zero = np.zeros_like(point)
        rows += [np.concatenate([point, zero, -u * point]), np.concatenate([zero, point, -v * point])]
    return np.linalg.svd(np.array(rows))[2][-1].reshape(3, -1)


def camera_matrix(tank: Array, pixel: Array) -> Array:
    """Camera matrix (3, 4) by the linear equations of points ``tank (n, 3)`` m and ``pixel (n, 2)``, scaled to be ahead of it.

    Parameters
    ----------
    tank : (n, d) places in the tank, m
    pixel : (n, 2) places in the picture
    """
    left, right = normaliser(pixel), normaliser(tank)
    source = np.column_stack([tank, np.ones(len(tank))]) @ right.T
    target = (np.column_stack([pixel, np.ones(len(pixel))]) @ left.T)[:, :2]
    return _signed(np.linalg.inv(left) @ linear_camera(source, target) @ right, tank)


def plane_matrix(xy: Array, pixel: Array) -> Array:
    """Homography (3, 3) by the linear equations of points ``xy (n, 2)`` m of a plane and ``pixel (n, 2)``, scaled alike.

    Parameters
    ----------
    xy : (n, 2) places in the plane, m
    pixel : (n, 2) places in the picture
    """
    left, right = normaliser(pixel), normaliser(xy)
    source = np.column_stack([xy, np.ones(len(xy))]) @ right.T
    target = (np.column_stack([pixel, np.ones(len(pixel))]) @ left.T)[:, :2]
    return _signed(np.linalg.inv(left) @ linear_camera(source, target) @ right, xy)


def _signed(matrix: Array, points: Array) -> Array:
    """Scale so that points are ahead of the camera and the matrix is of order one in its last row."""
    ahead = np.column_stack([points, np.ones(len(points))]) @ matrix[2]
    return matrix / ahead.mean()


def focal_from_plane(plane: Array, centre: Array, width: int) -> float:
    """Focal length in px from a plane's homography under square pixels (orthogonality and equal length of r1, r2).

    Parameters
    ----------
    plane : (3, 3) homography
    centre : (2,) principal point, px
    width : of the picture, px
    """
    shift = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1.0]])
    h1, h2 = (shift @ plane)[:, 0], (shift @ plane)[:, 1]
    top = np.array([h1[0] * h2[0] + h1[1] * h2[1], h1[0] ** 2 + h1[1] ** 2 - h2[0] ** 2 - h2[1] ** 2])
    low = np.array([h1[2] * h2[2], h1[2] ** 2 - h2[2] ** 2])
    square = -(top @ low) / max(low @ low, 1e-300)
    return float(np.sqrt(square)) if np.isfinite(square) and square > (0.2 * width) ** 2 else 1.2 * width
