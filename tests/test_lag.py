"""How a codec holds marks back: the modes in closed form, in the motion, and in the fit over many seeds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from towline.geometry import motion_from_tracks, run_datum
from towline.geometry.lag import PLAY_SHARE, SEAM_SHARE, SEAM_SPEEDS_PX, SPEEDS_PX, lag_modes
from towline.geometry.poses import LAG_COLUMN
from towline.identify import fit_runs
from towline.record import read_run, read_tracks

RATE_HZ, SIGMA_PX = 25.0, 0.05
COUNT = len(SPEEDS_PX) + 3 * len(SEAM_SPEEDS_PX) + 1
FAR_PX = 8.0
"""Of a block of 16: as far from its seams as can be (their middle is at whole multiples less a half)."""
ENDS = slice(10, -10)
"""Inside, a mean over 0.6 s has as many places before as after."""


def modes_of(u_px: np.ndarray, v_px: float = 7.5, repeated: np.ndarray | None = None, every: int = 1) -> np.ndarray:
    """(k, n, 2) of one mark."""
    frames = np.arange(0, len(u_px) * every, every)
    pixel = np.column_stack([u_px, np.full(len(u_px), v_px)])[:, None]
    repeated = np.zeros(len(u_px), dtype=bool) if repeated is None else repeated
    return lag_modes(frames, frames / RATE_HZ, pixel, np.array([SIGMA_PX]), repeated[:, None])[:, :, 0]


def steps(speed_px: float, count: int = 100, at_px: float = 407.5) -> np.ndarray:
    return at_px + speed_px * (np.arange(count) - count // 2)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("every", [1, 3])
def test_a_mark_stands_behind_by_what_its_speed_says(way: int, every: int) -> None:
    """Halfway between two speeds half of each mode, against the way; nothing along v, where it does not move."""
    speed = (SPEEDS_PX[1] + SPEEDS_PX[2]) / 2
    modes = modes_of(steps(way * speed * every), every=every)
    assert modes.shape == (COUNT, 100, 2)
    told = np.zeros(len(SPEEDS_PX))
    told[1:3] = -way * SIGMA_PX / 2
    np.testing.assert_allclose(modes[: len(SPEEDS_PX), ENDS, 0], np.tile(told[:, None], 80), atol=1e-12)
    np.testing.assert_array_equal(modes[: len(SPEEDS_PX), :, 1], 0.0)


@pytest.mark.parametrize("speed", [0.01, 0.7])
def test_slower_and_faster_marks_have_the_first_and_the_last_speed_s_lag(speed: float) -> None:
    modes = modes_of(steps(speed))
    at = 0 if speed < 0.1 else len(SPEEDS_PX) - 1
    np.testing.assert_allclose(modes[at, ENDS, 0], -SIGMA_PX, atol=1e-12)


def test_after_a_turn_the_play_is_taken_up_first() -> None:
    """A parabola: its mean over 0.6 s is the parabola, a little higher. The lag changes sides over twice the play's half width."""
    frames = np.arange(-60, 61)
    u_px = 407.5 + 0.5 * 0.0005 * frames**2
    taken = -modes_of(u_px)[0, :, 0] / SIGMA_PX
    after = 0.5 * 0.0005 * frames**2
    told = np.clip(-1 + after / (PLAY_SHARE * SIGMA_PX), -1, 1)
    inner = (frames > -20) & (frames <= 20) & (np.abs(0.0005 * frames) < SPEEDS_PX[0])
    np.testing.assert_allclose(taken[inner & (frames <= 0)], -1.0, atol=1e-12)
    np.testing.assert_allclose(taken[inner & (frames > 0)], told[inner & (frames > 0)], atol=1e-9)


def test_over_a_seam_there_are_modes_of_its_own() -> None:
    speed = SEAM_SPEEDS_PX[1]
    count, first = len(SEAM_SPEEDS_PX), len(SPEEDS_PX)
    for u_px, v_px, over in ((399.5, 7.5, (1, 0, 0)), (407.5, 15.5, (0, 1, 0)), (399.5, 15.5, (1, 1, 1))):
        modes = modes_of(steps(speed, 31, u_px), v_px)
        for k, share in enumerate(over):
            found = modes[first + k * count + 1, 10:-10, 0]
            np.testing.assert_allclose(found, -share * SEAM_SHARE * SIGMA_PX, atol=1e-12)
    seam = modes_of(steps(speed, 400))[first + 1, ENDS, 0] / (-SEAM_SHARE * SIGMA_PX)
    off = np.abs((steps(speed, 400)[ENDS] + 0.5 + FAR_PX) % 16 - FAR_PX)
    np.testing.assert_allclose(seam, np.clip((4.0 - off) / 1.5, 0, 1), atol=1e-9)


def test_a_repeated_picture_is_as_old_as_the_last_of_its_own() -> None:
    speed, run = 0.2, 3
    since = np.arange(100) % (run + 1)
    modes = modes_of(steps(speed), repeated=since > 0)
    np.testing.assert_allclose(modes[-1, ENDS, 0], -speed * since[ENDS], atol=1e-9)


def test_marks_that_cannot_lag_have_no_modes_and_lost_ones_none_while_lost() -> None:
    pixel = np.stack([np.column_stack([steps(0.1), np.full(100, 7.5)])] * 2, axis=1)
    frames, none = np.arange(100), np.zeros((100, 2), dtype=bool)
    assert lag_modes(frames, frames / 25, pixel, np.zeros(2), none).shape == (0, 100, 2, 2)
    pixel[40:50, 1] = np.nan
    modes = lag_modes(frames, frames / 25, pixel, np.array([SIGMA_PX, SIGMA_PX]), none)
    assert np.isfinite(modes).all()
    assert not modes[COUNT:, 40:50].any()
    assert not modes[:COUNT, :, 1].any()
    pixel[:, 1] = np.nan
    assert not lag_modes(frames, frames / 25, pixel, np.array([SIGMA_PX, SIGMA_PX]), none)[COUNT:].any()


def test_the_motion_s_lags_are_those_of_its_marks(samples: Path) -> None:
    """Every mode put on the pixels moves the pose as the motion's lag says."""
    run = read_run(samples / "mariner" / "x1446")
    tracks = read_tracks(run.folder / "truth" / "tracks.csv")
    tracks = tracks[tracks["frame"] < 200].reset_index(drop=True).assign(sigma_u_px=0.05, sigma_v_px=0.05)
    fit = run_datum(run, (960, 720))
    pulls = motion_from_tracks(
        run, tracks, fit
    ).lag  # what else goes with the motion and not with the place (test_pull.py)
    made = motion_from_tracks(run, tracks.assign(**{LAG_COLUMN: SIGMA_PX}), fit)
    names = [m.name for m in run.file.marker]
    pixel = np.stack([tracks.loc[tracks["marker"] == n, ["u_px", "v_px"]].to_numpy() for n in names], axis=1)
    frames = np.unique(tracks["frame"])
    t_s = tracks["t_s"].to_numpy()[:: len(names)]
    modes = lag_modes(frames, t_s, pixel, np.full(len(names), SIGMA_PX), np.zeros(pixel.shape[:2], dtype=bool))
    assert made.lag.shape == (len(pulls) + len(modes), len(frames), 3)
    whole = 0.0
    for mode, told in zip(modes, made.lag[len(pulls) :], strict=True):
        moved = tracks.copy()
        for k, name in enumerate(names):
            moved.loc[moved["marker"] == name, ["u_px", "v_px"]] += mode[:, k]
        change = motion_from_tracks(run, moved, fit).motion[["y_cg_m", "beta_rad", "alpha_rad"]].to_numpy() - (
            made.motion[["y_cg_m", "beta_rad", "alpha_rad"]].to_numpy()
        )
        whole = max(whole, float(np.abs(told).max()))
        # the projection's curvature over 0.05 px of 1000, and weights that turn with the rays
        np.testing.assert_allclose(change, told, atol=5e-3 * np.abs(told).max() + 1e-12)
    assert whole > 1e-5
    # the lag has no part in the run's common uncertainty: it changes sides
    columns = ["common_y_cg_m", "common_beta_rad"]
    np.testing.assert_array_equal(made.motion[columns], motion_from_tracks(run, tracks, fit).motion[columns])


@pytest.mark.slow
def test_the_fit_takes_lags_out_and_says_how_well(campaigns: ModuleType) -> None:
    """Twenty campaigns whose two runs lag alike by what is drawn: chi-square of six derivatives each, 120 +- 15.5."""
    t_s = campaigns.times(16.0, 40.0)
    still = [campaigns.still_run(x, t_s, "modal") for x in campaigns.POINTS_M[::3]]
    scale = 30.0  # px a metre: 0.01 to 0.3 px a frame
    lagging = []
    for run in still:
        pixel = np.column_stack([407.5 + scale * run.y_m, np.full(len(t_s), 7.5)])[:, None]
        modes = lag_modes(np.arange(len(t_s)), t_s, pixel, np.array([0.1]), np.zeros((len(t_s), 1), dtype=bool))
        lag = np.stack([modes[:, :, 0, 0] / scale, np.zeros(modes.shape[:2])], axis=2)
        lagging.append(replace(run, lag=lag, lag_key="camera"))
    with_modes = without = 0.0
    sizes = []
    for seed in range(20):
        rng = np.random.default_rng([61, seed])
        drawn = rng.normal(size=len(lagging[0].lag))
        runs = [replace(r, y_m=r.y_m + drawn @ r.lag[:, :, 0]) for r in campaigns.campaign(lagging, rng)]
        fit = fit_runs(runs, "linear")
        gap = fit.six - campaigns.SIX
        with_modes += float(gap @ np.linalg.solve(fit.covariance, gap))
        sizes.append(fit.modes["camera"][0] - drawn[0])
        naive = fit_runs([replace(r, lag=r.lag[:0]) for r in runs], "linear")
        gap = naive.six - campaigns.SIX
        without += float(gap @ np.linalg.solve(naive.covariance, gap))
    assert 120 - 4 * np.sqrt(240) < with_modes < 120 + 4 * np.sqrt(240)
    assert without > 2 * with_modes
    assert np.std(sizes) < 0.7  # the slowest speed's lag is known better than before


def test_modes_that_jump_with_a_hidden_mark_stay_whole(campaigns: ModuleType) -> None:
    """One of three marks is hidden for a while: the pose then stands on the other two, whose errors are others."""
    t_s = campaigns.times(16.0, 40.0)
    hidden = (t_s > 12) & (t_s < 13)
    runs = []
    for index, x in enumerate(campaigns.POINTS_M[::3]):
        made = campaigns.noisy(campaigns.still_run(x, t_s, "modal"), np.random.default_rng([62, index]))
        mode = np.zeros((1, len(t_s), 2))
        mode[0, :, 0] = 0.01 * made.y_m + np.where(hidden, 0.02, 0.0)
        runs.append(replace(made, y_m=made.y_m + mode[0, :, 0], common=mode, common_key="camera"))
    fit = fit_runs(runs, "linear")
    assert fit.modes["camera"][0] == pytest.approx(1.0, abs=0.05)  # 32 samples of 1 mm know 20 mm to 1 %
    for residual in fit.residual:
        assert abs(residual[hidden, 0].mean()) < 4e-3 / np.sqrt(hidden.sum())
    assert (np.abs(fit.six - campaigns.SIX) < 4 * np.sqrt(np.diag(fit.covariance))).all()
