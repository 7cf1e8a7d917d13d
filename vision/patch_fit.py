"""Where a patch lies in a frame: Gauss-Newton of place, linear shape, gain and offset.

The template is carried onto the frame's own pixels, not the frame onto the template: the pixels' noise stays white, nothing
is blurred, and the fit reaches the Cramer-Rao bound. OpenCV's findTransformECC carries the frame onto the template;
docs/bare_hull.md compares both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .patch import Array, Patch, determinant, inverse
from .patch_error import centre_covariance, pieces_spread, related_spread
from .patch_pixels import (
    INLIER_SD,
    LEAST_SCALE_DN,
    PARAMETERS,
    SLOPE_ERROR_PX,
    Cut,
    Linear,
    Pose,
    cut_out,
    linearise,
    told_share,
    with_first_brightness,
)

STEPS = 14
"""Gauss-Newton steps at most; a fit that has settled ends earlier."""
SETTLED_PX, NEARLY_SETTLED_PX = 2e-3, 0.05
"""A fit ends after a step below the first; after the last step the second will do."""
LONGEST_STEP_PX = 1.0
"""A step is shortened to this: beyond about a pixel the picture is no longer linear in the place."""
FARTHEST_PX = 4.0
"""A fit that leaves its start by more is another place's."""
TURN_SD, SIZE_SD, SHEAR_SD = 0.03, 0.004, 0.0015
"""Rotation, scale and shear change by about this from frame to frame at most."""
_TURN = 0.5 * np.array([[0, 0, 0, 0], [0, 1, -1, 0], [0, -1, 1, 0], [0, 0, 0, 0.0]])
"""On rotation: the antisymmetric part."""
_SIZE = 0.5 * np.array([[1, 0, 0, 1], [0, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 1.0]])
"""On scale: the trace."""
_SHEAR = np.eye(4) - _TURN - _SIZE
"""Projectors of a 2 x 2 matrix's entries on rotation, scale and shear (a rotation by e has two entries of e, and so on)."""
_DIAGONAL = np.arange(PARAMETERS)


@dataclass(frozen=True)
class Registration:
    """A fitted patch.

    Attributes
    ----------
    pose : fitted
    covariance_px2 : (2, 2) of the centre, residuals taken as independent
    correlation : of the pixels that fit
    inlier_share : share of the patch that fits, half by area, half by gradient
    visible_share : share of the patch's weight inside the picture
    noise_dn : root mean square residual of the pixels that fit
    spread : (2, 2), the centre's variance from the residuals as they are related over pixels, and as if independent
        (columns), u and v (rows); their ratio, pooled over frames, widens the covariance; ones where not asked for
    pieces : (2,), the centre's variance where pieces of PIECE_PX of the picture scatter in place by 1 px; ones likewise
    """

    pose: Pose
    covariance_px2: Array
    correlation: float
    inlier_share: float
    visible_share: float
    noise_dn: float
    spread: Array
    pieces: Array


def register(
    luma: Array,
    patch: Patch,
    start: Pose,
    shape_sd: tuple[float, float, float] = (TURN_SD, SIZE_SD, SHEAR_SD),
    white_dn: float = 255.0,
    related: bool = False,
    as_one: float = 1.0,
) -> Registration | None:
    """Fit ``patch`` to ``luma (h, w)`` from ``start`` (to a pixel or so; its brightness is not used).

    Parameters
    ----------
    luma : (h, w) uint8
    patch : the template
    start : where the fit begins
    shape_sd : prior standard deviations of rotation, scale and shear against start's; they hold what a poor texture does
        not show
    white_dn : the sensor's upper limit
    related : also work out ``spread`` and ``pieces``
    as_one : so many pixels' residuals vary as one; the prior weighs by that much more

    Returns
    -------
    None where less than LEAST_INSIDE of the patch lies in the picture, nothing is left to fit, or the fit runs away
    """
    cut = cut_out(luma, patch, start)
    if cut is None:
        return None
    pose = with_first_brightness(patch, cut, start)
    scale, settled = 1.0, False
    back = inverse(start.shape)
    firm = sum(part / (2 * sd**2) for part, sd in zip((_TURN, _SIZE, _SHEAR), shape_sd, strict=True))
    for number in range(STEPS):
        linear = linearise(patch, cut, pose, white_dn, scale)
        if linear is None:
            return None
        scale = linear.scale_dn
        weighted = linear.jacobian * linear.used
        both = weighted @ linear.whole.T
        normal, right = both[:, :PARAMETERS], both[:, PARAMETERS]
        prior = as_one * (scale / patch.radius_px) ** 2 * firm
        normal[2:6, 2:6] += prior
        right[2:6] -= patch.radius_px * prior @ (back @ pose.shape - np.eye(2)).ravel()
        normal[_DIAGONAL, _DIAGONAL] = normal[_DIAGONAL, _DIAGONAL] * (1.0 + 1e-9) + 1e-9
        if settled:
            return _answer(patch, cut, pose, linear, weighted, normal, related)
        step = np.linalg.solve(normal, right)
        pose, length = _moved(patch, pose, step)
        if not (np.hypot(*(pose.centre_px - start.centre_px)) < FARTHEST_PX and determinant(pose.shape) > 0.1):
            return None
        settled = length < (SETTLED_PX if number < STEPS - 2 else NEARLY_SETTLED_PX)
    return None


def matching_share(luma: Array, patch: Patch, pose: Pose, noise_dn: float, white_dn: float = 255.0) -> float:
    """Share of the patch's weight whose pixels agree with ``pose`` (brightness too) within INLIER_SD of ``noise_dn``.

    Parameters
    ----------
    luma : (h, w) uint8
    patch : the template
    pose : where it lies
    noise_dn : standard deviation of a pixel's noise, DN
    white_dn : largest value of a pixel; such pixels may truly be brighter
    """
    cut = cut_out(luma, patch, pose)
    linear = None if cut is None else linearise(patch, cut, pose, white_dn, noise_dn)
    if linear is None:
        return 0.0
    allowed = noise_dn**2 + SLOPE_ERROR_PX**2 * linear.steep
    return told_share(replace(linear, used=linear.weight * (linear.residual**2 < INLIER_SD**2 * allowed)))


def _moved(patch: Patch, pose: Pose, step: Array) -> tuple[Pose, float]:
    """The pose after a step, not along the blind direction, and the step's length in px."""
    away = step[:2] - pose.shape @ patch.blind * float(patch.blind @ inverse(pose.shape) @ step[:2])
    length = float(np.hypot(*away))
    short = min(1.0, LONGEST_STEP_PX / max(length, 1e-12))
    shape = pose.shape @ (np.eye(2) + short / patch.radius_px * step[2:6].reshape(2, 2))
    return Pose(pose.centre_px + short * away, shape, pose.gain + step[6], pose.offset_dn + step[7]), length


def _answer(
    patch: Patch, cut: Cut, pose: Pose, linear: Linear, weighted: Array, normal: Array, related: bool
) -> Registration:
    used, residual = linear.used, linear.residual
    total = float(used.sum())
    noise = max(float(np.sqrt(used @ residual**2 / max(total - PARAMETERS, 1.0))), LEAST_SCALE_DN)
    solved = np.linalg.inv(normal)
    influence = solved[:2] @ weighted
    white = noise**2 * (influence @ influence.T)
    middle, level = used @ linear.template / total, used @ cut.data / total
    one, two = linear.template - middle, cut.data - level
    correlation = float(used @ (one * two) / np.sqrt((used @ one**2) * (used @ two**2) + 1e-12))
    return Registration(
        pose,
        centre_covariance(patch, pose, white, solved, total),
        correlation,
        told_share(linear),
        cut.visible,
        noise,
        related_spread(cut, linear, influence, weighted, solved, noise) if related else np.ones((2, 2)),
        pieces_spread(cut, linear, influence) if related else np.ones(2),
    )
