"""A scale drawn on a frame: lines of equal x and y in one plane of the tank, through the true lens, and the datum's residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Array
from ..geometry.mapping import ProjectiveMapping
from ..record.schema import DatumPoint
from ..vision.overlay import write_text
from .topview import Area, decimals, multiples, pixels_of, round_step

LINES = 8
"""About so many along the longer side."""
SAMPLES = 400
"""Points of a line; between them it is straight."""
ARROW_PX, MOST_ENLARGED = 50.0, 1000.0
"""The largest residual's arrow is at most so long; no residual is enlarged more."""
X_INK, Y_INK, PICK_INK, ARROW_INK = (255, 220, 120), (140, 255, 160), (255, 255, 255), (60, 200, 255)
"""Colours, BGR: lines of equal x and y, picks, and the arrows of their residuals."""
_SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates: sixteenths of a pixel."""


@dataclass(frozen=True)
class GridLine:
    """A line of equal x or y.

    Attributes
    ----------
    axis : "x" or "y": which of them is the same all along it
    value_m : that coordinate
    pixel_px : (n, 2), NaN where it leaves the picture
    """

    axis: str
    value_m: float
    pixel_px: Array


def grid_lines(
    mapping: ProjectiveMapping, area: Area, size_px: tuple[int, int], step_m: float | None = None
) -> tuple[list[GridLine], float]:
    """Lines through the multiples of ``step_m`` (default: about LINES of them), and the step.

    Parameters
    ----------
    mapping : pixel -> tank
    area : rectangle of one plane in the tank
    size_px : width and height of the picture
    step_m : between lines; None: a round one
    """
    step = round_step(max(area.size_m) / LINES) if step_m is None else step_m
    lines = []
    for axis, limits, other in (("x", area.x_m, area.y_m), ("y", area.y_m, area.x_m)):
        run = np.linspace(*other, SAMPLES)
        for value in multiples(limits, step):
            fixed = np.full(SAMPLES, value)
            pair = (fixed, run) if axis == "x" else (run, fixed)
            place = np.column_stack([*pair, np.full(SAMPLES, area.depth_m)])
            lines.append(GridLine(axis, value, pixels_of(mapping, place, size_px)))
    return lines, step


def draw_grid(
    picture: NDArray[np.uint8],
    mapping: ProjectiveMapping,
    area: Area,
    datum: Sequence[DatumPoint] = (),
    residual_px: Array | None = None,
    caption: str = "",
) -> NDArray[np.uint8]:
    """Return a copy of ``picture (h, w, 3)`` BGR with the grid, the datum's picks and their residuals.

    Parameters
    ----------
    picture : (h, w, 3) uint8, BGR
    mapping : pixel -> tank
    area : rectangle of one plane in the tank
    datum : points that are crossed
    residual_px : (n, 2) of the datum points, picked minus projected; drawn from the pick on, enlarged
    caption : line at the foot
    """
    import cv2

    canvas = picture.copy()
    lines, step = grid_lines(mapping, area, (picture.shape[1], picture.shape[0]))
    for line in lines:
        for part in _parts(line.pixel_px):
            points = np.rint(part * (1 << _SHIFT)).astype(np.int32).reshape(-1, 1, 2)
            cv2.polylines(canvas, [points], False, X_INK if line.axis == "x" else Y_INK, 1, cv2.LINE_AA, _SHIFT)
    for line in lines:
        _label(canvas, line, decimals(step))
    enlarged = None if residual_px is None else enlargement(residual_px)
    for k, point in enumerate(datum):
        pick = np.array(point.pixel_px, dtype=float)
        cv2.circle(canvas, _fixed(pick), 6 << _SHIFT, PICK_INK, 1, cv2.LINE_AA, _SHIFT)
        if residual_px is not None and enlarged and enlarged * np.hypot(*residual_px[k]) >= 1:
            tip = pick + enlarged * residual_px[k]
            for ink, thick in (((0, 0, 0), 4), (ARROW_INK, 2)):
                start, end = (tuple(round(float(c)) for c in place) for place in (pick, tip))
                cv2.arrowedLine(canvas, start, end, ink, thick, cv2.LINE_AA, 0, 0.25)  # pyright: ignore
        write_text(canvas, point.name or f"point {k + 1}", (round(pick[0]) + 9, round(pick[1]) - 7), PICK_INK, 0.4)
    foot = f"z = {area.depth_m:g} m, every {step:g} m"
    if enlarged:
        foot += f"; arrows: picked minus projected, {enlarged:g} x"
    write_text(canvas, "  ".join(filter(None, (caption, foot))), (8, canvas.shape[0] - 8), PICK_INK)
    return canvas


def enlargement(residual_px: Array) -> float | None:
    """By how much residuals ``(n, 2)`` are drawn larger (1, 2, 5 times a power of ten); None where they are all zero."""
    largest = float(np.hypot(*np.asarray(residual_px).T).max(initial=0.0))
    if largest < ARROW_PX / MOST_ENLARGED / 50:
        return None
    return max(1.0, round_step(min(ARROW_PX / largest, MOST_ENLARGED)))


def _parts(pixel_px: Array) -> list[Array]:
    """The unbroken pieces of a line, of two points or more."""
    seen = np.isfinite(pixel_px).all(axis=1)
    cuts = np.flatnonzero(np.diff(seen.astype(int))) + 1
    return [part for part in np.split(pixel_px, cuts) if len(part) > 1 and np.isfinite(part[0]).all()]


def _label(canvas: NDArray[np.uint8], line: GridLine, digits: int) -> None:
    """The line's value at the end that is nearer to the picture's lower edge (x) or at its lower end (y)."""
    parts = _parts(line.pixel_px)
    if not parts:
        return
    ends = np.concatenate([parts[0][:1], parts[-1][-1:]])
    place = ends[np.argmax(ends[:, 0])] if line.axis == "x" else ends[np.argmax(ends[:, 1])]
    height, width = canvas.shape[:2]
    shift = (4, -3) if line.axis == "x" else (-12, 14)
    corner = (
        int(np.clip(round(place[0]) + shift[0], 2, width - 52)),
        int(np.clip(round(place[1]) + shift[1], 12, height - 26)),
    )
    write_text(canvas, f"{line.axis} {line.value_m:.{digits}f}", corner, X_INK if line.axis == "x" else Y_INK, 0.38)


def _fixed(place: Array) -> tuple[int, int]:
    return round(float(place[0]) * (1 << _SHIFT)), round(float(place[1]) * (1 << _SHIFT))
