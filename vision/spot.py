"""Sub-pixel place of a spot: an elliptic Gaussian on a sloping ground, fitted to a batch of windows at once.

The ellipse takes up foreshortened discs and motion blur; a symmetric spot's centre is not moved by it. A spot that the
sensor clips has a flat top and steep flanks: there the exponent is freed (super-Gaussian exp(-q^p/2), p >= 1), so that
the flanks place it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

STEPS = 25
_CONVERGED_PX = 1e-4
_TAPER = 2.2
"""The window is weighed down beyond this many widths from the centre, so that a neighbour pulls less."""
SATURATED_COUNT = 4
"""This many pixels near the window's largest value are a flat top: clipped, or a disc with an edge."""
FLAT_SHARE = 0.08
"""... near: within this share of the spot's height (a Gaussian of width 1.5 px has 3 pixels within 8 % of its peak)."""
_SHARPEST = 12.0
_PARAMETERS = 10


@dataclass(frozen=True)
class SpotFit:
    """Fitted spots, one row a window.

    Attributes
    ----------
    centre_px : (b, 2), u and v in the picture
    sigma_px : (b, 2), standard deviation of the centre from the residual scatter
    amplitude_dn : (b,), height above the ground (negative: dark)
    width_px : (b,), geometric mean of the two standard deviations of the spot
    stretch : (b,), ratio of the larger to the smaller
    sharpness : (b,), exponent p: 1 = Gaussian, larger = flat top
    noise_dn : (b,), weighted root mean square residual
    good : (b,), converged inside the window
    """

    centre_px: Array
    sigma_px: Array
    amplitude_dn: Array
    width_px: Array
    stretch: Array
    sharpness: Array
    noise_dn: Array
    good: NDArray[np.bool_]

    def row(self, index: int) -> SpotFit:
        """One window's fit, as a batch of one."""
        return SpotFit(*(getattr(self, f.name)[index : index + 1] for f in fields(self)))


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
    for index, (u, v) in enumerate(corner):
        u0, u1, v0, v1 = max(u, 0), min(u + size, width), max(v, 0), min(v + size, height)
        if u1 > u0 and v1 > v0:
            values[index, v0 - v : v1 - v, u0 - u : u1 - u] = luma[v0:v1, u0:u1]
    return values, corner.astype(float)


def fit_spots(values: Array, corner: Array, start_px: Array, start_width_px: Array, dark: bool = False) -> SpotFit:
    """Gauss-Newton fit of ``values (b, n, n)`` from ``start_px (b, 2)``.

    Model: ground + slope + A exp(-q/2), q = p11 x^2 + 2 p12 x y + p22 y^2 about the centre;
    on flat-topped spots exp(-q^p/2) with p free.
    """
    b, n, _ = values.shape
    grid = np.arange(n, dtype=float)
    x = np.broadcast_to(grid[None, None, :], values.shape).reshape(b, -1)
    y = np.broadcast_to(grid[None, :, None], values.shape).reshape(b, -1)
    data = values.reshape(b, -1)
    usable = np.isfinite(data)
    data = np.where(usable, data, 0.0)
    centre = start_px - corner
    width = np.clip(np.asarray(start_width_px, dtype=float), 0.6, n / 3)
    ground = np.array([np.median(d[m]) if m.any() else 0.0 for d, m in zip(data, usable)])
    sign = -1.0 if dark else 1.0
    peak = np.array([(sign * d[m]).max() * sign if m.any() else 0.0 for d, m in zip(data, usable)])
    theta = np.column_stack(
        [ground, np.zeros(b), np.zeros(b), peak - ground, centre, 1 / width**2, np.zeros(b), 1 / width**2, np.ones(b)]
    )
    flat = _flat_topped(sign * data, usable, sign * ground)
    theta[:, 9] = np.where(flat, 2.0, 1.0)
    theta[:, 3] = np.where(sign * theta[:, 3] > 1, theta[:, 3], sign)
    damping = np.full(b, 1e-3)
    gap, slope = _model(theta, x, y, data, flat)
    weight = _weights(theta, x, y, usable)
    cost = (weight * gap**2).sum(axis=1)
    moved = np.full(b, np.inf)
    for step_number in range(STEPS):
        normal = np.einsum("bpi,bp,bpj->bij", slope, weight, slope)
        right = np.einsum("bpi,bp,bp->bi", slope, weight, gap)
        diagonal = np.einsum("bii->bi", normal)
        damped = normal + (damping[:, None] * diagonal + 1e-12)[:, :, None] * np.eye(_PARAMETERS)
        step = np.linalg.solve(damped, right[:, :, None])[:, :, 0]
        trial = theta + step
        new_gap, new_slope = _model(trial, x, y, data, flat)
        new_cost = (weight * new_gap**2).sum(axis=1)
        inside = (np.abs(trial[:, 4:6] - (n - 1) / 2) < n / 2).all(axis=1)
        shape = (trial[:, 6] > 0) & (trial[:, 8] > 0) & (trial[:, 6] * trial[:, 8] > trial[:, 7] ** 2)
        shape &= (trial[:, 9] >= 0.7) & (trial[:, 9] <= _SHARPEST)
        better = np.isfinite(new_cost) & (new_cost <= cost) & inside & shape
        moved = np.where(better, np.hypot(step[:, 4], step[:, 5]), moved)
        theta = np.where(better[:, None], trial, theta)
        gap = np.where(better[:, None], new_gap, gap)
        slope = np.where(better[:, None, None], new_slope, slope)
        damping = np.where(better, damping / 5, damping * 8)
        if step_number in (2, 5):  # the taper follows the spot twice, then stands, so that the cost can converge
            weight = _weights(theta, x, y, usable)
            cost = (weight * gap**2).sum(axis=1)
        else:
            cost = np.where(better, new_cost, cost)
        if step_number > 6 and (moved < _CONVERGED_PX).all():
            break
    return _answer(theta, slope, gap, weight, corner, moved, usable, sign, n)


def _answer(theta, slope, gap, weight, corner, moved, usable, sign, n) -> SpotFit:
    effective = np.maximum(weight.sum(axis=1) - _PARAMETERS, 1.0)
    noise = np.sqrt((weight * gap**2).sum(axis=1) / effective)
    normal = np.einsum("bpi,bp,bpj->bij", slope, weight, slope)
    meat = np.einsum("bpi,bp,bpj->bij", slope, weight**2, slope)
    diagonal = np.einsum("bii->bi", normal)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = normal / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(_PARAMETERS)
    inverse = np.linalg.inv(scaled) / scale[:, :, None] / scale[:, None, :]
    covariance = inverse @ meat @ inverse * (noise**2)[:, None, None]
    trace = theta[:, 6] + theta[:, 8]
    determinant = np.maximum(theta[:, 6] * theta[:, 8] - theta[:, 7] ** 2, 1e-12)
    root = np.sqrt(np.maximum(trace**2 / 4 - determinant, 0.0))
    stretch = np.sqrt((trace / 2 + root) / np.maximum(trace / 2 - root, 1e-12))
    sigma = np.sqrt(np.maximum(np.column_stack([covariance[:, 4, 4], covariance[:, 5, 5]]), 0.0))
    width = determinant**-0.25
    good = (
        (moved < 0.05)
        & np.isfinite(sigma).all(axis=1)
        & (sign * theta[:, 3] > 0)
        & (usable.sum(axis=1) > 20)
        & (width < n / 2)
    )
    return SpotFit(theta[:, 4:6] + corner, sigma, theta[:, 3], width, stretch, theta[:, 9], noise, good)


def _flat_topped(data: Array, usable: NDArray[np.bool_], ground: Array) -> NDArray[np.bool_]:
    """Windows whose spot (bright in ``data``) has a plateau."""
    top = np.where(usable, data, -np.inf).max(axis=1)
    near = usable & (data >= (top - FLAT_SHARE * (top - ground))[:, None])
    return near.sum(axis=1) >= SATURATED_COUNT


def _quadratic(theta: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    dx, dy = x - theta[:, 4:5], y - theta[:, 5:6]
    return dx, dy, theta[:, 6:7] * dx**2 + 2 * theta[:, 7:8] * dx * dy + theta[:, 8:9] * dy**2


def _weights(theta: Array, x: Array, y: Array, usable: NDArray[np.bool_]) -> Array:
    _, _, q = _quadratic(theta, x, y)
    taper = np.exp(-0.5 * np.maximum(np.sqrt(np.maximum(q, 0.0)) - _TAPER, 0.0) ** 2)
    return taper * usable


def _model(theta: Array, x: Array, y: Array, data: Array, flat: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Residual (b, p) and the model's slope (b, p, 10); the exponent's slope is 0 where it is not free."""
    dx, dy, q = _quadratic(theta, x, y)
    q = np.clip(q, 1e-9, 1e4)
    power = theta[:, 9:10]
    raised = np.exp(np.minimum(power * np.log(q), 6.0))
    bell = np.exp(-0.5 * raised)
    amplitude = theta[:, 3:4] * bell
    by_q = -0.5 * amplitude * power * raised / q
    size = x.max() / 2
    value = theta[:, 0:1] + theta[:, 1:2] * (x / size - 1) + theta[:, 2:3] * (y / size - 1) + amplitude
    slope = np.stack(
        [
            np.ones_like(x),
            x / size - 1,
            y / size - 1,
            bell,
            -2 * by_q * (theta[:, 6:7] * dx + theta[:, 7:8] * dy),
            -2 * by_q * (theta[:, 7:8] * dx + theta[:, 8:9] * dy),
            by_q * dx**2,
            2 * by_q * dx * dy,
            by_q * dy**2,
            -0.5 * amplitude * raised * np.log(q) * flat[:, None],
        ],
        axis=2,
    )
    return data - value, slope
