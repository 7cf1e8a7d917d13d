"""The thesis's reference trapezoid: (AII-2), (AII-5) and the deck-height shift (4.2), section 4.6 and appendix II.

Exact for a camera without roll and without yaw against the channel; kept as the 1990s' method and as a comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..record.errors import GeometryError
from ..record.schema import DatumPoint
from .camera import Array
from .mapping import Places, ProjectiveMapping

_STEP_PX = 1e-4
"""Of the central differences: small against the picture, large against rounding."""


@dataclass(frozen=True)
class Trapezoid:
    """Four corners of a rectangle on the tank top, as seen.

    Attributes
    ----------
    corners_px : (4, 2): far left, far right, near left, near right as they stand in the picture
    drops_px_per_m : (4, 2), apparent shift of each corner per metre of depth (aa' .. dd' over D'')
    far_x_m, near_x_m, left_y_m, right_y_m : the rectangle in tank axes
    """

    corners_px: Array
    drops_px_per_m: Array
    far_x_m: float
    near_x_m: float
    left_y_m: float
    right_y_m: float

    def place(self, pixel_px: Array, depth_m: float, move_corners: bool = False) -> Array:
        """Pixels ``(n, 2)`` -> (x, y) in tank axes ``(n, 2)`` m at ``depth_m``.

        X = Lr d13 w2/(d13 w2 + d23 w1)  (AII-2);  Y = w y3 (d13 + d23)/(w2 d13 + w1 d23)  (AII-5)

        move_corners : move all four corners down to the depth (w1, w2 and the axis move too) instead of shifting
            d13, d23 alone by the corners' mean drop as (4.2) does (theory.md 9.9)
        """
        corners = self.corners_px
        drop = self.drops_px_per_m * depth_m
        if move_corners:
            corners = corners + drop
        far_left, far_right, near_left, near_right = corners
        far, near = (far_left + far_right) / 2, (near_left + near_right) / 2
        along = (far_right - far_left) / np.linalg.norm(far_right - far_left) + (
            near_right - near_left
        ) / np.linalg.norm(near_right - near_left)
        along = along / np.linalg.norm(along)
        down = np.array([-along[1], along[0]])
        w1, w2 = np.linalg.norm(far_right - far_left), np.linalg.norm(near_right - near_left)
        d13 = (pixel_px - far) @ down
        d23 = (near - pixel_px) @ down
        share = d13 / (d13 + d23)
        axis = far + share[:, None] * (near - far)
        y3 = (pixel_px - axis) @ along
        if not move_corners:
            d13 = d13 - (drop[0] + drop[1]) @ down / 2
            d23 = d23 + (drop[2] + drop[3]) @ down / 2
        from_far = d13 * w2 / (d13 * w2 + d23 * w1)
        lateral = y3 * (d13 + d23) / (w2 * d13 + w1 * d23)
        x = self.far_x_m + from_far * (self.near_x_m - self.far_x_m)
        y = (self.left_y_m + self.right_y_m) / 2 + lateral * (self.right_y_m - self.left_y_m)
        return np.column_stack([x, y])


def trapezoid_from_datum(points: Sequence[DatumPoint], exact: ProjectiveMapping) -> tuple[Trapezoid, Array]:
    """The outermost rectangle of the datum points on the tank top, and the picking sigma of its corners ``(4,)`` px.

    The drops come from points at a second depth below the corners where they are given, else from the ``exact`` camera.

    Parameters
    ----------
    points : of the datum; those at depth 0 are the tank top's
    exact : camera that says the drops where no points do

    Raises
    ------
    GeometryError : no four points at depth 0 form a rectangle along the tank
    """
    top = [p for p in points if p.tank_m[2] == 0.0]
    place = {(p.tank_m[0], p.tank_m[1]): p for p in top}
    xs, ys = sorted({x for x, _ in place}), sorted({y for _, y in place})
    best: tuple[float, list[DatumPoint]] | None = None
    for i, x1 in enumerate(xs):
        for x2 in xs[i + 1 :]:
            for j, y1 in enumerate(ys):
                for y2 in ys[j + 1 :]:
                    corners = [place.get(c) for c in ((x1, y1), (x1, y2), (x2, y1), (x2, y2))]
                    area = (x2 - x1) * (y2 - y1)
                    if all(c is not None for c in corners) and (best is None or area > best[0]):
                        best = (area, [c for c in corners if c is not None])
    if best is None:
        raise GeometryError(
            "datum: the trapezoid needs four points at depth 0 on the corners of a rectangle along the tank"
        )
    by_x: dict[float, list[DatumPoint]] = {}
    for corner in best[1]:
        by_x.setdefault(corner.tank_m[0], []).append(corner)
    strings = [sorted(pair, key=lambda p: p.pixel_px[0]) for pair in by_x.values()]
    strings.sort(key=lambda pair: abs(pair[1].pixel_px[0] - pair[0].pixel_px[0]))
    ordered = [*strings[0], *strings[1]]
    far, near = strings
    pixel = np.array([p.pixel_px for p in ordered], dtype=float)
    drops = np.array([_drop(p, points, exact) for p in ordered])
    return (
        Trapezoid(
            corners_px=pixel,
            drops_px_per_m=drops,
            far_x_m=far[0].tank_m[0],
            near_x_m=near[0].tank_m[0],
            left_y_m=far[0].tank_m[1],
            right_y_m=far[1].tank_m[1],
        ),
        np.array([p.sigma_px for p in ordered]),
    )


def _drop(corner: DatumPoint, points: Sequence[DatumPoint], exact: ProjectiveMapping) -> Array:
    x, y, _ = corner.tank_m
    for point in points:
        if point.tank_m[2] > 0 and point.tank_m[:2] == (x, y):
            return (np.array(point.pixel_px) - np.array(corner.pixel_px)) / point.tank_m[2]
    low = exact.to_pixel(np.array([[x, y, 0.01]]))[0] - exact.to_pixel(np.array([[x, y, 0.0]]))[0]
    return low / 0.01


@dataclass(frozen=True)
class TrapezoidMapping:
    """The trapezoid behind the common interface; derivatives by central differences (it has no exact inverse).

    Attributes
    ----------
    trapezoid : corners and rectangle
    corner_sigma_px : (4,)
    exact : the camera matrix of the same datum, for tank -> pixel and homographies
    move_corners : see ``Trapezoid.place``
    """

    trapezoid: Trapezoid
    corner_sigma_px: Array
    exact: ProjectiveMapping
    move_corners: bool = False

    @property
    def method(self) -> str:
        """Name of the method."""
        return "trapezoid_corners" if self.move_corners else "trapezoid"

    def to_pixel(self, tank_m: Array) -> Array:
        """Tank -> pixel by the exact camera (the trapezoid's formulas run one way only)."""
        return self.exact.to_pixel(tank_m)

    def homography(self, depth_m: float) -> Array:
        """The exact homography at this depth."""
        return self.exact.homography(depth_m)

    def to_tank(self, pixel_px: Array, depth_m: float) -> Places:
        """Pixels ``(n, 2)`` -> places at ``depth_m``."""
        pixel = np.asarray(pixel_px, dtype=float).reshape(-1, 2)

        def place(trapezoid: Trapezoid, shifted: Array) -> Array:
            return trapezoid.place(shifted, depth_m, self.move_corners)

        per_px = np.stack(
            [
                (place(self.trapezoid, pixel + step) - place(self.trapezoid, pixel - step)) / (2 * _STEP_PX)
                for step in _STEP_PX * np.eye(2)
            ],
            axis=-1,
        )
        modes = []
        for corner in range(4):
            for axis in range(2):
                shift = np.zeros((4, 2))
                shift[corner, axis] = _STEP_PX
                up, down = (place(self._moved(sign * shift), pixel) for sign in (1, -1))
                modes.append((up - down) / (2 * _STEP_PX) * self.corner_sigma_px[corner])
        return Places(place(self.trapezoid, pixel), per_px, np.array(modes))

    def _moved(self, shift: Array) -> Trapezoid:
        t = self.trapezoid
        return Trapezoid(t.corners_px + shift, t.drops_px_per_m, t.far_x_m, t.near_x_m, t.left_y_m, t.right_y_m)
