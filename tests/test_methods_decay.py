"""The decay fit (8.20) on records of known roots."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from towline.identify.decay_search import limits_of, strongest_rad_s
from towline.identify.methods.characteristic import derivatives_from_coefficients
from towline.identify.methods.decay import fit_decay
from towline.identify.methods.forced import modal_derivatives
from towline.identify.methods.phase import phase_from_amplitudes
from towline.record import EstimationError
from towline.simulate import Hull, Start, Tow, linear_system, simulate_linear, stability

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)
SIGMA = np.array([1e-3, np.radians(0.1)])


def tow(x_t: float) -> Tow:
    return Tow(1.28, 0.91, x_t, 3.96)


def record(x_t: float, t: np.ndarray, rng: np.random.Generator | None = None, y_0: float = 0.2):
    motion = simulate_linear(HULL, tow(x_t), Start(y_cg_m=y_0, beta_rad=0.03), t)
    values = motion[["y_cg_m", "beta_rad"]].to_numpy() + np.array([0.013, -0.021])
    return values if rng is None else values + SIGMA * rng.normal(size=values.shape)


@pytest.mark.parametrize("x_t", [1.446, 1.751, 2.2])
def test_an_exact_record_gives_its_roots_and_biases(x_t: float) -> None:
    t = 5.0 + np.arange(0, 60, 0.1)
    values = record(x_t, t)
    fit = fit_decay(t, values[:, 0], values[:, 1])
    truth = stability(HULL, tow(x_t)).roots
    np.testing.assert_allclose(np.sort_complex(fit.roots), np.sort_complex(truth), atol=1e-7)
    assert (fit.y_bias_m.value, fit.beta_bias_rad.value) == pytest.approx((0.013, -0.021), abs=1e-8)
    assert np.abs(fit.residual).max() < 1e-9
    assert fit.reached >= 2
    (c1, p1), (c3, p2) = fit.sines()
    rest = fit.theta[4] + fit.theta[5] * np.exp(-fit.theta[0] * 9) + fit.theta[6] * np.exp(-fit.theta[1] * 9)
    swing = np.exp(-fit.theta[2] * 9) * np.sin(fit.theta[3] * 9 + np.array([p1, p2])) * [c1, c3]
    assert rest + swing[0] == pytest.approx(values[90, 0], abs=1e-8)


def test_constraints_choose_the_sign_of_the_damping() -> None:
    t = np.arange(0, 60, 0.1)
    values = record(1.446, t, np.random.default_rng(1))  # l3 = -0.005: grows
    free = fit_decay(t, values[:, 0], values[:, 1])
    assert free.l3_per_s.value < 0
    grown = fit_decay(t, values[:, 0], values[:, 1], sign="unstable")
    assert grown.l3_per_s.value == pytest.approx(free.l3_per_s.value, abs=1e-6)
    held = fit_decay(t, values[:, 0], values[:, 1], sign="stable")
    assert held.l3_per_s.value > 0
    assert any("l3" in note and "edge" in note for note in held.notes)


def test_gaps_do_no_harm() -> None:
    t = np.arange(0, 60, 0.1)
    keep = np.ones(len(t), bool)
    keep[200:270] = False
    values = record(1.751, t)[keep]
    fit = fit_decay(t[keep], values[:, 0], values[:, 1])
    np.testing.assert_allclose(
        np.sort_complex(fit.roots), np.sort_complex(stability(HULL, tow(1.751)).roots), atol=1e-6
    )


@pytest.mark.slow
def test_intervals_of_damping_and_frequency_are_true_over_many_seeds() -> None:
    """30 records of 60 s: z of l3, w and the biases with std 1 within 4 standard errors and the noise model's 10 %."""
    rng = np.random.default_rng(2)
    t = np.arange(0, 60, 0.1)
    truth = stability(HULL, tow(1.751)).roots[0]
    wanted = np.array([-truth.real, abs(truth.imag), 0.013, -0.021])
    scores, spread = [], []
    for _ in range(30):
        values = record(1.751, t, rng)
        fit = fit_decay(t, values[:, 0], values[:, 1])
        at = [2, 3, 4, 9]
        scores.append((fit.theta[at] - wanted) / np.sqrt(np.diag(fit.covariance)[at]))
        spread.append(fit.theta[at])
    z = np.array(scores)
    assert (np.abs(z.std(axis=0) - 1) < 4 / np.sqrt(60) + 0.1).all(), z.std(axis=0)
    assert (np.abs(z.mean(axis=0)) < 4 / np.sqrt(30)).all(), z.mean(axis=0)
    # what such a record is worth: w to 0.1 %, l3 to 3e-4 per second
    assert np.std(spread, axis=0)[1] < 1e-3 * wanted[1]
    assert np.std(spread, axis=0)[0] < 4e-4


def test_the_reduced_form_is_enough_for_the_pair_once_the_start_is_past() -> None:
    """Cut 5 s off (l1 = 1.1: 0.4 % of it is left) and the reduced form finds the pair within its own errors."""
    t = np.arange(0, 60, 0.1)
    values = record(1.751, t, np.random.default_rng(3))
    later = t >= 5
    truth = stability(HULL, tow(1.751)).roots[0]
    fit = fit_decay(t[later], values[later, 0], values[later, 1], reduced=True)
    assert np.isnan(fit.l1_per_s.value)
    assert len(fit.roots) == 3
    assert abs(fit.l3_per_s.value + truth.real) < 4 * fit.l3_per_s.std
    assert abs(fit.omega_rad_s.value - abs(truth.imag)) < 4 * fit.omega_rad_s.std


def test_the_fitted_pair_feeds_the_phase_analysis_and_two_give_all_six() -> None:
    t = np.arange(0, 80, 0.1)
    fits = {}
    for x_t in (1.446, 2.0):
        values = record(x_t, t)
        fits[x_t] = fit_decay(t, values[:, 0], values[:, 1])
    found = modal_derivatives([fit.swing(tow(x)) for x, fit in fits.items()])
    np.testing.assert_allclose(found.six, SIX, rtol=1e-4)
    first, second = fits.values()
    roots = derivatives_from_coefficients(first.coefficients()[0], second.coefficients()[0], (tow(1.446), tow(2.0)))
    np.testing.assert_allclose(roots.six, SIX, rtol=1e-3)
    phase = phase_from_amplitudes(fits[1.446].amplitudes(), tow(1.446), SIX[1] / SIX[0])
    rates, vectors = np.linalg.eig(linear_system(HULL, tow(1.446))[0])
    at = int(np.argmax(rates.imag))
    ratio = complex(vectors[0, at] / vectors[1, at])
    assert phase.ratio_m == pytest.approx(-ratio.imag, rel=1e-6)
    assert phase.damping_share == pytest.approx(abs(ratio.real / ratio.imag), abs=1e-6)
    # a pair this far from quadrature costs the phase analysis 7 % of N_r: the damping it neglects
    assert phase.six[5] / SIX[5] == pytest.approx(1.0724, abs=5e-4)


def test_short_records_are_refused() -> None:
    with pytest.raises(EstimationError, match="at least 30"):
        fit_decay(np.arange(10.0), np.zeros(10), np.zeros(10))


@pytest.mark.parametrize("swings", [1.2, 4.0, 25.0])
def test_the_strongest_line_is_found_however_many_swings_there_are(swings: float) -> None:
    """Beside a drift and a bias, to the trial frequencies' step; a record of less than three quarters of a swing has none."""
    t = np.arange(0, 60, 0.05)
    w = 2 * np.pi * swings / 60
    values = np.column_stack([0.1 * np.cos(w * t + 0.3) + 0.2 + 0.01 * t, 0.02 * np.sin(w * t) - 0.1])
    step = (60 * np.pi / t[-1] - 1.5 * np.pi / t[-1]) / 159
    assert strongest_rad_s(t, values + 1e-4 * np.random.default_rng(1).normal(size=values.shape)) == pytest.approx(
        w, abs=step
    )


def test_a_fast_swing_in_a_long_record_is_fitted() -> None:
    """Twenty swings: far from where a search that began with one would end."""
    t = np.arange(0, 60, 0.05)
    l1, l2, l3, w = 1.5, 0.3, 0.02, 2 * np.pi / 3
    y = 0.2 * np.exp(-l3 * t) * np.sin(w * t + 0.4) + 0.05 * np.exp(-l2 * t) + 0.02 * np.exp(-l1 * t)
    beta = 0.05 * np.exp(-l3 * t) * np.cos(w * t) - 0.02 * np.exp(-l2 * t) + 0.03 * np.exp(-l1 * t)
    rng = np.random.default_rng(2)
    found = fit_decay(t, y + 1e-4 * rng.normal(size=len(t)), beta + 1e-4 * rng.normal(size=len(t)))
    assert found.omega_rad_s.value == pytest.approx(w, abs=5 * found.omega_rad_s.std)
    assert found.omega_rad_s.std < 1e-4
    assert found.l3_per_s.value == pytest.approx(l3, abs=5 * found.l3_per_s.std)


@pytest.mark.parametrize(
    ("sign", "damping"), [("stable", (1e-9 / 60, None)), ("unstable", (None, -1e-9 / 60)), ("free", (None, None))]
)
def test_what_a_search_may_reach_goes_with_the_records_length_and_rate(
    sign: Literal["stable", "unstable", "free"], damping: tuple[float | None, float | None]
) -> None:
    """Three quarters of a swing at the least, half of the Nyquist frequency at the most; the sign as it was asked for."""
    t = np.linspace(0, 60, 601)
    low, high = limits_of(t, False, sign)
    assert (low < high).all()
    assert (low[3], high[3]) == pytest.approx((1.5 * np.pi / 60, np.pi * 10 / 2))
    assert (low[0], high[0]) == (low[1], high[1])
    for end, value in zip((low[2], high[2]), damping, strict=True):
        assert value is None or end == pytest.approx(value)
    shorter = limits_of(t, True, sign)
    np.testing.assert_array_equal(shorter, (low[1:], high[1:]))
