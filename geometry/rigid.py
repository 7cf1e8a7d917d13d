"""Rigid markers seen in the plane -> place and heading of the model, frame by frame, weighted, vectorised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .camera import Array, inverse_2x2

_STEPS = 6
"""Gauss-Newton steps from the Procrustes start, at most: convergence is quadratic, as no residual is large."""
_SMALLEST_STEP = 1e-12
"""m and rad: the next step would be its square."""


@dataclass(frozen=True)
class RigidFit:
    """Pose of the body in every frame.

    Attributes
    ----------
    pose : (n, 3), x_CG m, y_CG m, beta rad; NaN where fewer than two markers were seen
    covariance : (n, 3, 3), from the markers' covariances
    gain : (n, 3, m, 2), d(pose)/d(marker place); 0 for a marker not seen
    chi_square : (n,), of the rigid fit; expected 2 * seen - 3
    seen : (n,), markers used
    """

    pose: Array
    covariance: Array
    gain: Array
    chi_square: Array
    seen: Array


def fit_rigid(place_m: Array, covariance_m2: Array, body_m: Array) -> RigidFit:
    """Weighted least squares of x = x_CG + xi cos b - yi sin b, y = y_CG + xi sin b + yi cos b (theory.md 9.1).

    Parameters
    ----------
    place_m : (n, m, 2), NaN where a marker is lost
    covariance_m2 : (n, m, 2, 2)
    body_m : (m, 2), ahead of LCG and to starboard
    """
    good = np.asarray(np.isfinite(place_m).all(axis=2) & np.isfinite(covariance_m2).all(axis=(2, 3)))
    seen = good.sum(axis=1)
    usable = np.asarray(seen >= 2)
    n = len(place_m)
    pose = np.full((n, 3), np.nan)
    covariance = np.full((n, 3, 3), np.nan)
    gain = np.zeros((n, 3, len(body_m), 2))
    chi_square = np.full(n, np.nan)
    if not usable.any():
        return RigidFit(pose, covariance, gain, chi_square, seen)
    mask = good[usable]
    place = np.where(mask[:, :, None], place_m[usable], 0.0)
    matrix = np.where(mask[:, :, None, None], covariance_m2[usable], np.eye(2))
    weight = inverse_2x2(matrix) * mask[:, :, None, None]
    state = _procrustes(place, mask, body_m)
    for _ in range(_STEPS):
        normal, right, _, _ = _normal(state, place, body_m, weight)
        step = np.linalg.solve(normal, right)[:, :, 0]
        state = state + step
        if np.abs(step).max() < _SMALLEST_STEP:
            break
    normal, _, gap, pull = _normal(state, place, body_m, weight)
    inverse = np.linalg.inv(normal)
    pose[usable] = state
    covariance[usable] = inverse
    gain[usable] = (inverse @ pull).reshape(-1, 3, len(body_m), 2)
    chi_square[usable] = (gap * (weight @ gap[..., None])[..., 0]).sum(axis=(1, 2))
    return RigidFit(pose, covariance, gain, chi_square, seen)


def _normal(state: Array, place: Array, body: Array, weight: Array) -> tuple[Array, Array, Array, Array]:
    """Normal matrix (n, 3, 3), its right side (n, 3, 1), gaps (n, m, 2) and weighted slopes (n, 3, 2m)."""
    gap, slope = _residual(state, place, body)
    rows = slope.reshape(len(gap), -1, 3)
    pull = (weight @ slope).reshape(rows.shape).transpose(0, 2, 1)
    return pull @ rows, pull @ gap.reshape(len(gap), -1, 1), gap, pull


def _residual(state: Array, place: Array, body: Array) -> tuple[Array, Array]:
    cosine, sine = np.cos(state[:, 2]), np.sin(state[:, 2])
    along = cosine[:, None] * body[:, 0] - sine[:, None] * body[:, 1]
    across = sine[:, None] * body[:, 0] + cosine[:, None] * body[:, 1]
    gap = place - np.stack([state[:, 0:1] + along, state[:, 1:2] + across], axis=2)
    slope = np.zeros((*gap.shape, 3))
    slope[:, :, 0, 0] = slope[:, :, 1, 1] = 1.0
    slope[:, :, 0, 2], slope[:, :, 1, 2] = -across, along
    return gap, slope


def _procrustes(place: Array, mask: Array, body: Array) -> Array:
    count = mask.sum(axis=1)[:, None]
    mean_place = (place * mask[:, :, None]).sum(axis=1) / count
    mean_body = (body[None] * mask[:, :, None]).sum(axis=1) / count
    p = (place - mean_place[:, None]) * mask[:, :, None]
    b = (body[None] - mean_body[:, None]) * mask[:, :, None]
    dot = (p * b).sum(axis=(1, 2))
    cross = (b[:, :, 0] * p[:, :, 1] - b[:, :, 1] * p[:, :, 0]).sum(axis=1)
    heading = np.arctan2(cross, dot)
    cosine, sine = np.cos(heading), np.sin(heading)
    x = mean_place[:, 0] - cosine * mean_body[:, 0] + sine * mean_body[:, 1]
    y = mean_place[:, 1] - sine * mean_body[:, 0] - cosine * mean_body[:, 1]
    return np.column_stack([x, y, heading])
