"""The renderer against closed forms: what it draws must lie where its truth says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from towline.record import InputError, read_result, read_run, read_tracks
from towline.record.files import sha256_of_file
from towline.record.results import TruthFile
from towline.record.scenario import FilmMarker, ScenarioFile
from towline.record.toml import check_tables
from towline.simulate import render, simulate_scenario
from towline.simulate.picture_light import LIGHT_BGR, add_light
from towline.simulate.render import camera_of, film_frames, render_scenario, true_tracks
from towline.simulate.scene import stage_of

NO_NOISE = {"read_noise_dn": 0.0, "electrons_per_dn": 1e9, "ripple": 0.0}


def scenario(seed: int = 5, duration_s: float = 0.2, film: dict[str, Any] | None = None, **more: Any) -> ScenarioFile:
    """A small picture of a MARINER tow."""
    datum = [
        {"name": f"{side}{end}{depth}", "tank_m": [x, y, depth]}
        for end, x in (("far", -0.4), ("near", -4.3))
        for side, y in (("port", -1.0), ("starboard", 1.0))
        for depth in (0.0, 0.25)
    ]
    content: dict[str, Any] = {
        "name": "small",
        "seed": seed,
        "time": {"duration_s": duration_s, "rate_hz": 30.0},
        "hull": {
            "speed_m_s": 1.28,
            "m_minus_y_vdot": 149.19,
            "i_minus_n_rdot": 62.11,
            "y_v": -52.87,
            "y_r_minus_mu": -66.33,
            "n_v": -48.51,
            "n_r": -57.60,
        },
        "tow": {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": 1.548, "tension_n": 3.96},
        "start": {"y_cg_m": 0.2, "r_rad_s": 0.1},
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "marker": [
            {"name": "bow", "body_m": [1.0, 0.02], "depth_m": 0.12, "colour": "red"},
            {"name": "stern", "body_m": [-1.0, 0.0], "depth_m": 0.13},
        ],
        "film": {
            "camera": {
                "image_size_px": [320, 240],
                "fx_px": 340.0,
                "fy_px": 342.0,
                "cx_px": 159.5,
                "cy_px": 119.5,
                "distortion": [-0.08, 0.01, 0.0, 0.0, 0.0],
            },
            "pose": {"place_m": [-7.0, 0.3, -3.3], "look_at_m": [-2.4, 0.0, 0.1], "roll_rad": 0.02},
            "datum": datum,
            **(film or {}),
        },
        **more,
    }
    return check_tables(content, ScenarioFile, "scenario.toml")


def filmed(file: ScenarioFile, folder: Path = Path()) -> tuple[pd.DataFrame, list[np.ndarray]]:
    motion = simulate_scenario(file, folder)
    return motion, [frame for _, _, frame in film_frames(file, motion)]


def test_true_tracks_are_the_projected_rigid_body():
    file = scenario(duration_s=2.0)
    motion, camera = simulate_scenario(file, Path()), camera_of(file)
    tracks = true_tracks(file, motion, camera)
    assert list(tracks.columns[:5]) == ["frame", "t_s", "marker", "u_px", "v_px"]
    for marker in file.marker:
        xi, yi = marker.body_m
        beta = motion.beta_rad.to_numpy()
        x = motion.x_cg_m + xi * np.cos(beta) - yi * np.sin(beta)
        y = motion.y_cg_m + xi * np.sin(beta) + yi * np.cos(beta)
        expected = camera.project(np.column_stack([x, y, np.full(len(x), marker.depth_m)]))
        mine = tracks[tracks.marker == marker.name]
        np.testing.assert_allclose(mine[["u_px", "v_px"]], expected, atol=1e-9)
        np.testing.assert_array_equal(mine.t_s, motion.t_s)
        np.testing.assert_array_equal(mine.frame, np.arange(len(motion)))


def test_marks_follow_roll_pitch_and_heave():
    # scipy turns the body by heading, then pitch, then roll, about the LCG at the water line, 0.25 m below the tank top
    file = scenario(duration_s=1.0)
    motion, camera = simulate_scenario(file, Path()), camera_of(file)
    t_s = motion.t_s.to_numpy()
    roll, pitch, heave = 0.04 * np.sin(3 * t_s), 0.02 * np.cos(2 * t_s), 0.005 * np.sin(4 * t_s)
    motion = motion.assign(roll_rad=roll, pitch_rad=pitch, heave_m=heave)
    tracks = true_tracks(file, motion, camera)
    turned = Rotation.from_euler("ZYX", np.column_stack([motion.beta_rad, pitch, roll])).as_matrix()
    for marker in file.marker:
        place = turned @ np.array([*marker.body_m, marker.depth_m - 0.25]) + np.column_stack(
            [motion.x_cg_m, motion.y_cg_m, 0.25 + heave]
        )
        mine = tracks[tracks.marker == marker.name]
        np.testing.assert_allclose(mine[["u_px", "v_px"]], camera.project(place), atol=1e-9)


@pytest.mark.slow
def test_the_deck_turns_with_its_marks():
    """What is painted on the deck is seen where scipy's rotation puts it: of a model that heels by 5 degrees, sampled there, it is
    that of the level one; sampled where it had been at rest it is not."""
    film = NO_NOISE | {
        "camera": {"image_size_px": [1280, 960], "fx_px": 1360.0, "fy_px": 1368.0, "cx_px": 639.5, "cy_px": 479.5}
    }
    file = scenario(film=film)
    motion, camera, deck_m = simulate_scenario(file, Path()).iloc[:1], camera_of(file), stage_of(file).deck_m
    tilt = {"roll_rad": 0.09, "pitch_rad": -0.02, "heave_m": 0.01}
    (_, _, level), (_, _, tilted) = (next(film_frames(file, m)) for m in (motion, motion.assign(**tilt)))
    along, aside = np.meshgrid(np.linspace(-0.9, 0.7, 300), np.linspace(-0.16, 0.16, 60))
    body = np.column_stack([along.ravel(), aside.ravel(), np.full(along.size, deck_m - 0.25)])

    def sampled(picture: np.ndarray, heading: float, pitch: float, roll: float, heave: float) -> np.ndarray:
        turned = Rotation.from_euler("ZYX", [heading, pitch, roll]).apply(body)
        place = turned + np.array([motion.x_cg_m.iloc[0], motion.y_cg_m.iloc[0], 0.25 + heave])
        at = np.round(camera.project(place)).astype(int)
        return picture[at[:, 1], at[:, 0]].astype(float).mean(axis=1)

    beta = float(motion.beta_rad.iloc[0])
    before = sampled(level, beta, 0.0, 0.0, 0.0)
    there = sampled(tilted, beta, tilt["pitch_rad"], tilt["roll_rad"], tilt["heave_m"])
    stayed = sampled(tilted, beta, 0.0, 0.0, 0.0)
    assert np.corrcoef(before, there)[0, 1] > 0.9
    assert np.abs(before - there).mean() < 0.3 * np.abs(before - stayed).mean()


def test_line_keeps_its_length_in_the_drawn_motion():
    # tow point from two drawn marks; distance to the post = L (theory.md 4, fact ii)
    file = scenario(duration_s=2.0)
    motion = simulate_scenario(file, Path())
    x = motion.x_cg_m + 1.548 * np.cos(motion.beta_rad)
    y = motion.y_cg_m + 1.548 * np.sin(motion.beta_rad)
    np.testing.assert_allclose(np.hypot(x, y), 0.91, atol=1e-12)


@pytest.mark.parametrize("centre", [(20.0, 18.0), (19.63, 18.21), (20.49, 17.5)])
def test_light_has_its_centroid_at_its_centre(centre: tuple[float, float]):
    """A Gaussian sampled at pixel centres has its centroid at its centre to exp(-2 pi^2 s^2) (Poisson summation), 1e-27
    px at s = 1.8; cutting it at 5.5 s leaves s phi(5.5) ~ 2e-7 px a side, float32 about 1e-6."""
    for width in (1.2, 1.8, 2.5):
        light_of = {"name": "m", "body_m": (0.0, 0.0), "depth_m": 0.1, "colour": "red", "width_px": width}
        marker = FilmMarker.model_validate(light_of)
        picture = np.zeros((40, 40, 3), np.float32)
        add_light(picture, np.array(centre), marker, 1.0)
        v, u = np.mgrid[:40, :40]
        for channel in range(3):
            light = picture[..., channel].astype(float)
            assert (light * u).sum() / light.sum() == pytest.approx(centre[0], abs=1e-5)
            assert (light * v).sum() / light.sum() == pytest.approx(centre[1], abs=1e-5)
            height = 190.0 * LIGHT_BGR["red"][channel]
            assert light.sum() == pytest.approx(2 * np.pi * width**2 * height, rel=1e-5)


def test_dark_mark_is_found_to_a_hundredth():
    """A dark dot in a disc: within 4 px of its centre the ground is the disc alone, so that only rounding is left."""
    marks = [{**mark, "colour": "dark", "peak_dn": 120.0} for mark in centred_marks()]
    file = scenario(film=NO_NOISE, marker=marks, duration_s=0.1)
    motion, frames = filmed(file)
    for row in true_tracks(file, motion, camera_of(file)).itertuples():
        u, v, frame = float(row.u_px), float(row.v_px), int(row.frame)  # pyright: ignore[reportArgumentType]
        fit = gaussian_fit(frames[frame][..., 1].astype(float), u, v, radius=4)
        assert np.abs(np.array(fit) - [u, v]).max() < 0.01


def test_led_on_its_own_deck_is_found_to_a_hundredth():
    """On the deck, whose light falls linearly along the rows: a Gaussian with a plane under it takes the ground away.

    Left over is the rounding, 0.29 sqrt(2/pi)/A = 0.0012 px for A = 190; the window keeps off the deck's edge.
    """
    file = scenario(film={**NO_NOISE, "hull_beam_m": 1.2, "camera": camera_table(340.0 * 1.4)})
    assert np.abs(gaussian_misses(file, "stern")).max() < 0.01


@pytest.mark.parametrize("bow_lower_m", [-0.06, 0.0, 0.06])
def test_no_mark_shines_up_through_the_deck(bow_lower_m: float):
    """The lowest mark stands on the deck, and the bar under the foremost one lies at its height, so that it pulls to no side.

    The bar's stepped edges leave 0.01 px a frame, 0.004 px in the mean of six; three of these are allowed. A bar 3 cm above the
    light (as when the deck lay at the marks' mean height) pulls it by 0.054 px along the rows at this heading.
    """
    depths = 0.10 + max(bow_lower_m, 0), 0.10 + max(-bow_lower_m, 0)
    marks = [{**mark, "depth_m": depth} for mark, depth in zip(centred_marks(), depths, strict=True)]
    start = {"y_cg_m": 0.2, "beta_rad": 0.15}
    file = scenario(
        film={**NO_NOISE, "hull_beam_m": 1.2, "camera": camera_table(340.0 * 1.4)}, marker=marks, start=start
    )
    assert stage_of(file).deck_m == max(depths)
    assert np.abs(gaussian_misses(file, "bow").mean(axis=0)).max() < 0.012


def camera_table(focal_px: float) -> dict[str, Any]:
    return {"image_size_px": [320, 240], "fx_px": focal_px, "fy_px": focal_px, "cx_px": 159.5, "cy_px": 119.5}


def gaussian_misses(file: ScenarioFile, name: str) -> np.ndarray:
    """Found minus true place (frames, 2) px of a light, by a Gaussian on a plane in a window of 13 x 13."""
    motion, frames = filmed(file)
    found = []
    for row, frame in zip(
        true_tracks(file, motion, camera_of(file)).query("marker == @name").itertuples(), frames, strict=True
    ):
        u, v = float(row.u_px), float(row.v_px)  # pyright: ignore[reportArgumentType]
        found.append(np.array(gaussian_fit(frame[..., 1].astype(float), u, v, radius=6)) - [u, v])
    return np.array(found)


def gaussian_fit(picture: np.ndarray, u: float, v: float, radius: int) -> tuple[float, float]:
    """Least squares of a Gaussian on a plane, started at the nearest pixel."""
    from scipy.optimize import least_squares

    iu, iv = round(u), round(v)
    window = picture[iv - radius : iv + radius + 1, iu - radius : iu + radius + 1]
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]

    def miss(p):
        light = p[0] * np.exp(-((x - p[1]) ** 2 + (y - p[2]) ** 2) / (2 * p[3] ** 2))
        return (light + p[4] + p[5] * x + p[6] * y - window).ravel()

    height = window[radius, radius] - window[0, 0]
    found = least_squares(miss, [height, 0.0, 0.0, 1.8, window[0, 0], 0.0, 0.0]).x
    return iu + found[1], iv + found[2]


def test_peak_is_as_stated_times_exposure():
    file = scenario(film={**NO_NOISE, "exposure": 0.5}, marker=centred_marks())
    dark = scenario(
        film={**NO_NOISE, "exposure": 0.5, "occlusion": [[0.0, 9.0, "bow"], [0.0, 9.0, "stern"]]},
        marker=centred_marks(),
    )
    motion, lit = filmed(file)
    _, unlit = filmed(dark)
    row = true_tracks(file, motion, camera_of(file)).iloc[0]
    iu, iv = round(row.u_px), round(row.v_px)
    away = (iu - row.u_px) ** 2 + (iv - row.v_px) ** 2
    rise = float(lit[0][iv, iu, 1]) - float(unlit[0][iv, iu, 1])
    assert rise == pytest.approx(0.5 * 190.0 * np.exp(-away / (2 * 1.8**2)), abs=1.0)  # two roundings


def centred_marks() -> list[dict[str, Any]]:
    return [
        {"name": "bow", "body_m": [1.0, 0.0], "depth_m": 0.12, "colour": "white"},
        {"name": "stern", "body_m": [-1.0, 0.0], "depth_m": 0.12, "colour": "white"},
    ]


def test_noise_has_the_stated_variance():
    film = {"read_noise_dn": 3.0, "electrons_per_dn": 5.0, "ripple": 0.0}
    file, clean = scenario(film=film, duration_s=1.0), scenario(film=NO_NOISE, duration_s=1.0)
    _, noisy = filmed(file)
    _, still = filmed(clean)
    wall = slice(200, 240), slice(0, 20)  # nothing moves there
    level = float(np.mean(still[0][wall]))
    stack = np.stack([frame[wall] for frame in noisy]).astype(float) - np.stack([f[wall] for f in still]).astype(float)
    expected = 9.0 + level / 5.0 + 1 / 12  # rounding adds 1/12
    # 30 frames x 2400 values: relative sd of the variance sqrt(2/72000) = 0.5 %; the level varies within the patch
    assert stack.var() == pytest.approx(expected, rel=0.04)
    assert abs(stack.mean()) < 0.1


def test_seed_decides():
    _, one = filmed(scenario(seed=1))
    _, same = filmed(scenario(seed=1))
    _, other = filmed(scenario(seed=2))
    np.testing.assert_array_equal(np.stack(one), np.stack(same))
    assert (np.stack(one) != np.stack(other)).mean() > 0.5
    assert (one[0] != one[1]).mean() > 0.5  # noise is new in every frame


def test_hidden_and_outside_marks_are_lost():
    file = scenario(duration_s=0.4, film={"occlusion": [[0.1, 0.2, "stern"]]})
    tracks = true_tracks(file, simulate_scenario(file, Path()), camera_of(file))
    lost = tracks[tracks.status == "lost"]
    assert set(lost.marker) == {"stern"}
    assert lost.t_s.between(0.1, 0.2).all()
    assert len(lost) == 4  # 3/30 .. 6/30 s
    camera = {**camera_table(340.0), "cx_px": -200.0}
    away = scenario(film={"camera": camera})
    tracks = true_tracks(away, simulate_scenario(away, Path()), camera_of(away))
    assert (tracks.status == "lost").all()
    filmed(away)  # nothing in the picture: nothing breaks


def test_run_folder_is_whole_and_readable(tmp_path: Path):
    file = scenario(seed=9)
    done: list[tuple[int, int]] = []
    render_scenario(file, tmp_path, tmp_path / "run", lambda i, n: done.append((i, n)))
    run = read_run(tmp_path / "run")
    motion = simulate_scenario(file, tmp_path)
    assert done[-1] == (len(motion), len(motion))
    assert run.file.source.video == "video.mp4"
    assert run.tow.tension_n == 3.96
    camera = camera_of(file)
    truth = camera.project(np.array([point.tank_m for point in run.file.datum]))
    picks = np.array([point.pixel_px for point in run.file.datum])
    assert 0.05 < (picks - truth).std() < 0.3  # 16 numbers of sd 0.15
    assert {point.sigma_px for point in run.file.datum} == {0.15}
    tracks = read_tracks(tmp_path / "run" / "truth" / "tracks.csv")
    np.testing.assert_allclose(tracks[["u_px", "v_px"]], true_tracks(file, motion, camera)[["u_px", "v_px"]], atol=1e-6)
    stored = pd.read_csv(tmp_path / "run" / "truth" / "motion.csv")
    np.testing.assert_allclose(stored, motion, atol=1e-9)
    derivatives = read_result(tmp_path / "run" / "truth" / "derivatives.json", TruthFile)
    assert derivatives.x_v_m == pytest.approx(48.51 / 52.87)
    assert derivatives.derivatives["y_v"] == -52.87
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


@pytest.mark.once
@pytest.mark.parametrize(
    ("codec", "name", "tolerance_s"),
    [
        ("h264", "video.mp4", 1e-6),
        ("hevc", "video.mp4", 1e-6),
        ("hevc10", "video.mp4", 1e-6),
        ("ffv1", "video.mkv", 5.1e-4),
    ],
)
def test_timestamps_in_the_file(tmp_path: Path, codec: str, name: str, tolerance_s: float):
    # Matroska counts milliseconds, so its times are rounded to 0.5 ms; run.toml then states the exact rate
    import av
    import cv2

    file = scenario(duration_s=0.5, film={"codec": codec}, time={"duration_s": 0.5, "rate_hz": 29.97})
    render_scenario(file, tmp_path, tmp_path / "run")
    motion = simulate_scenario(file, tmp_path)
    with av.open(str(tmp_path / "run" / name)) as container:
        frames = list(container.decode(video=0))
        times = np.array([float(frame.time or 0.0) for frame in frames])
        picture = frames[-1].to_ndarray(format="bgr24").astype(float)
        bits = frames[-1].format.components[0].bits
        planes = frames[-1].to_ndarray() if codec != "ffv1" else np.zeros((1, 1))
    assert bits == (10 if codec == "hevc10" else 8)
    np.testing.assert_allclose(times, motion.t_s, atol=tolerance_s)
    *_, (_, _, last) = film_frames(file, motion)
    if codec == "ffv1":
        np.testing.assert_array_equal(picture, last)
        assert read_run(tmp_path / "run").file.source.frame_rate_hz == 29.97
    else:
        # limited range, BT.601: full is 10 brighter
        expected = cv2.cvtColor(last, cv2.COLOR_BGR2YUV_I420)[: last.shape[0]]
        assert abs(planes[: last.shape[0]].mean() / 2 ** (bits - 8) - expected.mean()) < 0.25
        if codec == "h264":  # HEVC's decoder rounds colours down by another 0.3
            assert abs(picture.mean() - last.mean()) < 1.0  # limited range is written and read as such


def test_unmeasured_tension_is_left_out(tmp_path: Path):
    tow = {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": 1.548, "resistance_n": 3.9}
    render_scenario(scenario(tow=tow), tmp_path, tmp_path / "run")
    text = (tmp_path / "run" / "run.toml").read_text()
    assert "tension" not in text
    assert "resistance" not in text
    assert read_run(tmp_path / "run").tow.tension_n is None


def test_history_travels_with_the_run(tmp_path: Path):
    (tmp_path / "tension.csv").write_text("t_s,tension_n\n0,3.9\n10,4.1\n")
    tow = {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": 1.548, "tension": "tension.csv"}
    tow["line"] = "constant"
    render_scenario(scenario(tow=tow), tmp_path, tmp_path / "run")
    assert read_run(tmp_path / "run").tow.tension == "tension.csv"


def test_failure_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = scenario()
    render_scenario(file, tmp_path, tmp_path / "old")
    before = sha256_of_file(tmp_path / "old" / "video.mp4")

    def broken(*_: object):
        yield 0, 0.0, np.zeros((240, 320, 3), np.uint8)
        raise OSError("disk full")

    monkeypatch.setattr(render, "film_frames", broken)
    for name in ("old", "new"):
        with pytest.raises(OSError, match="disk full"):
            render_scenario(file, tmp_path, tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["old"]
    assert sha256_of_file(tmp_path / "old" / "video.mp4") == before


def test_replaces_a_run_but_no_other_folder(tmp_path: Path):
    file = scenario()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "scenario.toml").write_text("# kept\n")
    render_scenario(file, tmp_path / "run", tmp_path / "run")
    (tmp_path / "run" / "out").mkdir()
    (tmp_path / "run" / "out" / "stale.csv").write_text("")
    render_scenario(scenario(seed=6), tmp_path / "run", tmp_path / "run")
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        "run.toml",
        "scenario.toml",
        "truth",
        "video.mp4",
    ]
    assert (tmp_path / "run" / "scenario.toml").read_text() == "# kept\n"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="holds other files"):
        render_scenario(file, tmp_path, tmp_path / "other")
    assert (tmp_path / "other" / "thesis.txt").read_text() == "years of work"


def test_what_cannot_be_filmed_is_said(tmp_path: Path):
    camera = {**camera_table(340.0), "image_size_px": [321, 240]}
    with pytest.raises(InputError, match="even"):
        render_scenario(scenario(film={"camera": camera}), tmp_path, tmp_path / "run")
    no_film = scenario().model_copy(update={"film": None})
    with pytest.raises(InputError, match="film"):
        render_scenario(no_film, tmp_path, tmp_path / "run")
    assert list(tmp_path.iterdir()) == []
