"""The search of the decay fit: variable projection for l1, l2, l3, w under bounds, from several starts."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..record.errors import EstimationError
from ..simulate.model import Array
from .noise import Whitener, stated

Sign = Literal["stable", "unstable", "free"]
SLOWEST_SHARE = 0.2
"""l2 is not looked for below this share of one over the record's length: it could not be told from the bias."""
FASTEST_SHARE = 0.5
"""l1 is not looked for above this share of the sampling rate: the exponential would live in one sample."""
SAME_OPTIMUM = 1e-4
"""Starts whose cost ends within this share of the best have reached the optimum."""
LARGEST_GROWTH = 30.0
"""A growing pair is looked for up to this power of e over the record."""
ALIKE = 1e-10
"""Columns of which less than this is no part of the others: their amplitudes are not told apart."""
NOTHING = 1e-100
"""Whitened columns smaller than this are none: a motion at rest has no amplitudes, and tells no rates. Its square is divided by."""
THINNED = 200
"""Samples that the starts are tried on; the best goes on with all (the thesis thinned 64 Hz to 8 Hz for the same reason)."""


def limits_of(t: Array, reduced: bool, sign: Sign) -> tuple[Array, Array]:
    """Lower and upper of (l2, l3, w) or (l1 - l2, l2, l3, w).

    Parameters
    ----------
    t : (n,), s from the record's start
    reduced : one exponential less
    sign : of the pair's damping: "stable", "unstable" or "free"
    """
    span, rate = t[-1], (len(t) - 1) / t[-1]
    slow, fast = SLOWEST_SHARE / span, FASTEST_SHARE * rate
    tiny, grow = 1e-9 / span, LARGEST_GROWTH / span
    damping = {"stable": (tiny, fast), "unstable": (-grow, -tiny), "free": (-grow, fast)}[sign]
    low, high = [slow, damping[0], 1.5 * np.pi / span], [fast, damping[1], np.pi * rate / 2]
    if not reduced:
        low, high = [slow, *low], [fast, *high]
    return np.array(low), np.array(high)


def basis_of(t: Array, p: Array, reduced: bool) -> tuple[Array, Array]:
    """Columns 1, e1, e2, cos, sin, (n, k), and their slopes by p, (len(p), n, k).

    Parameters
    ----------
    t : (n,), s from the record's start
    p : (k,) rates
    reduced : one exponential less
    """
    l2, l3, w = p[-3:]
    swing, e2 = np.exp(-l3 * t), np.exp(-l2 * t)
    cos, sin = swing * np.cos(w * t), swing * np.sin(w * t)
    columns = [np.ones_like(t), e2, cos, sin]
    zero = np.zeros_like(t)
    slopes = [[zero, -t * e2, zero, zero], [zero, zero, -t * cos, -t * sin], [zero, zero, -t * sin, t * cos]]
    if not reduced:
        e1 = np.exp(-(p[0] + l2) * t)
        columns.insert(1, e1)
        for row, value in zip(slopes, (-t * e1, zero, zero), strict=True):
            row.insert(1, value)
        slopes.insert(0, [zero, -t * e1, zero, zero, zero])
    return np.column_stack(columns), np.array(slopes).transpose(0, 2, 1)


def best_model(t: Array, p: Array, values: Array, weight: Whitener, reduced: bool):
    """Best model (n, 2), its amplitudes (2, k), whitened residual (2n,) and Kaufman Jacobian (2n, len(p)).

    Parameters
    ----------
    t : (n,), s from the record's start
    p : (k,) rates
    values : (n, 2)
    weight : whitens residuals
    reduced : one exponential less
    """
    basis, slopes = basis_of(t, p, reduced)
    white = weight.along(np.ascontiguousarray(np.broadcast_to(basis.T, (2, *basis.T.shape))))
    target = weight.along(np.ascontiguousarray(values.T))
    q, r = np.linalg.qr(white.transpose(0, 2, 1))
    across = q.transpose(0, 2, 1)
    projected = (across @ target[..., None])[..., 0]
    residual = target - (q @ projected[..., None])[..., 0]
    found = _amplitudes(r, projected)
    moves = np.einsum("pnk,ck->cpn", slopes, found)
    if weight.mixes:
        moved = np.array([weight.along(np.array([move, move]))[channel] for channel, move in enumerate(moves)])
    else:
        moved = weight.along(moves)
    moved = moved.transpose(0, 2, 1)
    jacobian = q @ (across @ moved) - moved
    return basis @ found.T, found, residual.ravel(), jacobian.reshape(-1, jacobian.shape[2])


def inverse_of_squares(
    t: Array, p: Array, amplitudes: Array, weight: Whitener, reduced: bool, smallest_share: float
) -> Array:
    """Inverse normal matrix (k + 2 a, k + 2 a) of the rates and of either channel's amplitudes: their covariance by unit noise.

    Parameters
    ----------
    t : (n,), s from the record's start
    p : (k,) rates
    amplitudes : (2, a) of the best model
    weight : whitens residuals
    reduced : one exponential less
    smallest_share : a direction that is told less than this share of the best told one counts as not told
    """
    basis, slopes = basis_of(t, p, reduced)
    count, k = len(p), basis.shape[1]
    full = np.zeros((len(t), 2, count + 2 * k))
    for channel in range(2):
        full[:, channel, :count] = (slopes @ amplitudes[channel]).T
        full[:, channel, count + channel * k : count + (channel + 1) * k] = basis
    white = weight(full).reshape(-1, count + 2 * k)
    scale = np.maximum(np.linalg.norm(white, axis=0), NOTHING)
    inverse = np.linalg.pinv((white / scale).T @ (white / scale), rcond=smallest_share, hermitian=True)
    return inverse / scale[:, None] / scale


def _amplitudes(r: Array, projected: Array) -> Array:
    """(2, k) from the triangles (2, k, k) of either channel; the smallest ones where columns resemble each other too much."""
    size = np.abs(np.diagonal(r, axis1=1, axis2=2))
    if (size.min(axis=1) > ALIKE * size.max(axis=1)).all():
        return np.linalg.solve(r, projected[..., None])[..., 0]
    return np.array([np.linalg.lstsq(a, b, rcond=1e-13)[0] for a, b in zip(r, projected, strict=True)])


def search(
    t: Array,
    values: Array,
    weight: Whitener,
    start: Array,
    limits: tuple[Array, Array],
    reduced: bool,
    tolerance: float = 1e-12,
):
    """Bounded least squares of a decay's rates by variable projection, from one start.

    Parameters
    ----------
    t : (n,), s from the record's start
    values : (n, 2)
    weight : whitens residuals
    start : (k,) rates
    limits : lower and upper, (k,) each
    reduced : one exponential less
    tolerance : of cost and step

    Returns
    -------
    scipy's result
    """
    from scipy.optimize import least_squares  # takes long to load, and most commands look for no decay

    inside = np.clip(start, limits[0] * (1 + 1e-6) + 1e-12, limits[1] - 1e-6 * np.abs(limits[1]) - 1e-12)
    last: list[tuple[Array, Array, Array]] = []

    def both(p: Array) -> tuple[Array, Array, Array]:
        if not last or not np.array_equal(last[0][0], p):
            last[:] = [(p.copy(), *best_model(t, p, values, weight, reduced)[2:])]
        return last[0]

    return least_squares(
        lambda p: both(p)[1],
        inside,
        jac=lambda p: both(p)[2],  # pyright: ignore[reportArgumentType]
        bounds=limits,
        x_scale=np.maximum(np.abs(inside), 0.05),
        ftol=tolerance,
        xtol=tolerance,
        gtol=1e-12,
        max_nfev=100,
    )


def from_all_starts(t: Array, values: Array, weight: Whitener, limits: tuple[Array, Array], reduced: bool):
    """The best of ``search`` from a grid of frequencies and dampings about the spectrum's peak, on a thinned record at first.

    Parameters
    ----------
    t : (n,), s from the record's start
    values : (n, 2)
    weight : whitens residuals
    limits : lower and upper, (k,) each
    reduced : one exponential less

    Returns
    -------
    rates (k,), how many of the starts reached them, and how many there were
    """
    peak = strongest_rad_s(t, values)
    if not np.isfinite(peak):
        raise EstimationError(
            f"no oscillation of at least three quarters of a swing in {t[-1]:.1f} s; (8.20) needs one"
        )
    starts = []
    for w in (peak, 0.7 * peak, 1.4 * peak):
        for l3 in (0.01 * w, 0.2 * w):
            for l2 in (0.3 * w, w):
                l3_signed = -l3 if limits[1][-2] < 0 else l3
                starts.append([l2, l3_signed, w] if reduced else [2.5 * w, l2, l3_signed, w])
    every = max(1, len(t) // THINNED)
    few = stated(np.linalg.inv(np.einsum("nji,njk->nik", weight.matrices, weight.matrices))[::every], t[::every])
    found = [search(t[::every], values[::every], few, np.array(s), limits, reduced, 1e-8) for s in starts]
    costs = np.array([f.cost for f in found])
    best = found[int(np.argmin(costs))]
    # at the noise's floor of an exact record the costs differ by rounding only
    floor = SAME_OPTIMUM * best.cost + 1e-9 * float((few(values[::every]) ** 2).sum())
    reached = int((costs <= best.cost + floor).sum())
    return search(t, values, weight, best.x, limits, reduced).x, reached, len(starts)


def strongest_rad_s(t: Array, values: Array) -> float:
    """Find the strongest line in the spectrum of both channels together (Lomb-Scargle by least squares on sin, cos, 1, t).

    Parameters
    ----------
    t : (n,) s, from 0
    values : (n, 2)

    Returns
    -------
    frequency : rad/s, on a grid of 160 from three quarters of a cycle to thirty cycles over the record
    """
    trial = np.linspace(1.5 * np.pi / t[-1], min(60 * np.pi / t[-1], np.pi * len(t) / t[-1] / 3), 160)
    scaled = values / np.maximum(np.ptp(values, axis=0), 1e-300)
    window = np.column_stack([np.ones_like(t), t / t[-1]])
    best, at = np.inf, np.nan
    for w in trial:
        basis = np.column_stack([window, np.cos(w * t), np.sin(w * t)])
        q, _ = np.linalg.qr(basis)
        rest = float(((scaled - q @ (q.T @ scaled)) ** 2).sum())
        if rest < best:
            best, at = rest, float(w)
    return at
