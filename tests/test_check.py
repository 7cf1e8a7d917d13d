"""The camera check on random cameras: faults planted one at a time, nothing planted, coloured noise; intervals; refinement."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomlkit
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from towline.cli import main
from towline.geometry import motion_from_tracks, run_datum
from towline.geometry.camera import Lens
from towline.geometry.checks.bundle import Extra, State
from towline.geometry.checks.check import Check, bundle_of, camera_of, check_geometry, long_run_variance, tolerances
from towline.geometry.checks.faults import refit, screen
from towline.geometry.checks.jump import find_jump
from towline.geometry.checks.refine import open_words, refined
from towline.geometry.checks.seen import SeenCamera
from towline.geometry.datum_model import PLAIN
from towline.record import GeometryError, read_tracks
from towline.record.check_file import Refined
from towline.record.tables import write_table

FRAMES = 150
SEEDS = range(5)
KINDS = {"k1": "lens"}


def checked(case) -> Check:
    return check_geometry([case.run], [case.tracks], run_datum(case.run, None))


@pytest.mark.once
@pytest.mark.parametrize(
    "planted", ["deck height", "datum point", "datum width", "camera turned", "line length", "slack line", "k1"]
)
def test_a_planted_fault_is_named_with_its_size(cameras: ModuleType, planted: str) -> None:
    """Rates over 200 cameras are in the benchmark; here five each, all far beyond chance (k1: four of five)."""
    sizes = {"deck height": 0.02, "datum width": 0.01, "line length": 0.01, "k1": 0.05}
    named = 0
    for seed in SEEDS:
        scene = cameras.random_scene(np.random.default_rng(seed), FRAMES)
        case = cameras.film(scene, np.random.default_rng([seed, 7]), planted)
        check = checked(case)
        if not check.named:
            continue
        best = check.named[0]
        named += best.fault.kind.split(":")[0] == KINDS.get(planted, planted)
        assert best.solution is not None
        if planted in sizes and best.fault.kind == KINDS.get(planted, planted):
            column = list(check.bundle.names).index(next(iter(best.fault.released)))
            value, std = abs(best.solution.theta[column]), np.sqrt(best.solution.covariance[column, column])
            assert abs(value - sizes[planted]) < 4 * std
        if planted == "datum point":
            assert best.fault.item == case.item
        if planted == "camera turned":
            assert best.fault.extra is not None
            assert best.fault.extra.span_s[0] == case.at_s
    assert named >= (4 if planted == "k1" else 5)


@pytest.mark.slow
def test_nothing_planted_nothing_named(cameras: ModuleType) -> None:
    for seed in range(20):
        scene = cameras.random_scene(np.random.default_rng(seed), FRAMES)
        check = checked(cameras.film(scene, np.random.default_rng([seed, 7])))
        assert not check.named, check.named[0].fault


@pytest.mark.parametrize("marks", [2, 3])
def test_a_jump_of_the_picture_is_found_where_it_is_with_its_turn(marks: int) -> None:
    """Smooth paths, their noise, and a turn between two frames, 60 draws: its place in every one, its size without bias, and of
    the jump is left what the noise of 2 m - 3 numbers is."""
    t, at, turn = np.arange(120) / 10, 71, np.array([4e-3, -3e-3, 2e-3])
    slope = np.random.default_rng(1).normal(0, 900, (marks, 2, 3)) + 900 * np.array([[0, 1, 0.3], [-1, 0, 0.3]])
    turns, rests = [], []
    for seed in range(60):
        rng = np.random.default_rng([2, seed])
        sigma = np.tile([0.1, 0.2], (len(t), marks, 1))
        paths = 30 * np.sin(0.3 * t[:, None, None] + rng.uniform(0, 6, (marks, 2)))
        paths = paths + rng.normal(size=paths.shape) * sigma
        paths[at:] += slope @ turn
        paths[40, 0] = np.nan  # one lost frame
        film: Any = SimpleNamespace(t_s=t, pixel_px=paths, sigma_px=sigma)
        found = find_jump(film, np.tile(slope, (len(t), 1, 1, 1)), 1.0)
        assert found is not None
        assert (found.before_s, found.t_s) == (t[at - 1], t[at])
        assert found.rest_degrees == 2 * marks - 3
        assert found.gain > 100
        turns.append(found.turn_rad)
        rests.append(found.rest)
    error = np.mean(turns, axis=0) - turn
    assert (np.abs(error) < 4 * np.std(turns, axis=0) / np.sqrt(60)).all(), error
    degrees = 2 * marks - 3
    assert abs(np.mean(rests) - degrees) < 4 * np.sqrt(2 * degrees / 60)
    short: Any = SimpleNamespace(t_s=t[:6], pixel_px=paths[:6], sigma_px=sigma[:6])
    assert find_jump(short, np.tile(slope, (6, 1, 1, 1)), 1.0) is None


@pytest.mark.parametrize("hertz", [0.5, 1.0, 1.6])
def test_a_film_of_few_frames_is_no_turned_camera(cameras: ModuleType, hertz: float) -> None:
    """A swing of 16 s is no cubic over fourteen frames so far apart."""
    for seed in SEEDS:
        scene = cameras.random_scene(np.random.default_rng(seed), int(60 * hertz))
        check = checked(cameras.film(scene, np.random.default_rng([seed, 7])))
        assert not check.named, check.named[0].fault


@pytest.mark.slow
@pytest.mark.parametrize("planted", ["", "camera turned"])
def test_many_runs_of_one_set_up_hide_and_invent_no_turn(cameras: ModuleType, planted: str) -> None:
    """Twelve runs share 1500 frames, two a second; a turn is found at its own frame of ten a second all the same."""
    for seed in range(2):
        scene = cameras.random_scene(np.random.default_rng(seed), 600)
        films = [cameras.film(scene, np.random.default_rng([seed, k]), planted if k == 5 else "") for k in range(12)]
        check = check_geometry([f.run for f in films], [f.tracks for f in films], run_datum(films[0].run, None))
        assert np.median(np.diff(check.bundle.films[0].t_s)) > 0.45
        if not planted:
            assert not check.named, check.named[0].fault
            continue
        fault = check.named[0].fault
        assert (fault.kind, fault.item) == ("camera turned", 5)
        assert fault.extra is not None
        assert fault.extra.span_s == (films[5].at_s, np.inf)
        best = check.named[0].solution
        assert best is not None
        assert np.degrees(np.linalg.norm(best.theta[-3:])) == pytest.approx(0.3, rel=0.1)


def test_the_gain_of_a_jump_is_in_units_of_what_the_frames_show() -> None:
    """Noise five times as large as stated: the drop by chance is not 25 times that of right numbers; a window's own 36 numbers say
    how large the noise is to a quarter, so that the largest of many is a fifth to a half larger than with what is known."""
    t, rng = np.arange(120) / 10, np.random.default_rng(4)
    slope = rng.normal(0, 900, (2, 2, 3))
    gains = {1.0: [], 5.0: []}
    for factor, found in gains.items():
        for _ in range(40):
            paths = factor * rng.normal(0, 0.1, (len(t), 2, 2))
            film: Any = SimpleNamespace(t_s=t, pixel_px=paths, sigma_px=np.full((len(t), 2, 2), 0.1))
            jump = find_jump(film, np.tile(slope, (len(t), 1, 1, 1)), 1.0)
            assert jump is not None
            assert jump.frames == len(t) - 13
            found.append(jump.gain)
    assert 1.0 < np.mean(gains[5.0]) / np.mean(gains[1.0]) < 1.6
    assert 8 < np.mean(gains[1.0]) < 16  # the largest of some hundred chi-squares of 3, neighbours alike


@pytest.mark.parametrize("seed", [0, 3])
def test_one_linear_step_foresees_the_full_fit(cameras: ModuleType, seed: int) -> None:
    """Nothing planted, so that every fault is small: evidence and gain of the screening are those of the fit that releases it,
    but for what is not linear (0.1 in the log, 5 % of the gain beside it)."""
    scene = cameras.random_scene(np.random.default_rng(seed), 60)
    case = cameras.film(scene, np.random.default_rng([seed, 7]))
    fit = run_datum(case.run, None)
    bundle = bundle_of([case.run], [case.tracks], fit).with_inflation(1.7)
    sd = tolerances(bundle, case.run, fit)
    null = bundle.solve(sd)
    # two picks each, and of every frame two marks and the line less a pose; the camera's own six have no prior
    assert null.degrees == 2 * 10 + 60 * (2 * 2 + 1 - 3) - 6
    found = screen(bundle, null, sd)
    assert [s.evidence for s in found] == sorted((s.evidence for s in found), reverse=True)
    slack = [s for s in found if s.fault.kind == "slack line"]
    rest = [s for s in found if s.fault.kind not in ("slack line", "camera turned")]
    assert len(rest) == 11 + 2 * 2 + 10
    # windows of seven lengths, each a sixth of its length further on
    spans = [s.fault.extra.span_s for s in slack if s.fault.extra is not None]
    lengths = sorted({round(b - a, 6) for a, b in spans})
    assert lengths == [3.0, 4.5, 7.0, 10.0]  # a second apart, shorter ones hold fewer than three frames
    assert {s.fault.ways for s in slack} == {sum(int(np.ceil((59 - n) / (n / 6))) for n in (0.5, 1, 2, *lengths))}
    for scored in [*rest, *slack[:: len(slack) // 10]]:
        whole = refit(bundle, null, sd, scored)
        assert scored.evidence == pytest.approx(whole.evidence, abs=0.1), scored.fault
        assert scored.gain == pytest.approx(whole.gain, abs=0.1 + 0.05 * whole.gain), scored.fault


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8])
def test_sums_of_a_coloured_series_vary_as_itslong_run_variance_variance_says(memory: float) -> None:
    """1 + 2 (a + a^2 + ...) down to where a^k is a twentieth, of an autoregression of variance 1; 40 draws of 4000 samples, whose
    splines take a per cent or two. A mean over 40 draws is known to 2 %."""
    rng, t = np.random.default_rng(5), np.arange(4000) / 400
    found = []
    for _ in range(40):
        series = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.normal(size=4400))[400:]
        found.append(long_run_variance(t, series))
    powers = memory ** np.arange(1, 50)
    assert np.mean(found) == pytest.approx(1 + 2 * powers[powers > 0.05].sum(), rel=0.08)


@pytest.mark.slow
def test_coloured_noise_is_no_fault(cameras: ModuleType) -> None:
    """Marks whose errors last for a second (a codec's) carry less than their number says; white statistics would cry out."""
    for seed in range(10):
        scene = cameras.random_scene(np.random.default_rng(seed), 900)
        rng = np.random.default_rng([seed, 7])
        case = cameras.film(scene, rng, noise=(0.0, 0.3))
        slow = np.zeros((900, 4))
        for k in range(1, 900):
            slow[k] = 0.93 * slow[k - 1] + np.sqrt(1 - 0.93**2) * rng.normal(0, 0.05, 4)
        case.tracks[["u_px", "v_px"]] += slow.reshape(-1, 2)
        check = checked(case)
        assert check.inflation > 5  # (1 + 0.93)/(1 - 0.93) = 28 for the sum of many
        assert not check.named, check.named[0].fault


@pytest.mark.slow
def test_stated_intervals_hold_over_random_cameras(cameras: ModuleType) -> None:
    """Lens, heights, places of marks, picks and pixels unsure at once: 40 cameras, bounds 4 standard errors of a std."""
    draws, scores, frame = 40, [], []
    for seed in range(draws):
        scene = cameras.random_scene(np.random.default_rng(seed), 24)
        noisy, still = (
            cameras.film(scene, np.random.default_rng([seed, 1]), noise=noise, unsure=True)
            for noise in ((0.05, 0.3), (0.0, 0.3))
        )
        made = motion_from_tracks(noisy.run, noisy.tracks, run_datum(noisy.run, None)).motion
        calm = motion_from_tracks(still.run, still.tracks, run_datum(still.run, None)).motion
        keys = ["y_cg_m", "beta_rad", "alpha_rad"]
        common = calm[[f"common_{key}" for key in keys]].to_numpy()[12]
        scores.append((calm[keys].to_numpy()[12] - still.motion[12]) / common)
        frame.append((made[keys] - calm[keys]).to_numpy() / made[[f"sigma_{key}" for key in keys]].to_numpy())
    common_std, frame_std = np.std(scores, axis=0), np.concatenate(frame).std(axis=0)
    assert (np.abs(common_std - 1) < 4 / np.sqrt(2 * draws)).all(), common_std
    assert (np.abs(frame_std - 1) < 4 / np.sqrt(2 * draws * 24)).all(), frame_std


def test_slopes_of_a_camera_with_skewed_axes_against_differences() -> None:
    lens, turned = (
        Lens(900.0, 920.0, 630.0, 350.0, (-0.1, 0.02, 0.001, -0.002, 0.0)),
        Rotation.from_rotvec([1.9, 0.1, -0.2]),
    )
    place = np.array([[0.3, -0.2, 0.1], [-0.4, 0.5, 0.0]])

    def pixel(skew: float, moved: np.ndarray) -> np.ndarray:
        return SeenCamera(lens, skew, turned.as_matrix(), np.array([0.1, -0.2, 5.0])).project(moved)[0]

    _, by_camera, by_place = SeenCamera(lens, 25.0, turned.as_matrix(), np.array([0.1, -0.2, 5.0])).project(place)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        difference = (pixel(25.0, place + step) - pixel(25.0, place - step)) / 2e-6
        np.testing.assert_allclose(by_place[:, :, axis], difference, rtol=1e-6, atol=1e-5)
    difference = pixel(25.5, place) - pixel(24.5, place)
    np.testing.assert_allclose(by_camera[:, :, 9], difference, rtol=1e-6, atol=1e-9)


def test_slopes_of_the_bundle_against_differences(cameras: ModuleType) -> None:
    """Every parameter and every extra, at a point away from the solution."""
    scene = cameras.random_scene(np.random.default_rng(1), 12)
    case = cameras.film(scene, np.random.default_rng(2))
    fit = run_datum(case.run, None)
    bundle = bundle_of([case.run], [case.tracks], fit)
    extras = [Extra("point", 3), Extra("turn", 0, (20.0, np.inf)), Extra("slack", 0, (10.0, 40.0))]
    count = len(bundle.names)
    theta = np.zeros(count + 6)
    theta[count + 5] = 0.01
    film, rows = bundle.films[0], 5

    def residuals(theta: np.ndarray, pose: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
        r = Rotation.from_rotvec(turn).as_matrix()
        state = State(theta, r @ bundle.rig.rotation, r @ bundle.rig.translation + shift, [pose])
        return bundle.linear(0, state, extras).residual

    pose = bundle.start[0]
    zero = np.zeros(3)
    found = bundle.linear(0, State(theta, bundle.rig.rotation, bundle.rig.translation, [pose]), extras)
    by_pose, by_theta = found.by_pose, found.by_theta
    assert by_theta.shape == (len(film.t_s), rows, count + 6)
    for index in range(count + 6):
        step = 1e-4 if index < 4 or index == 9 else 1e-6
        e = step * np.eye(count + 6)[index]
        if 10 <= index < 16:
            turn, shift = (step * np.eye(6)[index - 10])[:3], (step * np.eye(6)[index - 10])[3:]
            ends = [residuals(theta, pose, s * turn, s * shift) for s in (1, -1)]
        else:
            ends = [residuals(theta + s * e, pose, zero, zero) for s in (1, -1)]
        slope = (ends[1] - ends[0]) / (2 * step)
        size = max(np.abs(slope).max(), 1e-9)
        np.testing.assert_allclose(by_theta[:, :, index], slope, atol=2e-5 * size, err_msg=str(index))
    for index in range(3):
        e = 1e-6 * np.eye(3)[index]
        ends = [residuals(theta, pose + s * e, zero, zero) for s in (1, -1)]
        slope = (ends[1] - ends[0]) / 2e-6
        np.testing.assert_allclose(by_pose[:, :, index], slope, atol=2e-5 * np.abs(slope).max())


def test_refinement_finds_what_the_invariants_hold_and_says_what_they_do_not(cameras: ModuleType) -> None:
    for seed in SEEDS:
        scene = cameras.random_scene(np.random.default_rng(seed), FRAMES)
        case = cameras.film(scene, np.random.default_rng([seed, 7]), "deck height")
        check = checked(case)
        (height,), words = refined(check, ["deck_height"])
        assert height.observable
        assert not words
        truth = scene.depth_m - case.run.file.marker[0].depth_m
        assert abs(height.value - truth) < 4 * height.std
        # close to the axis the three lengths of the taut line are one
        slight = scene.pose * [1.0, 0.02, 0.02]
        side = slight[:, 1] + cameras.TOW_POINT_M * np.sin(slight[:, 2])
        slight[:, 0] = -np.sqrt(cameras.LINE_M**2 - side**2) - cameras.TOW_POINT_M * np.cos(slight[:, 2])
        calm = checked(cameras.film(replace(scene, pose=slight), np.random.default_rng([seed, 7])))
        values, words = refined(calm, ["line_length", "post_ahead", "tow_point"])
        assert not any(v.observable for v in values)
        assert all(any(name in w for w in words) for name in ("line length", "post ahead", "tow point"))
    with pytest.raises(GeometryError, match="expected one of"):
        refined(check, ["tilt"])


def test_tolerances_are_what_is_stated_where_it_is(cameras: ModuleType) -> None:
    scene = cameras.random_scene(np.random.default_rng(0), 12)
    case = cameras.film(scene, np.random.default_rng(1), unsure=True)
    fit = run_datum(case.run, None)
    bundle = bundle_of([case.run], [case.tracks], fit)
    sd = dict(zip(bundle.names, tolerances(bundle, case.run, fit), strict=True))
    assert (sd["fx"], sd["k1"], sd["depth 0"], sd["ahead 1"]) == (2.0, 0.003, 2e-3, 1e-3)
    assert sd["line length"] == 1e-3
    assert np.isinf(sd["camera turn right"])
    assert sd["deck height"] == sd["datum width"] == 0.0


def test_the_command_names_the_fault_and_draws_its_page(
    cameras: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = cameras.random_scene(np.random.default_rng(3), FRAMES)
    case = cameras.film(scene, np.random.default_rng(4), "deck height")
    folder = tmp_path / "run"
    folder.mkdir()
    content = case.run.file.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    (folder / "run.toml").write_text(tomlkit.dumps(content))
    write_table(folder / "tracks.csv", case.tracks)
    assert len(read_tracks(folder / "tracks.csv")) == 2 * FRAMES
    assert main(["check", str(folder), "--no-effects", "--refine", "deck_height"]) == 0
    said = capsys.readouterr().out
    assert "the marks lie 2" in said or "the marks lie 1" in said
    file = json.loads((folder / "out" / "check.json").read_text())
    assert file["verdict"] == "fault"
    assert file["faults"][0]["kind"] == "deck height"
    page = (folder / "out" / "check.html").read_text()
    assert "Something is wrong" in page
    assert page.count("<img") >= 3
    assert "http" not in page.split("</style>")[1].replace("http://www.w3.org", "")
    assert main(["check", str(folder), "--refine", "nonsense", "--no-effects", "--no-page"]) == 1


@pytest.mark.parametrize("wrong", [False, True])
def test_check_says_one_thing_of_a_camera_without_a_fault(
    wrong: bool, cameras: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sound, in words and page alike; or, where the motion contradicts the load cell, nowhere sound."""
    from towline.identify.tension import GaugeCheck
    from towline.pipeline import checking
    from towline.report.check_page import check_page

    scene = cameras.random_scene(np.random.default_rng(3), FRAMES)
    case = cameras.film(scene, np.random.default_rng(4))
    gauge = GaugeCheck((2.0 if wrong else 1.0, 0.01), (0.0, 0.01), (0.0, 0.01))
    assert gauge.contradicted == wrong
    monkeypatch.setattr(checking, "gauges_of", lambda *_: {case.run.name: gauge})
    found = checking.checked([case.run], [case.tracks], effects=False)
    page = check_page(found)
    sound = ("nothing is wrong with the camera" in " ".join(found.file.sentences), "is sound" in page)
    assert found.file.verdict == ("unknown" if wrong else "sound")
    assert sound == (not wrong, not wrong)
    assert ("the motion contradicts it" in page) == ("Something does not fit" in page) == wrong
    # what a fault that was not named would have been is no second answer
    for one in found.file.tried:
        assert (one.sentence in page) == wrong


def test_what_the_camera_does_to_the_derivatives(samples: Path) -> None:
    """A deck 2 mm higher changes the derivatives by tenths of a per cent; doubling it doubles the change (it is linear)."""
    from towline.pipeline.checking import effects_of
    from towline.record import read_run

    run = read_run(samples / "mariner" / "x1548")
    truth = run.folder / "truth" / "tracks.csv"
    tracks = read_tracks(truth)
    fit = run_datum(run, None)
    changes = effects_of([run], [tracks], fit, lambda _: None, "deck")
    assert set(changes) == {"m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r"}
    priors = run.file.priors.model_copy(update={"marker_depth_sd_m": 4e-3})
    deeper = replace(run, file=run.file.model_copy(update={"priors": priors}))
    double = effects_of([deeper], [tracks], fit, lambda _: None, "deck")
    once, twice = changes["y_v"]["deck height 2 mm"], double["y_v"]["deck height 4 mm"]
    assert 0.02 < abs(once) < 2.0
    assert twice == pytest.approx(2 * once, rel=0.1)


@pytest.mark.parametrize("scale", [1.0, -0.3, 20.0])
def test_a_camera_without_a_lens_is_taken_out_of_its_matrix(scale: float) -> None:
    """K (R | t) of any size and sign: focal lengths, skew and centre, and where it stands; a stated lens stays as it is."""
    inner = np.array([[1100.0, 12.0, 630.0], [0, 1050.0, 350.0], [0, 0, 1]])
    rotation = Rotation.from_rotvec([1.9, 0.1, -0.2]).as_matrix()
    translation = np.array([0.1, -0.2, 5.0])
    matrix = scale * inner @ np.column_stack([rotation, translation])
    mapping: Any = SimpleNamespace(matrix=matrix, lens=PLAIN)
    lens, skew, turn, shift = camera_of(mapping)
    sign = np.sign(scale)  # what lies ahead is not known here
    np.testing.assert_allclose(lens.vector, [1100.0, 1050.0, 630.0, 350.0, 0, 0, 0, 0, 0], rtol=1e-9, atol=1e-9)
    assert skew == pytest.approx(12.0)
    np.testing.assert_allclose(turn, rotation, atol=1e-12)
    np.testing.assert_allclose(sign * np.abs(shift) * np.sign(translation), sign * translation, atol=1e-12)
    stated = Lens(900.0, 905.0, 470.0, 365.0, (-0.1, 0.0, 0.0, 0.0, 0.0))
    known: Any = SimpleNamespace(matrix=np.column_stack([rotation, translation]), lens=stated)
    lens, skew, turn, shift = camera_of(known)
    assert (lens, skew) == (stated, 0.0)
    np.testing.assert_allclose(turn, rotation, atol=1e-12)
    np.testing.assert_allclose(shift, translation, atol=1e-12)


def test_what_only_a_pair_tells_is_said_as_the_sum_that_is_fixed() -> None:
    """b - 2 a known to 0.001, a and b each to 0.02: one is told with the other, and the direction that stays open is named."""
    covariance = np.array([[1.0, 2.0], [2.0, 4.0]]) * 0.01**2 + np.diag([0.0, 1e-6])
    wide = np.array([0.03, 0.05])
    values = [
        Refined(parameter=n, stated=0.0, value=0.0, std=float(s), unit="m", observable=bool(s < 0.3 * w))
        for n, s, w in zip(("a", "b"), np.sqrt(np.diag(covariance)), wide, strict=True)
    ]
    said = open_words(["a", "b"], covariance, wide, values)
    assert said == [
        "a is not told by these runs (+- 0.01 m); it is left as stated",
        "b is not told by these runs (+- 0.02 m); it is left as stated",
        "a and b are told only together (correlation +0.999): these runs fix b -2 a, not both",
        said[3],
    ]
    assert re.fullmatch(
        r"null direction, in shares of what is possible: (\+0\.6\d a \+0\.7\d b|-0\.6\d a -0\.7\d b)", said[3]
    )
    apart = np.diag([1e-6, 1e-6])
    assert open_words(["a", "b"], apart, wide, [v.model_copy(update={"observable": True}) for v in values]) == []


@pytest.mark.parametrize(("gap_s", "seen"), [(0.15, True), (0.45, False)])
def test_frames_on_either_side_of_a_gap_are_not_compared(gap_s: float, seen: bool) -> None:
    """A step of all marks over a gap of more than three usual steps says nothing: nobody saw how the model went there."""
    rng, t = np.random.default_rng(3), np.arange(120) / 10
    t[60:] += gap_s
    slope = rng.normal(0, 900, (2, 2, 3))
    paths = rng.normal(0, 0.1, (120, 2, 2))
    paths[60:] += slope @ np.array([4e-3, -3e-3, 2e-3])
    film: Any = SimpleNamespace(t_s=t, pixel_px=paths, sigma_px=np.full((120, 2, 2), 0.1))
    found = find_jump(film, np.tile(slope, (120, 1, 1, 1)), 1.0)
    assert found is not None
    if not seen:
        assert found.gain < 30
        assert found.frames == 120 - 13 - 13  # no window of fourteen frames reaches over it
    else:
        assert found.t_s == pytest.approx(t[60])
        assert found.gain > 100
