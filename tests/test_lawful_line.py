"""A line with a law of its own: its length and the model's surge are states (theory.md 10)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towline.simulate.model import Hull, Tow, forward_speed, full_state, loose_rates, paid_state, spring_tension

HULL = Hull(
    150.0,
    60.0,
    -52.0,
    -64.0,
    -48.0,
    -57.0,
    1.28,
    mass_kg=79.0,
    x_udot_kg=-4.0,
    x_vr_kg=30.0,
    x_vv_kg_m=-20.0,
    x_rr_kg_m=2.0,
)
TOW = Tow(1.28, 0.91, 1.548, 4.0, tow_point_offset_m=0.01, line="surge", post_amplitude_m=0.05, post_frequency_hz=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_the_line_s_own_coordinates_say_what_the_tank_s_do(seed: int) -> None:
    """``loose_rates``, integrated elsewhere and held against golden motions, by its chain rule: the same six rates."""
    rng = np.random.default_rng(seed)
    t_s, beta, v, r, u = 3.0, *rng.normal(0, 0.2, 3), 1.28 + rng.normal(0, 0.1)
    alpha, longer = rng.normal(0, 0.3), 0.05
    now = replace(TOW, line_length_m=TOW.line_length_m + longer)
    post_y, _ = TOW.post_motion(t_s)
    x = -now.line_length_m * np.cos(alpha) - TOW.tow_point_m * np.cos(beta) + TOW.tow_point_offset_m * np.sin(beta)
    y = (
        post_y
        + now.line_length_m * np.sin(alpha)
        - TOW.tow_point_m * np.sin(beta)
        - TOW.tow_point_offset_m * np.cos(beta)
    )
    spring = replace(TOW, stiffness_n_m=300.0, line_damping_n_s_m=10.0)
    plain = np.array([x, y, beta, u, v, r])
    rates = loose_rates(t_s, plain, HULL, spring)
    pull = float(spring_tension(t_s, plain, spring)[0])
    found = paid_state(t_s, (alpha, beta, v, r, u), pull, HULL, now).rates
    np.testing.assert_allclose(found[[1, 2, 3, 5]], rates[[2, 4, 5, 3]], rtol=1e-9, atol=1e-12)
    # where the tow point goes from the post, by the central difference of the tank's own rates
    step = 1e-6

    def place(sign: float) -> tuple[float, float]:
        there, post = plain + sign * step * rates, TOW.post_motion(t_s + sign * step)[0]
        ahead = there[0] + TOW.tow_point_m * np.cos(there[2]) - TOW.tow_point_offset_m * np.sin(there[2])
        aside = there[1] + TOW.tow_point_m * np.sin(there[2]) + TOW.tow_point_offset_m * np.cos(there[2]) - post
        return float(np.hypot(ahead, aside)), float(np.arctan2(aside, -ahead))

    (length_1, alpha_1), (length_0, alpha_0) = place(1.0), place(-1.0)
    assert found[4] == pytest.approx((length_1 - length_0) / (2 * step), abs=1e-7)
    assert found[0] == pytest.approx((alpha_1 - alpha_0) / (2 * step), abs=1e-7)


def test_a_line_that_pulls_as_one_that_keeps_its_length_keeps_it() -> None:
    """T of the constraint put in as given: L' = 0, and the rates are the taut line's."""
    state = np.array([0.2, 0.05, 0.02, -0.03])
    still = replace(TOW, post_amplitude_m=0.0)
    taut = full_state(0.0, state, HULL, still)
    u = forward_speed(still, *state)
    found = paid_state(0.0, (*state, u), taut.tension_n, HULL, still).rates
    assert found[4] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found[:4], taut.rates, rtol=1e-9)
