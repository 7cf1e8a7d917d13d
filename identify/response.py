"""The tow's response and its exact sensitivities to derivatives, start and tow.

Both forms differentiate the one equation of motion in ``simulate.model`` by the complex step, so there is no second
copy of it here. Parameters of a run, in this order (``RUN_PARAMETERS``): the six derivatives, the start (side, beta, v, r), T, X_T,
L, U.
The side is y for the linear form and alpha for the full one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from ..simulate.model import DERIVATIVE_UNITS, Array, Hull, Tow, alpha_from_y, full_rates, full_y_cg, linear_system
from .data import RunData

RUN_PARAMETERS = (*DERIVATIVE_UNITS, "side", "beta", "v", "r", "tension", "tow_point", "line_length", "speed")
COUNT = len(RUN_PARAMETERS)
TENSION, TOW_POINT, LINE_LENGTH, SPEED = range(10, 14)
"""Places in a run's parameter vector."""
COMPLEX_STEP = 1e-30
_TAYLOR_ORDER = 10
_FULL_STEP_S = 0.05
_FULL_STEP_SHARE = 0.06
"""Runge-Kutta step: this share of the fastest root's time; RK4 then errs by about 1e-7 of the amplitude."""
SAMPLING_SHARE = 0.25


def run_tow(tow: Tow, values: Array) -> Tow:
    """The tow with T, X_T, L and U of a run's parameter vector (14,)."""
    return replace(
        tow,
        tension_n=values[TENSION],
        tow_point_m=values[TOW_POINT],
        line_length_m=values[LINE_LENGTH],
        speed_m_s=values[SPEED],
    )


def hull_from(values: Array, speed_m_s: float) -> Hull:
    """A hull from the first six of a parameter vector, real or complex, quoted at ``speed_m_s``."""
    return Hull(*values[:6], speed_m_s=speed_m_s)


def linear_response(data: RunData, values: Array, reference_speed_m_s: float) -> tuple[Array, Array]:
    """(y, beta) at the run's samples by the exact matrix exponential, with analytic sensitivities.

    Parameters
    ----------
    values : (14,), ``RUN_PARAMETERS``; side = y m

    Returns
    -------
    response : (n, 2)
    sensitivity : (n, 2, 14)

    On a grid of the mean sample step the state is doubled (Phi_2n = Phi_n Phi_n, with its derivative); the rest to
    each sample's own time, less than half a step, is a Taylor series.
    """
    matrix, constant, d_matrix, d_constant = _linear_matrices(data.tow, values, reference_speed_m_s)
    size = 5  # y, beta, v, r, 1
    times = data.t_s - data.t_s[0]
    step = times[-1] / (len(times) - 1)
    node = np.rint(times / step).astype(int)
    rest = times - node * step
    full = _augmented(matrix, constant)
    slopes = [_augmented(m, c) for m, c in zip(d_matrix, d_constant, strict=True)]
    state = np.zeros((1, size))
    state[0] = [*values[6:10], 1.0]
    moved = np.zeros((1, COUNT, size))
    for index in range(4):
        moved[0, 6 + index, index] = 1.0
    transition, slope = _exponential(full, slopes, step)
    while len(state) <= node[-1]:
        after = state @ transition.T
        after_moved = moved @ transition.T + np.einsum("pij,nj->npi", slope, state)
        state, moved = np.concatenate([state, after]), np.concatenate([moved, after_moved])
        slope = slope @ transition + transition @ slope
        transition = transition @ transition
    state, moved = state[node], moved[node]
    if np.abs(rest).max() > 1e-12 * step:
        state, moved = _taylor(full, np.array(slopes), state, moved, rest)
    return state[:, :2], moved[:, :, :2].transpose(0, 2, 1)


def _linear_form(tow: Tow, values: Array, reference: float) -> tuple[Array, Array]:
    """``linear_system`` of a run's parameter vector, real or complex."""
    here = run_tow(tow, values)
    return linear_system(hull_from(values, reference).at_speed(here.speed_m_s), here)


def _linear_matrices(tow: Tow, values: Array, reference: float):
    matrix, constant = _linear_form(tow, values, reference)
    d_matrix, d_constant = np.zeros((COUNT, 4, 4)), np.zeros((COUNT, 4))
    for index in (*range(6), *range(10, COUNT)):
        moved = values.astype(complex)
        moved[index] += 1j * COMPLEX_STEP
        m, c = _linear_form(tow, moved, reference)
        d_matrix[index], d_constant[index] = np.imag(m) / COMPLEX_STEP, np.imag(c) / COMPLEX_STEP
    return matrix, constant, d_matrix, d_constant


def _augmented(matrix: Array, constant: Array) -> Array:
    full = np.zeros((5, 5))
    full[:4, :4], full[:4, 4] = matrix, constant
    return full


def _exponential(full: Array, slopes: list[Array], step: float) -> tuple[Array, Array]:
    """exp(A h) and its derivatives, from the exponential of the block matrix [[A, dA], [0, A]]."""
    blocks = np.zeros((len(slopes), 10, 10))
    blocks[:, :5, :5] = blocks[:, 5:, 5:] = full
    blocks[:, :5, 5:] = slopes
    powers = expm(blocks * step)
    return powers[0, :5, :5], powers[:, :5, 5:]


def _taylor(full: Array, slopes: Array, state: Array, moved: Array, rest: Array) -> tuple[Array, Array]:
    term, d_term = state, moved
    total, d_total = state.copy(), moved.copy()
    for order in range(1, _TAYLOR_ORDER + 1):
        d_term = (d_term @ full.T + np.einsum("pij,nj->npi", slopes, term)) * (rest / order)[:, None, None]
        term = term @ full.T * (rest / order)[:, None]
        total, d_total = total + term, d_total + d_term
    return total, d_total


def full_response(runs: list[RunData], values: Array, reference_speed_m_s: float) -> list[tuple[Array, Array]]:
    """(y, beta) of all runs by the full equations, with exact sensitivities; all runs integrated side by side.

    Parameters
    ----------
    values : (runs, 14), ``RUN_PARAMETERS``; side = alpha rad

    Returns
    -------
    per run response (n, 2) and sensitivity (n, 2, 14)

    Classical Runge-Kutta on complex columns: column 0 is the motion, column j has parameter j moved by i 1e-30.
    Samples by cubic Hermite interpolation between steps.
    """
    columns = _complex_columns(values)  # (14, runs, 15)
    span = max(float(d.t_s[-1] - d.t_s[0]) for d in runs)
    step = _full_step(runs, values, reference_speed_m_s)
    count = max(2, int(np.ceil(span / step)))
    state = columns[6:10].copy()
    post = [d.tow.post_phase_rad + 2 * np.pi * d.tow.post_frequency_hz * d.t_s[0] for d in runs]
    tow = _stacked_tow(runs, columns, np.array(post)[:, None])
    forcing = _forcing(runs, step, count)
    hull = hull_from(columns, reference_speed_m_s)
    if forcing[1] is None:
        hull = hull.at_speed(tow.speed_m_s)
    path = np.empty((count + 1, *state.shape), dtype=complex)
    rate = np.empty_like(path)
    with np.errstate(over="ignore", invalid="ignore"):
        for index in range(count + 1):
            t = index * step
            k1 = _rates(t, state, hull, tow, forcing, 2 * index)
            path[index], rate[index] = state, k1
            if index == count:
                break
            k2 = _rates(t + step / 2, state + step / 2 * k1, hull, tow, forcing, 2 * index + 1)
            k3 = _rates(t + step / 2, state + step / 2 * k2, hull, tow, forcing, 2 * index + 1)
            k4 = _rates(t + step, state + step * k3, hull, tow, forcing, 2 * index + 2)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return [_sampled(d, i, step, path[:, :, i], rate[:, :, i], tow, columns[:, i]) for i, d in enumerate(runs)]


def _complex_columns(values: Array) -> Array:
    runs = len(values)
    columns = np.repeat(values.T[:, :, None], COUNT + 1, axis=2).astype(complex)
    for index in range(COUNT):
        columns[index, np.arange(runs), index + 1] += 1j * COMPLEX_STEP
    return columns


def _full_step(runs: list[RunData], values: Array, reference: float) -> float:
    fastest = 1e-9
    for data, v in zip(runs, values, strict=True):
        matrix, _ = _linear_form(data.tow, v, reference)
        if np.isfinite(matrix).all():
            fastest = max(fastest, float(np.abs(np.linalg.eigvals(matrix)).max()))
        fastest = max(fastest, 2 * np.pi * data.tow.post_frequency_hz)
    # a root far above the sampling rate is a trial of the fit gone astray; the samples cannot tell it from a faster one
    sampling = min(float(np.median(np.diff(d.t_s))) for d in runs)
    return min(_FULL_STEP_S, max(_FULL_STEP_SHARE / fastest, SAMPLING_SHARE * sampling))


def _stacked_tow(runs: list[RunData], columns: Array, phase: Array) -> Tow:
    """One Tow whose fields are arrays (runs, 1) or (runs, 15)."""

    def field(name: str) -> Array:
        return np.array([getattr(d.tow, name) for d in runs], dtype=float)[:, None]

    moving = any(d.tow.post_amplitude_m for d in runs)
    return Tow(
        speed_m_s=columns[SPEED],  # pyright: ignore[reportArgumentType]
        line_length_m=columns[LINE_LENGTH],  # pyright: ignore[reportArgumentType]
        tow_point_m=columns[TOW_POINT],  # pyright: ignore[reportArgumentType]
        tension_n=columns[TENSION],  # pyright: ignore[reportArgumentType]
        tow_point_offset_m=field("tow_point_offset_m"),  # pyright: ignore[reportArgumentType]
        post_amplitude_m=field("post_amplitude_m") if moving else 0.0,  # pyright: ignore[reportArgumentType]
        post_frequency_hz=field("post_frequency_hz"),  # pyright: ignore[reportArgumentType]
        post_phase_rad=phase,  # pyright: ignore[reportArgumentType]
    )


def _forcing(runs: list[RunData], step: float, count: int) -> tuple[Array | None, Array | None]:
    """Tension and speed relative to their means at every half step, (2 count + 1, runs, 1); None where constant."""
    half = np.arange(2 * count + 1) * step / 2
    tension = speed = None
    if any(d.tension is not None for d in runs):
        tension = np.ones((len(half), len(runs), 1))
        for i, d in enumerate(runs):
            if d.tension is not None:
                assert d.tow.tension_n is not None
                tension[:, i, 0] = np.interp(half + d.t_s[0], *d.tension) / d.tow.tension_n
    if any(d.speed is not None for d in runs):
        speed = np.ones((len(half), len(runs), 1))
        for i, d in enumerate(runs):
            if d.speed is not None:
                speed[:, i, 0] = np.interp(half + d.t_s[0], *d.speed) / d.tow.speed_m_s
    return tension, speed


def _rates(t: float, state: Array, hull: Hull, tow: Tow, forcing, half: int) -> Array:
    tension, speed = forcing
    if tension is not None:
        tow = replace(tow, tension_n=tow.tension_n * tension[half])
    if speed is not None:
        tow = replace(tow, speed_m_s=tow.speed_m_s * speed[half])
        hull = hull.at_speed(tow.speed_m_s)
    return full_rates(t, state, hull, tow)


def _sampled(data: RunData, run: int, step: float, path: Array, rate: Array, tow: Tow, columns: Array):
    """Hermite interpolation of (alpha, beta) to the samples, then y; path, rate: (count + 1, 4, 15)."""
    times = data.t_s - data.t_s[0]
    node = np.minimum((times / step).astype(int), len(path) - 2)
    s = (times / step - node)[:, None, None]
    h00, h10 = 2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s
    h01, h11 = -2 * s**3 + 3 * s**2, s**3 - s**2
    here = h00 * path[node] + h10 * step * rate[node] + h01 * path[node + 1] + h11 * step * rate[node + 1]
    own = replace(
        data.tow,
        tow_point_m=columns[TOW_POINT][None],
        line_length_m=columns[LINE_LENGTH][None],
        tension_n=None,
        resistance_n=0.0,
        post_phase_rad=tow.post_phase_rad[run, 0],  # pyright: ignore[reportIndexIssue]
    )
    y = full_y_cg(times[:, None], here[:, 0], here[:, 1], own)
    both = np.stack([y, here[:, 1]], axis=1)
    return np.real(both[:, :, 0]), np.imag(both[:, :, 1:]) / COMPLEX_STEP


def side_from_y(form: str, data: RunData, y_m: float, beta_rad: float) -> float:
    """The start's side parameter: y itself, or the tow line angle that puts the model there (at most 80 degrees)."""
    if form == "linear":
        return y_m
    post_y, _ = data.tow.post_motion(float(data.t_s[0]))
    alpha = float(alpha_from_y(y_m, beta_rad, data.tow, post_y))
    limit = np.radians(80.0)
    reach = y_m + data.tow.tow_point_m * np.sin(beta_rad)
    return float(np.clip(alpha, -limit, limit)) if np.isfinite(alpha) else float(np.sign(reach) * limit)
