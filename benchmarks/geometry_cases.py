"""Random cameras over a towed model, with their truth, and faults planted one at a time.

Shares the pinhole camera with the product, and nothing else: places, tracks and picks are made here. A camera looks down by 20 to
80 degrees, rolled by up to 10, off the axis, k1 within +-0.3, marks 0 to 0.4 m below the tank top; ten datum points at two depths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from towline.geometry import Camera, Lens
from towline.record import GeometryError, Run, RunFile
from towline.record.toml import check_tables

SIZE = (1280, 720)
LINE_M, TOW_POINT_M, DURATION_S = 0.91, 1.2, 60.0
BODY = np.array([[1.0, 0.0], [-1.0, 0.0]])
TOP = [(x, y, 0.0) for x in (-0.6, -2.2, -3.8) for y in (-0.9, 0.9)]
LOW = [(x, y, 0.25) for x in (-0.6, -3.8) for y in (-0.9, 0.9)]
MARK_PX, PICK_PX = 0.05, 0.3
FAULTS = ("", "k1", "deck height", "datum point", "datum width", "camera turned", "line length", "slack line")
"""Sizes: 0.05; 2 cm; 8 px; 1 %; 0.3 degrees mid-run; 1 cm; 1 to 3 cm for 3 s."""
LENS_SD = (2.0, 2.0, 3.0, 3.0, 0.003, 0.003, 2e-4, 2e-4, 0.002)
PLACE_SD_M, DEPTH_SD_M = 1e-3, 2e-3


@dataclass(frozen=True)
class Scene:
    """A camera over a tow.

    Attributes
    ----------
    camera : true
    depth_m : of the marks, true
    t_s, pose : (n,), (n, 3): x, y, beta
    """

    camera: Camera
    depth_m: float
    t_s: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class Case:
    """What the product gets, and the truth.

    Attributes
    ----------
    run, tracks : as measured
    motion : (n, 3), y_CG, beta, alpha
    planted : name of the fault; for a datum point its index is ``item``, for a turn its time is ``at_s``
    """

    run: Run
    tracks: pd.DataFrame
    motion: np.ndarray
    planted: str
    item: int = -1
    at_s: float = float("nan")


def pixels(camera: Camera, pose: np.ndarray, body: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Marks in the picture, (n, m, 2)."""
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x = pose[:, :1] + cosine[:, None] * body[:, 0] - sine[:, None] * body[:, 1]
    y = pose[:, 1:2] + sine[:, None] * body[:, 0] + cosine[:, None] * body[:, 1]
    tank = np.stack([x, y, np.broadcast_to(depth, x.shape)], axis=2)
    return camera.project(tank.reshape(-1, 3)).reshape(len(pose), len(body), 2)


def random_scene(rng: np.random.Generator, frames: int) -> Scene:
    """A camera that sees all datum points and marks."""
    t_s = np.arange(frames) * DURATION_S / frames
    swing = 2 * np.pi / 16 * t_s
    y, beta = (a * np.exp(-0.01 * t_s) for a in (0.3 * np.cos(swing), 0.12 * np.sin(swing + 0.4)))
    alpha = np.arcsin((y + TOW_POINT_M * np.sin(beta)) / LINE_M)
    pose = np.column_stack([-LINE_M * np.cos(alpha) - TOW_POINT_M * np.cos(beta), y, beta])
    while True:
        tilt, roll = np.radians(rng.uniform(20, 80)), np.radians(rng.uniform(-10, 10))
        target = np.array([-2.2, rng.uniform(-0.3, 0.3), 0.1])
        distance, focal = rng.uniform(3, 5), rng.uniform(800, 1300)
        place = target + np.array([-np.cos(tilt) * distance, rng.uniform(-1, 1), -np.sin(tilt) * distance])
        centre = np.array(SIZE) / 2 + rng.uniform(-15, 15, 2)
        bend = np.array([rng.uniform(-0.3, 0.3), 0.02, 5e-4, -5e-4, 0.0])
        camera = Camera.looking_at(Lens(focal, focal * rng.uniform(0.995, 1.005), *centre, bend), place, target, roll)
        depth = rng.uniform(0, 0.4)
        seen = np.vstack([camera.project(np.array(TOP + LOW)), pixels(camera, pose, BODY, depth).reshape(-1, 2)])
        if not (np.isfinite(seen).all() and (seen > 5).all() and (seen < np.array(SIZE) - 5).all()):
            continue
        try:
            camera.lens.normalise(seen)
        except GeometryError:
            continue
        return Scene(camera, depth, t_s, pose)


def film(
    scene: Scene,
    rng: np.random.Generator,
    planted: str = "",
    noise: tuple[float, float] = (MARK_PX, PICK_PX),
    unsure: bool = False,
) -> Case:
    """Tracks and run.toml of a scene.

    Parameters
    ----------
    planted : one of FAULTS
    noise : of marks and of picks, px; the stated sigmas stay
    unsure : lens, heights and places of the marks are off by what run.toml states as their standard deviations
    """
    camera, lens, pose = scene.camera, scene.camera.lens, scene.pose.copy()
    stated, depth, points = lens.vector, np.full(2, scene.depth_m), np.array(TOP + LOW)
    body, told_points, told_depth = BODY.copy(), points.copy(), scene.depth_m
    sign, item, at_s = rng.choice([-1.0, 1.0]), -1, float("nan")
    if unsure:
        camera = replace(camera, lens=Lens.from_vector(stated + rng.normal(size=9) * LENS_SD))
        body = body + rng.normal(0, PLACE_SD_M, (2, 2))
        depth = depth + rng.normal(0, DEPTH_SD_M, 2)
    if planted == "slack line":
        share = (scene.t_s - rng.uniform(10, 45)) / 3
        slack = np.where((share > 0) & (share < 1), np.sin(np.pi * np.clip(share, 0, 1)), 0)
        pose[:, 0] += rng.uniform(0.01, 0.03) * slack
    if planted == "line length":
        length = LINE_M + sign * 0.01
        side = pose[:, 1] + TOW_POINT_M * np.sin(pose[:, 2])
        pose[:, 0] = -np.sqrt(length**2 - side**2) - TOW_POINT_M * np.cos(pose[:, 2])
    picks = camera.project(points) + rng.normal(0, noise[1], (len(points), 2))
    if planted == "datum point":
        item, way = int(rng.integers(len(points))), rng.uniform(0, 2 * np.pi)
        picks[item] += 8 * np.array([np.cos(way), np.sin(way)])
    seen = pixels(camera, pose, body, depth)
    if planted == "camera turned":
        axis = rng.normal(size=3)
        turn = Rotation.from_rotvec(np.radians(0.3) * axis / np.linalg.norm(axis)).as_matrix()
        after = int(rng.integers(len(pose) // 4, 3 * len(pose) // 4))
        turned = replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation)
        seen[after:], at_s = pixels(turned, pose, body, depth)[after:], float(scene.t_s[after])
    seen = seen + rng.normal(0, noise[0], seen.shape)
    if planted == "k1":
        stated = stated + sign * 0.05 * np.eye(9)[4]
    if planted == "deck height":
        told_depth = told_depth + sign * 0.02
    if planted == "datum width":
        told_points[:, 1] *= 1 + sign * 0.01
    run = _run(stated, picks, told_points, told_depth, unsure)
    ahead, aside = pose[:, 0] + TOW_POINT_M * np.cos(pose[:, 2]), pose[:, 1] + TOW_POINT_M * np.sin(pose[:, 2])
    motion = np.column_stack([pose[:, 1], pose[:, 2], np.arctan2(aside, -ahead)])
    return Case(run, _tracks(scene.t_s, seen), motion, planted, item, at_s)


def _run(lens: np.ndarray, picks: np.ndarray, points: np.ndarray, depth: float, unsure: bool) -> Run:
    camera = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), map(float, lens[:4]), strict=True))
    content = {
        "name": "case",
        "source": {"tracks": "tracks.csv"},
        "camera": {"image_size_px": list(SIZE), **camera, "distortion": [float(k) for k in lens[4:]]},
        "datum": [
            {"name": f"p{i}", "pixel_px": [float(v) for v in p], "tank_m": [float(v) for v in t], "sigma_px": PICK_PX}
            for i, (p, t) in enumerate(zip(picks, points, strict=True))
        ],
        "marker": [
            {"name": name, "body_m": [float(v) for v in b], "depth_m": float(depth)}
            for name, b in zip(("bow", "stern"), BODY, strict=True)
        ],
        "tow": {"speed_m_s": 1.0, "line_length_m": LINE_M, "tow_point_m": TOW_POINT_M, "tension_n": 4.0},
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"density_kg_m3": 1000.0},
    }
    if unsure:
        content["camera"]["sd"] = list(LENS_SD)
        content["priors"] = {"marker_place_sd_m": PLACE_SD_M, "marker_depth_sd_m": DEPTH_SD_M}
    return Run(Path("case"), check_tables(content, RunFile, Path("run.toml")))


def _tracks(t_s: np.ndarray, seen: np.ndarray) -> pd.DataFrame:
    n = len(t_s)
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(n), 2),
            "t_s": np.repeat(t_s, 2),
            "marker": np.tile(["bow", "stern"], n),
            "u_px": seen[:, :, 0].ravel(),
            "v_px": seen[:, :, 1].ravel(),
            "sigma_u_px": MARK_PX,
            "sigma_v_px": MARK_PX,
            "status": "measured",
        }
    )
