"""The view from above and the scale grid, against the camera that drew the picture."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from towline.cli import main
from towline.geometry import Camera, Lens, ProjectiveMapping
from towline.record import DatumPoint
from towline.record.errors import GeometryError
from towline.record.scenario import ScenarioFile
from towline.record.toml import check_tables
from towline.report.scale_grid import X_INK, draw_grid, enlargement, grid_lines
from towline.report.topview import Area, area_around, pixels_of, round_step, top_view
from towline.simulate import simulate_scenario
from towline.simulate.render import camera_of, film_frames

SIZE = (960, 720)
CORNERS = [(x, y, 0.0) for x in (-0.6, -4.2) for y in (-0.9, 0.9)]
AREA = Area((-4.35, -0.35), (-1.1, 1.1), 0.0)
MM_PER_PX = 5.0


def scenario() -> ScenarioFile:
    """A tow behind a lens that bends lines by 10 px, two strings across and a mark in each corner, without noise."""
    content: dict[str, Any] = {
        "name": "top",
        "time": {"duration_s": 0.1, "rate_hz": 30.0},
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
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"tank_width_m": 2.4},
        "marker": [
            {"name": "bow", "body_m": [1.0, 0.0], "depth_m": 0.12},
            {"name": "stern", "body_m": [-1.0, 0.0], "depth_m": 0.13},
        ],
        "film": {
            "camera": {
                "image_size_px": list(SIZE),
                "fx_px": 1130.0,
                "fy_px": 1135.0,
                "cx_px": 482.0,
                "cy_px": 356.0,
                "distortion": [-0.25, 0.03, 1e-3, -5e-4, 0.0],
            },
            "pose": {"place_m": [-6.3, 0.3, -3.6], "look_at_m": [-2.6, 0.0, 0.0], "roll_rad": 0.03},
            "datum": [{"name": f"c{i}", "tank_m": list(place)} for i, place in enumerate(CORNERS)],
            "read_noise_dn": 0.0,
            "electrons_per_dn": 1e9,
            "ripple": 0.0,
        },
    }
    return check_tables(content, ScenarioFile, "scenario.toml")


def mapping_of(camera: Camera) -> ProjectiveMapping:
    matrix = np.column_stack([camera.rotation, camera.translation])
    return ProjectiveMapping("pose", camera.lens, matrix, np.zeros((0, 3, 4)))


@pytest.fixture(scope="module")
def drawn() -> tuple[Camera, np.ndarray]:
    file = scenario()
    _, _, picture = next(iter(film_frames(file, simulate_scenario(file, Path()))))
    return camera_of(file), picture


def middle_of(profile: np.ndarray) -> float:
    """Where a bright line crosses a profile: the centroid of what stands out by more than a quarter of its height."""
    ground = float(np.median(profile))
    light = np.clip(profile - ground - 0.25 * (profile.max() - ground), 0, None)
    return float((light * np.arange(len(light))).sum() / light.sum())


@pytest.mark.slow
def test_strings_come_out_straight_and_where_they_are(drawn: tuple[Camera, np.ndarray]) -> None:
    """Two strings at x = -0.6 and -4.2 m: within 1 px of the top view (5 mm) all along, away from beads (0.3 m) and marks.

    In the picture the near one is bent by several pixels, so a mapping without the lens fails.
    """
    camera, picture = drawn
    view = top_view(mapping_of(camera), AREA, SIZE, MM_PER_PX)
    seen = view.look(picture).astype(float).sum(axis=2)
    y = np.array([k + d for k in np.arange(-0.6, 0.61, 0.3) for d in (0.08, 0.11, 0.15, 0.19, 0.22)])
    y = y[(y > -0.8) & (y < 0.8)]
    for x in (-0.6, -4.2):
        found = []
        for place in view.place_px(np.column_stack([np.full(len(y), x), y])):
            column, row = (round(float(c)) for c in place)
            found.append(middle_of(seen[row, column - 8 : column + 9]) + column - 8 - place[0])
        assert np.abs(found).max() < 1.0, (x, found)
    line = camera.project(np.column_stack([np.full(50, -4.2), np.linspace(-0.9, 0.9, 50), np.zeros(50)]))
    along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
    bend = (line - line[0]) @ [-along[1], along[0]]
    assert np.abs(bend).max() > 2.0


def test_the_rectangle_has_its_metres(drawn: tuple[Camera, np.ndarray]) -> None:
    """The marks in the corners, by the centroid of their white, against 3.6 x 1.8 m: within 1 px."""
    camera, picture = drawn
    view = top_view(mapping_of(camera), AREA, SIZE, MM_PER_PX)
    seen = view.look(picture).astype(float).mean(axis=2)
    places = []
    for place in view.place_px(np.array(CORNERS)[:, :2]):
        u, v = np.rint(place).astype(int)
        part = seen[v - 10 : v + 11, u - 10 : u + 11]
        light = np.clip(part - 0.6 * part.max(), 0, None)
        rows, columns = np.mgrid[v - 10 : v + 11, u - 10 : u + 11]
        places.append([(light * columns).sum() / light.sum(), (light * rows).sum() / light.sum()])
    assert np.abs(np.array(places) - view.place_px(np.array(CORNERS)[:, :2])).max() < 1.0
    metres = view.place_m(np.array(places))
    for i, j, length in ((0, 1, 1.8), (2, 3, 1.8), (0, 2, 3.6), (1, 3, 3.6)):
        assert abs(np.hypot(*(metres[i] - metres[j])) - length) < 1e-3 * MM_PER_PX


def test_the_map_is_the_mapping(drawn: tuple[Camera, np.ndarray]) -> None:
    """Every entry of the map against the camera, to float32's rounding at 960 px; a pixel's middle has its metres."""
    camera, _ = drawn
    area = Area((-4.0, -1.0), (-0.6, 0.7), 0.17)
    view = top_view(mapping_of(camera), area, SIZE, 20.0)
    height, width = view.map_px.shape[:2]
    assert (width, height) == (150, 65)
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    place = view.place_m(np.column_stack([u.ravel(), v.ravel()]))
    np.testing.assert_allclose(view.place_px(place), np.column_stack([u.ravel(), v.ravel()]), atol=1e-9)
    truth = camera.project(np.column_stack([place, np.full(len(place), 0.17)]))
    np.testing.assert_allclose(view.map_px.reshape(-1, 2), truth, atol=960 * 2**-23)
    assert place[0] == pytest.approx([-3.99, -0.59])


def test_what_the_picture_does_not_show_is_left_out(drawn: tuple[Camera, np.ndarray]) -> None:
    """Behind the camera the projection returns to the picture, and far to the side the lens model folds back into it."""
    camera, picture = drawn
    mapping = mapping_of(camera)
    behind = camera.place_m + 2 * (camera.place_m - [-2.6, 0.0, 0.0])
    folding = Camera(
        Lens(540.0, 540.0, 319.5, 239.5, np.array([-0.3, 0, 0, 0, 0])), camera.rotation, camera.translation
    )
    side = camera.rotation.T @ (np.array([1.7, 0.0, 1.0]) * 3 - camera.translation)
    for seen, place in ((mapping, behind), (mapping_of(folding), side)):
        inside = seen.to_pixel(place[None])[0]
        assert (inside > 0).all()
        assert (inside < SIZE).all()
        assert np.isnan(pixels_of(seen, place[None], SIZE)).all()
    beyond = Area((-4.5, 10.0), (-3.0, 3.0), 0.0)
    view = top_view(mapping, beyond, SIZE, 50.0)
    assert 0.05 < view.seen_share < 0.95
    assert (view.look(picture)[view.map_px[..., 0] <= -1] == 0).all()
    with pytest.raises(GeometryError, match="outside the picture"):
        top_view(mapping, Area((-90.0, -80.0), (-1.0, 1.0), 0.0), SIZE)
    with pytest.raises(GeometryError, match="at most 4000 on a side"):
        top_view(mapping, AREA, SIZE, 0.5)
    with pytest.raises(GeometryError, match="the second must be the larger"):
        Area((1.0, -1.0), (0.0, 1.0), 0.0)


def test_grid_lines_are_projected_lines_and_are_drawn_there(drawn: tuple[Camera, np.ndarray]) -> None:
    camera, picture = drawn
    mapping = mapping_of(camera)
    lines, step = grid_lines(mapping, AREA, SIZE)
    assert step == 0.5
    assert [line.value_m for line in lines if line.axis == "y"] == [-1.0, -0.5, 0.0, 0.5, 1.0]
    canvas = draw_grid(np.zeros_like(picture), mapping, AREA)
    blue, green, red = np.moveaxis(canvas.astype(int), 2, 0)
    ink = (blue > 80) & (blue > green + 10) & (green > red)
    assert X_INK == (255, 220, 120)
    assert ink.sum() > 1000
    # the labels apart, every inked pixel lies on a line, and every line is inked
    near = np.zeros(ink.shape, np.uint8)
    hits = []
    for line in (line for line in lines if line.axis == "x"):
        run = np.linspace(*AREA.y_m, 4000)
        truth = camera.project(np.column_stack([np.full(4000, line.value_m), run, np.zeros(4000)]))
        np.testing.assert_allclose(line.pixel_px[[0, -1]], truth[[0, -1]], atol=1e-9)
        u, v = np.rint(truth).astype(int).T
        near[v, u] = 1
        hits.append((canvas[v, u].max(axis=1) > 100).mean())
    assert min(hits) > 0.95
    reach = cv2.dilate(near, np.ones((3, 3), np.uint8)) > 0
    labels = np.zeros_like(ink)
    for line in lines:
        for u, v in line.pixel_px[[0, -1]].astype(int):
            labels[max(v - 16, 0) : v + 18, max(u - 16, 0) : u + 60] = True
    assert not (ink & ~reach & ~labels).any()


def test_residuals_are_drawn_enlarged(drawn: tuple[Camera, np.ndarray]) -> None:
    camera, picture = drawn
    residual = np.array([[0.2, -0.1], [0.0, 0.0], [-0.3, 0.3], [0.1, 0.1]])
    assert enlargement(residual) == 100.0
    assert enlargement(np.zeros((4, 2))) is None
    assert enlargement(np.array([[400.0, 0.0]])) == 1.0
    pixel = camera.project(np.array(CORNERS))
    datum = [
        DatumPoint(name=f"c{i}", pixel_px=(float(u), float(v)), tank_m=place)
        for i, (place, (u, v)) in enumerate(zip(CORNERS, pixel, strict=True))
    ]
    black = np.zeros_like(picture)
    plain, arrows = (draw_grid(black, mapping_of(camera), AREA, datum, r) for r in (None, residual))
    changed = np.abs(plain[:-20].astype(int) - arrows[:-20]).max(axis=2) > 60
    for k, at in enumerate(pixel + 50 * residual):
        u, v = np.rint(at).astype(int)
        assert changed[v - 1 : v + 2, u - 1 : u + 2].any() == (k != 1)


def test_steps_are_round() -> None:
    assert [round_step(v) for v in (0.99, 1.0, 2.4, 4.99, 7.0, 0.05)] == [0.5, 1.0, 2.0, 2.0, 5.0, 0.05]


def test_the_area_holds_datum_and_marks() -> None:
    datum = [DatumPoint(pixel_px=(10.0 * i, 5.0), tank_m=place) for i, place in enumerate(CORNERS)]
    area = area_around(datum, 0.1, np.array([[-5.2, 0.0], [np.nan, np.nan]]))
    assert area.x_m == pytest.approx((-5.2 - 0.04 * 4.6, -0.6 + 0.04 * 4.6))
    assert area.y_m == pytest.approx((-0.9 - 0.04 * 1.8, 0.9 + 0.04 * 1.8))


@pytest.fixture(scope="module")
def run(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rectify") / "x1446"
    shutil.copytree(samples / "mariner" / "x1446", folder, ignore=shutil.ignore_patterns("out"))
    text = (folder / "run.toml").read_text()
    (folder / "run.toml").write_text(text.replace('video = "video.mp4"', 'video = "video.mp4"\nspan_s = [0.99, 1.99]'))
    return folder


@pytest.mark.slow
def test_a_sample_video_from_above(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The bow's light in the still, at 2 mm a pixel, against the truth; the film has the analysed frames at their times."""
    import av

    words = ["rectify", str(run), "--depth", "0.12", "--mm-per-px", "2", "--frame", "45", "--grid", "--video"]
    assert main([*words, "--area", "-4.5", "-0.4", "-1.3", "1.3"]) == 0
    said = capsys.readouterr().out
    assert "frame 45" in said
    assert "top.mp4" in said
    still = cv2.imread(str(run / "out" / "top.png"))
    assert still is not None
    assert still.shape == (1300, 2050, 3)
    assert cv2.imread(str(run / "out" / "grid.png")).shape == (600, 800, 3)
    truth = pd.read_csv(run / "truth" / "motion.csv", comment="#").iloc[45]
    place = np.array([truth.x_cg_m + 1.2 * np.cos(truth.beta_rad), truth.y_cg_m + 1.2 * np.sin(truth.beta_rad)])
    u, v = (place - [-4.5, -1.3]) / 2e-3 - 0.5
    rows, columns = np.mgrid[round(v) - 25 : round(v) + 26, round(u) - 25 : round(u) + 26]
    light = still[rows, columns].max(axis=2).astype(float)
    light = np.clip(light - 0.5 * light.max(), 0, None)
    found = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
    # 0.04 px of the mark and 0.15 px / sqrt(8) of each pick, at 6 mm a pixel: 0.4 mm; a blob of 10 px adds what perspective bends
    assert np.abs(found - [u, v]).max() < 1.0
    with av.open(str(run / "out" / "top.mp4")) as film:
        times = [float(frame.time) for frame in film.decode(video=0) if frame.time is not None]
        assert (film.streams.video[0].width, film.streams.video[0].height) == (2050, 1300)
    np.testing.assert_allclose(times, np.arange(30) / 30, atol=1e-3)


@pytest.mark.slow
def test_what_cannot_be_shown_is_said(run: Path, samples: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        (["--area", "50", "60", "-1", "1"], "outside the picture"),
        (["--area", "1", "0", "-1", "1"], "the second must be the larger"),
        (["--mm-per-px", "0.1"], "at most 4000"),
        (["--mm-per-px", "-2"], "must be above 0"),
        (["--frame", "99999"], "no frame 99999"),
        (["--time", "3000"], "3000"),
    ):
        assert main(["rectify", str(run), *words]) == 1, words
        assert message in capsys.readouterr().err, words
    motion = run.parent / "no video"
    motion.mkdir()
    shutil.copy(samples / "mariner" / "x1446" / "truth" / "motion.csv", motion)
    text = (run / "run.toml").read_text().replace('video = "video.mp4"\nspan_s = [0.99, 1.99]', 'motion = "motion.csv"')
    (motion / "run.toml").write_text(text)
    assert main(["rectify", str(motion)]) == 1
    assert "source.video" in capsys.readouterr().err
