"""A tow as the diagnosis sees it: what the camera would show, how noisy that is, when its line was slack, what to tow next."""

from __future__ import annotations

import re
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from towline.diagnose.effects import Effect, Parameter
from towline.diagnose.inference.hypothesis import Hypothesis
from towline.diagnose.tow.data import Recorded, block_step, tow_runs
from towline.diagnose.tow.model import TowModel
from towline.diagnose.tow.next_run import differing
from towline.diagnose.tow.slackness import slack_effects
from towline.diagnose.tow.slow import LINE_SD_M, SLOW_PX, SLOW_S
from towline.diagnose.tow.start import excess_scatter
from towline.diagnose.tow.tow_run import TowRun
from towline.geometry import motion_from_tracks, run_datum
from towline.geometry.checks.bundle import half_sine
from towline.simulate import Hull, Start, simulate_full
from towline.simulate.model import Tow


@pytest.fixture(scope="module")
def filmed(cases: ModuleType) -> tuple[Any, Any, Any]:
    """(run, tracks, static record) of one tow, without noise of the forces on it."""
    return cases.campaign("none", np.random.default_rng(3)).runs[1]


def prepared(filmed: tuple[Any, Any, Any], tracks: Any = None, static: Any = None, pixels: bool = True) -> TowRun:
    """As the diagnosis takes it, with other tracks or another static record; ``pixels``: False as if it came as motion."""
    run, own, _ = filmed
    tracks = own if tracks is None else tracks
    fit = run_datum(run, None)
    motion = motion_from_tracks(run, tracks, fit)
    given = (tracks, fit, static) if pixels else (None, None, None)
    return tow_runs([Recorded(run, motion.motion, motion.common, *given)], block_step([45.0]))[0]


@pytest.fixture(scope="module")
def tow(filmed: tuple[Any, Any, Any]) -> TowRun:
    return prepared(filmed)


# what the camera would show ---------------------------------------------------------------------------------------


SPLINED = 2e-5
"""m, rad: marks scatter by 0.3 mm; a spline through every twelfth frame (0.48 s), read 20 ms later, moves by that times 0.02 / 0.48
and the square root of two marks."""


@pytest.mark.slow
@pytest.mark.parametrize("aside_m", [0.0, 0.5])
@pytest.mark.parametrize("way", [0, 1], ids=["rows", "columns"])
def test_a_rolling_shutter_sees_a_lower_mark_later(filmed: tuple[Any, Any, Any], aside_m: float, way: int) -> None:
    """Every mark from its own track 20 ms times its row's (or column's) share later: y, beta and marker distance change by the
    shutter's slopes times the rates of x, y and beta, to a twentieth of the largest change, with marks on the model's axis and
    beside it."""
    run, tracks, static = filmed
    marks = [m.model_copy(update={"body_m": (m.body_m[0], aside_m)}) for m in run.file.marker]
    run = replace(run, file=run.file.model_copy(update={"marker": tuple(marks)}))
    filmed, tow = (run, tracks, static), prepared((run, tracks, static))
    readout_s, (width, height) = 0.02, run.file.camera.image_size_px
    late = tracks.copy()
    for mark in tracks["marker"].unique():
        rows = (tracks["marker"] == mark) & (tracks["status"] == "measured")
        t_s = tracks.loc[rows, "t_s"].to_numpy()
        share = tracks.loc[rows, ("v_px", "u_px")[way]].to_numpy() / (height, width)[way] - 0.5
        for column in ("u_px", "v_px"):
            course = CubicSpline(t_s[::12], tracks.loc[rows, column].to_numpy()[::12])
            late.loc[rows, column] += course(t_s + readout_s * share) - course(t_s)
    seen = prepared(filmed, late).values - tow.values
    fit = run_datum(run, None)
    motion = motion_from_tracks(run, tracks, fit).motion
    rates = []
    for name in ("x_cg_m", "y_cg_m", "beta_rad"):
        course = CubicSpline(motion["t_s"].to_numpy()[::12], motion[name].to_numpy()[::12])
        rates.append(course(tow.centre_s + tow.start_s, 1))
    told = readout_s * np.einsum("nck,kn->nc", tow.shutter[way], np.array(rates))
    for channel, row in ((0, 1), (1, 2), (3, 3)):  # y, beta and distance among (x, y, beta, distance)
        largest = np.abs(told[:, row]).max()
        np.testing.assert_allclose(seen[2:-2, channel], told[2:-2, row], atol=0.05 * largest + SPLINED)


@pytest.fixture(scope="module")
def simulated(tow: TowRun, cases: ModuleType) -> tuple[TowModel, Hypothesis, Any]:
    """A model of one run, a hypothesis with a line and tow point unlike the stated ones, and the same tow integrated finely."""
    stated = tow.data.tow
    own = [0.1, 0.05, 0.0, 0.0, 0.0, 0.0, 3.9, stated.tow_point_m + 0.02, stated.line_length_m - 0.01, 1.28, 0, 0]
    h = Hypothesis(np.array(cases.SIX), np.array([own]))
    fine = Tow(1.28, own[8], own[7], own[6])
    t_s = np.arange(0, 20, 0.01)
    motion = simulate_full(Hull(*cases.SIX, speed_m_s=1.28), fine, Start(alpha_rad=0.1, beta_rad=0.05), t_s)
    return TowModel([tow], 1.28), h, motion


def test_a_line_is_as_long_as_the_stated_post_and_tow_point_make_it(
    tow: TowRun, simulated: tuple[TowModel, Hypothesis, Any]
) -> None:
    """The distance of the stated tow point from the post less the stated length, by the pose of the finely integrated tow."""
    model, h, motion = simulated
    stated = tow.data.tow
    x, y, beta = (motion[name].to_numpy() for name in ("x_cg_m", "y_cg_m", "beta_rad"))
    place = np.stack([x + stated.tow_point_m * np.cos(beta), y + stated.tow_point_m * np.sin(beta)])
    radius = np.hypot(*(place - np.array(stated.post_m)[:, None])) - stated.line_length_m
    seen = model.values([h])[0][0][:, 2]
    some = (tow.centre_s > 1) & (tow.centre_s < 19)
    np.testing.assert_allclose(seen[some], np.interp(tow.centre_s[some], motion["t_s"], radius), atol=5e-5)
    assert np.ptp(radius) > 5e-4  # it is no constant: the tow point that is stated is not the one it is towed at


@pytest.mark.parametrize(("channel", "name"), [(0, "x_cg_m"), (1, "y_cg_m"), (2, "beta_rad")])
def test_an_effect_is_shown_pose_and_rates_of_the_tow(
    tow: TowRun, simulated: tuple[TowModel, Hypothesis, Any], channel: int, name: str
) -> None:
    """An effect that adds them to what is measured of y, against the finely integrated tow and its differences."""
    model, h, motion = simulated
    some = (tow.centre_s > 1) & (tow.centre_s < 19)
    plain = model.values([h])[0][0][some, 0]
    course = motion[name].to_numpy()
    for attribute, wanted in (("pose", course), ("rate", np.gradient(course, 0.01))):
        effect = Effect(
            "shown", "camera", (Parameter("k", "", 1.0),), "", "",
            observe=lambda seen, k, a=attribute: (0.0, k * getattr(seen, a)[channel], 0.0, 0.0),
        )  # fmt: skip
        found = model.values([replace(h, effects=(effect,), numbers=(np.ones(1),))])[0][0][some, 0] - plain
        # the mean over a block differs from its middle by curvature times h^2/24
        off = tow.step_s**2 / 24 * np.abs(np.gradient(np.gradient(wanted, 0.01), 0.01))[50:-50].max()
        np.testing.assert_allclose(found, np.interp(tow.centre_s[some], motion["t_s"], wanted), atol=2 * off + 1e-5)


# how noisy it is --------------------------------------------------------------------------------------------------


def test_each_block_has_its_own_variance_beside_a_slow_error_that_all_share(
    filmed: tuple[Any, Any, Any], tow: TowRun
) -> None:
    """Marks with sigmas that grow fourfold over the run: block variances grow sixteenfold, the slow error stays as it is."""
    _, tracks, _ = filmed
    grown = tracks.copy()
    factor = 1 + 3 * (tracks["t_s"] - tracks["t_s"].min()) / np.ptp(tracks["t_s"])
    grown[["sigma_u_px", "sigma_v_px"]] = tracks[["sigma_u_px", "sigma_v_px"]].mul(factor, axis=0)
    more = prepared(filmed, grown)
    lag = np.abs(tow.centre_s[:, None] - tow.centre_s)
    for channel in range(4):
        covariance = tow.covariance[channel]
        slow = covariance[0, 20] / np.exp(-lag[0, 20] / SLOW_S)
        np.testing.assert_allclose(covariance, np.diag(np.diag(covariance) - slow) + slow * np.exp(-lag / SLOW_S))
        own, wider = np.diag(covariance) - slow, np.diag(more.covariance[channel])
        wider = wider - more.covariance[channel][0, 20] / np.exp(-lag[0, 20] / SLOW_S)
        np.testing.assert_allclose(wider[-1] / own[-1] / (wider[0] / own[0]), 16, rtol=0.05)


def test_the_slow_error_is_a_share_of_a_pixel_in_every_channel(filmed: tuple[Any, Any, Any], tow: TowRun) -> None:
    """A block's own variance is that of a mark's sigma over its frames; a line is no steadier than LINE_SD_M beside. How large a
    share is told by the distance of these marks, which wander by nothing.
    """
    assert SLOW_PX <= tow.slow.size_px <= 2 * SLOW_PX
    _, tracks, _ = filmed
    frames, sigma_px = tow.step_s * 25.0, tracks["sigma_u_px"].median()
    for channel in range(4):
        covariance = tow.covariance[channel]
        slow = covariance[0, 40] / np.exp(-(tow.centre_s[40] - tow.centre_s[0]) / SLOW_S)
        own = np.median(np.diag(covariance)) - slow
        slow -= LINE_SD_M**2 if channel == 2 else 0.0
        assert slow / own == pytest.approx(frames * (tow.slow.size_px / sigma_px) ** 2, rel=0.1)


@pytest.mark.parametrize("times", [2.0, 5.0])
def test_a_static_record_says_how_large_the_noise_is(filmed: tuple[Any, Any, Any], times: float) -> None:
    """The record's scatter so many times as large: so is the noise of every block, and the slow error is not."""
    static = filmed[2]
    wider = static.copy()
    for column in ("u_px", "v_px"):
        mean = static.groupby("marker")[column].transform("mean")
        wider[column] = mean + times * (static[column] - mean)
    once, more = prepared(filmed, static=static), prepared(filmed, static=wider)
    lag = np.abs(once.centre_s[:, None] - once.centre_s)
    for channel in range(4):
        own = (more.covariance[channel] - once.covariance[channel]) / (times**2 - 1)
        slow = once.covariance[channel] - own
        np.testing.assert_allclose(slow, slow[0, 0] * np.exp(-lag / SLOW_S), rtol=0.02)
        assert own[0, 0] > 0


def test_a_run_that_came_as_motion_has_no_line_and_a_lost_block_has_the_usual_noise(
    filmed: tuple[Any, Any, Any],
) -> None:
    run, tracks, _ = filmed
    motion = motion_from_tracks(run, tracks, run_datum(run, None)).motion
    lost = motion.copy()
    gone = (lost["t_s"] > 10) & (lost["t_s"] < 12)
    lost.loc[gone, ["y_cg_m", "beta_rad"]] = np.nan
    found = tow_runs([Recorded(run, lost[~gone])], block_step([45.0]))[0]
    inside = (found.centre_s > 10.5) & (found.centre_s < 11.5)
    assert np.isnan(found.values[inside]).all()
    assert np.isfinite(found.values[~inside & (found.centre_s < 9), :2]).all()
    for channel in (0, 1):
        variance = np.diag(found.covariance[channel])
        assert variance[inside] == pytest.approx(np.median(variance), rel=0.2)
    np.testing.assert_array_equal(found.covariance[2], np.eye(len(found.centre_s)))


def test_how_far_marks_scatter_about_a_smooth_course(tow: TowRun) -> None:
    """Noise of twice and five times what is stated about a cubic; too few blocks say nothing of it."""
    rng, n = np.random.default_rng(5), 400
    t = 0.5 * np.arange(n)
    values = np.full((n, 4), np.nan)
    values[:, :2] = np.column_stack([0.2 * np.cos(0.05 * (t - 80)), 1e-6 * (t - 80) ** 3])
    values[:, :2] += rng.normal(size=(n, 2)) * [2e-3, 5e-4]
    values[160, 0] = np.nan

    def cut(count: int, step_s: float) -> TowRun:
        covariance = np.stack([np.eye(count) * 1e-6, np.eye(count) * 1e-8])
        return replace(tow, values=values[:count], covariance=covariance, step_s=step_s)

    # a cubic over seven blocks takes four of their numbers: of the middle one (1 - 1/3) of its variance is left. Ten blocks say it
    # to 1 in sqrt(2 * 10 * 2/3), the largest of some forty independent ones is 2.2 of these above
    largest = np.sqrt(2 / 3) * (1 + 2.2 / np.sqrt(2 * 10 * 2 / 3))
    np.testing.assert_allclose(excess_scatter(cut(n, 0.5)), np.array([2.0, 5.0]) * largest, rtol=0.2)
    shaken = cut(n, 0.5)
    shaken.values[:10, 0] += 0.03 * (-1.0) ** np.arange(
        10
    )  # for five seconds by 30 times the noise: half of it is left at the ends
    assert excess_scatter(shaken)[0] > 15
    assert excess_scatter(shaken)[1] < 5.0 * 2
    for count, step_s, told in ((6, 0.5, False), (7, 0.5, True), (4, 2.0, False), (5, 2.0, True)):
        assert (excess_scatter(cut(count, step_s)) != 1.0).all() == told


# a slack line, and the next run -----------------------------------------------------------------------------------


def dipping(tow: TowRun, radii: list[np.ndarray]) -> tuple[list[TowRun], list[np.ndarray]]:
    """Runs good to 0.5 mm in the radius, whose base fit leaves these courses of it and nothing else."""
    count = len(radii[0])
    covariance = np.stack([np.eye(count) * 25e-8] * 4)
    runs = [replace(tow, centre_s=np.arange(0.25, 0.5 * count, 0.5), covariance=covariance) for _ in radii]
    return runs, [np.column_stack([0 * r, 0 * r, r, 0 * r]) for r in radii]


def test_slack_windows_are_those_of_the_radius_clearest_run_first(tow: TowRun) -> None:
    """Half sines of 6 mm and 3 mm in a radius good to 0.5 mm: each window to 0.4 s, one run, then both."""
    t, rng = np.arange(0.25, 40, 0.5), np.random.default_rng(7)
    dips = [(0.003, 12.0, 15.0), None, (0.006, 25.0, 29.5)]
    radii = [rng.normal(0, 5e-4, len(t)) - (d[0] * half_sine(t, *d[1:]) if d else 0.0) for d in dips]
    found = [e for e in slack_effects(*dipping(tow, radii)) if not e.variant.startswith("wave")]
    windows = [re.findall(r"run (\d) ([0-9.]+)-([0-9.]+) s", e.variant) for e in found]
    assert [[int(w[0]) for w in one] for one in windows] == [[3], [1, 3]]
    for run, begin, end in windows[1]:
        dip = dips[int(run) - 1]
        assert dip is not None
        assert (float(begin), float(end)) == pytest.approx(dip[1:], abs=0.4)
    assert slack_effects(*dipping(tow, [rng.normal(0, 5e-4, len(t)) for _ in dips])) == []


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ((1.6, 0.91, 1.28, 0.2, 0.0), "released at y 0.20 m"),
        ((1.9, 0.91, 1.28, 0.2, 0.0), "a tow point at 1.90 m, released at y 0.20 m"),
        (
            (1.4, 1.4, 1.28, -0.1, np.radians(5)),
            "a line of 1.40 m, a tow point at 1.40 m, released at y -0.10 m and 5 degrees heading",
        ),
        ((1.75, 0.91, 0.9, 0.2, 0.0), "0.90 m/s, released at y 0.20 m"),
    ],
)
def test_a_next_run_is_told_by_what_differs_from_those_made(setting: tuple[float, ...], said: str) -> None:
    assert differing([Tow(1.28, 0.91, x, 3.96) for x in (1.45, 1.6, 1.75)], setting) == said
