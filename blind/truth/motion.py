"""Surge, sway and yaw of a model towed on a spring line, many lanes at once.

Carriage axes: x ahead, y to starboard, z down, origin at the stated post. The state is place, heading and body velocities through
the water; nothing is linearised. The line is a spring with a damper that cannot push. The hull's resistance is what a stiff line
needs to pull with the tension of the settings, so that the taut line with constant tension (theory.md 2) is the limit of a reality
without effects; a tension that varies, a soft line or a slack one take that away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from .forces import Now, forces_of
from .lanes import Array, Lane, Lanes

STEP_S = 0.02
STIFF_N_M = 64000.0
"""A taut line gives by less than 0.01 mm as its tension varies by a tenth of 4 N: at 8000 N/m the model surged by 0.05 mm
with the load, and that was no null any more."""
LINE_DAMPING = 0.35
X, Y, B, U, V, R = range(6)
LAG = slice(6, 10)
PULL, PULL_RATE, ROLL, ROLL_RATE, SLOSH, SLOSH_RATE = range(10, 16)
STATES = 16


@dataclass(frozen=True)
class Path:
    """A motion on the integrator's own times.

    Attributes
    ----------
    t_s : ``(k,)``
    states : ``(k, 16, n)``: x, y, heading, u, v, r, memory, tension servo, roll, slosh
    rates : their time derivatives
    tension_n : ``(k, n)``
    """

    t_s: Array
    states: Array
    rates: Array
    tension_n: Array

    def at(self, t_s: Array, lane: int, what: tuple[int, ...]) -> Array:
        """States of a lane at any times, ``(len(t_s), len(what))``, by cubic Hermite interpolation."""
        rows = list(what)
        return CubicHermiteSpline(self.t_s, self.states[:, rows, lane], self.rates[:, rows, lane])(t_s)


def swim(lanes: Sequence[Lane], duration_s: float, random: Array | None = None, step_s: float = STEP_S) -> Path:
    """Integrate (classical Runge-Kutta).

    Parameters
    ----------
    lanes : numbers of each
    duration_s : how long
    random : ``(2 k - 1, 2, n)`` side force N and moment N m at every half step, or None
    step_s : of the integrator
    """
    q = Lanes(lanes)
    terms = forces_of(q)
    steps = int(np.ceil(duration_s / step_s - 1e-9))
    t_s = np.arange(steps + 1) * step_s
    state = _released(q)
    states = np.empty((steps + 1, STATES, q.n))
    rates = np.empty_like(states)
    tension = np.empty((steps + 1, q.n))
    half, still = step_s / 2, np.zeros((2, q.n))
    for k in range(steps + 1):
        t = t_s[k]
        a, mid, b = _of_step(random, k, still)
        k1, tension[k] = _rates(q, terms, t, state, a)
        states[k], rates[k] = state, k1
        if k == steps:
            break
        k2, _ = _rates(q, terms, t + half, state + half * k1, mid)
        k3, _ = _rates(q, terms, t + half, state + half * k2, mid)
        k4, _ = _rates(q, terms, t + step_s, state + step_s * k3, b)
        state = state + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return Path(t_s, states, rates, tension)


def instant(q: Lanes, t_s: float, state: Array, forces: Array) -> Array:
    """Time derivatives of states ``(16, n)`` under forces ``(2, n)``."""
    return _rates(q, forces_of(q), t_s, state, forces)[0]


def _of_step(random: Array | None, k: int, still: Array) -> tuple[Array, Array, Array]:
    if random is None:
        return still, still, still
    last = len(random) - 1
    return random[2 * k], random[min(2 * k + 1, last)], random[min(2 * k + 2, last)]


def _released(q: Lanes) -> Array:
    """Held on the carriage, then let go: the tow point at the line's length from the post."""
    state = np.zeros((STATES, q.n))
    y, b = q["y_release"], q["beta_release"]
    stretch = np.where(q["elastic_line.compliance_m_n"] > 0, q["elastic_line.compliance_m_n"] * q["tension"], 0.0)
    line = q["line"] + stretch * (1 - q["elastic_line.shock"])
    sb, cb = np.sin(b), np.cos(b)
    across = y + q["x_t"] * sb + q["tow_point_offset.offset_m"] * cb - _post(q, 0.0)[0]
    along = np.sqrt(np.maximum(line**2 - across**2, 1e-6))
    state[X] = q["datum_bias.ahead_m"] - along - q["x_t"] * cb + q["tow_point_offset.offset_m"] * sb
    state[Y], state[B] = y, b
    speed, _ = _speed(q, 0.0)
    state[U], state[V] = speed * cb, -speed * sb + q["v_release"]
    state[R] = q["r_release"]
    state[6] = state[7] = state[V]
    state[PULL] = q["tension"] / np.maximum(along / line, 0.1) ** q["tension_variation.power"]
    state[SLOSH] = np.where(q["sloshing.side_n"] != 0, 1.0, 0.0)
    return state


def _speed(q: Lanes, t: float) -> tuple[Array, Array]:
    """Carriage speed and its rate: a drift that settles, and a drive that sticks and slips."""
    speed, rate = q["speed"], np.zeros(q.n)
    if q.has("speed_drift.share"):
        settle = np.maximum(q["speed_drift.settle_s"], 1.0)
        span = 1 - np.exp(-q["duration"] / settle)
        fall = np.exp(-t / settle)
        share = q["speed_drift.share"]
        speed, rate = (
            speed + q["speed"] * share * ((1 - fall) / span - 0.5),
            rate + q["speed"] * share * fall / settle / span,
        )
    if q.has("stick_slip.share"):
        for k in (1, 2, 3):
            w = 2 * np.pi * k * q["stick_slip.rate_hz"]
            size = q["speed"] * q["stick_slip.share"] * (-1) ** (k + 1) / k
            speed, rate = speed + size * np.sin(w * t), rate + size * w * np.cos(w * t)
    return speed, rate


def _post(q: Lanes, t: float) -> tuple[Array, Array, Array]:
    """The post across the tank, its rate and acceleration: off its stated place, shaken by the carriage."""
    place = q["datum_bias.aside_m"]
    if not q.has("carriage_shake.size_m"):
        return place, np.zeros(q.n), np.zeros(q.n)
    w = 2 * np.pi * q["carriage_shake.rate_hz"]
    phase = w * t + q["carriage_shake.phase"]
    size = q["carriage_shake.size_m"]
    return place + size * np.sin(phase), size * w * np.cos(phase), -size * w**2 * np.sin(phase)


def wanted_tension(q: Lanes, t: float) -> Array:
    """The tension that the settings hold: constant, or the history that the load cell saw."""
    pull = q["tension"]
    if q.has("history.size"):
        a, b = 2 * np.pi * q["history.rate_hz"], 2 * np.pi * q["history.second_hz"]
        at = t - q["history.late_s"]
        swing = np.sin(a * at + q["history.phase"]) + 0.6 * np.sin(b * at + 2 * q["history.phase"])
        pull = pull * (1 + q["history.size"] * swing)
    return pull


def _slackening(q: Lanes, t: float) -> tuple[Array, Array, Array]:
    """How much nearer a following wave carries the model, its rate and acceleration."""
    share = (t - q["slack_line.begin_s"]) / np.maximum(q["slack_line.length_s"], 0.1)
    inside = (share > 0) & (share < 1)
    w = 2 * np.pi / np.maximum(q["slack_line.length_s"], 0.1)
    size = np.where(inside, 0.5 * q["slack_line.nearer_m"], 0.0)
    angle = 2 * np.pi * share
    return size * (1 - np.cos(angle)), size * w * np.sin(angle), size * w**2 * np.cos(angle)


def _rates(q: Lanes, terms, t: float, s: Array, random: Array) -> tuple[Array, Array]:
    x, y, b, u, v, r = s[:6]
    sb, cb = np.sin(b), np.cos(b)
    speed, speed_rate = _speed(q, t)
    post_y, post_v, post_a = _post(q, t)
    xt, yt = q["x_t"], q["tow_point_offset.offset_m"]
    out = np.zeros_like(s)
    out[X], out[Y], out[B] = u * cb - v * sb - speed, u * sb + v * cb, r
    # the line
    px = x + xt * cb - yt * sb - q["datum_bias.ahead_m"]
    py = y + xt * sb + yt * cb - post_y
    length = np.hypot(px, py)
    nx, ny = px / length, py / length
    vx = out[X] + r * (-xt * sb - yt * cb)
    vy = out[Y] + r * (xt * cb - yt * sb) - post_v
    out_rate = nx * vx + ny * vy
    turn = (nx * vy - ny * vx) / length
    base = wanted_tension(q, t)
    target = base
    if q.has("tension_variation.power"):
        varied = q["tension_variation.power"] != 0
        target = np.where(varied, s[PULL], base)
        w = 2 * np.pi / np.maximum(q["tension_variation.period_s"], 0.2)
        command = base / np.maximum(-nx, 0.1) ** q["tension_variation.power"]
        out[PULL] = np.where(varied, s[PULL_RATE], 0.0)
        out[PULL_RATE] = np.where(varied, w**2 * (command - s[PULL]) - 1.4 * w * s[PULL_RATE], 0.0)
    soft = q["elastic_line.compliance_m_n"]
    stiff = np.where(soft > 0, 1 / np.where(soft > 0, soft, 1.0), STIFF_N_M)
    natural = q["line"] - np.where(soft > 0, 0.0, q["tension"] / STIFF_N_M)
    mass = q["surge_mass"]
    ratio = np.where(soft > 0, q["elastic_line.damping"], LINE_DAMPING)
    damper = 2 * ratio * np.sqrt(stiff * mass)
    tension = np.maximum(target + stiff * (length - natural - target / stiff) + damper * out_rate, 0.0)
    held, nearer_a = target, 0.0
    if q.has("slack_line.nearer_m"):
        nearer, nearer_v, nearer_a = _slackening(q, t)
        held = np.maximum(target - stiff * nearer - damper * nearer_v, 0.0)
    c, side = nx * cb + ny * sb, ny * cb - nx * sb
    # sway and yaw
    scale = speed / q["speed_ref"]
    force = scale * (q["y_v"] * v + q["y_r"] * r) - tension * side + random[0]
    moment = scale * (q["n_v"] * v + q["n_r"] * r) - tension * (xt * side - yt * c) + random[1]
    # the line's direction in tank axes turns with ``turn``, the hull's with r: the swivel feels the difference
    now = Now(t, y, b, v, r, speed, -tension * side, r - turn, s[LAG], s[SLOSH])
    for term in terms:
        one, two = term(q, now)
        force, moment = force + one, moment + two
    m, i = q["m"], q["i"]
    if q.has("new_mass.share"):
        m = m * (1 + q["new_mass.share"] * 0.5 * (1 + np.tanh((t - q["new_mass.time_s"]) / 0.3)))
    cross, other = q["added_mass_coupling.y_rdot"], q["added_mass_coupling.n_vdot"]
    det = m * i - cross * other
    out[V] = (i * force + cross * moment) / det
    out[R] = (m * moment + other * force) / det
    # surge: the resistance that keeps a taut line taut, and what the line does beyond it
    swing = vx**2 + vy**2 - out_rate**2
    across = (
        side * (out[V] + u * r + out[R] * xt - r**2 * yt) - nx * speed_rate - ny * post_a + swing / length + nearer_a
    )
    out[U] = v * r + out[R] * yt + r**2 * xt - across / c - (tension - held) * c / mass
    _slow_states(q, s, out, speed, tension, side)
    return out, tension


def _slow_states(q: Lanes, s: Array, out: Array, speed: Array, tension: Array, side: Array) -> None:
    if q.has("fluid_memory.sway") or q.has("fluid_memory.yaw"):
        fast, slow = (np.maximum(q[f"fluid_memory.{name}_s"], 0.1) for name in ("fast", "slow"))
        out[6], out[7] = (s[V] - s[6]) / fast, (s[V] - s[7]) / slow
        out[8], out[9] = (s[R] - s[8]) / fast, (s[R] - s[9]) / slow
    if q.has("marker_roll.lean_rad"):
        w = 2 * np.pi / np.maximum(q["marker_roll.period_s"], 0.3)
        drive = q["marker_roll.lean_rad"] * (-tension * side / q["tension"])
        out[ROLL] = s[ROLL_RATE]
        out[ROLL_RATE] = w**2 * (drive - s[ROLL]) - 2 * q["marker_roll.damping"] * w * s[ROLL_RATE]
    if q.has("sloshing.side_n"):
        w = 2 * np.pi * q["sloshing.rate_hz"]
        out[SLOSH] = s[SLOSH_RATE]
        out[SLOSH_RATE] = (
            -(w**2) * s[SLOSH] - 2 * q["sloshing.damping"] * w * s[SLOSH_RATE] + q["sloshing.feed"] * out[V]
        )
