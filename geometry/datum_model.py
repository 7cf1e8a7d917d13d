"""What is fitted to the datum points, by what is known (formats.md).

- ``pose``: [camera] gives the lens; the six numbers of the pose are fitted, and the lens within its own uncertainty.
- ``two_planes``: no lens, datum points at two depths: the whole matrix is fitted (single-view metrology).
- ``homography``: no lens, one plane, and the marks lie in it.
- ``square_pixels``: no lens, one plane, marks off it: square pixels and a centred principal point are assumed, said, and their
  uncertainty carried.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..record.errors import GeometryError
from ..record.schema import CameraTable
from .camera import Array, Lens
from .linear import camera_matrix, focal_from_plane, plane_matrix, pose_start

CENTRE_SD_SHARE = 0.02
"""Principal points of ordinary cameras scatter by about 2 % of the picture's width around its centre."""
PLAIN = Lens(1.0, 1.0, 0.0, 0.0)
"""No lens: pixels are the ideal picture, the camera matrix holds all."""


@dataclass(frozen=True)
class DatumModel:
    """A camera with free numbers ``theta``.

    Attributes
    ----------
    method : name
    start : first theta
    matrix : theta -> camera matrix (3, 4) in the lens's ideal coordinates
    lens : theta -> lens
    prior : theta -> residuals of what is known of theta beforehand, unit variance
    gauge : directions of theta without effect (a scale)
    notes : assumptions, for the user
    """

    method: str
    start: Array
    matrix: Callable[[Array], Array]
    lens: Callable[[Array], Lens]
    prior: Callable[[Array], Array] = lambda _: np.zeros(0)
    gauge: int = 0
    notes: tuple[str, ...] = ()


def datum_model(
    tank_m: Array,
    pixel_px: Array,
    camera: CameraTable | None,
    marker_depths_m: Sequence[float],
    image_size_px: tuple[int, int] | None,
    lens_covariance: Array | None,
) -> DatumModel:
    """Choose the model and its start.

    Parameters
    ----------
    tank_m : (n, 3) places in the tank
    pixel_px : (n, 2) picks
    camera : [camera] of run.toml, or None
    marker_depths_m : of the marks, for planes beside the datum's
    image_size_px : width and height
    lens_covariance : (9, 9) of the stated lens, or None

    Raises
    ------
    GeometryError : too little is known
    """
    if camera is not None:
        return _pose_model(Lens.from_table(camera), lens_covariance, tank_m, pixel_px)
    depths = np.unique(tank_m[:, 2])
    if len(depths) > 1 and len(tank_m) >= 6:
        note = "no [camera]: the picture is taken as free of distortion; height from datum points at two depths"
        start = camera_matrix(tank_m, pixel_px).ravel()
        return DatumModel("two_planes", start, lambda theta: theta.reshape(3, 4), _plain, gauge=1, notes=(note,))
    if len(depths) == 1 and np.allclose(marker_depths_m, depths[0], atol=1e-9):
        if depths[0] != 0:
            raise GeometryError("datum: one plane without [camera] must be the datum plane itself, depth 0")
        note = "no [camera]: the picture is taken as free of distortion"
        start = plane_matrix(tank_m[:, :2], pixel_px).ravel()
        return DatumModel("homography", start, _of_plane, _plain, gauge=1, notes=(note,))
    if image_size_px is None:
        raise GeometryError(
            "camera: missing table; the marks lie off the datum plane and the picture's size is not known: "
            "give [camera], or six or more datum points at two depths"
        )
    return _square_pixels(tank_m, pixel_px, image_size_px)


def _pose_model(stated: Lens, lens_covariance: Array | None, tank: Array, pixel: Array) -> DatumModel:
    start = pose_start(tank, stated.normalise(pixel)[0])
    if lens_covariance is None:
        return DatumModel("pose", start, _of_pose, lambda _: stated)
    root = _root(lens_covariance)
    return DatumModel(
        "pose",
        np.concatenate([start, np.zeros(root.shape[1])]),
        lambda theta: _of_pose(theta[:6]),
        lambda theta: Lens.from_vector(stated.vector + root @ theta[6:]),
        prior=lambda theta: theta[6:],
    )


def _root(covariance: Array) -> Array:
    """Columns of a square root without the directions that do not vary, (9, k)."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > 1e-12
    return scale[:, None] * vectors[:, kept] * np.sqrt(values[kept])


def _square_pixels(tank: Array, pixel: Array, size: tuple[int, int]) -> DatumModel:
    width, height = size
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    spread = CENTRE_SD_SHARE * width
    note = (
        "no [camera], one datum plane and marks off it: square pixels and a principal point at the picture's centre "
        f"(within {spread:.0f} px) are assumed; a [camera] table or water-line datum points would replace the assumption"
    )
    focal = focal_from_plane(plane_matrix(tank[:, :2], pixel), centre, width)
    start = np.concatenate([[focal], centre, pose_start(tank, (pixel - centre) / focal)])

    def matrix(theta: Array) -> Array:
        inner = np.array([[theta[0], 0, theta[1]], [0, theta[0], theta[2]], [0, 0, 1.0]])
        return inner @ _of_pose(theta[3:])

    return DatumModel(
        "square_pixels", start, matrix, _plain, prior=lambda theta: (theta[1:3] - centre) / spread, notes=(note,)
    )


def _plain(_: Array) -> Lens:
    return PLAIN


def _of_pose(theta: Array) -> Array:
    return np.column_stack([Rotation.from_rotvec(theta[:3]).as_matrix(), theta[3:6]])


def _of_plane(theta: Array) -> Array:
    plane = theta.reshape(3, 3)
    return np.column_stack([plane[:, 0], plane[:, 1], np.zeros(3), plane[:, 2]])
