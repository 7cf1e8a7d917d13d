"""From the roots of the characteristic equation (2.22) to the derivatives: four roots at two tow points (9.3), or only the pair
at three (appendix I, 9.4).

The equation itself and its stability (2.26) stand in ``simulate.characteristic``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.characteristic import characteristic_coefficients
from ...simulate.model import Array, Hull, Tow
from .common import SixEstimate, propagate, shared_tow

APPENDIX_WARNING = (
    "appendix I lives on second differences over three tow points: errors of 1e-4 in damping and frequency move l1 + l2 by 0.07 "
    "and l1 l2 by 0.09, 1e-3 makes it useless; prefer modal_derivatives or the joint fit"
)
USELESS_SHARE = 0.5
"""A standard deviation above this share of its value is reported as no value at all."""


def coefficients_from_roots(roots: Array) -> Array:
    """(b, c, d, e) of s^4 + b s^3 + c s^2 + d s + e, (4,) real, from four roots closed under conjugation.

    Parameters
    ----------
    roots : (4,) complex, 1/s

    Raises
    ------
    EstimationError : not four roots, or complex ones without their conjugates
    """
    roots = np.asarray(roots)
    if roots.shape != (4,):
        raise EstimationError(f"{roots.size} roots; the characteristic equation has four")
    polynomial = np.poly(roots)
    if np.abs(np.imag(polynomial)).max() > 1e-9 * np.abs(polynomial).max():
        raise EstimationError(f"the roots {roots} hold a complex one without its conjugate")
    return np.real(polynomial[1:])


def roots_from_coefficients(coefficients: Array, covariance: Array) -> tuple[Array, Array]:
    """Four roots of s^4 + b s^3 + .. + e and the sd of each as (real part, imaginary part), (4,) complex and (4, 2).

    To first order: d s = -(s^3 db + s^2 dc + s dd + de)/P'(s); near a double root it has no meaning.

    Parameters
    ----------
    coefficients : (4,), b, c, d, e
    covariance : (4, 4), theirs
    """
    polynomial = np.concatenate([[1.0], coefficients])
    roots = np.roots(polynomial)
    roots = roots[np.argsort(-roots.real)]
    slope = -(roots[:, None] ** np.arange(3, -1, -1)) / np.polyval(np.polyder(polynomial), roots)[:, None]
    parts = [np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", p, covariance, p), 0)) for p in (slope.real, slope.imag)]
    return roots, np.column_stack(parts)


def monic_coefficients(hull: Hull, tow: Tow) -> Array:
    """(b, c, d, e) = (B, C, D, E)/A of a known hull, (4,).

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    """
    full = characteristic_coefficients(hull.at_speed(tow.speed_m_s), tow)
    return full[1:] / full[0]


def derivatives_from_coefficients(
    first: Array, second: Array, tows: tuple[Tow, Tow], covariance: Array | None = None
) -> SixEstimate:
    """Six derivatives from (b, c, d, e) at two tow points (9.3).

    Parameters
    ----------
    first, second : (4,), monic coefficients at the two tow points
    tows : of one T, L, U and different X_T
    covariance : (8, 8), of (first, second); None = exact

    Raises
    ------
    EstimationError : the tow points or the coefficients are alike, or T, L, U differ
    """
    tension, length, speed = shared_tow(list(tows))
    x1, x2 = tows[0].tow_point_m, tows[1].tow_point_m
    if abs(x1 - x2) < 1e-6:
        raise EstimationError(f"both tow points are at {x1:g} m; (9.3) needs two different ones")
    if abs(first[1] - second[1]) < 1e-12 * abs(first[1]):
        raise EstimationError("c = C/A is the same at both tow points; (9.3) has no I'")

    def six(values: Array) -> Array:
        (b1, c1, d1, e1), (b2, c2, d2, e2) = values[:4], values[4:]
        eta = -length * (e1 - e2) / (tension * speed * (x1 - x2))
        nu = length * e1 / (tension * speed) + x1 * eta
        inertia = tension * (x1 - x2) * (x1 + x2 + length) / (length * (c1 - c2))

        def q(x: float, d: float) -> float:
            return length * (d / tension - nu + x * eta) - x * nu - speed * x / inertia + x**2 * eta

        q1, q2 = q(x1, d1), q(x2, d2)
        psi = (q1 - q2) / (x1 - x2)
        rho = x1 * psi - q1
        n_r = -inertia * ((b1 + b2) / 2 + eta * inertia)
        mass = n_r / (rho * inertia)
        product = mass * inertia
        return np.array([mass, inertia, eta * product, psi * product, nu * product, n_r])

    values = np.concatenate([first, second])
    found, spread = propagate(six, values, np.zeros((8, 8)) if covariance is None else covariance)
    notes = []
    if not np.isfinite(found).all() or found[0] <= 0 or found[1] <= 0:
        notes.append(
            f"m' = {found[0]:.4g}, I' = {found[1]:.4g}: both must be above 0; the coefficients are not good enough"
        )
    if abs(first[0] - second[0]) > 1e-3 * abs(first[0]) and covariance is None:
        notes.append(f"B/A is {first[0]:.4g} and {second[0]:.4g}, but must not depend on the tow point")
    share = np.sqrt(np.maximum(np.diag(spread), 0)) / np.abs(found)
    if (share > USELESS_SHARE).any():
        notes.append(
            f"standard deviations reach {100 * share.max():.0f} % of the values: these roots do not hold the derivatives"
        )
    return SixEstimate(found, spread, tuple(notes))


def derivatives_from_roots(
    first: Array, second: Array, tows: tuple[Tow, Tow], coefficient_covariance: Array | None = None
) -> SixEstimate:
    """``derivatives_from_coefficients`` of four roots each, (4,) complex.

    Parameters
    ----------
    first : (4,) complex, roots at the first tow point, 1/s
    second : the same at the second
    tows : the two, of one T, L, U
    coefficient_covariance : (8, 8), of the coefficients made from them, or None
    """
    return derivatives_from_coefficients(
        coefficients_from_roots(first), coefficients_from_roots(second), tows, coefficient_covariance
    )


@dataclass(frozen=True)
class AppendixOne:
    """Result of ``appendix_one``.

    Attributes
    ----------
    x, y : (3,), l1 + l2 and l1 l2 at the three tow points
    coefficients : (3, 4), monic (b, c, d, e)
    covariance : (6, 6), of (x, y)
    roots : (3, 4), complex: the two that were not seen, then the pair
    derivatives : SixEstimate from the outer two through (9.3); its I' is the assumed one
    warning : always given
    """

    x: Array
    y: Array
    coefficients: Array
    covariance: Array
    roots: Array
    derivatives: SixEstimate
    warning: str = APPENDIX_WARNING


def appendix_one(
    damping_per_s: Sequence[float],
    omega_rad_s: Sequence[float],
    tows: Sequence[Tow],
    inertia_kg_m2: float,
    sd: float | Array = 0.0,
    inertia_sd_kg_m2: float = 0.0,
) -> AppendixOne:
    """The two unseen roots from the pair -z +- i w at three equally spaced tow points (appendix I, 9.4).

    Parameters
    ----------
    damping_per_s, omega_rad_s : (3,), z (positive = decaying) and w at X1, X1 - dX, X1 - 2 dX
    tows : the three, of one T, L, U
    inertia_kg_m2 : I', assumed
    sd : of each z and w, 1/s, one number or (6,) for (z1, z2, z3, w1, w2, w3)
    inertia_sd_kg_m2 : standard deviation of I', kg m2

    Raises
    ------
    EstimationError : not three tow points at equal steps
    """
    tension, length, speed = shared_tow(list(tows))
    points = np.array([t.tow_point_m for t in tows])
    if len(points) != 3 or abs(points[0] - 2 * points[1] + points[2]) > 1e-6 or points[0] == points[1]:
        raise EstimationError(f"tow points {points} m: appendix I needs three at equal steps")
    step = points[0] - points[1]

    def unseen(values: Array) -> Array:
        z, w, inertia = values[:3], values[3:6], values[6]
        g = z**2 + w**2
        # x_i = x1 + x_0i, y_i = y1 + 2 (z1 - z_i) x1 + y_0i: all linear in (x1, y1); columns: x1, y1, constant
        x = np.column_stack([np.ones(3), np.zeros(3), 2 * (z[0] - z)])
        y = np.column_stack(
            [
                2 * (z[0] - z),
                np.ones(3),
                -4 * z * (z[0] - z)
                + g[0]
                - g
                + tension / (length * inertia) * (points - points[0]) * (points + points[0] + length),
            ]
        )
        d, e = 2 * z[:, None] * y + g[:, None] * x, g[:, None] * y
        equations = np.stack([e[0] - 2 * e[1] + e[2], d[0] - 2 * d[1] + d[2] - 2 * step / speed * (e[0] - e[1])])
        pair = np.append(np.linalg.solve(equations[:, :2], -equations[:, 2]), 1.0)
        return np.concatenate([x @ pair, y @ pair])

    def coefficients(values: Array) -> Array:
        z, w = values[:3], values[3:6]
        found = unseen(values)
        x, y, g = found[:3], found[3:], z**2 + w**2
        return np.column_stack([x + 2 * z, y + 2 * z * x + g, 2 * z * y + g * x, g * y])

    def six(values: Array) -> Array:
        table = coefficients(values)
        return derivatives_from_coefficients(table[0], table[2], (tows[0], tows[2])).six

    values = np.array([*damping_per_s, *omega_rad_s, inertia_kg_m2], dtype=float)
    covariance = np.diag(np.append(np.broadcast_to(sd, 6), inertia_sd_kg_m2) ** 2)
    found, spread = propagate(unseen, values, covariance)
    derivatives, six_spread = propagate(six, values, covariance)
    x, y = found[:3], found[3:]
    half = np.sqrt((x**2 / 4 - y).astype(complex))
    pair = -values[:3] + 1j * values[3:6]
    return AppendixOne(
        x=x,
        y=y,
        coefficients=coefficients(values),
        covariance=spread,
        roots=np.column_stack([-x / 2 + half, -x / 2 - half, pair, pair.conj()]),
        derivatives=SixEstimate(derivatives, six_spread, (APPENDIX_WARNING,)),
    )
