"""A patch's model on a frame's own pixels: what it predicts, what is left, and how both change with the pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..geometry.robust import MAD_TO_SD
from .patch import SOFT_PX, Array, Patch, axes_of, inverse, look_up

LEAST_INSIDE = 1 / 3
"""A patch of which less lies inside the picture is not looked at."""
LARGEST_GROWTH = 1.8
"""Pixels are cut out for a patch that has grown by so much at most: what lies beyond is not used."""
SOLID_WEIGHT = 0.5
"""A pixel of more than this weight belongs to the patch's inside, not its soft rim; the scale is told by those."""
INLIER_SD, OUTLIER_SD = 3.0, 6.0
"""A pixel counts in full up to the first residual and not at all beyond the second."""
SLOPE_ERROR_PX = 0.1
"""Where the picture is steep, sampling and compression leave residuals of this times the slope, without being outliers."""
LEAST_SCALE_DN = 0.3
"""Rounding to whole levels alone scatters by this."""
CLIP_SD = 2.0
"""Pixels predicted this near to the sensor's limit are left out (chosen by the prediction: choosing by the data biases)."""
PARAMETERS = 8
"""Of a pose: place (2), shape (4), gain, offset."""


@dataclass(frozen=True)
class Pose:
    """Where a patch lies: x = centre + shape @ xi, brightness gain * T(xi) + offset.

    Attributes
    ----------
    centre_px : (2,), of the picked point
    shape : (2, 2), rotation, scale and shear
    gain, offset_dn : against the template
    """

    centre_px: Array
    shape: Array
    gain: float = 1.0
    offset_dn: float = 0.0


@lru_cache(maxsize=32)
def _disc(radius: int) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Pixels (2, m) of a disc about 0, u then v, as floats and as integers."""
    axis = np.arange(-radius, radius + 1)
    v, u = np.meshgrid(axis, axis, indexing="ij")
    inside = u**2 + v**2 <= radius**2
    whole = np.stack([u[inside], v[inside]])
    return whole.astype(float), whole


def _median(values: Array) -> float:
    """The upper median; np.median asks more questions than the sorting takes."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


@dataclass(frozen=True)
class Cut:
    """The frame's pixels under a patch: places (2, m) from the corner, values (m,), weight share inside the picture."""

    place: Array
    data: Array
    corner: NDArray[np.intp]
    visible: float


def cut_out(luma: Array, patch: Patch, start: Pose) -> Cut | None:
    """The frame's pixels that a patch may cover at ``start``; None where less than ``LEAST_INSIDE`` of them are in the picture.

    Parameters
    ----------
    luma : (h, w) uint8
    patch : the template
    start : where the fit begins
    """
    height, width = luma.shape
    grown = min(axes_of(start.shape)[0], LARGEST_GROWTH)
    disc, whole = _disc(int(np.ceil((patch.radius_px + 0.5 * SOFT_PX) * grown + 0.5)))
    corner = np.rint(start.centre_px).astype(np.intp)
    u, v = whole + corner[:, None]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    if inside.all():
        return Cut(disc, luma[v, u].astype(float), corner, 1.0)
    if inside.mean() < LEAST_INSIDE:
        return None
    weight = look_up(patch, inverse(start.shape) @ (disc - (start.centre_px - corner)[:, None]))[3]
    visible = float(weight[inside].sum() / max(weight.sum(), 1e-9))
    return Cut(disc[:, inside], luma[v[inside], u[inside]].astype(float), corner, visible)


@dataclass(frozen=True)
class Linear:
    """The model about a pose: Jacobian and, below it, the residual (9, m), weights before and after regard to it (m,), their
    scale, the template and its squared slope (m,)."""

    whole: Array
    weight: Array
    used: Array
    scale_dn: float
    template: Array
    steep: Array

    @property
    def jacobian(self) -> Array:
        """(8, m), of the model by the pose's unknowns."""
        return self.whole[:PARAMETERS]

    @property
    def residual(self) -> Array:
        """(m,), DN."""
        return self.whole[PARAMETERS]


def linearise(patch: Patch, cut: Cut, pose: Pose, white_dn: float, scale_dn: float) -> Linear | None:
    """Unknowns: centre, the entries of E radius_px in shape (1 + E), gain, offset.

    Parameters
    ----------
    patch : the template
    cut : the frame's pixels about it
    pose : where it lies
    white_dn : largest value of a pixel; such pixels may truly be brighter
    scale_dn : scatter of the residuals so far, DN
    """
    turn = inverse(pose.shape)
    xi = turn @ (cut.place - (pose.centre_px - cut.corner)[:, None])
    template, slope_u, slope_v, weight = look_up(patch, xi)
    model = pose.gain * template + pose.offset_dn
    weight *= (model < white_dn - CLIP_SD * scale_dn) & (model > 0.5 * scale_dn)
    solid = weight > SOLID_WEIGHT
    if np.count_nonzero(solid) < 3 * PARAMETERS:
        return None
    residual = cut.data - model
    scale = max(MAD_TO_SD * _median(np.abs(residual[solid])), LEAST_SCALE_DN)
    slope_u *= -pose.gain
    slope_v *= -pose.gain
    steep = slope_u**2 + slope_v**2
    sizes = np.abs(residual) / np.sqrt(scale**2 + SLOPE_ERROR_PX**2 * steep)
    used = weight * np.clip((OUTLIER_SD - sizes) / (OUTLIER_SD - INLIER_SD), 0.0, 1.0)
    jacobian = np.empty((PARAMETERS + 1, len(residual)))
    jacobian[0] = turn[0, 0] * slope_u + turn[1, 0] * slope_v
    jacobian[1] = turn[0, 1] * slope_u + turn[1, 1] * slope_v
    xi *= 1.0 / patch.radius_px
    np.multiply(slope_u, xi, out=jacobian[2:4])
    np.multiply(slope_v, xi, out=jacobian[4:6])
    jacobian[6], jacobian[7], jacobian[8] = template, 1.0, residual
    return Linear(jacobian, weight, used, scale, template, steep)


def with_first_brightness(patch: Patch, cut: Cut, start: Pose) -> Pose:
    """Gain and offset of a straight line through the pixels at the start.

    Parameters
    ----------
    patch : the template
    cut : the frame's pixels about it
    start : where the fit begins
    """
    xi = inverse(start.shape) @ (cut.place - (start.centre_px - cut.corner)[:, None])
    template, _, _, weight = look_up(patch, xi)
    total = max(float(weight.sum()), 1e-9)
    middle, level = weight @ template / total, weight @ cut.data / total
    energy = weight @ (template - middle) ** 2
    gain = float(np.clip(weight @ ((template - middle) * (cut.data - level)) / max(energy, 1e-9), 0.3, 3.0))
    return Pose(start.centre_px, start.shape, gain, float(level - gain * middle))


def told_share(linear: Linear) -> float:
    """Share of the pixels that fit, half by area, half by what they tell (a small mark on plain ground is few pixels)."""
    told = 0.5 / max(float(linear.weight.sum()), 1e-9)
    told = told + 0.5 * linear.steep / max(float(linear.weight @ linear.steep), 1e-9)
    return float(linear.used @ told)
