"""Measured frequency responses, and the six derivatives fitted to them (2.37, 5.22, 8.31).

The outside input is the post's motion or a known lateral force at the tow point; y and beta answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array, Hull, Tow
from .common import SixEstimate, jacobian
from .forced import Swing, modal_derivatives
from .transfer import line_force_transfer, post_transfer

Input = Literal["post", "force"]
STEPS = 60
"""Levenberg-Marquardt steps at most; more are reported as no convergence."""
CONVERGED = 1e-8
"""Largest relative step of a derivative at which the fit stands."""
STUCK = 1e10
"""Damping beyond which no step can move anything: the fit stands."""


@dataclass(frozen=True)
class FrequencyResponse:
    """Measured (y, beta) over the input at some frequencies, one tow.

    Attributes
    ----------
    tow : T, X_T, L, U
    omega_rad_s : (n,)
    y, beta : (n,) complex, per m of post or per N of force
    sd_y, sd_beta : (n,), of real and of imaginary part each
    source : "post" or "force"
    """

    tow: Tow
    omega_rad_s: Array
    y: Array
    beta: Array
    sd_y: Array
    sd_beta: Array
    source: Input = "post"


def measure_response(
    t_s: Array, y_m: Array, beta_rad: Array, tow: Tow, inputs: Array, omega_rad_s: Array, source: Input = "post"
) -> FrequencyResponse:
    """Frequency response from one settled record that holds one or several sines at known frequencies.

    Parameters
    ----------
    t_s : (n,) times, s
    y_m : (n,) y_CG, m
    beta_rad : (n,) heading, rad
    tow : T, X_T, L, U of the tow
    inputs : (n,), y_o in m or the lateral force in N, taken as exact
    omega_rad_s : (k,), of the sines; all are fitted together with a constant and a trend
    source : what ``inputs`` are: "post" or "force"

    Raises
    ------
    EstimationError : two frequencies closer than one over the record's length, or an input without one of them
    """
    t = np.asarray(t_s) - t_s[0]
    omega = np.sort(np.asarray(omega_rad_s, dtype=float))
    spacing = 2 * np.pi / t[-1]
    if omega[0] < spacing or (np.diff(omega) < 0.99 * spacing).any():
        raise EstimationError(
            f"frequencies {np.round(omega, 4)} rad/s in {t[-1]:.1f} s: each and their steps must be at least {spacing:.3g} rad/s"
        )
    basis = np.column_stack(
        [np.ones_like(t), t / t[-1], *[f(w * t) for w in omega for f in (np.cos, lambda x: -np.sin(x))]]
    )
    inverse = np.linalg.inv(basis.T @ basis)
    found, sds = [], []
    for values in (inputs, y_m, beta_rad):
        theta = inverse @ basis.T @ values
        rest = values - basis @ theta
        sds.append(np.sqrt(float(rest @ rest) / max(len(t) - len(theta), 1) * np.diag(inverse)[2::2]))
        found.append(theta[2::2] + 1j * theta[3::2])
    given, y, beta = found
    weak = np.abs(given) < 1e-3 * np.abs(given).max()
    if weak.any():
        raise EstimationError(f"the input holds nothing at {omega[weak]} rad/s")
    size = np.abs(given)
    return FrequencyResponse(tow, omega, y / given, beta / given, sds[1] / size, sds[2] / size, source)


def model_response(hull: Hull, response: FrequencyResponse) -> Array:
    """(n, 2) complex (y, beta) of a hull at the response's frequencies.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    response : measured, with its tow
    """
    functions = (post_transfer if response.source == "post" else line_force_transfer)(hull, response.tow)
    s = 1j * response.omega_rad_s
    return np.column_stack([functions["y"](s), functions["beta"](s)])


def fit_frequency_response(
    responses: Sequence[FrequencyResponse], start: Array | None = None, reference_speed_m_s: float | None = None
) -> SixEstimate:
    """Six derivatives by weighted least squares on complex responses of one or more tows (Gauss-Newton with damping).

    Parameters
    ----------
    responses : of one hull
    start : (6,); default: least squares on the equations of motion at all frequencies (``modal_derivatives``)
    reference_speed_m_s : at which the derivatives are quoted; default: the first tow's

    Raises
    ------
    EstimationError : fewer than six real numbers, or no convergence from ``start``
    """
    if sum(4 * len(r.omega_rad_s) for r in responses) < 8:
        raise EstimationError("one frequency at one tow point holds four numbers; the six derivatives need two")
    speed = responses[0].tow.speed_m_s if reference_speed_m_s is None else reference_speed_m_s
    measured = np.concatenate([_real(np.column_stack([r.y, r.beta])) for r in responses])
    sd = np.concatenate([_real_sd(r) for r in responses])
    floor = 1e-12 * np.abs(measured).max()
    sd = np.maximum(sd, floor)
    if start is None:
        start = modal_derivatives([w for r in responses for w in _swings(r)], speed).six
    six = np.asarray(start, dtype=float)

    def predict(values: Array) -> Array:
        hull = Hull(*values, speed_m_s=speed)
        return np.concatenate([_real(model_response(hull, r)) for r in responses]) / sd

    target = measured / sd
    here = predict(six)
    damping = 1e-3
    for _ in range(STEPS):
        slope = jacobian(predict, six) * six
        normal = slope.T @ slope
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope.T @ (target - here))
        trial = six * (1 + step)
        there = predict(trial)
        if ((target - there) ** 2).sum() <= ((target - here) ** 2).sum():
            six, here, damping = trial, there, damping / 10
            if np.abs(step).max() < CONVERGED:
                break
        else:
            if np.abs(step).max() < CONVERGED:
                break
            damping *= 10
            if damping > STUCK:
                break
    else:
        raise EstimationError(f"no convergence in {STEPS} steps; give start values nearer to the hull")
    slope = jacobian(predict, six)
    covariance = np.linalg.inv(slope.T @ slope)
    chi2 = float(((target - here) ** 2).sum())
    degrees = len(target) - 6
    notes = (f"chi-square {chi2:.1f} of {degrees}",)
    if chi2 > degrees + 4 * np.sqrt(2 * degrees):
        notes += (
            "the responses differ from the linear model by more than their errors: amplitudes too large, or derivatives that "
            "depend on frequency",
        )
        covariance = covariance * chi2 / degrees
    return SixEstimate(six, covariance, notes)


def _swings(response: FrequencyResponse) -> list[Swing]:
    post, force = (1.0, 0.0) if response.source == "post" else (0.0, 1.0)
    return [
        Swing(response.tow, 1j * float(w), complex(y), complex(b), post, None, force)
        for w, y, b in zip(response.omega_rad_s, response.y, response.beta, strict=True)
    ]


def _real(values: Array) -> Array:
    """(n, 2) complex as a real vector: Re y, Im y, Re beta, Im beta of each frequency."""
    return np.stack([np.real(values), np.imag(values)], axis=2).ravel()


def _real_sd(response: FrequencyResponse) -> Array:
    return np.column_stack([response.sd_y, response.sd_y, response.sd_beta, response.sd_beta]).ravel()
