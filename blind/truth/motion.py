"""Surge, sway and yaw of a model towed on a spring line, many lanes at once.

Carriage axes: x ahead, y to starboard, z down, origin at the stated post. The state is place, heading and body velocities through
the water; nothing is linearised. Surge is a mass that the line pulls and the hull's resistance holds back, nothing more: the
line is a spring with a damper that cannot push, and what it pulls with is what its stretch makes it. A line that a winch or a
falling weight keeps at a tension has no length of its own.

Signs and symbols are theory.md's, section 10. What a run's ``tension`` names is R, the pull of a straight tow at the run's speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from .carriage import push, speed_at
from .forces import forces_of
from .lanes import Array, Lane, Lanes
from .laws import TERMS as LAW_TERMS
from .laws import law_ahead, law_lean
from .lift import memory_rates
from .line import creep_rate, pull_of, servo_anywhere, servo_command, servo_rates, stretch_at_rest
from .now import Now

STEP_S = 0.02
"""A line of 60 kN/m rings at up to 55 rad/s on the lighter hull: 1.1 in a step, and classical Runge-Kutta is stable to 2.8. What
half the step, or twice it (``signature``), changes is held by a test."""
SLACK_STEP_S, BOUNCES_S = 0.005, 8.0
"""Where a slack line comes straight the pull has a kink: steps are cut to this, until it has bounced out."""
SLIPS_S, RAIL_RAD = 0.3, 0.1
"""A tow point that slips takes about the first; one on a rail has gone most of its way where the line pulls at the second."""
X, Y, B, U, V, R = range(6)
"""Places in the state: place of LCG (m), heading (rad), and speeds in the hull's axes."""
LAG = slice(6, 10)
"""Lagging parts of v and r: each by a fast and a slow time, or each with its rate where it rings."""
PULL, PULL_RATE, ROLL, ROLL_RATE, SLOSH, SLOSH_RATE, CREEP = range(10, 17)
"""Tension of a winch, roll and sloshing water, each with its rate; by how much a line has crept."""
STATES = 17
"""All of them."""
_MEMORY = tuple(f"fluid_memory.{name}" for name in ("sway", "yaw", "ring_sway", "ring_yaw"))
_ROLLS = tuple(f"marker_roll.{name}_rad" for name in ("lean", "sway", "turn"))
_LEANS = tuple(f"law.lean{k}" for k in range(LAW_TERMS))


@dataclass(frozen=True)
class Path:
    """A motion on the integrator's own times.

    Attributes
    ----------
    t_s : ``(k,)``
    states : ``(k, 17, n)``: x, y, heading, u, v, r, memory, tension servo, roll, slosh, creep
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
    terms = q.once(forces_of)
    steps = int(np.ceil(duration_s / step_s - 1e-9))
    t_s = np.arange(steps + 1) * step_s
    state = _released(q)
    states = np.empty((steps + 1, STATES, q.n))
    rates = np.empty_like(states)
    tension = np.empty((steps + 1, q.n))
    for k in range(steps + 1):
        cuts = _cuts(q, t_s[k], step_s)
        step = step_s / cuts
        half = step / 2
        given = _of_step(random, k, cuts, q.n)
        for cut in range(cuts):
            t = t_s[k] + cut * step
            k1, pull = _rates(q, terms, t, state, given[2 * cut])
            if cut == 0:
                states[k], rates[k], tension[k] = state, k1, pull
            if k == steps:
                break
            k2, _ = _rates(q, terms, t + half, state + half * k1, given[2 * cut + 1])
            k3, _ = _rates(q, terms, t + half, state + half * k2, given[2 * cut + 1])
            k4, _ = _rates(q, terms, t + step, state + step * k3, given[2 * cut + 2])
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return Path(t_s, states, rates, tension)


def instant(q: Lanes, t_s: float, state: Array, forces: Array) -> Array:
    """Time derivatives of states ``(17, n)`` under forces ``(2, n)``."""
    return _rates(q, q.once(forces_of), t_s, state, forces)[0]


def _cuts(q: Lanes, t: float, step_s: float) -> int:
    """How many parts a step is cut into: more than one while some line may be slack, or has just come straight."""
    begin, end = q["slack_line.begin_s"] - step_s, q["slack_line.begin_s"] + q["slack_line.length_s"] + BOUNCES_S
    if not np.any((q["slack_line.length_s"] > 0) & (t > begin) & (t < end)):
        return 1
    return int(np.ceil(step_s / SLACK_STEP_S - 1e-9))


def _of_step(random: Array | None, k: int, cuts: int, lanes: int) -> Array:
    """Forces at the half steps of a step's cuts, ``(2 cuts + 1, 2, lanes)``; straight between those that are given."""
    if random is None:
        return np.zeros((2 * cuts + 1, 2, lanes))
    three = random[np.minimum([2 * k, 2 * k + 1, 2 * k + 2], len(random) - 1)]
    at = np.arange(2 * cuts + 1) / cuts
    first = np.minimum(at.astype(int), 1)
    share = (at - first)[:, None, None]
    return (1 - share) * three[first] + share * three[first + 1]


def _released(q: Lanes) -> Array:
    """Held on the carriage, the line straight and at its length; then let go. The line does not lengthen at that moment."""
    state = np.zeros((STATES, q.n))
    y, b = q["y_release"], q["beta_release"]
    held = 1 - q["elastic_line.shock"]
    line = q["line"] + stretch_at_rest(q) * held
    sb, cb = np.sin(b), np.cos(b)
    post, post_v = _post(q, 0.0)
    xt, yt = q["x_t"], _aside(q, 0.0, y, b)
    across = y + xt * sb + yt * cb - post
    along = np.sqrt(np.maximum(line**2 - across**2, 1e-6))
    state[X] = q["datum_bias.ahead_m"] - along - xt * cb + yt * sb
    state[Y], state[B] = y, b
    speed = speed_at(q, 0.0)
    state[V], state[R] = -speed * sb + q["v_release"], q["r_release"]
    nx, ny = -along / line, across / line
    c, side = nx * cb + ny * sb, ny * cb - nx * sb
    state[U] = state[R] * yt + (nx * speed + ny * post_v - side * (state[V] + state[R] * xt)) / c
    state[6] = state[7] = state[V]
    if q.has("fluid_memory.ring_s"):
        state[7] = np.where(q["fluid_memory.ring_s"] > 0, 0.0, state[7])
    state[CREEP] = q["elastic_line.creep"] * q["elastic_line.compliance_m_n"] * q["tension"] * held
    state[PULL] = servo_command(q, -nx)
    state[SLOSH] = np.where(q["sloshing.side_n"] != 0, 1.0, 0.0)
    return state


def _aside(q: Lanes, t: float, y: Array, b: Array) -> Array:
    """Where the line holds, beside the centre line: fixed, slipped at some time, or on a rail on which the line draws it along."""
    place = q["tow_point_offset.offset_m"]
    if q.has("tow_point_offset.slip_m"):
        gone = 0.5 * (1 + np.tanh((t - q["tow_point_offset.slip_s"]) / SLIPS_S))
        place = place + q["tow_point_offset.slip_m"] * gone
    if q.has("tow_point_offset.slide_m"):
        place = place - q["tow_point_offset.slide_m"] * np.tanh(((y + q["x_t"] * b) / q["line"] + b) / RAIL_RAD)
    return place


def _post(q: Lanes, t: float) -> tuple[Array, Array]:
    """The post across the tank, and its rate: off its stated place, shaken by the carriage."""
    place = q["datum_bias.aside_m"]
    if not q.has("carriage_shake.size_m"):
        return place, np.zeros(q.n)
    w = 2 * np.pi * q["carriage_shake.rate_hz"]
    phase = w * t + q["carriage_shake.phase"]
    size = q["carriage_shake.size_m"]
    return place + size * np.sin(phase), size * w * np.cos(phase)


def _rates(q: Lanes, terms, t: float, s: Array, random: Array) -> tuple[Array, Array]:
    x, y, b, u, v, r = s[:6]
    sb, cb = np.sin(b), np.cos(b)
    speed = speed_at(q, t)
    post_y, post_v = _post(q, t)
    xt, yt = q["x_t"], _aside(q, t, y, b)
    out = np.zeros_like(s)
    out[X], out[Y], out[B] = u * cb - v * sb - speed, u * sb + v * cb, r
    # the line
    px = x + xt * cb - yt * sb - q["datum_bias.ahead_m"]
    py = y + xt * sb + yt * cb - post_y
    length = np.hypot(px, py)
    nx, ny = px / length, py / length
    vx = out[X] + r * (-xt * sb - yt * cb)
    vy = out[Y] + r * (xt * cb - yt * sb) - post_v
    turn = (nx * vy - ny * vx) / length
    tension = pull_of(q, s[PULL], s[CREEP], length, nx * vx + ny * vy)
    if q.once(servo_anywhere):
        out[PULL], out[PULL_RATE] = servo_rates(q, -nx, s[PULL], s[PULL_RATE])
    c, side = nx * cb + ny * sb, ny * cb - nx * sb
    # the hull: what grows with its own speed through the water, not with the carriage's
    scale = u / q["speed_ref"]
    share = u / q["speed"]
    added = np.zeros(q.n)
    if q.has("new_mass.share"):
        added = q["m"] * q["new_mass.share"] * 0.5 * (1 + np.tanh((t - q["new_mass.time_s"]) / 0.3))
    mass = q["mass"] + added
    y_r = q["y_r"] + q["mass"] * q["speed_ref"]
    ahead = push(q, t) - q["tension"] * share * np.abs(share) ** (q["power"] - 1)
    x_vv = q["x_vv"] - q["crossflow_drag.ahead_kg_m"]
    ahead = ahead + x_vv * v**2 + (q["x_vr"] + mass) * v * r + q["x_rr"] * r**2 - tension * c
    force = scale * (q["y_v"] * v + y_r * r) - mass * u * r - tension * side + random[0]
    moment = scale * (q["n_v"] * v + q["n_r"] * r) - tension * (xt * side - yt * c) + random[1]
    # the line's direction in tank axes turns with ``turn``, the hull's with r: the swivel feels the difference
    now = Now(t, y, b, v, r, u, -tension * side, r - turn, s[LAG], s[SLOSH], turn, c / length)
    if q.has("law.along0") or q.has("law.along1"):
        ahead = ahead + law_ahead(q, now)
    for term, own, here in terms:
        if here is None:
            one, two = term(q, now)
            force, moment = force + one, moment + two
        else:
            one, two = term(own, now.part(here))
            force[here] += one
            moment[here] += two
    m, i = q["m"] + added, q["i"]
    cross, other = q["added_mass_coupling.y_rdot"], q["added_mass_coupling.n_vdot"]
    det = m * i - cross * other
    out[U] = ahead / (q["surge_mass"] + added)
    out[V] = (i * force + cross * moment) / det
    out[R] = (m * moment + other * force) / det
    _slow_states(q, s, out, now, tension, side)
    return out, tension


def _slow_states(q: Lanes, s: Array, out: Array, now: Now, tension: Array, side: Array) -> None:
    if any(map(q.has, _MEMORY)):
        out[LAG] = memory_rates(q, s[LAG], s[V], s[R])
    if q.has("elastic_line.creep"):
        out[CREEP] = creep_rate(q, s[CREEP], tension)
    leans = any(map(q.has, _LEANS))
    if leans or any(map(q.has, _ROLLS)):
        w = 2 * np.pi / np.maximum(q["marker_roll.period_s"], 0.3)
        drive = q["marker_roll.lean_rad"] * (-tension * side / q["tension"])
        inertia = q["marker_roll.sway_rad"] * q["m"] * out[V] + q["marker_roll.turn_rad"] * q["mass"] * s[U] * s[R]
        drive = drive + inertia / q["tension"] + (law_lean(q, now) if leans else 0.0)
        out[ROLL] = s[ROLL_RATE]
        out[ROLL_RATE] = w**2 * (drive - s[ROLL]) - 2 * q["marker_roll.damping"] * w * s[ROLL_RATE]
    if q.has("sloshing.side_n"):
        w = 2 * np.pi * q["sloshing.rate_hz"]
        out[SLOSH] = s[SLOSH_RATE]
        out[SLOSH_RATE] = (
            -(w**2) * s[SLOSH] - 2 * q["sloshing.damping"] * w * s[SLOSH_RATE] + q["sloshing.feed"] * out[V]
        )
