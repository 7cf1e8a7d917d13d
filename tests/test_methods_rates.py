"""Regression on differentiated records (8.43): exact on exact rates, and how wrong it is on noisy ones."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.methods.common import Record
from towline.identify.methods.rates import WARNING, regression_on_rates, smooth_rates
from towline.record import EstimationError
from towline.simulate import Hull, Start, Tow, simulate_full, simulate_linear

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)
T = np.arange(0, 40, 0.05)


def record(x_t: float, y_0: float, rng: np.random.Generator | None = None) -> Record:
    tow = Tow(1.28, 0.91, x_t, 3.96)
    motion = simulate_full(HULL, tow, Start(y_cg_m=y_0), T)
    y, beta = motion["y_cg_m"].to_numpy(), motion["beta_rad"].to_numpy()
    if rng is not None:
        y, beta = y + rng.normal(0, 1e-3, len(T)), beta + rng.normal(0, np.radians(0.1), len(T))
    return Record(T, y, beta, tow)


def test_the_rates_are_the_simulators() -> None:
    """A quartic over 0.5 s errs by the sixth derivative: below 1e-5 of these motions (v to 1e-3, it takes in v' u-terms)."""
    one = record(1.649, 0.1)
    motion = simulate_full(HULL, one.tow, Start(y_cg_m=0.1), T)
    rates = smooth_rates(one, 0.5)
    inside = np.isin(T, rates.t_s)
    np.testing.assert_allclose(rates.r_rad_s, motion["r_rad_s"][inside], atol=1e-6)
    # v = y' - U beta is the linear kinematics: off by the cubes of the angles
    np.testing.assert_allclose(rates.v_m_s, motion["v_m_s"][inside], atol=2e-3)
    np.testing.assert_allclose(rates.r_rate, np.gradient(motion["r_rad_s"], T)[inside], atol=2e-4)


def test_exact_records_give_the_derivatives() -> None:
    """Small motion (5 cm): the linear kinematics err by the angles' cubes, 0.24 % of the weakest derivative."""
    found = regression_on_rates([record(1.446, 0.05), record(1.751, -0.05)], 0.6)
    np.testing.assert_allclose(found.six, SIX, rtol=0.005)
    assert found.notes == (WARNING,)
    assert max(found.condition) < 100


def test_the_warning_is_true() -> None:
    """1 mm and 0.1 degree at 20 Hz, one tow, three windows: one derivative is wrong by 85 to 120 %; the stated errors miss it.

    No window helps: a short one lets the noise in, a long one bends the motion.
    """
    rng = np.random.default_rng(3)
    worst, z = {}, {}
    for window in (0.6, 1.5, 3.0):
        gaps, scores = [], []
        for _ in range(8):
            found = regression_on_rates([record(1.649, 0.2, rng)], window)
            gaps.append(np.abs(found.six / SIX - 1))
            scores.append(np.abs(found.six - SIX) / found.sd)
        worst[window] = float(np.median(np.max(gaps, axis=1)))
        z[window] = float(np.median(np.max(scores, axis=1)))
    assert all(0.85 < w < 1.2 for w in worst.values()), worst
    assert all(s > 4 for s in z.values()), z


def test_refusals() -> None:
    one = record(1.649, 0.1)
    with pytest.raises(EstimationError, match="a window of"):
        regression_on_rates([one], 0.1)
    with pytest.raises(EstimationError, match="no record"):
        regression_on_rates([], 1.0)
    with pytest.raises(EstimationError, match="farther aside"):
        regression_on_rates([Record(T, one.y_m * 30, one.beta_rad, one.tow)], 0.6)


def test_the_linear_line_is_enough_for_small_angles_and_not_for_large_ones() -> None:
    """A motion of the linear form is exact with the linear line force; of the full form, 5 cm aside, both are as good."""
    tow = Tow(1.28, 0.91, 1.446, 3.96)
    records = []
    for x_t, y_0 in ((1.446, 0.3), (1.751, -0.3)):
        tow = Tow(1.28, 0.91, x_t, 3.96)
        motion = simulate_linear(HULL, tow, Start(y_cg_m=y_0), T)
        records.append(Record(T, motion["y_cg_m"].to_numpy(), motion["beta_rad"].to_numpy(), tow))
    exact = regression_on_rates(records, 0.6, full_sine=False)
    np.testing.assert_allclose(exact.six, SIX, rtol=2e-3)
    sine = regression_on_rates(records, 0.6)
    assert np.abs(sine.six / SIX - 1).max() > 5 * np.abs(exact.six / SIX - 1).max()
    calm = regression_on_rates([record(1.446, 0.05), record(1.751, -0.05)], 0.6, full_sine=False)
    np.testing.assert_allclose(calm.six, SIX, rtol=0.02)
