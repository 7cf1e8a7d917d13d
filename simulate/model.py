"""The towed model's equations of motion: hull, line, kinematics. The only place where they stand (theory.md 2, 9.1, 10).

Every function takes arrays that broadcast; units are SI and radians. The linear form is this same equation evaluated
on unit vectors with s = y/L + (1 + X_T/L) beta in place of sin(alpha + beta).

``Tow.line`` says what the line does: "surge", it keeps its length and its tension is what the model's own inertia makes it
(theory.md 10); "constant", it keeps its tension and the model's forward speed is the carriage's (the thesis's approximation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..record.errors import TowlineError

Array = NDArray[Any]
DERIVATIVE_UNITS = {
    "m_minus_y_vdot": "kg",
    "i_minus_n_rdot": "kg m2",
    "y_v": "N s/m",
    "y_r_minus_mu": "N s",
    "n_v": "N s",
    "n_r": "N m s",
}
GRAVITY_M_S2 = 9.81
"""Its third digit changes with the place; nothing here needs more."""
RESISTANCE_EXPONENT = 1.85
"""n of R ~ u^n where nothing is said: 1.8-2 for bare models (theory.md 10)."""
Line = Literal["constant", "surge"]


@dataclass(frozen=True)
class Hull:
    """The linear hull, dimensional at ``speed_m_s`` (2.18, 2.20); damping grows with U, rudder and bias with U^2.

    Attributes
    ----------
    m_minus_y_vdot : m - Y_vdot, kg
    i_minus_n_rdot : I - N_rdot, kg m2
    y_v, y_r_minus_mu, n_v, n_r : Y_v N s/m, Y_r - mU N s, N_v N s, N_r N m s
    speed_m_s : U at which they are quoted
    y_rdot, n_vdot : cross added masses, kg m
    y_delta, n_delta : rudder force N/rad and moment N m/rad
    y_bias_n, n_bias_n_m : Y*, N* of an asymmetric hull
    mass_kg : m, the displacement mass; needed for surge only
    x_udot_kg : X_udot, negative: water that surges along
    x_vr_kg, x_vv_kg_m, x_rr_kg_m : X_vr, X_vv, X_rr; they do not change with the speed
    resistance_exponent : n of R ~ u^n
    """

    m_minus_y_vdot: float
    i_minus_n_rdot: float
    y_v: float
    y_r_minus_mu: float
    n_v: float
    n_r: float
    speed_m_s: float
    y_rdot: float = 0.0
    n_vdot: float = 0.0
    y_delta: float = 0.0
    n_delta: float = 0.0
    y_bias_n: float = 0.0
    n_bias_n_m: float = 0.0
    mass_kg: float | None = None
    x_udot_kg: float = 0.0
    x_vr_kg: float = 0.0
    x_vv_kg_m: float = 0.0
    x_rr_kg_m: float = 0.0
    resistance_exponent: float = RESISTANCE_EXPONENT

    @property
    def six(self) -> Array:
        """The six linear derivatives, (6,), in the order of ``DERIVATIVE_UNITS``."""
        return np.array([getattr(self, name) for name in DERIVATIVE_UNITS])

    def with_six(self, values: Array) -> Hull:
        """This hull with other linear derivatives."""
        return replace(self, **{name: float(value) for name, value in zip(DERIVATIVE_UNITS, values, strict=True)})

    @property
    def x_v_m(self) -> float:
        """X_v = N_v/Y_v, the neutral point ahead of LCG (4.9)."""
        return self.n_v / self.y_v

    @property
    def x_r_m(self) -> float:
        """X_r = N_r/(Y_r - mU)."""
        return self.n_r / self.y_r_minus_mu

    @property
    def straight_line_stable(self) -> bool:
        """Y_v N_r - N_v Y_R > 0, that is X_r > X_v; a verdict, never a precondition of a tow."""
        return self.y_v * self.n_r - self.n_v * self.y_r_minus_mu > 0

    def at_speed(self, speed_m_s: float | Array) -> Hull:
        """The same hull (same primes) at another speed; a hull at rest has no damping."""
        ratio = speed_m_s / self.speed_m_s
        damping = {name: getattr(self, name) * ratio for name in ("y_v", "y_r_minus_mu", "n_v", "n_r")}
        force = {name: getattr(self, name) for name in ("y_delta", "n_delta", "y_bias_n", "n_bias_n_m")}
        force = {name: value * ratio**2 for name, value in force.items() if not _nothing(value)}
        # a force law asks for this at every step of an integration: dataclasses.replace would take a third of its time
        here = object.__new__(type(self))
        here.__dict__.update(self.__dict__, speed_m_s=speed_m_s, **damping, **force)
        return here


@dataclass(frozen=True)
class Tow:
    """How the model hangs on its line.

    Attributes
    ----------
    speed_m_s : U
    line_length_m : L
    tow_point_m, tow_point_offset_m : X_T ahead of LCG, Y_T to starboard
    tension_n : T of a "constant" line; of a "surge" line R, the force of a straight tow at the hull's ``speed_m_s``
    resistance_n : "constant" line without tension_n: T = R/cos(alpha)
    rudder_rad : delta, positive to port
    post_m : tow post in tank axes, (x, y)
    post_amplitude_m, post_frequency_hz, post_phase_rad : y_o = amplitude sin(2 pi f t + phase) (3.7)
    line : what the line keeps: its length ("surge") or its tension ("constant")
    stiffness_n_m : of a "surge" line that is a spring, ``line_length_m`` long without load; None = it does not stretch
    line_damping_n_s_m : of that spring
    speed_rate_m_s2 : dU/dt, of a "surge" line
    """

    speed_m_s: float
    line_length_m: float
    tow_point_m: float
    tension_n: float | None
    resistance_n: float | None = None
    tow_point_offset_m: float = 0.0
    rudder_rad: float = 0.0
    post_m: tuple[float, float] = (0.0, 0.0)
    post_amplitude_m: float = 0.0
    post_frequency_hz: float = 0.0
    post_phase_rad: float = 0.0
    line: Line = "constant"
    stiffness_n_m: float | None = None
    line_damping_n_s_m: float = 0.0
    speed_rate_m_s2: float = 0.0

    def post_motion(self, t_s: Array | float) -> tuple[Array | float, Array | float]:
        """y_o and its rate at the times ``t_s``, m and m/s (3.7)."""
        if isinstance(self.post_amplitude_m, float) and self.post_amplitude_m == 0.0:
            return 0.0, 0.0
        omega = 2 * np.pi * self.post_frequency_hz
        phase = omega * np.asarray(t_s) + self.post_phase_rad
        return self.post_amplitude_m * np.sin(phase), self.post_amplitude_m * omega * np.cos(phase)

    def post_acceleration(self, t_s: Array | float) -> Array | float:
        """y_o'' at the times ``t_s``, m/s2."""
        omega = 2 * np.pi * self.post_frequency_hz
        return -(omega**2) * self.post_motion(t_s)[0]

    @property
    def resistance(self) -> float:
        """R of a "surge" line, N."""
        return self.tension_n if self.tension_n is not None else self.resistance_n  # pyright: ignore[reportReturnType]

    def tension(self, alpha):
        """T of a "constant" line at the tow line angle ``alpha``, N."""
        if self.tension_n is not None:
            return self.tension_n
        assert self.resistance_n is not None
        return self.resistance_n / np.cos(alpha)


class Answering(Protocol):
    """A hull of another simulator, known by how it answers speeds and forces; many side by side where the arrays broadcast."""

    def free(self, u: Any, v: Any, r: Any, rudder_rad: Any, more: tuple[Any, ...]) -> tuple[Any, Any, Any]:
        """u', v', r' without the line, at these speeds; ``more``: what else pushes, (Y, N) or (Y, N, X)."""
        ...

    def pulled(self, ahead: Any, side: Any, moment: Any) -> tuple[Any, Any, Any]:
        """By how much a force ahead, a side force and a moment change u', v', r'."""
        ...


Kind = TypeVar("Kind", "Hull", "Tow")


def _nothing(value: Any) -> bool:
    """Whether a number, or every one of an array, is 0: terms of it are left out."""
    return value == 0.0 if isinstance(value, float) else not np.any(value)


def side_by_side(kind: type[Kind], **numbers: Any) -> Kind:
    """A ``Hull`` or a ``Tow`` of many runs at once: its numbers may be arrays that broadcast, which every equation here takes.

    Examples
    --------
    >>> tows = side_by_side(Tow, speed_m_s=1.28, line_length_m=np.array([0.9, 1.2]), tow_point_m=1.5, tension_n=4.0)
    >>> line_force(tows, 4.0, np.array([0.1, 0.2]), 1.0)[0]
    array([-0.4, -0.8])
    """
    return kind(**numbers)


ExtraForce = Callable[..., tuple]
"""An unmodelled effect: ``(t_s, y, beta, v, r, alpha) -> (Y, N)`` added to sway and yaw, N and N m, or ``(Y, N, X)`` with what is
added to surge, N: a line that keeps its length answers that by its tension, one that keeps its tension does not (u is U)."""


def sway_yaw_acceleration(hull: Hull, v, r, side_force, moment):
    """Solve the two equations of motion (2.18) for v' and r'.

    m' v' - Y_rdot r' = Y_v v + Y_R r + Y ;  I' r' - N_vdot v' = N_v v + N_r r + N

    Parameters
    ----------
    hull : at the speed of the run
    v, r : sway velocity m/s, yaw rate rad/s
    side_force, moment : everything beside the linear hull, N and N m

    Returns
    -------
    v', r' : m/s2 and rad/s2; v' is the derivative of v, not the acceleration (it holds -U beta')
    """
    sway = hull.y_v * v + hull.y_r_minus_mu * r + side_force
    yaw = hull.n_v * v + hull.n_r * r + moment
    return accelerated(hull, sway, yaw)


def accelerated(hull: Hull, side_force, moment):
    """v' and r' under the whole side force and moment; added masses and their cross terms only."""
    if _nothing(hull.y_rdot) and _nothing(hull.n_vdot):
        return side_force / hull.m_minus_y_vdot, moment / hull.i_minus_n_rdot
    determinant = hull.m_minus_y_vdot * hull.i_minus_n_rdot - hull.y_rdot * hull.n_vdot
    return (
        (hull.i_minus_n_rdot * side_force + hull.y_rdot * moment) / determinant,
        (hull.n_vdot * side_force + hull.m_minus_y_vdot * moment) / determinant,
    )


def constant_force(hull: Hull, rudder_rad: float) -> tuple[float, float]:
    """Rudder and asymmetry: Y_delta delta + Y*, N_delta delta + N* at the hull's speed, N and N m."""
    return hull.y_delta * rudder_rad + hull.y_bias_n, hull.n_delta * rudder_rad + hull.n_bias_n_m


def line_force(tow: Tow, tension, sine, cosine):
    """The line's side force and moment from sin and cos of (alpha + beta), N and N m (2.18; Y_T: theory.md 2)."""
    return -tension * sine, -tension * (tow.tow_point_m * sine + tow.tow_point_offset_m * cosine)


def surge_mass(hull: Hull) -> Any:
    """m - X_udot, kg."""
    if hull.mass_kg is None:
        raise TowlineError('Hull.mass_kg: missing; line = "surge" weighs the model')
    return hull.mass_kg - hull.x_udot_kg


def surge_force(hull: Hull, resistance_n, speed_ratio, v, r):
    """X without the line: -R (u/U_0)|u/U_0|^(n-1) + X_vv v^2 + X_vr v r + X_rr r^2 (theory.md 10), N.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    resistance_n : R at U_0
    speed_ratio : u/U_0; complex values are differentiated as real ones
    v : sway velocity, m/s
    r : yaw rate, rad/s
    """
    # sqrt(z^2) is |z| with a derivative, complex steps included
    size = np.sqrt(speed_ratio * speed_ratio) ** (hull.resistance_exponent - 1)
    return -resistance_n * speed_ratio * size + v * (hull.x_vv_kg_m * v + hull.x_vr_kg * r) + hull.x_rr_kg_m * r * r


def line_angle_rate(tow: Tow, beta, v, r, cosine, post_rate: Array | float = 0.0, heading=None):
    """a' = (v + X_T r + U sin b - y_o' cos b)/(L cos(a+b)) (theory.md 9.1), rad/s; ``cosine`` of alpha + beta.

    ``heading``: sin b and cos b, where they are known already.
    """
    sin_b = np.sin(beta) if heading is None else heading[0]
    across = v + tow.tow_point_m * r + tow.speed_m_s * sin_b
    if not _nothing(post_rate):
        across = across - post_rate * (np.cos(beta) if heading is None else heading[1])
    return across / (tow.line_length_m * cosine)


def forward_speed(tow: Tow, alpha, beta, v, r, post_rate: Array | float = 0.0, turn=None):
    """u of a model on a line that keeps its length: U cos b + L a' sin(a+b) + Y_T r + y_o' sin b (theory.md 10), m/s."""
    sine, cosine, heading = np.sin(alpha + beta), np.cos(alpha + beta), (np.sin(beta), np.cos(beta))
    if turn is None:
        turn = line_angle_rate(tow, beta, v, r, cosine, post_rate, heading)
    return _forward_speed(tow, r, turn, sine, heading, post_rate)


def _forward_speed(tow: Tow, r, turn, sine, heading, post_rate):
    along = tow.speed_m_s * heading[1] + tow.line_length_m * turn * sine
    for part, of in ((tow.tow_point_offset_m, r), (post_rate, heading[0])):
        along = along if _nothing(part) else along + part * of
    return along


@dataclass(frozen=True)
class Taut:
    """A tow at one time: ``full_state``.

    Attributes
    ----------
    rates : (4, ...), of alpha, beta, v, r
    tension_n : T, N; of a "surge" line it may be below 0: there the line is slack and these equations do not hold
    u_m_s : forward speed through the water
    gain : of a "surge" line, by how much faster the model would go for each newton more than keeps the line's length, m/s2 per N
    """

    rates: Array
    tension_n: Any
    u_m_s: Any
    gain: Any = np.inf


def full_state(t_s, state, hull: Hull | Answering, tow: Tow, extra: ExtraForce | None = None) -> Taut:
    """Rates of (alpha, beta, v, r), tension and forward speed: full sine and kinematics (2.9), a line that does not stretch.

    a' = (v + X_T r + U sin b - y_o' cos b)/(L cos(a+b)), b' = r; singular at a + b = 90 degrees. With ``tow.line`` = "surge"
    T follows from the constraint in closed form (theory.md 10); with "constant" u = U and T is given.

    Parameters
    ----------
    t_s : time
    state : (4, ...) alpha rad, beta rad, v m/s, r rad/s
    hull : at the carriage's speed ("constant") or at the speed at which R is quoted ("surge"); or another simulator's
    tow : T, X_T, L, U of the tow
    extra : force and moment beside the model's own
    """
    alpha, beta, v, r = state
    _, post_rate = tow.post_motion(t_s)
    angle, heading = alpha + beta, (np.sin(beta), np.cos(beta))
    sine, cosine = np.sin(angle), np.cos(angle)
    turn = line_angle_rate(tow, beta, v, r, cosine, post_rate, heading)
    more = (0.0, 0.0) if extra is None else extra(t_s, full_y_cg(t_s, alpha, beta, tow), beta, v, r, alpha)
    if tow.line == "constant":
        tension, u = tow.tension(alpha), tow.speed_m_s
        v_rate, r_rate = _held_at(u, hull, tow, v, r, line_force(tow, tension, sine, cosine), more)
        return Taut(_together(turn, r, v_rate, r_rate), tension, u)
    u = _forward_speed(tow, r, turn, sine, heading, post_rate)
    u_free, v_free, r_free = _coasting(hull, tow, u, v, r, more)
    u_pull, v_pull, r_pull = _by_line(hull, tow, 1.0, sine, cosine)
    by_v = sine / cosine
    by_r = tow.tow_point_m * by_v + tow.tow_point_offset_m
    needed = surge_rate_of_line(t_s, state, turn, by_v, cosine, tow, post_rate, heading) + by_v * v_free + by_r * r_free
    gain = u_pull - by_v * v_pull - by_r * r_pull
    tension = (needed - u_free) / gain
    rates = _together(turn, r, v_free + tension * v_pull, r_free + tension * r_pull)
    return Taut(rates, tension, u, gain)


def _together(turn, r, v_rate, r_rate) -> Array:
    """(4, ...): r is a state, and may have fewer columns than what follows from it."""
    shape = np.broadcast_shapes(np.shape(turn), np.shape(r), np.shape(v_rate), np.shape(r_rate))
    rates = np.empty((4, *shape), dtype=np.result_type(turn, r, v_rate, r_rate))
    rates[0], rates[1], rates[2], rates[3] = turn, r, v_rate, r_rate
    return rates


def full_rates(t_s, state, hull: Hull, tow: Tow, extra: ExtraForce | None = None):
    """Rates of (alpha, beta, v, r), (4, ...): ``full_state``."""
    return full_state(t_s, state, hull, tow, extra).rates


def _held_at(u, hull: Hull | Answering, tow: Tow, v, r, line, more):
    """v', r' of a hull that a carriage takes along at its speed; ``line``: its side force and moment."""
    if not isinstance(hull, Hull):
        free, pull = hull.free(u, v, r, tow.rudder_rad, more), hull.pulled(0.0, *line)
        return free[1] + pull[1], free[2] + pull[2]
    y_0, n_0 = constant_force(hull, tow.rudder_rad)
    return sway_yaw_acceleration(hull, v, r, line[0] + y_0 + more[0], line[1] + n_0 + more[1])


def _coasting(hull: Hull | Answering, tow: Tow, u, v, r, more):
    """u', v', r' without the line, at the forward speed u."""
    if not isinstance(hull, Hull):
        return hull.free(u, v, r, tow.rudder_rad, more)
    here = hull.at_speed(u)
    y_0, n_0 = constant_force(here, tow.rudder_rad)
    v_free, r_free = sway_yaw_acceleration(here, v, r, y_0 + more[0], n_0 + more[1])
    push = surge_force(hull, tow.resistance, u / hull.speed_m_s, v, r) + hull.mass_kg * v * r
    return (push + more[2] if len(more) > 2 else push) / surge_mass(hull), v_free, r_free


def _by_line(hull: Hull | Answering, tow: Tow, tension, sine, cosine):
    """By how much a line that pulls with ``tension`` at alpha + beta changes u', v', r'."""
    ahead, side_and_moment = tension * cosine, line_force(tow, tension, sine, cosine)
    if not isinstance(hull, Hull):
        return hull.pulled(ahead, *side_and_moment)
    return ahead / surge_mass(hull), *accelerated(hull, *side_and_moment)


def _under_pull(hull: Hull | Answering, tow: Tow, speeds: tuple[Any, Any, Any], tension, sine, cosine, more):
    """u', v', r' of a model that a line pulls with ``tension`` at alpha + beta; ``speeds``: u, v, r."""
    free, pull = _coasting(hull, tow, *speeds, more), _by_line(hull, tow, tension, sine, cosine)
    return free[0] + pull[0], free[1] + pull[1], free[2] + pull[2]


def surge_rate_of_line(t_s, state, turn, by_v, cosine, tow: Tow, post_rate, heading):
    """K_0: u' of a line that keeps its length, at v' = r' = 0 (theory.md 10), m/s2.

    ``turn``: alpha'; ``by_v``: tan(alpha + beta); ``heading``: sin and cos of beta.
    """
    r, (sin_b, cos_b) = state[3], heading
    found = tow.speed_m_s * r * (by_v * cos_b - sin_b) + tow.line_length_m * turn * (turn + r) / cosine
    if not _nothing(tow.speed_rate_m_s2):
        found = found + tow.speed_rate_m_s2 * (cos_b + by_v * sin_b)
    if not _nothing(post_rate) or not _nothing(tow.post_amplitude_m):
        gust = tow.post_acceleration(t_s)
        found = found + gust * (sin_b - by_v * cos_b) + post_rate * r * (cos_b + by_v * sin_b)
    return found


def loose_rates(t_s, state, hull: Hull, tow: Tow, extra: ExtraForce | None = None):
    """Rates of (x_CG, y_CG, beta, u, v, r) of a model whose line is slack or a spring (theory.md 10), carriage axes.

    Parameters
    ----------
    t_s : time, s
    state : (6, ...), m, m, rad, m/s, m/s, rad/s
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    extra : force and moment beside the model's own
    """
    _, y, beta, u, v, r = state
    sin_b, cos_b = np.sin(beta), np.cos(beta)
    tension, sine, cosine, alpha = spring_tension(t_s, state, tow)
    more = (0.0, 0.0) if extra is None else extra(t_s, y, beta, v, r, alpha)
    rates = _under_pull(hull, tow, (u, v, r), tension, sine, cosine, more)
    ahead, aside = u * cos_b - v * sin_b - tow.speed_m_s, u * sin_b + v * cos_b
    return np.array([ahead, aside, r, *rates])


def paid_state(t_s, state, tension, hull: Hull | Answering, tow: Tow, extra: ExtraForce | None = None) -> Taut:
    """``full_state`` of a line whose length is a state, because what it pulls with is given: a spring, a winch, a weight.

    The same equations as ``loose_rates`` (theory.md 10) in the line's own coordinates: L' is by how fast the tow point goes from
    the post, alpha' by how fast it goes across the line.

    Parameters
    ----------
    t_s : time, s
    state : (5, ...) alpha rad, beta rad, v m/s, r rad/s, u m/s
    tension : what the line pulls with, N
    hull : the six derivatives and the speed at which they and R are quoted
    tow : X_T, R, U of the tow, and how long the line is now
    extra : force and moment beside the model's own

    Returns
    -------
    rates of alpha, beta, v, r, L, u, (6, ...)
    """
    alpha, beta, v, r, u = state
    sine, cosine = np.sin(alpha + beta), np.cos(alpha + beta)
    more = (0.0, 0.0) if extra is None else extra(t_s, full_y_cg(t_s, alpha, beta, tow), beta, v, r, alpha)
    u_rate, v_rate, r_rate = _under_pull(hull, tow, (u, v, r), tension, sine, cosine, more)
    across, along = line_speeds(t_s, state, tow)
    found = (across / tow.line_length_m, r, v_rate, r_rate, along, u_rate)
    return Taut(np.stack(np.broadcast_arrays(*found)), tension, u)


def line_speeds(t_s, state, tow: Tow):
    """Speeds of the tow point seen from the post across the line, L alpha', and along it, L', m/s.

    Parameters
    ----------
    t_s : time, s
    state : (5, ...) alpha rad, beta rad, v m/s, r rad/s, u m/s
    tow : X_T, U of the tow
    """
    alpha, beta, v, r, u = state
    sine, cosine = np.sin(alpha + beta), np.cos(alpha + beta)
    post_rate = tow.post_motion(t_s)[1]
    point, offset = tow.tow_point_m, tow.tow_point_offset_m
    sin_a, cos_a = np.sin(alpha), np.cos(alpha)
    across = u * sine + v * cosine + r * (point * cosine - offset * sine) - tow.speed_m_s * sin_a - post_rate * cos_a
    along = v * sine - u * cosine + r * (point * sine + offset * cosine) + tow.speed_m_s * cos_a - post_rate * sin_a
    return across, along


def spring_tension(t_s, state, tow: Tow):
    """T of a spring line (0 without ``stiffness_n_m``, and never a push), sin and cos of alpha + beta, alpha."""
    away, rate, alpha = line_reach(t_s, state, tow)
    angle = alpha + state[2]
    tension = 0.0 * away
    if tow.stiffness_n_m is not None:
        pull = tow.stiffness_n_m * (away - tow.line_length_m) + tow.line_damping_n_s_m * rate
        tension = np.maximum(pull, 0.0) * (away > tow.line_length_m)
    return tension, np.sin(angle), np.cos(angle), alpha


def line_reach(t_s, state, tow: Tow):
    """Distance of the tow point from the post, its rate, and alpha, from (x_CG, y_CG, beta, u, v, r); m, m/s, rad."""
    x, y, beta, u, v, r = state
    sin_b, cos_b = np.sin(beta), np.cos(beta)
    post_y, post_rate = tow.post_motion(t_s)
    point, offset = tow.tow_point_m, tow.tow_point_offset_m
    ahead = x + point * cos_b - offset * sin_b - tow.post_m[0]
    aside = y + point * sin_b + offset * cos_b - tow.post_m[1] - post_y
    away = np.hypot(ahead, aside)
    ahead_rate = u * cos_b - v * sin_b - tow.speed_m_s - r * (point * sin_b + offset * cos_b)
    aside_rate = u * sin_b + v * cos_b + r * (point * cos_b - offset * sin_b) - post_rate
    return away, (ahead * ahead_rate + aside * aside_rate) / away, np.arctan2(aside, -ahead)


def jerk_of_line(hull: Hull, tow: Tow, alpha, beta, parting_m_s):
    """Changes of u, v, r as a slack line becomes taut: it takes the separating speed away at once (theory.md 10), m/s, rad/s."""
    sine, cosine = np.sin(alpha + beta), np.cos(alpha + beta)
    arm = tow.tow_point_m * sine + tow.tow_point_offset_m * cosine
    mass = surge_mass(hull)
    v_pull, r_pull = accelerated(hull, -sine, -arm)
    impulse = parting_m_s / (cosine**2 / mass - sine * v_pull - arm * r_pull)
    return impulse * cosine / mass, impulse * v_pull, impulse * r_pull


def free_rates(t_s, state, hull: Hull, tow: Tow, extra: ExtraForce | None = None):
    """Rates of (y_cg, beta, v, r) of a model without a line (kind = "free")."""
    y, beta, v, r = state
    side, moment = constant_force(hull, tow.rudder_rad)
    if extra is not None:
        more = extra(t_s, y, beta, v, r, 0.0)
        side, moment = side + more[0], moment + more[1]
    v_rate, r_rate = sway_yaw_acceleration(hull, v, r, side, moment)
    return np.array([tow.speed_m_s * np.sin(beta) + v * np.cos(beta), r, v_rate, r_rate])


def full_y_cg(t_s, alpha, beta, tow: Tow):
    """y_CG in tank axes from the angles (2.10), m."""
    post_y, _ = tow.post_motion(t_s)
    return (
        tow.post_m[1]
        + post_y
        + tow.line_length_m * np.sin(alpha)
        - tow.tow_point_m * np.sin(beta)
        - tow.tow_point_offset_m * np.cos(beta)
    )


def full_x_cg(alpha, beta, tow: Tow):
    """x_CG in tank axes from the angles (2.10), m."""
    return (
        tow.post_m[0]
        - tow.line_length_m * np.cos(alpha)
        - tow.tow_point_m * np.cos(beta)
        + tow.tow_point_offset_m * np.sin(beta)
    )


def full_y_cg_rate(alpha, beta, alpha_rate, beta_rate, tow: Tow):
    """How ``full_y_cg`` changes as the angles do, the post standing still; per time or per anything else."""
    arm = tow.tow_point_m * np.cos(beta) - tow.tow_point_offset_m * np.sin(beta)
    return tow.line_length_m * np.cos(alpha) * alpha_rate - arm * beta_rate


def full_x_cg_rate(alpha, beta, alpha_rate, beta_rate, tow: Tow):
    """How ``full_x_cg`` changes as the angles do."""
    arm = tow.tow_point_m * np.sin(beta) + tow.tow_point_offset_m * np.cos(beta)
    return tow.line_length_m * np.sin(alpha) * alpha_rate + arm * beta_rate


def alpha_from_y(y_cg, beta, tow: Tow, post_y: Array | float = 0.0):
    """The tow line angle that puts the LCG at ``y_cg`` (inverse of ``full_y_cg``), rad; NaN out of the line's reach."""
    lateral = y_cg - tow.post_m[1] - post_y + tow.tow_point_m * np.sin(beta) + tow.tow_point_offset_m * np.cos(beta)
    with np.errstate(invalid="ignore"):
        return np.arcsin(lateral / tow.line_length_m)


def linear_system(hull: Hull, tow: Tow) -> tuple[Array, Array]:
    """The linear form (2.20, model B (8.26)): x' = A x + b with x = (y, beta, v, r), y measured from the post.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow

    Returns
    -------
    A : (4, 4)
    b : (4,), rates at x = 0 from rudder, asymmetry and an off-centre tow point

    Built by evaluating ``sway_yaw_acceleration`` and ``line_force`` on unit vectors.
    """
    if tow.tension_n is None:
        raise ValueError("the linear form needs a constant tension_n")
    length = tow.line_length_m
    y, beta, v, r = np.eye(4)
    s = y / length + (1 + tow.tow_point_m / length) * beta
    on_axis = replace(tow, tow_point_offset_m=0.0)
    side, moment = line_force(on_axis, tow.tension_n, s, 1.0)
    v_rate, r_rate = sway_yaw_acceleration(hull, v, r, side, moment)
    matrix = np.stack([v + tow.speed_m_s * beta, r, v_rate, r_rate])
    y_0, n_0 = constant_force(hull, tow.rudder_rad)
    offset = tow.tow_point_offset_m
    side_0, moment_0 = line_force(tow, tow.tension_n, offset / length, 1.0)
    constant = sway_yaw_acceleration(hull, 0.0, 0.0, side_0 + y_0, moment_0 + n_0)
    return matrix, np.array([0.0, 0.0, *constant])
