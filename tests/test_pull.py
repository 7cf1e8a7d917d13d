"""What stands beside a mark pulls it as model and line turn: the modes in closed form, in the motion, in the fit over seeds."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from slow_modes import assert_told, chi_squares, exact_tow

from towline.geometry.pull import PULL_PX_RAD, pull_modes
from towline.identify import RunData
from towline.pipeline.analysis import compute_motions, identify_batch
from towline.simulate.model import DERIVATIVE_UNITS

MARKS_M = (1.3, -1.1)
"""Along the hull, of a mark at the bow and one at the stern."""
SCALE_PX_M = 120.0
"""A small picture: the pulls show beside 1 mm of noise, and the derivatives are known well enough for a covariance to tell all."""


def test_each_mark_is_off_along_each_axis_by_each_angle_alone() -> None:
    """0.4 px a radian of heading, then of the line against the hull (alpha + beta), from the first frame to the last."""
    t_s = np.arange(0, 6, 0.04)
    beta, alpha = 0.1 * t_s - 0.2, 0.3 - 0.02 * t_s
    modes = pull_modes(t_s, beta, alpha, 2)
    assert modes.shape == (8, len(t_s), 2, 2)
    for k, mode in enumerate(modes):
        angle = beta if k < 4 else alpha + beta
        expected = np.zeros((len(t_s), 2, 2))
        expected[:, (k % 4) // 2, k % 2] = PULL_PX_RAD * angle
        np.testing.assert_allclose(mode, expected, atol=1e-12)


@pytest.mark.parametrize("period_s", [4.0, 8.0])
def test_a_swing_keeps_its_size_where_the_marks_come_into_view_too(period_s: float) -> None:
    """A parabola of a sine is off by less than its fourth derivative over one second within (w^4 / 24), and by less than its third
    at the ends (w^3 / 6). A mean would lose half of a swing of 4 s.
    """
    t_s = np.arange(0, 12, 0.04)
    swing, w = np.sin(2 * np.pi * t_s / period_s + 1.0), 2 * np.pi / period_s
    off = np.abs(pull_modes(t_s, swing, np.full(len(t_s), np.nan), 1)[0, :, 0, 0] / PULL_PX_RAD - swing)
    assert off[30:-30].max() < w**4 / 24
    assert off.max() < w**3 / 6


def test_without_a_line_only_the_heading_turns_anything() -> None:
    t_s = np.arange(0, 6, 0.04)
    beta = np.where(t_s > 3, np.nan, 0.1)
    modes = pull_modes(t_s, beta, np.full(len(t_s), np.nan), 1)
    assert modes.shape == (2, len(t_s), 1, 2)
    assert np.isfinite(modes).all()
    np.testing.assert_allclose(modes[0, t_s < 3.5, 0, 0], 0.1 * PULL_PX_RAD)


def test_the_motion_s_modes_are_what_such_a_pull_does_to_it(samples: Path) -> None:
    """Pixels moved by 0.4 px a radian of the true heading and line angle: y_CG, beta and alpha change as the modes say."""
    run, tracks, made = exact_tow(samples)
    t_s, beta, alpha = made.motion[["t_s", "beta_rad", "alpha_rad"]].to_numpy().T
    modes = pull_modes(t_s, beta, alpha, len(run.file.marker))
    assert len(modes) == 4 * len(run.file.marker)
    assert_told(run, tracks, made, modes, made.lag[: len(modes)])


def with_pulls(run: RunData) -> RunData:
    """The run with the modes by which its two marks may be pulled, of the motion as it is measured, noise and all."""
    alpha = np.arcsin((run.y_m + run.tow.tow_point_m * np.sin(run.beta_rad)) / run.tow.line_length_m)
    bow, stern = pull_modes(run.t_s, run.beta_rad, alpha, 2)[:, :, :, 0].transpose(2, 0, 1) / SCALE_PX_M
    beta = (bow - stern) / (MARKS_M[0] - MARKS_M[1])
    lag = np.stack([bow - MARKS_M[0] * beta, beta], axis=2)
    return replace(run, lag=lag[np.abs(lag).max(axis=(1, 2)) > 0], lag_key="camera")


@pytest.mark.slow
@pytest.mark.parametrize("pulled", [True, False])
def test_the_fit_takes_pulls_out_and_says_how_well(campaigns: ModuleType, pulled: bool) -> None:
    """Twenty campaigns of two tows whose marks are pulled by what is drawn, or not at all: chi-square of six each, 120 +- 15.5."""
    with_modes, without, largest = chi_squares(campaigns, with_pulls, 67, pulled)
    # its own noise is not explained by a pull: of 640 frames it would be, by a few standard deviations
    assert pulled or largest < 2.5
    # where nothing is pulled the modes' prior is wider than the truth, and the six are nearer than they say
    assert (120 - 4 * np.sqrt(240) if pulled else 20) < with_modes < 120 + 4 * np.sqrt(240)
    assert not pulled or without > 2 * with_modes


@pytest.mark.slow
def test_path_traced_tows_with_a_mirroring_bar(shared: Path, tmp_path: Path) -> None:
    """film_campaign, drawn by others: each derivative within 3.3 standard deviations (of six, once in 170) and 3 % of its truth."""
    folder = shared / "film_campaign"
    truth = json.loads((folder / "truth.json").read_text())
    runs = []
    for run in sorted(folder.glob("run-*")):
        runs.append(tmp_path / run.name)
        shutil.copytree(run, runs[-1])
    result = identify_batch(compute_motions(runs)).result
    found = result.derivatives
    for name in DERIVATIVE_UNITS:
        value = found[name]
        assert abs(value.value - truth[name]) < 3.3 * value.std, name
        assert value.value == pytest.approx(truth[name], rel=0.03), name
    z = np.array([(found[name].value - truth[name]) / found[name].std for name in DERIVATIVE_UNITS])
    assert z @ np.linalg.solve(np.array(result.correlation), z) < 16.8  # together: of six, 99 %
