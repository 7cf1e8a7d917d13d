"""Phase analysis, forced oscillation and the free pair: against closed forms and the simulator."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.methods.common import balance
from towline.identify.methods.forced import (
    Swing,
    forced_response,
    frequency_dependence,
    modal_derivatives,
    solve_six,
    swing_from_alpha,
)
from towline.identify.methods.phase import (
    Amplitudes,
    complex_amplitudes,
    phase_derivatives,
    phase_from_amplitudes,
)
from towline.record import EstimationError
from towline.simulate import Hull, Start, Tow, linear_system, simulate_full, simulate_linear
from towline.simulate.model import sway_yaw_acceleration

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)
K2 = SIX[1] / SIX[0]
POINTS_M = (1.446, 1.548, 1.649, 1.751)
ROUNDING = 1e-9


def tow(x_t: float, **more) -> Tow:
    return Tow(1.28, 0.91, x_t, 3.96, **more)


def pair(x_t: float) -> tuple[complex, np.ndarray]:
    """The oscillating pair's rate and eigenvector (y, beta, v, r), scaled to beta = 1."""
    matrix, _ = linear_system(HULL, tow(x_t))
    rates, vectors = np.linalg.eig(matrix)
    at = int(np.argmax(rates.imag))
    return complex(rates[at]), vectors[:, at] / vectors[1, at]


def test_the_balance_is_the_simulators_equation() -> None:
    rng = np.random.default_rng(1)
    v, r, side, moment = rng.normal(size=(4, 5))
    v_rate, r_rate = sway_yaw_acceleration(HULL, v, r, side, moment)
    rows, right = balance(v_rate, r_rate, v, r, side, moment)
    np.testing.assert_allclose(rows @ SIX, right, atol=1e-12)


def test_the_hull_that_phase_analysis_gives_swings_as_measured() -> None:
    """(8.4) is exact for an undamped swing in quadrature: its hull has the pair +-i w with y = -i (y0/b0) beta."""
    six = phase_derivatives(0.37, 2.85, tow(1.649), K2).six
    rates, vectors = np.linalg.eig(linear_system(HULL.with_six(six), tow(1.649))[0])
    at = int(np.argmin(np.abs(rates - 0.37j)))
    assert rates[at] == pytest.approx(0.37j, abs=1e-10)
    assert vectors[0, at] / vectors[1, at] == pytest.approx(-2.85j, abs=1e-8)


def test_phase_analysis_at_zero_damping_errs_by_what_is_not_in_quadrature() -> None:
    """At zero damping y/beta = a - i c still has a real part a; then (8.4)'s N_r is off by exactly N_v a: 0.16 % on this hull."""
    from scipy.optimize import brentq

    still = brentq(lambda x: pair(x)[0].real, 1.5, 1.8)
    rate, vector = pair(still)
    assert abs(rate.real) < 1e-10
    found = phase_derivatives(rate.imag, -vector[0].imag, tow(still), K2).six
    assert found[5] - SIX[5] == pytest.approx(SIX[4] * vector[0].real, rel=1e-6)
    assert abs(found[5] / SIX[5] - 1) == pytest.approx(0.00163, abs=1e-5)
    # (8.8) is empirical: the masses are off by up to 4 %
    np.testing.assert_allclose(found[:2], SIX[:2], rtol=0.04)


def test_complex_amplitudes_and_the_damping_share() -> None:
    """|Re/Im| is the pair's own: measured on a simulated record against the eigenvector."""
    x_t = 2.2
    rate, vector = pair(x_t)
    start = 0.1 * vector.real
    t = np.arange(0, 30, 0.1)
    motion = simulate_linear(
        HULL, tow(x_t), Start(beta_rad=start[1], v_m_s=start[2], r_rad_s=start[3], y_cg_m=start[0]), t
    )
    found = complex_amplitudes(t, motion["y_cg_m"].to_numpy() + 0.01, motion["beta_rad"].to_numpy() - 0.02, rate)
    assert found.y_m / found.beta_rad == pytest.approx(vector[0], rel=ROUNDING)
    assert (found.y_bias_m, found.beta_bias_rad) == pytest.approx((0.01, -0.02), abs=1e-12)
    result = phase_from_amplitudes(found, tow(x_t), K2)
    expected = abs(vector[0].real / vector[0].imag)
    assert result.damping_share == pytest.approx(expected, rel=1e-8)
    assert expected > 0.1
    assert "|Re/Im|" in result.notes[0]
    assert not phase_from_amplitudes(Amplitudes(0.37j, -0.3, -0.1j, np.zeros((4, 4)), 0, 0), tow(1.7), K2).notes


def test_phase_errors_propagate_as_sampling_says() -> None:
    """20 000 draws of w and y0/b0 with 0.2 % and 0.5 %: sds agree within 4 standard errors and 1 % of curvature."""
    from towline.identify import phase_analysis

    result = phase_derivatives(0.37, 2.85, tow(1.649), K2, omega_sd_rad_s=7e-4, ratio_sd_m=0.014, tension_sd_n=0.02)
    rng = np.random.default_rng(2)
    draws = [
        phase_analysis(w, q, t, 1.649, 0.91, 1.28, K2)
        for w, q, t in zip(rng.normal(0.37, 7e-4, 20000), rng.normal(2.85, 0.014, 20000), rng.normal(3.96, 0.02, 20000))
    ]
    np.testing.assert_allclose(np.std(draws, axis=0) / result.sd, 1.0, atol=4 / np.sqrt(40000) + 0.01)
    with pytest.raises(EstimationError, match="equals U"):
        phase_derivatives(0.4, 3.2, tow(1.6), K2)
    with pytest.raises(EstimationError, match="quarter period"):
        phase_from_amplitudes(Amplitudes(0.37j, 0.3, -0.1j, np.zeros((4, 4)), 0, 0), tow(1.7), K2)


def test_forced_response_solves_the_two_by_two_system() -> None:
    """The linear system of theory.md 9.2, retyped here as the independent form."""
    m, i, y_v, y_r, n_v, n_r = SIX
    w, x, length, t, u = 0.8, 1.6, 0.91, 3.96, 1.28
    matrix = np.array(
        [
            [
                t - m * length * w**2 - 1j * w * length * y_v,
                t + u * y_v + m * x * w**2 + 1j * w * (x * y_v - y_r - m * u),
            ],
            [t * x - 1j * w * length * n_v, t * x + u * n_v - i * w**2 + 1j * w * (x * n_v - n_r)],
        ]
    )
    alpha, beta = np.linalg.solve(matrix, [m * w**2 + 1j * w * y_v, 1j * w * n_v])
    found = forced_response(HULL, tow(x), w)
    assert found.alpha_rad == pytest.approx(alpha, rel=ROUNDING)
    assert found.beta_rad == pytest.approx(beta, rel=ROUNDING)
    again = swing_from_alpha(tow(x), w, alpha, beta, 1.0)
    assert again.y_m == pytest.approx(found.y_m, rel=ROUNDING)


@pytest.mark.parametrize("frequency_hz", [0.02, 0.05, 0.1, 0.2, 0.4])
def test_two_tow_points_give_all_six_exactly(frequency_hz: float) -> None:
    w = 2 * np.pi * frequency_hz
    found = modal_derivatives([forced_response(HULL, tow(x), w, 0.03 + 0.01j) for x in (1.446, 1.751)])
    np.testing.assert_allclose(found.six, SIX, rtol=1e-8)
    assert (found.sd < 1e-6 * np.abs(SIX)).all()


def test_the_free_pair_at_two_tow_points_gives_all_six_exactly() -> None:
    swings = [Swing(tow(x), *_mode(x)) for x in (1.446, 2.0)]
    np.testing.assert_allclose(modal_derivatives(swings).six, SIX, rtol=1e-7)


def _mode(x_t: float) -> tuple[complex, complex, complex]:
    rate, vector = pair(x_t)
    return rate, vector[0], vector[1]


def test_one_tow_point_is_refused() -> None:
    with pytest.raises(EstimationError, match="two or more tow points"):
        modal_derivatives([forced_response(HULL, tow(1.5), 0.6)] * 2)
    with pytest.raises(EstimationError, match="tell the six"):
        modal_derivatives([forced_response(HULL, tow(x), 0.6) for x in (1.5, 1.5 + 1e-9)])


@pytest.mark.parametrize("missing", range(6))
def test_equations_that_leave_one_direction_open_are_refused(missing: int) -> None:
    rows = np.random.default_rng(missing).normal(size=(12, 6))
    rows[:, missing] = rows[:, (missing + 1) % 6] * 2 + 1e-13 * rows[:, missing]
    with pytest.raises(EstimationError, match="tell the six"):
        solve_six([(rows, np.ones(12))], [np.eye(12)])


def test_frequency_dependent_derivatives_are_followed() -> None:
    groups, truth = [], []
    for w in (1.2, 0.3, 0.6):
        six = SIX * (1 + 0.1 * w * np.array([1, -0.5, 0.4, 0.3, -0.2, 0.6]))
        truth.append((w, six))
        groups.append([forced_response(HULL.with_six(six), tow(x), w) for x in POINTS_M[::3]])
    found = frequency_dependence(groups)
    assert [w for w, _ in found] == [0.3, 0.6, 1.2]
    for (_, estimate), (_, six) in zip(found, sorted(truth, key=lambda p: p[0]), strict=True):
        np.testing.assert_allclose(estimate.six, six, rtol=1e-7)


@pytest.mark.slow
def test_forced_tows_with_noise_have_true_errors() -> None:
    """300 campaigns of three tow points at 0.1 Hz, 1 mm and 0.1 degree: z-scores of std 1 within 4 standard errors and 5 %.

    The record is the steady answer of 60 s at 10 Hz; bias below 4 standard errors plus a tenth of a sigma (the equations
    are not linear in the amplitudes).
    """
    rng = np.random.default_rng(3)
    w, t = 2 * np.pi * 0.1, np.arange(0, 60, 0.1)
    swings = [forced_response(HULL, tow(x), w, 0.1) for x in (1.3, 1.55, 1.8)]
    records = [(np.real(s.y_m * np.exp(1j * w * t)), np.real(s.beta_rad * np.exp(1j * w * t))) for s in swings]
    scores = []
    for _ in range(300):
        measured = []
        for swing, (y, beta) in zip(swings, records, strict=True):
            a = complex_amplitudes(
                t, y + rng.normal(0, 1e-3, len(t)), beta + rng.normal(0, np.radians(0.1), len(t)), 1j * w
            )
            measured.append(Swing(swing.tow, 1j * w, a.y_m, a.beta_rad, 0.1, a.covariance))
        found = modal_derivatives(measured)
        scores.append((found.six - SIX) / found.sd)
    z = np.array(scores)
    assert (np.abs(z.std(axis=0) - 1) < 4 / np.sqrt(600) + 0.05).all(), z.std(axis=0)
    assert (np.abs(z.mean(axis=0)) < 4 / np.sqrt(300) + 0.1).all(), z.mean(axis=0)


def test_a_full_simulation_of_a_small_forced_tow_returns_the_six() -> None:
    """The full equations at 5 mm of post: what is left is third order in the angles (5e-3 rad squared) and the transient."""
    t = np.arange(300.0, 400.0, 0.05)
    swings = []
    for x in (2.4, 3.0):
        forced = tow(x, post_amplitude_m=0.005, post_frequency_hz=0.1)
        motion = simulate_full(HULL, forced, Start(), np.concatenate([[0.0], t]))[1:]
        rate = 2j * np.pi * 0.1
        a = complex_amplitudes(t, motion["y_cg_m"].to_numpy(), motion["beta_rad"].to_numpy(), rate)
        post = 0.005 * np.exp(rate * t[0]) / 1j
        swings.append(Swing(forced, rate, a.y_m, a.beta_rad, post))
    np.testing.assert_allclose(modal_derivatives(swings).six, SIX, rtol=2e-4)
