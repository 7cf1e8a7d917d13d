"""Rate sensors with known scale error and bias (8.32-8.34)."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.methods.calibration import calibrate_rate, second_difference_sd
from towline.record import EstimationError
from towline.simulate import Hull, Start, Tow, simulate_full

HULL = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)
T = np.arange(0, 40, 0.05)
MOTION = simulate_full(HULL, Tow(1.28, 0.91, 1.751, 3.96), Start(y_cg_m=0.2), T)
BETA, RATE = MOTION["beta_rad"].to_numpy(), MOTION["r_rad_s"].to_numpy()
SCALE, BIAS = 0.03, 0.002


def test_an_exact_gyro_is_calibrated_exactly() -> None:
    """Trapezoid integration at 20 Hz: h^2/12 of the rate's second derivative, some 1e-5 of the scale."""
    found = calibrate_rate(T, BETA + 0.01, (1 + SCALE) * RATE + BIAS)
    assert found.scale_error.value == pytest.approx(SCALE, abs=2e-4)
    assert found.rate_bias.value == pytest.approx(BIAS, abs=2e-6)
    np.testing.assert_allclose(found.corrected((1 + SCALE) * RATE + BIAS), RATE, atol=2e-5)


@pytest.mark.parametrize("rate_sd", [0.0, 0.002])
def test_intervals_are_true_over_many_seeds(rate_sd: float) -> None:
    """100 records with 0.1 degree in beta and 0 or 0.002 rad/s in the gyro: z within 4 standard errors and 5 %.

    With gyro noise the errors wander, and the dense covariance carries that.
    """
    rng = np.random.default_rng(1)
    sd = np.radians(0.1)
    keep = slice(None, None, 2)
    z = []
    for _ in range(100):
        beta = BETA + rng.normal(0, sd, len(T))
        rate = (1 + SCALE) * RATE + BIAS + rate_sd * rng.normal(size=len(T))
        found = calibrate_rate(T[keep], beta[keep], rate[keep], position_sd=sd, rate_sd=rate_sd)
        assert not found.notes
        z.append(
            [
                (found.scale_error.value - SCALE) / found.scale_error.std,
                (found.rate_bias.value - BIAS) / found.rate_bias.std,
            ]
        )
    assert (np.abs(np.std(z, axis=0) - 1) < 4 / np.sqrt(200) + 0.05).all(), np.std(z, axis=0)
    assert (np.abs(np.mean(z, axis=0)) < 4 / np.sqrt(100) + 0.1).all(), np.mean(z, axis=0)


def test_only_the_ratio_of_the_scales_is_seen() -> None:
    """A position sensor 2 % long and a true gyro: the gyro looks 2 % short."""
    found = calibrate_rate(T, 1.02 * BETA, RATE)
    assert found.scale_error.value == pytest.approx(1 / 1.02 - 1, abs=2e-4)


def test_a_wrong_clock_is_noticed_and_bad_records_are_refused() -> None:
    sd = 1e-4
    late = np.interp(T - 0.5, T, RATE)
    assert "do not belong together" in calibrate_rate(T, BETA, late, position_sd=sd).notes[0]
    with pytest.raises(EstimationError, match="never changes"):
        calibrate_rate(T, BETA, np.ones_like(T))
    with pytest.raises(EstimationError, match="5 samples"):
        calibrate_rate(T[:5], BETA[:5], RATE[:5])


@pytest.mark.parametrize("rate_sd", [0.0, 0.002])
def test_the_covariance_of_scale_bias_and_start_is_that_of_weighted_least_squares(rate_sd: float) -> None:
    """Of 1000 drawn records, within 4 standard errors of a standard deviation and of a correlation."""
    keep, sd = slice(0, 100, 2), 1e-4  # 5 s: scale and bias are hardly told apart
    t, beta, rate = T[keep], BETA[keep], (1 + SCALE) * RATE[keep] + BIAS
    found = calibrate_rate(t, beta, rate, position_sd=sd, rate_sd=rate_sd)
    rng = np.random.default_rng(6)
    drawn = []
    for _ in range(1000):
        noisy = rate + rate_sd * rng.normal(size=len(t))
        one = calibrate_rate(t, beta + sd * rng.normal(size=len(t)), noisy, position_sd=sd, rate_sd=rate_sd)
        drawn.append([one.scale_error.value, one.rate_bias.value, one.start.value])
    scale = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(np.std(drawn, axis=0) / scale, 1, atol=4 / np.sqrt(2000) + 0.02)
    told = found.covariance / np.outer(scale, scale)
    np.testing.assert_allclose(np.corrcoef(np.transpose(drawn)), told, atol=4 / np.sqrt(1000))
    # the start from which the path is reckoned goes with the drift, and so against the bias
    late = calibrate_rate(t + 30.0, beta, rate, position_sd=sd, rate_sd=rate_sd).covariance
    np.testing.assert_allclose(late, found.covariance, rtol=1e-6)


def test_noise_of_a_smooth_course_is_told_by_its_second_differences() -> None:
    """6 sigma^2 is their variance; a straight line has none but rounding."""
    rng, t = np.random.default_rng(7), np.arange(4000) / 100
    found = second_difference_sd(0.3 * np.sin(t) + rng.normal(0, 1e-3, 4000))
    assert found == pytest.approx(1e-3, rel=4 / np.sqrt(2 * 4000 / 2.5))
    line = second_difference_sd(1 + 2 * t)
    assert line > 1e-12 * 79.9
    assert line < 1e-10
