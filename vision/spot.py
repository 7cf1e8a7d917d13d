"""Sub-pixel place of a spot: models of one mark in its window, fitted to a batch of windows at once.

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

from .backend import NUMPY, Backend

Array = NDArray[Any]

GROUND, SLOPE_U, SLOPE_V, HEIGHT, U, V, P_UU, P_UV, P_VV, POWER = range(10)
HEIGHT_2, U_2, V_2, Q_UU, Q_UV, Q_VV = range(10, 16)
PARAMETERS = 16
STEPS = 30
CONVERGED_PX = 5e-4
"""Gauss-Newton converges quadratically here: after a step this small the next one is below 1e-5 px."""
CONVERGED_VARIANCES = 0.01
"""... and no parameter was farther than a tenth of its own standard deviation from where the step took it."""
NEARLY_PX = 0.05
TAPER_WIDTHS = 2.2
"""With a taper the window is weighed down beyond this many widths from the centre, so that a neighbour pulls less."""
RIM_WIDTHS = 1.4
"""A spot with an edge ends here."""
SHARPEST = 12.0
DISC_WIDTHS = 2.6
WHITE_MARGIN_DN = 1.5
LEAST_PIXELS = 20
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
PLATEAU_SHARED = Model("flat top, shared shape", _BARE, taper=True, rim_px=1.2)
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

    Returns
    -------
    values : (b, n, n), NaN beyond the picture's edge, n = 2 radius + 1
    corner : (b, 2), u and v of each window's first pixel
    """
    height, width = luma.shape
    size = 2 * radius_px + 1
    values = np.full((len(centres_px), size, size), np.nan)
    corner = np.rint(centres_px).astype(int) - radius_px
    for index, (u, v) in enumerate(corner.tolist()):
        u0, u1, v0, v1 = max(u, 0), min(u + size, width), max(v, 0), min(v + size, height)
        if u1 > u0 and v1 > v0:
            values[index, v0 - v : v1 - v, u0 - u : u1 - u] = luma[v0:v1, u0:u1]
    return values, corner.astype(float)


def start_of(values: Array, start_px: Array, start_width_px: Array, dark: bool = False) -> Array:
    """Where a fit begins: round spots of the given width, ground and height by order statistics; ``(b, 16)``."""
    data = values.reshape(len(values), -1)
    usable = np.isfinite(data)
    some = usable.any(axis=1)
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


def has_plateau(values: Array, dark: bool = False) -> NDArray[np.bool_]:
    """Windows ``(b, n, n)`` whose spot has a flat top."""
    data = (-values if dark else values).reshape(len(values), -1)
    data = np.where(np.isfinite(data), data, -np.inf)
    top = data.max(axis=1)
    finite = np.where(np.isfinite(data), data, np.nan)
    ground = np.nanmedian(np.where(np.isfinite(top)[:, None], finite, 0.0), axis=1)
    return (data >= (top - PLATEAU_SHARE * (top - ground))[:, None]).sum(axis=1) >= PLATEAU_PIXELS


def _taper(q: Any, xp: Any) -> Any:
    return xp.exp(-0.5 * xp.clip(q**0.5 - TAPER_WIDTHS, 0.0, None) ** 2)


def expected(theta: Array, corner: Array, size: int) -> tuple[Array, Array]:
    """Grey values ``(b, n, n)`` of the model with parameters ``theta (b, 16)`` in windows of ``size`` at ``corner (b, 2)``;
    and the taper there.

    The slope of the ground counts from the window's middle, so ``size`` must be that of the fit.
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
    return value, _taper(near, np)


def fit_spots(
    values: Array,
    corner: Array,
    start: Array,
    model: Model,
    noise: tuple[float, float] = (1.0, 0.0),
    white_dn: float | None = None,
    backend: Backend = NUMPY,
) -> SpotFit:
    """Damped Gauss-Newton fit of ``model`` to every window.

    Parameters
    ----------
    values : (b, n, n) grey values, NaN = not in the picture
    corner : (b, 2) of the windows' first pixels
    start : (b, 16) parameters to begin from
    noise : variance of a grey value mu is noise[0] + noise[1] max(mu, 0), DN^2
    white_dn : the sensor's or codec's largest value; such pixels may truly be brighter
    """
    problem = _Problem(values, corner, model, noise, white_dn, backend)
    return problem.solve(start)


class _Problem:
    """The windows of one call, flattened; pixels along the last axis so that sums run over contiguous memory."""

    def __init__(self, values, corner, model: Model, noise, white_dn, backend: Backend) -> None:
        self.backend, self.model, self.noise = backend, model, noise
        self.b, self.n = len(values), values.shape[2]
        data = np.ascontiguousarray(values).reshape(self.b, -1)
        usable = np.isfinite(data)
        self.usable = usable
        self.all_usable = bool(usable.all())
        clean = data if self.all_usable else np.where(usable, data, 0.0)
        white = None if white_dn is None else clean >= white_dn - WHITE_MARGIN_DN
        self.corner = np.asarray(corner, dtype=float)
        self.data = backend.array(clean)
        self.mask = None if self.all_usable else backend.array(usable.astype(float))
        self.white = None if white is None or not white.any() else backend.mask(white)
        grid = np.arange(self.n, dtype=float)
        self.x = backend.array(np.tile(grid, self.n))
        self.y = backend.array(np.repeat(grid, self.n))
        self.free = list(model.free)

    def solve(self, start: Array) -> SpotFit:
        xp, k = self.backend.xp, len(self.free)
        local = np.array(start, dtype=float)
        for column in (U, U_2):
            local[:, column : column + 2] -= self.corner
        theta = self.backend.array(local)
        everything = np.arange(self.b)
        active = everything
        damping = self.backend.array(np.full(self.b, 1e-6))
        moved = self.backend.array(np.full(self.b, np.inf))
        gap, slope, weight = self._linearised(theta, active)
        cost = (weight * gap**2).sum(-1)
        state = [gap, slope, weight, cost]
        eye = self.backend.eye(k)
        for step_number in range(STEPS):
            gap, slope, weight, cost = state
            scaled = slope * weight[:, None, :]
            normal = xp.matmul(scaled, slope.swapaxes(1, 2))
            right = xp.matmul(scaled, gap[:, :, None])
            diagonal = xp.diagonal(normal, 0, 1, 2)
            now = damping[active]
            damped = normal + (now[:, None] * diagonal + 1e-12)[:, :, None] * eye
            step = xp.linalg.solve(damped, right)[:, :, 0]
            before = theta[active]
            trial = before + 0.0
            trial[:, self.free] = before[:, self.free] + step
            follow = step_number in (
                1,
                4,
            )  # the weights follow the spot twice, then stand, so that the cost can converge
            new = self._linearised(trial, active, None if follow else weight)
            new_cost = (new[2] * new[0] ** 2).sum(-1)
            if follow:
                cost = (new[2] * gap**2).sum(-1)
            better = xp.isfinite(new_cost) & (new_cost <= cost * (1 + 1e-9)) & self._allowed(trial)
            length = (step[:, [self.free.index(U), self.free.index(V)]] ** 2).sum(-1) ** 0.5
            moved[active] = xp.where(better, length, moved[active])
            theta[active] = xp.where(better[:, None], trial, before)
            damping[active] = xp.where(better, now / 10, xp.clip(now, 1e-5, None) * 10)
            left = xp.matmul(step[:, None, :], right)[:, 0, 0]
            done = (moved[active] < CONVERGED_PX) & (left < CONVERGED_VARIANCES) & better
            done = done & (step_number >= 5 if self.model.taper else step_number >= 1)
            done = done | (damping[active] > 1e7)
            keep = self.backend.numpy(~done)
            if not keep.any():
                break
            chosen = xp.where(better[:, None], new[0], gap)
            sloped = xp.where(better[:, None, None], new[1], slope)
            weights = new[2]
            state = [chosen[keep], sloped[keep], weights[keep], xp.where(better, new_cost, cost)[keep]]
            active = active[keep]
        return self._answer(theta, moved)

    def _linearised(self, theta, rows, weight=None):
        """Residual (b, p), slope (b, k, p) and weights (b, p) of some windows."""
        xp = self.backend.xp
        data = self.data[rows]
        dx, dy = self.x - theta[:, U, None], self.y - theta[:, V, None]
        p_uu, p_uv, p_vv = theta[:, P_UU, None], theta[:, P_UV, None], theta[:, P_VV, None]
        rise_x, rise_y = p_uu * dx + p_uv * dy, p_uv * dx + p_vv * dy
        q = xp.clip(rise_x * dx + rise_y * dy, 1e-9, 1e4)
        height = theta[:, HEIGHT, None]
        columns: dict[int, Any] = {}
        if POWER in self.free or bool((theta[:, POWER] != 1).any()):
            power = theta[:, POWER, None]
            raised = xp.exp(xp.clip(power * xp.log(q), None, 6.0))
            bell = xp.exp(-0.5 * raised)
            by_q = -0.5 * height * bell * power * raised / q
            columns[POWER] = -0.5 * height * bell * raised * xp.log(q)
        else:
            bell = xp.exp(-0.5 * q)
            by_q = -0.5 * height * bell
        value = theta[:, GROUND, None] + height * bell
        half = (self.n - 1) / 2
        columns[SLOPE_U], columns[SLOPE_V] = self.x / half - 1, self.y / half - 1
        if SLOPE_U in self.free or bool((theta[:, SLOPE_U : SLOPE_V + 1] != 0).any()):
            value = value + theta[:, SLOPE_U, None] * columns[SLOPE_U] + theta[:, SLOPE_V, None] * columns[SLOPE_V]
        near = q
        if self.model.reflects:
            glow, second, q_second = self._second(theta)
            value, near = value + glow, xp.minimum(q, q_second)
            columns |= second
        columns |= {GROUND: 1.0, HEIGHT: bell, U: -2 * by_q * rise_x, V: -2 * by_q * rise_y}
        if P_UU in self.free:
            columns |= {P_UU: by_q * dx**2, P_UV: 2 * by_q * dx * dy, P_VV: by_q * dy**2}
        slope = self.backend.empty((len(theta), len(self.free), self.n**2))
        for place, column in enumerate(self.free):
            slope[:, place] = columns[column]
        gap = data - value
        if self.white is not None:
            above = self.white[rows] & (value >= data)
            gap = xp.where(above, self.backend.array(0.0), gap)
            slope = xp.where(above[:, None, :], self.backend.array(0.0), slope)
        if weight is None:
            weight = 1 / xp.clip(self.noise[0] + self.noise[1] * xp.clip(value, 0.0, None), 1e-6, None)
            if self.model.rim_px:
                beyond = (near**0.5 - RIM_WIDTHS) * xp.clip(p_uu * p_vv - p_uv**2, 1e-8, None) ** -0.25
                weight = weight * xp.exp(-0.5 * xp.clip(beyond / self.model.rim_px, 0.0, None) ** 2)
            elif self.model.taper:
                weight = weight * _taper(near, xp)
            if self.mask is not None:
                weight = weight * self.mask[rows]
        return gap, slope, weight

    def _second(self, theta):
        """The reflection's grey values, their slopes, and the squared distance in its widths."""
        xp = self.backend.xp
        dx, dy = self.x - theta[:, U_2, None], self.y - theta[:, V_2, None]
        rise_x = theta[:, Q_UU, None] * dx + theta[:, Q_UV, None] * dy
        rise_y = theta[:, Q_UV, None] * dx + theta[:, Q_VV, None] * dy
        q = xp.clip(rise_x * dx + rise_y * dy, 0.0, 1e4)
        bell = xp.exp(-0.5 * q)
        glow = theta[:, HEIGHT_2, None] * bell
        slopes = {HEIGHT_2: bell, U_2: glow * rise_x, V_2: glow * rise_y}
        slopes |= {Q_UU: -0.5 * glow * dx**2, Q_UV: -glow * dx * dy, Q_VV: -0.5 * glow * dy**2}
        return glow, slopes, q

    def _allowed(self, theta):
        middle = (self.n - 1) / 2
        inside = (abs(theta[:, U : V + 1] - middle) < self.n / 2).all(-1)
        shape = (theta[:, P_UU] > 0) & (theta[:, P_VV] > 0)
        shape = shape & (theta[:, P_UU] * theta[:, P_VV] > theta[:, P_UV] ** 2)
        shape = shape & (theta[:, POWER] >= 0.7) & (theta[:, POWER] <= SHARPEST)
        if self.model.reflects:
            shape = shape & (theta[:, Q_UU] > 0) & (theta[:, Q_VV] > 0)
            shape = shape & (theta[:, Q_UU] * theta[:, Q_VV] > theta[:, Q_UV] ** 2)
            inside = inside & (abs(theta[:, U_2 : V_2 + 1] - middle) < self.n).all(-1)
        return inside & shape

    def _answer(self, theta, moved) -> SpotFit:
        xp, k = self.backend.xp, len(self.free)
        gap, slope, weight = self._linearised(theta, np.arange(self.b))
        if self.model.taper:
            variance = self.noise[0] + self.noise[1] * xp.clip(self.data - gap, 0.0, None)
        else:
            variance = None
        cost = (weight * gap**2).sum(-1)
        scaled = slope * weight[:, None, :]
        normal = xp.matmul(scaled, slope.swapaxes(1, 2))
        diagonal = xp.diagonal(normal, 0, 1, 2)
        sound = (diagonal > 1e-12).all(-1) & (diagonal < 1e12).all(-1)
        scale = xp.where(sound[:, None], diagonal, self.backend.array(1.0)) ** 0.5
        normal = xp.where(sound[:, None, None], normal, self.backend.eye(k))
        inverse = xp.linalg.inv(normal / scale[:, :, None] / scale[:, None, :] + 1e-12 * self.backend.eye(k))
        inverse = inverse / scale[:, :, None] / scale[:, None, :]
        if variance is None:
            pixels = (weight > 0).sum(-1) * 1.0
            covariance = inverse
        else:
            meat = xp.matmul(scaled * (weight * variance)[:, None, :], slope.swapaxes(1, 2))
            pixels = (weight * variance).sum(-1)
            covariance = xp.matmul(xp.matmul(inverse, meat), inverse)
        chi_square = cost / xp.clip(pixels - k, 1.0, None)
        place = [self.free.index(U), self.free.index(V)]
        spread = xp.diagonal(covariance, 0, 1, 2)[:, place]
        plain = gap if self.mask is None else gap * self.mask
        host = self.backend.numpy
        theta, moved, cost, chi_square = host(theta), host(moved), host(cost), host(chi_square)
        sigma = np.sqrt(np.maximum(host(spread) * np.maximum(chi_square, 1e-12)[:, None], 0.0))
        theta = theta.copy()
        for column in (U, U_2):
            theta[:, column : column + 2] += self.corner
        level, disc = self._level(theta, host(gap))
        noise_dn = np.sqrt(host((plain**2).sum(-1)) / np.maximum(self.usable.sum(axis=1) - k, 1))
        good = (moved < NEARLY_PX) & host(sound) & np.isfinite(sigma).all(axis=1)
        good &= (self.usable.sum(axis=1) > max(LEAST_PIXELS, k + 4)) & (width_of(theta) < self.n / 2)
        return SpotFit(theta, sigma, chi_square, level, disc, noise_dn, good)

    def _level(self, theta: Array, gap: Array) -> tuple[Array, Array]:
        """Mean square residual over the noise model's variance within the spot's disc, and its degrees of freedom."""
        x, y = np.tile(np.arange(self.n), self.n), np.repeat(np.arange(self.n), self.n)
        dx, dy = x - (theta[:, U] - self.corner[:, 0])[:, None], y - (theta[:, V] - self.corner[:, 1])[:, None]
        q = theta[:, P_UU, None] * dx**2 + 2 * theta[:, P_UV, None] * dx * dy + theta[:, P_VV, None] * dy**2
        inside = (q < DISC_WIDTHS**2) & self.usable
        variance = self.noise[0] + self.noise[1] * np.maximum(self.backend.numpy(self.data) - gap, 0.0)
        freedom = np.maximum(inside.sum(axis=1) - len(self.free), 1.0)
        return (inside * gap**2 / np.maximum(variance, 1e-6)).sum(axis=1) / freedom, freedom
