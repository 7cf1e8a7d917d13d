"""The linear form's response and its exact sensitivities: matrix exponential, no time stepping.

A grid of n steps is cut into I blocks of J steps. With Phi = exp(A h): y_(iJ+j) = C Phi^j x_(iJ), and for a parameter p
dy = C Phi^j dx + d(C Phi^j) x: one small matrix product per parameter gives all samples. What a sample's own time lacks to
its grid point, less than half a step, is a Taylor series.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...simulate.model import Array, Tow, line_force, sway_yaw_acceleration
from ..data import RunData
from .parameters import EVERY, LINE_LENGTH, SPEED, TENSION, TOW_POINT, hull_from

COMPLEX_STEP = 1e-30
"""Step of the complex derivative: so small that it is exact to rounding, as nothing is subtracted."""
SERIES_NORM = 0.5
"""A matrix is halved until its norm is below this, then its exponential's series is squared as often."""
SERIES_ORDER = 14
"""0.5^15/15! is 2e-17: the series of exp is exact to rounding."""
ROUNDING = 1e-16
"""A series ends when its next term is below this, the rounding of double precision (2.2e-16 / 2)."""
STATES = 4
"""y, beta, v, r."""


def linear_paths(
    runs: list[RunData],
    values: Array,
    reference_speed_m_s: float,
    wanted: tuple[int, ...] = EVERY,
    channels: int = 2,
) -> list[tuple[Array, Array]]:
    """(y, beta) of all runs at their samples with sensitivities.

    Parameters
    ----------
    runs : the runs, in their order
    values : (runs, 14), ``RUN_PARAMETERS``; side = y m
    reference_speed_m_s : at which the derivatives are quoted, m/s
    wanted : parameters whose sensitivities are asked for, rising
    channels : 2: y and beta; 4: v and r as well

    Returns
    -------
    per run response (channels, n) and sensitivity (channels, len(wanted), n)
    """
    dynamic = [p for p in wanted if p < 6 or p >= TENSION]
    matrix, slopes = system_matrices(runs, values, reference_speed_m_s, dynamic)
    grids = [_grid(d.t_s) for d in runs]
    with np.errstate(over="ignore", invalid="ignore"):
        powers = exponential(
            np.repeat(matrix, 2, axis=0),
            np.repeat(slopes, 2, axis=0),
            np.array([s for step, _, _, inner in grids for s in (step, inner * step)]),
        )
        return [
            _path(
                values[i], wanted, dynamic, channels, matrix[i], slopes[i], grid, powers[0][2 * i :], powers[1][2 * i :]
            )
            for i, grid in enumerate(grids)
        ]


def system_matrices(
    runs: list[RunData], values: Array, reference_speed_m_s: float, wanted: list[int]
) -> tuple[Array, Array]:
    """A of x' = A x with x = (y, beta, v, r, 1), (runs, 5, 5), and its derivatives (runs, len(wanted), 5, 5).

    ``simulate.model``'s own equations on unit vectors, differentiated by the complex step; all runs and parameters at once.

    Parameters
    ----------
    runs : the runs, in their order
    values : (runs, 14), ``RUN_PARAMETERS``
    reference_speed_m_s : at which the derivatives are quoted, m/s
    wanted : parameters whose sensitivities are asked for, rising
    """
    columns = np.repeat(values.T[:, :, None, None], len(wanted) + 1, axis=2).astype(complex)
    for at, index in enumerate(wanted, start=1):
        columns[index, :, at] += 1j * COMPLEX_STEP
    speed, length, point = columns[SPEED], columns[LINE_LENGTH], columns[TOW_POINT]
    hull = hull_from(columns, reference_speed_m_s).at_speed(speed)  # pyright: ignore[reportArgumentType]
    offset = np.array([d.tow.tow_point_offset_m for d in runs], dtype=float)[:, None, None]
    tow = Tow(speed, length, point, columns[TENSION])  # pyright: ignore[reportArgumentType]
    y, beta, v, r = np.eye(STATES)
    pull = line_force(tow, columns[TENSION], y / length + (1 + point / length) * beta, 1.0)
    rates = sway_yaw_acceleration(hull, v, r, *pull)
    full = np.zeros((len(runs), len(wanted) + 1, 5, 5), dtype=complex)
    full[:, :, 0, :4], full[:, :, 1, :4] = v + speed * beta, r
    full[:, :, 2, :4], full[:, :, 3, :4] = rates
    if offset.any():
        aside = replace(tow, tow_point_offset_m=offset)
        pull = line_force(aside, columns[TENSION], offset / length, 1.0)
        rates = sway_yaw_acceleration(hull, 0.0, 0.0, *pull)
        full[:, :, 2, 4], full[:, :, 3, 4] = rates[0][:, :, 0], rates[1][:, :, 0]
    return np.real(full[:, 0]), np.imag(full[:, 1:]) / COMPLEX_STEP


def exponential(matrix: Array, slopes: Array, step_s: Array) -> tuple[Array, Array]:
    """exp(A h) and its derivatives by scaling, series and squaring.

    Parameters
    ----------
    matrix : (b, m, m)
    slopes : (b, k, m, m), dA
    step_s : (b,), h

    Returns
    -------
    (b, m, m) and (b, k, m, m)
    """
    norm = float((np.abs(matrix).sum(axis=-1).max(axis=-1) * step_s).max())
    squarings = int(np.clip(np.ceil(np.log2(max(norm, 1e-300) / SERIES_NORM)), 0, 60)) if np.isfinite(norm) else 0
    scale = (step_s / 2.0**squarings)[:, None, None]
    here = matrix * scale
    moved = slopes * scale[:, None]
    one = np.eye(matrix.shape[-1])
    power = one + here / SERIES_ORDER
    change = moved / SERIES_ORDER
    for order in range(SERIES_ORDER - 1, 0, -1):
        change = (moved @ power[:, None] + here[:, None] @ change) / order
        power = one + here @ power / order
    for _ in range(squarings):
        change = change @ power[:, None] + power[:, None] @ change
        power = power @ power
    return power, change


def _grid(t_s: Array) -> tuple[float, Array, Array, int]:
    """Usual step, grid point of each sample, what its time lacks to it, steps of a block."""
    times = t_s - t_s[0]
    usual = float(np.median(np.diff(times)))
    step = float(times[-1] / max(1, round(times[-1] / usual)))
    node = np.rint(times / step).astype(int)
    return step, node, times - node * step, max(1, round(np.sqrt(node[-1] + 1)))


def _path(values, wanted, dynamic, channels, matrix, slopes, grid, power, change) -> tuple[Array, Array]:
    step, node, rest, inner = grid
    count = int(node[-1]) + 1
    blocks = -(-count // inner)
    observed = np.eye(channels, 5)
    rows, d_rows = [observed], [np.zeros((len(dynamic), channels, 5))]
    reach = float(np.abs(rest).max())
    if reach > 1e-9 * step:
        size, term = float(np.abs(matrix).sum(axis=-1).max()) * reach, 1.0
        while term > ROUNDING and len(rows) < 20:
            d_rows.append(d_rows[-1] @ matrix + rows[-1] @ slopes)
            rows.append(rows[-1] @ matrix)
            term *= size / (len(rows) - 1)
    taps, d_taps = _taps(np.concatenate(rows), np.concatenate(d_rows, axis=1), power[0], change[0], inner)
    state, moved = _block_states(values, wanted, dynamic, power[1], change[1], blocks)
    # (columns, blocks, 10) @ (columns, 10, inner): column 0 is the motion, then the wanted parameters
    left = np.zeros((len(wanted) + 1, blocks, 10))
    left[0, :, :5], left[1:, :, :5], left[1:, :, 5:] = state, moved, state
    right = np.zeros((len(wanted) + 1, 10, inner))
    place = [1 + wanted.index(p) for p in dynamic]
    whole = len(node) == count
    answer = np.zeros((channels, len(wanted) + 1, len(node)))
    weight = np.ones(len(node))
    for order in range(len(rows)):
        if order:
            weight = weight * rest / order
        for channel in range(channels):
            at = order * channels + channel
            right[:, :5] = taps[at].T
            right[place, 5:] = d_taps[:, at].transpose(0, 2, 1)
            found = (left @ right).reshape(len(wanted) + 1, -1)
            found = found[:, :count] if whole else found[:, node]
            if order:
                answer[channel] += found * weight
            else:
                answer[channel] = found
    return answer[:, 0], answer[:, 1:]


def _taps(rows: Array, d_rows: Array, power: Array, change: Array, count: int) -> tuple[Array, Array]:
    """C Phi^j, (c, count, 5), and its derivatives (k, c, count, 5), by doubling."""
    taps, d_taps = rows[:, None], d_rows[:, :, None]
    while taps.shape[1] < count:
        k, c, j = d_taps.shape[:3]
        flat = taps.reshape(-1, 5)
        further = (flat @ power).reshape(c, j, 5)
        d_further = (d_taps.reshape(-1, 5) @ power).reshape(k, c, j, 5) + (flat @ change).reshape(k, c, j, 5)
        taps, d_taps = np.concatenate([taps, further], axis=1), np.concatenate([d_taps, d_further], axis=2)
        change = change @ power + power @ change
        power = power @ power
    return taps[:, :count], d_taps[:, :, :count]


def _block_states(values, wanted, dynamic, power, change, count) -> tuple[Array, Array]:
    """State at the begin of each block, (count, 5), and its sensitivities (wanted, count, 5), by doubling."""
    state = np.array([[*values[6:10], 1.0]])
    moved = np.zeros((len(wanted), 1, 5))
    place = [wanted.index(p) for p in dynamic]
    for at, index in enumerate(wanted):
        if 6 <= index < 10:
            moved[at, 0, index - 6] = 1.0
    while len(state) < count:
        after = state @ power.T
        d_after = (moved.reshape(-1, 5) @ power.T).reshape(moved.shape)
        d_after[place] += state @ change.transpose(0, 2, 1)
        state, moved = np.concatenate([state, after]), np.concatenate([moved, d_after], axis=1)
        change = change @ power + power @ change
        power = power @ power
    return state[:count], moved[:, :count]
