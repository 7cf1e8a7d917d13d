"""Effects whose numbers lie between those from which fits begin, or far from them, in the blind check's reality: named, alone."""

from __future__ import annotations

from collections.abc import Sequence
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


def best_of(folder: Path, effect: str, form: str, seed: Sequence[int], **numbers: float) -> RankedEffects:
    """What is named first, and alone."""
    case = case_of("between", "effect", [effect], list(seed), forms={effect: form})
    given = {f"{effect}.{name}": value for name, value in numbers.items()}
    best = diagnose_folders(write_case(folder, replace(case, numbers=case.numbers | given))).diagnosis.file.ranking[0]
    assert best.effects == [effect]
    assert best.probability + (best.probability_inexact or 0.0) > 0.9
    return best


def near(best: RankedEffects, name: str, value: float) -> None:
    found = best.parameters[name]
    assert found.value == pytest.approx(value, abs=WITHIN_SDS * found.std), name


def test_a_memory_that_rings_is_found_with_its_own_period_and_damping(tmp_path: Path) -> None:
    numbers = {"ring_sway": 0.3, "ring_yaw": 0.4, "ring_s": 4.3, "ring_damping": 0.2}
    best = best_of(tmp_path, "fluid_memory", "ringing", (778, 1), **numbers)
    assert best.probability > 0.9
    near(best, "fluid_memory.time_s", 4.3)
    near(best, "fluid_memory.damped", 0.2 - 0.3)
    near(best, "fluid_memory.share_yaw", 0.4)


def test_eddies_are_found_by_their_length_from_tows_of_several_speeds(tmp_path: Path) -> None:
    best = best_of(tmp_path, "cross_current", "to and fro", (778, 2), swirl_m_s=0.0015, eddy_m=23.0, phase=1.0)
    assert "to and fro" in best.form


def test_a_clock_that_runs_off_far_is_no_frame_rate_beside_it(tmp_path: Path) -> None:
    """By 0.87 s over a run, against a load cell's: case-195 of seed 271144, where a frame rate took most of it first."""
    best = best_of(tmp_path, "sync_delay", "drifting", (271144, 194))
    assert "growing" in best.form


def test_a_pulley_a_little_out_of_round_is_found_beside_what_its_weight_does(tmp_path: Path) -> None:
    """By half a per cent of the pull: case-003 of seed 271144, where a weight and a drifting carriage had said as much."""
    best = best_of(tmp_path, "constant_tension", "out of round", (271144, 2))
    assert "out of round" in best.form
