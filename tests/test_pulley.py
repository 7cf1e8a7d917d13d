"""A line that pays out over a pulley: which turn one out of round has by the motion, and where a base begins beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towline.blind.one_case import case_of
from towline.blind.truth.cases import Case
from towline.blind.truth.folders import write_case
from towline.diagnose.effects import KEPT, LAWS, PULLEYS
from towline.diagnose.effects.line_laws import PULLEYS_M
from towline.diagnose.inference.evidence import Inference
from towline.diagnose.inference.noise import Forces
from towline.diagnose.tow.start import lawful_hypotheses
from towline.diagnose.tow.towed import TowSimulator
from towline.diagnose.tow.weak import by_motion, missed
from towline.pipeline.diagnosing import tows_of
from towline.pipeline.stages import compute_run_motion
from towline.record.run import read_run

STEP = PULLEYS_M[1] / PULLEYS_M[0]


def campaign(folder: Path, seed: int) -> tuple[Case, TowSimulator]:
    """A weight over a pulley out of round, by the blind check's equations, as the diagnosis takes it."""
    case = case_of("case", "effect", ["constant_tension"], [777, seed], forms={"constant_tension": "out of round"})
    runs = [read_run(one) for one in write_case(folder, case)]
    return case, TowSimulator(tows_of(runs, [compute_run_motion(run) for run in runs]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_measured_motion_says_which_turn_a_pulley_has(tmp_path: Path, seed: int) -> None:
    """Ten turns, a sixth apart: the one that is tried first is next to the true one."""
    case, simulator = campaign(tmp_path / "case", seed)
    weight = next(law for law in LAWS if law.name == KEPT.name)
    (begun,) = lawful_hypotheses(simulator.runs, [weight, *PULLEYS], simulator.starts()[-1:])
    left = missed(simulator, [by_motion(simulator, h, simulator.shared_prior) for h in begun])
    best = PULLEYS_M[int(np.argmin(left[1:]))]
    assert left[1:].min() < left[0]
    assert 1 / STEP < best / case.numbers["constant_tension.round_m"] < STEP


@pytest.mark.slow
def test_a_base_begins_where_its_line_does_not_reach(tmp_path: Path) -> None:
    """The line of 0.91 m is up to 1.8 m long here: along the angles of one that keeps its length nothing could be begun."""
    _, simulator = campaign(tmp_path / "case", 3)
    longest = max(np.nanmax(run.values[:, 2]) + run.data.tow.line_length_m for run in simulator.runs)
    assert longest > 1.5
    start = simulator.starts()[-1]
    (opened,) = Inference(simulator, None).fit([start], [Forces()], 2, None, 3)
    assert np.isfinite(opened.log_evidence)
