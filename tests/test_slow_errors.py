"""Errors of the marks that last: granted to runs that show them, and not to runs that do not."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from towline.blind.truth.noise import wandering
from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.noise import Forces
from towline.diagnose.tow.data import Recorded, block_step, granted, tow_runs
from towline.diagnose.tow.slow import SLOW_PX, SLOW_S
from towline.diagnose.tow.towed import TowSimulator
from towline.geometry import motion_from_tracks, run_datum
from towline.record import Run

SEEDS = (3, 4, 5)


def filmed(run: Run) -> Run:
    """The same run, its marks of a film."""
    source = run.file.source.model_copy(update={"video": "video.mp4"})
    return replace(run, file=run.file.model_copy(update={"source": source}))


def fitted(
    cases: ModuleType, seed: int, slow_px: float, film: bool = False, still: bool = True
) -> tuple[TowSimulator, Inference, Fitted]:
    """Four tows on lines that keep their length, each mark's place off by ``slow_px`` that lasts, and the simulator as it is."""
    rng = np.random.default_rng([31, seed])
    campaign = cases.campaign("none", rng, line="surge")
    recorded = []
    for run, tracks, static in campaign.runs[:4]:
        moved = tracks.copy()
        for _, rows in moved.groupby("marker").groups.items():
            off = wandering(len(rows), 1 / cases.RATE_HZ, slow_px, SLOW_S, rng, 2)
            moved.loc[rows, ["u_px", "v_px"]] += off.T
        fit = run_datum(run, None)
        motion = motion_from_tracks(run, moved, fit)
        told = filmed(run) if film else run
        recorded.append(Recorded(told, motion.motion, motion.common, moved, fit, static if still else None))
    simulator = TowSimulator(tow_runs(recorded, block_step([cases.DURATION_S])))
    first = simulator.starts()[0]
    inference = Inference(simulator, simulator.noise(first))
    return simulator, inference, inference.fit([first], [Forces()], 8, (1,))[0]


def shares(before: TowSimulator, after: TowSimulator) -> np.ndarray:
    """(4,) what is left of what was granted in y, heading, line and distance."""
    return after.runs[0].slow.sd / before.runs[0].slow.sd


@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_runs_do_not_show_is_not_granted(cases: ModuleType, seed: int) -> None:
    """At most twice what the marks' own noise leaves of a mean over SLOW_S: what is smaller shows in no run."""
    simulator, inference, base = fitted(cases, seed, 0.0)
    y, heading, line, _ = shares(simulator, simulator.as_quiet_as(inference, base))
    seen = simulator.runs[0].marks
    assert seen is not None
    worn_px = float(seen.tracks["sigma_u_px"].median()) / np.sqrt(cases.RATE_HZ * SLOW_S)
    assert y * SLOW_PX <= 2 * worn_px
    assert heading == y  # the same dynamics show in both
    assert line <= 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_runs_show_stays_granted(cases: ModuleType, seed: int) -> None:
    simulator, inference, base = fitted(cases, seed, SLOW_PX)
    assert (shares(simulator, simulator.as_quiet_as(inference, base))[[0, 1, 3]] == 1.0).all()


@pytest.mark.parametrize(("film", "still"), [(True, True), (False, False)])
def test_a_film_and_marks_without_a_static_record_stay_granted_what_they_are(
    cases: ModuleType, film: bool, still: bool
) -> None:
    """What light and codec do to a mark goes with its place; nobody has seen what the noise alone is."""
    simulator, inference, base = fitted(cases, SEEDS[0], 0.0, film, still)
    assert simulator.as_quiet_as(inference, base) is simulator


def test_granting_what_is_granted_changes_nothing(cases: ModuleType) -> None:
    simulator, _, _ = fitted(cases, SEEDS[0], 0.0)
    run = simulator.runs[0]
    again = granted(granted(run, [0, 1], 0.25), [0, 1], 4.0)
    assert np.abs(again.covariance - run.covariance).max() < 1e-12 * run.covariance.max()
    assert np.abs(again.cross - run.cross).max() < 1e-12 * np.abs(run.cross).max()
