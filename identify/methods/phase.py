"""Phase analysis with its errors (8.4, 8.7-8.9), and its complex form that says how much damping it neglects (9.11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array, Tow
from ..analytic import phase_analysis
from .common import SixEstimate, constant_tension, covariance_of, propagate

LARGEST_DAMPING_SHARE = 0.02
"""Beyond this |Re/Im| derivatives are off by 4 % (N_r) to 10 % (N_v) on the ITTC hull: as much as the thesis's runs scatter."""


@dataclass(frozen=True)
class PhaseEstimate(SixEstimate):
    """Result of ``phase_derivatives`` and ``phase_from_amplitudes``.

    Attributes
    ----------
    ratio_m, ratio_sd_m : y0/b0
    damping_share : |Re(Y/B)/Im(Y/B)|, 0 in pure quadrature; NaN where only the ratio is known
    """

    ratio_m: float = np.nan
    ratio_sd_m: float = np.nan
    damping_share: float = np.nan


@dataclass(frozen=True)
class Amplitudes:
    """Complex amplitudes of y and beta at one complex rate: y = Re(y_amplitude e^(s t)) + y_b.

    Attributes
    ----------
    rate : s, 1/s; i w for a steady swing
    y_m, beta_rad : complex, at t_s[0]
    covariance : (4, 4), of (Re y, Im y, Re beta, Im beta), from the residuals taken as white
    y_bias_m, beta_bias_rad : the constants
    """

    rate: complex
    y_m: complex
    beta_rad: complex
    covariance: Array
    y_bias_m: float
    beta_bias_rad: float


def complex_amplitudes(t_s: Array, y_m: Array, beta_rad: Array, rate: complex) -> Amplitudes:
    """Least-squares complex amplitudes of (y, beta) at a known complex rate s, with a constant in each channel.

    Parameters
    ----------
    t_s : (n,) times, s
    y_m : (n,) y_CG, m
    beta_rad : (n,) heading, rad
    rate : s = damping + i w, 1/s
    """
    t = np.asarray(t_s) - t_s[0]
    wave = np.exp(rate * t)
    basis = np.column_stack([wave.real, -wave.imag, np.ones_like(t)])
    inverse = np.linalg.inv(basis.T @ basis)
    found, covariance = [], np.zeros((4, 4))
    for channel, values in enumerate((y_m, beta_rad)):
        theta = inverse @ basis.T @ values
        rest = values - basis @ theta
        at = slice(2 * channel, 2 * channel + 2)
        covariance[at, at] = inverse[:2, :2] * float(rest @ rest) / max(len(t) - 3, 1)
        found.append(theta)
    return Amplitudes(
        rate,
        complex(*found[0][:2]),
        complex(*found[1][:2]),
        covariance,
        float(found[0][2]),
        float(found[1][2]),
    )


def phase_derivatives(
    omega_rad_s: float,
    ratio_m: float,
    tow: Tow,
    k2_m2: float,
    *,
    omega_sd_rad_s: float = 0.0,
    ratio_sd_m: float = 0.0,
    tension_sd_n: float = 0.0,
    k2_sd_m2: float = 0.0,
) -> PhaseEstimate:
    """Six derivatives from w, y0/b0 and K^2 of one lightly damped swing (8.4, 8.8, 8.9), errors propagated.

    Parameters
    ----------
    omega_rad_s : w, rad/s
    ratio_m : y0/b0 of y = -y0 cos wt, beta = b0 sin wt, m/rad, positive
    tow : T, X_T, L, U
    k2_m2 : K^2 = I'/m', m2
    omega_sd_rad_s : standard deviation of w
    ratio_sd_m : of y0/b0
    tension_sd_n : of T
    k2_sd_m2 : of K^2

    Raises
    ------
    EstimationError : w y0/b0 = U, where (8.4) has no value, or no tension

    The standard deviations hold the inputs' errors only. The closure (8.8) itself is off on the ITTC hull by +4 to -1 % in w,
    that is +9 to -2 % in m' and I' (X_T 1.446 to 1.751 m), and Y_R, N_v follow it.
    """
    tension = constant_tension(tow)
    sway = omega_rad_s * ratio_m - tow.speed_m_s
    if abs(sway) < 1e-6 * tow.speed_m_s:
        raise EstimationError(f"w y0/b0 = {omega_rad_s * ratio_m:.4g} m/s equals U; (8.4) has no value there")

    def six(values: Array) -> Array:
        return phase_analysis(
            values[0], values[1], values[2], tow.tow_point_m, tow.line_length_m, tow.speed_m_s, values[3]
        )

    values = np.array([omega_rad_s, ratio_m, tension, k2_m2])
    found, covariance = propagate(six, values, covariance_of((omega_sd_rad_s, ratio_sd_m, tension_sd_n, k2_sd_m2)))
    return PhaseEstimate(found, covariance, (), ratio_m, ratio_sd_m)


def phase_from_amplitudes(
    amplitudes: Amplitudes, tow: Tow, k2_m2: float, *, omega_sd_rad_s: float = 0.0, tension_sd_n: float = 0.0
) -> PhaseEstimate:
    """Phase analysis from complex amplitudes: y0/b0 = -Im(Y/B), and |Re/Im| of Y/B as the damping neglected (9.11).

    For y = -y0 cos wt, beta = b0 sin wt: Y = -y0, B = -i b0, so Y/B = -i y0/b0.

    Parameters
    ----------
    amplitudes : of y and beta, from ``complex_amplitudes``
    tow : T, X_T, L, U of the tow
    k2_m2 : K^2 = I'/m', m2
    omega_sd_rad_s : standard deviation of w
    tension_sd_n : of T
    """

    def parts(values: Array) -> Array:
        quotient = complex(values[0], values[1]) / complex(values[2], values[3])
        return np.array([-quotient.imag, quotient.real])

    y, b = amplitudes.y_m, amplitudes.beta_rad
    (ratio, real), covariance = propagate(parts, np.array([y.real, y.imag, b.real, b.imag]), amplitudes.covariance)
    if ratio <= 0:
        raise EstimationError(
            f"y/beta = {real:.3g} {-ratio:+.3g}i; a tow's swing has y a quarter period behind beta: is a sign or a pairing wrong?"
        )
    ratio_sd = float(np.sqrt(covariance[0, 0]))
    plain = phase_derivatives(
        amplitudes.rate.imag,
        float(ratio),
        tow,
        k2_m2,
        omega_sd_rad_s=omega_sd_rad_s,
        ratio_sd_m=ratio_sd,
        tension_sd_n=tension_sd_n,
    )
    share = float(abs(real / ratio))
    notes = ()
    if share > LARGEST_DAMPING_SHARE:
        notes = (
            f"|Re/Im| of y/beta is {share:.2f}, above {LARGEST_DAMPING_SHARE:g}: this swing is not in quadrature, the neglected "
            "damping biases the derivatives; use modal_derivatives with a second tow point, or the joint fit",
        )
    return PhaseEstimate(plain.six, plain.covariance, notes, float(ratio), ratio_sd, share)
