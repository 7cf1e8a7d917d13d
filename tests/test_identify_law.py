"""Derivatives beside a law that is known beforehand: its slopes, what a fit without it misses, and what the command says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from towline.cli.main import main
from towline.diagnose.law.terms import effect_of
from towline.diagnose.simulated import missing_force
from towline.identify import fit_runs
from towline.identify.data import Missing
from towline.identify.joint.full import full_paths
from towline.identify.joint.parameters import COUNT, LINE_LENGTH, SPEED, TOW_POINT
from towline.identify.joint.partials import linearise
from towline.record.plan_file import PlanFile
from towline.record.results import read_result
from towline.simulate import Hull, Start, simulate_full
from towline.simulate.model import Line, Tow, full_state

LENGTH_M, WATER_KG_M3 = 2.66, 1000.0
LAW = (
    (effect_of("v|v|", "Y and N"), np.array([-0.03, -0.006])),
    (effect_of("bump(y at 0.05, 0.1 wide)", "Y"), np.array([2e-4, 0.05, 0.1])),
    (effect_of("alpha^2", "X"), np.array([-0.004])),
)
"""A drag across, a push at one place, and a resistance: of the size of a tenth of the line's pull."""


@pytest.mark.parametrize("line", ["constant", "surge"])
def test_a_known_law_moves_the_rates_as_differences_say(line: Line) -> None:
    """Every column of state, tow point, line and speed that the law goes with, against central differences of ``full_state``."""
    force = missing_force(LAW, LENGTH_M, WATER_KG_M3)
    hull = Hull(
        149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-4.0, x_vr_kg=40.0
    )
    tow = Tow(1.28, 0.91, 1.5, 3.96, tow_point_offset_m=0.02, line=line)
    state, when = np.array([0.2, -0.05, 0.03, -0.04])[:, None], 1.3

    def missing(t_s: float, state: np.ndarray, tow: Tow) -> tuple:
        return force(t_s, state, tow, 40.0, 2.3)

    def both(state: np.ndarray, tow: Tow) -> np.ndarray:
        found = full_state(when, state, hull.at_speed(tow.speed_m_s), tow, lambda *_: missing(when, state, tow))
        return np.append(found.rates[:, 0], np.broadcast_to(found.tension_n, 1))

    every = tuple(range(COUNT))
    found = linearise(when, state, hull, tow, every, 1.28, missing=missing)
    moved = np.zeros((4, 4 + COUNT, 1))
    moved[range(4), range(4)] = 1.0
    slopes = found.along(moved, 4, every)[:, :, 0]
    step = 1e-6
    for i in range(4):
        up, down = state.copy(), state.copy()
        up[i] += step
        down[i] -= step
        np.testing.assert_allclose(
            slopes[:, i], (both(up, tow) - both(down, tow))[:4] / (2 * step), rtol=2e-6, atol=2e-7
        )
    for index, name in ((TOW_POINT, "tow_point_m"), (LINE_LENGTH, "line_length_m"), (SPEED, "speed_m_s")):
        ends = [replace(tow, **{name: getattr(tow, name) + sign * step}) for sign in (1, -1)]
        change = (both(state, ends[0]) - both(state, ends[1]))[:4] / (2 * step)
        np.testing.assert_allclose(slopes[:, 4 + index], change, rtol=2e-6, atol=2e-7)


@pytest.mark.slow
def test_a_fit_beside_the_law_finds_the_derivatives_and_one_without_does_not(campaigns: ModuleType) -> None:
    """Two tows without noise that ``simulate_full`` makes with the law: to a thousandth; without it worse by tens of times."""
    force = missing_force(LAW, LENGTH_M, WATER_KG_M3)
    runs, times = [], campaigns.times(20.0, 10.0)
    truth = Hull(*campaigns.SIX, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-3.9, x_vr_kg=35.6)
    for x in (1.446, 1.751):
        plain = campaigns.still_run(x, times)
        tow = replace(plain.tow, line="surge")

        def extra(t_s, y, beta, v, r, alpha, tow=tow):
            return force(t_s - times[0], np.array([alpha, beta, v, r]), tow, times[-1] - times[0], 2.3)

        motion = simulate_full(truth, tow, Start(alpha_rad=0.25), times, extra=extra)
        runs.append(
            replace(
                plain, tow=tow, mass_kg=78.0, length_pp_m=LENGTH_M, y_m=motion["y_cg_m"].to_numpy(),
                beta_rad=motion["beta_rad"].to_numpy(), missing=Missing(force, 2.3),
            )
        )  # fmt: skip
    off = [
        np.abs(fit_runs([replace(d, missing=m) for d in runs]).six / campaigns.SIX - 1).max()
        for m in (runs[0].missing, None)
    ]
    assert off[0] < 1e-3
    assert off[1] > 30 * off[0]


def test_what_is_no_law_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "law.toml"
    table.write_text('[[effect]]\nname = "crossflow_drag"\n[effect.numbers]\ndrag_depth_m = 0.1\n')
    assert main(["identify", "anywhere", "--effects", str(table)]) == 1
    assert "effect[0].name" in capsys.readouterr().err
    assert main(["identify", "anywhere", "--effects", str(table), str(table), "--no-page"]) == 1
    assert "2 TOML files given" in capsys.readouterr().err
    assert main(["identify", "anywhere", "--effects", str(table), "--form", "linear"]) == 1
    assert "full form" in capsys.readouterr().err


PLAN = """
[tank]
length_m = 60.0
width_m = 4.6
speeds_m_s = [1.28]
[model]
length_pp_m = 2.66
mass_kg = 78.0
[guess]
reference = "southampton"
[choices]
tension_n = 3.96
tension_speed_m_s = 1.28
tow_points_m = [1.55]
line_lengths_m = [0.91]
releases_y_m = [0.1]
releases_beta_rad = [0.0]
[wish]
max_runs = 1
"""


def test_a_plan_swings_with_the_law_and_says_where_nothing_is_known_of_it(tmp_path: Path) -> None:
    """Found for alpha to 0.01, planned with 0.1: said of every run. A resistance of 30 N per alpha^2 takes room from the wall."""
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    (tmp_path / "law.py").write_text(
        "from towline.diagnose.law.terms import effect_of\n"
        "LAW = effect_of('alpha^2', 'X', sd=(0.01, 0.01, 0.01), reach={'alpha': (-0.01, 0.01)})\n"
    )
    (tmp_path / "law.toml").write_text('[[effect]]\nname = "law alpha^2"\nform = "X"\n[effect.numbers]\nx = -0.005\n')
    law = [str(tmp_path / name) for name in ("law.toml", "law.py")]
    plans = []
    for more in ([], ["--effects", *law]):
        assert main(["plan", str(tmp_path / "plan.toml"), *more]) == 0
        plans.append(read_result(tmp_path / "plan.json", PlanFile))
    plain, beside = plans
    assert any("planned beside a law" in note for note in beside.notes)
    assert any("run 1" in note and "nothing is known of it" in note for note in beside.notes)
    assert not any("law" in note for note in plain.notes)
    assert {"law.toml", "law.py"} <= set(beside.inputs)
    # the resistance is told by the motion as T is: other intervals
    assert beside.chosen.percent["y_v"] != pytest.approx(plain.chosen.percent["y_v"], rel=1e-3)


def test_a_planned_motion_is_the_simulators_with_the_law(campaigns: ModuleType) -> None:
    """Against DOP853 to 20 micrometres: a planned path has steps of a twelfth of its fastest root's time."""
    times = np.arange(0.0, 30.0, 0.05)
    force = missing_force(LAW, LENGTH_M, WATER_KG_M3)
    plain = campaigns.still_run(1.6, times)
    tow = replace(plain.tow, line="surge")
    hull = Hull(*campaigns.SIX, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-3.9, x_vr_kg=35.6)

    def extra(t_s, y, beta, v, r, alpha):
        return force(t_s, np.array([alpha, beta, v, r]), tow, times[-1], 2.3)

    motion = simulate_full(hull, tow, Start(alpha_rad=0.2), times, extra=extra)
    values = np.zeros((1, COUNT))
    values[0, :14] = [*campaigns.SIX, 0.2, 0, 0, 0, tow.tension_n, tow.tow_point_m, tow.line_length_m, 1.28]
    values[0, 14:19] = [-3.9, 35.6, 0.0, 0.0, 1.85]
    run = replace(plain, tow=tow, mass_kg=78.0, length_pp_m=LENGTH_M, missing=Missing(force, 2.3))
    (path, _), *_ = full_paths([run], values, 1.28)[0]
    np.testing.assert_allclose(path, motion[["y_cg_m", "beta_rad"]].to_numpy().T, atol=2e-5)
