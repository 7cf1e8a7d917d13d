"""Motion of a tow over time: exact propagation of the linear form, adaptive Runge-Kutta for the full one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ..record.errors import TowlineError
from .model import (
    Array,
    ExtraForce,
    Hull,
    Tow,
    alpha_from_y,
    free_rates,
    full_rates,
    full_x_cg,
    full_y_cg,
    linear_system,
)

RELATIVE_TOLERANCE = 1e-10
ABSOLUTE_TOLERANCE = 1e-12


@dataclass(frozen=True)
class Start:
    """The state at the first time; the side is given by the tow line angle or by y_cg.

    Attributes
    ----------
    beta_rad, v_m_s, r_rad_s : heading, sway velocity, yaw rate
    alpha_rad, y_cg_m : tow line angle or lateral place in tank axes; the other is None
    """

    beta_rad: float = 0.0
    v_m_s: float = 0.0
    r_rad_s: float = 0.0
    alpha_rad: float | None = None
    y_cg_m: float | None = None


@dataclass(frozen=True)
class Histories:
    """What changes through the run, as functions of time; None = constant.

    Attributes
    ----------
    tension_n, rudder_rad, speed_m_s : callables of t_s
    """

    tension_n: Callable[[float], float] | None = None
    rudder_rad: Callable[[float], float] | None = None
    speed_m_s: Callable[[float], float] | None = None

    @property
    def empty(self) -> bool:
        """Nothing changes."""
        return self.tension_n is None and self.rudder_rad is None and self.speed_m_s is None

    def at(self, t_s: float, hull: Hull, tow: Tow) -> tuple[Hull, Tow]:
        """Hull and tow at one time."""
        if self.tension_n is not None:
            tow = replace(tow, tension_n=float(self.tension_n(t_s)), resistance_n=None)
        if self.rudder_rad is not None:
            tow = replace(tow, rudder_rad=float(self.rudder_rad(t_s)))
        if self.speed_m_s is not None:
            speed = float(self.speed_m_s(t_s))
            hull, tow = hull.at_speed(speed), replace(tow, speed_m_s=speed)
        return hull, tow


def simulate_full(
    hull: Hull,
    tow: Tow,
    start: Start,
    t_s: Array,
    *,
    free: bool = False,
    histories: Histories | None = None,
    extra: ExtraForce | None = None,
) -> pd.DataFrame:
    """Full sine and kinematics, DOP853 with dense output at ``t_s``.

    Parameters
    ----------
    hull : quoted at any speed; taken to the tow's own
    t_s : (n,) rising times, s; the first is the start
    free : without a line (kind = "free")

    Returns
    -------
    motion : t_s, y_cg_m, beta_rad, alpha_rad, x_cg_m, v_m_s, r_rad_s, tension_n (NaN where there is no line)

    Raises
    ------
    TowlineError : the start is out of the line's reach, or the tow reaches alpha + beta = 90 degrees
    """
    t_s = np.asarray(t_s, dtype=float)
    hull = hull.at_speed(tow.speed_m_s)
    histories = histories or Histories()
    rates = free_rates if free else full_rates
    constant = histories.empty

    def slope(t, state):
        here = (hull, tow) if constant else histories.at(t, hull, tow)
        return rates(t, state, *here, extra)

    if free:
        first = start.y_cg_m or 0.0
        events = None
    else:
        first = _start_alpha(start, tow, float(t_s[0]))

        def broadside(_, state):
            return np.cos(state[0] + state[1]) - 1e-3

        broadside.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
        events = broadside
    solution = solve_ivp(
        slope,
        (t_s[0], t_s[-1]),
        [first, start.beta_rad, start.v_m_s, start.r_rad_s],
        method="DOP853",
        t_eval=t_s,
        rtol=RELATIVE_TOLERANCE,
        atol=ABSOLUTE_TOLERANCE,
        events=events,
    )
    if solution.status == 1:
        raise TowlineError(
            f"the tow reaches alpha + beta = 90 degrees at t = {solution.t_events[0][0]:.2f} s, where the line no longer "
            f"steers it; tow_point_m = {tow.tow_point_m:g}, X_v = {hull.x_v_m:.3f} m"
        )
    if solution.status != 0:
        raise TowlineError(f"the integration stopped: {solution.message}")
    one, beta, v, r = solution.y
    if free:
        alpha, tension = np.full_like(one, np.nan), np.full_like(one, np.nan)
        y_cg, x_cg = one, _free_x(t_s, beta, v, tow)
    else:
        alpha, y_cg = one, full_y_cg(t_s, one, beta, tow)
        x_cg = full_x_cg(alpha, beta, tow)
        if constant:
            tension = np.broadcast_to(tow.tension(alpha), alpha.shape)
        else:
            tension = np.array([histories.at(t, hull, tow)[1].tension(a) for t, a in zip(t_s, alpha, strict=True)])
    return _frame(t_s, y_cg, beta, alpha, x_cg, v, r, tension)


def _start_alpha(start: Start, tow: Tow, t_s: float) -> float:
    if start.alpha_rad is not None:
        return start.alpha_rad
    post_y, _ = tow.post_motion(t_s)
    y_cg = tow.post_m[1] if start.y_cg_m is None else start.y_cg_m
    alpha = float(alpha_from_y(y_cg, start.beta_rad, tow, post_y))
    if not np.isfinite(alpha):
        raise TowlineError(
            f"start.y_cg_m = {y_cg:g} m puts the tow point farther aside than line_length_m = {tow.line_length_m:g} reaches"
        )
    return alpha


def _free_x(t_s: Array, beta: Array, v: Array, tow: Tow) -> Array:
    """x_CG in the carriage's axes of a free model at forward speed u = U: x' = u cos b - v sin b - U, by the trapezoid rule."""
    rate = tow.speed_m_s * (np.cos(beta) - 1) - v * np.sin(beta)
    steps = np.diff(t_s) * (rate[1:] + rate[:-1]) / 2
    return tow.post_m[0] + np.concatenate([[0.0], np.cumsum(steps)])


def simulate_linear(hull: Hull, tow: Tow, start: Start, t_s: Array) -> pd.DataFrame:
    """The linear form, exact at every time by the matrix exponential; a moving post is an oscillator in the state.

    Parameters, returns: as ``simulate_full``. alpha = (y_T - y_post)/L, x_CG at its mean.
    """
    t_s = np.asarray(t_s, dtype=float)
    hull = hull.at_speed(tow.speed_m_s)
    matrix, constant = linear_system(hull, tow)
    omega = 2 * np.pi * tow.post_frequency_hz
    # state: y - y_post, beta, v, r, 1, y_o, y_o'/omega
    augmented = np.zeros((7, 7))
    augmented[:4, :4], augmented[:4, 4] = matrix, constant
    augmented[:4, 5] = -matrix[:, 0]  # the line acts on y - y_o
    augmented[5, 6], augmented[6, 5] = omega, -omega
    phase = omega * t_s[0] + tow.post_phase_rad
    alpha_0 = start.alpha_rad
    length, x_t = tow.line_length_m, tow.tow_point_m
    y_o = tow.post_amplitude_m * np.sin(phase)
    if alpha_0 is not None:
        y_0 = y_o + length * alpha_0 - x_t * start.beta_rad - tow.tow_point_offset_m
    else:
        y_0 = 0.0 if start.y_cg_m is None else start.y_cg_m - tow.post_m[1]
    state = np.array([y_0, start.beta_rad, start.v_m_s, start.r_rad_s, 1.0, y_o, tow.post_amplitude_m * np.cos(phase)])
    steps = expm(augmented[None] * (t_s - t_s[0])[:, None, None])
    y, beta, v, r, _, y_o, _ = (steps @ state).T
    alpha = (y + x_t * beta + tow.tow_point_offset_m - y_o) / length
    x_cg = np.full_like(y, tow.post_m[0] - length - x_t)
    return _frame(t_s, y + tow.post_m[1], beta, alpha, x_cg, v, r, np.full_like(y, tow.tension_n))


def _frame(t_s, y_cg, beta, alpha, x_cg, v, r, tension) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "t_s": t_s,
            "y_cg_m": y_cg,
            "beta_rad": beta,
            "alpha_rad": alpha,
            "x_cg_m": x_cg,
            "v_m_s": v,
            "r_rad_s": r,
            "tension_n": tension,
        }
    )
