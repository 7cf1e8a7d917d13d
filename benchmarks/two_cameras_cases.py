"""Random tows before two random cameras that are not synchronised, with their truth.

Shares nothing with the product but the form of run.toml and of tracks: the motion is a formula, scipy turns the body, and OpenCV
projects. Two cameras look down by 25 to 70 degrees from either side, each with its own lens (k1 within +-0.2), frame rate,
start and rate of its clock; each sees the marks for a part of the tow only. Marks to 0.05 px, picks to 0.3 px; lens, depths and
places of the marks are wrong by what is stated of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from towline.record import Run, RunFile
from towline.record.toml import check_tables

SIZE = (1280, 720)
LINE_M, TOW_POINT_M, DURATION_S = 0.91, 1.2, 60.0
MARKS = {"bow": (1.0, 0.0, 0.10), "stern": (-1.0, 0.0, 0.12), "mast": (-0.1, 0.0, -0.35), "side": (0.2, 0.16, 0.10)}
"""Ahead of LCG, to starboard, depth below the tank top; m."""
TOP = [(x, y, 0.0) for x in (-0.4, -2.1, -3.8) for y in (-0.9, 0.9)]
LOW = [(x, y, 0.25) for x in (-0.4, -3.8) for y in (-0.9, 0.9)]
NAMES = ("port", "starboard")
MARK_PX, PICK_PX = 0.05, 0.3
LENS_SD = (1.0, 1.0, 1.5, 1.5, 0.002, 0.002, 2e-4, 2e-4, 0.002)
PLACE_SD_M, DEPTH_SD_M = 0.5e-3, 1e-3
RATES_HZ = (25.0, 30000 / 1001, 30.0, 50.0)
AXIS_M = 0.15
"""Depth of the point of the body that x, y, heave are of: about the water line."""


@dataclass(frozen=True)
class Eye:
    """A camera of OpenCV's: lens (fx fy cx cy k1 k2 p1 p2 k3), turn (tank to camera) and place."""

    lens: np.ndarray
    turn: np.ndarray
    place_m: np.ndarray

    def sees(self, tank_m: np.ndarray) -> np.ndarray:
        """Pixels (n, 2) of tank points (n, 3)."""
        fx, fy, cx, cy, *bend = self.lens
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        spin, _ = cv2.Rodrigues(self.turn)
        found, _ = cv2.projectPoints(tank_m.reshape(-1, 1, 3), spin, -self.turn @ self.place_m, matrix, np.array(bend))
        return found.reshape(-1, 2)


@dataclass(frozen=True)
class Tow:
    """A motion as a function of the true time, (n,) -> (n, 6): x, y, heading, heave, roll, pitch."""

    pose: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Case:
    """What the product gets, and the truth.

    Attributes
    ----------
    run : with two [[camera]]
    content : of its run.toml
    tracks : of each
    offset_s, rate : of the second clock: t_first = offset_s + (1 + rate) t_second
    truth : of times on the first clock: (n,) -> (n, 6)
    axis_m : depth of the point of the body that the truth is of
    """

    run: Run
    content: dict[str, Any]
    tracks: tuple[pd.DataFrame, pd.DataFrame]
    offset_s: float
    rate: float
    truth: Callable[[np.ndarray], np.ndarray]
    axis_m: float = AXIS_M


def random_tow(rng: np.random.Generator, rolls: bool = False) -> Tow:
    """A swing on the line that dies away, with a slower one on top; with ``rolls`` also roll, heave and pitch."""
    period, decay = rng.uniform(9, 18), rng.uniform(0.005, 0.03)
    size, turned, lag = rng.uniform(0.12, 0.3), rng.uniform(0.05, 0.12), rng.uniform(0, 1)
    slow, phase = rng.uniform(25, 40), rng.uniform(0, 2 * np.pi, 5)
    rolling = rng.uniform(0.5, 2.0) if rolls else 0.0

    def pose(t: np.ndarray) -> np.ndarray:
        wave = 2 * np.pi / period * t
        y = size * np.exp(-decay * t) * np.cos(wave) + 0.02 * np.sin(2 * np.pi * t / slow + phase[0])
        beta = turned * np.exp(-decay * t) * np.sin(wave + lag) + 0.005 * np.sin(2 * np.pi * t / slow + phase[1])
        alpha = np.arcsin((y + TOW_POINT_M * np.sin(beta)) / LINE_M)
        x = -LINE_M * np.cos(alpha) - TOW_POINT_M * np.cos(beta)
        roll = np.radians(rolling) * (np.sin(2 * np.pi * t / 2.3 + phase[2]) + 0.4 * np.sin(wave + 1))
        heave = 0.003 * rolling * np.sin(2 * np.pi * t / 1.7 + phase[3])
        pitch = np.radians(0.2 * rolling) * np.sin(2 * np.pi * t / 1.9 + phase[4])
        return np.column_stack([x, y, beta, heave, roll, pitch])

    return Tow(pose)


def mark_places(pose: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Marks (m, 3) of the body in the tank, (n, m, 3): yaw, then pitch, then roll about the body's own axes."""
    turn = Rotation.from_euler("ZYX", pose[:, [2, 5, 4]]).as_matrix()
    own = body - [0.0, 0.0, AXIS_M]
    place = np.einsum("nij,mj->nmi", turn, own)
    return place + np.column_stack([pose[:, :2], pose[:, 3] + AXIS_M])[:, None]


def random_eye(rng: np.random.Generator, side: int, through: np.ndarray) -> Eye:
    """A camera on one side that sees all datum points, and all marks at all times."""
    while True:
        tilt, azimuth = np.radians(rng.uniform(25, 70)), np.radians(rng.uniform(15, 60)) * side
        distance, focal = rng.uniform(3.5, 6.0), rng.uniform(800, 1400)
        target = np.array([-2.1, rng.uniform(-0.2, 0.2), 0.0])
        ahead = np.array([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)])
        right = np.cross([0.0, 0.0, 1.0], ahead)
        right /= np.linalg.norm(right)
        level = np.stack([right, np.cross(ahead, right), ahead])
        turn = Rotation.from_euler("z", rng.uniform(-5, 5), degrees=True).as_matrix() @ level
        lens = np.array([focal, focal * rng.uniform(0.995, 1.005), *(np.array(SIZE) / 2 + rng.uniform(-15, 15, 2))])
        lens = np.concatenate([lens, [rng.uniform(-0.2, 0.2), 0.02, 5e-4, -5e-4, 0.0]])
        eye = Eye(lens, turn, target - distance * ahead)
        seen = eye.sees(np.vstack([np.array(TOP + LOW), through]))
        if (seen > 5).all() and (seen < np.array(SIZE) - 5).all():
            return eye


def random_case(
    seed: int,
    marks: tuple[str, ...] = ("bow", "stern"),
    rolls: bool = False,
    duration_s: float = DURATION_S,
    noise: tuple[float, float] = (MARK_PX, PICK_PX),
    unsure: bool = True,
    still: bool = False,
    pull_px_rad: float = 0.0,
) -> Case:
    """A tow, two cameras, their tracks.

    Parameters
    ----------
    seed : of everything
    marks : of MARKS
    rolls : the model rolls, heaves and pitches
    duration_s : of the tow
    noise : of marks and picks, px
    unsure : lens, depths and places are wrong by what is stated of them
    still : the model does not move
    pull_px_rad : each mark is drawn aside as model and line turn, by so much (standard deviation) a radian of either
    """
    rng = np.random.default_rng(seed)
    tow = random_tow(rng, rolls)
    offset_s, rate = rng.uniform(-2, 2), rng.uniform(-1e-4, 1e-4)

    def truth(t_s: np.ndarray) -> np.ndarray:
        return tow.pose(np.zeros_like(t_s) if still else t_s)

    body = np.array([MARKS[name] for name in marks])
    every = truth(np.linspace(-3, duration_s + 3, 400))
    eyes = [random_eye(rng, side, mark_places(every, body).reshape(-1, 3)) for side in (-1, 1)]
    wrong = rng.standard_normal((len(marks), 3)) * [PLACE_SD_M, PLACE_SD_M, DEPTH_SD_M] * unsure
    cameras, tracks = [], []
    for index, eye in enumerate(eyes):
        hz = rng.choice(RATES_HZ)
        own_s = np.arange(round(duration_s * hz)) / hz
        first_s = own_s if index == 0 else offset_s + (1 + rate) * own_s
        seen = eye.sees(mark_places(truth(first_s), body).reshape(-1, 3)).reshape(len(own_s), -1, 2)
        seen += noise[0] * rng.standard_normal(seen.shape)
        _, y, beta, *_ = truth(first_s).T
        turned = np.column_stack([beta, np.arcsin((y + TOW_POINT_M * np.sin(beta)) / LINE_M) + beta])
        if pull_px_rad:
            seen += np.einsum("nk,kmj->nmj", turned, pull_px_rad * rng.standard_normal((2, len(marks), 2)))
        # the first loses the model in the last quarter, the second sees it from the first quarter on
        cut = duration_s * rng.uniform(0.15, 0.3)
        lost = first_s > duration_s - cut if index == 0 else first_s < cut
        seen[lost] = np.nan
        tracks.append(_table(own_s, seen, marks))
        lens = eye.lens + rng.standard_normal(9) * LENS_SD * unsure
        picks = eye.sees(np.array(TOP + LOW)) + noise[1] * rng.standard_normal((len(TOP + LOW), 2))
        cameras.append(_camera(NAMES[index], lens, picks, unsure))
    content = {
        "name": f"case-{seed}",
        "camera": cameras,
        "marker": [
            {"name": name, "body_m": [float(v) for v in (b + w)[:2]], "depth_m": float((b + w)[2])}
            for name, b, w in zip(marks, body, wrong, strict=True)
        ],
        "tow": {"speed_m_s": 1.0, "line_length_m": LINE_M, "tow_point_m": TOW_POINT_M, "tension_n": 4.0},
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"density_kg_m3": 1000.0},
    }
    if unsure:
        content["priors"] = {"marker_place_sd_m": PLACE_SD_M, "marker_depth_sd_m": DEPTH_SD_M}
    run = Run(Path("case"), check_tables(content, RunFile, Path("run.toml")))
    return Case(run, content, (tracks[0], tracks[1]), offset_s, rate, truth)


def _camera(name: str, lens: np.ndarray, picks: np.ndarray, unsure: bool) -> dict[str, Any]:
    told = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), map(float, lens[:4]), strict=True))
    table: dict[str, Any] = {"image_size_px": list(SIZE), **told, "distortion": [float(k) for k in lens[4:]]}
    if unsure:
        table["sd"] = list(LENS_SD)
    datum = [
        {"name": f"p{i}", "pixel_px": [float(v) for v in p], "tank_m": [float(v) for v in t], "sigma_px": PICK_PX}
        for i, (p, t) in enumerate(zip(picks, TOP + LOW, strict=True))
    ]
    return {"name": name, "tracks": f"{name}.csv", "lens": table, "datum": datum}


def _table(own_s: np.ndarray, seen: np.ndarray, marks: tuple[str, ...]) -> pd.DataFrame:
    n, m = seen.shape[:2]
    lost = np.isnan(seen).any(axis=2).ravel()
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(n), m),
            "t_s": np.repeat(own_s, m),
            "marker": np.tile(list(marks), n),
            "u_px": seen[:, :, 0].ravel(),
            "v_px": seen[:, :, 1].ravel(),
            "sigma_u_px": np.where(lost, np.nan, MARK_PX),
            "sigma_v_px": np.where(lost, np.nan, MARK_PX),
            "status": np.where(lost, "lost", "measured"),
        }
    )
