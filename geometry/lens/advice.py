"""What a calibration does not tell, in sentences that say what to do about it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...record.errors import GeometryError
from ..camera import Lens
from .boards import BoardView
from .calibrate import LEAST_SHAPED_VIEWS, Calibration
from .coverage import Coverage, differ_px
from .fit import JointFit, joint_fit
from .model import COEFFICIENTS, PARAMETERS, free_basis, nearest
from .scatter import view_scatter

TOLD_SDS = 2.0
"""A coefficient nearer to zero than this many of its standard deviations is not told by the data (5 % of true zeros pass)."""
ILL_CONDITION = 1e6
"""Condition number of the correlation matrix from which the views are said to fix the lens weakly: a choice."""
FEW_VIEWS = 10
"""Fewer views than this are called few: a choice, well below the 15 to 30 that the sentence asks for."""
FOCAL_SHARE = 0.01
"""A focal length known worse than this is called weak."""
SHAPE_SHARE = 5e-4
"""A board whose corners lie off by more than this share of a square is called out: print and glue do better."""


def advice(calibration: Calibration, found: Coverage) -> list[str]:
    """Sentences on the coefficients, the views and the board.

    Parameters
    ----------
    calibration : from ``calibrate``
    found : from ``coverage``
    """
    free = int((calibration.fit.basis[4:] != 0).any(1).sum())
    square = bool((calibration.fit.basis[0] == calibration.fit.basis[1]).all())
    return [
        *_weak(calibration),
        *_board(calibration),
        *_coefficients(calibration, found, free, square),
        *_pixels(calibration, square),
    ]


def _weak(calibration: Calibration) -> list[str]:
    said = []
    used = sum(view.used for view in calibration.views)
    if used < FEW_VIEWS:
        said.append(f"only {used} views are used; with 15 to 30 both the lens and its errors are known better")
    share = calibration.sd[0] / calibration.lens.fx_px
    if share > FOCAL_SHARE or calibration.condition > ILL_CONDITION:
        said.append(
            f"the views fix the lens weakly (focal length to {100 * share:.1f} %, condition {calibration.condition:.1e}): "
            "add views with the board tilted by 30 to 45 degrees about both of its sides"
        )
    if calibration.scatter > 1 + 2 * calibration.scatter_sd:
        said.append(
            f"the views pull the lens {np.sqrt(calibration.scatter):.1f} times as far as independent corners would; all "
            "standard deviations are wider by that"
        )
    wider = calibration.sd / np.maximum(
        np.sqrt(np.diag(calibration.covariance_corners) * max(1.0, calibration.scatter)), 1e-300
    )
    names = [name for name, ratio in zip(PARAMETERS, wider, strict=True) if ratio > 1.001]
    if names:
        said.append(
            f"of {', '.join(names)} the jackknife over the views tells a larger deviation still; it is the one stated"
        )
    return said


def _board(calibration: Calibration) -> list[str]:
    shape = calibration.fit.shape_m
    if not calibration.fit.shape_sd_m.any():
        used = sum(view.used for view in calibration.views)
        if used < LEAST_SHAPED_VIEWS:
            return [f"the board is taken as flat: {used} views cannot tell its shape ({LEAST_SHAPED_VIEWS} can)"]
        return []
    within, across = 1e3 * calibration.fit.shape_sd_m
    square = _square_m(calibration.seen)
    if max(within, across) < 1e3 * SHAPE_SHARE * square:
        return []
    return [
        f"the board is not flat and true: its corners lie off by {within:.2f} mm within it and {across:.2f} mm out of its plane "
        f"(the largest by {1e3 * np.linalg.norm(shape, axis=1).max():.2f} mm); this was fitted with the lens"
    ]


def _square_m(views: Sequence[BoardView]) -> float:
    steps = np.diff(np.unique(np.concatenate([view.board_m[:, 0] for view in views])))
    return float(steps[steps > 1e-9].min())


def _coefficients(calibration: Calibration, found: Coverage, free: int, square: bool) -> list[str]:
    def told(*names: str) -> bool:
        at = [PARAMETERS.index(name) for name in names]
        return bool((np.abs(calibration.fit.theta[at]) > TOLD_SDS * calibration.sd[at]).any())

    def value(name: str) -> str:
        at = PARAMETERS.index(name)
        return f"{name} = {calibration.fit.theta[at]:.4f} +- {calibration.sd[at]:.4f}"

    if free < 5:
        missing = _missing(calibration, free, square)
        if missing:
            return [missing]
    if free == 5 and not told("k3"):
        gap = _difference(calibration, found, 4, square)
        return (
            []
            if gap is None
            else [
                f"{value('k3')} is not told by these views; without it (--coefficients 4) the lens differs by at most {gap:.2f} px "
                "where boards were, and is safer to use beyond"
            ]
        )
    if free == 4 and not told("p1", "p2"):
        gap = _difference(calibration, found, 2, square)
        return (
            []
            if gap is None
            else [
                f"{value('p1')} and {value('p2')} are not told by these views; without them (--coefficients 2) the lens differs by "
                f"at most {gap:.2f} px where boards were"
            ]
        )
    return []


def _missing(calibration: Calibration, free: int, square: bool) -> str:
    """The coefficient that was not fitted although the views tell it; empty = none."""
    fit = _refitted(calibration, 5, square)
    if fit is None:
        return ""
    at = [PARAMETERS.index(name) for name in COEFFICIENTS[5] if name not in COEFFICIENTS[free]]
    deviation = np.sqrt(np.diag(fit.covariance)[at] * max(1.0, view_scatter(fit).ratio))
    sds = np.abs(fit.theta[at]) / deviation
    worst = int(sds.argmax())
    if sds[worst] <= TOLD_SDS:
        return ""
    return (
        f"{PARAMETERS[at[worst]]} = {fit.theta[at[worst]]:.4f} is told by these views ({sds[worst]:.1f} standard deviations) but "
        "not fitted: --coefficients 5"
    )


def _pixels(calibration: Calibration, square: bool) -> list[str]:
    lens, c = calibration.lens, calibration.covariance
    gap = lens.fx_px - lens.fy_px
    sd = float(np.sqrt(max(c[0, 0] + c[1, 1] - 2 * c[0, 1], 0.0)))
    if square or abs(gap) > TOLD_SDS * sd:
        return []
    return [
        f"fx - fy = {gap:.2f} +- {sd:.2f} px: the pixels may be square (--square-pixels knows the focal length better)"
    ]


def _refitted(calibration: Calibration, coefficients: int, square: bool) -> JointFit | None:
    """The fit with other coefficients free; None where that does not settle."""
    basis = free_basis(coefficients, square)
    shaped = bool(calibration.fit.shape_sd_m.any())
    try:
        return joint_fit(calibration.seen, nearest(calibration.fit.theta, basis), basis, calibration.fit.poses, shaped)
    except GeometryError:
        return None


def _difference(calibration: Calibration, found: Coverage, coefficients: int, square: bool) -> float | None:
    other = _refitted(calibration, coefficients, square)
    if other is None:
        return None
    try:
        return differ_px(calibration.lens, Lens.from_vector(other.theta), calibration.image_size_px, found.covered)
    except GeometryError:
        return None
