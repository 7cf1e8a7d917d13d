"""Errors of the marks that last: granted to runs that show them, and not to runs that do not."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest

from towline.blind.truth.noise import wandering
from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.inexact import size_of
from towline.diagnose.inference.noise import Forces
from towline.diagnose.tow.data import Recorded, block_step, tow_runs
from towline.diagnose.tow.lasting import TRIED_PX
from towline.diagnose.tow.slow import SLOW_PX, SLOW_S
from towline.diagnose.tow.towed import TowSimulator
from towline.geometry import DatumFit, motion_from_tracks, run_datum
from towline.geometry.lag import OF_A_MARK
from towline.geometry.poses import framed
from towline.record import Run

SEEDS = (3, 4, 5)
LAG_PX = 0.15
"""A codec's lag, as tracks of strongly compressed films tell it."""
TOLD_MEANS = 400
"""Means of y and heading of a run, about: what it tells of the noise's variance."""


def filmed(run: Run) -> Run:
    """The same run, its marks of a film."""
    source = run.file.source.model_copy(update={"video": "video.mp4"})
    return replace(run, file=run.file.model_copy(update={"source": source}))


def held_back(run: Run, tracks: pd.DataFrame, fit: DatumFit, seed: int) -> pd.DataFrame:
    """The tracks as a codec leaves them that holds all marks back by the same numbers in all runs, told as LAG_PX."""
    tracks = tracks.assign(sigma_lag_px=LAG_PX)
    modes = framed(run, tracks, fit).lags
    alike = np.tile(np.random.default_rng([7, seed]).normal(size=OF_A_MARK), len(modes) // OF_A_MARK)
    off = np.einsum("k,knmc->nmc", alike, np.nan_to_num(modes))
    for k, mark in enumerate(run.file.marker):
        rows = tracks["marker"] == mark.name
        tracks.loc[rows, ["u_px", "v_px"]] += off[:, k]
    return tracks


def campaign_of(
    cases: ModuleType,
    seed: int,
    slow_px: float,
    film: bool = False,
    still: bool = True,
    effect: str = "none",
    lag: str = "",
) -> TowSimulator:
    """Four tows on lines that keep their length, each mark's place off by ``slow_px`` that lasts.

    ``lag`` : all marks are held back by a codec, "told" by the tracks or "untold".
    """
    rng = np.random.default_rng([31, seed])
    campaign = cases.campaign(effect, rng, line="surge")
    recorded = []
    for run, tracks, static in campaign.runs[:4]:
        moved = tracks.copy()
        for _, rows in moved.groupby("marker").groups.items():
            off = wandering(len(rows), 1 / cases.RATE_HZ, slow_px, SLOW_S, rng, 2)
            moved.loc[rows, ["u_px", "v_px"]] += off.T
        fit = run_datum(run, None)
        if lag:
            moved = held_back(run, moved, fit, seed)
            moved = moved if lag == "told" else moved.drop(columns="sigma_lag_px")
        motion = motion_from_tracks(run, moved, fit)
        told = filmed(run) if film else run
        recorded.append(Recorded(told, motion.motion, motion.common, moved, fit, static if still else None))
    return TowSimulator(tow_runs(recorded, block_step([cases.DURATION_S])))


def fitted(cases: ModuleType, seed: int, *how: Any) -> tuple[TowSimulator, Inference, Fitted]:
    """A campaign of ``campaign_of``, and the simulator as it is."""
    simulator = campaign_of(cases, seed, *how)
    first = simulator.starts()[0]
    inference = Inference(simulator, simulator.noise(first))
    return simulator, inference, inference.fit([first], [Forces()], 8, (1,))[0]


def shares(before: TowSimulator, after: TowSimulator) -> np.ndarray:
    """(4,) what is left of what was granted in y, heading, line and distance."""
    return after.runs[0].slow.sd / before.runs[0].slow.sd


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_runs_show_stays_granted(cases: ModuleType, seed: int) -> None:
    simulator, inference, base = fitted(cases, seed, SLOW_PX)
    assert (shares(simulator, simulator.as_quiet_as(inference, base))[[0, 1, 3]] == 1.0).all()


@pytest.mark.slow
@pytest.mark.parametrize(("film", "still"), [(True, True), (False, False)])
def test_a_film_and_marks_without_a_static_record_are_not_granted_less_by_their_motion(
    cases: ModuleType, film: bool, still: bool
) -> None:
    """What light and codec do to a mark goes with its place; nobody has seen what the noise alone is."""
    simulator, inference, base = fitted(cases, SEEDS[0], 0.0, film, still)
    assert simulator.as_quiet_as(inference, base) is simulator


@pytest.mark.slow
@pytest.mark.parametrize("still", [True, False])
@pytest.mark.parametrize("slow_px", [0.0, 0.03, 0.06, 0.12])
def test_a_film_is_granted_what_its_marks_distance_shows(cases: ModuleType, slow_px: float, still: bool) -> None:
    """To a factor of two: four runs have some twenty stretches of SLOW_S, and most of what they tell is smooth in the place."""
    wanted = max(slow_px, SLOW_PX)
    for seed in SEEDS:
        (found,) = {run.slow.size_px for run in campaign_of(cases, seed, slow_px, film=True, still=still).runs}
        assert found in TRIED_PX
        assert wanted / 2 <= found <= 2 * wanted


@pytest.mark.once
@pytest.mark.parametrize("effect", ["lens_distortion", "deck_height", "rolling_shutter", "marker_roll", "datum_scale"])
def test_a_fault_of_the_camera_is_no_error_of_the_marks(cases: ModuleType, effect: str) -> None:
    """It goes smoothly with the place and the rates: what is granted stays as small as it is."""
    runs = campaign_of(cases, SEEDS[0], 0.0, film=True, effect=effect).runs
    assert {run.slow.size_px for run in runs} == {SLOW_PX}


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_codec_that_holds_all_marks_back_is_no_gap(cases: ModuleType, seed: int) -> None:
    """The marks' distance shows little of it; what the tracks tell of it does. Told, no more is left than without any lag."""
    size = {}
    for lag in ("", "told", "untold"):
        _, inference, base = fitted(cases, seed, 0.0, True, True, "none", lag)
        size[lag] = size_of(inference, base, Forces())
    noise = 1 + 3 * np.sqrt(2 / TOLD_MEANS)
    assert size["told"] < noise * size[""]
    assert size["untold"] > noise * size[""]


@pytest.mark.slow
def test_granting_what_is_granted_changes_nothing(cases: ModuleType) -> None:
    simulator, _, _ = fitted(cases, SEEDS[0], 0.0)
    run = simulator.runs[0]
    again = run
    for share in (0.25, 4.0):
        again = again.granted(again.slow.less([0, 1], share))
    again = again.granted(again.slow.of_size(0.1)).granted(again.slow)
    assert np.abs(again.covariance - run.covariance).max() < 1e-12 * run.covariance.max()
    assert np.abs(again.cross - run.cross).max() < 1e-12 * np.abs(run.cross).max()
