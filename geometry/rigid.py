"""Rigid markers seen in the plane -> place and heading of the model, frame by frame, weighted, vectorised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .camera import Array

_STEPS = 6
"""Gauss-Newton steps from the Procrustes start, always all of them: convergence is quadratic, as no residual is
large."""


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
    weight = np.linalg.inv(matrix) * mask[:, :, None, None]
    state = _procrustes(place, mask, body_m)
    for _ in range(_STEPS):
        gap, slope = _residual(state, place, body_m)
        normal = np.einsum("nmia,nmij,nmjb->nab", slope, weight, slope)
        right = np.einsum("nmia,nmij,nmj->na", slope, weight, gap)
        state = state + np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    gap, slope = _residual(state, place, body_m)
    normal = np.einsum("nmia,nmij,nmjb->nab", slope, weight, slope)
    inverse = np.linalg.inv(normal)
    pose[usable] = state
    covariance[usable] = inverse
    gain[usable] = np.einsum("nab,nmib,nmij->namj", inverse, slope, weight)
    chi_square[usable] = np.einsum("nmi,nmij,nmj->n", gap, weight, gap)
    return RigidFit(pose, covariance, gain, chi_square, seen)


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
