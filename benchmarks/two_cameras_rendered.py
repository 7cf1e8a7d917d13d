"""Random tows rendered before two random cameras: hulls and pictures of ``end_to_end_cases``, tracked; cases for ``two_cameras``.

The tow is simulated with surge in full, of a hull drawn around the MARINER. Each camera stands on its own side, looks down by 25 to
60 degrees, sees all datum points and all marks at all times; lens, frame rate, H.264's crf (17 to 28) and light are drawn. The
first one's film ends in the last quarter of the tow, the second's begins up to 2 s from the first one's begin and goes to the end.
Half of the tows have two marks; the others roll, heave and pitch as ``two_cameras_cases`` draws it, with its four marks. Marks and
picks are wrong by what the run's [priors] and picks state.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from end_to_end_cases import PRIORS, campaign, is_told
from two_cameras_cases import MARKS, Case
from two_cameras_films import Filmed, dense_motion, film_motion

from towline.geometry.camera import Camera
from towline.pipeline.stages.motion import compute_camera_motion
from towline.record import read_run
from towline.record.run import RUN_FILE, cameras_of
from towline.record.scenario import ScenarioFile
from towline.record.toml import check_tables
from towline.simulate.scene import camera_of, film_of, mark_places

Rng = np.random.Generator
SIZE_PX = (1280, 720)
MARGIN_PX = 12
RATES_HZ = (25.0, 30000 / 1001, 30.0)
TOLD = ("marker_depth_sd_m", "marker_place_sd_m")


def rendered(seed: int, rolls: bool, out: Path, lossless: bool = False) -> Case:
    """A tow of two films, tracked by the product; what stands in ``out`` is taken as it is. ``lossless``: crf 0."""
    rng = np.random.default_rng([seed, 5])
    scenario = campaign(seed)[int(rng.integers(4))]
    duration_s = scenario["time"]["duration_s"]
    if rolls:
        light = {key: scenario["marker"][0][key] for key in ("peak_dn", "width_px", "colour")}
        scenario["marker"] = [
            {"name": name, "body_m": [x, y], "depth_m": depth} | light for name, (x, y, depth) in MARKS.items()
        ]
    scenario["film"] |= {"occlusion": [], "codec": "h264"}
    file = check_tables(scenario, ScenarioFile, "scenario.toml")
    offset_s, rate = float(rng.uniform(-2, 2)), float(rng.uniform(-1e-4, 1e-4))
    ends_s = duration_s * float(rng.uniform(0.7, 0.85)), duration_s
    motion = dense_motion(file, Path(), min(0.0, offset_s), max(ends_s) + 1.0)
    if rolls:
        motion = _afloat(motion, rng)
    poses, lens = _cameras(scenario, motion, rng)
    scenario["film"]["camera"] |= lens
    file = check_tables(scenario, ScenarioFile, "scenario.toml")
    filmed = Filmed(out / f"{'rolling' if rolls else 'level'}-{seed}", offset_s, rate, motion)
    rates = tuple(float(v) for v in rng.choice(RATES_HZ, 2))
    crf = int(rng.integers(17, 29))
    film_motion(filmed, file, poses, ends_s, (rates[0], rates[1]), 2 * seed, crf=0 if lossless else crf)
    if not is_told(filmed.folder / RUN_FILE):
        _believed(filmed.folder / RUN_FILE, rng)
    return tracked(filmed, offset_s, rate, film_of(file).water_depth_m)


def tracked(filmed: Filmed, offset_s: float, rate: float, axis_m: float) -> Case:
    """What both cameras see of a tow, by the stages of ``towline track``; ``axis_m``: of ``Case``."""
    run = read_run(filmed.folder)
    first, second = (compute_camera_motion(view).tracks for view in cameras_of(run))
    assert first is not None
    assert second is not None
    return Case(run, {}, (first, second), offset_s, rate, filmed.truth, axis_m)


def _afloat(motion, rng: Rng):
    """Rolls by 0.5 to 2 degrees, beside it heave and pitch, as in ``two_cameras_cases``."""
    t, size, phase = motion["t_s"].to_numpy(), rng.uniform(0.5, 2.0), rng.uniform(0, 2 * np.pi, 4)
    slow = 2 * np.pi / rng.uniform(9, 18)
    return motion.assign(
        heave_m=0.003 * size * np.sin(2 * np.pi * t / 1.7 + phase[0]),
        roll_rad=np.radians(size) * (np.sin(2 * np.pi * t / 2.3 + phase[1]) + 0.4 * np.sin(slow * t + phase[2])),
        pitch_rad=np.radians(0.2 * size) * np.sin(2 * np.pi * t / 1.9 + phase[3]),
    )


def _cameras(
    scenario: dict[str, Any], motion, rng: Rng
) -> tuple[tuple[dict[str, Any], dict[str, Any]], dict[str, Any]]:
    """[film.pose] of each and the lens that both have: all datum points and marks are seen all the time."""
    focal = round(float(rng.uniform(1000, 1400)), 2)
    lens = {"image_size_px": list(SIZE_PX), "fx_px": focal, "fy_px": focal}
    lens |= {"cx_px": (SIZE_PX[0] - 1) / 2, "cy_px": (SIZE_PX[1] - 1) / 2}
    poses = [_pose(scenario, lens, motion, rng, side) for side in (-1, 1)]
    return (poses[0], poses[1]), lens


def _pose(scenario: dict[str, Any], lens: dict[str, Any], motion, rng: Rng, side: int) -> dict[str, Any]:
    film = scenario["film"] | {"camera": scenario["film"]["camera"] | lens}
    for _ in range(100_000):
        tilt, azimuth = np.radians(rng.uniform(25, 60)), np.radians(rng.uniform(10, 50)) * side
        ahead = np.array([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)])
        target = np.array([-2.4, rng.uniform(-0.1, 0.1), 0.15])
        place = target - rng.uniform(4.5, 7.0) * ahead
        pose = {"place_m": [round(float(v), 3) for v in place], "look_at_m": [round(float(v), 3) for v in target]}
        file = check_tables(scenario | {"film": film | {"pose": pose}}, ScenarioFile, "scenario.toml")
        points = mark_places(file, motion.iloc[::40]).reshape(-1, 3)
        if _sees(camera_of(file), np.vstack([points, [p["tank_m"] for p in film["datum"]]])):
            return pose
    raise ValueError("no camera sees it all")


def _sees(camera: Camera, points_m: np.ndarray) -> bool:
    pixel = camera.project(points_m)
    return bool((pixel > MARGIN_PX).all() and (pixel < np.array(SIZE_PX) - MARGIN_PX).all())


def _believed(path: Path, rng: Rng) -> None:
    """The places of the marks as they were measured."""
    told: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    for marker in told["marker"]:
        marker["body_m"] = [round(float(v + rng.normal(0, PRIORS["marker_place_sd_m"])), 5) for v in marker["body_m"]]
        marker["depth_m"] = round(float(marker["depth_m"] + rng.normal(0, PRIORS["marker_depth_sd_m"])), 5)
    told["priors"] = {key: PRIORS[key] for key in TOLD}
    path.write_text(tomlkit.dumps(told), encoding="utf-8")


__all__ = ["rendered", "tracked"]
