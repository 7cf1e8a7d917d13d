"""A start for the fit without any guess: the equations of motion against smooth test functions (weak form).

Multiplied by test functions that vanish with their slopes at their ends and integrated by parts, the equations need no
differentiated record: they are linear in the six derivatives.
"""

from __future__ import annotations

import numpy as np

from ..record.errors import EstimationError
from ..simulate.model import Array, alpha_from_y
from .data import RunData

LARGEST_GAP_STEPS = 4.0
"""A hole in the record longer than this many usual steps parts it: no test function reaches across."""
WIDTHS = (4.0, 7.0)
"""Lengths of the test functions in units of (L + X_T)/U: about 8 and 13 s for MARINER at 1.28 m/s; shorter ones let noise in."""


def weak_form_start(runs: list[RunData], reference_speed_m_s: float) -> Array:
    """Six derivatives at ``reference_speed_m_s`` by least squares, (6,); signs and sizes forced to be usable.

    Parameters
    ----------
    runs : the runs, in their order
    reference_speed_m_s : at which the derivatives are quoted, m/s
    """
    sway, yaw = _weak_form(runs, reference_speed_m_s)
    length = 1.4 * max(d.tow.tow_point_m for d in runs)
    # a mass of the order that the line can swing at the observed rate, if the record gave nonsense
    mass = sway[0] if sway[0] > 0 else 10.0
    inertia = yaw[0] if yaw[0] > 0 else mass * (0.25 * length) ** 2
    y_v = sway[1] if sway[1] < 0 else -0.3 * mass * reference_speed_m_s / length * 2
    n_r = yaw[2] if yaw[2] < 0 else -inertia * reference_speed_m_s / length * 2
    return np.array([mass, inertia, y_v, sway[2], yaw[1], n_r])


def _weak_form(runs: list[RunData], reference_speed_m_s: float) -> tuple[Array, Array]:
    """(m', Y_v, Y_R, Y_delta, a constant of each run) and (I', N_v, N_r, N_delta, ...); Y_delta of moving rudders, else 0."""
    sway_rows, sway_right, yaw_rows, yaw_right = [], [], [], []
    for index, data in enumerate(runs):
        ratio = data.tow.speed_m_s / reference_speed_m_s
        speed = data.tow.speed_m_s
        alpha = alpha_from_y(data.y_m, data.beta_rad, data.tow)
        linear = (data.y_m + data.tow.tow_point_m * data.beta_rad) / data.tow.line_length_m
        s = np.sin(np.where(np.isfinite(alpha), alpha, linear) + data.beta_rad)
        assert data.tow.tension_n is not None
        rudder = np.zeros(len(data.t_s)) if data.rudder is None else np.interp(data.t_s, *data.rudder)
        for phi, slope, curve in _test_functions(data.t_s, data.tow.line_length_m + data.tow.tow_point_m, speed):
            v_dot = curve @ data.y_m + speed * (slope @ data.beta_rad)
            v = -(slope @ data.y_m) - speed * (phi @ data.beta_rad)
            r_dot, r = curve @ data.beta_rad, -(slope @ data.beta_rad)
            constant = np.zeros((len(phi), len(runs)))
            constant[:, index] = -phi.sum(axis=1)
            pull = data.tow.tension_n * (phi @ s)
            steered = -(phi @ rudder) * ratio**2
            sway_rows.append(np.column_stack([v_dot, -v * ratio, -r * ratio, steered, constant]))
            sway_right.append(-pull)
            yaw_rows.append(np.column_stack([r_dot, -v * ratio, -r * ratio, steered, constant]))
            yaw_right.append(-pull * data.tow.tow_point_m)
    if sum(len(rows) for rows in sway_rows) < 6 + 2 * len(runs):
        raise EstimationError(
            "the records are too short or too often interrupted: no stretch holds a few seconds of motion"
        )
    sway = _least_squares(np.concatenate(sway_rows), np.concatenate(sway_right))
    yaw = _least_squares(np.concatenate(yaw_rows), np.concatenate(yaw_right))
    return sway, yaw


def rudder_start(runs: list[RunData], six: Array, reference_speed_m_s: float) -> tuple[float, float]:
    """(Y_delta, N_delta) at ``reference_speed_m_s``, N/rad and N m/rad: of rudders that move by the weak form, of others what holds
    the runs at their mean angles (5.1).

    Parameters
    ----------
    runs : the runs, in their order
    six : (6,) derivatives
    reference_speed_m_s : at which the derivatives are quoted, m/s
    """
    if any(d.rudder is not None for d in runs):
        sway, yaw = _weak_form(runs, reference_speed_m_s)
        return float(sway[3]), float(yaw[3])
    rows, side, moment = [], [], []
    for data in runs:
        if not data.steered:
            continue
        tow, ratio = data.tow, data.tow.speed_m_s / reference_speed_m_s
        delta = tow.rudder_rad
        alpha = alpha_from_y(data.y_m, data.beta_rad, tow)
        good = np.isfinite(alpha)
        if not good.any():
            continue
        angle = float(np.mean(np.sin(alpha[good] + data.beta_rad[good])))
        v = -tow.speed_m_s * float(np.sin(data.beta_rad[good]).mean())
        assert tow.tension_n is not None
        rows.append(delta * ratio**2)
        side.append(tow.tension_n * angle - six[2] * ratio * v)
        moment.append(tow.tension_n * (tow.tow_point_m * angle + tow.tow_point_offset_m) - six[4] * ratio * v)
    weight = float(np.dot(rows, rows)) if rows else 0.0
    if weight == 0.0:
        return 0.0, 0.0
    return float(np.dot(rows, side)) / weight, float(np.dot(rows, moment)) / weight


def start_state(data: RunData) -> tuple[float, float, float, float]:
    """(y, beta, v, r) at the first sample from quadratics through the first part of the record."""
    span = max(1.0, 4.0 * np.median(np.diff(data.t_s)))
    near = data.t_s - data.t_s[0] <= span
    if near.sum() < 6:
        near = np.arange(len(data.t_s)) < 6
    t = data.t_s[near] - data.t_s[0]
    y = np.polynomial.polynomial.polyfit(t, data.y_m[near], 2)
    beta = np.polynomial.polynomial.polyfit(t, data.beta_rad[near], 2)
    return float(y[0]), float(beta[0]), float(y[1] - data.tow.speed_m_s * beta[0]), float(beta[1])


def _test_functions(t_s: Array, length_m: float, speed_m_s: float):
    """(phi, phi', phi'') as weights over the samples (m, n), quadrature included: (1 - x^2)^4 bumps, overlapping.

    No bump lies over a gap in the record: quadrature over it would be worth nothing.
    """
    weight = np.gradient(t_s)
    usual = np.median(np.diff(t_s))
    holes = np.flatnonzero(np.diff(t_s) > LARGEST_GAP_STEPS * usual)
    for share in WIDTHS:
        half = min(share * length_m / speed_m_s / 2, (t_s[-1] - t_s[0]) / 4)
        centres = np.arange(t_s[0] + half, t_s[-1] - half + 1e-9, half / 3)
        for hole in holes:
            centres = centres[(t_s[hole + 1] <= centres - half) | (t_s[hole] >= centres + half)]
        x = (t_s - centres[:, None]) / half
        bump = np.maximum(1 - x**2, 0.0)
        cube = bump**3
        yield (
            weight * (bump * cube),
            weight * (-8 * x * cube) / half,
            weight * (-8 * cube + 48 * x**2 * bump**2) / half**2,
        )


def _least_squares(rows: Array, right: Array) -> Array:
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    return np.linalg.lstsq(rows / scale, right, rcond=1e-10)[0] / scale
