"""Transfer functions against the closed forms of theory.md 9.5 (retyped here), and derivatives from frequency responses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towline.identify.methods.forced import forced_response
from towline.identify.methods.frequency import (
    FrequencyResponse,
    fit_frequency_response,
    measure_response,
    model_response,
)
from towline.identify.methods.transfer import (
    bode,
    free_ship_transfer,
    line_force_transfer,
    open_loop_transfer,
    post_transfer,
    rudder_transfer,
)
from towline.record import EstimationError
from towline.simulate import Hull, Start, Tow, characteristic_coefficients, simulate_linear

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28, y_delta=-14.0, n_delta=17.0)
TOW = Tow(1.28, 0.91, 1.649, 3.96)
EXACT = 1e-10
M, IZ, YV, YR, NV, NR = SIX
X, L, T, U, YD, ND = 1.649, 0.91, 3.96, 1.28, -14.0, 17.0


def test_rudder_to_y_and_beta_2_37() -> None:
    found = rudder_transfer(HULL, TOW)
    np.testing.assert_allclose(found["y"].denominator, characteristic_coefficients(HULL, TOW), rtol=EXACT)
    y = [IZ * YD, (YR + M * U) * ND - NR * YD, U * (NV * YD - YV * ND) + T * (1 + X / L) * (X * YD - ND)]
    beta = [M * ND, NV * YD - YV * ND, T / L * (ND - X * YD)]
    np.testing.assert_allclose(found["y"].numerator, y, rtol=EXACT)
    np.testing.assert_allclose(found["beta"].numerator, beta, rtol=EXACT)


def test_line_force_to_all_5_22() -> None:
    found = line_force_transfer(HULL, TOW)
    np.testing.assert_allclose(found["y"].numerator, [IZ, (YR + M * U) * X - NR, U * (NV - X * YV)], rtol=EXACT)
    np.testing.assert_allclose(found["beta"].numerator, [M * X, NV - X * YV, 0.0], rtol=EXACT, atol=1e-9)
    np.testing.assert_allclose(found["v"].numerator, [IZ, X * YR - NR, 0.0, 0.0], rtol=EXACT, atol=1e-9)
    np.testing.assert_allclose(found["r"].numerator, [M * X, NV - X * YV, 0.0, 0.0], rtol=EXACT, atol=1e-9)


def test_free_ship_5_14_and_open_loop_8_27() -> None:
    p0 = [M * IZ, -(IZ * YV + M * NR), YV * NR - NV * YR]
    free = free_ship_transfer(HULL)
    np.testing.assert_allclose(free["v"].denominator, p0, rtol=EXACT)
    np.testing.assert_allclose(free["v"].numerator, [YD * IZ, -YD * NR + ND * YR], rtol=EXACT)
    np.testing.assert_allclose(free["r"].numerator, [ND * M, -ND * YV + YD * NV], rtol=EXACT)
    loop = open_loop_transfer(HULL, TOW)
    np.testing.assert_allclose(loop["y"].denominator, [*p0, 0.0, 0.0], rtol=EXACT, atol=1e-9)
    np.testing.assert_allclose(loop["y"].numerator, line_force_transfer(HULL, TOW)["y"].numerator, rtol=EXACT)
    # closing the loop with f = -T s(alpha + beta) gives the towed one back
    s = 0.3 + 0.7j
    closed = line_force_transfer(HULL, TOW)["y"](s)
    spring = T * (loop["y"](s) / L + (1 + X / L) * loop["beta"](s))
    assert loop["y"](s) / (1 + spring) == pytest.approx(closed, rel=EXACT)


def test_speeds_other_than_the_hulls_own() -> None:
    """At half the speed Y_v halves and Y_delta quarters."""
    slow = free_ship_transfer(HULL, 0.64)
    assert slow["v"].numerator[0] == pytest.approx(YD / 4 * IZ, rel=EXACT)
    assert slow["v"].denominator[1] == pytest.approx(-(IZ * YV + M * NR) / 2, rel=EXACT)


def test_bode_data() -> None:
    function = line_force_transfer(HULL, TOW)["beta"]
    omega = np.geomspace(0.01, 10, 300)
    data = bode(function, omega)
    np.testing.assert_allclose(10 ** (data.gain_db / 20), np.abs(function(1j * omega)), rtol=EXACT)
    assert np.abs(np.diff(data.phase_deg)).max() <= 180  # unwrapped: the undamped pair turns it by 180 at most
    # the gain peaks where the pair swings
    pair = function.poles[np.argmax(function.poles.imag)]
    assert omega[np.argmax(data.gain_db)] == pytest.approx(pair.imag, rel=0.05)
    # far above all roots: s^-2 m' X / (m' I') -> 40 dB a decade, 180 degrees behind
    assert data.gain_db[-1] == pytest.approx(20 * np.log10(X / IZ / 100), abs=0.1)
    assert 0.0 in np.round(function.zeros, 12)


def test_the_post_is_the_forced_oscillation() -> None:
    swing = forced_response(HULL, TOW, 0.5)
    functions = post_transfer(HULL, TOW)
    assert functions["y"](0.5j) == pytest.approx(swing.y_m, rel=EXACT)
    assert functions["beta"](0.5j) == pytest.approx(swing.beta_rad, rel=EXACT)


def exact_response(x_t: float, omega: np.ndarray, source="post") -> FrequencyResponse:
    empty = FrequencyResponse(replace(TOW, tow_point_m=x_t), omega, omega, omega, 0 * omega, 0 * omega, source)
    values = model_response(HULL, empty)
    return replace(empty, y=values[:, 0], beta=values[:, 1])


def test_exact_responses_give_the_derivatives_back() -> None:
    """One tow point at several frequencies is enough, whether the post or a force moves the model."""
    omega = np.array([0.2, 0.4, 0.9])
    np.testing.assert_allclose(fit_frequency_response([exact_response(1.649, omega)]).six, SIX, rtol=1e-7)
    force = [exact_response(x, omega, "force") for x in (1.5, 1.8)]
    np.testing.assert_allclose(fit_frequency_response(force).six, SIX, rtol=1e-7)
    noisy = [replace(f, sd_y=0.01 * np.abs(f.y), sd_beta=0.01 * np.abs(f.beta)) for f in force]
    np.testing.assert_allclose(fit_frequency_response(noisy, SIX * 1.1).six, SIX, rtol=1e-5)
    with pytest.raises(EstimationError, match="holds four numbers"):
        fit_frequency_response([exact_response(1.649, omega[:1])])
    two = [exact_response(x, omega[1:2]) for x in (1.446, 1.751)]  # eight numbers are enough
    np.testing.assert_allclose(fit_frequency_response(two).six, SIX, rtol=1e-6)
    # responses that differ by more than their stated errors: the covariance is that of errors as large as the misfit
    rng = np.random.default_rng(8)
    off = [
        replace(r, y=r.y * (1 + 0.02 * rng.normal(size=len(r.y))), sd_y=0.02 * abs(r.y), sd_beta=0.02 * abs(r.beta))
        for r in (exact_response(x, omega) for x in (1.446, 1.751))
    ]
    fair = fit_frequency_response(off, SIX)
    boast = fit_frequency_response([replace(r, sd_y=r.sd_y / 50, sd_beta=r.sd_beta / 50) for r in off], SIX)
    np.testing.assert_allclose(boast.six, fair.six, rtol=1e-5)
    chi2, degrees = (float(word) for word in fair.notes[0].removeprefix("chi-square ").split(" of "))
    assert "differ from the linear model" in boast.notes[1]
    np.testing.assert_allclose(boast.covariance, fair.covariance * chi2 / degrees, rtol=0.02)


@pytest.mark.slow
def test_a_measured_response_has_true_errors() -> None:
    """100 records of a post that moves at three frequencies at once, 1 mm and 0.1 degree: z within 4 standard errors and 5 %."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 62.8, 0.1)
    omega = 0.1 * np.array([4, 9, 20])
    post = sum(0.06 * np.sin(w * t + k) for k, w in enumerate(omega))
    phasors = [0.06 * np.exp(1j * (k - np.pi / 2)) for k in range(3)]
    clean = []
    for x in (1.446, 1.751):
        tow = replace(TOW, tow_point_m=x)
        parts = [forced_response(HULL, tow, w, p) for w, p in zip(omega, phasors, strict=True)]
        clean.append(
            (
                tow,
                sum(np.real(s.y_m * np.exp(s.rate * t)) for s in parts),
                sum(np.real(s.beta_rad * np.exp(s.rate * t)) for s in parts),
            )
        )
    scores = []
    for _ in range(100):
        measured = [
            measure_response(
                t,
                y + rng.normal(0, 1e-3, len(t)),
                b + rng.normal(0, np.radians(0.1), len(t)) + 0.01,
                tow,
                post,
                omega,
            )
            for tow, y, b in clean
        ]
        found = fit_frequency_response(measured)
        assert len(found.notes) == 1
        scores.append((found.six - SIX) / found.sd)
    z = np.array(scores)
    assert (np.abs(z.std(axis=0) - 1) < 4 / np.sqrt(200) + 0.05).all(), z.std(axis=0)
    assert (np.abs(z.mean(axis=0)) < 4 / np.sqrt(100)).all(), z.mean(axis=0)


def test_a_record_of_the_simulator_after_its_transient() -> None:
    """A stable tow (damping 0.07 1/s at X_T 3.0 m) 200 s after its start: e^-14 of the transient is left."""
    tow = replace(TOW, tow_point_m=3.0, post_amplitude_m=0.05, post_frequency_hz=0.1)
    t = np.concatenate([[0.0], np.arange(200, 300, 0.1)])
    motion = simulate_linear(HULL, tow, Start(), t)
    late = t >= 200
    post, _ = tow.post_motion(t)
    y, beta = motion["y_cg_m"].to_numpy()[late], motion["beta_rad"].to_numpy()[late]
    found = measure_response(t[late], y, beta, tow, np.asarray(post)[late], np.array([0.2 * np.pi]))
    assert found.y[0] == pytest.approx(post_transfer(HULL, tow)["y"](0.2j * np.pi), rel=1e-4)
    with pytest.raises(EstimationError, match="must be at least"):
        measure_response(t[late], y, beta, tow, np.asarray(post)[late], np.array([0.01]))


def test_sines_closer_than_one_over_the_record_are_refused() -> None:
    """In 100 s: none below 2 pi / 100, and none nearer to its neighbour than that."""
    t = np.arange(0, 100.01, 0.5)
    spacing = 2 * np.pi / 100
    tow_ = Tow(1.28, 0.91, 1.446, 3.96)

    def asked(*omega: float) -> None:
        inputs = sum(np.sin(w * t) for w in omega)
        measure_response(t, 0.5 * inputs, 0.1 * inputs, tow_, inputs, np.array(omega))

    asked(1.001 * spacing, 2.5 * spacing)
    for wrong in ((0.999 * spacing, 3 * spacing), (2 * spacing, 2.97 * spacing)):
        with pytest.raises(EstimationError, match=r"at least 0\.0628 rad/s"):
            asked(*wrong)
