"""The fit of a model to a batch of windows at once: damped Gauss-Newton, on numpy or on a graphics card."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend import NUMPY, Backend
from .model import (
    DISC_WIDTHS,
    GROUND,
    HEIGHT,
    HEIGHT_2,
    P_UU,
    P_UV,
    P_VV,
    POWER,
    Q_UU,
    Q_UV,
    Q_VV,
    RIM_WIDTHS,
    SLOPE_U,
    SLOPE_V,
    U_2,
    V_2,
    Array,
    Model,
    SpotFit,
    U,
    V,
    taper_of,
    width_of,
)

STEPS = 30
"""Gauss-Newton steps at most, damped ones included."""
CONVERGED_PX = 5e-4
"""Gauss-Newton converges quadratically here: after a step this small the next one is below 1e-5 px."""
CONVERGED_VARIANCES = 0.01
"""... and no parameter was farther than a tenth of its own standard deviation from where the step took it."""
NEARLY_PX = 0.05
"""A fit that ran out of steps counts if its last one was shorter than this: a choice."""
SHARPEST = 12.0
"""Largest power of a flat top (1: a Gaussian): beyond it its edge is sharper than a pixel can show."""
WHITE_MARGIN_DN = 1.5
"""A pixel so near to white is taken as clipped: rounding, and a codec's ringing."""
LEAST_DISC_PX = 1.6
"""The disc by which a fit is judged has at least this radius: nine pixels, of which a mark narrower than a pixel would leave none
that its parameters have not taken up."""
LEAST_PIXELS = 20
"""A fit on fewer usable pixels of a window does not count: a choice."""


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
    model : what is free
    noise : variance of a grey value mu is noise[0] + noise[1] max(mu, 0), DN^2
    white_dn : the sensor's or codec's largest value; such pixels may truly be brighter
    backend : numpy or a graphics card
    """
    problem = _Problem(values, corner, model, noise, white_dn, backend)
    return problem.solve(start)


def pull_of(values: Array, corner: Array, theta: Array, model: Model, noise: tuple[float, float]) -> Array:
    """What a small change of each pixel's grey value does to a fitted centre.

    Parameters
    ----------
    values, corner, model, noise : of ``fit_spots``
    theta : (b, 16), the parameters that it found

    Returns
    -------
    pull : (b, 2, n, n), px of u and v per grey value
    """
    local = np.array(theta, dtype=float)
    for column in (U, U_2):
        local[:, column : column + 2] -= corner
    problem = _Problem(values, corner, model, noise, None, NUMPY)
    _, slope, weight = problem._linearised(local, np.arange(len(local)))
    length = np.sqrt(np.maximum((slope**2 * weight[:, None]).sum(axis=2), 1e-12))
    unit = slope / length[:, :, None]
    scaled = unit * weight[:, None]
    inverse = np.linalg.pinv(scaled @ unit.swapaxes(1, 2), hermitian=True)
    place = [problem.free.index(U), problem.free.index(V)]
    pull = (inverse @ scaled)[:, place] / length[:, place, None]
    return pull.reshape(len(values), 2, problem.n, problem.n)


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
                weight = weight * taper_of(near, xp)
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
        inside = ((q < DISC_WIDTHS**2) | (dx**2 + dy**2 < LEAST_DISC_PX**2)) & self.usable
        variance = self.noise[0] + self.noise[1] * np.maximum(self.backend.numpy(self.data) - gap, 0.0)
        freedom = np.maximum(inside.sum(axis=1) - len(self.free), 1.0)
        return (inside * gap**2 / np.maximum(variance, 1e-6)).sum(axis=1) / freedom, freedom
