"""The effects' forms against closed forms and integrals by other means, and in the simulator as in the diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from towline.blind.truth.hulls import MARINER
from towline.blind.truth.motion import swim
from towline.diagnose.effects import LIBRARY, Effect, Late, Seen, Situation, camera
from towline.diagnose.simulated import effects_of, with_effects
from towline.diagnose.tow.pushes import Push
from towline.diagnose.tow.unknown import (
    ACROSS_PER_M,
    BETA_RAD,
    CHANGES,
    R_RAD_S,
    SIDE_N,
    TURNED_PER_RAD,
    V_M_S,
    Y_M,
    free_forms,
    one_off,
    shapes_of,
)
from towline.record.scenario import ScenarioFile
from towline.record.schema import CameraTable, DatumPoint, Marker, TowTable
from towline.record.toml import check_tables
from towline.simulate.model import Hull, Tow, full_rates, full_state, line_angle_rate, line_force

STATE = {
    "t_s": 4.0, "y_m": 0.3, "beta_rad": 0.08, "v_m_s": -0.11, "r_rad_s": 0.07, "alpha_rad": -0.2, "speed_m_s": 1.28,
    "line_length_m": 0.91, "tow_point_m": 1.6, "tension_n": 3.96, "alpha_rate": 0.13, "length_pp_m": 2.66,
    "density_kg_m3": 998.0, "half_width_m": 2.0, "v_lag": -0.15, "r_lag": 0.02, "duration_s": 40.0, "y_v": -52.87,
    "n_v": -48.51, "n_r": -57.60, "history": lambda t_s: 1.0 + 0.02 * np.sin(t_s),
}  # fmt: skip
RUNG_OUT_S = 3.0
"""0.15 of critical damping on 82 kg and 20 kN/m: exp(-0.15 15.6/s 3 s) = 0.001 of the ring after the release."""
HULL, TOW = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28), Tow(1.28, 0.91, 1.6, 3.96)


def situation(**other) -> Situation:
    return Situation(**(STATE | other))


def effect(name: str) -> Effect:
    """The first of its variants."""
    return next(e for e in LIBRARY if e.name == name)


def pushed(name: str, *numbers: float, **other) -> tuple[float, float]:
    force = effect(name).force
    assert force is not None
    one, two = force(situation(**other), *numbers)
    return float(one), float(two)


@pytest.mark.parametrize(("v", "r"), [(-0.11, 0.0), (0.2, 0.3), (-0.05, 0.6)])
def test_crossflow_drag_is_the_integral_over_the_hull(v: float, r: float) -> None:
    """Where |v + x r| has its kink inside the hull, eight stations are good to 2 % of the whole."""
    drag, trim = 0.12, 0.04

    def section(x: float, arm: float) -> float:
        across = v + x * r
        return -0.5 * 998.0 * (drag + trim * x / 1.33) * abs(across) * across * arm

    force = quad(lambda x: section(x, 1.0), -1.33, 1.33, limit=200)[0]
    moment = quad(lambda x: section(x, x), -1.33, 1.33, limit=200)[0]
    exact = abs(v) > 1.33 * abs(r)
    size = quad(lambda x: abs(section(x, 1.0)), -1.33, 1.33, limit=200)[0]
    found = pushed("crossflow_drag", drag, trim, v_m_s=v, r_rad_s=r)
    assert found[0] == pytest.approx(force, rel=1e-9, abs=1e-12 if exact else 0.02 * size)
    assert found[1] == pytest.approx(moment, rel=1e-9, abs=1e-12 if exact else 0.02 * size * 1.33)


@pytest.mark.parametrize(("v", "r"), [(0.2, 0.03), (-0.11, 0.02)])
def test_a_section_fuller_at_the_ends_drags_as_much_on_a_hull_that_moves_straight_sideways(v: float, r: float) -> None:
    """c d = drag + ends (x^2 - 1/3), x from -1 to 1: its mean is that of ``drag`` alone."""
    drag, ends = 0.12, 0.05
    force, moment = form("crossflow_drag", "fuller at the ends")(situation(v_m_s=v, r_rad_s=0.0), drag, 0.0, ends)
    assert float(force) == pytest.approx(pushed("crossflow_drag", drag, 0.0, v_m_s=v, r_rad_s=0.0)[0], rel=1e-12)
    assert float(moment) == pytest.approx(0.0, abs=1e-12)

    def section(x: float, arm: float) -> float:
        across = v + x * r
        return -0.5 * 998.0 * (drag + ends * ((x / 1.33) ** 2 - 1 / 3)) * abs(across) * across * arm

    found = form("crossflow_drag", "fuller at the ends")(situation(v_m_s=v, r_rad_s=r), drag, 0.0, ends)
    for k, one in enumerate(found):
        assert float(one) == pytest.approx(quad(lambda x, k=k: section(x, x**k), -1.33, 1.33)[0], rel=1e-9)


@pytest.mark.parametrize(
    ("wall", "power", "pull"),
    [
        # at half of the half width: gaps of 1/2 and 3/2
        ("both walls", 1, (2 - 2 / 3) / 2),
        ("both walls", 2, (4 - 4 / 9) / 4),
        ("both walls", 3, (8 - 8 / 27) / 6),
        ("near wall", 1, 2 - 1),
        ("near wall", 2, (4 - 1) / 2),
        ("near wall", 3, (8 - 1) / 3),
    ],
)
def test_bank_suction_by_a_power_of_the_gap(wall: str, power: int, pull: float) -> None:
    force = form("bank_suction", f"{wall}, gap^-{power}")
    size = 998.0 * 1.28**2
    side, moment = force(situation(y_m=1.0, half_width_m=2.0), 0.01, -0.004)
    assert (float(side), float(moment)) == pytest.approx((size * 0.01 * pull, -size * 2.66 * 0.004 * pull), rel=1e-12)
    other = force(situation(y_m=-1.0, half_width_m=2.0), 0.01, -0.004)
    assert (float(other[0]), float(other[1])) == pytest.approx((-float(side), -float(moment)), rel=1e-12)
    near_middle = force(situation(y_m=1e-7, half_width_m=2.0), 0.01, 0.0)[0]
    assert float(near_middle) == pytest.approx(size * 0.01 * 0.5e-7, rel=1e-6)
    # a wall is as near to a section ahead as the heading brings it, and turns a hull that heads for it
    there = form("bank_suction", f"{wall}, gap^-{power}, by sections")
    ahead = there(situation(y_m=0.0, beta_rad=0.5, half_width_m=2.0), 0.01, 0.0, 1 / 1.33, 0.0)
    assert float(ahead[0]) == pytest.approx(float(side), rel=1e-12)
    turned = there(situation(y_m=0.0, beta_rad=0.1, half_width_m=2.0), 0.0, 0.0, 0.0, 0.003)
    assert (float(turned[0]), float(turned[1])) == pytest.approx((0.0, size * 2.66 * 0.003 * 2.66 * 0.1 / 2), rel=1e-12)


@pytest.mark.parametrize("turning", [-0.2, 0.05, 0.3])
def test_a_swivel_rubs_dry_and_as_oil_and_sticks_only_near_rest(turning: float) -> None:
    at = situation(alpha_rate=turning - 0.07)
    side, dry = form("swivel_friction", "")(at, 0.04)
    oiled = form("swivel_friction", "dry, and oil")(at, 0.04, 0.3)[1]
    assert float(side) == 0.0
    # beyond the smoothing of its turning over
    assert float(dry) == pytest.approx(-0.04 * np.sign(turning), rel=1e-9)
    assert float(oiled) == pytest.approx(float(dry) - 0.3 * turning, rel=1e-12)
    sticks = form("swivel_friction", "sticking, and oil")(at, 0.04, 0.0, 0.02)[1]
    assert float(sticks) == pytest.approx(float(dry), rel=5e-3)
    slow = form("swivel_friction", "sticking, and oil")(situation(alpha_rate=0.01 - 0.07), 0.04, 0.0, 0.02)[1]
    assert float(slow) == pytest.approx(-(0.04 + 0.02 * np.exp(-0.25)) * np.tanh(2.5), rel=1e-12)


def test_cubics_by_hand() -> None:
    v, r = -0.11, 0.07
    numbers = (900.0, 300.0, 500.0)
    plain = pushed("cubic_damping", *numbers)
    angled = form("cubic_damping", "by the drift angle")(situation(), *numbers)
    assert [float(one) * 1.28 for one in angled] == pytest.approx(list(plain), rel=1e-12)
    mixed = form("cubic_damping", "with mixed terms")(situation(), *numbers, 40.0, 50.0, 55.0, 60.0, 65.0)
    more = (40 * v * v * r + 55 * v * r * r + 65 * r**3, 50 * v * v * r + 60 * v * r * r)
    assert [float(one) for one in mixed] == pytest.approx([a + b for a, b in zip(plain, more, strict=True)], rel=1e-12)


@pytest.mark.parametrize("speed_m_s", [0.8, 1.28])
def test_a_cable_pushes_alike_at_any_speed(speed_m_s: float) -> None:
    found = form("hull_asymmetry", "a cable's, at any speed")(situation(speed_m_s=speed_m_s), 0.05, -0.02)
    assert [float(one) for one in found] == [0.05, -0.02]


def test_a_ramp_goes_from_one_speed_to_another() -> None:
    ramp = next(e.speed for e in LIBRARY if e.label == "speed_drift/a ramp at 0.5 of the run")
    assert ramp is not None
    at = [float(ramp(situation(t_s=t), 0.04, 2.0, -1.0, 0.01)) for t in (0.0, 22.0, 39.0)]
    assert at == pytest.approx([1.28 * 0.01, 1.28 * 0.03, 1.28 * 0.05], rel=1e-4)


def form(name: str, variant: str) -> Any:
    """The force of one form of an effect."""
    return next(e.force for e in LIBRARY if e.name == name and e.variant == variant)


def test_every_form_of_a_force_is_nothing_where_its_numbers_are() -> None:
    for each in LIBRARY:
        if each.force is not None:
            none = each.force(situation(), *(p.none for p in each.parameters))
            assert [float(one) for one in none] == [0.0, 0.0], each.label


def test_no_two_effects_share_a_label() -> None:
    labels = [each.label for each in LIBRARY]
    assert len(labels) == len(set(labels))


def test_forces_on_the_hull_by_hand() -> None:
    assert pushed("cubic_damping", 900.0, 300.0, 500.0) == pytest.approx(
        (900 * -(0.11**3), 300 * -(0.11**3) + 500 * 0.07**3), rel=1e-12
    )
    assert pushed("hull_asymmetry", 0.05, -0.02) == pytest.approx((0.05 * 1.28**2, -0.02 * 1.28**2), rel=1e-12)
    flow = 0.01 + 0.003 * 0.3
    assert pushed("cross_current", 0.01, 0.003) == pytest.approx((52.87 * flow, 48.51 * flow), rel=1e-12)
    # damping of the velocity a while ago instead of now's
    assert pushed("fluid_memory", 0.3, 0.2, 0.1) == pytest.approx(
        (0.3 * -52.87 * (-0.15 + 0.11), 0.2 * -57.60 * (0.02 - 0.07) + 0.1 * -48.51 * (-0.15 + 0.11)), rel=1e-12
    )
    side, moment = pushed("swivel_friction", 0.05)
    assert side == 0.0
    assert moment == pytest.approx(-0.05, rel=1e-12)  # the line turns over the hull at 0.2 rad/s
    assert pushed("swivel_friction", 0.05, alpha_rate=-0.2)[1] == pytest.approx(0.05, rel=1e-12)


@pytest.mark.parametrize(("late", "wanted"), [(Late(2.0), Late(1.6)), (Late(3.6, 0.3), Late(2.88, 0.45))])
def test_a_memory_follows_faster_as_one_of_a_shorter_time_does(late: Late, wanted: Late) -> None:
    held = np.random.default_rng(3).normal(0, 0.1, late.size)
    assert np.array(late.rates(held, 0.12, -0.05, 0.25, 0.15)) == pytest.approx(
        np.array(wanted.rates(held, 0.12, -0.05))
    )


@pytest.mark.parametrize("share", [0.4, 1.0, 1.7])
def test_a_memory_that_swings_answers_as_a_swing_does(share: float) -> None:
    """A sway to and fro at a share of the memory's own frequency: amplitude and phase of an oscillator of second order."""
    late = Late(3.6, 0.3)
    own = 2 * np.pi / late.time_s
    shaken = share * own

    def rates(t: float, held: np.ndarray) -> np.ndarray:
        return np.array(late.rates(held, np.sin(shaken * t), 0.0))

    t = np.linspace(60.0, 60.0 + 2 * np.pi / shaken, 400)  # what it began with has died away by e^-31
    held = solve_ivp(rates, (0, t[-1]), np.zeros(late.size), t_eval=t, rtol=1e-10, atol=1e-12).y
    answer = 1 / (1 - share**2 + 2j * 0.3 * share)
    np.testing.assert_allclose(held[0], np.imag(answer * np.exp(1j * shaken * t)), atol=1e-8)
    assert np.abs(held[[1, 3]]).max() == 0.0


@pytest.mark.parametrize("variant", ["on a rail", "slips at about 18 s"])
def test_a_point_that_moves_aside_is_followed(variant: str) -> None:
    """The line to the centre line is longer by -Y sin(a+b): T times what a newton does is -L''/cos, by central differences.

    Of a hull without resistance, which grows with the speed by which the model follows.
    """
    each = next(e for e in LIBRARY if e.variant == variant)
    numbers = (0.01,) if variant == "on a rail" else (0.004, 0.01, 20.2)
    assert each.tension is not None

    def angle(t: float) -> float:
        return 0.3 * np.sin(1.3 * t) + 0.05

    def longer(t: float) -> float:
        side = np.sin(angle(t))
        place = (
            numbers[0] * np.tanh(side / 0.1)
            if variant == "on a rail"
            else numbers[0] + numbers[1] * 0.5 * (1 + np.tanh((t - numbers[2]) / 1.0))
        )
        return -place * side

    step = 1e-3
    for t in (1.0, 19.9, 20.3, 21.7):
        now = replace(
            situation(), t_s=t, alpha_rad=angle(t) - 0.1, beta_rad=0.1, gain=0.02, tension_n=4.0, beyond_n=4.0,
            bend_rate=0.39 * np.cos(1.3 * t), bend_rate2=-0.507 * np.sin(1.3 * t),
        )  # fmt: skip
        twice = (longer(t + step) - 2 * longer(t) + longer(t - step)) / step**2
        assert each.tension(now, *numbers) * 0.02 == pytest.approx(-twice / np.cos(angle(t)), rel=1e-4, abs=1e-6)


def test_the_walls_pull_to_the_near_one_and_not_amidships() -> None:
    assert pushed("bank_suction", 0.01, 0.005, y_m=0.0) == (0.0, 0.0)
    near, far = 1 - 0.3 / 2, 1 + 0.3 / 2
    pull = 998.0 * 1.28**2 * 0.25 * (near**-2 - far**-2)
    assert pushed("bank_suction", 0.01, 0.005) == pytest.approx((0.01 * pull, 0.005 * 2.66 * pull), rel=1e-12)
    assert pushed("bank_suction", 0.01, 0.005, y_m=-0.3) == pytest.approx((-0.01 * pull, -0.005 * 2.66 * pull))


def test_tension_and_speed_by_hand() -> None:
    power = effect("tension_variation").tension
    assert power is not None
    assert float(power(situation(), 1.0, 0.0)) == pytest.approx(3.96 * (1 / np.cos(0.2) - 1), rel=1e-12)
    late = -0.2 - 0.3 * 0.13
    assert float(power(situation(), 2.0, 0.3)) == pytest.approx(3.96 * (np.cos(late) ** -2 - 1), rel=1e-12)
    delay = effect("sync_delay").tension
    assert delay is not None
    then, now = 1 + 0.02 * np.sin(3.8), 1 + 0.02 * np.sin(4.0)
    assert float(delay(situation(), 0.2)) == pytest.approx(3.96 * (then / now - 1), rel=1e-12)
    drift = effect("speed_drift").speed
    assert drift is not None
    # over the run a drift of ``share``; the other two have no mean and no line in them (Legendre's second and third)
    at = np.linspace(0, 40, 4001)
    course = np.array([float(drift(situation(t_s=t), 0.02, 0.0, 0.0, 0.0)) for t in (0.0, 20.0, 40.0)])
    assert course == pytest.approx([-0.0128, 0.0, 0.0128], abs=1e-15)
    for numbers in ((0, 0.02, 0, 0), (0, 0, 0.01, 0)):
        values = drift(situation(t_s=at), *numbers)
        assert abs(np.trapezoid(values, at)) < 1e-4 * np.abs(values).max() * 40
        assert abs(np.trapezoid(values * (at - 20), at)) < 1e-4 * np.abs(values).max() * 40 * 20
        assert np.abs(values).max() == pytest.approx(1.28 * max(numbers), rel=1e-12)
    assert float(drift(situation(), 0, 0, 0, 0.005)) == pytest.approx(0.0064, rel=1e-12)


def seen(t_s: np.ndarray, side: np.ndarray, rate: float = 0.05) -> Seen:
    column = t_s[:, None, None]
    zero = np.zeros_like(column)
    shutter = np.zeros((2, len(t_s), 1, 4, 3))
    shutter[0, :, :, 1, 1], shutter[0, :, :, 2, 2], shutter[0, :, :, 3, 2] = 0.4, 0.3, 0.2
    return Seen(
        column, (zero, zero + 0.2, zero + 0.04), (zero, zero + 0.1, zero + rate), side[:, None, None], zero - 0.3,
        np.array([[3.96]]), shutter,
    )  # fmt: skip


def test_a_hull_that_turns_rolls_by_its_own_sway_acceleration_and_not_by_the_tanks() -> None:
    """A circle at constant u and v accelerates in the tank at every moment, in the hull's own axes never: what drives a roll by
    sway acceleration does nothing, what drives it by turning gives r u over the carriage's speed, whatever the heading.
    """
    t, u, v, r, speed = np.linspace(0, 20, 401), 1.1, 0.07, 0.06, 1.28
    heading = r * t - 0.5
    x_rate, y_rate = u * np.cos(heading) - v * np.sin(heading) - speed, u * np.sin(heading) + v * np.cos(heading)
    column = t[:, None, None]
    view = replace(
        seen(t, 0 * t),
        pose=(0 * column, 0 * column, heading[:, None, None]),
        rate=(x_rate[:, None, None], y_rate[:, None, None], r + 0 * column),
        speed_m_s=np.array([[speed]]),
    )
    for own, is_so in zip(view.through_water, (u, v), strict=True):
        np.testing.assert_allclose(own, is_so, atol=1e-12)
    rolling = next(e for e in LIBRARY if e.remembers and len(e.parameters) > 4)
    assert rolling.observe is not None
    by_sway = rolling.observe(view, 0.0, 1.2, 0.3, 0.0, 0.05, 0.0)[1]
    by_turning = rolling.observe(view, 0.0, 1.2, 0.3, 0.0, 0.0, 0.02)[1]
    np.testing.assert_allclose(by_sway, 0.0, atol=1e-12)
    assert by_turning[-1, 0, 0] == pytest.approx(0.02 * r * u / speed, rel=1e-6)


def test_a_roll_with_its_own_period_is_the_damped_oscillator() -> None:
    """Against an adaptive integration; the drive is straight from node to node, as the form has it. A line that keeps its length
    pulls the harder, the more the model's inertia asks of it: what leans the model is all of that, not the straight tow's pull.
    """
    t = np.linspace(0, 12, 121)
    side, tension_n = 0.2 * np.sin(0.9 * t) + 0.05, 3.96 * (1 + 0.4 * np.cos(1.8 * t))
    lean, period, damping, turn = 0.01, 1.2, 0.08, 0.3
    rolling = next(e for e in LIBRARY if e.remembers)
    assert rolling.observe is not None
    view = replace(seen(t, side), beyond_n=tension_n[:, None, None] - 3.96)
    x, y, beta, apart = rolling.observe(view, lean, period, damping, turn)
    w = 2 * np.pi / period

    def swing(at: float, state: np.ndarray) -> list[float]:
        pull = np.interp(at, t, side * tension_n / 3.96)
        return [state[1], w**2 * (lean * pull - state[0]) - 2 * damping * w * state[1]]

    truth = solve_ivp(swing, (0, 12), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-13, max_step=0.02).y[0]
    np.testing.assert_allclose(y[:, 0, 0], truth, atol=1e-8)
    np.testing.assert_allclose(beta[:, 0, 0], turn * truth, atol=1e-8)
    assert not np.any(x)
    assert not np.any(apart)


def test_a_roll_driven_by_sway_and_yaw_follows_a_slow_drive_and_is_the_plain_one_without() -> None:
    t = np.linspace(0, 12, 241)
    side = 0.2 * np.sin(0.3 * t)
    plain = next(e for e in LIBRARY if e.remembers)
    freely = next(e for e in LIBRARY if e.variant == f"{plain.variant}, by sway and yaw too")
    assert plain.observe is not None
    assert freely.observe is not None
    alike = freely.observe(seen(t, side), 0.01, 1.2, 0.1, 0.3, 0.0, 0.0)
    np.testing.assert_array_equal(alike[1], plain.observe(seen(t, side), 0.01, 1.2, 0.1, 0.3)[1])
    # a sideways speed of a t^2: the drive, its acceleration 2 a t, is straight; a quick roll is behind it by 2 zeta / w
    speed = replace(
        seen(t, 0.0 * side, rate=0.0),
        rate=(0.0 * t[:, None, None], 0.02 * t[:, None, None] ** 2, 0.0 * t[:, None, None]),
    )
    period, damping, per_s2 = 0.4, 0.3, 0.05
    rolled = freely.observe(speed, 0.0, period, damping, 0.0, per_s2, 0.0)[1][:, 0, 0]
    behind_s = 2 * damping * period / (2 * np.pi)
    late = t[60:-1]
    np.testing.assert_allclose(rolled[60:-1], per_s2 * 0.04 * (late - behind_s), rtol=0.01)


def test_what_the_camera_sees_by_hand() -> None:
    t = np.linspace(0, 2, 5)
    side = np.full(5, 0.25)
    roll = effect("marker_roll").observe
    assert roll is not None
    x, y, beta, apart = roll(seen(t, side), 0.01, 0.02)
    np.testing.assert_allclose(y, 0.01 * 0.25 + 0.02 * 0.05, rtol=1e-12)
    assert not any(np.any(one) for one in (x, beta, apart))
    shutter = effect("rolling_shutter").observe
    assert shutter is not None
    x, y, beta, apart = shutter(seen(t, side), 0.02)
    for found, truth in ((x, 0.0), (y, 0.02 * 0.4 * 0.1), (beta, 0.02 * 0.3 * 0.05), (apart, 0.02 * 0.2 * 0.05)):
        np.testing.assert_allclose(found, truth, rtol=1e-12)
    stretch = effect("elastic_line").stretch
    assert stretch is not None
    np.testing.assert_allclose(
        stretch(seen(t, side), 0.003, 0.7), 0.003 * 0.7 * 3.96 * (1 / np.cos(0.3) - 1), rtol=1e-12
    )


def test_the_free_forms_are_powers_of_time_place_and_heading() -> None:
    t = np.linspace(0, 8, 5)
    forms = shapes_of(seen(t, np.full(5, 0.1)))
    y, b, at = 0.2 / Y_M, 0.04 / BETA_RAD, t / 4 - 1
    across, turning, side = 0.1 / V_M_S, 0.05 / R_RAD_S, 0.1 / BETA_RAD
    truths = (1.0, at, y, y * y, b, b * b, y * b, across, turning, at * across, at * turning, side)
    for found, truth in zip(forms, truths, strict=True):
        np.testing.assert_allclose(found[:, 0, 0], np.broadcast_to(truth, 5), rtol=1e-12)


@dataclass(frozen=True)
class Tables:
    """The tables of a run.toml that the corrections of the camera touch."""

    camera: CameraTable
    datum: tuple[DatumPoint, ...]
    marker: tuple[Marker, ...]
    tow: TowTable

    def model_copy(self, update: dict[str, Any]) -> Tables:
        return replace(self, **update)


@dataclass(frozen=True)
class Filmed:
    file: Tables


@dataclass(frozen=True)
class Matrix:
    matrix: np.ndarray


def filmed() -> Filmed:
    points = tuple(
        DatumPoint(name=f"d{i}", pixel_px=(100.0 + 50 * i, 90.0), tank_m=place)
        for i, place in enumerate([(0.0, -1.0, 0.0), (0.5, 1.0, 0.0), (-3.0, 1.5, 0.1), (-3.0, -1.5, 0.1)])
    )
    lens = CameraTable(
        image_size_px=(640, 480), fx_px=500.0, fy_px=500.0, cx_px=320.0, cy_px=240.0, distortion=(0.1, 0.02, 0, 0, 0)
    )
    marks = Marker(name="bow", body_m=(1.0, 0.0), depth_m=0.1), Marker(name="stern", body_m=(-1.0, 0.0), depth_m=0.2)
    tow = TowTable(speed_m_s=1.28, line_length_m=0.91, tow_point_m=1.6, tension_n=3.96, post_m=(0.1, 0.2))
    return Filmed(Tables(lens, points, marks, tow))


@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.12, -0.07)])
def test_a_lens_that_bends_about_another_place_is_browns(
    aside: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """a |x - c|^2 (x - c): by hand, against OpenCV's projection with the numbers that the effect gives it; all that differs is
    where and how large the picture is, which the datum tells.
    """
    monkeypatch.setattr(camera, "_datum", lambda *given: given)
    run, bend, (c_x, c_y) = filmed(), 0.03, aside
    straight = replace(
        run, file=replace(run.file, camera=run.file.camera.model_copy(update={"distortion": (0.0,) * 5}))
    )
    off = next(e for e in LIBRARY if e.name == "lens_distortion" and e.variant == "off its middle")
    assert off.correct is not None
    made, _ = off.correct(straight, SimpleNamespace(), bend, -bend * c_y, -bend * c_x)
    x = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 7), np.linspace(-0.4, 0.4, 5)), axis=-1).reshape(-1, 2)
    ahead, still = np.column_stack([x, np.ones(len(x))]), np.zeros(3)
    seen, _ = cv2.projectPoints(ahead, still, still, np.eye(3), np.array(made.file.camera.distortion))
    away = x - [c_x, c_y]
    wanted = x + bend * (away**2).sum(axis=1, keepdims=True) * away
    _, left, *_ = np.linalg.lstsq(ahead, wanted - seen.reshape(-1, 2), rcond=None)
    assert left.max() < 1e-24
    assert np.abs(wanted - x).max() > 0.005


def test_corrections_of_the_camera_change_what_they_name(monkeypatch: pytest.MonkeyPatch) -> None:
    run, fit = filmed(), SimpleNamespace(mapping=Matrix(np.arange(12.0).reshape(3, 4)))
    points = run.file.datum
    monkeypatch.setattr(camera, "_datum", lambda *given: given)

    def corrected(name: str, *numbers: float):
        correct = effect(name).correct
        assert correct is not None
        return correct(run, fit, *numbers)

    made, mapping = corrected("lens_distortion", 0.03)
    assert made.file.camera.distortion == pytest.approx((0.13, 0.02, 0, 0, 0))
    assert mapping == (made.file.camera, points, (0.1, 0.2))
    with_k2 = next(e for e in LIBRARY if e.name == "lens_distortion" and e.variant == "with k2")
    assert with_k2.correct is not None
    assert with_k2.correct(run, fit, 0.03, -0.05)[0].file.camera.distortion == pytest.approx((0.13, -0.03, 0, 0, 0))
    made, mapping = corrected("deck_height", 0.015)
    assert [m.depth_m for m in made.file.marker] == pytest.approx([0.115, 0.215])
    assert mapping is fit.mapping
    made, mapping = corrected("datum_scale", 0.01)
    for before, after in zip(points, made.file.datum, strict=True):
        assert after.tank_m == pytest.approx((before.tank_m[0] * 1.01, before.tank_m[1] * 1.01, before.tank_m[2]))
    assert mapping[1] == made.file.datum
    made, mapping = corrected("datum_bias", 0.006, -0.003)
    assert made.file.tow.post_m == pytest.approx((0.106, 0.197))
    assert mapping is fit.mapping
    made, mapping = corrected("camera_shift", 0.001, -0.002, 0.003)
    turn = Rotation.from_rotvec([0.001, -0.002, 0.003]).as_matrix()
    np.testing.assert_allclose(mapping.matrix, turn @ fit.mapping.matrix, rtol=1e-14)
    assert made is run


SCENARIO = {
    "name": "a",
    "time": {"duration_s": 40.0, "rate_hz": 10.0},
    "hull": {
        "speed_m_s": 1.28, "m_minus_y_vdot": 149.19, "i_minus_n_rdot": 62.11, "y_v": -52.87, "y_r_minus_mu": -66.33,
        "n_v": -48.51, "n_r": -57.60,
    },
    "tow": {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": 1.6, "tension_n": 3.96},
    "start": {"y_cg_m": 0.0},
    "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
    "water": {"tank_width_m": 4.0, "density_kg_m3": 998.0},
}  # fmt: skip


def scenario(*effects: tuple[str, dict[str, float]]) -> ScenarioFile:
    given = SCENARIO | {"effect": [{"name": name, "numbers": numbers} for name, numbers in effects]}
    return check_tables(given, ScenarioFile, Path("scenario.toml"))


def test_the_simulator_pushes_with_the_same_force() -> None:
    """``towline simulate`` with [[effect]] tables: the added force at a state is the effects' own at that situation."""
    sizes = {
        "crossflow_drag": {"drag_depth_m": 0.12, "trim_depth_m": 0.04},
        "cross_current": {"current_m_s": 0.01, "shear_1_s": 0.003},
        "hull_asymmetry": {"y_star_n_s2_m2": 0.05, "n_star_n_m_s2_m2": -0.02},
        "cubic_damping": {"y_vvv": 900.0, "n_vvv": 300.0, "n_rrr": 500.0},
        "bank_suction": {"suction_m2": 0.01, "moment_m2": 0.005},
        "swivel_friction": {"moment_n_m": 0.05},
    }
    t, y, beta, v, r, alpha = 4.0, 0.3, 0.08, -0.003, 0.002, -0.2
    rate = float(line_angle_rate(TOW, beta, v, r, np.cos(alpha + beta)))
    moved = full_rates(t, (np.array(alpha), np.array(beta), np.array(v), np.array(r)), HULL, TOW)
    assert rate == pytest.approx(float(moved[0]), rel=1e-12)
    at = {"t_s": t, "y_m": y, "beta_rad": beta, "v_m_s": v, "r_rad_s": r, "alpha_rad": alpha, "alpha_rate": rate}
    total = np.zeros(2)
    for name, numbers in sizes.items():
        file = scenario((name, numbers))
        same_hull, same_tow, extra = with_effects(HULL, TOW, effects_of(file, Path("s.toml")), file)
        assert (same_hull, same_tow) == (HULL, TOW)
        assert extra is not None
        alone = extra(t, y, beta, v, r, alpha)
        assert alone == pytest.approx(pushed(name, *numbers.values(), **at), rel=1e-12)
        total += alone
    file = scenario(*sizes.items())
    extra = with_effects(HULL, TOW, effects_of(file, Path("s.toml")), file)[2]
    assert extra is not None
    assert extra(t, y, beta, v, r, alpha) == pytest.approx(tuple(total), rel=1e-12)
    # a change of tension pulls along the line: its side part, and that on the tow point's arm
    file = scenario(("tension_variation", {"power": 1.0}))
    extra = with_effects(HULL, TOW, effects_of(file, Path("s.toml")), file)[2]
    assert extra is not None
    side = -3.96 * (1 / np.cos(alpha) - 1) * np.sin(alpha + beta)
    assert extra(t, y, beta, v, r, alpha) == pytest.approx((side, 1.6 * side), rel=1e-12)


def test_the_simulator_takes_couplings_lines_and_offsets() -> None:
    file = scenario(
        ("added_mass_coupling", {"y_rdot": -4.0, "n_vdot": 3.0}),
        ("elastic_line", {"compliance_m_n": 0.003}),
        ("tow_point_offset", {"offset_m": 0.005}),
    )
    changed, longer, extra = with_effects(HULL, TOW, effects_of(file, Path("s.toml")), file)
    assert extra is None
    assert (changed.y_rdot, changed.n_vdot) == (-4.0, 3.0)
    assert longer.line_length_m == pytest.approx(0.91 + 0.003 * 3.96, rel=1e-14)
    assert longer.tow_point_offset_m == 0.005
    same = {f.name for f in fields(Tow)} - {"line_length_m", "tow_point_offset_m"}
    assert all(getattr(longer, name) == getattr(TOW, name) for name in same)


def test_a_free_force_has_each_of_its_shapes_for_side_and_for_moment() -> None:
    """What is another after some time: nothing long before it, all of the motion long after; the rest are odd or even as named."""
    effects = {e.name.removeprefix("unknown force").strip(): e for e in free_forms(1, ()) if e.force is not None}
    s = situation(v_m_s=np.array([[-0.11]]), r_rad_s=np.array([[0.07]]))

    def shapes(kind: str, at: Situation) -> np.ndarray:
        force, count = effects[kind].force, len(effects[kind].parameters) // 2
        assert force is not None
        sides, moments = zip(*(force(at, *np.eye(2 * count)[k]) for k in range(2 * count)), strict=True)
        whole = np.array([[float(np.squeeze(x)) for x in one] for one in (sides, moments)])
        # a number of the side force pushes sideways alone, one of the moment turns alone, and both have the same shapes
        np.testing.assert_array_equal(whole[0, count:], 0.0)
        np.testing.assert_array_equal(whole[1, :count], 0.0)
        np.testing.assert_array_equal(whole[0, :count], whole[1, count:])
        return whole[0, :count]

    motion = [1.0, -0.11 / V_M_S, 0.07 / R_RAD_S, (-0.2 + 0.08) / BETA_RAD]
    end = replace(s, t_s=1e4, duration_s=1e4)
    np.testing.assert_allclose(shapes("changed", end), motion * len(CHANGES), rtol=1e-12)
    np.testing.assert_allclose(shapes("changed", replace(end, t_s=0.0)), 0.0, atol=1e-12)
    middle = shapes("changed", replace(end, t_s=CHANGES[1] * 1e4))  # the second change is half done
    np.testing.assert_allclose(
        middle, [*motion, *(0.5 * np.array(motion)), *[0.0] * 4 * (len(CHANGES) - 2)], atol=1e-12
    )
    y, b = 0.3, 0.08
    waves = [f(2 * np.pi * k * y) for k in ACROSS_PER_M for f in (np.sin, np.cos)]
    waves += [f(2 * np.pi * k * b) for k in TURNED_PER_RAD for f in (np.sin, np.cos)]
    np.testing.assert_allclose(shapes("placed", s), waves, rtol=1e-12)
    here = shapes("", s)
    there = shapes("", replace(s, y_m=-0.3, beta_rad=-0.08, v_m_s=-s.v_m_s, r_rad_s=-s.r_rad_s))
    even = [0, 1, 11]  # constant, time, beta^2; all others are odd in the motion
    np.testing.assert_allclose(there[even], here[even], rtol=1e-12)
    odd = [k for k in range(len(here)) if k not in even]
    np.testing.assert_allclose(there[odd], -here[odd], rtol=1e-12)
    assert here[0] == 1.0
    assert here[1] == pytest.approx(2 * 4 / 40 - 1)
    assert here[4] == pytest.approx((y / Y_M) ** 3)
    assert here[11] == pytest.approx((b / BETA_RAD) ** 2)
    side = 3.96 * np.sin(-0.2 + 0.08) / SIDE_N
    np.testing.assert_allclose(
        shapes("drawn", s), [side, side * abs(side), side**3, (2 * 4 / 40 - 1) * side], rtol=1e-12
    )
    lagged = replace(s, v_lag=np.array([[-0.16]]), r_lag=np.array([[0.05]]))
    np.testing.assert_allclose(shapes("remembered", lagged), [-0.05 / V_M_S, -0.02 / R_RAD_S], rtol=1e-12)


def test_a_push_that_comes_once_is_in_its_runs_and_at_its_time() -> None:
    """Of the mean that its numbers say, over its stretch; nothing before and after, and nothing in the run between."""
    (push,) = one_off(["a", "b", "c"], [Push(0, 10.0, 12.0, 1.0), Push(2, 20.0, 21.0, 2.0)])
    assert push.force is not None
    assert (push.variant, push.cost) == ("in a at 11.0 s, in c at 20.5 s", 3.0)
    t_s = np.arange(0.0, 40.0, 0.01)[:, None, None] + 0.005
    side, moment = push.force(situation(t_s=t_s), 0.3, -0.1, 0.2, 0.4)
    for found, sizes in ((side, (0.3, 0.0, 0.2)), (moment, (-0.1, 0.0, 0.4))):
        impulse = found[..., 0].sum(axis=0) * 0.01
        np.testing.assert_allclose(impulse, np.array(sizes) * [2.0, 0.0, 1.0], atol=1e-6)
        outside = ((t_s < 10) | (t_s > 12))[:, 0, 0]
        assert np.abs(found[outside, 0]).max() < 1e-30
    assert one_off(["a"], []) == ()


def test_a_shake_is_each_runs_own() -> None:
    """Numbers: sine and cosine of side force, moment, x, y, post, run after run, and one frequency's error for all."""
    shake = next(e for e in free_forms(3, (0.5,)) if e.name == "unknown shake")
    assert shake.force is not None
    assert shake.observe is not None
    count = len(shake.parameters)
    assert count == 3 * 10 + 1
    numbers = np.zeros(count)
    numbers[10 + 2], numbers[20 + 5], numbers[6], numbers[-1] = 0.3, 0.002, 0.004, 0.1
    t = 0.7
    side, moment = shake.force(situation(t_s=t), *numbers)
    wave = 2 * np.pi * 0.6 * t
    np.testing.assert_allclose(np.ravel(side), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.ravel(moment), [0.0, 0.3 * np.sin(wave), 0.0], atol=1e-15)
    zero = np.zeros((1, 3, 1))
    shown = Seen(
        zero + t,
        (zero, zero, zero),
        (zero, zero, zero),
        zero,
        zero - 0.3,
        np.full((3, 1), 3.96),
        np.zeros((1, 3, 4, 3)),
    )
    x, y, beta, apart = shake.observe(shown, *numbers)
    np.testing.assert_allclose(np.ravel(x), [0.0, 0.0, 0.002 * np.cos(wave)], atol=1e-15)
    np.testing.assert_allclose(np.ravel(y), [0.004 * np.sin(wave), 0.0, 0.0], atol=1e-15)
    assert not np.any(beta)
    assert not np.any(apart)
    numbers = np.zeros(count)
    numbers[8] = 0.01  # the first run's post, to starboard: it draws a model ahead that swings to port, at -0.3 rad
    x, *_ = shake.observe(shown, *numbers)
    np.testing.assert_allclose(np.ravel(x), [np.sin(0.3) * 0.01 * np.sin(2 * np.pi * 0.5 * t), 0, 0], atol=1e-15)


def test_a_post_that_shakes_makes_the_line_pull_as_another_program_says() -> None:
    """Model and line before a post that shakes, less the same at rest, by the blind check's own equations."""
    hz, size, phase, x_t = 0.35, 0.005, 0.4, 1.548
    at_rest = {**MARINER, "speed": 1.28, "duration": 45.0, "x_t": x_t, "y_release": 0.3}
    shaken = {"carriage_shake.size_m": size, "carriage_shake.rate_hz": hz, "carriage_shake.phase": phase}
    path = swim([at_rest, {**at_rest, **shaken}], 30.0)
    late = path.t_s > RUNG_OUT_S
    x, y, b, _, v, r = path.states[late, :6, 0].T
    alpha = np.arctan2(y + x_t * np.sin(b), -x - x_t * np.cos(b))
    hull = replace(HULL, mass_kg=78.0, x_udot_kg=-4.0)
    tow, state = Tow(1.28, 0.91, x_t, 3.96, line="surge"), (alpha, b, v, r)
    taut = full_state(path.t_s[late], state, hull, tow)
    # what the line pulls more to the side, as far as the post has moved, is a force of the shake's own
    aside = taut.tension_n * size * np.sin(2 * np.pi * hz * path.t_s[late] + phase) * np.cos(alpha) / 0.91
    side = aside * np.cos(alpha + b)
    answered = full_state(path.t_s[late], state, hull, tow, lambda *_: (side, x_t * side)).tension_n - taut.tension_n
    shake = next(e for e in free_forms(1, (hz,)) if e.name == "unknown shake")
    assert shake.tension is not None
    numbers = np.zeros(len(shake.parameters))
    numbers[8:10] = size * np.cos(phase), size * np.sin(phase)
    here = situation(
        t_s=path.t_s[late],
        alpha_rad=alpha,
        beta_rad=b,
        alpha_rate=np.gradient(alpha, path.t_s[late]),
        tension_n=path.tension_n[late, 0],
        beyond_n=path.tension_n[late, 0] - 3.96,
        gain=taut.gain,
    )
    found = np.ravel(shake.tension(here, *numbers)) + answered
    wanted = path.tension_n[late, 1] - path.tension_n[late, 0]
    # what is left: the tow point swings against the post, by (1/m + X_T^2/I) 0.07 N over omega^2 = 0.6 mm, a ninth of its 5 mm
    assert np.std(found - wanted) < 0.15 * np.std(wanted)
    assert np.polyfit(found, wanted, 1)[0] == pytest.approx(1.0, abs=0.12)


def test_without_a_tension_history_a_delay_of_its_log_does_nothing() -> None:
    file = scenario(("sync_delay", {"delay_s": 0.3}))
    extra = with_effects(HULL, TOW, effects_of(file, Path("s.toml")), file)[2]
    assert extra is not None
    assert extra(4.0, 0.3, 0.08, -0.1, 0.07, -0.2) == pytest.approx((0.0, 0.0), abs=1e-15)


def test_what_an_effect_takes_from_the_tension_acts_where_the_line_does() -> None:
    """At X_T and Y_T, as the equation of motion has it."""
    loose = effect("tension_variation")
    assert loose.tension is not None
    at = situation()
    change = loose.tension(at, *(p.sd for p in loose.parameters))
    assert change != 0
    angle = at.alpha_rad + at.beta_rad
    tow = Tow(1.28, 0.91, 1.6, 3.96, tow_point_offset_m=0.05)
    file = scenario((loose.name, {p.name: p.sd for p in loose.parameters}))
    extra = with_effects(HULL, tow, effects_of(file, Path("s.toml")), file)[2]
    assert extra is not None
    state = at.t_s, at.y_m, at.beta_rad, at.v_m_s, at.r_rad_s, at.alpha_rad
    turning = line_angle_rate(tow, at.beta_rad, at.v_m_s, at.r_rad_s, np.cos(angle))
    wanted = line_force(
        tow,
        loose.tension(replace(at, alpha_rate=turning), *(p.sd for p in loose.parameters)),
        np.sin(angle),
        np.cos(angle),
    )
    np.testing.assert_allclose(extra(*state), wanted, rtol=1e-10)
