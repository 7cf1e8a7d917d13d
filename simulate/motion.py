"""Motion of a tow over time: exact propagation of the linear form, adaptive Runge-Kutta for the full one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
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
    full_state,
    full_x_cg,
    full_y_cg,
    jerk_of_line,
    line_reach,
    linear_system,
    loose_rates,
    spring_tension,
    surge_mass,
)

DIFFERENCE_S = 1e-3
"""Half the span of the central difference that gives the carriage's acceleration from its speed."""
RELATIVE_TOLERANCE = 1e-10
"""Of the integrator, for each step ..."""
ABSOLUTE_TOLERANCE = 1e-12
"""... and in m, rad, m/s, rad/s: the truth is to be exact beside anything that is measured against it."""
MOST_STRETCHES = 1000
"""A line that falls slack and taut again more often than this bounces for ever."""
MOST_SLACK_STEP_S = 0.05
"""The coasting model moves so smoothly that the integrator would step over the moment at which the line is taut again."""
REACHED_M = 1e-12
"""The line is taut from this on: rounding must not keep an event from being seen."""


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
    tension_n, rudder_rad, speed_m_s : callables of t_s; tension_n moves a "constant" line only
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
            # on a line that keeps its length U(t) stands in the kinematics only: the forces take u
            hull = hull if tow.line == "surge" else hull.at_speed(speed)
            tow = replace(tow, speed_m_s=speed, speed_rate_m_s2=self._speed_rate(t_s))
        return hull, tow

    def _speed_rate(self, t_s: float) -> float:
        assert self.speed_m_s is not None
        early, late = self.speed_m_s(t_s - DIFFERENCE_S), self.speed_m_s(t_s + DIFFERENCE_S)
        return float(late - early) / (2 * DIFFERENCE_S)


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

    A line that keeps its length ("surge") and whose tension would fall below 0 is slack: the model coasts until the line is
    taut again (theory.md 10). With ``tow.stiffness_n_m`` the line is a spring.

    Parameters
    ----------
    hull : quoted at any speed; taken to the tow's own
    tow : T, X_T, L, U, and how the post moves
    start : the state at the first time
    t_s : (n,) rising times, s; the first is the start
    free : without a line (kind = "free")
    histories : what changes through the run
    extra : force and moment beside the model's own

    Returns
    -------
    motion : t_s, y_cg_m, beta_rad, alpha_rad, x_cg_m, v_m_s, r_rad_s, tension_n (0: slack; NaN where there is no line)

    Raises
    ------
    TowlineError : the start is out of the line's reach, surge without a mass, or the tow reaches alpha + beta = 90 degrees
    """
    t_s = np.asarray(t_s, dtype=float)
    hull = hull.at_speed(tow.speed_m_s)
    histories = histories or Histories()
    if free:
        return _simulate_free(hull, tow, start, t_s, histories, extra)
    if tow.line == "surge":
        surge_mass(hull)
        if histories.tension_n is not None:
            raise TowlineError(
                'a history of tension_n moves a line = "constant"; with "surge" the tension follows from the motion'
            )
    towed = _Towed(hull, tow, histories, extra)
    alpha = _start_alpha(start, tow, float(t_s[0]))
    state = np.array([alpha, start.beta_rad, start.v_m_s, start.r_rad_s])
    if tow.line == "surge" and tow.stiffness_n_m is not None:
        parts = [towed.on_spring(towed.stretched(float(t_s[0]), state), t_s)]
    else:
        parts = towed.through(state, t_s)
    return pd.concat(parts, ignore_index=True) if len(parts) > 1 else parts[0]


@dataclass(frozen=True)
class _Towed:
    """One tow, integrated stretch by stretch: taut, slack, taut again."""

    hull: Hull
    tow: Tow
    histories: Histories
    extra: ExtraForce | None

    def at(self, t_s: float) -> tuple[Hull, Tow]:
        """Hull and tow at one time."""
        return (self.hull, self.tow) if self.histories.empty else self.histories.at(t_s, self.hull, self.tow)

    def through(self, state: Array, t_s: Array) -> list[pd.DataFrame]:
        """The whole motion from a taut line's state, in stretches."""
        parts, begin, taut = [], float(t_s[0]), True
        if self.tow.line == "surge" and self._tension(begin, state) <= 0:
            state, taut = self._loosened(begin, state), False
        for _ in range(MOST_STRETCHES):
            left = t_s[t_s >= begin] if not parts else t_s[t_s > begin]
            motion, begin, ended = (self._taut if taut else self._slack)(begin, state, left, float(t_s[-1]))
            parts.append(motion)
            if ended is None:
                return [p for p in parts if len(p)]
            if taut:
                state, taut = self._loosened(begin, ended), False
            else:
                state = self._tightened(begin, ended)
                taut = self._tension(begin, state) > 0
                state = state if taut else self._loosened(begin, state)
        raise TowlineError(f"the line falls slack and taut again more than {MOST_STRETCHES} times by t = {begin:.2f} s")

    def on_spring(self, state: Array, t_s: Array) -> pd.DataFrame:
        """The whole motion on a spring line, from (x, y, beta, u, v, r)."""
        solution = self._solve(lambda t, s: loose_rates(t, s, *self.at(t), self.extra), state, t_s[0], t_s[-1], t_s, [])
        return self._loose_frame(t_s, solution.y)

    def stretched(self, t_s: float, state: Array) -> Array:
        """(x, y, beta, u, v, r) of a taut line that is as much longer as its pull stretches it."""
        hull, tow = self.at(t_s)
        pull = max(float(full_state(t_s, state, hull, replace(tow, stiffness_n_m=None), self.extra).tension_n), 0.0)
        longer = replace(
            self, tow=replace(self.tow, line_length_m=tow.line_length_m + pull / float(tow.stiffness_n_m or 1))
        )
        return longer._loosened(t_s, state)

    def _tension(self, t_s: float, state: Array) -> float:
        return float(full_state(t_s, state, *self.at(t_s), self.extra).tension_n)

    def _taut(self, begin: float, state: Array, t_s: Array, end: float) -> tuple[pd.DataFrame, float, Array | None]:
        """Until the line slackens: motion at ``t_s`` so far, where it ended, the state there (None: at the end)."""

        def broadside(_, here):
            return np.cos(here[0] + here[1]) - 1e-3

        def slackens(t, here):
            return self._tension(t, here)

        slackens.direction = -1  # pyright: ignore[reportFunctionMemberAccess]
        events = [broadside, slackens] if self.tow.line == "surge" else [broadside]
        found = self._solve(lambda t, s: full_rates(t, s, *self.at(t), self.extra), state, begin, end, t_s, events)
        if len(found.t_events[0]):
            raise TowlineError(
                f"the tow reaches alpha + beta = 90 degrees at t = {found.t_events[0][0]:.2f} s, where the line no longer "
                f"steers it; tow_point_m = {self.tow.tow_point_m:g}, X_v = {self.hull.x_v_m:.3f} m"
            )
        motion = self._taut_frame(found.t, found.y)
        if found.status == 1:
            return motion, float(found.t_events[1][0]), found.y_events[1][0]
        return motion, end, None

    def _slack(self, begin: float, state: Array, t_s: Array, end: float) -> tuple[pd.DataFrame, float, Array | None]:
        """As ``_taut``, until the line's length is reached again from below."""

        def tightens(t, here):
            return float(line_reach(t, here, self.at(t)[1])[0]) - self.tow.line_length_m - REACHED_M

        tightens.direction = 1  # pyright: ignore[reportFunctionMemberAccess]
        found = self._solve(
            lambda t, s: loose_rates(t, s, *self.at(t), self.extra),
            state,
            begin,
            end,
            t_s,
            [tightens],
            MOST_SLACK_STEP_S,
        )
        motion = self._loose_frame(found.t, found.y)
        if found.status == 1:
            return motion, float(found.t_events[0][0]), found.y_events[0][0]
        return motion, end, None

    def _loosened(self, t_s: float, state: Array) -> Array:
        """(alpha, beta, v, r) of a taut line -> (x, y, beta, u, v, r)."""
        alpha, beta, v, r = state
        hull, tow = self.at(t_s)
        u = float(full_state(t_s, state, hull, replace(tow, stiffness_n_m=None), self.extra).u_m_s)
        return np.array([full_x_cg(alpha, beta, tow), full_y_cg(t_s, alpha, beta, tow), beta, u, v, r], dtype=float)

    def _tightened(self, t_s: float, state: Array) -> Array:
        """(x, y, beta, u, v, r) as the line becomes taut -> (alpha, beta, v, r) after its jerk."""
        hull, tow = self.at(t_s)
        _, parting, alpha = line_reach(t_s, state, tow)
        beta, _, v, r = state[2:]
        _, sway, yaw = jerk_of_line(hull, tow, alpha, beta, parting)
        return np.array([alpha, beta, v + sway, r + yaw], dtype=float)

    def _solve(
        self, slope, state: Array, begin: float, end: float, t_s: Array, events, longest_s: float = np.inf
    ) -> Any:
        from scipy.integrate import solve_ivp

        for event in events:
            event.terminal = True
        found = solve_ivp(
            slope,
            (begin, end),
            state,
            method="DOP853",
            t_eval=t_s,
            rtol=RELATIVE_TOLERANCE,
            atol=ABSOLUTE_TOLERANCE,
            events=events or None,
            max_step=longest_s,
        )
        if not found.success:
            raise TowlineError(f"the motion cannot be integrated: {found.message}")
        return found

    def _taut_frame(self, t_s: Array, states: Array) -> pd.DataFrame:
        if not len(t_s):
            return _frame(*[np.zeros(0)] * 8)
        alpha, beta, v, r = states
        if self.histories.empty:
            found = full_state(t_s, states, self.hull, self.tow, self.extra).tension_n
            tension = np.broadcast_to(found, alpha.shape)
        else:
            tension = np.array([self._tension(t, s) for t, s in zip(t_s, states.T, strict=True)])
        y_cg = full_y_cg(t_s, alpha, beta, self.tow)
        return _frame(t_s, y_cg, beta, alpha, full_x_cg(alpha, beta, self.tow), v, r, tension)

    def _loose_frame(self, t_s: Array, states: Array) -> pd.DataFrame:
        if not len(t_s):
            return _frame(*[np.zeros(0)] * 8)
        each = [spring_tension(t, s, self.at(t)[1]) for t, s in zip(t_s, states.T, strict=True)]
        tension, alpha = np.array([e[0] for e in each]), np.array([e[3] for e in each])
        return _frame(t_s, states[1], states[2], alpha, states[0], states[4], states[5], tension)


def _simulate_free(
    hull: Hull, tow: Tow, start: Start, t_s: Array, histories: Histories, extra: ExtraForce | None
) -> pd.DataFrame:
    from scipy.integrate import solve_ivp

    def slope(t, state):
        here = (hull, tow) if histories.empty else histories.at(t, hull, tow)
        return free_rates(t, state, *here, extra)

    first = [start.y_cg_m or 0.0, start.beta_rad, start.v_m_s, start.r_rad_s]
    solution = solve_ivp(
        slope, (t_s[0], t_s[-1]), first, method="DOP853", t_eval=t_s, rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE
    )
    if not solution.success:
        raise TowlineError(f"the motion cannot be integrated: {solution.message}")
    y_cg, beta, v, r = solution.y
    nothing = np.full_like(y_cg, np.nan)
    return _frame(t_s, y_cg, beta, nothing, _free_x(t_s, beta, v, tow), v, r, nothing)


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

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    start : the state at the first time
    t_s : (n,) rising times, s; the first is the start

    Returns
    -------
    motion : columns as in ``simulate_full``; alpha = (y_T - y_post)/L, x_CG at its mean
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
