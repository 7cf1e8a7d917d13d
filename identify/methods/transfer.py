"""Transfer functions of the towed and the free model (2.37, 5.14, 5.22, 8.31) and their Bode data, out of the one linear form."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array, Hull, Tow, linear_system, sway_yaw_acceleration

OUTPUTS = ("y", "beta", "v", "r")


@dataclass(frozen=True)
class TransferFunction:
    """numerator(s)/denominator(s), real coefficients by falling powers.

    Attributes
    ----------
    numerator, denominator : (k,), (n,); the denominator carries the thesis's scale (A = m' I')
    """

    numerator: Array
    denominator: Array

    def __call__(self, s: Array | complex) -> Array:
        """Value at complex s."""
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)

    @property
    def poles(self) -> Array:
        """Roots of the denominator."""
        return np.roots(self.denominator)

    @property
    def zeros(self) -> Array:
        """Roots of the numerator."""
        return np.roots(self.numerator)


@dataclass(frozen=True)
class Bode:
    """Bode data.

    Attributes
    ----------
    omega_rad_s, gain_db, phase_deg : (n,); phase unwrapped along omega
    """

    omega_rad_s: Array
    gain_db: Array
    phase_deg: Array


def bode(function: TransferFunction, omega_rad_s: Array) -> Bode:
    """Gain in dB and unwrapped phase in degrees at the frequencies.

    Parameters
    ----------
    function : of a response
    omega_rad_s : (n,) circular frequencies, rad/s
    """
    omega = np.asarray(omega_rad_s, dtype=float)
    value = function(1j * omega)
    return Bode(omega, 20 * np.log10(np.abs(value)), np.degrees(np.unwrap(np.angle(value))))


def rudder_transfer(hull: Hull, tow: Tow) -> dict[str, TransferFunction]:
    """y, beta, v, r over the rudder angle of a towed model (2.37).

    Parameters
    ----------
    hull : with a rudder
    tow : T, X_T, L, U of the tow

    Returns
    -------
    name of the output -> transfer function
    """
    column = sway_yaw_acceleration(hull.at_speed(tow.speed_m_s), 0.0, 0.0, *_rudder(hull, tow))
    return _towed(hull, tow, np.array([0.0, 0.0, *column]))


def line_force_transfer(hull: Hull, tow: Tow) -> dict[str, TransferFunction]:
    """y, beta, v, r over a lateral force at the tow point, the line attached (5.22, 8.31), per N.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow

    Returns
    -------
    name of the output -> transfer function
    """
    column = sway_yaw_acceleration(hull.at_speed(tow.speed_m_s), 0.0, 0.0, 1.0, tow.tow_point_m)
    return _towed(hull, tow, np.array([0.0, 0.0, *column]))


def post_transfer(hull: Hull, tow: Tow) -> dict[str, TransferFunction]:
    """y, beta, v, r over the place of a moving post (3.7, 9.2), per m.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow

    Returns
    -------
    name of the output -> transfer function
    """
    matrix, _ = linear_system(hull.at_speed(tow.speed_m_s), tow)
    return _towed(hull, tow, -matrix[:, 0])


def open_loop_transfer(hull: Hull, tow: Tow) -> dict[str, TransferFunction]:
    """y, beta, v, r over a lateral force at the tow point, no line (8.27): the line's force is the input; double root at 0.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow

    Returns
    -------
    name of the output -> transfer function
    """
    column = sway_yaw_acceleration(hull.at_speed(tow.speed_m_s), 0.0, 0.0, 1.0, tow.tow_point_m)
    return _towed(hull, replace(tow, tension_n=0.0), np.array([0.0, 0.0, *column]))


def free_ship_transfer(hull: Hull, speed_m_s: float | None = None) -> dict[str, TransferFunction]:
    """v and r over the rudder angle of a free ship (5.14); denominator P0 = m'I's^2 - (I'Y_v + m'N_r)s + Y_v N_r - N_v Y_R.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    speed_m_s : U, m/s; default: the hull's own

    Returns
    -------
    "v" and "r" -> transfer function
    """
    speed = hull.speed_m_s if speed_m_s is None else speed_m_s
    tow = Tow(speed, 1.0, 0.0, 0.0)
    matrix, _ = linear_system(hull.at_speed(speed), tow)
    column = np.array(sway_yaw_acceleration(hull.at_speed(speed), 0.0, 0.0, *_rudder(hull, tow)))
    return _functions(matrix[2:, 2:], column, _scale(hull), OUTPUTS[2:])


def _rudder(hull: Hull, tow: Tow) -> tuple[float, float]:
    here = hull.at_speed(tow.speed_m_s)
    return here.y_delta, here.n_delta


def _scale(hull: Hull) -> float:
    return hull.m_minus_y_vdot * hull.i_minus_n_rdot - hull.y_rdot * hull.n_vdot


def _towed(hull: Hull, tow: Tow, column: Array) -> dict[str, TransferFunction]:
    matrix, _ = linear_system(hull.at_speed(tow.speed_m_s), tow)
    return _functions(matrix, column, _scale(hull), OUTPUTS)


def _functions(matrix: Array, column: Array, scale: float, names: tuple[str, ...]) -> dict[str, TransferFunction]:
    """adj(s I - A) b / det(s I - A) by Faddeev and LeVerrier: exact, no root finding."""
    size = len(matrix)
    term, denominator, adjugate = np.eye(size), [1.0], []
    for order in range(1, size + 1):
        adjugate.append(term @ column)
        product = matrix @ term
        denominator.append(-np.trace(product) / order)
        term = product + denominator[-1] * np.eye(size)
    numerators = np.array(adjugate).T * scale
    below = np.array(denominator) * scale
    return {name: TransferFunction(_trimmed(row), below) for name, row in zip(names, numerators, strict=True)}


def _trimmed(row: Array) -> Array:
    """Without leading zeros that are rounding."""
    row = np.where(np.abs(row) > 1e-12 * max(np.abs(row).max(), 1e-300), row, 0.0)
    return np.trim_zeros(row, "f") if row.any() else np.zeros(1)
