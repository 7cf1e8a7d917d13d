"""A load cell in a line that keeps its length: what it says is compared with what the motion makes, on a clock of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from towline.blind.one_case import case_of
from towline.blind.truth.folders import write_case
from towline.diagnose.effects import DELAY_FORMS, ELASTIC, LIBRARY, Effect
from towline.diagnose.gap import Diagnosis
from towline.diagnose.inference.hypothesis import Hypothesis
from towline.diagnose.tow.cell import SETTLES_S, cell_means
from towline.diagnose.tow.channels import PULL
from towline.diagnose.tow.data import Recorded, block_step, tow_runs
from towline.diagnose.tow.delays import delay_effects
from towline.diagnose.tow.tow_run import TowRun
from towline.diagnose.tow.towed import TowSimulator
from towline.pipeline import diagnosing
from towline.pipeline.diagnosing import diagnose_folders, diagnosed_runs
from towline.record import Run, RunFile
from towline.record.errors import EstimationError
from towline.record.toml import check_tables
from towline.simulate import Hull, Start, Tow, simulate_full

HULL = Hull(
    149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-4.0, x_vr_kg=40.0
)  # fmt: skip
R_N, LINE_M, POINT_M, SPEED, CELL_N, LATE_S = 3.96, 0.91, 1.548, 1.28, 0.02, 0.3
OFFSET_M = 2e-3
TOW = Tow(SPEED, LINE_M, POINT_M, R_N, line="surge")


def with_cell(folder: Path, late_s: float = LATE_S, noise_n: float = 0.0) -> TowRun:
    """A tow with a load cell whose times are stated too early by ``late_s``."""
    rng, t_s = np.random.default_rng(3), np.arange(45 * 25) / 25
    cell_s = np.arange(0.0, 45.0, 0.1)
    motion = simulate_full(HULL, TOW, Start(y_cg_m=0.2), t_s)
    pull = simulate_full(HULL, TOW, Start(y_cg_m=0.2), cell_s)["tension_n"].to_numpy()
    said = {"t_s": cell_s - late_s, "tension_n": pull + rng.normal(0, 1, len(pull)) * noise_n}
    pd.DataFrame(said).to_csv(folder / "tension.csv", index=False)
    content = {
        "name": "x",
        "source": {"motion": "motion.csv"},
        "tow": {"speed_m_s": SPEED, "line_length_m": LINE_M, "tow_point_m": POINT_M, "tension": "tension.csv"},
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"density_kg_m3": 1000.0, "tank_width_m": 4.6},
    }
    table = motion[["t_s", "y_cg_m", "beta_rad"]].assign(
        alpha_rad=np.nan, sigma_y_cg_m=1e-3, sigma_beta_rad=2e-3, status="measured"
    )
    run = Run(folder, check_tables(content, RunFile, folder / "run.toml"))
    return tow_runs([Recorded(run, table)], block_step([45.0]))[0]


def test_its_means_and_their_noise(tmp_path: Path) -> None:
    run = with_cell(tmp_path, 0.0, CELL_N)
    count = len(run.centre_s)
    cell = cell_means(run.data, run.start_s, run.step_s, count)
    assert cell is not None
    early = (np.arange(count) + 1) * run.step_s <= SETTLES_S
    assert np.isnan(cell.pull_n[early]).all()
    assert np.isfinite(cell.pull_n[~early]).all()
    exact = simulate_full(HULL, TOW, Start(y_cg_m=0.2), np.arange(0.0, 45.0, 0.01))["tension_n"].to_numpy()
    left = (cell.pull_n - np.interp(cell.centre_s, np.arange(0.0, 45.0, 0.01), exact))[~early]
    samples = run.step_s / 0.1
    assert np.std(left) == pytest.approx(CELL_N / np.sqrt(samples), rel=0.3)
    # the white part alone, of a covariance that holds scale, zero and slow errors too
    white = np.linalg.eigvalsh(cell.covariance[np.ix_(~early, ~early)])[: count // 2]
    assert np.sqrt(np.median(white)) == pytest.approx(CELL_N / np.sqrt(samples), rel=0.3)


def test_a_run_without_one_has_no_such_channel(tow_runs: Callable[[int, int], list]) -> None:
    (run,) = tow_runs(4, 1)
    assert run.values.shape[1] == PULL
    assert cell_means(run.data, run.start_s, run.step_s, len(run.centre_s)) is None


def test_what_is_said_beside_the_model_is_what_the_simulator_pulls_with(tmp_path: Path) -> None:
    """Against ``simulate_full`` at every block, late by the clock of the cell alone; and its slopes against differences."""
    run = with_cell(tmp_path)
    model = TowSimulator([run])
    shared = np.array([getattr(HULL, n) if n != "compliance_m_n" else 0.0 for n in model.shared_names])
    alpha = np.arcsin(0.2 / LINE_M)
    own = np.array([[alpha, 0, 0, 0, 0, 0, R_N, POINT_M, LINE_M, SPEED, 0, 0]])
    effects: tuple[Effect, ...] = (DELAY_FORMS[1], ELASTIC)
    h = Hypothesis(shared, own, effects, (np.array([LATE_S, 0.0]), np.array([1e-4, 0.0])))
    found = model.linear([h])[0]
    residual, slope = found.rows[0]
    good = np.isfinite(run.values[:, PULL])
    # the pull bends over a block by less than this
    assert np.abs(residual[good, PULL]).max() < 5e-3
    at = len(shared) + own.shape[1]
    steps = [(0, 1e-2 * abs(shared[0])), (2, 1e-2 * abs(shared[2])), (at, 0.01), (at + 1, 1e-3)]
    h = replace(h, path=found.path)
    for column, step in steps:
        both = []
        for sign in (1, -1):
            if column < at:
                both.append(replace(h, shared=shared + sign * step * np.eye(len(shared))[column]))
            else:
                moved = h.numbers[0] + sign * step * np.eye(2)[column - at]
                both.append(replace(h, numbers=(moved, h.numbers[1])))
        up, down = model.values(both)
        change = (up[0] - down[0])[:, PULL] / (2 * step)
        assert np.abs(slope[:, PULL, column] - change).max() < 0.03 * np.abs(change).max() + 1e-9, column
        if column >= at:
            assert np.abs(slope[:, :PULL, column]).max() == 0.0  # a camera has a clock of its own


@pytest.mark.slow
def test_random_forces_are_felt_by_the_cell_too(tmp_path: Path) -> None:
    """Against ``simulate_full`` with a push that lasts one block, from a release at 0.22 rad: what it does to the pull, at once and
    as the model moves, to 1 % of its root mean square (a block has three nodes, and the push begins and ends between samples).
    """
    run = with_cell(tmp_path, 0.0)
    model = TowSimulator([run])
    shared = np.array([getattr(HULL, n) if n != "compliance_m_n" else 0.0 for n in model.shared_names])
    own = np.array([[np.arcsin(0.2 / LINE_M), 0, 0, 0, 0, 0, R_N, POINT_M, LINE_M, SPEED, 0, 0]])
    h = model.begun(Hypothesis(shared, own))
    found = model.pushed(h)[0]
    cell_s = np.arange(0.0, 45.0, 0.1)
    block = np.floor(cell_s / run.step_s + 1e-9).astype(int)
    inside = block < len(run.centre_s)
    good = np.isfinite(run.values[:, PULL])

    def means(block_pushed: int, side_n: float, moment_n_m: float) -> np.ndarray:
        def push(t, y, beta, v, r, alpha):
            there = (np.floor(t / run.step_s) == block_pushed) + 0.0 * v
            return side_n * there, moment_n_m * there

        pull = simulate_full(HULL, TOW, Start(y_cg_m=0.2), cell_s, extra=push)["tension_n"].to_numpy()
        return np.bincount(block[inside], pull[inside]) / np.bincount(block[inside])

    still = means(0, 0.0, 0.0)
    for pushed in (12, 25, 40):
        for k, force in enumerate(((0.02, 0.0), (0.0, 0.02))):
            truth = (means(pushed, *force) - still) / 0.02
            off = (found[:, -1, k, pushed] - truth)[good]
            assert np.sqrt(np.mean(off**2)) < 0.01 * np.sqrt(np.mean(truth[good] ** 2)), (pushed, k)


@pytest.mark.slow
def test_a_point_beside_the_centre_line_is_felt_by_the_cell_too(tmp_path: Path) -> None:
    """One that could slip, and does not, against one that is fixed, whose equations are exact.

    What is left is smaller by the square of the swing's angles, 0.38 rad at most.
    """
    run = with_cell(tmp_path, 0.0)
    model = TowSimulator([run])
    shared = np.array([getattr(HULL, n) if n != "compliance_m_n" else 0.0 for n in model.shared_names])
    fixed = next(e for e in LIBRARY if e.name == "tow_point_offset" and not e.variant)
    slips = next(e for e in LIBRARY if e.variant == "slips at about 18 s")

    def values(aside_m: float, effects: tuple[Effect, ...], numbers: tuple[np.ndarray, ...]) -> np.ndarray:
        own = np.array([[np.arcsin((0.2 + aside_m) / LINE_M), 0, 0, 0, 0, 0, R_N, POINT_M, LINE_M, SPEED, 0, 0]])
        return model.values([Hypothesis(shared, own, effects, numbers)])[0][0]

    # where alpha is the line's own angle, the point that holds begins further aside
    there = values(OFFSET_M, (fixed,), (np.array([OFFSET_M]),))
    slid = values(0.0, (slips,), (np.array([OFFSET_M, 0.0, 20.0]),))
    nothing = values(0.0, (), ())
    for channel in (0, 1, PULL):
        good = np.isfinite(run.values[:, channel])
        moved = np.abs(there - nothing)[good, channel].max()
        assert np.abs(there - slid)[good, channel].max() < 0.38**2 * moved, channel


@pytest.mark.parametrize("since", [None, 20.0])
def test_delays_are_found_where_record_and_motion_disagree(since: float | None) -> None:
    rng, runs = np.random.default_rng(1), []
    node_s = np.arange(0.0, 45.0, 0.1)
    pulls = np.array([4 + 0.5 * np.sin(2 * np.pi * node_s / p) for p in (9.0, 12.0)]).T
    for k, late in enumerate((0.15, -0.2)):
        cell_s = np.arange(0.5, 44.0, 0.35)
        # a mean over the jump has a part of it
        by = np.full_like(cell_s, late) if since is None else 0.1 + 0.3 * np.clip((cell_s - since) / 0.35 + 0.5, 0, 1)
        said = 0.05 + 1.02 * np.interp(cell_s + by, node_s, pulls[:, k]) + rng.normal(0, 0.01, len(cell_s))
        values = np.column_stack([np.zeros((len(cell_s), PULL)), said])
        runs.append(
            SimpleNamespace(
                name=f"r{k}", celled=True, values=values, cell_s=cell_s, step_s=0.35, usual_sd=lambda _: 0.01
            )
        )
    jump, each = delay_effects(runs, node_s, pulls)
    assert jump.cell is not None
    assert each.cell is not None
    if since is None:
        # 120 means of a wave of 0.5 N and 10 s tell a delay to 0.004 s
        found = [one.none for one in each.parameters]
        assert [float(each.cell(f"r{k}", 1.0, *found)) for k in range(2)] == pytest.approx([0.15, -0.2], abs=0.015)
        assert float(each.cell("a run without a cell", 1.0, *found)) == 0.0
    else:
        # to a part of a block; the fit goes on from there
        at = jump.parameters[2].none
        assert at == pytest.approx(since, abs=0.35 / 2)
        before, after = (float(jump.cell("r0", np.array(t), 0.0, 1.0, at)) for t in (since - 1.0, since + 1.0))
        assert (before, after) == (0.0, 1.0)


@pytest.mark.slow
def test_a_clock_that_jumps_is_named_in_a_reality_of_its_own(tmp_path: Path) -> None:
    case = case_of("case-x", "effect", ["sync_delay"], [4, 1], False)
    numbers = {"sync_delay.delay_s": 0.05, "sync_delay.jump_s": 0.3, "sync_delay.change_s": 15.0}
    case = replace(case, numbers=numbers, runs=case.runs[:3], extra={}, duration_s=30.0)
    found = diagnose_folders(write_case(tmp_path, case)).diagnosis.file
    assert found.verdict == "effect"
    assert found.ranking[0].effects == ["sync_delay"]
    assert found.ranking[0].shrink > 0.8 * (1 - 1 / found.ranking[0].gap_before)


@pytest.mark.slow
def test_a_record_beside_which_nothing_can_be_followed_is_left_out_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line that stands far off what is stated; here every fit with a cell is refused."""
    case = replace(case_of("case-x", "effect", ["sync_delay"], [4, 1], False), extra={})
    case = replace(case, runs=case.runs[:2], numbers={"sync_delay.delay_s": 0.0})

    def refused(simulator: TowSimulator, *rest: Any) -> Diagnosis:
        if simulator.celled:
            raise EstimationError("it cannot follow")
        return diagnosed_runs(simulator, *rest)

    monkeypatch.setattr(diagnosing, "diagnosed_runs", refused)
    found = diagnose_folders(write_case(tmp_path, case)).diagnosis
    assert not found.inference.simulator.celled  # pyright: ignore[reportAttributeAccessIssue]
    assert "load cell" in found.file.excluded
    assert any("load cell's record is left out" in sentence for sentence in found.file.sentences)
    assert found.file.verdict == "no_gap"
