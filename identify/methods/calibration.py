"""Calibration-error states (8.32-8.34, theory.md 9.8): scale and bias of a rate sensor against a position sensor.

    y_m = y + y_b,  dy_m = (1 + l) y' + d_b   ->   y_m(t) = y_m(0) + k Int(dy_m) - k d_b t,   k = 1/(1 + l)

A linear regression on [1, Int(dy_m), t]; the same for beta and a yaw rate gyro. y_b itself cannot be seen here, and of the two
scales only their ratio: a position sensor that reads 1 % long looks like a rate sensor that reads 1 % short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky

from ...record.errors import EstimationError
from ...record.results import Measured
from ...simulate.model import Array

MOST_SAMPLES = 4000
"""The rate's integrated noise is carried by a dense covariance."""


@dataclass(frozen=True)
class RateCalibration:
    """Result of ``calibrate_rate``.

    Attributes
    ----------
    scale_error : l, the rate sensor's relative scale error (over the position sensor's)
    rate_bias : d_b, in the rate's unit
    start : y_m(0) of the fit
    covariance : (3, 3), of (l, d_b, start)
    residual : (n,), measured position minus fitted
    chi2_per_dof : of the position residuals by the stated or estimated noise
    notes : for the user
    """

    scale_error: Measured
    rate_bias: Measured
    start: Measured
    covariance: Array
    residual: Array
    chi2_per_dof: float
    notes: tuple[str, ...]

    def corrected(self, rate: Array) -> Array:
        """The rate without its bias and scale error, (n,)."""
        return (np.asarray(rate) - self.rate_bias.value) / (1 + self.scale_error.value)


def calibrate_rate(
    t_s: Array, position: Array, rate: Array, *, position_sd: float | None = None, rate_sd: float = 0.0
) -> RateCalibration:
    """Scale error and bias of a measured rate (y' or beta') from the measured position over the same samples.

    Parameters
    ----------
    t_s, position, rate : (n,); times may be uneven
    position_sd : white noise of the position; None = from the residuals
    rate_sd : white noise of each rate sample; integrated it wanders, and the covariance holds it

    Raises
    ------
    EstimationError : fewer than 10 or more than 4000 samples, or a rate that never changes
    """
    t, y, dy = (np.asarray(x, dtype=float) for x in (t_s, position, rate))
    n = len(t)
    if not 10 <= n <= MOST_SAMPLES:
        raise EstimationError(f"{n} samples; 10 to {MOST_SAMPLES} are usable (thin the record)")
    if np.std(dy) < 1e-12 * max(np.abs(dy).max(), 1e-300) or not np.isfinite(np.concatenate([y, dy])).all():
        raise EstimationError("the rate never changes (or is not finite): scale and bias cannot be told apart")
    steps = np.diff(t)
    path = np.concatenate([[0.0], np.cumsum(steps * (dy[1:] + dy[:-1]) / 2)])
    rows = np.column_stack([np.ones(n), path, t - t[0]])
    sd = second_difference_sd(y) if position_sd is None else position_sd
    theta = np.linalg.lstsq(rows, y, rcond=None)[0]
    covariance = np.eye(n) * sd**2
    if rate_sd > 0:
        # Int(noise) at t_i: the trapezoid weights of the samples up to i, scaled by k
        weights = np.zeros((n, n))
        for i in range(1, n):
            weights[i] = weights[i - 1]
            weights[i, i - 1] += steps[i - 1] / 2
            weights[i, i] += steps[i - 1] / 2
        covariance = covariance + (theta[1] * rate_sd) ** 2 * weights @ weights.T
    factor = (cholesky(covariance, lower=True), True)
    solved = cho_solve(factor, rows)
    inverse = np.linalg.inv(rows.T @ solved)
    theta = inverse @ (solved.T @ y)
    residual = y - rows @ theta
    per_dof = float(residual @ cho_solve(factor, residual)) / (n - 3)
    if position_sd is None and rate_sd == 0.0:
        inverse = inverse * per_dof
    start, k, drift = theta
    # l = 1/k - 1, d_b = -drift/k
    slope = np.array([[0, -1 / k**2, 0], [0, drift / k**2, -1 / k], [1, 0, 0]])
    spread = slope @ inverse @ slope.T
    values = (1 / k - 1, -drift / k, start)
    scale_error, bias, first = (
        Measured(value=float(v), std=float(np.sqrt(spread[i, i]))) for i, v in enumerate(values)
    )
    notes = []
    if position_sd is not None and per_dof > 1 + 4 * np.sqrt(2 / (n - 3)):
        notes.append(
            f"chi-square per degree {per_dof:.2f}: position and rate do not belong together to within "
            "their noise (clock, other axis?)"
        )
    return RateCalibration(scale_error, bias, first, spread, residual, per_dof, tuple(notes))


def second_difference_sd(values: Array) -> float:
    """Estimate the white noise on a smooth course by its second differences, whose variance is six times the noise's.

    Parameters
    ----------
    values : (n,) evenly spaced

    Returns
    -------
    sd : at least the rounding of numbers so large
    """
    return float(max(np.std(np.diff(values, n=2)) / np.sqrt(6.0), 1e-12 * max(np.ptp(values), 1e-300)))
