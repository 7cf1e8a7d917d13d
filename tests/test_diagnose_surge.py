"""The diagnosis of tows on a line that keeps its length: nothing but surge is no gap, what is stated is not blamed."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq

from towline.blind.one_case import case_of
from towline.blind.truth.folders import write_case
from towline.diagnose.effects import LAWS, LIBRARY
from towline.diagnose.effects.slack_line import springing
from towline.diagnose.gap import Diagnosis, diagnosed
from towline.diagnose.inference.evidence import CONVERGED_GAIN
from towline.diagnose.inference.hypothesis import Hypothesis
from towline.diagnose.law.terms import effect_of
from towline.diagnose.simulated import effects_of, with_effects
from towline.diagnose.tow.channels import CHANNELS
from towline.diagnose.tow.data import Recorded, block_step, tow_runs
from towline.diagnose.tow.tow_run import TowRun
from towline.diagnose.tow.towed import TowSimulator
from towline.pipeline.diagnosing import diagnose_folders
from towline.record import Run, RunFile
from towline.record.scenario import ScenarioFile
from towline.record.toml import check_tables
from towline.simulate import DERIVATIVE_UNITS, Histories, Hull, Start, Tow, simulate_full, simulate_scenario
from towline.simulate.model import ExtraForce, Line, full_y_cg

HULL = Hull(
    149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-4.0, x_vr_kg=40.0,
    y_delta=3.0, n_delta=-3.5,
)  # fmt: skip
R_N, LINE_M, HERTZ, DURATION_S = 3.96, 0.91, 25, 45.0
SD = np.array([1e-3, np.radians(0.1)])
DESIGN = ((1.446, 0.20, 1.28), (1.548, -0.25, 1.28), (1.649, 0.30, 1.28), (1.751, 0.20, 0.9))
"""Tow point, y at release, speed: swings of 12 to 19 degrees."""


def motion_of(
    name: str, motion: pd.DataFrame, tow: dict[str, Any], rng: np.random.Generator | None, **more: Any
) -> TowRun:
    """A run that came as motion, with noise, as run.toml states it."""
    n = len(motion)
    noise = np.zeros((n, 2)) if rng is None else rng.normal(size=(n, 2)) * SD
    table = pd.DataFrame(
        {
            "t_s": motion["t_s"],
            "y_cg_m": motion["y_cg_m"] + noise[:, 0],
            "beta_rad": motion["beta_rad"] + noise[:, 1],
            "alpha_rad": np.nan,
            "sigma_y_cg_m": SD[0],
            "sigma_beta_rad": SD[1],
            "status": "measured",
        }
    )
    content = {
        "name": name,
        "source": {"motion": "motion.csv"},
        "tow": tow,
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"density_kg_m3": 1000.0, "tank_width_m": 4.6},
    } | more
    run = Run(Path(), check_tables(content, RunFile, Path("run.toml")))
    return tow_runs([Recorded(run, table)], block_step([DURATION_S]))[0]


def campaign(seed: int, line: Line = "surge", rudder_rad: float = 0.0, push: ExtraForce | None = None) -> list[TowRun]:
    """Four tows; run.toml states the rudder, and that the line keeps its length, whatever it does."""
    rng, runs, t_s = np.random.default_rng(seed), [], np.arange(int(DURATION_S * HERTZ)) / HERTZ
    for point, across, speed in DESIGN:
        pull = R_N * (speed / 1.28) ** HULL.resistance_exponent
        tow = Tow(speed, LINE_M, point, pull, rudder_rad=rudder_rad, line=line)
        motion = simulate_full(HULL, tow, Start(y_cg_m=across), t_s, extra=push)
        stated = {"speed_m_s": speed, "line_length_m": LINE_M, "tow_point_m": point, "tension_n": pull}
        runs.append(motion_of(f"x{point}", motion, stated | {"rudder_rad": rudder_rad}, rng))
    return runs


def found_in(runs: list[TowRun]) -> Diagnosis:
    return diagnosed(TowSimulator(runs), LIBRARY, "t", {}, rng=np.random.default_rng(1))


def within(found: Diagnosis, truth: Hull, sds: float = 4.0) -> None:
    """The six at their truth, by what they say of themselves."""
    for name, told in list(found.file.derivatives["before"].items())[:6]:
        assert abs(told.value - getattr(truth, name)) < sds * told.std, name


def test_tows_that_hold_nothing_but_surge_have_no_gap() -> None:
    """X_vr = 40 kg, swings to 19 degrees: no gap, and the six are the truth at the speed they are quoted at."""
    runs = campaign(1)
    found = found_in(runs)
    assert found.file.verdict == "no_gap"
    assert found.file.p_no_gap > 0.6
    simulator = found.inference.simulator
    assert isinstance(simulator, TowSimulator)
    within(found, HULL.at_speed(simulator.speed_m_s))
    # runs that came as motion, of which no line is seen, are followed by a run, too
    assert found.file.next_run is not None
    # m is weighed by such swings: no tension need be known for the derivatives' scale
    assert ["tension scale", "all derivatives together"] not in found.file.indistinguishable


@pytest.mark.slow
def test_films_of_tows_on_a_stiff_spring_have_no_gap(shared: Path) -> None:
    """Motions integrated by other code, with the marks' noise on them; small swings leave the scale to the load cell."""
    rng, runs = np.random.default_rng(7), []
    truth = json.loads((shared / "film_campaign" / "truth.json").read_text())
    for folder in sorted((shared / "film_campaign").glob("run-*")):
        table = tomllib.loads((folder / "run.toml").read_text())
        motion = pd.read_csv(folder / "truth.csv", comment="#")
        stated = {k: table["tow"][k] for k in ("speed_m_s", "line_length_m", "tow_point_m", "tension_n")}
        model = {k: table["model"][k] for k in ("length_pp_m", "mass_kg")}
        runs.append(motion_of(folder.name, motion, stated, rng, model=model))
    found = found_in(runs)
    assert found.file.verdict == "no_gap"
    wanted = {k: truth[k] for k in DERIVATIVE_UNITS}
    within(found, Hull(**wanted, speed_m_s=truth["at_speed_m_s"]))
    assert ["tension scale", "all derivatives together"] in found.file.indistinguishable


@pytest.mark.slow
def test_a_rudder_that_is_stated_is_not_blamed() -> None:
    """15 degrees in every run, Y_delta and N_delta free: no asymmetry, no current, no offset."""
    found = found_in(campaign(3, rudder_rad=float(np.radians(15))))
    assert found.file.verdict == "no_gap"
    names = list(found.file.derivatives["before"])
    assert names[-2:] == ["y_delta", "n_delta"]


@pytest.mark.slow
def test_a_line_that_a_weight_keeps_at_one_tension_is_told_from_surge() -> None:
    """Two motions at constant T, one of them slow, said to be on a line that keeps its length."""
    file = found_in(campaign(4, line="constant")[-2:]).file
    assert file.verdict == "effect"
    assert file.ranking[0].effects in (["constant_tension"], ["tension_variation"])
    kept = next(row for row in file.ranking if row.effects == ["constant_tension"])
    share = kept.parameters["constant_tension.share"]
    # such motions take u = U in the hull's forces, a part of the effect's own form
    assert share.value == pytest.approx(1.0, abs=4 * share.std + FORM)


FORM = 0.05


@pytest.mark.once
@pytest.mark.parametrize("planted", ["crossflow_drag", "none", "deck_height", "constant_tension"])
def test_a_planted_effect_is_named_on_top_of_surge(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], planted: str, tmp_path: Path
) -> None:
    """Filmed campaigns: a camera's fault, a hull's force, a line that does not keep its length. Four tows, the short line and the
    slow speed among them, have less to tell it by than all six.
    """
    runs = cases.campaign(planted, np.random.default_rng([11, 5]), line="surge").runs[-4:]
    file = diagnose_folders(write_runs(runs, tmp_path, 26.0)).diagnosis.file  # the swings have died away by then
    assert file.verdict == ("no_gap" if planted == "none" else "effect")
    if planted != "none":
        assert file.ranking[0].effects == [planted]


def stated(**more: Any) -> TowRun:
    """A run of 45 s that states ``more`` of its tow."""
    tow = {"speed_m_s": 1.28, "line_length_m": LINE_M, "tow_point_m": 1.548, "tension_n": R_N}
    motion = simulate_full(HULL, Tow(1.28, LINE_M, 1.548, R_N, line="surge"), Start(y_cg_m=0.2), TIMES_S)
    return motion_of("stated", motion, tow | more, None)


TIMES_S = 2.0 + np.arange(int(DURATION_S * HERTZ)) / HERTZ
STATED = {
    "rudder": ({"rudder_rad": 0.2}, {}),
    "offset": ({"tow_point_offset_m": 0.05}, {}),
    "forced": ({"post_amplitude_m": 0.1, "post_frequency_hz": 0.05, "post_phase_rad": 0.4}, {}),
    "constant": ({"line": "constant", "rudder_rad": 0.2}, {}),
    "speed": ({}, {"speed_m_s": lambda t: 1.28 + 0.02 * np.sin(0.3 * t)}),
    "constant, speed": ({"line": "constant"}, {"speed_m_s": lambda t: 1.28 + 0.02 * np.sin(0.3 * t)}),
}


@pytest.mark.slow
def test_a_base_that_cannot_follow_stands_where_its_steps_end(tmp_path: Path) -> None:
    """A film 3 % too slow beside a load cell, by the blind check's equations: where the first fit led, the next step promised 9,973
    more and none gained; scores of such a place name anything.
    """
    case = case_of("case", "effect", ["frame_rate"], [7, 0], False, forms={"frame_rate": "off"})
    case = replace(case, history=True, runs=case.runs[:2], duration_s=30.0, numbers={"frame_rate.fast": -0.03})
    others = sorted({e.name for e in LIBRARY} - {"frame_rate", "sync_delay"})
    found = diagnose_folders(write_case(tmp_path / "case", case), without=others).diagnosis
    assert found.ranking.base.promised < CONVERGED_GAIN
    assert found.file.verdict == "effect"
    assert found.file.ranking[0].effects == ["frame_rate"]


@pytest.mark.once
@pytest.mark.parametrize("name", STATED)
def test_every_stated_input_moves_the_simulated_side(name: str) -> None:
    """Against DOP853 at 1e-10: means over blocks to a hundredth of a millimetre and of a milliradian."""
    more, histories = STATED[name]
    run = stated(**more)
    tow = replace(run.data.tow, line=run.data.tow.line)
    if histories:
        course = np.arange(0, 60, 0.02)
        told = (course, histories["speed_m_s"](course))
        mean = float(np.interp(run.data.t_s, *told).mean())
        tow = replace(tow, speed_m_s=mean)
        run = replace(run, data=replace(run.data, speed=told, tow=tow))
    model = TowSimulator([run])
    start = Start(alpha_rad=0.2, beta_rad=0.02, v_m_s=-0.02, r_rad_s=0.01)
    truth = simulate_full(HULL, tow, start, run.data.t_s, histories=Histories(**histories))
    own = np.array([[0.2, 0.02, -0.02, 0.01, 0.0, 0.0, R_N, 1.548, LINE_M, tow.speed_m_s, 0, 0]])
    shared = np.array([getattr(HULL.at_speed(model.speed_m_s), n) for n in model.shared_names])
    values = model.values([Hypothesis(shared, own)])[0][0]
    block = np.floor((run.data.t_s - run.start_s) / run.step_s + 1e-9).astype(int)
    inside = block < len(run.centre_s)
    for channel, column in enumerate(("y_cg_m", "beta_rad")):
        mean = np.bincount(block[inside], truth[column].to_numpy()[inside]) / np.bincount(block[inside])
        assert np.abs(values[:, channel] - mean).max() < STEPPED, channel


STEPPED = 2e-5
"""m and rad: steps of a twelfth of a second and means by polynomials (``test_diagnose``: a twentieth of a mean's noise)."""
RESISTS = effect_of("|r|^2.5", "X", sd=(0.0, 0.0, 0.03))
"""Of R's size where the yaw rate is 0.1."""
BOUNCING = springing(lambda t_s: 2e-3 * np.sin(1.5 * np.asarray(t_s)) + np.zeros((2, 1)), "a slow bounce", 0.0, 0.0)
"""It changes the line's length and its pull."""
PUSHED = (
    *(
        next(e for e in LIBRARY if e.label == label)
        for label in (
            "crossflow_drag",
            "constant_tension",
            "tension_variation/instead of the line's length",
            "elastic_line",
            "speed_drift",
            "swivel_friction",
            "added_mass_coupling",
            "tow_point_offset",
        )
    ),
    BOUNCING,
    RESISTS,
)


@pytest.mark.slow
def test_slopes_on_a_line_that_keeps_its_length_are_differences_of_motions() -> None:
    """Every number of surge and of effects, against central differences of motions."""
    runs = [stated(), replace(stated(rudder_rad=0.1), name="other")]
    model = TowSimulator(runs)
    own = np.array([[0.2, 0.02, -0.02, 0.01, 0, 0, R_N, 1.548, LINE_M, 1.28, 0, 0]] * 2)
    shared = np.array([getattr(HULL, n) for n in model.shared_names])
    sizes = tuple(np.array([p.none + 0.3 * p.sd for p in e.parameters]) for e in PUSHED)
    found = model.linear([Hypothesis(shared, own, PUSHED, sizes)])[0]
    h = Hypothesis(shared, own, PUSHED, sizes, found.path)
    slopes = np.array([slope[:, :2] for _, slope in found.rows])
    sd = 0.1 * np.where(np.isfinite(model._shared.sd), model._shared.sd, np.abs(shared))
    moved = [
        (k, 0.02 * sd[k], [replace(h, shared=shared + sign * 0.02 * sd[k] * one) for sign in (1, -1)])
        for k, one in enumerate(np.eye(len(shared)))
    ]
    at = len(shared) + own.shape[1]
    for index, effect in enumerate(PUSHED):
        for k, parameter in enumerate(effect.parameters):
            step, both = 0.01 * parameter.sd, []
            for sign in (1, -1):
                numbers = [n.copy() for n in sizes]
                numbers[index][k] += sign * step
                both.append(replace(h, numbers=tuple(numbers)))
            moved.append((at, step, both))
            at += 1
    values = iter(model.values([one for *_, both in moved for one in both]))
    for column, step, _ in moved:
        up, down = (np.array(next(values))[:, :, :2] for _ in range(2))
        change = (up - down) / (2 * step)
        wrong = np.abs(slopes[..., column] - change).max()
        assert wrong < SLOPE_SHARE * np.abs(change).max() + 3e-8 / step, column


SLOPE_SHARE = 0.03
"""As ``test_shooting`` grants."""


@pytest.mark.once
@pytest.mark.parametrize(
    ("label", "numbers"),
    [
        ("constant_tension", {"share": 0.7}),
        ("tension_variation/instead of the line's length", {"share": 0.5, "power": 1.5, "late_s": 0.2}),
        ("crossflow_drag", {"drag_depth_m": 0.1, "trim_depth_m": 0.02}),
        (RESISTS.label, {"x": -0.1, "power": 2.2}),
        ("tow_point_offset/on a rail", {"slides_m": -0.008}),
    ],
)
def test_the_saved_simulator_is_the_diagnosis_own(label: str, numbers: dict[str, float]) -> None:
    """``towline simulate`` with the model that was saved, against the motion that the diagnosis had beside the data."""
    effect = next(e for e in (*LIBRARY, RESISTS) if e.label == label)
    run = stated()
    model = TowSimulator([run])
    own = np.array([[0.2, 0.02, -0.02, 0.01, 0.0, 0.0, R_N, 1.548, LINE_M, 1.28, 0, 0]])
    shared = np.array([getattr(HULL, n) for n in model.shared_names])
    h = Hypothesis(shared, own, (effect,), (np.array(list(numbers.values())),))
    ours = model.values([h])[0][0]
    scenario = {
        "name": "again",
        "time": {"duration_s": DURATION_S, "rate_hz": HERTZ},
        "hull": {n: float(v) for n, v in zip(model.shared_names, shared, strict=True)} | {"speed_m_s": 1.28},
        "effect": [{"name": effect.name, "form": effect.variant, "numbers": numbers}],
        "tow": {"line": "surge", "speed_m_s": 1.28, "line_length_m": LINE_M, "tow_point_m": 1.548, "tension_n": R_N},
        "start": {"alpha_rad": 0.2, "beta_rad": 0.02, "v_m_s": -0.02, "r_rad_s": 0.01},
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
    }
    file = check_tables(scenario, ScenarioFile, Path("scenario.toml"))
    found = effects_of(file, Path("scenario.toml"), (*LIBRARY, RESISTS))
    motion = simulate_scenario(file, Path(), lambda hull, tow: with_effects(hull, tow, found, file))
    t_s = run.data.t_s - run.start_s
    block = np.floor(t_s / run.step_s + 1e-9).astype(int)
    inside = block < len(run.centre_s)
    for channel, column in enumerate(("y_cg_m", "beta_rad")):
        mean = np.bincount(block[inside], motion[column].to_numpy()[inside]) / np.bincount(block[inside])
        # how far a point on a rail is from the centre line, seen along the line, is no force, and not simulated
        seen_m = 8e-3 * 0.2 * 0.05 if "rail" in label and channel == 0 else 0.0
        assert np.abs(ours[:, channel] - mean).max() < STEPPED + seen_m, channel


def test_a_model_gains_on_the_carriage_under_a_weight_heavier_than_its_resistance() -> None:
    """Ahead (m - X_udot) u' = R h - n R/U (u - U), so that the line shortens as a lag of first order: by U h/n in the end.

    To second order in that share, and what a mean over a block of 0.35 s rounds of the lag's begin (micrometres).
    """
    heavier, model = 0.003, TowSimulator([stated()])
    weight = next(law for law in LAWS if law.name == "constant_tension")
    own = np.array([[0, 0, 0, 0, 0, 0, R_N, 1.548, LINE_M, 1.28, 0, 0.0]])
    shared = np.array([getattr(HULL, n) for n in model.shared_names])
    lengths = []
    for more in (0.0, heavier):
        numbers = np.array([more if p.name == "heavier" else 0.0 for p in weight.parameters])
        (values,) = model.values([Hypothesis(shared, own, (weight,), (numbers,))])
        lengths.append(np.array(values)[0, :, CHANNELS.index("line")])
    lag_s = (HULL.mass_kg - HULL.x_udot_kg) * 1.28 / (HULL.resistance_exponent * R_N)
    t_s = model.runs[0].centre_s
    gained = 1.28 * heavier / HULL.resistance_exponent * (t_s - lag_s * (1 - np.exp(-t_s / lag_s)))
    np.testing.assert_allclose(lengths[0] - lengths[1], gained, rtol=heavier, atol=3e-6)


def test_a_tow_point_that_has_slipped_turns_the_model_by_all_that_the_line_pulls_with() -> None:
    """Against the simulator's own offset, where the model's inertia asks for a third more and less than the straight tow's pull."""
    aside_m, t_s, begin = 0.004, np.arange(0, 30, 0.05), Start(y_cg_m=0.25)
    tow = Tow(1.28, LINE_M, 1.548, R_N, line="surge")
    name = "slips at about 8 s"
    effect = next(e for e in LIBRARY if e.name == "tow_point_offset" and e.variant == name)
    file: Any = SimpleNamespace(
        effect=[SimpleNamespace(name=effect.name, form=name, numbers={"slipped_m": aside_m, "when_s": -100.0})],
        water=SimpleNamespace(tank_width_m=None, density_kg_m3=1000.0),
        model=SimpleNamespace(length_pp_m=2.66),
        time=SimpleNamespace(duration_s=30.0),
    )
    _, _, extra = with_effects(HULL, tow, effects_of(file, Path("s.toml")), file)
    plain, forced = (simulate_full(HULL, tow, begin, t_s, extra=e) for e in (None, extra))
    wanted = simulate_full(HULL, replace(tow, tow_point_offset_m=aside_m), begin, t_s)
    for column in ("y_cg_m", "beta_rad"):
        change = np.abs(wanted[column] - plain[column]).max()
        assert change > 1e-3
        assert np.abs(forced[column] - wanted[column]).max() < SECOND_ORDER * change, column


@pytest.mark.slow
def test_the_diagnosis_has_the_same_of_a_tow_point_that_has_slipped() -> None:
    """Beside its own offset, all along: y and heading of the model and the line's length as they are seen."""
    model = TowSimulator([stated()])
    own = np.array([[0.25, 0.02, -0.02, 0.01, 0.0, 0.0, R_N, 1.548, LINE_M, 1.28, 0, 0]])
    shared = np.array([getattr(HULL, n) for n in model.shared_names])
    forms = {e.variant: e for e in LIBRARY if e.name == "tow_point_offset"}
    numbers = {"": [0.0], "aside": [0.004], "slips at about 8 s": [0.0, 0.004, -100.0]}
    effects = {name: forms["" if name == "aside" else name] for name in numbers}
    tow = Tow(1.28, LINE_M, 1.548, R_N, line="surge")
    y_m = full_y_cg(0.0, 0.25, 0.02, tow)
    # let go at the same place: the line to the point aside stands at another angle there
    other = brentq(lambda alpha: full_y_cg(0.0, alpha, 0.02, replace(tow, tow_point_offset_m=0.004)) - y_m, 0.2, 0.3)
    begun = {name: np.concatenate([[[other if name == "aside" else 0.25]], own[:, 1:]], axis=1) for name in numbers}
    hypotheses = [Hypothesis(shared, begun[n], (effects[n],), (np.array(numbers[n]),)) for n in numbers]
    plain, wanted, found = (np.array(v)[0] for v in model.values(hypotheses))
    for channel in ("y", "beta", "line"):
        at = CHANNELS.index(channel)
        change = np.abs(wanted[:, at] - plain[:, at]).max()
        assert change > 3e-4, channel
        assert np.abs(found[:, at] - wanted[:, at]).max() < SECOND_ORDER * change, channel


SECOND_ORDER = 0.25**2 + 0.004 / LINE_M
"""Of the line's angle, rad, and the offset over the line: what a force at the centre line leaves out. With the straight tow's pull
instead of the line's own the heading is wrong by 0.14."""


def test_a_line_that_gives_is_simulated_as_a_spring() -> None:
    """What the diagnosis calls a compliance is a spring's in the simulator, at the same length under way."""
    file: Any = SimpleNamespace(
        effect=[SimpleNamespace(name="elastic_line", numbers={"compliance_m_n": 0.002}, form="")],
        water=SimpleNamespace(tank_width_m=None, density_kg_m3=1000.0),
    )
    tow = Tow(1.28, LINE_M, 1.548, R_N, line="surge")
    _, made, _ = with_effects(HULL, tow, effects_of(file, Path("s.toml")), file)
    assert made.stiffness_n_m == pytest.approx(500.0)
    assert made.line_length_m == LINE_M
