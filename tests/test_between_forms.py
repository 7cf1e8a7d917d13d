"""Effects whose numbers lie between those from which fits begin, in the blind check's reality: named, alone, with their numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from towline.blind.one_case import case_of
from towline.blind.truth.folders import write_case
from towline.pipeline.diagnosing import diagnose_folders

if TYPE_CHECKING:
    from towline.record.gap import RankedEffects

pytestmark = pytest.mark.slow
WITHIN_SDS = 4.0
"""Of some ten numbers none lies beyond by chance (6e-5 each)."""


def best_of(folder: Path, effect: str, form: str, numbers: dict[str, float], seed: int) -> RankedEffects:
    """What is named first, and alone."""
    case = case_of("between", "effect", [effect], [778, seed], forms={effect: form})
    given = {f"{effect}.{name}": value for name, value in numbers.items()}
    case = replace(case, numbers=case.numbers | given, duration_s=36.0)
    best = diagnose_folders(write_case(folder, case)).diagnosis.file.ranking[0]
    assert best.effects == [effect]
    assert best.probability + (best.probability_inexact or 0.0) > 0.9
    return best


def near(best: RankedEffects, name: str, value: float) -> None:
    found = best.parameters[name]
    assert found.value == pytest.approx(value, abs=WITHIN_SDS * found.std), name


def test_a_memory_that_rings_is_found_with_its_own_period_and_damping(tmp_path: Path) -> None:
    numbers = {"ring_sway": 0.3, "ring_yaw": 0.4, "ring_s": 4.3, "ring_damping": 0.2}
    best = best_of(tmp_path, "fluid_memory", "ringing", numbers, 1)
    assert best.probability > 0.9
    near(best, "fluid_memory.time_s", 4.3)
    near(best, "fluid_memory.damped", 0.2 - 0.3)
    near(best, "fluid_memory.share_yaw", 0.4)


def test_eddies_are_found_by_their_length_from_tows_of_several_speeds(tmp_path: Path) -> None:
    numbers = {"swirl_m_s": 0.0015, "eddy_m": 23.0, "phase": 1.0}
    best = best_of(tmp_path, "cross_current", "to and fro", numbers, 2)
    assert "to and fro" in best.form


def test_a_clock_that_runs_off_far_is_no_frame_rate_beside_it(tmp_path: Path) -> None:
    """By 0.85 s over a run, the line's pull from a load cell: a frame rate takes most of it first."""
    best = best_of(tmp_path, "sync_delay", "drifting", {"drift_s": 0.85}, 3)
    assert "growing" in best.form


def test_a_pulley_a_little_out_of_round_is_found_beside_what_its_weight_does(tmp_path: Path) -> None:
    numbers = {"unround": 0.006, "round_m": 0.24, "phase": 1.0, "drag_n_s_m": 2.0, "weight": 1.0}
    best = best_of(tmp_path, "constant_tension", "out of round", numbers, 4)
    assert "out of round" in best.form
