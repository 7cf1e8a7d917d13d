"""ARX of order 4 (8.35-8.42): estimate with decimation, poles in continuous time, characteristic coefficients, derivatives by 9.3.

    A(q) y = B(q) u + e,   A = 1 - a1 q^-1 - .. - a4 q^-4,   B = b1 q^-1 + .. + b4 q^-4

y may hold several channels (y and beta) that share A. A free tow has no u: then a constant takes the bias. Where LS is biased
by noise in y (always, in a measured tow) ``method="iv"`` uses the model's own simulated response as instruments (theory.md 9.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...record.errors import EstimationError, solvable
from ...simulate.model import Array, Hull, Tow, linear_system, sway_yaw_acceleration
from .characteristic import derivatives_from_coefficients, roots_from_coefficients
from .common import Record, SixEstimate, check_series, propagate
from .least_squares import least_squares_svd

ORDER = 4
"""Of the model, as in (8.35): four roots of the tow."""
IV_ROUNDS = 6
"""Of instruments made from the last estimate; the best of them is kept. A choice."""
BEST_STEP_PER_ROOT = 2.2
"""Step times the fastest root that ``suggested_decimation`` aims at: below 0.5 the z roots crowd at 1,
above 4 the fast one is gone in the noise."""


@dataclass(frozen=True)
class ArxFit:
    """Result of ``fit_arx``.

    Attributes
    ----------
    a : (4,), a1..a4
    b : (channels, 4), b1..b4 of each channel; empty without input
    covariance : (4, 4), of a; "ls": for a white equation error, "iv": for white noise in y
    step_s : after decimation
    z_poles : (4,)
    coefficients, coefficient_covariance : (4,), (4, 4): b, c, d, e of s^4 + b s^3 + c s^2 + d s + e
    poles, pole_sd : (4,) 1/s by falling real part, (4, 2) sd of real and imaginary part
    sigma : (channels,), residual scatter
    """

    a: Array
    b: Array
    covariance: Array
    step_s: float
    z_poles: Array
    coefficients: Array
    coefficient_covariance: Array
    poles: Array
    pole_sd: Array
    sigma: Array


def suggested_decimation(step_s: float, fastest_root_per_s: float) -> int:
    """Samples per ARX step for a fastest expected root (about U/Lpp times 2.4 for MARINER: 1.2 1/s at 1.28 m/s).

    Parameters
    ----------
    step_s : between samples, s
    fastest_root_per_s : size of the root, 1/s
    """
    return max(1, round(BEST_STEP_PER_ROOT / fastest_root_per_s / step_s))


def continuous_coefficients(a: Array, step_s: float) -> Array:
    """(b, c, d, e) of the continuous characteristic equation from a1..a4: s_i = ln(z_i)/h (theory.md 9.6).

    Parameters
    ----------
    a : (4,), of z^4 + a1 z^3 + .. + a4
    step_s : h, s

    Raises
    ------
    EstimationError : a root z at or below 0, which no continuous system sampled at h has
    """
    z = np.roots(np.concatenate([[1.0], -np.asarray(a)]))
    bad = (np.abs(z.imag) < 1e-12) & (z.real <= 0)
    if bad.any() or len(z) < len(a):
        raise EstimationError(
            f"the discrete model has a root z = {z[bad][0].real if bad.any() else 0:.3g}: no continuous motion sampled every "
            f"{step_s:g} s has one; use another decimation, or method='iv'"
        )
    s = np.log(z.astype(complex)) / step_s
    return np.real(np.poly(s))[1:]


@solvable(EstimationError)
def fit_arx(
    y: Array,
    step_s: float,
    *,
    u: Array | None = None,
    decimation: int = 1,
    method: Literal["ls", "iv"] = "ls",
    scale: Array | None = None,
) -> ArxFit:
    """Estimate ARX-4 (8.41, 8.42).

    Parameters
    ----------
    y : (n,) or (n, channels), evenly sampled
    step_s : between samples, s
    u : (n,), an outside input held between samples; None = a free motion with a constant in each channel
    decimation : d; the lags are d samples, all d phases are used
    method : "ls", or "iv" with instruments from the fitted model's simulated response
    scale : (channels,), noise of each channel; default: alike relative to their scatter

    Raises
    ------
    EstimationError : too few samples, or poles without a continuous counterpart
    """
    values = np.asarray(y, dtype=float)
    check_series(np.arange(len(values)), values)
    values = values.reshape(len(values), -1)
    lag = decimation * np.arange(ORDER + 1)
    if len(values) < 3 * lag[-1] + 20:
        raise EstimationError(f"{len(values)} samples are too few for ARX-4 at a decimation of {decimation}")
    sizes = values.std(axis=0) if scale is None else np.asarray(scale, dtype=float)
    rows, target = _regression(values / sizes, u, lag)
    least = least_squares_svd(rows, target)
    theta, instruments = least.theta, rows
    channels = values.shape[1]
    if method == "iv":
        best = np.inf
        trial = theta
        for _ in range(IV_ROUNDS):
            clean = simulated_response(values / sizes, u, trial, decimation)
            misfit = float(((values / sizes - clean) ** 2).sum())
            if misfit < best:  # the instruments of the model that simulates the record best
                best, theta = misfit, trial
                instruments, _ = _regression(clean, u, lag)
            here, _ = _regression(clean, u, lag)
            trial = np.linalg.lstsq(here.T @ rows, here.T @ target, rcond=None)[0]
    residual = target - rows @ theta
    a = theta[:ORDER]
    covariance = _covariance(rows, instruments, residual, channels, lag, a if method == "iv" else None)[:ORDER, :ORDER]
    coefficients, spread = propagate(lambda x: continuous_coefficients(x, decimation * step_s), a, covariance)
    poles, pole_sd = roots_from_coefficients(coefficients, spread)
    own = theta[ORDER:].reshape(channels, -1)
    return ArxFit(
        a=a,
        b=own * sizes[:, None] if u is not None else np.zeros((channels, 0)),
        covariance=covariance,
        step_s=decimation * step_s,
        z_poles=np.roots(np.concatenate([[1.0], -a])),
        coefficients=coefficients,
        coefficient_covariance=spread,
        poles=poles,
        pole_sd=pole_sd,
        sigma=residual.reshape(channels, -1).std(axis=1) * sizes,
    )


def _regression(values: Array, u: Array | None, lag: Array) -> tuple[Array, Array]:
    """Rows and target of all channels, one under the other: shared lags of y, own lags of u (or own constant)."""
    count, channels = len(values) - lag[-1], values.shape[1]
    shifted = [np.arange(lag[-1] - k, lag[-1] - k + count) for k in lag[1:]]
    outside = np.ones((count, 1)) if u is None else np.column_stack([np.asarray(u)[k] for k in shifted])
    own = outside.shape[1]
    rows = np.zeros((channels * count, ORDER + channels * own))
    target = np.empty(channels * count)
    for channel in range(channels):
        here = slice(channel * count, (channel + 1) * count)
        rows[here, :ORDER] = np.column_stack([values[k, channel] for k in shifted])
        rows[here, ORDER + channel * own : ORDER + (channel + 1) * own] = outside
        target[here] = values[lag[-1] :, channel]
    return rows, target


def simulated_response(values: Array, u: Array | None, theta: Array, decimation: int) -> Array:
    """Simulate a model without noise: driven by u, or as free modes with the amplitudes that fit the record best.

    Parameters
    ----------
    values : (n, channels) record; of a driven model only its shape counts
    u : (n,) input, or None
    theta : coefficients a, and behind them b of each channel where there is an input
    decimation : samples to a lag

    Returns
    -------
    response : (n, channels)
    """
    if u is None:
        z = np.roots(np.concatenate([[1.0], -theta[:ORDER]])).astype(complex)
        z = np.where((np.imag(z) == 0) & (np.real(z) <= 0), 1e-6, z)
        power = np.exp(np.log(z)[None, :] / decimation * np.arange(len(values))[:, None])
        size = np.maximum(np.abs(power).max(axis=0), 1e-300)
        basis = np.column_stack([np.ones(len(values)), np.real(power / size), np.imag(power / size)])
        return basis @ np.linalg.lstsq(basis, values, rcond=1e-12)[0]
    own = theta[ORDER:].reshape(values.shape[1], -1)
    clean = np.zeros_like(values)
    lags = decimation * np.arange(1, ORDER + 1)
    for k in range(len(values)):
        past = [k - j for j in lags]
        old = np.array([clean[p] if p >= 0 else np.zeros(values.shape[1]) for p in past])
        force = np.array([u[p] if p >= 0 else 0.0 for p in past])
        clean[k] = np.clip(theta[:ORDER] @ old + own @ force, -1e3, 1e3)  # a wild trial stays finite
    return clean


def _covariance(rows: Array, instruments: Array, residual: Array, channels: int, lag: Array, a: Array | None) -> Array:
    """(Z'F)^-1 M (Z'F)^-T with M of a white equation error, or (``a`` given) of white noise in y: w_k = sum A_j e_(k-j)."""
    count = len(residual) // channels
    meat = np.zeros((instruments.shape[1], instruments.shape[1]))
    for channel in range(channels):
        z, w = (x[channel * count : (channel + 1) * count] for x in (instruments, residual))
        if a is not None:
            # each e_k enters the equations k, k + d, ... with the weights A_j
            polynomial = np.concatenate([[1.0], -a])
            spread = np.zeros((count + lag[-1], z.shape[1]))
            for size, k in zip(polynomial, lag, strict=True):
                start = lag[-1] - k
                spread[start : start + count] += size * z
            z, w = spread, w / np.sqrt(polynomial @ polynomial)
        meat += z.T @ z * float(w @ w) / count
    bread = np.linalg.pinv(instruments.T @ rows, rcond=1e-13)
    return bread @ meat @ bread.T


def discrete_tow(hull: Hull, tow: Tow, step_s: float) -> tuple[Array, Array]:
    """a1..a4 and b1..b4 of (y, beta), (2, 4), of a tow under a lateral force at X_T held over each step: (5.22).

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    step_s : h, s
    """
    from scipy.linalg import expm

    here = hull.at_speed(tow.speed_m_s)
    matrix, _ = linear_system(here, tow)
    column = np.array([0.0, 0.0, *sway_yaw_acceleration(here, 0.0, 0.0, 1.0, tow.tow_point_m)])
    block = np.zeros((5, 5))
    block[:4, :4], block[:4, 4] = matrix, column
    whole = expm(block * step_s)
    polynomial = np.real(np.poly(np.linalg.eigvals(whole[:4, :4])))
    # Markov parameters times A(q): b_k = sum_j A_j h_(k-j)
    state, markov = whole[:4, 4], []
    for _ in range(ORDER):
        markov.append(state[:2])
        state = whole[:4, :4] @ state
    found = np.array([sum(polynomial[j] * markov[k - j] for j in range(k + 1)) for k in range(ORDER)])
    return -polynomial[1:], found.T


def arx_derivatives(fits: Sequence[ArxFit], tows: tuple[Tow, Tow]) -> SixEstimate:
    """Six derivatives from ARX fits at two tow points through (9.3), the poles' covariance propagated.

    Parameters
    ----------
    fits : of the two tows
    tows : of one T, L, U
    """
    covariance = np.zeros((8, 8))
    covariance[:4, :4], covariance[4:, 4:] = fits[0].coefficient_covariance, fits[1].coefficient_covariance
    return derivatives_from_coefficients(fits[0].coefficients, fits[1].coefficients, tows, covariance)


@solvable(EstimationError)
def arx_of_records(
    records: tuple[Record, Record], decimation: int, method: Literal["ls", "iv"] = "iv"
) -> tuple[tuple[ArxFit, ArxFit], SixEstimate]:
    """ARX-4 of two free tows (y and beta share A) and the derivatives that follow.

    Parameters
    ----------
    records : of two free tows at two tow points, evenly sampled
    decimation : samples to a lag
    method : "ls" or "iv", as in ``fit_arx``

    Returns
    -------
    the two fits, and the six derivatives with their covariance
    """
    first, second = (
        fit_arx(np.column_stack([r.y_m, r.beta_rad]), r.step_s, decimation=decimation, method=method) for r in records
    )
    return (first, second), arx_derivatives((first, second), (records[0].tow, records[1].tow))
