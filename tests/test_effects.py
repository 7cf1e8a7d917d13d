"""The effects' forms against closed forms and integrals by other means, and in the simulator as in the diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from towline.diagnose.effects import LIBRARY, Effect, Seen, Situation, camera
from towline.diagnose.simulated import effects_of, with_effects
from towline.diagnose.tow.unknown import (
    ACROSS_PER_M,
    BETA_RAD,
    CHANGES,
    R_RAD_S,
    TURNED_PER_RAD,
    V_M_S,
    Y_M,
    free_forms,
    shapes_of,
)
from towline.record.scenario import ScenarioFile
from towline.record.schema import CameraTable, DatumPoint, Marker, TowTable
from towline.record.toml import check_tables
from towline.simulate.model import Hull, Tow, full_rates, line_angle_rate, line_force

STATE = {
    "t_s": 4.0, "y_m": 0.3, "beta_rad": 0.08, "v_m_s": -0.11, "r_rad_s": 0.07, "alpha_rad": -0.2, "speed_m_s": 1.28,
    "line_length_m": 0.91, "tow_point_m": 1.6, "tension_n": 3.96, "alpha_rate": 0.13, "length_pp_m": 2.66,
    "density_kg_m3": 998.0, "half_width_m": 2.0, "v_lag": -0.15, "r_lag": 0.02, "duration_s": 40.0, "y_v": -52.87,
    "n_v": -48.51, "n_r": -57.60, "history": lambda t_s: 1.0 + 0.02 * np.sin(t_s),
}  # fmt: skip
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
    shutter = np.zeros((len(t_s), 1, 4, 3))
    shutter[:, :, 1, 1], shutter[:, :, 2, 2], shutter[:, :, 3, 2] = 0.4, 0.3, 0.2
    return Seen(
        column, (zero, zero + 0.2, zero + 0.04), (zero, zero + 0.1, zero + rate), side[:, None, None], zero - 0.3,
        np.array([[3.96]]), shutter,
    )  # fmt: skip


def test_a_roll_with_its_own_period_is_the_damped_oscillator() -> None:
    """Against an adaptive integration; the drive is straight from node to node, as the form has it."""
    t = np.linspace(0, 12, 121)
    side = 0.2 * np.sin(0.9 * t) + 0.05
    lean, period, damping, turn = 0.01, 1.2, 0.08, 0.3
    rolling = next(e for e in LIBRARY if e.remembers)
    assert rolling.observe is not None
    x, y, beta, apart = rolling.observe(seen(t, side), lean, period, damping, turn)
    w = 2 * np.pi / period

    def swing(at: float, state: np.ndarray) -> list[float]:
        return [state[1], w**2 * (lean * np.interp(at, t, side) - state[0]) - 2 * damping * w * state[1]]

    truth = solve_ivp(swing, (0, 12), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-13, max_step=0.02).y[0]
    np.testing.assert_allclose(y[:, 0, 0], truth, atol=1e-8)
    np.testing.assert_allclose(beta[:, 0, 0], turn * truth, atol=1e-8)
    assert not np.any(x)
    assert not np.any(apart)


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
    forms = shapes_of(seen(t, np.zeros(5)))
    y, b, at = 0.2 / Y_M, 0.04 / BETA_RAD, t / 4 - 1
    for found, truth in zip(forms, (1.0, at, y, y * y, b, b * b, y * b), strict=True):
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


def test_corrections_of_the_camera_change_what_they_name(monkeypatch: pytest.MonkeyPatch) -> None:
    points = tuple(
        DatumPoint(name=f"d{i}", pixel_px=(100.0 + 50 * i, 90.0), tank_m=place)
        for i, place in enumerate([(0.0, -1.0, 0.0), (0.5, 1.0, 0.0), (-3.0, 1.5, 0.1), (-3.0, -1.5, 0.1)])
    )
    lens = CameraTable(
        image_size_px=(640, 480), fx_px=500.0, fy_px=500.0, cx_px=320.0, cy_px=240.0, distortion=(0.1, 0.02, 0, 0, 0)
    )
    marks = Marker(name="bow", body_m=(1.0, 0.0), depth_m=0.1), Marker(name="stern", body_m=(-1.0, 0.0), depth_m=0.2)
    tow = TowTable(speed_m_s=1.28, line_length_m=0.91, tow_point_m=1.6, tension_n=3.96, post_m=(0.1, 0.2))
    run, fit = Filmed(Tables(lens, points, marks, tow)), SimpleNamespace(mapping=Matrix(np.arange(12.0).reshape(3, 4)))
    monkeypatch.setattr(camera, "_datum", lambda *given: given)

    def corrected(name: str, *numbers: float):
        correct = effect(name).correct
        assert correct is not None
        return correct(run, fit, *numbers)

    made, mapping = corrected("lens_distortion", 0.03)
    assert made.file.camera.distortion == pytest.approx((0.13, 0.02, 0, 0, 0))
    assert mapping == (made.file.camera, points, (0.1, 0.2))
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
    numbers[8] = 0.01  # the first run's post, to starboard: a taut line at -0.3 rad then draws the model back
    x, *_ = shake.observe(shown, *numbers)
    np.testing.assert_allclose(np.ravel(x), [np.sin(-0.3) * 0.01 * np.sin(2 * np.pi * 0.5 * t), 0, 0], atol=1e-15)


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
