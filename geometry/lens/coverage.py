"""Where in the picture the boards were, how well the lens is known there, and whether the working area lies inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...record.errors import GeometryError
from ..camera import Array, Lens
from .boards import BoardView
from .calibrate import Calibration

CELLS_ACROSS = 8
"""Of the grid in which views are counted, over the picture's width: a choice."""
ENOUGH_CORNERS = 3
"""A cell with that many corners is covered, and one whose middle lies inside the corners of a view."""


@dataclass(frozen=True)
class Coverage:
    """The picture in cells.

    Attributes
    ----------
    image_size_px : (width, height)
    corners : (rows, columns), how many corners of all used views lie in each cell
    covered : (rows, columns)
    sd_px : (rows, columns), how far the lens may be wrong in the middle of the cell, one coordinate, after the camera is turned as
        well as possible (a datum does that); NaN where the lens folds over
    """

    image_size_px: tuple[int, int]
    corners: Array
    covered: Array
    sd_px: Array

    @property
    def share(self) -> float:
        """Of the picture that is covered."""
        return float(self.covered.mean())

    def lines(self) -> list[str]:
        """The map as text: corners per cell, "." = none but inside a view, blank = not covered."""
        width = max(3, len(str(int(self.corners.max()))) + 1)
        rows = []
        for counts, inside in zip(self.corners, self.covered, strict=True):
            cells = [str(int(n)) if n else "." if c else "" for n, c in zip(counts, inside, strict=True)]
            rows.append("|" + "".join(f"{cell:>{width}}" for cell in cells) + " |")
        edge = "+" + "-" * (width * self.corners.shape[1] + 1) + "+"
        return [edge, *rows, edge]

    def sd_lines(self) -> list[str]:
        """``sd_px`` as text; in brackets where not covered."""
        rows = []
        for values, inside in zip(self.sd_px, self.covered, strict=True):
            cells = ["fold" if np.isnan(v) else f"{v:.2f}" if v < 100 else ">99" for v in values]
            rows.append(
                "|" + "".join(f" {cell} " if c else f"({cell})" for cell, c in zip(cells, inside, strict=True)) + "|"
            )
        edge = "+" + "-" * (len(rows[0]) - 2) + "+"
        return [edge, *rows, edge]


def coverage(calibration: Calibration) -> Coverage:
    """Cells, corners and accuracy of a calibration.

    Parameters
    ----------
    calibration : from ``calibrate``
    """
    size = calibration.image_size_px
    corners, covered = covered_cells(calibration.seen, size)
    return Coverage(size, corners, covered, mapping_sd_px(calibration.lens, calibration.covariance, size, covered))


def covered_cells(views: Sequence[BoardView], size: tuple[int, int]) -> tuple[Array, Array]:
    """Corners per cell, and which cells are covered, both (rows, columns).

    Parameters
    ----------
    views : of the board
    size : width and height of the picture, px
    """
    from scipy.spatial import ConvexHull

    columns, rows = _cells(size)
    places = np.concatenate([view.pixel_px for view in views])
    counts, _, _ = np.histogram2d(
        places[:, 1], places[:, 0], (rows, columns), ((-0.5, size[1] - 0.5), (-0.5, size[0] - 0.5))
    )
    inside = np.zeros(rows * columns, dtype=bool)
    middle = _middles(size)
    for view in views:
        hull = ConvexHull(view.pixel_px).equations
        inside |= (middle @ hull[:, :2].T + hull[:, 2] <= 0).all(1)
    return counts.astype(int), (counts >= ENOUGH_CORNERS) | inside.reshape(rows, columns)


def mapping_sd_px(lens: Lens, covariance: Array, size: tuple[int, int], covered: Array) -> Array:
    """How far the lens may be wrong in each cell, (rows, columns) px, one coordinate: sqrt of half the trace.

    A wrong principal point is mostly a turned camera, which the datum takes up: the turn that fits the covered cells best is taken
    off (as Hagemann et al., "Inferring bias and uncertainty in camera calibration", IJCV 2022, do in their expected mapping error).

    Parameters
    ----------
    lens : of the camera
    covariance : (9, 9) of the lens
    size : width and height of the picture, px
    covered : (rows, columns) of bool
    """
    middle = _middles(size)
    by_lens, by_turn = np.full((len(middle), 2, 9), np.nan), np.full((len(middle), 2, 3), np.nan)
    parts = [slice(None)]
    try:
        lens.normalise(middle)
    except GeometryError:  # folds over somewhere: which cells?
        parts = [slice(i, i + 1) for i in range(len(middle))]
    for part in parts:
        try:
            ideal, _ = lens.normalise(middle[part])
        except GeometryError:
            continue
        by_lens[part], by_turn[part] = _by_lens_and_turn(lens, ideal)
    used = covered.ravel() & np.isfinite(by_turn).all((1, 2))
    if not used.any():
        return np.full(covered.shape, np.nan)
    turn = np.linalg.lstsq(by_turn[used].reshape(-1, 3), by_lens[used].reshape(-1, 9), rcond=None)[0]
    rest = by_lens - by_turn @ turn
    variance = np.einsum("nka,ab,nkb->n", rest, covariance, rest) / 2
    return np.sqrt(np.maximum(variance, 0)).reshape(covered.shape)


def differ_px(one: Lens, other: Lens, size: tuple[int, int], covered: Array) -> float:
    """Largest distance, px, of two lenses over the covered cells, after the best turn of the camera.

    Parameters
    ----------
    one : a lens
    other : the lens that it is compared with
    size : width and height of the picture, px
    covered : (rows, columns), of ``Coverage``
    """
    middle = _middles(size)[covered.ravel()]
    ideal, _ = one.normalise(middle)
    _, by_turn = _by_lens_and_turn(one, ideal)
    gap = (other.distort(ideal) - one.distort(ideal)).ravel()
    turns = by_turn.reshape(-1, 3)
    rest = gap - turns @ np.linalg.lstsq(turns, gap, rcond=None)[0]
    return float(np.linalg.norm(rest.reshape(-1, 2), axis=1).max())


def uncovered(found: Coverage, box_px: tuple[float, float, float, float]) -> list[str]:
    """Which parts of a box (left, top, right, bottom) px lie in cells that are not covered, in words; empty = none.

    Parameters
    ----------
    found : from ``coverage``
    box_px : left, top, right, bottom
    """
    rows, columns = found.covered.shape
    width, height = found.image_size_px
    left, top, right, bottom = box_px
    first, last = (_cell(x, width, columns) for x in (left, right))
    upper, lower = (_cell(y, height, rows) for y in (top, bottom))
    said: list[str] = []
    for row in range(upper, lower + 1):
        for column in range(first, last + 1):
            if found.covered[row, column]:
                continue
            vertical = _side(row, upper, lower, "top", "bottom")
            across = _side(column, first, last, "left", "right")
            word = f"{vertical} {across} corner" if vertical and across else f"{vertical or across} side"
            if not vertical and not across:
                word = "middle"
            if word not in said:
                said.append(word)
    return said


def _side(at: int, first: int, last: int, low: str, high: str) -> str:
    if first == last:
        return ""
    return low if at == first else high if at == last else ""


def _cells(size: tuple[int, int]) -> tuple[int, int]:
    return CELLS_ACROSS, max(2, round(CELLS_ACROSS * size[1] / size[0]))


def _cell(at_px: float, length_px: int, cells: int) -> int:
    return int(np.clip(np.floor((at_px + 0.5) / length_px * cells), 0, cells - 1))


def _middles(size: tuple[int, int]) -> Array:
    """Middles of the cells, (rows * columns, 2) px."""
    columns, rows = _cells(size)
    u = (np.arange(columns) + 0.5) * size[0] / columns - 0.5
    v = (np.arange(rows) + 0.5) * size[1] / rows - 0.5
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _by_lens_and_turn(lens: Lens, ideal: Array) -> tuple[Array, Array]:
    """Derivatives of the pixels of given directions by the lens (n, 2, 9) and by a turn of the camera (n, 2, 3)."""
    _, by_ideal, by_lens = lens.slopes(ideal)
    x, y = ideal.T
    turn = np.empty((len(ideal), 2, 3))
    turn[:, 0] = np.column_stack([-x * y, 1 + x * x, -y])
    turn[:, 1] = np.column_stack([-1 - y * y, x * y, x])
    return by_lens, by_ideal @ turn
