"""Further forms of the effects: against the same hull in another form, against the simulator's own numbers, and by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from towline.diagnose.effects import LAWS, LIBRARY, Effect, Seen, Situation
from towline.diagnose.effects.base import SWINGS_S, along_the_run, swinging
from towline.diagnose.effects.line_laws import STIFFEST_M_N, out_of_round
from towline.simulate import Hull, Start, Tow, simulate_full

HULL, TOW = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28), Tow(1.28, 0.91, 1.6, 3.96)
STATE = {
    "t_s": 4.0, "y_m": 0.3, "beta_rad": 0.08, "v_m_s": -0.11, "r_rad_s": 0.07, "alpha_rad": -0.2, "speed_m_s": 1.28,
    "line_length_m": 0.91, "tow_point_m": 1.6, "tension_n": 3.96, "alpha_rate": 0.13, "length_pp_m": 2.66,
    "density_kg_m3": 998.0, "half_width_m": 2.0, "v_lag": -0.15, "r_lag": 0.02, "duration_s": 40.0, "y_v": -52.87,
    "n_v": -48.51, "n_r": -57.60, "history": lambda t_s: 1.0,
}  # fmt: skip
DEPTH_M = 0.12


def situation(**other: object) -> Situation:
    return Situation(**(STATE | other))  # pyright: ignore[reportArgumentType]


def form(name: str, variant: str) -> Effect:
    return next(e for e in LIBRARY if e.name == name and e.variant == variant)


def pushes(effect: Effect, s: Situation, *numbers: float) -> tuple[float, float]:
    assert effect.force is not None
    side, moment = effect.force(s, *numbers)
    return float(side), float(moment)


def test_second_order_moduli_are_strips_where_a_hull_only_sways_or_only_turns() -> None:
    """A plate of one depth: v|v| by its whole length; r|r| by the integral of |x| x^2, L^4/32."""
    moduli, strips = form("crossflow_drag", "second-order moduli"), form("crossflow_drag", "")
    sway = situation(r_rad_s=0.0)
    assert pushes(moduli, sway, DEPTH_M, 0.0, 0.0, 0.0, 0.0) == pytest.approx(pushes(strips, sway, DEPTH_M, 0.0))
    turn = situation(v_m_s=0.0, r_rad_s=0.6)
    _, wanted = pushes(strips, turn, DEPTH_M, 0.0)
    side, moment = pushes(moduli, turn, DEPTH_M, 0.0, 0.0, 0.0, DEPTH_M / 32)
    assert side == 0.0
    # the strips' own integral over eight stations is good to 2 % where its kink lies amidships
    assert moment == pytest.approx(wanted, rel=0.02)
    assert moment == pytest.approx(-0.5 * 998.0 * DEPTH_M * 0.36 * 2.66**4 / 32)


@pytest.mark.parametrize(("variant", "place"), [("of the after body alone", -0.35), ("of the fore body alone", 0.35)])
def test_one_part_of_a_hull_drags_by_its_own_speed_at_its_own_place(variant: str, place: float) -> None:
    """A point of it, and a bell of 0.06 lengths by many strips: all water runs one way, so that three points are exact."""
    middle, drag = (place + 0.02) * 2.66, -0.5 * 998.0 * 2.66 * DEPTH_M

    def strip(arm: np.ndarray) -> np.ndarray:
        across = -0.11 + arm * 0.07
        return drag * across * np.abs(across)

    side, moment = pushes(form("crossflow_drag", variant), situation(), DEPTH_M, 0.02, 0.0)
    assert (side, moment) == pytest.approx((strip(middle), middle * strip(middle)))
    z, h = np.linspace(-8, 8, 4001, retstep=True)
    arms, bell = middle + 0.06 * 2.66 * z, np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) * h
    assert (-0.11 + arms[np.abs(z) < 3] * 0.07 < 0).all()
    wide = pushes(form("crossflow_drag", variant), situation(), DEPTH_M, 0.02, 0.06)
    assert wide == pytest.approx((float(strip(arms) @ bell), float((arms * strip(arms)) @ bell)), rel=1e-3)


def test_what_changes_along_the_run_is_even_over_it() -> None:
    t_s = 40.0 * (np.arange(4000) + 0.5) / 4000
    s = situation(t_s=t_s)
    courses = [along_the_run(s, *size) for size in np.eye(3)]
    assert [float(np.mean(c)) for c in courses] == pytest.approx([0.0] * 3, abs=1e-6)
    products = np.array([[np.mean(a * b) for a in courses] for b in courses])
    assert products == pytest.approx(np.diag([1 / 3, 1 / 5, 1 / 7]), abs=1e-6)
    assert [float(along_the_run(situation(t_s=40.0), *size)) for size in np.eye(3)] == pytest.approx([1.0] * 3)


def test_what_swings_comes_back_after_a_period_and_no_fit_goes_far_from_it() -> None:
    for period in SWINGS_S:
        one, later = (swinging(situation(t_s=t), period, 0.3, -0.2, 0.0) for t in (3.0, 3.0 + period))
        assert one == pytest.approx(later)
    fast, faster = (swinging(situation(t_s=5.0), 20.0, 0.3, 0.0, f) for f in (0.5, 2.0))
    assert fast == faster


def test_a_current_that_changes_is_a_current_at_every_time() -> None:
    plain = form("cross_current", "")
    grows = form("cross_current", "that changes along the tank")
    eddy = form("cross_current", "to and fro, about 19 m")
    for t_s in (0.0, 11.0, 40.0):
        s = situation(t_s=t_s)
        assert pushes(grows, s, 0.01, 0.004, 0.0, 0.0) == pytest.approx(
            pushes(plain, s, 0.01 + 0.004 * (t_s / 20 - 1), 0.0)
        )
        flow = 0.01 + 0.002 * np.sin(2 * np.pi * 1.28 * t_s / 19)
        assert pushes(eddy, s, 0.01, 0.002, 0.0, 0.0) == pytest.approx(pushes(plain, s, flow, 0.0))


def test_eddies_are_met_the_sooner_the_faster_the_tow() -> None:
    eddy = form("cross_current", "to and fro, about 27 m")
    slow, fast = (situation(t_s=t_s, speed_m_s=u) for t_s, u in ((20.0, 0.8), (12.5, 1.28)))
    assert pushes(eddy, slow, 0.0, 0.002, -0.001, 0.1) == pytest.approx(pushes(eddy, fast, 0.0, 0.002, -0.001, 0.1))


def test_a_fin_that_stalls_loses_its_lift_where_the_water_comes_from_aside() -> None:
    """Straight ahead it pushes as any crooked hull does, beyond its angle by no more than a hundredth."""
    plain, fin = form("hull_asymmetry", ""), form("hull_asymmetry", "a fin aft, stalling")
    straight = situation(v_m_s=0.0, r_rad_s=0.0)
    assert pushes(fin, straight, 0.05, 0.03, 0.0, 0.3) == pytest.approx(pushes(plain, straight, 0.05, 0.03))
    # the hull turns about its fin: no water comes at that from aside
    about = situation(v_m_s=0.4 * 2.66 * 0.1, r_rad_s=0.1)
    assert pushes(fin, about, 0.05, 0.03, 0.0, 0.3) == pytest.approx(pushes(plain, about, 0.05, 0.03))
    aside = situation(v_m_s=1.28 * np.tan(0.3), r_rad_s=0.0)
    flow = 1.28**2 / np.cos(0.3) ** 2
    assert pushes(fin, aside, 0.05, 0.03, 0.0, 0.3) == pytest.approx((0.05 * flow / np.e, 0.03 * flow / np.e))
    assert abs(pushes(fin, aside, 0.05, 0.03, 0.0, 0.12)[0]) < 0.01 * 0.05 * flow


@pytest.mark.parametrize("rate", [0.13, -0.13])
def test_a_post_that_rubs_turns_the_line_back(rate: float) -> None:
    """The line is turned by M, so that it presses across at the tow point with M / L."""
    side, moment = pushes(form("swivel_friction", "at the post"), situation(alpha_rate=rate), 0.05, 0.0)
    assert side == pytest.approx(-np.sign(rate) * 0.05 / 0.91 * np.cos(-0.2 + 0.08))
    assert moment == pytest.approx(1.6 * side)


def test_a_tow_point_that_has_slipped_is_one_that_stands_aside() -> None:
    """Along the whole motion, the model let go at the same place: by the simulator's own offset, and by the effect's force."""
    slipped, aside_m, t_s = form("tow_point_offset", "slips at about 8 s"), 0.004, np.arange(0, 30, 0.05)

    def extra(t, y, beta, v, r, alpha):
        s = situation(t_s=t, y_m=y, beta_rad=beta, v_m_s=v, r_rad_s=r, alpha_rad=alpha)
        assert slipped.force is not None
        return slipped.force(s, 0.0, aside_m, -100.0)

    begin = Start(y_cg_m=0.1)
    plain, forced = (simulate_full(HULL, TOW, begin, t_s, extra=e) for e in (None, extra))
    wanted = simulate_full(HULL, Tow(1.28, 0.91, 1.6, 3.96, tow_point_offset_m=aside_m), begin, t_s)
    for column in ("y_cg_m", "beta_rad"):
        change = wanted[column] - plain[column]
        assert np.abs(change).max() > 1e-3
        # second order in the line's angle (0.2 rad) and the offset over the line
        assert np.abs(forced[column] - wanted[column]).max() < 0.03 * np.abs(change).max(), column


def test_a_rail_draws_the_point_to_the_side_it_is_pulled_to_and_is_seen_in_the_lines_length() -> None:
    rail = form("tow_point_offset", "on a rail")
    assert rail.force is not None
    assert rail.stretch is not None
    angles = np.array([-0.3, 0.0, 0.3])
    side, _ = rail.force(situation(alpha_rad=angles - 0.08), 0.01)
    assert side[1] == 0.0
    assert side[0] == pytest.approx(-side[2], rel=0.1)
    seen = SimpleNamespace(side=np.sin(angles))
    longer = rail.stretch(seen, 0.01)
    assert longer == pytest.approx(-0.01 * np.tanh(np.sin(angles) / 0.1) * np.sin(angles))


def test_a_heavy_line_pulls_as_a_catenary_does() -> None:
    """Chord 2 a arsinh(L/2a) of a line of weight w, a = T/w: 1.6 mm shorter than the line at R, 6.4 mm at R/2."""
    hanging = next(law for law in LAWS if law.variant.startswith("hanging"))
    assert hanging.law is not None
    rest_n, length_m, weight_n_m = 3.96, 0.91, 0.9
    pull_n = rest_n * np.array([0.5, 0.7, 1.0, 1.5, 3.0])
    a = pull_n / weight_n_m
    shorter = length_m - 2 * a * np.arcsinh(length_m / (2 * a))
    longer = (pull_n - rest_n) * STIFFEST_M_N - shorter
    s = situation(line_length_m=length_m + longer, longer_m=longer, longer_rate_m_s=0.0 * pull_n)
    found = hanging.law(s, weight_n_m, 0.0, 1.0)
    # a catenary is a parabola to the square of its weight over its pull
    assert (np.abs(found / pull_n - 1) < 0.1 * (weight_n_m * length_m / pull_n.min()) ** 2).all()
    quick = replace(s, longer_rate_m_s=0.01 + 0.0 * pull_n)
    for tighter in (0.0, 1.0, 1.5):
        damped = hanging.law(quick, weight_n_m, 15.0, tighter) - found
        assert damped == pytest.approx(15.0 * 0.01 * (found / rest_n) ** tighter)


def test_a_heavy_line_hangs_the_deeper_the_longer_it_is_whatever_the_speed() -> None:
    """L (w L/T)^2/24: of twice the length eight times as much at one pull, of a slower tow as much."""
    hanging = next(law for law in LAWS if law.variant.startswith("hanging"))
    assert hanging.law is not None
    for length_m, rest_n, shorter_m in ((0.6, 3.96, 1e-3), (1.2, 3.96, 8e-3), (1.2, 1.98, 8e-3)):
        weight_n_m = 3.96 / 0.6 * np.sqrt(24e-3 / 0.6)
        longer_m = (3.96 - rest_n) * STIFFEST_M_N - shorter_m
        s = situation(tension_n=rest_n, line_length_m=length_m + longer_m, longer_m=longer_m, longer_rate_m_s=0.0)
        assert float(hanging.law(s, weight_n_m, 0.0, 1.0)) == pytest.approx(3.96, rel=1e-6)


def test_an_eccentric_pulley_pulls_by_the_ratio_of_its_arms() -> None:
    """The line runs off its top and a weight hangs at its side: T (a + e sin) = W (a + e cos) about an axle e off its middle."""
    radius_m, off, weight_n, paid_m = 0.024, 0.017, 3.96, np.linspace(-0.3, 0.3, 200)
    phase = paid_m / radius_m
    wanted = weight_n * (1 + off * np.cos(phase)) / (1 + off * np.sin(phase))
    begun_m = 2 * np.pi * 0.0265
    effect = out_of_round(begun_m)
    own = {"sine": -off, "cosine": off, "smaller": begun_m / (2 * np.pi * radius_m) - 1}
    assert effect.law is not None
    numbers = [own.get(p.name, 0.0) for p in effect.parameters]
    found = effect.law(situation(longer_m=paid_m, longer_rate_m_s=0.0 * paid_m, tension_n=weight_n), *numbers)
    # what one sine leaves of the ratio: sin (sin - cos) (e/a)^2, at most 1.21
    np.testing.assert_allclose(found, wanted, rtol=1.25 * off**2)


def test_a_camera_on_its_side_is_late_by_columns() -> None:
    t_s = np.arange(3.0)
    none = np.zeros((3, 1, 1))
    shutter = np.zeros((2, 3, 1, 4, 3))
    shutter[0, :, :, 1, 1], shutter[1, :, :, 1, 1] = 0.4, -0.1
    rates = (none, none + 0.05, none)
    seen = Seen(t_s[:, None, None], (none, none, none), rates, none, none, np.ones((1, 1)), shutter)
    for variant, share in (("", 0.4), ("column by column", -0.1)):
        observe = form("rolling_shutter", variant).observe
        assert observe is not None
        assert np.ravel(observe(seen, 0.02)[1]) == pytest.approx([0.02 * share * 0.05] * 3)


@pytest.mark.parametrize(("at_s", "later"), [(16.0, 0.01), (26.0, -0.005)])
def test_a_clock_that_goes_over_to_another_rate_has_both(at_s: float, later: float) -> None:
    clock = form("frame_rate", f"another rate from about {at_s:g} s on").clock
    assert clock is not None
    early, late = (np.diff([float(clock(t, 0.002, later, at_s)) for t in (a, a + 1.0)])[0] for a in (2.0, 38.0))
    assert (early, late) == pytest.approx((0.002, 0.002 + later), abs=1e-6)
