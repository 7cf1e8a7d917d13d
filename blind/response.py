"""How random forces move a tow: covariance of place and heading along its own path, where the equations are made linear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from .truth.lanes import Array, Lane, Lanes
from .truth.motion import STATES, Path, X, Y, instant

STEP_S = 0.08
"""Longest step on which the linear equations are carried along: well below any of a tow's times."""
BODY = 6
"""x, y, heading, u, v, r; no effect's own state is driven."""
NUDGE = 1e-6
"""Of the one-sided differences that make the equations linear, in the state's own units."""
SEEN = [X, Y, 2]
"""Places in the state of what a camera sees: x, y and heading."""


def pose_covariance(
    lanes: Sequence[Lane],
    path: Path,
    columns: list[int],
    times_s: Array,
    side_n: float,
    moment_n_m: float,
    lasting_s: float,
) -> Array:
    """Covariance of (x, y, heading) at some times under two independent forces that wander (first order).

    Parameters
    ----------
    lanes, columns : tows and where they stand in ``path``
    path : of the motion
    times_s : ``(n,)``, evenly spaced
    side_n, moment_n_m, lasting_s : the forces' standard deviations and correlation time

    Returns
    -------
    ``(tows, n, 3, n, 3)``
    """
    every = max(1, round((times_s[1] - times_s[0]) / STEP_S))
    fine = np.interp(np.arange((len(times_s) - 1) * every + 1) / every, np.arange(len(times_s)), times_s)
    grid = np.concatenate([[0.0], fine]) if fine[0] > 0 else fine
    step = np.diff(grid)
    moves = _transitions(lanes, path, columns, grid, step, lasting_s)
    sd = np.array([side_n, moment_n_m])
    tows, size = len(lanes), BODY + 2
    p = np.zeros((tows, size, size))
    p[:, BODY:, BODY:] = np.diag(sd**2)
    n = len(times_s)
    found = np.zeros((tows, n, 3, n, 3))
    crossed = np.zeros((n, tows, size, size))
    begin, block = len(grid) - len(fine), 0
    for j in range(len(grid)):
        if j:
            f = moves[:, j - 1]
            p = f @ p @ f.transpose(0, 2, 1)
            p[:, BODY:, BODY:] += np.diag(sd**2) * (1 - np.exp(-2 * step[j - 1] / lasting_s))
            crossed[:block] = f @ crossed[:block]
        if j >= begin and (j - begin) % every == 0:
            crossed[block] = p
            block += 1
            here = crossed[:block][:, :, SEEN][:, :, :, SEEN]
            found[:, block - 1, :, :block, :] = here.transpose(1, 2, 0, 3)
            found[:, :block, :, block - 1, :] = here.transpose(1, 0, 3, 2)
    return found


def _transitions(
    lanes: Sequence[Lane], path: Path, columns: list[int], grid: Array, step: Array, lasting_s: float
) -> Array:
    """State transition of each step, forces' states beside the body's: ``(tows, steps, 8, 8)``."""
    tows, ways = len(lanes), 1 + BODY + 2
    q = Lanes([lane for lane in lanes for _ in range(ways)])
    middles = (grid[:-1] + grid[1:]) / 2
    states = np.stack([path.at(middles, c, tuple(range(STATES))) for c in columns])
    moves = np.zeros((tows, len(step), BODY + 2, BODY + 2))
    nudges = np.zeros((STATES, ways))
    nudges[:BODY, 1 : BODY + 1] = NUDGE * np.eye(BODY)
    forces = np.zeros((2, tows * ways))
    for k in range(2):
        forces[k, BODY + 1 + k :: ways] = NUDGE
    for j, t in enumerate(middles):
        state = (states[:, j, :, None] + nudges).transpose(1, 0, 2).reshape(STATES, tows * ways)
        rates = instant(q, float(t), state, forces)[:BODY].reshape(BODY, tows, ways)
        jacobian = (rates[:, :, 1:] - rates[:, :, :1]) / NUDGE
        moves[:, j, :BODY] = jacobian.transpose(1, 0, 2)
    moves[:, :, BODY:, BODY:] = -np.eye(2) / lasting_s
    return expm(moves * step[:, None, None])
