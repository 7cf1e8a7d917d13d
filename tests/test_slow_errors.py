"""Errors of the marks that last: granted to runs that show them, and not to runs that do not."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from lasting import lasting

from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.noise import Forces
from towline.diagnose.tow.data import Recorded, block_step, granted, tow_runs
from towline.diagnose.tow.slow import SLOW_PX, SLOW_S
from towline.diagnose.tow.towed import TowSimulator
from towline.geometry import motion_from_tracks, run_datum

SEEDS = (3, 4, 5)


def fitted(
    cases: ModuleType, seed: int, slow_px: float, planted: str = "none"
) -> tuple[TowSimulator, Inference, Fitted]:
    """Four tows on lines that keep their length, each mark's place off by ``slow_px`` that lasts, and the simulator as it is."""
    rng = np.random.default_rng([31, seed])
    campaign = cases.campaign(planted, rng, line="surge")
    recorded = []
    for run, tracks, static in campaign.runs[:4]:
        moved = tracks.copy()
        for _, rows in moved.groupby("marker").groups.items():
            for column in ("u_px", "v_px"):
                moved.loc[rows, column] += slow_px * lasting(rng, len(rows), 1 / cases.RATE_HZ)
        fit = run_datum(run, None)
        motion = motion_from_tracks(run, moved, fit)
        recorded.append(Recorded(run, motion.motion, motion.common, moved, fit, static))
    simulator = TowSimulator(tow_runs(recorded, block_step([cases.DURATION_S])))
    first = simulator.starts()[0]
    inference = Inference(simulator, simulator.noise(first))
    return simulator, inference, inference.fit([first], [Forces()], 8, (1,))[0]


def shares(before: TowSimulator, after: TowSimulator) -> tuple[float, float]:
    """What is left of what was granted for the marks' places and for the line's length."""
    old, new = before.runs[0].slow, after.runs[0].slow
    return float(new.marks[0] / old.marks[0]), float(new.line[2] / old.line[2])


@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_runs_do_not_show_is_not_granted(cases: ModuleType, seed: int) -> None:
    """At most twice what the marks' own noise leaves of a mean over SLOW_S: what is smaller shows in no run."""
    simulator, inference, base = fitted(cases, seed, 0.0)
    marks, line = shares(simulator, simulator.as_quiet_as(inference, base))
    seen = simulator.runs[0].marks
    assert seen is not None
    worn_px = float(seen.tracks["sigma_u_px"].median()) / np.sqrt(cases.RATE_HZ * SLOW_S)
    assert marks * SLOW_PX <= 2 * worn_px
    assert line <= 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_runs_show_stays_granted(cases: ModuleType, seed: int) -> None:
    simulator, inference, base = fitted(cases, seed, SLOW_PX)
    marks, _ = shares(simulator, simulator.as_quiet_as(inference, base))
    assert marks == 1.0


def test_granting_what_is_granted_changes_nothing(cases: ModuleType) -> None:
    simulator, _, _ = fitted(cases, SEEDS[0], 0.0)
    run = simulator.runs[0]
    again = granted(granted(run, run.slow.scaled(0.5, 0.25)), run.slow)
    assert np.abs(again.covariance - run.covariance).max() < 1e-12 * run.covariance.max()
    assert np.abs(again.cross - run.cross).max() < 1e-12 * np.abs(run.cross).max()
