"""A printed square tag in a picture: its whole pattern, border and code, fitted at once by Gauss-Newton.

Known are the tag's cells. Sought are the eight numbers of the plane's projection, the blur, the camera's tone curve, light that
falls off over the tag, and the brightness around it. Every edge of the pattern counts, not the four outer ones alone, and a
border so thin that its two edges run into each other is no trouble, because both are modelled. The centre is the image of the
tag's middle: where the diagonals of the fitted corners meet. That is the projective centre of the square; the mean of the corners
or of the area is not.

On 1200 rendered views (side 24-60 px, contrast 150, noise 3, blur 0.7-1.2 px) the centre is off by 0.005 px rms, against
0.02-0.04 px for lines fitted to the four edges, and 0.07-0.27 px for OpenCV's corner refinements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Lens
from ..record.errors import GeometryError
from .tag_view import (
    SQUARE,
    Array,
    Pixels,
    Template,
    bend,
    blur_samples,
    chosen_pixels,
    half_side_px,
    inside,
    lens_curve,
    middle_px,
    narrow_px,
    project,
    rendered,
    samples_per_unit,
    seen_pixels,
)

RIM_PX, RIM_SPREADS, LEAST_RIM_CELLS = 3.0, 1.7, 0.35
"""Pixels so far outside the tag take part; less where the end of a quiet zone one cell wide would show, but so many cells."""
START_SPREAD_PX, LEAST_SPREAD_PX, MOST_SPREAD_PX = 1.0, 0.45, 4.0
"""Standard deviation of blur and pixel together: at first, and its limits."""
LEAST_AROUND, MOST_AROUND = 0.05, 3.0
"""Brightness around the tag, black cell = 0, white cell = 1."""
STALE = 0.05
"""A template serves until blur or shape have changed by this share; the fit carries the rest to first order."""
CLEAR_CHANGE, SMALL_CHANGE_GAIN = 0.2, 0.3
"""A change of the blur's variance above the first share is taken in full, below by the second: smaller ones are
mostly noise."""
ROUNDS = 10
"""Gauss-Newton steps at most."""
SETTLED_PX, NEARLY_SETTLED_PX, NEAR_PX = 0.05, 0.1, 0.2
"""A Gauss-Newton step below the first is the last: what it leaves is of second order. After the last round the second will do;
below the third the blur is believed."""
LONGEST_STEP_PX = 2.0
"""A step that moves a corner farther is shortened to this: beyond, the picture is not linear in the pose."""
FARTHEST_CELLS = 1.5
"""A fit that leaves its start by more is another place's."""
LEAST_CONTRAST_DN, LEAST_CELL_PX = 8.0, 1.5
"""White over black, and the side of a cell: with less there is nothing to hold on to. Choices."""
LARGEST_RESIDUAL = 0.2
"""Root mean square over the contrast."""
CELL_RESIDUAL, CHANCE_SD, LEAST_CELL_PIXELS = 0.12, 2.0, 3
"""A cell whose mean is off by this share of the contrast beyond chance is covered, mirrors a lamp, or is another tag's."""
READABLE_RESIDUAL = 0.35
"""Up to here a cell's mean stands clearly nearer to its own colour than to the other: worn or glaring, it can be read."""
SPLIT_CELL_PX = 5.0
"""Cells so large are looked at in quarters."""
GRAM_PIXELS = 768
"""Columns of one product: few enough that BLAS stays on one thread."""
_MOTION = 8
"""Columns of the design that move the tag: the eight numbers of a homography."""
_RIDGE = 1e-9
"""Keeps the scaled normal matrix invertible where a column is empty: of the size of its rounding."""


@dataclass(frozen=True)
class TagFit:
    """A tag in a picture.

    Attributes
    ----------
    to_px : (3, 3), the tag's square [-1, 1]^2 -> pixels; with a lens, pixels made straight about the centre
    covariance_px2 : (2, 2), of the centre, from the scatter of the fit's residuals; where not ``whole``, from their sums by cells
    contrast_dn : white cells above black ones
    residual : root mean square over the contrast
    worst_cell : largest mean residual of a cell, beyond chance, over the contrast
    settled : the iteration came to its end
    curve : (2, 3), of the lens, see ``lens_curve``
    motion_covariance_px2 : (8, 8), of the last step's motion (``_design``)
    """

    to_px: Array
    covariance_px2: Array
    contrast_dn: float
    residual: float
    worst_cell: float
    settled: bool
    curve: Array
    motion_covariance_px2: Array

    @property
    def corner_sigma_px(self) -> Array:
        """(4, 2), standard deviations of ``corners_px`` from the scatter of the fit's residuals."""
        x, y = ((project(self.to_px, SQUARE) - self.centre_px) / half_side_px(self.to_px)).T
        one, no = np.ones(4), np.zeros(4)
        along_u = np.stack([one, no, x, y, no, no, x * x, x * y], axis=1)
        along_v = np.stack([no, one, no, no, x, y, x * y, y * y], axis=1)
        design = np.stack([along_u, along_v], axis=1)
        return np.sqrt(np.einsum("cai,ij,caj->ca", design, self.motion_covariance_px2, design))

    @property
    def centre_px(self) -> Array:
        """(2,), where the diagonals meet."""
        return middle_px(self.to_px)

    @property
    def corners_px(self) -> Array:
        """(4, 2), in the order of ``SQUARE``."""
        scale = half_side_px(self.to_px)
        straight = (project(self.to_px, SQUARE) - self.centre_px) / scale
        bent = straight - bend(self.curve, *straight.T).T
        return self.centre_px + scale * (straight - bend(self.curve, *bent.T).T)

    @property
    def whole(self) -> bool:
        """All of the pattern is there, and nothing else."""
        return self.readable and self.worst_cell <= CELL_RESIDUAL

    @property
    def readable(self) -> bool:
        """Every cell has its colour; wear, glare or a thin thing in front may lie over it."""
        return (
            self.settled
            and self.contrast_dn >= LEAST_CONTRAST_DN
            and self.residual <= LARGEST_RESIDUAL
            and self.worst_cell <= READABLE_RESIDUAL
        )


@dataclass(frozen=True)
class _Step:
    """One Gauss-Newton step: its solution, what is left of the residuals (n,), and the motion's covariance (8, 8).

    ``pull (8, n)`` is how far each residual pulls the motion.
    """

    motion_px: Array
    wider_px2: float
    around: float
    contrast_dn: float
    left_dn: Array
    covariance_px2: Array
    pull: Array


class Tag:
    """One tag: its cells, and how blurred it was last.

    Parameters
    ----------
    cells : (m, m), 1 white, 0 black, border included
    white_dn : value at which the picture is clipped
    lens : of the camera; without it the picture is taken as free of distortion. A lens bends the tag's sides: at k1 = -0.3, 600 px
        from the middle of a picture of f = 1100 px, the centre of a tag of 60 px goes off by 0.09 px
    """

    def __init__(self, cells: Array, white_dn: float = 255.0, lens: Lens | None = None) -> None:
        self.cells, self.white_dn, self.lens = cells.astype(np.float32), white_dn, lens
        self.spread_px2, self.around = START_SPREAD_PX**2, 1.0
        self._template: Template | None = None

    def fit(self, luma: NDArray[np.uint8], to_px: Array) -> TagFit | None:
        """Fit the tag from a start that is off by less than about half a cell.

        Parameters
        ----------
        luma : (h, w)
        to_px : (3, 3), the start

        Returns
        -------
        TagFit, or None where the fit left the picture or its start. Whether the tag is all there, the fit's ``whole`` says
        """
        before = self.spread_px2, self.around
        try:
            fit = self._fit(luma, to_px)
        except GeometryError:  # the lens model folds over there
            fit = None
        if fit is None or not fit.whole:
            self.spread_px2, self.around = before
        return fit

    def _fit(self, luma: NDArray[np.uint8], to_px: Array) -> TagFit | None:
        start, moved = middle_px(to_px), np.inf
        chosen, curve = None, np.zeros((2, 3))
        for turn in range(1, ROUNDS + 1):
            cell_px = narrow_px(to_px) / len(self.cells)
            if cell_px < LEAST_CELL_PX or not inside(project(to_px, SQUARE), luma.shape):
                return None
            template = self._prepared(to_px, cell_px)
            # near the end the same pixels take part: the fit does not settle while some come and go
            if chosen is None or moved > NEAR_PX:
                chosen = chosen_pixels(luma, to_px, self._rim(cell_px))
                curve = lens_curve(self.lens, to_px)
            pixels = seen_pixels(chosen, to_px, curve)
            step = _step(pixels, template, self.white_dn)
            if step is None:
                return None
            to_px, moved = _moved(to_px, step.motion_px, pixels)
            if not np.hypot(*(middle_px(to_px) - start)) < FARTHEST_CELLS * cell_px:
                return None
            # a tag out of place looks blurred
            if moved < NEAR_PX:
                self._learn(step, template)
            if (moved < SETTLED_PX and self._serves(template, to_px)) or turn == ROUNDS:
                parts = 2 if cell_px >= SPLIT_CELL_PX else 1
                worst, spread = _worst_cell(step.left_dn, pixels.tag, parts * len(self.cells))
                contrast = step.contrast_dn
                settled = moved < NEARLY_SETTLED_PX
                left = spread / contrast, worst / contrast
                covariance = step.covariance_px2
                if left[1] > CELL_RESIDUAL:
                    covariance = _by_cells(step, pixels.tag, len(self.cells))
                return TagFit(to_px, covariance[:2, :2], contrast, *left, settled, curve, covariance)
        return None

    def _rim(self, cell_px: float) -> float:
        """How far outside the tag pixels take part, tag units: not where the quiet zone's own end shows."""
        rim_px = min(RIM_PX, max(cell_px - RIM_SPREADS * float(np.sqrt(self.spread_px2)), LEAST_RIM_CELLS * cell_px))
        return 2.0 * rim_px / (cell_px * len(self.cells))

    def _learn(self, step: _Step, template: Template) -> None:
        before, wider = template.spread_px2, step.wider_px2
        # small changes are mostly noise, and the fit carries them anyway
        share = 1.0 if abs(wider) > CLEAR_CHANGE * before else SMALL_CHANGE_GAIN
        after = before + share * np.clip(wider, -0.4 * before, 0.8 * before)
        self.spread_px2 = float(np.clip(after, LEAST_SPREAD_PX**2, MOST_SPREAD_PX**2))
        self.around = float(np.clip(template.around + step.around, LEAST_AROUND, MOST_AROUND))

    def _serves(self, template: Template, to_px: Array) -> bool:
        off = np.abs(blur_samples(to_px, self.spread_px2, template.per_unit) - template.blur).max()
        return bool(off < STALE * np.trace(template.blur) and abs(self.around - template.around) < STALE)

    def _prepared(self, to_px: Array, cell_px: float) -> Template:
        if self._template is None or not self._serves(self._template, to_px):
            per_unit = samples_per_unit(len(self.cells), cell_px)
            blur = blur_samples(to_px, self.spread_px2, per_unit)
            self._template = rendered(self.cells, blur, per_unit, self.spread_px2, self.around)
        return self._template


def _design(pixels: Pixels, contrast: float, layers: Array, around: Array) -> Array:
    """Derivatives of the model by its parameters (17, n): motion in px, light, blur, tone curve, brightness around."""
    value, slope_p, slope_q, wider = layers.T
    (p_x, p_y), (q_x, q_y) = pixels.slopes
    x, y = pixels.x, pixels.y
    # where the pattern goes by d, the picture changes by -slope d
    m_x, m_y = -contrast * (slope_p * p_x + slope_q * q_x), -contrast * (slope_p * p_y + slope_q * q_y)
    swell = m_x * x + m_y * y
    design = np.empty((17, len(x)), np.float32)
    for row, column in enumerate((m_x, m_y, m_x * x, m_x * y, m_y * x, m_y * y, swell * x, swell * y)):
        design[row] = column
    design[8], design[9], design[10], design[11] = 1.0, x, y, value
    design[12], design[13] = value * x, value * y
    design[14] = contrast * wider
    # a camera's gamma shifts edges by more than half a pixel; ink that spreads acts much the same
    design[15] = contrast * value * (1 - value)
    design[16] = contrast * around
    return design


def _step(pixels: Pixels, template: Template, white_dn: float) -> _Step | None:
    """One Gauss-Newton step, or None where there is nothing to hold on to."""
    import cv2

    u, v = (((t + 1) * template.per_unit + template.origin)[None] for t in pixels.tag)
    layers = cv2.remap(template.layers, u, v, cv2.INTER_LINEAR)[0]
    around = cv2.remap(template.outside, u, v, cv2.INTER_LINEAR).ravel()
    observed = pixels.value_dn
    value = layers[:, 0] - layers[:, 0].mean()
    contrast = float(value @ observed / max(float(value @ value), 1e-9))
    if contrast < LEAST_CONTRAST_DN:
        return None
    design = _design(pixels, contrast, layers, around)
    # a clipped pixel says only that it was at least so bright
    used = observed < white_dn - 0.5
    part, seen = (design, observed) if used.all() else (design[:, used], observed[used])
    freedom = part.shape[1] - len(part)
    if freedom <= 0:
        return None
    normal = _gram(part)
    unit = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-6))
    inverse = np.linalg.inv(normal * np.outer(unit, unit) + _RIDGE * np.eye(len(unit))) * np.outer(unit, unit)
    solution = inverse @ (part @ seen).astype(float)
    left = observed - np.minimum(solution.astype(np.float32) @ design, white_dn)
    variance = float(np.sum(left[used] ** 2)) / freedom
    pull = inverse[:_MOTION] @ np.where(used, design, 0.0)
    covariance = variance * inverse[:_MOTION, :_MOTION]
    return _Step(solution[:_MOTION], solution[14], solution[16], solution[11], left, covariance, pull)


def _gram(rows: Array) -> Array:
    """rows @ rows.T, in pieces so small that BLAS does not wake its threads: that costs more than the product."""
    total = np.zeros((len(rows), len(rows)))
    for first in range(0, rows.shape[1], GRAM_PIXELS):
        piece = rows[:, first : first + GRAM_PIXELS]
        total += piece @ piece.T
    return total


def _moved(to_px: Array, motion_px: Array, pixels: Pixels) -> tuple[Array, float]:
    """The homography after a step (held to ``LONGEST_STEP_PX``), and how far its farthest corner went, px."""
    t_x, t_y, xx, xy, yx, yy, p_x, p_y = motion_px / pixels.scale_px
    reach = float(np.abs(motion_px).max()) / LONGEST_STEP_PX
    step = np.array([[xx, xy, t_x], [yx, yy, t_y], [-p_x, -p_y, 0.0]]) / max(reach, 1.0)
    frame = np.array(
        [[pixels.scale_px, 0, pixels.centre_px[0]], [0, pixels.scale_px, pixels.centre_px[1]], [0, 0, 1.0]]
    )
    after = frame @ (np.eye(3) + step) @ np.linalg.inv(frame) @ to_px
    return after / after[2, 2], float(np.abs(project(after, SQUARE) - project(to_px, SQUARE)).max())


def _cell_of(tag: tuple[Array, Array], cells: int) -> Array:
    """The cell in which each pixel lies (n,), those just outside the tag counted too."""
    side = cells + 2
    column, row = (np.clip(((t + 1) * cells / 2 + 1).astype(np.intp), 0, side - 1) for t in tag)
    return row * side + column


def _by_cells(step: _Step, tag: tuple[Array, Array], cells: int) -> Array:
    """The motion's covariance (8, 8) where what is left of the residuals goes together within a cell: wear, glare."""
    side, cell = cells + 2, _cell_of(tag, cells)
    pulled = np.stack([np.bincount(cell, row * step.left_dn, minlength=side**2) for row in step.pull])
    return pulled @ pulled.T * (side**2 / (side**2 - len(step.pull)))


def _worst_cell(left_dn: Array, tag: tuple[Array, Array], cells: int) -> tuple[float, float]:
    """The largest mean residual of a cell (those just outside too) beyond what noise makes of a mean, and the rms of all."""
    side, cell = cells + 2, _cell_of(tag, cells)
    count = np.maximum(np.bincount(cell, minlength=side**2), 1)
    spread = float(np.sqrt(np.mean(left_dn**2)))
    excess = np.abs(np.bincount(cell, left_dn, minlength=side**2) / count) - CHANCE_SD * spread / np.sqrt(count)
    return float(excess[count >= LEAST_CELL_PIXELS].max(initial=0.0)), spread
