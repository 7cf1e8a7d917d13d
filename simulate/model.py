"""The towed model's equations of motion: hull, line, kinematics. The only place where they stand (theory.md 2, 9.1).

Every function takes arrays that broadcast; units are SI and radians. The linear form is this same equation evaluated
on unit vectors with s = y/L + (1 + X_T/L) beta in place of sin(alpha + beta).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
DERIVATIVE_UNITS = {
    "m_minus_y_vdot": "kg",
    "i_minus_n_rdot": "kg m2",
    "y_v": "N s/m",
    "y_r_minus_mu": "N s",
    "n_v": "N s",
    "n_r": "N m s",
}


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

    def at_speed(self, speed_m_s: float) -> Hull:
        """The same hull (same primes) at another speed; a hull at rest has no damping."""
        ratio = speed_m_s / self.speed_m_s
        damping = {name: getattr(self, name) * ratio for name in ("y_v", "y_r_minus_mu", "n_v", "n_r")}
        force = {name: getattr(self, name) * ratio**2 for name in ("y_delta", "n_delta", "y_bias_n", "n_bias_n_m")}
        return replace(self, speed_m_s=speed_m_s, **damping, **force)


@dataclass(frozen=True)
class Tow:
    """How the model hangs on its line.

    Attributes
    ----------
    speed_m_s : U
    line_length_m : L
    tow_point_m, tow_point_offset_m : X_T ahead of LCG, Y_T to starboard
    tension_n : T, constant; or None with ``resistance_n`` = R: T = R/cos(alpha)
    rudder_rad : delta, positive to port
    post_m : tow post in tank axes, (x, y)
    post_amplitude_m, post_frequency_hz, post_phase_rad : y_o = amplitude sin(2 pi f t + phase) (3.7)
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

    def post_motion(self, t_s: Array | float) -> tuple[Array | float, Array | float]:
        """y_o and its rate at the times ``t_s``, m and m/s (3.7)."""
        if isinstance(self.post_amplitude_m, float) and self.post_amplitude_m == 0.0:
            return 0.0, 0.0
        omega = 2 * np.pi * self.post_frequency_hz
        phase = omega * np.asarray(t_s) + self.post_phase_rad
        return self.post_amplitude_m * np.sin(phase), self.post_amplitude_m * omega * np.cos(phase)

    def tension(self, alpha):
        """T at the tow line angle ``alpha``, N."""
        if self.tension_n is not None:
            return self.tension_n
        assert self.resistance_n is not None
        return self.resistance_n / np.cos(alpha)


ExtraForce = Callable[..., tuple]
"""An unmodelled effect: ``(t_s, y, beta, v, r, alpha) -> (Y, N)`` added to sway and yaw, N and N m."""


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
    if not np.any(hull.y_rdot) and not np.any(hull.n_vdot):
        return sway / hull.m_minus_y_vdot, yaw / hull.i_minus_n_rdot
    determinant = hull.m_minus_y_vdot * hull.i_minus_n_rdot - hull.y_rdot * hull.n_vdot
    return (
        (hull.i_minus_n_rdot * sway + hull.y_rdot * yaw) / determinant,
        (hull.n_vdot * sway + hull.m_minus_y_vdot * yaw) / determinant,
    )


def constant_force(hull: Hull, rudder_rad: float) -> tuple[float, float]:
    """Rudder and asymmetry: Y_delta delta + Y*, N_delta delta + N* at the hull's speed, N and N m."""
    return hull.y_delta * rudder_rad + hull.y_bias_n, hull.n_delta * rudder_rad + hull.n_bias_n_m


def line_force(tow: Tow, tension, sine, cosine):
    """The line's side force and moment from sin and cos of (alpha + beta), N and N m (2.18; Y_T: theory.md 2)."""
    return -tension * sine, -tension * (tow.tow_point_m * sine + tow.tow_point_offset_m * cosine)


def line_angle_rate(tow: Tow, beta, v, r, cosine, post_rate: Array | float = 0.0):
    """a' = (v + X_T r + U sin b - y_o' cos b)/(L cos(a+b)) (theory.md 9.1), rad/s; ``cosine`` of alpha + beta."""
    return (v + tow.tow_point_m * r + tow.speed_m_s * np.sin(beta) - post_rate * np.cos(beta)) / (
        tow.line_length_m * cosine
    )


def full_rates(t_s, state, hull: Hull, tow: Tow, extra: ExtraForce | None = None):
    """Rates of (alpha, beta, v, r), full sine and kinematics (2.9), inextensible line (theory.md 9.1).

    a' = (v + X_T r + U sin b - y_o' cos b)/(L cos(a+b)), b' = r; singular at a + b = 90 degrees.

    Parameters
    ----------
    t_s : time
    state : (4, ...) alpha rad, beta rad, v m/s, r rad/s
    hull : at the run's speed
    """
    alpha, beta, v, r = state
    _, post_rate = tow.post_motion(t_s)
    sine, cosine = np.sin(alpha + beta), np.cos(alpha + beta)
    alpha_rate = line_angle_rate(tow, beta, v, r, cosine, post_rate)
    side, moment = line_force(tow, tow.tension(alpha), sine, cosine)
    y_0, n_0 = constant_force(hull, tow.rudder_rad)
    side, moment = side + y_0, moment + n_0
    if extra is not None:
        more = extra(t_s, full_y_cg(t_s, alpha, beta, tow), beta, v, r, alpha)
        side, moment = side + more[0], moment + more[1]
    v_rate, r_rate = sway_yaw_acceleration(hull, v, r, side, moment)
    return np.array([alpha_rate, r, v_rate, r_rate])


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
