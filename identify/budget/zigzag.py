"""The zigzag of a linear hull, of many hulls at once: its equations are stepped exactly by their matrix exponential."""

from __future__ import annotations

import numpy as np

from ...simulate.model import Array

STEP = 0.01
"""Of L/U. The rudder is thrown within it to first order, so that what remains is of its square: 1e-4 of a heading's swing."""
LONGEST = 60.0
"""L/U, in which a hull has answered twice, or does not."""


def zigzag(a: Array, b: Array, angle_rad: float, speed_m_s: float, length_m: float) -> list[tuple[str, str, Array]]:
    """First and second overshoot and the time of half a zigzag, the rudder thrown over at once.

    Parameters
    ----------
    a, b : (n, 2, 2) and (n, 2) of (v, r)' = A (v, r) + b delta
    angle_rad : rudder, and heading at which it is thrown over
    speed_m_s, length_m : U and L

    Returns
    -------
    (name, unit, (n,)) of each; NaN where a hull does not come so far
    """
    n = len(a)
    step = STEP * length_m / speed_m_s
    forward, push = _stepping(a, b, step)
    # delta with which the hull turns to positive headings first
    steady = -np.linalg.solve(a, b[:, :, None])[:, 1, 0]
    sense = np.where(np.linalg.det(a) > 0, np.sign(steady), np.sign(b[:, 1]))
    rudder = angle_rad * sense
    state, time = np.zeros((n, 3)), 0.0
    executes, thrown = np.zeros(n, dtype=int), np.full((2, n), np.nan)
    peak = np.full((2, n), np.nan)
    done = np.zeros((2, n), dtype=bool)
    target = np.full(n, angle_rad)
    for _ in range(int(LONGEST / STEP)):
        before = state
        state = np.einsum("nij,nj->ni", forward, before) + push * rudder[:, None]
        time += step
        side = np.sign(target)
        crossed = (side * before[:, 2] < np.abs(target)) & (side * state[:, 2] >= np.abs(target)) & (executes < 3)
        if crossed.any():
            late = np.where(crossed, (state[:, 2] - target) / np.where(crossed, state[:, 2] - before[:, 2], 1.0), 0.0)
            state = state.copy()
            state[:, :2] -= 2 * (late * step * rudder)[:, None] * b
            for k in range(2):
                thrown[k] = np.where(crossed & (executes == k), time - late * step, thrown[k])
            rudder, target = np.where(crossed, -rudder, rudder), np.where(crossed, -target, target)
            executes += crossed
        for k in range(2):
            # between one throw and the next the heading passes its extreme, where r changes its sign
            towards = angle_rad if k == 0 else -angle_rad
            turned = (
                ~done[k]
                & (executes > k)
                & (np.sign(towards) * state[:, 1] <= 0)
                & (np.sign(towards) * before[:, 1] > 0)
            )
            best = np.maximum(np.abs(state[:, 2]), np.abs(before[:, 2]))
            peak[k] = np.where(turned, best - angle_rad, peak[k])
            done[k] |= turned
        if done.all():
            break
    return [
        ("first overshoot", "rad", peak[0]),
        ("second overshoot", "rad", peak[1]),
        ("time to the first throw", "s", thrown[0]),
        ("time between throws", "s", thrown[1] - thrown[0]),
    ]


def _stepping(a: Array, b: Array, step_s: float) -> tuple[Array, Array]:
    """(n, 3, 3) and (n, 3): a step of (v, r, psi), and what a unit rudder adds."""
    from scipy.linalg import expm

    whole = np.zeros((len(a), 4, 4))
    whole[:, :2, :2], whole[:, :2, 3], whole[:, 2, 1] = a, b, 1.0
    moved = expm(whole * step_s)
    return moved[:, :3, :3], moved[:, :3, 3]


__all__ = ["zigzag"]
