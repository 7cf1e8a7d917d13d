"""The camera's own motion from datum points that are re-found: truth by projecting through a turned camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from towline.geometry.camera import Camera, Lens
from towline.geometry.datum import fit_datum
from towline.geometry.motion import motion_from_tracks
from towline.geometry.shake import StillView, camera_shake, turned_back
from towline.record.run import Run
from towline.record.schema import CameraTable, DatumPoint, RunFile
from towline.record.toml import check_tables

LENS = CameraTable(
    image_size_px=(1280, 720), fx_px=1100.0, fy_px=1100.0, cx_px=639.5, cy_px=359.5, distortion=(-0.1, 0.02, 0, 0, 0)
)
POINTS_M = [(x, y, z) for z in (0.0, 0.3) for x in (0.0, -3.0) for y in (-0.7, 0.7)]
FRAMES = 200


def scene(seed: int, turn_rad: float, sigma_px: float = 0.05):
    """A shaken camera: true camera, datum fit, re-found points, the turned cameras."""
    rng = np.random.default_rng(seed)
    camera = Camera.looking_at(Lens.from_table(LENS), np.array([-6.0, 0.3, -3.0]), np.array([-1.5, 0.0, 0.0]))
    picked = camera.project(np.array(POINTS_M))
    points = [
        DatumPoint(name=f"d{i}", pixel_px=tuple(pixel), tank_m=place, sigma_px=0.01, track=True)
        for i, (pixel, place) in enumerate(zip(picked, POINTS_M, strict=True))
    ]
    fit = fit_datum(points, LENS, [0.1], (1280, 720))
    t = np.arange(FRAMES) / 30
    turns = turn_rad * np.column_stack([np.sin(9 * t), np.where(t > 3, 1.0, 0.0), 0.3 * np.cos(5 * t)])
    turned = [
        Camera(
            camera.lens,
            Rotation.from_rotvec(w).as_matrix() @ camera.rotation,
            Rotation.from_rotvec(w).as_matrix() @ camera.translation,
        )
        for w in turns
    ]
    rows = []
    for index, one in enumerate(turned):
        seen = one.project(np.array(POINTS_M)) + rng.normal(0, sigma_px, (len(POINTS_M), 2))
        for point, place in zip(points, seen, strict=True):
            hidden = index % 7 == 0 and point.name in ("d0", "d1")
            status = "lost" if hidden else "measured"
            rows.append((index, t[index], point.name, *([np.nan] * 2 if hidden else place), sigma_px, sigma_px, status))
    names = ["frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status"]
    return camera, fit, points, pd.DataFrame(rows, columns=names), turned, turns


def test_the_turn_and_its_uncertainty_are_true() -> None:
    """600 turns know a standard deviation to 2.9 %: three of them."""
    _, fit, points, tracks, _, turns = scene(1, 0.008)
    shake = camera_shake(tracks, points, fit.mapping)
    gap = shake.turn_rad - turns
    z = gap / np.sqrt(np.einsum("naa->na", shake.covariance))
    assert not shake.still
    assert abs(z.std() - 1) < 0.09
    left = 0.05 * np.sqrt(1 - 3 / (2 * len(POINTS_M)))  # three numbers of sixteen are fitted
    assert abs(shake.residual_px / left - 1) < 0.06  # 3200 coordinates, some hidden


def test_a_frame_by_itself_has_the_turn_that_it_has_among_all() -> None:
    """The turn is the same number; its covariance too, where no frame's misfit widens it."""
    _, fit, points, tracks, *_ = scene(5, 0.008)
    view = StillView(points, fit.mapping)
    names = [point.name for point in points]
    every = camera_shake(tracks, points, fit.mapping)
    for frame in (0, 1, 50):
        rows = tracks[(tracks["frame"] == frame) & (tracks["status"] == "measured")]
        which = np.array([names.index(name) for name in rows["marker"]])
        one = view.turn(which, rows[["u_px", "v_px"]].to_numpy(), rows[["sigma_u_px", "sigma_v_px"]].to_numpy())
        assert one.turn_rad[0] == pytest.approx(every.turn_rad[frame], rel=1e-9)
        alone = camera_shake(tracks[tracks["frame"] == frame], points, fit.mapping)
        assert one.covariance[0] == pytest.approx(alone.covariance[0], rel=1e-9)


def test_marks_are_turned_back_to_where_the_picked_camera_saw_them() -> None:
    """Nine pixels of shake and a knock of nine more leave what the points' noise allows."""
    camera, fit, points, tracks, turned, _ = scene(2, 0.008)
    marks = np.array([[-1.0, 0.1, 0.12], [-2.4, -0.2, 0.12]])
    still = camera.project(marks)
    pixel = np.stack([one.project(marks) for one in turned])
    assert np.abs(pixel - still).max() > 9
    shake = camera_shake(tracks, points, fit.mapping)
    back, variance = turned_back(shake, np.arange(FRAMES), pixel, fit.mapping)
    z = (back - still) / np.sqrt(variance)
    assert np.abs(back - still).max() < 0.15
    assert 0.85 < z.std() < 1.15


def test_a_camera_that_stood_still_is_said_to() -> None:
    _, fit, points, tracks, _, _ = scene(3, 0.0)
    assert camera_shake(tracks, points, fit.mapping).still


def test_a_frame_with_one_point_has_no_turn() -> None:
    _, fit, points, tracks, *_ = scene(4, 0.005)
    tracks.loc[(tracks["frame"] == 50) & (tracks["marker"] != "d3"), "status"] = "lost"
    shake = camera_shake(tracks, points, fit.mapping)
    assert np.isnan(shake.turn_rad[50]).all()
    back, _ = turned_back(shake, np.array([49, 50]), np.zeros((2, 1, 2)) + 300.0, fit.mapping)
    assert np.isfinite(back[0]).all()
    assert np.isnan(back[1]).all()


@pytest.mark.parametrize("lens_known", [True, False])
def test_the_turn_needs_no_lens(lens_known: bool) -> None:
    """Without [camera] the datum at two depths gives K itself."""
    camera = Camera.looking_at(Lens(1100, 1100, 639.5, 359.5), np.array([-6.0, 0.3, -3.0]), np.array([-1.5, 0.0, 0.0]))
    picked = camera.project(np.array(POINTS_M))
    points = [
        DatumPoint(name=f"d{i}", pixel_px=tuple(p), tank_m=m, track=True)
        for i, (p, m) in enumerate(zip(picked, POINTS_M, strict=True))
    ]
    lens = LENS.model_copy(update={"distortion": (0.0,) * 5}) if lens_known else None
    fit = fit_datum(points, lens, [0.1], (1280, 720))
    turn = Rotation.from_rotvec([0.004, -0.006, 0.002])
    seen = Camera(camera.lens, turn.as_matrix() @ camera.rotation, turn.as_matrix() @ camera.translation).project(
        np.array(POINTS_M)
    )
    tracks = pd.DataFrame(
        {
            "frame": 0,
            "t_s": 0.0,
            "marker": [p.name for p in points],
            "u_px": seen[:, 0],
            "v_px": seen[:, 1],
            "sigma_u_px": 0.05,
            "sigma_v_px": 0.05,
            "status": "measured",
        }
    )
    shake = camera_shake(tracks, points, fit.mapping)
    np.testing.assert_allclose(shake.turn_rad[0], turn.as_rotvec(), atol=2e-5)


@pytest.mark.parametrize("turn_rad", [0.008, 0.0])
def test_a_run_filmed_by_a_shaken_camera_has_the_motion_of_the_tow(turn_rad: float) -> None:
    """Marks of a moving model seen by the turned cameras: with the re-found points the motion is the tow's, and its
    uncertainty holds what the points' noise adds; without them it is millimetres off."""
    _, fit, points, datum_tracks, turned, _ = scene(5, turn_rad)
    tables = {
        "name": "shaken",
        "source": {"tracks": "tracks.csv"},
        "camera": LENS.model_dump(),
        "datum": [p.model_dump() for p in points],
        "marker": [
            {"name": "bow", "body_m": [0.6, 0.0], "depth_m": 0.1},
            {"name": "stern", "body_m": [-0.6, 0.0], "depth_m": 0.1},
        ],
        "tow": {"speed_m_s": 1.0, "line_length_m": 0.9, "tow_point_m": 0.7, "tension_n": 4.0},
        "model": {"length_pp_m": 1.5, "mass_kg": 20.0},
        "water": {},
    }
    run = Run(Path(), check_tables(tables, RunFile, Path("run.toml")))
    t = np.arange(FRAMES) / 30
    pose = np.column_stack([np.full(FRAMES, -1.5), 0.1 * np.sin(t), 0.06 * np.cos(t)])
    rng, rows = np.random.default_rng(6), []
    for name, ahead in (("bow", 0.6), ("stern", -0.6)):
        along, aside = ahead * np.cos(pose[:, 2]), ahead * np.sin(pose[:, 2])
        places = np.column_stack([pose[:, 0] + along, pose[:, 1] + aside, np.full(FRAMES, 0.1)])
        for index, place in enumerate(places):
            u, v = turned[index].project(place[None])[0] + rng.normal(0, 0.03, 2)
            rows.append((index, t[index], name, u, v, 0.03, 0.03, "measured"))
    tracks = pd.DataFrame(rows, columns=list(datum_tracks.columns))
    lost = datum_tracks.assign(status=datum_tracks["status"].where(datum_tracks["frame"] != 60, "lost"))
    found = motion_from_tracks(run, tracks, fit, datum_tracks=lost)
    motion, truth = found.motion, pose[:, [1, 2]]
    as_it_stood = motion_from_tracks(run, tracks, fit)
    note = next(n for n in found.camera.notes if n.startswith("datum.track"))
    if turn_rad == 0.0:
        assert "stood still" in note
        pd.testing.assert_frame_equal(motion, as_it_stood.motion)
        return
    assert "turned by up to" in note
    assert "1 frames without two datum points are lost" in note
    assert list(motion["status"]) == ["measured"] * 60 + ["lost"] + ["measured"] * (FRAMES - 61)
    seen = motion["status"] == "measured"
    gap = (motion[["y_cg_m", "beta_rad"]].to_numpy() - truth)[seen]
    z = gap / motion[["sigma_y_cg_m", "sigma_beta_rad"]].to_numpy()[seen]
    # 199 draws know a standard deviation to 5 %; a turn common to both marks is in the sigma of each
    assert ((z.std(axis=0) > 0.7) & (z.std(axis=0) < 1.2)).all(), z.std(axis=0)
    bare = as_it_stood.motion[["y_cg_m", "beta_rad"]].to_numpy() - truth
    assert np.abs(bare[:, 0]).max() > 20 * np.abs(gap[:, 0]).max() > 0
    nothing = motion_from_tracks(run, tracks, fit, datum_tracks=lost.assign(status="lost"))
    assert any("fewer than two points" in n for n in nothing.camera.notes)
    pd.testing.assert_frame_equal(nothing.motion, as_it_stood.motion)
