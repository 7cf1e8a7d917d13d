"""A camera's fault does to a mean what it does to its frames, however the sigmas of a film go up and down."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from towline.diagnose.tow.data import Recorded, corrected, tow_runs
from towline.diagnose.tow.evened import evened
from towline.diagnose.tow.tow_run import TowRun
from towline.geometry import motion_from_tracks, run_datum
from towline.record import Run

STEP_S = 0.35
JITTER = 0.07
"""By which a film's sigmas change from frame to frame."""
DEEPER_M = 0.025
"""The first mark's depth is wrong by this: the marks seem a centimetre or two nearer together than they are."""
HIDDEN = 0.25
"""Of a mean's noise: so much beside it adds 6 % to chi-square."""


def jittering(tracks: pd.DataFrame, seed: int) -> pd.DataFrame:
    rng = np.random.default_rng([41, seed])
    up = np.exp(JITTER * rng.normal(size=len(tracks)))
    return tracks.assign(sigma_u_px=up * tracks["sigma_u_px"], sigma_v_px=up * tracks["sigma_v_px"])


def deeper(run: Run) -> Run:
    first, *others = run.file.marker
    first = first.model_copy(update={"depth_m": first.depth_m + DEEPER_M})
    return replace(run, file=run.file.model_copy(update={"marker": (first, *others)}))


def tow(run: Run, tracks: pd.DataFrame) -> TowRun:
    fit = run_datum(run, None)
    motion = motion_from_tracks(run, tracks, fit)
    return tow_runs([Recorded(run, motion.motion, motion.common, tracks, fit)], STEP_S)[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_fault_moves_means_as_it_moves_their_frames(cases: ModuleType, seed: int) -> None:
    """By a frame of each mean it is told what the true depth does; beside the mean of all frames it is off by less than noise."""
    run, tracks, _ = cases.campaign("none", np.random.default_rng([43, seed]), line="surge").runs[0]
    tracks = jittering(tracks, seed)
    stated, true = tow(run, tracks), tow(deeper(run), tracks)
    assert stated.marks is not None
    told = corrected(stated, deeper(run), stated.marks.fit.mapping)
    off = told - (true.values - stated.values)
    noise = np.sqrt([np.diag(c).min() for c in stated.covariance])
    # at both ends one frame stands for half a mean
    assert (np.sqrt(np.nanmean(off[1:-1] ** 2, axis=0)) < HIDDEN * noise).all()


def test_only_what_changes_from_frame_to_frame_is_taken_out() -> None:
    """A mark that fades counts less and less, one that was hardly seen in a frame hardly counts there, a lost one stays lost, and
    how noisy a frame is as a whole stays its own.
    """
    n = 500
    level, fading = np.exp(0.3 * np.random.default_rng(45).normal(size=n)), np.linspace(1.0, 3.0, n)
    marks = {"bow": 0.03 * level * fading, "stern": 0.03 * level}
    rows = pd.concat(
        pd.DataFrame({"frame": np.arange(n), "t_s": np.arange(n) / 25, "marker": name, "status": "measured"}).assign(
            sigma_u_px=sigma, sigma_v_px=sigma
        )
        for name, sigma in marks.items()
    ).reset_index(drop=True)
    rows.loc[100, ["sigma_u_px", "sigma_v_px"]] = 1.0
    rows.loc[200, "status"], rows.loc[200, ["sigma_u_px", "sigma_v_px"]] = "lost", np.nan
    even = evened(rows.sample(frac=1, random_state=1)).sort_index()
    assert even.loc[100, "sigma_u_px"] == pytest.approx(1.0, rel=1e-12)
    assert np.isnan(even.loc[200, "sigma_u_px"])
    bow, stern = (even[even["marker"] == name]["sigma_u_px"].to_numpy() for name in marks)
    usual = np.delete(np.arange(n), [100, 200])
    np.testing.assert_allclose((bow * stern)[usual], (marks["bow"] * marks["stern"])[usual], rtol=1e-12)
    half = 51 * (fading[1] - fading[0])  # at the ends half a median is there
    assert np.abs(bow / stern - fading)[usual].max() <= half
    kept = [name for name in rows if name not in ("sigma_u_px", "sigma_v_px")]
    pd.testing.assert_frame_equal(even[kept], rows[kept])
