"""Two cameras over one tow: clocks told from the motion, one motion of both, whether they agree, roll and heave."""

from __future__ import annotations

import copy
import json
import os
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import av
import numpy as np
import pytest
import tomlkit

from towline.cli import main
from towline.geometry.cameras.afloat import afloat_view
from towline.geometry.cameras.join import BOTH, FIRST, SECOND, Joined
from towline.geometry.cameras.match import Known, Match, match_views
from towline.geometry.cameras.motion import JointMotion, joint_motion
from towline.geometry.cameras.view import View, between, between_variance, rate_noise, rates
from towline.geometry.cameras.words import cameras_file
from towline.geometry.motion import run_datum
from towline.geometry.poses import poses_from_tracks
from towline.live.meeting import Meeting, MeetingRecorder
from towline.live.pieces import Ended, opened_of
from towline.live.source import Hearing
from towline.pipeline.stages import CAMERAS, compute_run_motion
from towline.record import GeometryError, InputError, RunFile, read_run
from towline.record.run import Run, cameras_of
from towline.record.toml import check_tables
from towline.vision import read_frames

SHORT_S = 25.0
"""Of a tow here: about two swings."""


def joined(case: Any) -> JointMotion:
    poses, mappings = [], []
    for view, tracks in zip(cameras_of(case.run), case.tracks, strict=True):
        fit = run_datum(view, None)
        mappings.append(fit.mapping)
        poses.append(poses_from_tracks(view, tracks, fit.mapping, fit, None, pulled=True))
    return joint_motion(case.run, poses, mappings)


def sds(course: Joined) -> np.ndarray:
    """(n, D) of all that is stated: frames and common."""
    return np.sqrt(np.einsum("ndd->nd", course.covariance) + (course.modes**2).sum(axis=0))


@pytest.fixture(scope="module")
def case(pairs: ModuleType) -> Any:
    return pairs.random_case(3, duration_s=SHORT_S)


@pytest.fixture(scope="module")
def found(case: Any) -> JointMotion:
    return joined(case)


# one camera between its frames ----------------------------------------------------------------------------------------


def drawn_view(
    t_s: np.ndarray, rng: np.random.Generator, path: Callable[[np.ndarray], np.ndarray], clock: np.ndarray
) -> View:
    """A view without common errors; ``clock``: the motion's time at each frame."""
    sd = np.array([1e-4, 1e-4, 5e-5])
    pose = path(clock) + sd * rng.standard_normal((len(t_s), 3))
    return View(t_s, pose, np.tile(np.diag(sd**2), (len(t_s), 1, 1)), np.zeros((0, len(t_s), 3)), 0, 0, 0)


def swing(t_s: np.ndarray) -> np.ndarray:
    fading = np.exp(-0.03 * t_s)
    return np.column_stack(
        [-2 + 0.01 * fading, 0.2 * fading * np.cos(0.7 * t_s), 0.08 * fading * np.sin(0.7 * t_s + 0.3)]
    )


def test_between_frames_a_cubic_is_met_exactly_and_gaps_are_left() -> None:
    t_s = np.delete(np.arange(40) / 10 + 0.01 * np.sin(np.arange(40)), [20, 21, 22])
    cubic = np.column_stack([t_s**3, 1 - t_s, 0.2 * t_s**2])
    view = View(t_s, cubic, np.tile(np.eye(3), (len(t_s), 1, 1)), np.zeros((0, len(t_s), 3)), 0, 0, 0)
    at_s = np.array([0.05, 0.3, 1.234, 1.95, 2.1, 3.0, 3.88])
    told = between(view, at_s)
    # before the second frame, beside and in the gap, behind the last but one there are no four frames about it
    assert told.told.tolist() == [False, True, True, False, False, True, False]
    exact = np.column_stack([at_s**3, 1 - at_s, 0.2 * at_s**2])
    assert np.abs(told.of(cubic) - exact)[told.told].max() < 1e-12
    # of four weights of which two stand nearly on a frame little noise is taken away, halfway 1 - 0.64 of it
    half = between(view, np.array([(t_s[5] + t_s[6]) / 2]))
    assert half.covariance(view.covariance)[0, 0, 0] == pytest.approx(0.64, abs=0.03)


def test_what_a_cubic_misses_of_a_fast_motion_is_known() -> None:
    """3/128 h^4 y'''' at the middle between frames, root mean square over a swing, against the error itself."""
    t_s = np.arange(400) / 5
    rng = np.random.default_rng(0)
    omega = 3.0

    def fast(at_s: np.ndarray) -> np.ndarray:
        return np.column_stack([0 * at_s, 0.1 * np.sin(omega * at_s), 0 * at_s])

    view = drawn_view(t_s, rng, fast, t_s)
    middle = (t_s[10:-10] + t_s[11:-9]) / 2
    error = between(view, middle).of(fast(t_s)) - fast(middle)
    assert np.sqrt(between_variance(view)[1]) == pytest.approx(error[:, 1].std(), rel=0.15)
    slow = drawn_view(t_s, rng, swing, t_s / 10)
    assert not between_variance(slow).any()


# the clock ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_clock_is_as_uncertain_as_it_says() -> None:
    """Offset and rate over their standard deviations, of views that know nothing but noise: 1, within three of its own chance."""
    draws, z = 80, []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        offset, rate = rng.uniform(-2, 2), rng.uniform(-1e-4, 1e-4)
        one_s, two_s = np.arange(300) / 15, np.arange(250) / 12.5
        one = drawn_view(one_s, rng, swing, one_s)
        two = drawn_view(two_s, rng, swing, offset + (1 + rate) * two_s)
        clock = match_views(one, two).clock
        z.append(((clock.offset_s - offset) / clock.offset_sd_s, (clock.rate - rate) / clock.rate_sd))
    assert np.sqrt(np.mean(np.square(z), axis=0)) == pytest.approx(np.ones(2), abs=3 / np.sqrt(2 * draws))


def test_offset_and_rate_of_a_tow(case: Any, found: JointMotion) -> None:
    clock = found.match.clock
    assert abs(clock.offset_s - case.offset_s) < 4 * clock.offset_sd_s
    assert abs(clock.rate - case.rate) < 4 * clock.rate_sd
    assert clock.offset_sd_s < 5e-3
    assert clock.first(clock.second(np.array([1.5]))) == pytest.approx([1.5], abs=1e-12)


def test_a_model_that_stands_still_tells_no_clock(pairs: ModuleType) -> None:
    still = pairs.random_case(3, duration_s=SHORT_S, still=True)
    with pytest.raises(InputError, match=r'camera\[2 "starboard"\].*too little to tell.*offset_s'):
        joined(still)


def test_noise_of_a_model_at_rest_is_no_motion_however_long_it_is_filmed() -> None:
    """What is known beforehand stands: by what the noise of rates feigned, a minute told the clock to 0.01 s, wherever that was."""
    rng = np.random.default_rng(2)

    def rest(t_s: np.ndarray) -> np.ndarray:
        return np.column_stack([-2 + 0 * t_s, 0.1 + 0 * t_s, 0.02 + 0 * t_s])

    one_s, two_s = np.arange(1800) / 30, np.arange(1500) / 25
    clock = match_views(drawn_view(one_s, rng, rest, one_s), drawn_view(two_s, rng, rest, two_s), Known(0.3, 0.2)).clock
    assert clock.offset_s == pytest.approx(0.3, abs=0.02)
    assert clock.offset_sd_s == pytest.approx(0.2, rel=0.05)


def test_a_motion_that_repeats_itself_needs_a_stated_offset() -> None:
    rng = np.random.default_rng(1)

    def steady(t_s: np.ndarray) -> np.ndarray:
        return np.column_stack([0 * t_s, 0.1 * np.sin(1.5 * t_s), 0.05 * np.cos(1.5 * t_s)])

    t_s = np.arange(900) / 30
    views = drawn_view(t_s, rng, steady, t_s), drawn_view(t_s, rng, steady, t_s + 0.4)
    with pytest.raises(GeometryError, match="repeats itself; state offset_s"):
        match_views(*views)
    clock = match_views(*views, Known(0.5, 0.2)).clock
    assert abs(clock.offset_s - 0.4) < 4 * clock.offset_sd_s < 0.01


@pytest.mark.parametrize(
    ("until_s", "words"), [(4.0, "no offset .* see one motion"), (2.0, "never see the model together")]
)
def test_cameras_that_do_not_see_the_model_together_say_so(case: Any, until_s: float, words: str) -> None:
    """Ends of two seconds are too short for any offset; ends of four look alike somewhere, but are not one motion."""
    first, second = case.tracks
    apart = replace(case, tracks=(first[first.t_s < until_s], second[second.t_s > 18]))
    with pytest.raises(InputError, match=words):
        joined(apart)


# one motion of both ---------------------------------------------------------------------------------------------------


def test_the_joined_motion_is_as_uncertain_as_it_says(case: Any, found: JointMotion) -> None:
    """Frames by their scatter about a smooth path, single and both; the whole error within what is stated."""
    course = found.joined
    error = course.pose - case.truth(course.t_s)[:, :3]
    whole = error / sds(course)
    seen = course.source > 0
    assert {FIRST, SECOND, BOTH} <= set(course.source.tolist())
    assert np.abs(whole[seen].mean(axis=0)).max() < 3.0
    for source in (FIRST, SECOND, BOTH):
        rows = course.source == source
        slow = np.polynomial.chebyshev.chebfit(course.t_s[rows] / SHORT_S, error[rows], 6)
        quick = error[rows] - np.polynomial.chebyshev.chebval(course.t_s[rows] / SHORT_S, slow).T
        stated = np.einsum("ndd->nd", course.covariance[rows]).mean(axis=0)
        # some 150 rows and more, of which neighbours share noise where the second camera is seen between its frames
        assert (quick**2).mean(axis=0) / stated == pytest.approx(np.ones(3), abs=0.35)


def test_rows_are_from_where_they_say_and_times_rise(case: Any, found: JointMotion) -> None:
    motion, course = found.motion, found.joined
    assert (np.diff(motion["t_s"]) > 0).all()
    names = {FIRST: "port", SECOND: "starboard", BOTH: "port+starboard"}
    assert [names.get(int(s), "") for s in course.source] == motion["camera"].tolist()
    assert ((motion["status"] == "lost") == (motion["camera"] == "")).all()
    first = case.tracks[0][case.tracks[0]["marker"] == "bow"]
    assert set(first["t_s"]) <= set(motion["t_s"])  # the first camera's clock is the run's
    lost = first.loc[first["status"] == "lost", "t_s"]
    assert not motion.loc[motion["t_s"].isin(lost), "camera"].str.contains("port").any()


def test_the_hand_over_is_no_step(pairs: ModuleType) -> None:
    """Error after less error before both hand-overs over the stated deviation of that: 1 over cases; as filmed it is a step."""
    steps = []
    for seed in range(4):
        case = pairs.random_case(seed + 40, duration_s=SHORT_S)
        course = joined(case).joined
        error = course.pose - case.truth(course.t_s)[:, :3]
        for one, other in ((FIRST, BOTH), (BOTH, SECOND)):
            edge = np.flatnonzero(course.source == other)[0]
            before = np.flatnonzero((course.source == one) & (np.arange(len(error)) < edge))[-15:]
            after = np.flatnonzero(course.source == other)[:15]
            step = error[after].mean(axis=0) - error[before].mean(axis=0)
            common = course.modes[:, after].mean(axis=1) - course.modes[:, before].mean(axis=1)
            noise = sum(np.einsum("ndd->d", course.covariance[rows]) / len(rows) ** 2 for rows in (before, after))
            steps.append(step / np.sqrt((common**2).sum(axis=0) + noise))
    rms = np.sqrt(np.mean(np.square(steps)))
    assert 0.6 < rms < 1.4  # 24 numbers, not all their own


def test_where_one_camera_is_off_they_do_not_agree(pairs: ModuleType, case: Any, found: JointMotion) -> None:
    assert found.match.agree
    assert found.match.widened == 1.0
    content = copy.deepcopy(case.content)
    for point in content["camera"][1]["datum"]:
        point["tank_m"][1] += 0.01  # the second camera's datum stands a centimetre aside
    run = Run(Path("case"), check_tables(content, RunFile, "run.toml"))
    off = joined(replace(case, run=run))
    assert not off.match.agree
    assert off.match.widened > 1.5
    said = cameras_file(run, off, "", {})
    assert any("do not agree" in sentence and "most in y" in sentence for sentence in said.sentences)
    assert said.differences["y_m"].mean == pytest.approx(-0.01, abs=4 * said.differences["y_m"].expected)
    assert off.motion["common_y_cg_m"].median() > 1.5 * found.motion["common_y_cg_m"].median()


def test_errors_that_last_make_the_clock_less_sure(case: Any, found: JointMotion) -> None:
    rng = np.random.default_rng(5)
    slow = np.repeat(rng.standard_normal(200), 20)[: len(case.tracks[1])] * 0.15
    wandering = case.tracks[1].assign(u_px=case.tracks[1]["u_px"] + slow)
    match: Match = joined(replace(case, tracks=(case.tracks[0], wandering))).match
    assert match.inflation > 2.0
    assert match.clock.offset_sd_s > 1.3 * found.match.clock.offset_sd_s


# roll and heave -------------------------------------------------------------------------------------------------------

MARKS = ("bow", "stern", "mast", "side")
SMALL_CHANGE = 1e-5
"""What a tenth of a millimetre either way adds to a mode beyond its slope, relative: the square of that over half a metre."""


def exact_afloat(pairs: ModuleType, case: Any, t_s: np.ndarray) -> np.ndarray:
    """The truth of the point that the product quotes: the LCG at the depth of the lowest mark."""
    from scipy.spatial.transform import Rotation

    pose = case.truth(t_s)
    down = max(pairs.MARKS[name][2] for name in MARKS) - pairs.AXIS_M
    moved = Rotation.from_euler("ZYX", pose[:, [2, 5, 4]]).as_matrix()[:, :, 2] * down
    pose[:, :2] += moved[:, :2]
    pose[:, 3] += moved[:, 2] - down
    return pose


def test_without_noise_one_camera_gives_back_all_six_numbers(pairs: ModuleType) -> None:
    case = pairs.random_case(8, MARKS, rolls=True, duration_s=4.0, noise=(0.0, 0.0), unsure=False)
    view = cameras_of(case.run)[0]
    fit = run_datum(view, None)
    seen = afloat_view(view, poses_from_tracks(view, case.tracks[0], fit.mapping, fit), fit.mapping)
    error = (seen.pose - exact_afloat(pairs, case, seen.t_s))[seen.seen]
    # what is wide beforehand (``ROOM``) draws by the ratio of the variances: 0.05 px stated, so below a hundredth of a frame's
    frame = np.sqrt(np.einsum("ndd->nd", seen.covariance[seen.seen]))
    assert np.abs(error / frame).max() < 0.1


def test_marks_off_their_places_move_a_leaning_model_as_its_modes_say(pairs: ModuleType) -> None:
    """By a run.toml with one number changed, fitted anew; the modes of a level model are a tenth off there."""
    case = pairs.random_case(7, MARKS, rolls=True, duration_s=12.0, noise=(0.0, 0.0), unsure=False)
    view = cameras_of(case.run)[0]
    unsure = {"marker_place_sd_m": 0.5e-3, "marker_depth_sd_m": 1e-3}
    priors = view.file.priors.model_copy(update=unsure)

    def seen_by(markers: Any) -> View:
        run = replace(view, file=view.file.model_copy(update={"marker": markers, "priors": priors}))
        fit = run_datum(run, None)
        return afloat_view(run, poses_from_tracks(run, case.tracks[0], fit.mapping, fit), fit.mapping)

    there, marks = seen_by(view.file.marker), list(view.file.marker)
    modes = there.modes[there.own :, there.seen]
    small, whole = 0.1, np.sqrt((modes**2).sum(axis=0)).min(axis=0)

    def moved(index: int, key: str, by: np.ndarray) -> np.ndarray:
        ends = []
        for sign in (small, -small):
            value = np.asarray(getattr(marks[index], key)) + sign * by
            change = {key: tuple(value) if value.ndim else float(value)}
            ends.append(seen_by((*marks[:index], marks[index].model_copy(update=change), *marks[index + 1 :])).pose)
        return (ends[0] - ends[1])[there.seen] / (2 * small)

    def assert_same(mode: np.ndarray, by: np.ndarray) -> None:
        apart = np.abs(mode - by).max(axis=0) / whole
        assert apart.max() < SMALL_CHANGE, apart

    for index, mark in enumerate(marks):
        # the lowest mark's depth is where the pose is quoted, too
        if mark.depth_m < max(m.depth_m for m in marks):
            assert_same(modes[index], moved(index, "depth_m", np.array(priors.marker_depth_sd_m)))
    at = len(marks)
    for index in range(len(marks)):
        for axis in range(2):
            assert_same(modes[at], moved(index, "body_m", priors.marker_place_sd_m * np.eye(2)[axis]))
            at += 1


def test_two_cameras_tell_roll(pairs: ModuleType) -> None:
    case = pairs.random_case(6, MARKS, rolls=True, duration_s=SHORT_S)
    found = joined(case)
    assert found.rolls
    course = found.joined
    both = course.source == BOTH
    error = (course.pose - exact_afloat(pairs, case, course.t_s))[both]
    assert np.degrees(error[:, 4].std()) < 0.1
    frame = np.sqrt(np.einsum("ndd->nd", course.covariance[both]).mean(axis=0))
    assert (error.std(axis=0) / frame)[3:] == pytest.approx(np.ones(3), abs=0.3)
    assert np.abs(error.mean(axis=0) / sds(course)[both].mean(axis=0)).max() < 3.5
    assert {"roll_rad", "sigma_roll_rad", "common_roll_rad", "heave_m", "pitch_rad"} <= set(found.motion)
    assert any("the model rolls" in s for s in cameras_file(case.run, found, "", {}).sentences)


def test_a_model_that_does_not_roll_is_not_said_to(pairs: ModuleType) -> None:
    found = joined(pairs.random_case(6, MARKS, duration_s=SHORT_S))
    assert not found.rolls
    assert found.joined.pose.shape[1] == 3
    assert found.motion["roll_rad"].notna().any()


def test_two_marks_tell_no_roll_and_it_is_said(case: Any, found: JointMotion) -> None:
    assert found.afloat is None
    said = cameras_file(case.run, found, "", {})
    assert said.rolls is None
    assert any("two marks" in sentence for sentence in said.sentences)
    assert "roll_rad" not in found.motion


# the run folder -------------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(case: Any, tmp_path: Path) -> Path:
    (tmp_path / "run.toml").write_text(tomlkit.dumps(case.content))
    for camera, table in zip(case.content["camera"], case.tracks, strict=True):
        table.to_csv(tmp_path / camera["tracks"], index=False)
    return tmp_path


def test_one_motion_of_both_in_the_run_folder(folder: Path, case: Any, found: JointMotion, capsys: Any) -> None:
    assert main(["motion", str(folder)]) == 0
    assert "starboard's clock shows 0" in capsys.readouterr().out
    said = json.loads((folder / "out" / CAMERAS).read_text())
    assert said["offset_s"]["value"] == pytest.approx(found.match.clock.offset_s, abs=1e-6)
    assert sum(said["rows"].values()) == len(found.motion)
    for name in ("port", "starboard"):
        assert (folder / "out" / name / "motion.csv").is_file()
    before = (folder / "out" / "motion.csv").stat().st_mtime_ns
    again = compute_run_motion(read_run(folder))
    assert (folder / "out" / "motion.csv").stat().st_mtime_ns == before
    assert again.common is not None
    assert again.common.shape == found.common.shape
    y = again.motion["y_cg_m"].to_numpy()
    assert np.nanmax(np.abs(y - found.motion["y_cg_m"].to_numpy())) < 1e-8


def test_check_says_whether_the_two_agree(folder: Path, capsys: Any) -> None:
    assert main(["check", str(folder), "--no-effects", "--no-page"]) == 0
    said = capsys.readouterr().out
    assert "(port): " in said
    assert "(starboard): " in said
    assert "port and starboard agree" in said


def test_corrections_by_hand_are_refused(folder: Path) -> None:
    (folder / "corrections.toml").write_text("version = 1\n")
    with pytest.raises(InputError, match="two \\[\\[camera\\]\\]"):
        compute_run_motion(read_run(folder))


def test_a_run_of_one_camera_is_what_it_was(samples: Path) -> None:
    run = read_run(samples / "mariner" / "x1446")
    assert cameras_of(run) == (run,)
    assert run.out == run.folder / "out"
    assert run.file.cameras == ()


def one_camera(content: dict[str, Any]) -> None:
    content["camera"].pop()


def own_source(content: dict[str, Any]) -> None:
    content["source"] = {"tracks": "port.csv"}


def static(content: dict[str, Any]) -> None:
    content["noise"] = {"static": "static.csv"}


def same_name(content: dict[str, Any]) -> None:
    content["camera"][1]["name"] = "port"


def no_recording(content: dict[str, Any]) -> None:
    del content["camera"][1]["tracks"]


def unknown_mark(content: dict[str, Any]) -> None:
    content["camera"][1]["seen_at_px"] = {"bou": [1.0, 2.0]}


def misspelt(content: dict[str, Any]) -> None:
    content["camera"][1]["offset"] = 1.0


def first_offset(content: dict[str, Any]) -> None:
    content["camera"][0]["offset_s"] = 1.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (one_camera, "1 \\[\\[camera\\]\\] tables; two are expected"),
        (own_source, "source: with \\[\\[camera\\]\\] each camera has its own"),
        (static, "static record of two cameras"),
        (same_name, "both are called 'port'"),
        (no_recording, 'camera\\[2 "starboard"\\]: exactly one of video, tracks'),
        (unknown_mark, "no \\[\\[marker\\]\\] is called 'bou'"),
        (misspelt, "offset: unknown key; did you mean 'offset_s'"),
        (first_offset, "offset_s stands with the second"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_what_is_wrong_with_two_cameras_is_named(
    case: Any, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    content = copy.deepcopy(case.content)
    change(content)
    with pytest.raises(InputError, match=words):
        check_tables(content, RunFile, "run.toml")


def test_rates_of_a_model_that_rolls() -> None:
    """Against the sines' own derivatives, with frames missing; and their noise against the scatter of many."""
    rng = np.random.default_rng(7)
    t_s = np.delete(np.arange(3000) / 30, np.arange(400, 440))
    period = np.array([15.0, 12.0, 10.0, 1.7, 2.3, 1.9])
    pose, rate = (
        np.sin(2 * np.pi * t_s[:, None] / period),
        2 * np.pi / period * np.cos(2 * np.pi * t_s[:, None] / period),
    )

    def seen(values: np.ndarray) -> View:
        n = len(t_s)
        return View(t_s, values, np.tile(np.eye(6), (n, 1, 1)), np.zeros((0, n, 6)), 0, 0, 0)

    whole = (np.abs(t_s - 420 / 30) > 1.0) & (t_s > 0.4) & (t_s < t_s[-1] - 0.4)
    error = (rates(seen(pose), t_s) - rate)[whole] * period / (2 * np.pi)
    # a cubic over +-h errs by (w h)^4 / 120 or less of the rate, at 1.7 s and 0.3 s by 0.0126
    assert np.abs(error).max() < 0.013
    noise = rng.standard_normal(pose.shape)
    scatter = rates(seen(noise), t_s)[whole].var()
    # some 2,900 frames by 6, of which 19 neighbours share theirs: 900 of their own, 5 % of scatter, taken three times
    assert abs(scatter / rate_noise(seen(noise)) - 1) < 0.15


@pytest.fixture(scope="module")
def filmed(films: ModuleType, samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Two small films of some seconds."""
    poses = (
        {"place_m": [-7.2, -1.6, -3.4], "look_at_m": [-2.5, 0.05, 0.15]},
        {"place_m": [-7.0, 1.9, -3.0], "look_at_m": [-2.5, -0.05, 0.15]},
    )
    scenario = samples / "mariner" / "x1446" / "scenario.toml"
    folder = tmp_path_factory.mktemp("two") / "tow"
    return films.film_two(scenario, folder, poses, (7.0, 8.0), (12.0, 10.0), 0.63, 1e-4, 7, (400, 300))


def test_two_films_end_to_end(filmed: Any, capsys: Any) -> None:
    """Tracked and joined by the command, against the renderer's truth."""
    assert main(["track", str(filmed.folder), "--no-overlay"]) == 0
    assert main(["motion", str(filmed.folder)]) == 0
    capsys.readouterr()
    said = json.loads((filmed.folder / "out" / CAMERAS).read_text())
    offset = said["offset_s"]
    assert abs(offset["value"] - filmed.offset_s) < 4 * offset["std"]
    motion = compute_run_motion(read_run(filmed.folder)).motion
    seen = motion[motion["status"] == "measured"]
    truth = filmed.truth(seen["t_s"].to_numpy())
    stated = np.hypot(seen["sigma_y_cg_m"].to_numpy(), seen["common_y_cg_m"].to_numpy())
    z = (seen["y_cg_m"].to_numpy() - truth[:, 1]) / stated
    assert np.sqrt(np.mean(z**2)) < 2.0
    assert set(seen["camera"]) == {"port", "starboard", "port+starboard"} - ({"port"} if offset["value"] < 0 else set())


@pytest.mark.slow
def test_two_sources_are_filmed_into_one_run(filmed: Any, tmp_path: Path, capsys: Any) -> None:
    """The two films, played at their own rate: the run folder that is made is one of two cameras, with every picture of both, each
    camera's values while it was filmed, the clock's offset, and the day's fit."""
    setup, day = filmed.folder, tmp_path / "day"
    words = [str(setup / "port.mp4"), str(setup / "starboard.mp4"), str(day), "--like", str(setup)]
    assert main(["live", *words]) == 0
    said = capsys.readouterr().out
    run = read_run(day / "tow-01")
    assert [camera.video for camera in run.file.cameras] == ["port.ts", "starboard.ts"]
    truth_y_m = filmed.truth(np.linspace(0, 8, 801))[:, 1]
    for name, film in zip(("port", "starboard"), ("port.mp4", "starboard.mp4"), strict=True):
        sent, recorded = (list(read_frames(path)) for path in (setup / film, run.folder / f"{name}.ts"))
        assert len(sent) == len(recorded)
        assert all(np.array_equal(a.luma, b.luma) for a, b in zip(sent, recorded, strict=True))
        assert f"{name}: {len(sent)} pictures recorded" in said
        records = [json.loads(line) for line in (run.out / name / "live.jsonl").read_text().splitlines()]
        seen = np.array([r["y_cg_m"][0] for r in records if r.get("y_cg_m")])
        assert len(seen) > 0
        assert seen.min() > truth_y_m.min() - 0.02
        assert seen.max() < truth_y_m.max() + 0.02
    together = [json.loads(line) for line in (run.out / "live.jsonl").read_text().splitlines()]
    rows = [r for r in together if "joint" in r and r["y_cg_m"] is not None]
    y_m, own_m, common_m = np.array([r["y_cg_m"] for r in rows]).T
    off = (y_m - filmed.truth(np.array([r["t_s"] for r in rows]))[:, 1]) / np.hypot(own_m, common_m)
    assert np.abs(off).max() < 5.0
    clocks = [r for r in together if "cameras" in r]
    for clock in (r for r in clocks if r["told"]):  # seven seconds may be too little, on a busy machine they are
        assert abs(clock["offset_s"][0] - filmed.offset_s) < 4 * clock["offset_s"][1]
    assert "port: y" in said
    assert "starboard's clock" in said
    assert json.loads((day / "day.json").read_text())["tows"] == [run.name]
    offset = json.loads((run.out / CAMERAS).read_text())["offset_s"]
    assert abs(offset["value"] - filmed.offset_s) < 4 * offset["std"]
    capsys.readouterr()
    assert main(["live", words[0], str(day), "--like", str(setup)]) == 1
    assert "one source to film from, but the set-up has two [[camera]] (port, starboard)" in capsys.readouterr().err


@pytest.mark.slow
def test_the_page_films_with_two_cameras(filmed: Any, tmp_path: Path, browsers: Any) -> None:
    """By clicks: the pair's set-up is opened, other steps say that it is none of theirs; both pictures, one course, what is said of
    the clock, the fit."""
    pytest.importorskip("nicegui", reason="nicegui is not installed (the extra app)")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (the extra test)")
    from test_app_browser import Served

    served, said = Served(filmed.folder, tmp_path / "errors.txt"), []
    with sync_api.sync_playwright() as playwright:
        browser = browsers.started(playwright)
        try:
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.set_default_timeout(60_000)
            page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
            page.on("pageerror", lambda e: said.append(str(e)))
            page.goto(served.address)
            page.locator(".head").wait_for()
            page.keyboard.press("3")
            page.get_by_text("Datum takes a run of one camera; one of two is filmed in step Live").wait_for()
            page.get_by_label("Source port", exact=True).fill(str(filmed.folder / "port.mp4"))
            page.get_by_label("Day", exact=True).fill(str(tmp_path / "today"))
            page.get_by_label("Day", exact=True).press("Tab")
            page.get_by_role("button", name="Film a tow", exact=True).click()
            page.get_by_text("Say where the pictures come from: Source starboard").wait_for()
            page.get_by_label("Source starboard", exact=True).fill(str(filmed.folder / "starboard.mp4"))
            page.get_by_label("Source starboard", exact=True).press("Tab")
            page.get_by_role("button", name="Film a tow", exact=True).click()
            page.locator(".plots .curve").first.wait_for()
            for name in ("port", "starboard"):
                page.get_by_alt_text(f"The tow as camera {name} sees it").wait_for()
            page.get_by_label("The two cameras").get_by_text("starboard's clock").first.wait_for()
            page.get_by_text(re.compile(r"port: 84 pictures.*; starboard: 7\d pictures.* Fitted")).wait_for()
            assert "port: bow" in page.get_by_label("Readiness").inner_text()
            assert re.search(r"by (port|starboard).*y_CG", page.get_by_label("Values now").inner_text())
            page.screenshot(path=str(Path(os.environ.get("TOWLINE_SHOTS", tmp_path)) / "8-two-cameras.png"))
            browser.close()
        finally:
            served.end()
    assert said == []
    assert "Traceback" not in (tmp_path / "errors.txt").read_text()


@pytest.mark.slow
def test_the_source_that_answers_first_waits_and_loses_nothing(filmed: Any, tmp_path: Path) -> None:
    """Its packets come before the other has answered: written first when it has, in their order, each with its time."""
    answers: list[Any] = []
    held: list[Any] = []

    def begin(given: Any) -> tuple[Any, list[Any]]:
        answers.extend(given)
        (tmp_path / "run").mkdir()
        return read_run(filmed.folder), []

    meeting = Meeting(2, begin)
    first, second = (
        MeetingRecorder(tmp_path / "run", name, meeting, k) for k, name in enumerate(("port", "starboard"))
    )
    hearing = Hearing(str(filmed.folder / "port.mp4"), lambda piece: held.append(piece) or first.take(piece))
    with av.open(str(filmed.folder / "starboard.mp4")) as other:
        hearing.start()
        while len(held) < 20:
            time.sleep(0.01)
        assert first.packets == 0
        assert not (tmp_path / "run").exists()
        second.take(opened_of(other.streams.video[0], True))
        hearing.join()
        second.take(Ended())
    assert [(a.recording, a.size_px) for a in answers] == [("port.ts", (400, 300)), ("starboard.ts", (400, 300))]
    sent = list(read_frames(filmed.folder / "port.mp4"))
    assert len(list(read_frames(tmp_path / "run" / "port.ts"))) == len(sent) == first.packets
    early = [times.t_s for _, times in first.early]
    assert len(early) >= 19
    assert (np.diff(early) > 0).all()
