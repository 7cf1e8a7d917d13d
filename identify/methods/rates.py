"""Linear regression on v, v', r, r' (8.43): differentiate the record, then least squares. Simple, and wrong on noisy records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array, alpha_from_y, line_force
from .common import Record, SixEstimate, balance, constant_tension, sway_velocity
from .least_squares import least_squares_svd

WARNING = (
    "regression on differentiated records: its standard deviations leave out the bias that noise in the regressors makes; "
    "Y_R, N_v and masses come out wrong by 30-110 % at 1 mm and 0.1 degree; use it on records of a rate gyro and accelerometer"
)
POLYNOMIAL = 4
"""Degree of the Savitzky-Golay filter: even, as the next odd one gives the same second derivative in the middle. A choice."""


@dataclass(frozen=True)
class Rates:
    """A record's smoothed state and rates.

    Attributes
    ----------
    t_s, y_m, beta_rad, v_m_s, r_rad_s, v_rate, r_rate : (n,), ends cut off by half a window
    white_gain : sd of the second derivative over the record's white noise, 1/s2
    """

    t_s: Array
    y_m: Array
    beta_rad: Array
    v_m_s: Array
    r_rad_s: Array
    v_rate: Array
    r_rate: Array
    white_gain: float


@dataclass(frozen=True)
class RatesEstimate(SixEstimate):
    """Result of ``regression_on_rates``: the six, and how well the regressors are told apart.

    Attributes
    ----------
    condition : condition numbers of the sway and of the yaw regression
    """

    condition: tuple[float, float] = (np.nan, np.nan)


def smooth_rates(record: Record, window_s: float) -> Rates:
    """Savitzky-Golay smoothing and derivatives (quartic over ``window_s``); v = y' - U beta, v' = y'' - U beta'.

    Parameters
    ----------
    record : evenly sampled
    window_s : of the filter, s

    Raises
    ------
    EstimationError : uneven samples, or a window shorter than six samples or longer than half the record
    """
    from scipy.signal import savgol_coeffs, savgol_filter

    step = record.step_s
    width = 2 * round(window_s / step / 2) + 1
    if width < POLYNOMIAL + 3 or width > len(record.t_s) // 2:
        raise EstimationError(
            f"a window of {window_s:g} s holds {width} of {len(record.t_s)} samples; "
            f"{POLYNOMIAL + 3} .. {len(record.t_s) // 2} are usable"
        )

    def derivative(values: Array, order: int) -> Array:
        return np.asarray(savgol_filter(values, width, POLYNOMIAL, deriv=order, delta=step))

    inside = slice(width // 2, len(record.t_s) - width // 2)
    y, y1, y2 = (derivative(record.y_m, k)[inside] for k in range(3))
    b, b1, b2 = (derivative(record.beta_rad, k)[inside] for k in range(3))
    gain = float(np.linalg.norm(savgol_coeffs(width, POLYNOMIAL, deriv=2, delta=step)))
    v, v_rate = sway_velocity(y1, b, record.tow), sway_velocity(y2, b1, record.tow)
    return Rates(record.t_s[inside], y, b, v, b1, v_rate, b2, gain)


def regression_on_rates(
    records: Sequence[Record],
    window_s: float,
    *,
    full_sine: bool = True,
    bias: bool = True,
    reference_speed_m_s: float | None = None,
) -> RatesEstimate:
    """Six derivatives by regression of the line's force on v', v, r (sway) and r', v, r (yaw) (8.43).

    Parameters
    ----------
    records : evenly sampled
    window_s : of the differentiating filter
    full_sine : sin(alpha + beta) with alpha from y and beta (2.10), or its linear form (2.17)
    bias : a constant in each equation of each record takes datum errors, Y* and N*
    reference_speed_m_s : at which the derivatives are quoted; default: the first record's. Other speeds share the primes.

    The covariance is that of least squares: it leaves out the regressors' noise. The note says so.
    """
    if not records:
        raise EstimationError("no record")
    speed = records[0].tow.speed_m_s if reference_speed_m_s is None else reference_speed_m_s
    sway, yaw, target_sway, target_yaw = [], [], [], []
    for index, record in enumerate(records):
        rates = smooth_rates(record, window_s)
        side, moment = _line(record, rates, full_sine)
        rows, right = balance(rates.v_rate, rates.r_rate, rates.v_m_s, rates.r_rad_s, side, moment)
        ratio = record.tow.speed_m_s / speed
        rows = rows * np.array([1, 1, ratio, ratio, ratio, ratio])
        own = np.zeros((len(side), len(records) if bias else 0))
        if bias:
            own[:, index] = 1.0
        sway.append(np.column_stack([rows[0][:, [0, 2, 3]], own]))
        yaw.append(np.column_stack([rows[1][:, [1, 4, 5]], own]))
        target_sway.append(right[0])
        target_yaw.append(right[1])
    found = [
        least_squares_svd(np.concatenate(a), np.concatenate(b)) for a, b in ((sway, target_sway), (yaw, target_yaw))
    ]
    six, covariance = np.zeros(6), np.zeros((6, 6))
    for least, places in zip(found, ([0, 2, 3], [1, 4, 5]), strict=True):
        six[places] = least.theta[:3]
        covariance[np.ix_(places, places)] = least.covariance[:3, :3]
    return RatesEstimate(six, covariance, (WARNING,), (found[0].condition, found[1].condition))


def _line(record: Record, rates: Rates, full_sine: bool) -> tuple[Array, Array]:
    tow = record.tow
    linear = (rates.y_m + tow.tow_point_m * rates.beta_rad) / tow.line_length_m + rates.beta_rad
    if full_sine:
        alpha = alpha_from_y(rates.y_m + tow.post_m[1], rates.beta_rad, tow)
        angle = alpha + rates.beta_rad
        sine, cosine = np.sin(angle), np.cos(angle)
    else:
        sine, cosine = linear, np.ones_like(linear)
    if not np.isfinite(sine).all():
        raise EstimationError("the record puts the tow point farther aside than the line reaches")
    return line_force(tow, constant_tension(tow), sine, cosine)
