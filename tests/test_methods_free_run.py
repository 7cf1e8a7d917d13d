"""Rudder derivatives from the simulator's own zigzags and turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from towline.identify.methods.free_run import FreeRecord, fit_free_run, without_rudder
from towline.identify.methods.output_error import output_error
from towline.record import EstimationError
from towline.simulate import Histories, Hull, Start, Tow, simulate_full

HULL = Hull(249.6448, 93.9161, -97.17078, -42.7710, -92.5523, -94.0412, speed_m_s=1.30, y_delta=-18.0, n_delta=25.5)
"""Table 3.1's hull (straight-line stable) with a rudder at -1.417 m."""
SIGMA = np.array([1e-3, np.radians(0.1)])


def zigzag(
    amplitude_rad: float = 0.17, period_s: float = 12.0, length_s: float = 40.0
) -> tuple[np.ndarray, np.ndarray]:
    """Rudder history of a zigzag: trapezoids, 0.2 rad/s."""
    ramp = amplitude_rad / 0.2
    times, values = [0.0, 1.0], [0.0, 0.0]
    side, t = 1.0, 1.0
    while t < length_s:
        times += [t + (ramp if len(times) == 2 else 2 * ramp), t + period_s / 2]
        values += [side * amplitude_rad] * 2
        side, t = -side, t + period_s / 2
    return np.array(times), np.array(values)


def run(
    history: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator | None = None,
    hull: Hull = HULL,
    speed: float = 1.30,
    step: float = 0.1,
) -> FreeRecord:
    t = np.arange(0, 40, step)
    motion: pd.DataFrame = simulate_full(
        hull,
        Tow(speed, 1.0, 0.0, None, resistance_n=0.0),
        Start(y_cg_m=0.1, beta_rad=0.01),
        t,
        free=True,
        histories=Histories(rudder_rad=lambda s: float(np.interp(s, *history))),
    )
    values = motion[["y_cg_m", "beta_rad"]].to_numpy()
    if rng is not None:
        values = values + SIGMA * rng.normal(size=values.shape)
    return FreeRecord(t, values[:, 0], values[:, 1], *history, speed)


TURN = (np.array([0.0, 2.0, 3.0, 100.0]), np.array([0.0, 0.0, 0.1, 0.1]))


def test_an_exact_zigzag_gives_the_rudder() -> None:
    """Runge-Kutta of 0.1 s over the rudder's corners: 1e-4 of the derivatives."""
    found = fit_free_run([run(zigzag())], without_rudder(HULL), np.zeros((6, 6)))
    assert (found.y_delta.value, found.n_delta.value) == pytest.approx((-18.0, 25.5), rel=5e-4)
    assert found.x_delta_m.value == pytest.approx(-25.5 / 18, rel=1e-3)
    assert found.y_bias_n is not None
    assert found.y_bias_n.value == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_array_equal(found.six.six, HULL.six)


def test_zigzag_and_turn_give_the_four_linear_derivatives_too() -> None:
    """m' and I' held, the other eight free, the start 20 % off."""
    wrong = without_rudder(HULL.with_six(HULL.six * [1, 1, 1.2, 0.8, 1.2, 0.85]))
    found = fit_free_run([run(zigzag()), run(TURN)], wrong)
    np.testing.assert_allclose(found.six.six, HULL.six, rtol=5e-3)
    assert (found.y_delta.value, found.n_delta.value) == pytest.approx((-18.0, 25.5), rel=5e-3)


def test_asymmetry_and_another_speed() -> None:
    """Quoted at 1.30, run at 1.0 m/s: rudder and bias go with U squared."""
    skew = replace(HULL, y_bias_n=0.3, n_bias_n_m=-0.4)
    found = fit_free_run([run(zigzag(), hull=skew, speed=1.0)], without_rudder(HULL), np.zeros((6, 6)))
    assert (found.y_delta.value, found.n_delta.value) == pytest.approx((-18.0, 25.5), rel=1e-3)
    assert found.y_bias_n is not None
    assert found.n_bias_n_m is not None
    assert (found.y_bias_n.value, found.n_bias_n_m.value) == pytest.approx((0.3, -0.4), rel=2e-2)


@pytest.mark.slow
def test_intervals_are_true_when_the_tows_errors_come_along() -> None:
    """10 zigzags, 1 mm and 0.1 degree; the six known to 1 % with a random error of that size each time.

    rms z of (Y_delta, N_delta) is 1 within 4 standard errors and 10 %. Held at the wrong values, the stated error is too small.
    """
    rng = np.random.default_rng(3)
    covariance = np.diag((0.01 * HULL.six) ** 2)
    clean = run(zigzag(), step=0.4)
    z, naive = [], []
    for _ in range(10):
        noise = SIGMA * rng.normal(size=(len(clean.t_s), 2))
        one = replace(clean, y_m=clean.y_m + noise[:, 0], beta_rad=clean.beta_rad + noise[:, 1])
        told = HULL.with_six(HULL.six * (1 + 0.01 * rng.normal(size=6)))
        for known, scores in ((covariance, z), (np.zeros((6, 6)), naive)):
            found = fit_free_run([one], told, known, bias=False)
            scores.append(
                [(found.y_delta.value + 18.0) / found.y_delta.std, (found.n_delta.value - 25.5) / found.n_delta.std]
            )
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert (np.abs(rms - 1) < 4 / np.sqrt(20) + 0.1).all(), rms
    assert np.sqrt(np.mean(np.square(naive))) > 2


def test_refusals_and_disagreement() -> None:
    with pytest.raises(EstimationError, match="no free run"):
        fit_free_run([], HULL)
    still = (np.array([0.0, 1.0]), np.array([0.0, 0.0]))
    with pytest.raises(EstimationError, match="never moves"):
        fit_free_run([run(still, step=0.4)], HULL, np.zeros((6, 6)))
    told = HULL.with_six(HULL.six * [1, 1, 1, 1, 1, 1.2])
    found = fit_free_run([run(zigzag(), np.random.default_rng(4), step=0.2)], told, np.diag((0.01 * HULL.six) ** 2))
    assert any("disagree" in note for note in found.notes)


@pytest.mark.parametrize("what", ["motion", "slopes"])
def test_a_start_whose_motion_is_not_finite_is_refused(what: str) -> None:
    """Its slopes may be: a model that grows beyond bounds is no place to begin."""
    t = np.arange(30) / 10

    def predict(theta: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        motion, slopes = np.outer(t, [theta[0], 2 * theta[0]]), np.stack([t, 2 * t], axis=1)[:, :, None]
        if what == "motion":
            motion = motion + np.where(t > 2, np.inf, 0.0)[:, None]
        else:
            slopes = slopes + np.where(t > 2, np.inf, 0.0)[:, None, None]
        return [motion], [slopes]

    seen = [np.outer(t, [3.0, 6.0])]
    if what == "motion":
        with pytest.raises(EstimationError, match="beyond bounds"):
            output_error(predict, seen, [t], np.array([1.0]))
    else:
        output_error(predict, seen, [t], np.array([1.0]))
