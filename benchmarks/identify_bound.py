"""The Cramer-Rao bound under a coloured force, from dense covariance matrices: nothing of the Kalman filter is used here."""

from __future__ import annotations

from functools import cache

import numpy as np
from identify_cases import (
    FORCE_N,
    FORCE_TIME_S,
    LENGTH_M,
    POINTS_M,
    RATE_HZ,
    RELEASED_M,
    SIGMA_BETA_RAD,
    SIGMA_Y_M,
    SIX,
    SPAN_S,
    TENSION_N,
)
from scipy.linalg import cho_factor, cho_solve, expm

from towline.simulate import Hull, Tow, linear_system

BLOCK_HZ = 8.0
"""Eight samples in one: their mean holds all that they tell of motions of half a second and more."""
NOISE = np.array([FORCE_N, FORCE_N, FORCE_TIME_S, 1.0, 1.0])
"""sd of force and moment, correlation time, measurement scatter of y and beta over what is stated."""


def _matrix(six: np.ndarray, point: float) -> np.ndarray:
    return linear_system(Hull(*six, speed_m_s=1.28), Tow(1.28, LENGTH_M, point, TENSION_N))[0]


def covariance(six: np.ndarray, noise: np.ndarray, point: float, count: int) -> np.ndarray:
    """Covariance of (y, beta) at ``count`` times, (2 count, 2 count): disturbance from rest, and white measurement noise."""
    force, moment, time_s, *scale = noise
    whole, drive = np.zeros((6, 6)), np.zeros((6, 6))
    whole[:4, :4] = _matrix(six, point)
    whole[2, 4], whole[3, 5] = 1 / six[0], 1 / six[1]
    whole[4, 4] = whole[5, 5] = -1 / time_s
    drive[4, 4], drive[5, 5] = 2 * force**2 / time_s, 2 * moment**2 / time_s
    block = np.block([[-whole, drive], [np.zeros((6, 6)), whole.T]])
    power = expm(block / BLOCK_HZ)
    step = power[6:, 6:].T
    added = step @ power[:6, 6:]
    powers = [np.eye(6)]
    for _ in range(count):
        powers.append(step @ powers[-1])
    stack = np.array(powers)
    state = np.diag([0, 0, 0, 0, force**2, moment**2])
    found = np.zeros((count, 2, count, 2))
    for i in range(count):
        cross = (stack[: count - i] @ state)[:, :2, :2]
        found[i:, :, i, :] = cross
        found[i, :, i:, :] = cross.transpose(2, 0, 1)
        state = step @ state @ step.T + added
    flat = found.reshape(2 * count, 2 * count)
    white = np.array(scale) * [SIGMA_Y_M, SIGMA_BETA_RAD] / np.sqrt(RATE_HZ / BLOCK_HZ)
    return flat + np.diag(np.tile(white**2, count))


def mean(six: np.ndarray, start: np.ndarray, point: float, t_s: np.ndarray) -> np.ndarray:
    roots, shapes = np.linalg.eig(_matrix(six, point))
    sizes = np.linalg.solve(shapes, start.astype(complex))
    return np.real((shapes[:2] * sizes) @ np.exp(roots[:, None] * t_s)).T.ravel()


@cache
def coloured_bound() -> np.ndarray:
    """Standard deviations (6,) no unbiased estimator can beat: starts and the noise's five parameters unknown too."""
    count = int(SPAN_S * BLOCK_HZ)
    t_s = np.arange(count) / BLOCK_HZ
    start = np.array([RELEASED_M, 0, 0, 0])
    total = np.zeros((11, 11))
    for point in POINTS_M:
        factor = cho_factor(covariance(SIX, NOISE, point, count))
        slopes, changes = [], []
        for i in range(6):
            up, down = SIX.copy(), SIX.copy()
            up[i], down[i] = SIX[i] * (1 + 1e-4), SIX[i] * (1 - 1e-4)
            width = up[i] - down[i]
            slopes.append((mean(up, start, point, t_s) - mean(down, start, point, t_s)) / width)
            changes.append((covariance(up, NOISE, point, count) - covariance(down, NOISE, point, count)) / width)
        slopes += [mean(SIX, e, point, t_s) for e in np.eye(4)]
        for i in range(5):
            up, down = NOISE.copy(), NOISE.copy()
            up[i], down[i] = NOISE[i] * 1.001, NOISE[i] / 1.001
            width = 2 * np.log(1.001)
            changes.append((covariance(SIX, up, point, count) - covariance(SIX, down, point, count)) / width)
        j = np.array(slopes)
        fisher = j @ cho_solve(factor, j.T)
        total[:6, :6] += fisher[:6, :6] - fisher[:6, 6:] @ np.linalg.solve(fisher[6:, 6:], fisher[6:, :6])
        turned = [cho_solve(factor, c) for c in changes]
        total += np.array([[0.5 * np.sum(a * b.T) for b in turned] for a in turned])
    return np.sqrt(np.diag(np.linalg.inv(total)))[:6]
