"""What a mark looks like in its window: models, their parameters, and what a fit of them says.

    mu = ground (+ slope) + A exp(-q^p / 2) (+ A' exp(-q' / 2)),   q = P_uu x^2 + 2 P_uv x y + P_vv y^2 about the centre

The ellipse takes up foreshortened discs and motion blur; a symmetric spot's centre is not moved by it. The exponent p is 1
(Gaussian) unless the spot has a plateau; the second, elliptic spot is a reflection that touches the first. A model is a set
of free parameters; the others stand as given. Pixels at the sensor's white are only known to be at least that bright: they
count where the model stays below.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.robust import MAD_TO_SD
from .candidates import middle

Array = NDArray[Any]

GROUND, SLOPE_U, SLOPE_V, HEIGHT, U, V, P_UU, P_UV, P_VV, POWER = range(10)
"""Columns of the parameter table: ground and its slopes, DN; height, DN; centre, px; the entries of the inverse
covariance, 1/px2; power of the flat top."""
HEIGHT_2, U_2, V_2, Q_UU, Q_UV, Q_VV = range(10, 16)
"""The same of a second spot, the reflection."""
PARAMETERS = 16
"""All columns."""
TAPER_WIDTHS = 2.2
"""With a taper the window is weighed down beyond this many widths from the centre, so that a neighbour pulls less."""
RIM_WIDTHS = 1.4
"""A spot with an edge ends here."""
RING_PIXELS = 12
"""Fewer about a spot do not tell its ground: a choice."""
RIM_SD = 6.0
"""What stands out of the ring about a spot by so many standard deviations of the ring's own levels is no part of the ground."""
DISC_WIDTHS = 2.6
"""The residuals are judged within so many widths of the spot, where a Gaussian has fallen to 3 % of its height."""
PLATEAU_PIXELS = 4
"""This many pixels near the window's largest value are a flat top: clipped, or a disc with an edge."""
PLATEAU_SHARE = 0.08
"""... near: within this share of the spot's height (a Gaussian of width 1.5 px has 3 pixels within 8 % of its peak)."""


@dataclass(frozen=True)
class Model:
    """What is free in a fit.

    Attributes
    ----------
    name : for reasons and reports
    free : columns of the parameter table
    taper : the window's rim counts less
    rim_px : of a spot with an edge: the window fades out over so many pixels beyond the edge; 0 = by the spot's width
    """

    name: str
    free: tuple[int, ...]
    taper: bool = False
    rim_px: float = 0.0

    @property
    def reflects(self) -> bool:
        """There is a second spot."""
        return HEIGHT_2 in self.free


_BARE = (GROUND, HEIGHT, U, V)
_ELLIPSE = (*_BARE, P_UU, P_UV, P_VV)
SHARED = Model("shared width", _BARE)
TAPERED = Model("shared width, tapered", _BARE, taper=True)
ELLIPSE = Model("ellipse", _ELLIPSE)
SLOPED = Model("sloping ground", (*_ELLIPSE, SLOPE_U, SLOPE_V), taper=True)
PLATEAU = Model("flat top", (*_ELLIPSE, SLOPE_U, SLOPE_V, POWER), taper=True, rim_px=1.2)
"""A spot with an edge: its window fades out within little more than a pixel beyond (a choice), where a Gaussian's
tail would be."""
PLATEAU_SHARED = Model("flat top, shared shape", _BARE, taper=True, rim_px=1.2)
"""The same with the shape that was learnt."""
_SECOND = (HEIGHT_2, U_2, V_2)
REFLECTION_SHARED = Model("reflection, shared widths", (*_BARE, *_SECOND), taper=True)
REFLECTION = Model("reflection, shared width", (*_BARE, *_SECOND, Q_UU, Q_UV, Q_VV), taper=True)
REFLECTION_FREE = Model("reflection", (*_ELLIPSE, *_SECOND, Q_UU, Q_UV, Q_VV), taper=True)
"""A mark and its reflection blur each other's widths: known widths halve the sd of a centre that its reflection overlaps."""


@dataclass(frozen=True)
class SpotFit:
    """Fitted spots, one row a window.

    Attributes
    ----------
    theta : (b, 16), all parameters; places in picture pixels
    sigma_px : (b, 2), standard deviation of the centre from the residual scatter
    chi_square : (b,), weighted mean square residual over the noise model's variance, 1 where the model is true
    level : (b,), the same over the spot's own disc (``DISC_WIDTHS``) with unit weights in units of the noise model, for
        comparing models of one window whatever their taper and window
    disc : (b,), degrees of freedom of ``level``
    noise_dn : (b,), weighted root mean square residual
    good : (b,), converged inside the window
    """

    theta: Array
    sigma_px: Array
    chi_square: Array
    level: Array
    disc: Array
    noise_dn: Array
    good: NDArray[np.bool_]

    @property
    def centre_px(self) -> Array:
        """(b, 2), u and v in the picture."""
        return self.theta[:, U : V + 1]

    @property
    def amplitude_dn(self) -> Array:
        """(b,), height above the ground (negative: dark)."""
        return self.theta[:, HEIGHT]

    @property
    def sharpness(self) -> Array:
        """(b,), exponent p: 1 = Gaussian, larger = flat top."""
        return self.theta[:, POWER]

    @property
    def width_px(self) -> Array:
        """(b,), geometric mean of the two standard deviations of the spot."""
        return width_of(self.theta)

    @property
    def stretch(self) -> Array:
        """(b,), ratio of the larger standard deviation to the smaller."""
        half = (self.theta[:, P_UU] + self.theta[:, P_VV]) / 2
        root = np.sqrt(np.maximum(half**2 - self.width_px**-4, 0.0))
        return np.sqrt((half + root) / np.maximum(half - root, 1e-12))

    def __len__(self) -> int:
        return len(self.theta)

    def rows(self, index: Any) -> SpotFit:
        """Some windows' fits."""
        return SpotFit(*(getattr(self, f.name)[index] for f in fields(self)))

    def with_rows(self, index: Any, other: SpotFit) -> SpotFit:
        """These fits with ``other`` at ``index``."""
        changed = []
        for f in fields(self):
            column = getattr(self, f.name).copy()
            column[index] = getattr(other, f.name)
            changed.append(column)
        return SpotFit(*changed)


def width_of(theta: Array) -> Array:
    """Geometric mean of the spot's two standard deviations, px."""
    determinant = theta[..., P_UU] * theta[..., P_VV] - theta[..., P_UV] ** 2
    return np.maximum(determinant, 1e-12) ** -0.25


def windows(luma: NDArray[np.uint8], centres_px: Array, radius_px: int) -> tuple[Array, Array]:
    """Cut square windows about the nearest pixels of ``centres_px (b, 2)``.

    Parameters
    ----------
    luma : (h, w) uint8
    centres_px : (b, 2)
    radius_px : half a window's side, n = 2 radius + 1

    Returns
    -------
    values : (b, n, n), NaN beyond the picture's edge, n = 2 radius + 1
    corner : (b, 2), u and v of each window's first pixel
    """
    height, width = luma.shape
    size = 2 * radius_px + 1
    values = np.full((len(centres_px), size, size), np.nan)
    corner = np.asarray(np.rint(centres_px), dtype=int) - radius_px
    for index in range(len(corner)):
        u, v = (int(x) for x in corner[index])
        u0, u1, v0, v1 = max(u, 0), min(u + size, width), max(v, 0), min(v + size, height)
        if u1 > u0 and v1 > v0:
            values[index, v0 - v : v1 - v, u0 - u : u1 - u] = luma[v0:v1, u0:u1]
    return values, corner.astype(float)


def start_of(values: Array, start_px: Array, start_width_px: Array, dark: bool = False) -> Array:
    """Where a fit begins: round spots of the given width, ground and height by order statistics; ``(b, 16)``.

    Parameters
    ----------
    values : (b, n, n) grey values
    start_px : (b, 2), in the windows
    start_width_px : (b,)
    dark : dark spots on light ground
    """
    data = values.reshape(len(values), -1)
    usable = np.isfinite(data)
    some = np.asarray(usable.any(axis=1))
    data = np.where(some[:, None], data, 0.0)
    # a mark fills at most a quarter of its window: the lower (dark mark: upper) side's median is the ground
    ground = np.nanmedian(data, axis=1)
    peak = (np.nanmin if dark else np.nanmax)(data, axis=1)
    height = np.minimum(peak - ground, -1.0) if dark else np.maximum(peak - ground, 1.0)
    theta = np.zeros((len(values), PARAMETERS))
    theta[:, GROUND], theta[:, HEIGHT], theta[:, U : V + 1], theta[:, POWER] = ground, height, start_px, 1.0
    theta[:, P_UU] = theta[:, P_VV] = 1 / np.clip(start_width_px, 0.6, values.shape[2] / 3) ** 2
    theta[:, Q_UU] = theta[:, Q_VV] = theta[:, P_UU] / 2
    return theta


def without_rims(values: Array, width_px: float) -> Array:
    """Windows about spots without what is not the ground there: the rim of a small plate, a neighbour, a line of print.

    Parameters
    ----------
    values : (b, n, n) grey values
    width_px : their standard deviation

    Returns
    -------
    values : (b, n, n), NaN where a pixel beyond ``DISC_WIDTHS`` of the spot stands out of the ring about the spot
    """
    half = (values.shape[2] - 1) / 2
    axis = np.arange(values.shape[2]) - half
    away = np.hypot(axis[None, :], axis[:, None])
    ring = (away > 1.7 * width_px + 0.7) & (away < 2.5 * width_px + 1.2)
    beyond = away > max(DISC_WIDTHS * width_px, 2.1 * width_px + 1.0)
    if ring.sum() < RING_PIXELS or not beyond.any():
        return values
    about = values[:, ring]
    usable = np.isfinite(about).all(axis=1)
    if not usable.any():
        return values
    level = middle(about[usable])
    spread = MAD_TO_SD * middle(np.abs(about[usable] - level[:, None]))
    far = np.abs(values[usable] - level[:, None, None]) > (RIM_SD * np.hypot(spread, 1.0))[:, None, None]
    far &= beyond
    if not far.any():
        return values
    answer = values.copy()
    answer[usable] = np.where(far, np.nan, values[usable])
    return answer


def has_plateau(values: Array, dark: bool = False) -> NDArray[np.bool_]:
    """Windows ``(b, n, n)`` whose spot has a flat top.

    Parameters
    ----------
    values : (b, n, n) grey values
    dark : dark spots on light ground
    """
    data = (-values if dark else values).reshape(len(values), -1)
    data = np.where(np.isfinite(data), data, -np.inf)
    top = data.max(axis=1)
    finite = np.where(np.isfinite(data), data, np.nan)
    ground = np.nanmedian(np.where(np.isfinite(top)[:, None], finite, 0.0), axis=1)
    return (data >= (top - PLATEAU_SHARE * (top - ground))[:, None]).sum(axis=1) >= PLATEAU_PIXELS


def taper_of(q: Any, xp: Any) -> Any:
    """Weight of pixels at the squared distance ``q`` (in widths) from a spot.

    Parameters
    ----------
    q : squared distance in widths
    xp : numpy or torch
    """
    return xp.exp(-0.5 * xp.clip(q**0.5 - TAPER_WIDTHS, 0.0, None) ** 2)


def expected(theta: Array, corner: Array, size: int) -> tuple[Array, Array]:
    """Grey values ``(b, n, n)`` of the model with parameters ``theta (b, 16)`` in windows of ``size`` at ``corner (b, 2)``;
    and the taper there.

    The slope of the ground counts from the window's middle, so ``size`` must be that of the fit.

    Parameters
    ----------
    theta : (b, 16) parameters of the spots
    corner : (b, 2), u and v of each window's first pixel
    size : side of the windows, px
    """
    axis = np.arange(size)
    x, y = (axis[None, None, :] + corner[:, 0, None, None], axis[None, :, None] + corner[:, 1, None, None])
    cell = theta[:, :, None, None]
    dx, dy = x - cell[:, U], y - cell[:, V]
    q = np.maximum(cell[:, P_UU] * dx**2 + 2 * cell[:, P_UV] * dx * dy + cell[:, P_VV] * dy**2, 1e-9)
    value = cell[:, GROUND] + cell[:, HEIGHT] * np.exp(-0.5 * np.minimum(q, 1e4) ** cell[:, POWER])
    near = q
    half = (size - 1) / 2
    tilt_u, tilt_v = axis[None, None, :] / half - 1, axis[None, :, None] / half - 1
    value = value + cell[:, SLOPE_U] * tilt_u + cell[:, SLOPE_V] * tilt_v
    if theta[:, HEIGHT_2].any():
        dx, dy = x - cell[:, U_2], y - cell[:, V_2]
        q = cell[:, Q_UU] * dx**2 + 2 * cell[:, Q_UV] * dx * dy + cell[:, Q_VV] * dy**2
        value = value + cell[:, HEIGHT_2] * np.exp(-0.5 * np.clip(q, 0, 1e4))
        near = np.minimum(near, np.maximum(q, 0.0))
    return value, taper_of(near, np)
