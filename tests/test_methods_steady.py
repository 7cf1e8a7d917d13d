"""Steady tows of the simulator with a rudder over: all four forces and both points of action, with and without measured tension."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve

from towline.identify.methods.steady_hull import damping_from_known_point, fit_steady_hull
from towline.identify.steady import Along, SteadyState, fit_steady, input_covariance
from towline.record import EstimationError
from towline.simulate import Hull, Tow
from towline.simulate.model import full_rates, full_state

DELTA = np.radians(-15.0)
HULL = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, y_delta=-2.0, n_delta=2.4)
POINTS_M = (1.45, 1.6, 1.75, 1.9, 2.05)
SD = np.radians(0.05)


def tow_state(x_t: float, measured: bool = True) -> SteadyState:
    """The simulator's own equilibrium; without measurement T = R/cos(alpha)."""
    plain = Tow(1.28, 0.91, x_t, 3.96 if measured else None, None if measured else 3.9, rudder_rad=DELTA)
    alpha, beta = fsolve(
        lambda a: full_rates(0.0, np.array([a[0], a[1], -1.28 * np.sin(a[1]), 0.0]), HULL, plain)[2:],
        [0.3, 0.03],
        xtol=1e-13,
    )
    rates = full_rates(0.0, np.array([alpha, beta, -1.28 * np.sin(beta), 0.0]), HULL, plain)
    assert np.abs(rates).max() < 1e-10
    return SteadyState(
        f"{x_t}", x_t, alpha, beta, np.eye(2) * SD**2, speed_m_s=1.28, tension_n=3.96 if measured else None
    )


def measured(
    tow: SteadyState, rng: np.random.Generator, heading_rad: float = 0.0, tension: float = 1.0, speed: float = 1.0
) -> SteadyState:
    """A tow with errors of its own in angles, T and X_T, and the campaign's in heading, T and U."""
    return replace(
        tow,
        alpha_rad=tow.alpha_rad + rng.normal(0, SD),
        beta_rad=tow.beta_rad + rng.normal(0, SD) + heading_rad,
        tension_n=3.96 * tension * (1 + rng.normal(0, 0.005)),
        speed_m_s=1.28 * speed,
        tow_point_m=tow.tow_point_m + rng.normal(0, 0.0005),
    )


def test_exact_tows_give_all_four_and_both_points() -> None:
    found = fit_steady_hull([tow_state(x) for x in POINTS_M[:3]], rudder_rad=DELTA)
    assert found.y_v.value == pytest.approx(-52.87, rel=1e-6)
    assert found.n_v.value == pytest.approx(-48.51, rel=1e-6)
    assert found.y_delta is not None
    assert found.n_delta is not None
    assert (found.y_delta.value, found.n_delta.value) == pytest.approx((-2.0, 2.4), rel=1e-6)
    assert found.x_v_m.value == pytest.approx(48.51 / 52.87, rel=1e-6)
    assert found.x_delta_m.value == pytest.approx(-1.2, rel=1e-6)
    y_v, n_v = damping_from_known_point([tow_state(x) for x in POINTS_M[:3]], -1.2)
    assert (y_v.value, n_v.value) == pytest.approx((-52.87, -48.51), rel=1e-6)


def test_without_tension_the_points_stay_and_the_resistance_scales() -> None:
    tows = [tow_state(x, measured=False) for x in POINTS_M]
    found = fit_steady_hull(tows)
    assert found.in_units_of_resistance
    assert found.y_delta is None
    assert (found.x_v_m.value, found.x_delta_m.value) == pytest.approx((48.51 / 52.87, -1.2), rel=1e-6)
    assert found.y_v.value * 3.9 == pytest.approx(-52.87, rel=1e-6)
    scaled = fit_steady_hull(tows, rudder_rad=DELTA, resistance_n=3.9, resistance_sd_n=0.039)
    assert scaled.n_v.value == pytest.approx(-48.51, rel=1e-6)
    assert scaled.y_v.std / abs(scaled.y_v.value) == pytest.approx(
        np.hypot(0.01, found.y_v.std / abs(found.y_v.value)), rel=1e-6
    )


def test_intervals_are_true_over_many_seeds() -> None:
    """400 campaigns of five tows, 0.05 degree in alpha and beta and 0.5 % in T: z within 4 standard errors and 5 %.

    A tenth of a sigma of bias is allowed: the equations are products of noisy angles.
    """
    rng = np.random.default_rng(2)
    clean = [replace(tow_state(x), tension_sd_rel=0.005, tow_point_sd_m=0.0005) for x in POINTS_M]
    truth = np.array([-52.87, -2.0 * DELTA, -48.51, 2.4 * DELTA])
    z, inside = [], 0
    for _ in range(400):
        tows = [measured(t, rng) for t in clean]
        found = fit_steady_hull(tows, rudder_rad=DELTA)
        theta = np.array([found.y_v.value, found.y_delta_delta.value, found.n_v.value, found.n_delta_delta.value])
        z.append((theta - truth) / np.sqrt(np.diag(found.covariance)))
        low, high = found.intervals["x_v_m"]
        inside += low < 48.51 / 52.87 < high
    assert (np.abs(np.std(z, axis=0) - 1) < 4 / np.sqrt(800) + 0.05).all(), np.std(z, axis=0)
    assert (np.abs(np.mean(z, axis=0)) < 4 / np.sqrt(400) + 0.1).all(), np.mean(z, axis=0)
    assert abs(inside / 400 - 0.95) < 4 * np.sqrt(0.05 * 0.95 / 400)


@pytest.mark.once
@pytest.mark.parametrize("points_m", [POINTS_M[::4], POINTS_M[::2], POINTS_M])
def test_intervals_with_a_known_rudder_point_are_true_over_many_seeds(points_m: tuple[float, ...]) -> None:
    """400 campaigns of two, three, five tows: errors of each tow's own and, of heading, T and U, common to all; bars as above."""
    rng = np.random.default_rng(3)
    mode = np.array([[0.0, SD / 2]])
    common = {"common": mode, "common_key": "c", "tension_common_sd_rel": 0.004, "speed_sd_rel": 0.003}
    clean = [replace(tow_state(x), tension_sd_rel=0.005, tow_point_sd_m=0.0005, **common) for x in points_m]
    k = clean[0].force()[0] * (points_m[0] - 48.51 / 52.87)
    z = []
    for _ in range(400):
        heading, tension, speed = mode[0, 1] * rng.normal(), 1 + 0.004 * rng.normal(), 1 + 0.003 * rng.normal()
        tows = [measured(t, rng, heading, tension, speed) for t in clean]
        line, free = fit_steady(tows, -1.2), fit_steady_hull(tows)
        y_v, n_v = damping_from_known_point(tows, -1.2)
        assert line.y_delta_delta is not None
        assert line.n_delta_delta is not None
        pairs = [
            (line.x_v_m, 48.51 / 52.87), (line.slope, k), (y_v, -52.87), (n_v, -48.51),
            (line.y_delta_delta, -2.0 * DELTA), (line.n_delta_delta, 2.4 * DELTA),
            (free.y_v, -52.87), (free.n_v, -48.51), (free.y_delta_delta, -2.0 * DELTA), (free.n_delta_delta, 2.4 * DELTA),
        ]  # fmt: skip
        z.append([(found.value - truth) / found.std for found, truth in pairs])
    assert (np.abs(np.std(z, axis=0) - 1) < 4 / np.sqrt(800) + 0.05).all(), np.std(z, axis=0)
    assert (np.abs(np.mean(z, axis=0)) < 4 / np.sqrt(400) + 0.1).all(), np.mean(z, axis=0)


def test_inputs_of_several_tows_share_what_one_camera_shares() -> None:
    mode = np.array([[1e-3, 2e-3], [0.0, 3e-3]])
    one, two = (
        replace(tow_state(x), tension_sd_rel=s, tow_point_sd_m=m) for x, s, m in ((1.45, 0.01, 2e-3), (1.6, 0.02, 3e-3))
    )
    seen = [replace(t, common=mode, common_key="c") for t in (one, two)]
    own = [np.diag([SD**2, SD**2, s**2, m**2]) for s, m in ((0.01, 2e-3), (0.02, 3e-3))]
    shared = np.zeros((4, 4))
    shared[:2, :2] = mode.T @ mode
    np.testing.assert_allclose(
        input_covariance(seen), np.block([[own[0] + shared, shared], [shared, own[1] + shared]]), rtol=1e-14
    )
    apart = [seen[0], replace(seen[1], common_key="d", tension_n=None)]
    own[1][2, 2] = 0.0  # no tension was measured: its error is none
    nothing = np.zeros((4, 4))
    np.testing.assert_allclose(
        input_covariance(apart), np.block([[own[0] + shared, nothing], [nothing, own[1] + shared]]), rtol=1e-14
    )


def test_refusals_and_notes() -> None:
    tows = [tow_state(x) for x in POINTS_M[:2]]
    assert "third tow point" in fit_steady_hull(tows).notes[0]
    with pytest.raises(EstimationError, match="two or more tow points"):
        fit_steady_hull(tows[:1] * 2)
    with pytest.raises(EstimationError, match="all or to none"):
        fit_steady_hull([tows[0], replace(tows[1], tension_n=None)])
    with pytest.raises(EstimationError, match="one speed"):
        fit_steady_hull([tows[0], replace(tows[1], speed_m_s=1.5)])
    with pytest.raises(EstimationError, match="one heading"):
        fit_steady_hull([tows[0], replace(tows[1], beta_rad=tows[0].beta_rad)])
    with pytest.raises(EstimationError, match="amidships"):
        fit_steady_hull(tows, rudder_rad=0.0)
    odd = replace(tow_state(POINTS_M[2]), alpha_rad=0.5)
    assert "do not close" in fit_steady_hull([*tows, odd]).notes[0]


def test_deviations_are_those_of_small_changes_of_every_input() -> None:
    """Two tows, so that nothing is widened: by central differences in both angles, T and X_T of each, and in all T's and U."""
    tows = [
        replace(
            tow_state(x), tension_sd_rel=0.005, tow_point_sd_m=5e-4, tension_common_sd_rel=0.004, speed_sd_rel=0.003
        )
        for x in POINTS_M[::4]
    ]

    def values(seen: list[SteadyState]) -> np.ndarray:
        line, (y_v, n_v) = fit_steady(seen, -1.2), damping_from_known_point(seen, -1.2)
        assert line.y_delta_delta is not None
        assert line.n_delta_delta is not None
        parts = (line.x_v_m, y_v, n_v, line.y_delta_delta, line.n_delta_delta)
        return np.array([[p.value for p in parts], [p.std for p in parts]])

    variance = np.zeros(5)
    changes = {"alpha_rad": SD, "beta_rad": SD, "tension_n": 3.96 * 0.005, "tow_point_m": 5e-4}
    for name, sd in changes.items():
        for index in range(2):
            ends = []
            for sign in (1, -1):
                moved = list(tows)
                moved[index] = replace(tows[index], **{name: getattr(tows[index], name) + sign * 1e-3 * sd})
                ends.append(values(moved)[0])
            variance += ((ends[0] - ends[1]) / 2e-3) ** 2
    for name, share in (("tension_n", 0.004), ("speed_m_s", 0.003)):
        ends = [
            values([replace(t, **{name: getattr(t, name) * (1 + sign * 1e-3 * share)}) for t in tows])[0]
            for sign in (1, -1)
        ]
        variance += ((ends[0] - ends[1]) / 2e-3) ** 2
    # two tows have one pair, and it is the line
    (pair,) = fit_steady(tows, -1.2).pairs.values()
    line = fit_steady(tows, -1.2).x_v_m
    assert (pair.value, pair.std) == pytest.approx((line.value, line.std), rel=1e-9)
    np.testing.assert_allclose(values(tows)[1], np.sqrt(variance), rtol=1e-4)


@pytest.mark.parametrize(("stated", "x_vv"), [(True, -12.0), (False, -12.0), (False, 0.0)])
def test_steady_tows_on_a_line_that_keeps_its_length(stated: bool, x_vv: float) -> None:
    """The equilibrium of the full equations with surge gives X_v back, R known or not; T = R/cos(alpha) is centimetres off."""
    hull = replace(HULL, mass_kg=78.0, x_udot_kg=-4.0, x_vv_kg_m=x_vv)
    tows, plain = [], []
    for x_t in POINTS_M[:3]:
        towed = Tow(1.28, 0.91, x_t, 3.96, rudder_rad=DELTA, line="surge")

        def rates(angles: np.ndarray, towed: Tow = towed) -> np.ndarray:
            v = -1.28 * np.sin(angles[1])
            return full_state(0.0, np.array([angles[0], angles[1], v, 0.0]), hull, towed).rates[2:]

        angles = fsolve(rates, [0.3, 0.03], xtol=1e-13)
        assert np.abs(rates(angles)).max() < 1e-10
        state = SteadyState(f"x{x_t}", x_t, *angles, speed_m_s=1.28, tension_n=3.96 if stated else None)
        drag = x_vv * 1.28**2 / 3.96
        tows.append(replace(state, along=Along((1.85, 0.0), (drag, 0.0))))
        plain.append(replace(state, tension_n=None))
    found = fit_steady(tows, x_delta_m=-1.2)
    assert found.x_v_m.value == pytest.approx(HULL.x_v_m, abs=1e-8)
    if found.y_v is not None:
        assert found.y_v.value == pytest.approx(-52.87, rel=1e-6)
    assert abs(fit_steady(plain).x_v_m.value - HULL.x_v_m) > 0.01
    # what is not known of the drag is in the interval: of two tows, moved by one standard deviation it moves X_v by as much
    tows = tows[:2]
    unsure = [replace(t, along=Along((1.85, 0.0), (t.along.drag[0], 3.0))) for t in tows if t.along is not None]
    moved = [replace(t, along=Along((1.85, 0.0), (t.along.drag[0] + 0.3, 0.0))) for t in tows if t.along is not None]
    shift = fit_steady(moved).x_v_m.value - HULL.x_v_m
    assert fit_steady(unsure).x_v_m.std == pytest.approx(10 * abs(shift), rel=0.1)
