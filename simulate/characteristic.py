"""The characteristic equation of the towed model and its verdict (2.22, 2.26)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .model import Array, Hull, Tow


@dataclass(frozen=True)
class Stability:
    """Verdict on a tow.

    Attributes
    ----------
    coefficients : (5,), A..E of A s^4 + B s^3 + C s^2 + D s + E (2.22)
    roots : (4,), complex, 1/s, by falling real part
    stable : A..E of one sign and B C D - A D^2 - B^2 E > 0 (2.26)
    sentence : the verdict with the numbers that decide it
    """

    coefficients: Array
    roots: np.ndarray
    stable: bool
    sentence: str


def characteristic_coefficients(hull: Hull, tow: Tow) -> Array:
    """A, B, C, D, E of (2.22), (5,); cross added masses are left out as in the thesis.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    """
    if tow.tension_n is None:
        raise ValueError("the characteristic equation needs a constant tension_n")
    m, i, y_v, y_r, n_v, n_r = hull.six
    tension, length, x_t, speed = tow.tension_n, tow.line_length_m, tow.tow_point_m, tow.speed_m_s
    return np.array(
        [
            m * i,
            -(i * y_v + m * n_r),
            y_v * n_r - n_v * y_r + tension / length * (i + m * x_t**2 + m * x_t * length),
            tension * (n_v - x_t * y_v + (-n_r + x_t * n_v + x_t * y_r + speed * x_t * m - x_t**2 * y_v) / length),
            tension * speed / length * (n_v - x_t * y_v),
        ]
    )


def stability(hull: Hull, tow: Tow) -> Stability:
    """Judge a tow of ``hull`` (at the tow's speed).

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    """
    coefficients = characteristic_coefficients(hull, tow)
    a, b, c, d, e = coefficients
    roots = np.roots(coefficients)
    roots = roots[np.argsort(-roots.real)]
    routh = b * c * d - a * d**2 - b**2 * e
    one_sign = bool((coefficients > 0).all() or (coefficients < 0).all())
    stable = one_sign and routh > 0
    if tow.tow_point_m <= hull.x_v_m:
        sentence = (
            f"unstable: tow_point_m = {tow.tow_point_m:.3f} is not ahead of X_v = {hull.x_v_m:.3f} m; "
            "the model shears off to one side"
        )
    elif stable:
        sentence = f"stable: tow_point_m = {tow.tow_point_m:.3f} is ahead of X_v = {hull.x_v_m:.3f} m, Routh sum {routh:.4g} > 0"
    elif not one_sign:
        sentence = (
            f"unstable: the coefficients A..E = {', '.join(f'{x:.4g}' for x in coefficients)} are not of one sign"
        )
    else:
        sentence = f"unstable: a growing oscillation, B C D - A D^2 - B^2 E = {routh:.4g} is not above 0"
    pair = roots[np.abs(roots.imag) > 1e-12]
    if len(pair):
        sentence += f"; it oscillates at {abs(pair[0].imag):.4f} rad/s with damping {-pair[0].real:+.4f} 1/s"
    return Stability(coefficients, roots, stable, sentence)
