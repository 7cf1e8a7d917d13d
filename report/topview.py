"""The picture as seen from straight above: one plane below the datum, to scale, by one lookup of every pixel.

The map from top view to picture goes through the whole camera, lens included; it is computed once for a clip. The top view lies
as the tank axes do: x (ahead) to the right, y (starboard) downwards, seen from above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Array
from ..geometry.mapping import ProjectiveMapping
from ..record.errors import GeometryError
from ..record.schema import DatumPoint
from ..vision.overlay import write_text

LARGEST_PX = 4000
"""Of a side of a top view."""
MARGIN = 0.04
"""Added around what is to be seen, as a share of its extent."""
FINEST_MM = 0.1
"""No picture is finer than this to the pixel."""
INK = (255, 255, 255)
"""White, over a black rim."""
TICK_PX, TICKS = 7, 8
"""Length of a tick, and about how many the longer side gets."""
_BORDER_POINTS = 60
"""Points to a side of the picture's border that are projected: the lens bends it."""
_SAMPLES = 12
"""Points along either side of the area at which the scale is judged: a choice."""


@dataclass(frozen=True)
class Area:
    """A rectangle in a plane of the tank.

    Attributes
    ----------
    x_m, y_m : from and to, tank axes
    depth_m : of the plane, below the datum
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    depth_m: float

    def __post_init__(self) -> None:
        for name, (low, high) in (("x", self.x_m), ("y", self.y_m)):
            if not (np.isfinite([low, high]).all() and low < high):
                raise GeometryError(f"area: {name} from {low:g} to {high:g} m; the second must be the larger")

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent along x and along y."""
        return self.x_m[1] - self.x_m[0], self.y_m[1] - self.y_m[0]

    def points(self, along_x: int = _SAMPLES, along_y: int = _SAMPLES) -> Array:
        """A lattice over it, ``(n, 3)`` m."""
        x, y = np.meshgrid(np.linspace(*self.x_m, along_x), np.linspace(*self.y_m, along_y))
        return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, self.depth_m)])


def area_around(points: Sequence[DatumPoint], depth_m: float, marks_m: Array | None = None) -> Area:
    """The upright rectangle around the datum points' and the marks' places ``(n, 2)`` m, with a margin.

    Parameters
    ----------
    points : of the datum
    depth_m : of the plane
    marks_m : (n, 2) places of the marks, or None
    """
    places = np.array([p.tank_m[:2] for p in points], dtype=float).reshape(-1, 2)
    if marks_m is not None:
        places = np.concatenate([places, marks_m[np.isfinite(marks_m).all(axis=1)]])
    low, high = places.min(axis=0), places.max(axis=0)
    rim = MARGIN * (high - low)
    (x0, y0), (x1, y1) = (low - rim).tolist(), (high + rim).tolist()
    return Area((x0, x1), (y0, y1), depth_m)


def pixels_of(mapping: ProjectiveMapping, tank_m: Array, size_px: tuple[int, int]) -> Array:
    """Where tank points ``(n, 3)`` stand in a picture of ``size_px`` (w, h): ``(n, 2)`` px, NaN where they do not.

    A lens model bends points far outside the picture back into it; they are left out too.

    Parameters
    ----------
    mapping : pixel -> tank
    tank_m : (n, 3)
    size_px : width and height of the picture
    """
    size = np.array(size_px)
    seen = np.column_stack([tank_m, np.ones(len(tank_m))]) @ mapping.matrix.T
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.hypot(*(seen[:, :2] / seen[:, 2:]).T)
        pixel = mapping.to_pixel(tank_m)
    with np.errstate(invalid="ignore"):
        inside = (seen[:, 2] > 0) & ((pixel >= -0.5) & (pixel <= size - 0.5)).all(axis=1)
    return np.where((inside & (away <= _reach(mapping, size_px)))[:, None], pixel, np.nan)


def _reach(mapping: ProjectiveMapping, size_px: tuple[int, int]) -> float:
    """The largest ideal radius in the picture, as far out as the lens has an inverse."""
    along = np.linspace(-0.5, 0.5, _BORDER_POINTS)
    half = np.full(_BORDER_POINTS, 0.5)
    sides = [(along, -half), (along, half), (-half, along), (half, along)]
    border = np.concatenate([np.column_stack(side) for side in sides])
    middle = (np.array(size_px) - 1) / 2
    for share in np.arange(1.0, 0.15, -0.05):
        try:
            ideal = mapping.lens.normalise(middle + share * border * size_px)[0]
        except GeometryError:
            continue
        return float(np.hypot(*ideal.T).max()) * (1 + 1e-9)
    raise GeometryError("camera.distortion: the lens model folds over everywhere in the picture")


def round_step(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))


def default_mm_per_px(mapping: ProjectiveMapping, area: Area, size_px: tuple[int, int]) -> float:
    """As fine as the picture is in its finer direction (median over the area), rounded to 1, 2, 5.

    Parameters
    ----------
    mapping : pixel -> tank
    area : rectangle of one plane in the tank
    size_px : width and height of the picture

    Raises
    ------
    GeometryError : nothing of the area stands in the picture
    """
    pixel = pixels_of(mapping, area.points(), size_px)
    pixel = pixel[np.isfinite(pixel).all(axis=1)]
    if not len(pixel):
        raise GeometryError(
            f"area: x {area.x_m[0]:g} .. {area.x_m[1]:g} m, y {area.y_m[0]:g} .. {area.y_m[1]:g} m at depth "
            f"{area.depth_m:g} m lies outside the picture"
        )
    scale = 1e3 * np.linalg.svd(mapping.to_tank(pixel, area.depth_m).per_px, compute_uv=False)[:, 1]
    least = 1e3 * max(area.size_m) / LARGEST_PX
    return max(round_step(float(np.median(scale))), 2 * round_step(least), FINEST_MM)


@dataclass(frozen=True)
class TopView:
    """A view from above.

    Attributes
    ----------
    area : what it shows
    mm_per_px : its scale
    map_px : (h, w, 2) float32, the place in the picture of every pixel of the top view; far outside where it is not seen
    """

    area: Area
    mm_per_px: float
    map_px: NDArray[np.float32]

    def place_px(self, xy_m: Array) -> Array:
        """Tank ``(n, 2)`` m -> pixels of the top view ``(n, 2)``, integers at pixel centres."""
        return (np.asarray(xy_m) - [self.area.x_m[0], self.area.y_m[0]]) * (1e3 / self.mm_per_px) - 0.5

    def place_m(self, pixel_px: Array) -> Array:
        """Pixels of the top view ``(n, 2)`` -> tank ``(n, 2)`` m."""
        return (np.asarray(pixel_px) + 0.5) * (self.mm_per_px / 1e3) + [self.area.x_m[0], self.area.y_m[0]]

    @cached_property
    def seen_share(self) -> float:
        """How much of the area stands in the picture."""
        return float((self.map_px[..., 0] > -1).mean())

    def look(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The picture ``(h, w)`` or ``(h, w, 3)`` from above; black where it shows nothing."""
        import cv2

        # cubic: linear interpolation would blur edges by up to half a pixel's width
        how = cv2.INTER_CUBIC
        seen = cv2.remap(picture, self.map_px, np.empty(0), how, borderMode=cv2.BORDER_REPLICATE)
        seen[self.map_px[..., 0] <= -1] = 0
        return np.asarray(seen, dtype=np.uint8)

    def annotated(self, picture: NDArray[np.uint8], caption: str = "") -> NDArray[np.uint8]:
        """``look`` with ticks in metres along the upper and left edge, and a caption."""
        import cv2

        canvas = self.look(picture)
        step = round_step(max(self.area.size_m) / TICKS)
        for axis, limits in enumerate((self.area.x_m, self.area.y_m)):
            for value in multiples(limits, step):
                at = round(float(self.place_px(np.full((1, 2), value))[0, axis]))
                ends = ((at, 0), (at, TICK_PX)) if axis == 0 else ((0, at), (TICK_PX, at))
                for ink, thick in (((0, 0, 0), 3), (INK, 1)):
                    cv2.line(canvas, ends[0], ends[1], ink, thick)
                text = f"{value:.{decimals(step)}f}"
                write_text(canvas, text, (at + 3, TICK_PX + 12) if axis == 0 else (TICK_PX + 4, at + 4), INK, 0.4)
        write_text(canvas, caption, (8, canvas.shape[0] - 8), INK)
        return canvas


def top_view(
    mapping: ProjectiveMapping, area: Area, size_px: tuple[int, int], mm_per_px: float | None = None
) -> TopView:
    """Lay out a top view of a picture of ``size_px`` (w, h).

    Parameters
    ----------
    mapping : pixel -> tank
    area : rectangle of one plane in the tank
    size_px : width and height of the picture
    mm_per_px : scale; None: the default

    Raises
    ------
    GeometryError : the area lies outside the picture, or the scale would make the view larger than LARGEST_PX
    """
    finest = default_mm_per_px(mapping, area, size_px)
    scale = finest if mm_per_px is None else mm_per_px
    if not scale > 0:
        raise GeometryError(f"mm-per-px = {scale:g}; must be above 0")
    width, height = (max(1, round(1e3 * side / scale)) for side in area.size_m)
    if max(width, height) > LARGEST_PX:
        raise GeometryError(
            f"mm-per-px = {scale:g} makes a picture of {width} x {height}; at most {LARGEST_PX} on a side, "
            f"so {1e3 * max(area.size_m) / LARGEST_PX:.2g} or more"
        )
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    place = (np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) * (scale / 1e3) + [area.x_m[0], area.y_m[0]]
    pixel = pixels_of(mapping, np.column_stack([place, np.full(len(place), area.depth_m)]), size_px)
    pixel = np.where(np.isfinite(pixel), pixel, -1e4)
    return TopView(area, scale, np.ascontiguousarray(pixel.reshape(height, width, 2), dtype=np.float32))


def multiples(limits: tuple[float, float], step: float) -> list[float]:
    """Multiples of ``step`` within the limits.

    Parameters
    ----------
    limits : lower and upper
    step : between two
    """
    low, high = limits
    return [step * k for k in range(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)]


def decimals(step: float) -> int:
    """Digits after the point that a multiple of ``step`` needs."""
    return max(0, -int(np.floor(np.log10(step) + 1e-9)))
