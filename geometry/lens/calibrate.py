"""Views of a board -> the lens, how well it is known, and which views do not belong.

The covariance is that of the joint least squares over all views with their poses free. It takes the corners' errors as
independent; where they are not (a bent board, blur that shifts a whole view), the views' scores scatter more than it lets expect,
and the covariance grows by that factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...record.errors import GeometryError
from ..camera import Array, Lens
from .boards import BoardView
from .fit import JointFit, joint_fit, posed
from .model import COEFFICIENTS, Corners, Poses, free_basis, nearest
from .scatter import view_scatter, widened

LEAST_VIEWS = 3
"""Of a plane board two views could fix four numbers of a lens, without any check; one more."""
LEAST_SHAPED_VIEWS = 5
"""From fewer, the board's shape and the lens cannot be told apart."""
CLEARLY_BAD = 3.0
"""A view whose corners miss by this many times what the others' do is left out: it would count for nine views in the squares.
Chance alone moves the rms of 54 corners by 7 %; blur and tilt by up to 1.5 times on real pictures."""
DOUBTFUL = 2.0
"""From here on it is named, and kept."""
CORNER_SIGMAS = 6.0
"""A corner further off than this many (robust) standard deviations is left out; by chance one in 70 million is."""
MOST_LEFT_OUT = 1 / 3
"""If more of the views look bad, it is not those views that are wrong."""


@dataclass(frozen=True)
class ViewFit:
    """How one view fits.

    Attributes
    ----------
    name : of the picture
    corners : used of it
    corners_out : left out of it as clearly wrong
    rms_px : root mean square distance of its corners from the final lens, its pose free
    expected_px : what its corners miss a lens by that was fitted without them
    ratio : expected_px over the median of the other views'
    used : False = left out of the fit
    why : "" or what is wrong with it
    """

    name: str
    corners: int
    corners_out: int
    rms_px: float
    expected_px: float
    ratio: float
    used: bool
    why: str


@dataclass(frozen=True)
class Calibration:
    """A calibrated lens.

    Attributes
    ----------
    lens : Lens
    image_size_px : (width, height)
    covariance : (9, 9), order fx fy cx cy k1 k2 p1 p2 k3; zero for what was not free. Use this one: covariance_corners times
        scatter, and wider where covariance_views is clearly larger
    covariance_corners : (9, 9), had the corners' errors been independent
    covariance_views : (9, 9), from the scatter of the views' pulls alone (jackknife); from few views it is rough
    scatter : variance of the views' scores over what independent corners let expect, 1 if they are
    scatter_sd : its standard deviation by chance
    sigma_px : standard deviation of a corner's coordinate
    rms_px : root mean square distance of corners, all views used
    condition : of the parameters' correlation matrix
    views : per view, in the order given
    fit : the joint fit of the views that were used
    seen : (v,) the views with the corners that were used
    notes : what the user must know
    """

    lens: Lens
    image_size_px: tuple[int, int]
    covariance: Array
    covariance_corners: Array
    covariance_views: Array
    scatter: float
    scatter_sd: float
    sigma_px: float
    rms_px: float
    condition: float
    views: tuple[ViewFit, ...]
    fit: JointFit
    seen: tuple[BoardView, ...]
    notes: tuple[str, ...]

    @property
    def sd(self) -> Array:
        """Standard deviations, (9,)."""
        return np.sqrt(np.diag(self.covariance))


def calibrate(
    views: Sequence[BoardView],
    image_size_px: tuple[int, int],
    coefficients: int = 5,
    square_pixels: bool = False,
    leave_out: bool = True,
    flat: bool = False,
) -> Calibration:
    """Fit the lens to the views of a board.

    Parameters
    ----------
    views : of the board, from ``find_board``
    image_size_px : width and height
    coefficients : how many of k1 k2 p1 p2 k3 are free: 0, 1, 2, 4 or 5
    square_pixels : fx = fy
    leave_out : leave out views and corners that are clearly wrong; else they are only named
    flat : take the board as flat and true; else its shape is fitted with the lens (from five views on)

    Raises
    ------
    GeometryError : fewer than three views, or they do not fix the lens.
    """
    if coefficients not in COEFFICIENTS:
        raise GeometryError(f"{coefficients} distortion coefficients: 0, 1, 2, 4 or 5 can be fitted")
    if len(views) < LEAST_VIEWS:
        raise GeometryError(f"the board was found in {len(views)} pictures; at least {LEAST_VIEWS} are needed, tilted")
    basis = free_basis(coefficients, square_pixels)
    notes: list[str] = []
    used, kept, fit = _settled(views, image_size_px, basis, (leave_out, not flat), notes)
    seen = [view.only(mask) for view, mask in zip(views, kept, strict=True)]
    fits = _judged(views, seen, used, fit)
    for view in fits:
        if view.why:
            notes.append(f"{view.name}: {view.why}")
    covariance = fit.covariance
    scatter = view_scatter(fit)
    size = basis.shape[1]
    free = np.linalg.inv(fit.total)[:size, :size]
    deviation = np.sqrt(np.diag(free))
    condition = float(np.linalg.cond(free / np.outer(deviation, deviation)))
    return Calibration(
        lens=Lens.from_vector(fit.theta),
        image_size_px=image_size_px,
        covariance=widened(covariance, scatter),
        covariance_corners=covariance,
        covariance_views=scatter.covariance,
        scatter=scatter.ratio,
        scatter_sd=scatter.chance,
        sigma_px=float(np.sqrt(fit.variance_px2)),
        rms_px=float(np.sqrt((fit.residual_px**2).sum(1).mean())),
        condition=condition,
        views=fits,
        fit=fit,
        seen=tuple(seen[i] for i in used),
        notes=tuple(notes),
    )


def start(views: Sequence[BoardView], image_size_px: tuple[int, int], basis: Array) -> tuple[Array, Poses]:
    """Lens and poses to start from, by OpenCV.

    Parameters
    ----------
    views : of the board
    image_size_px : width and height
    basis : (9, m), what is free

    Raises
    ------
    GeometryError : OpenCV finds no lens.
    """
    import cv2

    flags = 0
    for name, row in (("K1", 4), ("K2", 5), ("K3", 8)):
        if not basis[row].any():
            flags |= getattr(cv2, f"CALIB_FIX_{name}")
    if not basis[6].any():
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    guess = None
    if (basis[0] == basis[1]).all():
        flags |= cv2.CALIB_FIX_ASPECT_RATIO
        guess = np.diag([1.0, 1.0, 1.0])
    try:
        _, matrix, coefficients, turn, shift = cv2.calibrateCamera(
            [view.board_m.astype(np.float32) for view in views],
            [view.pixel_px.astype(np.float32).reshape(-1, 1, 2) for view in views],
            image_size_px,
            guess,  # type: ignore[arg-type]
            None,  # type: ignore[arg-type]
            flags=flags,
            criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 12, 1e-6),
        )
    except cv2.error as error:
        raise GeometryError(f"OpenCV finds no lens for these views ({error.err})") from None
    theta = np.concatenate([[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], coefficients.ravel()[:5]])
    rotation = np.array([cv2.Rodrigues(np.asarray(t, dtype=float))[0] for t in turn])
    return theta, Poses(rotation, np.array(shift, dtype=float).reshape(-1, 3))


def _settled(
    views: Sequence[BoardView], size: tuple[int, int], basis: Array, how: tuple[bool, bool], notes: list[str]
) -> tuple[list[int], list[Array], JointFit]:
    """The views and corners to use, and the joint fit of them."""
    used = list(range(len(views)))
    kept = [np.ones(len(view.ids), dtype=bool) for view in views]
    leave_out, shaped = how
    # a lens with too few coefficients fits badly near the edges, and the views there would look bad: judge by the full one
    widest = free_basis() if leave_out and len(views) >= LEAST_SHAPED_VIEWS else basis
    theta, poses = start(views, size, widest)
    fit = joint_fit(views, theta, widest, poses)
    for _ in range(len(views) if leave_out else 0):
        ratio = _ratios(_expected(fit))
        worst = int(ratio.argmax())
        if ratio[worst] <= CLEARLY_BAD:
            break
        if len(used) <= LEAST_VIEWS or len(used) - 1 < (1 - MOST_LEFT_OUT) * len(views):
            notes.append("more views look bad than can be left out: look at the pictures, the board and its size")
            break
        del used[worst]
        fit = joint_fit([views[i] for i in used], *_warm(fit, worst))
    if widest is not basis:
        fit = joint_fit([views[i] for i in used], nearest(fit.theta, basis), basis, fit.poses)
    shaped = shaped and len(used) >= LEAST_SHAPED_VIEWS
    if shaped:
        fit = joint_fit([views[i] for i in used], fit.theta, basis, fit.poses, True)
    for _ in range(3 if leave_out else 0):
        distance = np.linalg.norm(fit.residual_px, axis=1)
        # the median of a Rayleigh distribution is 1.177 times the standard deviation of a coordinate
        wrong = distance > CORNER_SIGMAS * np.median(distance) / 1.177
        wrong &= distance > np.sqrt(2) * fit.variance_px2**0.5
        if not wrong.any():
            break
        for place, i in enumerate(used):
            inside = kept[i].copy()
            inside[kept[i]] = ~wrong[fit.corners.view == place]
            if inside.sum() >= max(8, len(inside) / 2):
                kept[i] = inside
        fit = joint_fit([views[i].only(kept[i]) for i in used], fit.theta, basis, fit.poses, shaped)
    return used, kept, fit


def _warm(fit: JointFit, gone: int) -> tuple[Array, Array, Poses]:
    stay = np.arange(len(fit.score)) != gone
    return fit.without(gone)[0], fit.basis, Poses(fit.poses.rotation[stay], fit.poses.translation_m[stay])


def _expected(fit: JointFit) -> Array:
    """Per view, what its corners miss a lens by that was fitted without them (their pose free), rms px."""
    theta, shape = zip(*(fit.without(i) for i in range(len(fit.score))), strict=True)
    _, residual = posed(np.array(theta), fit.poses, fit.corners, np.array(shape))
    return np.sqrt(fit.corners.sums((residual**2).sum(1)) / fit.corners.counts)


def _ratios(rms_px: Array) -> Array:
    """Each over the median of the others."""
    others = [np.median(np.delete(rms_px, i)) for i in range(len(rms_px))]
    return rms_px / np.maximum(others, 1e-12)


def _judged(
    views: Sequence[BoardView], seen: Sequence[BoardView], used: Sequence[int], fit: JointFit
) -> tuple[ViewFit, ...]:
    expected, inside = _expected(fit), fit.rms_px
    ratios = _ratios(expected)
    usual = float(np.median(expected))
    judged: list[ViewFit] = []
    for i, (view, part) in enumerate(zip(views, seen, strict=True)):
        out = len(view.ids) - len(part.ids)
        if i in used:
            place = used.index(i)
            rms, miss, ratio = float(inside[place]), float(expected[place]), float(ratios[place])
        else:
            residual = _outside(view, fit)
            rms = miss = float(np.sqrt((residual**2).sum(1).mean()))
            ratio = miss / usual
        why = _why(view, ratio, miss, usual, i in used, out, fit)
        judged.append(ViewFit(view.name, len(part.ids), out, rms, miss, ratio, i in used, why))
    return tuple(judged)


def _outside(view: BoardView, fit: JointFit) -> Array:
    """Residuals (n, 2) px of a view that was left out, its pose fitted."""
    import cv2

    lens = Lens.from_vector(fit.theta)
    _, turn, shift = cv2.solvePnP(view.board_m, view.pixel_px, lens.matrix, lens.distortion)
    pose = Poses(cv2.Rodrigues(turn)[0][None], np.asarray(shift, dtype=float).reshape(1, 3))
    corners = Corners.of([view])
    place = np.searchsorted(fit.corners.point_ids, corners.point_ids)
    place = np.minimum(place, len(fit.shape_m) - 1)
    known = fit.corners.point_ids[place] == corners.point_ids
    return posed(fit.theta, pose, corners, np.where(known[:, None], fit.shape_m[place], 0.0))[1]


def _why(view: BoardView, ratio: float, miss_px: float, usual_px: float, used: bool, out: int, fit: JointFit) -> str:
    said = f"{out} of {len(view.ids)} corners are clearly wrong and left out" if out else ""
    if ratio <= DOUBTFUL:
        return said
    distance = np.linalg.norm(_outside(view, fit), axis=1)
    far = int((distance > CORNER_SIGMAS * np.sqrt(fit.variance_px2)).sum())
    fate = "left out" if not used else "doubtful, kept"
    where = view.pixel_px[int(distance.argmax())]
    text = (
        f"{fate}: its corners miss a lens fitted without them by {miss_px:.2f} px rms, {ratio:.1f} times the usual "
        f"{usual_px:.2f} px ({far} of {len(view.ids)} corners far off; worst {distance.max():.1f} px at "
        f"({where[0]:.0f}, {where[1]:.0f}))"
    )
    return f"{text}; {said}" if said else text
