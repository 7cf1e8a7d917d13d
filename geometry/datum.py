"""The datum: points of known place in the picture -> the camera matrix and its uncertainty.

Four ways, by what is known (formats.md):
- ``pose``: [camera] gives the lens; the six numbers of the pose are fitted.
- ``two_planes``: no lens, datum points at two depths: the whole matrix is fitted (single-view metrology).
- ``homography``: no lens, one plane, and the marks lie in it.
- ``square_pixels``: no lens, one plane, marks off it: square pixels and a centred principal point are assumed, said,
  and their uncertainty carried.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from ..record.errors import GeometryError
from ..record.schema import CameraTable, DatumPoint
from .camera import Array, Lens
from .mapping import ProjectiveMapping

CENTRE_SD_SHARE = 0.02
"""Principal points of ordinary cameras scatter by about 2 % of the picture's width around its centre."""
REJECTED_AT = 0.01
"""The stated picking errors are not believed when the residuals' chi-square is less probable than this."""
RANK_TOLERANCE = 1e-9
_STEP = 1e-6


@dataclass(frozen=True)
class DatumFit:
    """The camera over the datum.

    Attributes
    ----------
    mapping : pixel <-> tank
    residual_px : (n, 2), picked minus projected
    sigma_px : (n,), stated picking errors
    chi_square, degrees : of the weighted residuals
    notes : assumptions and warnings, for the user
    """

    mapping: ProjectiveMapping
    residual_px: Array
    sigma_px: Array
    chi_square: float
    degrees: int
    notes: tuple[str, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square of the residuals per coordinate."""
        return float(np.sqrt(np.mean(self.residual_px**2)))


def fit_datum(
    points: Sequence[DatumPoint],
    camera: CameraTable | None,
    marker_depths_m: Sequence[float],
    image_size_px: tuple[int, int] | None = None,
) -> DatumFit:
    """Fit the camera to its datum points.

    Parameters
    ----------
    points : at least 4, checked by ``record.schema.check_datum``
    camera : the lens, or None
    marker_depths_m : depths at which places will be asked for; they decide which model is needed
    image_size_px : width, height; needed for ``square_pixels``

    Raises
    ------
    GeometryError : the points do not fix the camera
    """
    tank = np.array([p.tank_m for p in points], dtype=float)
    pixel = np.array([p.pixel_px for p in points], dtype=float)
    sigma = np.array([p.sigma_px for p in points], dtype=float)
    notes: list[str] = []
    depths = np.unique(tank[:, 2])
    if camera is not None:
        lens = Lens.from_table(camera)
        start = _pose_start(tank, lens.normalise(pixel)[0])
        return _finish("pose", lens, _pose_matrix, start, tank, pixel, sigma, points, notes)
    lens = Lens(1.0, 1.0, 0.0, 0.0)
    if len(depths) > 1 and len(points) >= 6:
        start = _dlt(tank, pixel).ravel()
        notes.append("no [camera]: the picture is taken as free of distortion; height from datum points at two depths")
        return _finish("two_planes", lens, _free_matrix, start, tank, pixel, sigma, points, notes, gauge=1)
    if len(depths) == 1 and np.allclose(marker_depths_m, depths[0], atol=1e-9):
        plane = _plane_dlt(tank[:, :2], pixel)
        notes.append("no [camera]: the picture is taken as free of distortion")
        build = _plane_matrix(float(depths[0]))
        return _finish("homography", lens, build, plane.ravel(), tank, pixel, sigma, points, notes, gauge=1)
    if image_size_px is None:
        raise GeometryError(
            "camera: missing table; the marks lie off the datum plane and the picture's size is not known: "
            "give [camera], or six or more datum points at two depths"
        )
    return _square_pixels(lens, image_size_px, tank, pixel, sigma, points, notes)


def _square_pixels(
    lens: Lens,
    size: tuple[int, int],
    tank: Array,
    pixel: Array,
    sigma: Array,
    points: Sequence[DatumPoint],
    notes: list[str],
) -> DatumFit:
    width, height = size
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    spread = CENTRE_SD_SHARE * width
    notes.append(
        "no [camera], one datum plane and marks off it: square pixels and a principal point at the picture's centre "
        f"(within {spread:.0f} px) are assumed; a [camera] table or water-line datum points would replace the assumption"
    )
    focal = _focal_from_plane(_plane_dlt(tank[:, :2], pixel), centre, width)
    pose = _pose_start(tank, (pixel - centre) / focal)
    start = np.concatenate([[focal], centre, pose])

    def build(theta: Array) -> Array:
        intrinsic = np.array([[theta[0], 0, theta[1]], [0, theta[0], theta[2]], [0, 0, 1.0]])
        return intrinsic @ _pose_matrix(theta[3:])

    def prior(theta: Array) -> Array:
        return (theta[1:3] - centre) / spread

    return _finish("square_pixels", lens, build, start, tank, pixel, sigma, points, notes, prior=prior)


def _finish(
    method: str,
    lens: Lens,
    build: Callable[[Array], Array],
    start: Array,
    tank: Array,
    pixel: Array,
    sigma: Array,
    points: Sequence[DatumPoint],
    notes: list[str],
    gauge: int = 0,
    prior: Callable[[Array], Array] | None = None,
) -> DatumFit:
    """Levenberg-Marquardt from ``start``, then covariance; ``gauge`` counts directions without effect (a scale)."""
    homogeneous = np.column_stack([tank, np.ones(len(tank))])
    scale = np.maximum(np.abs(start), 1e-3 * np.abs(start).max())

    def picks(scaled: Array) -> Array:
        seen = homogeneous @ build(scaled * scale).T
        return (pixel - lens.distort(seen[:, :2] / seen[:, 2:])) / sigma[:, None]

    def cost(scaled: Array) -> Array:
        gap = picks(scaled).ravel()
        extra = prior(scaled * scale) if prior else np.zeros(0)
        fixed_scale = [np.linalg.norm(scaled) - np.linalg.norm(start / scale)] if gauge else []
        return np.concatenate([gap, extra, fixed_scale])

    answer = least_squares(cost, start / scale, method="lm", jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    values = np.linalg.svd(answer.jac, compute_uv=False)
    if not np.isfinite(values).all() or values[-1] < RANK_TOLERANCE * values[0]:
        raise GeometryError(
            f"datum: the {len(points)} points do not fix the camera ({method}): three of four on a line, or too few"
        )
    covariance = np.linalg.inv(answer.jac.T @ answer.jac)
    gap = picks(answer.x)
    degrees = 2 * len(points) - (len(start) - gauge) + (2 if prior else 0)
    chi_square = float((gap**2).sum())
    widen = 1.0
    if degrees > 0 and chdtrc(degrees, chi_square) < REJECTED_AT:
        widen = np.sqrt(chi_square / degrees)
        worst = int(np.argmax((gap**2).sum(axis=1)))
        size = float(np.linalg.norm(gap[worst]) * sigma[worst])
        notes.append(
            f"the datum does not fit its stated picking errors (chi-square {chi_square:.1f} of {degrees}): largest at "
            f"{points[worst].name or f'point {worst + 1}'}, {size:.2f} px; the camera's uncertainty is widened {widen:.1f} times"
        )
    elif degrees == 0:
        notes.append("the datum has no point to spare: its picks cannot be checked; a fifth point would")
    theta = answer.x * scale
    root = np.linalg.cholesky(covariance) * widen
    modes = []
    for column in (root * scale[:, None]).T:
        modes.append((build(theta + _STEP * column) - build(theta - _STEP * column)) / (2 * _STEP))
    mapping = ProjectiveMapping(method, lens, build(theta), np.array(modes))
    return DatumFit(mapping, gap * sigma[:, None], sigma, chi_square, degrees, tuple(notes))


def _pose_matrix(theta: Array) -> Array:
    rotation = Rotation.from_rotvec(theta[:3]).as_matrix()
    return np.column_stack([rotation, theta[3:6]])


def _free_matrix(theta: Array) -> Array:
    return theta.reshape(3, 4)


def _plane_matrix(depth_m: float) -> Callable[[Array], Array]:
    def build(theta: Array) -> Array:
        plane = theta.reshape(3, 3)
        if depth_m != 0:
            raise GeometryError("datum: one plane without [camera] must be the datum plane itself, depth 0")
        return np.column_stack([plane[:, 0], plane[:, 1], np.zeros(3), plane[:, 2]])

    return build


def _pose_start(tank: Array, ideal: Array) -> Array:
    """Rotation vector and translation from normalised points, by OpenCV's SQPnP (global optimum, planar or not)."""
    import cv2

    centre = tank.mean(axis=0)
    found, rotation, translation = cv2.solvePnP(
        np.ascontiguousarray(tank - centre),
        np.ascontiguousarray(ideal),
        np.eye(3),
        np.zeros(5),
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not found or not np.isfinite(rotation).all():
        raise GeometryError("datum: no camera pose fits the points; are tank_m and pixel_px in the same order?")
    matrix = Rotation.from_rotvec(rotation.ravel()).as_matrix()
    shift = translation.ravel() - matrix @ centre
    if ((tank @ matrix.T + shift)[:, 2] <= 0).any():
        raise GeometryError("datum: the points fit only a camera that has some of them behind it; check tank_m's signs")
    return np.concatenate([rotation.ravel(), shift])


def _normaliser(points: Array) -> Array:
    """Hartley's similarity: points to zero mean and unit spread, (d+1, d+1)."""
    centre = points.mean(axis=0)
    spread = np.sqrt(((points - centre) ** 2).sum(axis=1).mean())
    size = points.shape[1]
    similarity = np.eye(size + 1)
    similarity[:size, :size] /= spread
    similarity[:size, size] = -centre / spread
    return similarity


def _linear_camera(source: Array, pixel: Array) -> Array:
    """Direct linear transform of homogeneous ``source (n, d+1)`` to pixels; (3, d+1)."""
    rows = []
    for point, (u, v) in zip(source, pixel, strict=True):
        zero = np.zeros_like(point)
        rows += [np.concatenate([point, zero, -u * point]), np.concatenate([zero, point, -v * point])]
    return np.linalg.svd(np.array(rows))[2][-1].reshape(3, -1)


def _dlt(tank: Array, pixel: Array) -> Array:
    left, right = _normaliser(pixel), _normaliser(tank)
    source = np.column_stack([tank, np.ones(len(tank))]) @ right.T
    target = (np.column_stack([pixel, np.ones(len(pixel))]) @ left.T)[:, :2]
    return _signed(np.linalg.inv(left) @ _linear_camera(source, target) @ right, tank)


def _plane_dlt(xy: Array, pixel: Array) -> Array:
    left, right = _normaliser(pixel), _normaliser(xy)
    source = np.column_stack([xy, np.ones(len(xy))]) @ right.T
    target = (np.column_stack([pixel, np.ones(len(pixel))]) @ left.T)[:, :2]
    return _signed(np.linalg.inv(left) @ _linear_camera(source, target) @ right, xy)


def _signed(matrix: Array, points: Array) -> Array:
    """Scale so that points are ahead of the camera and the matrix is of order one in its last row."""
    ahead = np.column_stack([points, np.ones(len(points))]) @ matrix[2]
    return matrix / ahead.mean()


def _focal_from_plane(plane: Array, centre: Array, width: int) -> float:
    """Focal length in px from a plane's homography under square pixels (orthogonality and equal length of r1, r2)."""
    shift = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1.0]])
    h1, h2 = (shift @ plane)[:, 0], (shift @ plane)[:, 1]
    top = np.array([h1[0] * h2[0] + h1[1] * h2[1], h1[0] ** 2 + h1[1] ** 2 - h2[0] ** 2 - h2[1] ** 2])
    low = np.array([h1[2] * h2[2], h1[2] ** 2 - h2[2] ** 2])
    square = -(top @ low) / max(low @ low, 1e-300)
    return float(np.sqrt(square)) if np.isfinite(square) and square > (0.2 * width) ** 2 else 1.2 * width
