"""Derivatives from complex amplitudes at two or more tow points: forced oscillation (5.23-5.28, 9.2), and the free pair.

Each amplitude pair (y, beta) at a complex rate s is two complex equations of motion, linear in the six derivatives.
With the post at rest and s = -l3 + i w the same equations take the pair of a decaying record: then no damping is neglected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array, Hull, Tow, line_force, linear_system
from .common import SixEstimate, balance, constant_tension, jacobian, sway_velocity

WORST_CONDITION = 1e8
"""Of the column-scaled equations: beyond it the tows do not tell the six apart."""


@dataclass(frozen=True)
class Swing:
    """One tow's answer at one complex rate.

    Attributes
    ----------
    tow : T, X_T, L, U
    rate : s, 1/s; i w for a forced swing, -l3 + i w for the free pair
    y_m, beta_rad : complex amplitudes of y_CG (from the post's mean place) and heading
    post_m : complex amplitude of the post, 0 where it stands still
    force_n : complex amplitude of a known lateral force at the tow point beside the line
    covariance : (4, 4), of (Re y, Im y, Re beta, Im beta), or (6, 6) with (Re s, Im s) behind; None = alike and unknown
    """

    tow: Tow
    rate: complex
    y_m: complex
    beta_rad: complex
    post_m: complex = 0.0
    covariance: Array | None = None
    force_n: complex = 0.0

    @property
    def alpha_rad(self) -> complex:
        """Amplitude of the tow line angle, (y_T - y_post)/L (2.10)."""
        return (self.y_m + self.tow.tow_point_m * self.beta_rad - self.post_m) / self.tow.line_length_m


def swing_from_alpha(tow: Tow, omega_rad_s: float, alpha: complex, beta: complex, post_m: complex) -> Swing:
    """A forced swing from alpha's and beta's amplitudes and phases (5.23, 5.28); all relative to one time origin.

    Parameters
    ----------
    tow : T, X_T, L, U of the tow
    omega_rad_s : w, rad/s
    alpha : complex amplitude, rad
    beta : complex amplitude, rad
    post_m : complex amplitude of the post's motion, m
    """
    return Swing(tow, 1j * omega_rad_s, tow.line_length_m * alpha - tow.tow_point_m * beta + post_m, beta, post_m)


def forced_response(hull: Hull, tow: Tow, omega_rad_s: float, post_m: complex = 1.0) -> Swing:
    """The steady linear answer to y_o = post_m e^(iwt) (3.11): solves (i w - A) x = -A_y y_o.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    omega_rad_s : w, rad/s
    post_m : complex amplitude of the post's motion, m
    """
    matrix, _ = linear_system(hull.at_speed(tow.speed_m_s), tow)
    state = np.linalg.solve(1j * omega_rad_s * np.eye(4) - matrix, -matrix[:, 0] * post_m)
    return Swing(tow, 1j * omega_rad_s, complex(state[0]), complex(state[1]), post_m)


def swing_equations(swing: Swing, values: Array | None = None) -> tuple[Array, Array]:
    """(rows (4, 6), right (4,)), real: sway Re, Im, yaw Re, Im of (5.26, 5.27).

    Parameters
    ----------
    swing : a forced swing
    values : (4,) or (6,), in the covariance's order, instead of the swing's own
    """
    y, beta, s, tow = swing.y_m, swing.beta_rad, swing.rate, swing.tow
    if values is not None:
        y, beta = complex(values[0], values[1]), complex(values[2], values[3])
        s = complex(values[4], values[5]) if len(values) == 6 else s
    pull = (y - swing.post_m + tow.tow_point_m * beta) / tow.line_length_m + beta
    side, moment = line_force(tow, constant_tension(tow), np.array([pull]), 0.0)
    side, moment = side + swing.force_n, moment + tow.tow_point_m * swing.force_n
    v = sway_velocity(np.array([s * y]), np.array([beta]), tow)
    r = np.array([s * beta])
    rows, right = balance(s * v, s * r, v, r, side, moment)
    rows, right = rows.reshape(2, 6), right.reshape(2)
    return (
        np.stack([rows[0].real, rows[0].imag, rows[1].real, rows[1].imag]),
        np.array([right[0].real, right[0].imag, right[1].real, right[1].imag]),
    )


def modal_derivatives(swings: Sequence[Swing], reference_speed_m_s: float | None = None) -> SixEstimate:
    """All six derivatives from complex amplitudes at two or more tow points (9.2); exact without noise.

    Parameters
    ----------
    swings : tows at different X_T; their T, L, U and rates may differ
    reference_speed_m_s : at which the derivatives are quoted; default: the first tow's. Other speeds share the primes.

    Raises
    ------
    EstimationError : one tow point only, or tows that do not tell the six apart

    Swings with a covariance are weighted by it (equation errors to first order, twice iterated); without, least squares on
    equations scaled by each tow's T (a0 + b0), and the covariance is from their residuals.
    """
    speed = swings[0].tow.speed_m_s if swings and reference_speed_m_s is None else reference_speed_m_s
    if len(swings) < 2 or speed is None or len({(w.tow.tow_point_m, w.tow.line_length_m, w.rate) for w in swings}) < 2:
        raise EstimationError("the six derivatives need swings at two or more tow points (5.26, 5.27)")
    factors = [np.array([1, 1, *4 * [w.tow.speed_m_s / speed]]) for w in swings]
    equations = [swing_equations(w) for w in swings]
    equations = [(rows * f, right) for (rows, right), f in zip(equations, factors, strict=True)]
    weighted = all(w.covariance is not None for w in swings)
    whiten = [np.eye(4) / np.linalg.norm(right[:2]) for _, right in equations]
    six = solve_six(equations, whiten)[0]
    for _ in range(3 if weighted else 0):
        whiten = [_whitener(w, six * f) for w, f in zip(swings, factors, strict=True)]
        six = solve_six(equations, whiten)[0]
    six, inverse, square = solve_six(equations, whiten)
    degrees = 4 * len(swings) - 6
    if not weighted:
        inverse = inverse * square / degrees
    return SixEstimate(six, inverse)


def _whitener(swing: Swing, six: Array) -> Array:
    """Inverse Cholesky factor of the equation errors' covariance at the derivatives ``six``."""
    assert swing.covariance is not None
    parts = np.array([swing.y_m, swing.beta_rad, swing.rate])
    values = np.column_stack([np.real(parts), np.imag(parts)]).ravel()[: len(swing.covariance)]

    def error(v: Array) -> Array:
        rows, right = swing_equations(swing, v)
        return rows @ six - right

    slope = jacobian(error, values, np.full(len(values), np.abs(values).max()))
    return np.linalg.inv(np.linalg.cholesky(slope @ swing.covariance @ slope.T))


def solve_six(equations: list[tuple[Array, Array]], whiten: list[Array]) -> tuple[Array, Array, float]:
    """Solve linear equations for the six derivatives by weighted least squares.

    Parameters
    ----------
    equations : of each tow: rows (k, 6) and right-hand side (k,)
    whiten : of each tow: (k, k), makes the errors of its equations independent and of unit variance

    Returns
    -------
    six, inverse, square : (6,) derivatives, (6, 6) their covariance, and the sum of squares that is left

    Raises
    ------
    EstimationError : the equations leave a direction open
    """
    rows = np.concatenate([w @ a for w, (a, _) in zip(whiten, equations, strict=True)])
    right = np.concatenate([w @ b for w, (_, b) in zip(whiten, equations, strict=True)])
    scale = np.linalg.norm(rows, axis=0)
    u, singular, vh = np.linalg.svd(rows / scale, full_matrices=False)
    if singular[-1] * WORST_CONDITION < singular[0]:
        raise EstimationError(
            f"the tows do not tell the six derivatives apart (condition {singular[0] / max(singular[-1], 1e-300):.1e}); "
            "choose tow points farther apart"
        )
    six = vh.T @ ((u.T @ right) / singular) / scale
    inverse = (vh.T / singular**2) @ vh / scale[:, None] / scale[None, :]
    rest = rows @ six - right
    return six, inverse, float(rest @ rest)


def frequency_dependence(groups: Sequence[Sequence[Swing]]) -> list[tuple[float, SixEstimate]]:
    """``modal_derivatives`` frequency by frequency (5.3): (w, derivatives), by rising w.

    Parameters
    ----------
    groups : each the swings of one frequency at two or more tow points
    """
    found = []
    for swings in groups:
        rates = {w.rate for w in swings}
        if len(rates) != 1:
            raise EstimationError(f"one group holds several rates: {sorted(abs(r) for r in rates)}")
        found.append((float(swings[0].rate.imag), modal_derivatives(swings)))
    return sorted(found, key=lambda pair: pair[0])
