"""Campaigns of six tows with one planted effect, for the diagnosis: tracks, static records and run.toml, with the truth aside.

The equations of motion are the product's; every effect is planted here in its own form: strips for the drag, a lens bent in the
picture, a clock that runs off. The withheld check of the diagnosis has a generator that shares nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from towline.geometry import Camera, Lens
from towline.record import Run, RunFile
from towline.record.toml import check_tables
from towline.simulate.model import (
    RESISTANCE_EXPONENT,
    Hull,
    Line,
    Tow,
    alpha_from_y,
    full_rates,
    full_state,
    full_x_cg,
    full_y_cg,
)
from towline.simulate.motion import Histories, Start, simulate_full

SIX = (149.19, 62.11, -52.87, -66.33, -48.51, -57.60)
SPEED_M_S, LENGTH_M, DENSITY, WIDTH_M = 1.28, 2.66, 1000.0, 4.6
SURGE = {"mass_kg": 78.0, "x_udot_kg": -4.0, "x_vr_kg": 40.0}
RATE_HZ, DURATION_S, STATIC_S = 25.0, 45.0, 12.0
DESIGN = (
    # tow point, line, speed, y at release, heading at release
    (1.446, 0.91, 1.28, 0.15, 0.0),
    (1.548, 0.91, 1.28, 0.20, 0.05),
    (1.649, 0.91, 1.28, -0.18, 0.0),
    (1.751, 0.91, 1.28, 0.15, -0.10),
    (1.649, 0.60, 1.28, 0.15, 0.0),
    (1.548, 0.91, 0.90, 0.20, 0.03),
)
SIZE = (1280, 960)
"""It holds what is seen: a mark outside its picture would be a gross mistake, and looked into for every run."""
DATUM = [(x, y, 0.0) for x in (-3.5, -2.3, -1.0) for y in (-0.85, 0.85)]
BODY = ((1.3, 0.0), (-1.1, 0.0))
EFFECTS = {
    "none": 0.0,
    "crossflow_drag": 0.15,
    "cubic_damping": 2500.0,
    "hull_asymmetry": 0.08,
    "added_mass_coupling": 20.0,
    "fluid_memory": 0.12,
    "bank_suction": 0.0003,
    "cross_current": 0.01,
    "speed_drift": 0.03,
    "tension_variation": 1.0,
    "elastic_line": 0.004,
    "slack_line": 0.9,
    "tow_point_offset": 0.008,
    "swivel_friction": 0.06,
    "lens_distortion": 0.03,
    "deck_height": 0.015,
    "camera_shift": 0.004,
    "datum_scale": 0.01,
    "datum_bias": 0.008,
    "marker_roll": 0.01,
    "frame_rate": 0.012,
    "rolling_shutter": 0.03,
    "constant_tension": 1.0,
    "unknown washboard": 0.15,
    "unknown kick": 0.12,
}
"""Effect -> its size (SI): clear to the eye in the residual."""
NEEDS_CONSTANT, NEEDS_SURGE = ("tension_variation", "slack_line"), ("constant_tension",)
"""Planted as a course of the tension, or by taking the line's length for what it does not keep."""


@dataclass(frozen=True)
class Campaign:
    """What the diagnosis gets.

    Attributes
    ----------
    runs : (run, tracks, static)
    planted : effect
    """

    runs: list[tuple[Run, pd.DataFrame, pd.DataFrame]]
    planted: str


def campaign(
    planted: str, rng: np.random.Generator, size: float | None = None, noise: float = 1.0, line: Line = "constant"
) -> Campaign:
    """Six tows with an effect.

    Parameters
    ----------
    planted : of EFFECTS
    size : instead of its usual one
    noise : factor on all noise
    line : what it keeps, its tension or (as a line does) its length
    """
    size = EFFECTS[planted] if size is None else size
    lens = Lens(1300.0, 1300.0, 640.0 + rng.normal(0, 4), 360.0 + rng.normal(0, 4), np.array([-0.05, 0.0, 0, 0, 0]))
    camera = Camera.looking_at(
        lens, np.array([-4.6, rng.normal(0, 0.1), -2.6]), np.array([-2.35, 0.0, 0.1]), rng.normal(0, 0.02)
    )
    picked_by, points = camera, np.array(DATUM)
    if planted == "lens_distortion":  # the lens bends otherwise than stated, for picks and marks alike
        picked_by = replace(camera, lens=_bent(camera.lens, size))
    if planted == "datum_scale":
        points = points * [1 + size, 1 + size, 1.0]
    picks = picked_by.project(points) + 0.15 * noise * rng.normal(size=(len(DATUM), 2))
    return Campaign([_tow(planted, size, i, camera, picks, rng, noise, line) for i in range(len(DESIGN))], planted)


def _tow(
    planted: str,
    size: float,
    index: int,
    camera: Camera,
    picks: np.ndarray,
    rng: np.random.Generator,
    noise: float,
    line_keeps: Line,
):
    x_t, line, speed, y, beta = DESIGN[index]
    tension = 3.96 * (speed / SPEED_M_S) ** (2 if line_keeps == "constant" else RESISTANCE_EXPONENT)
    depth = (0.19, 0.22)
    run = _run(index, camera.lens, picks, x_t, line, speed, tension, depth, line_keeps)
    small = rng.normal(size=4) * noise
    tow = Tow(
        speed * (1 + 1e-3 * small[0]),
        line + 5e-4 * small[1],
        x_t + 5e-4 * small[2],
        tension * (1 + 4e-3 * small[3]),
        line=line_keeps,
    )
    hull = Hull(*SIX, speed_m_s=SPEED_M_S, **SURGE)
    t_s = np.arange(int(DURATION_S * RATE_HZ)) / RATE_HZ
    motion_t = t_s * (1 + size) if planted == "frame_rate" else t_s
    fine = np.linspace(0, motion_t[-1] + 1, int(8 * (motion_t[-1] + 1)))
    random = [_slow(fine, 0.004 * noise, 1.5, rng) for _ in range(2)]
    histories, tow, hull = _settings(planted, size, tow, hull)
    extra = _force(planted, size, tow, hull, index)

    def force(t, y, beta, v, r, alpha):
        one, two = extra(t, y, beta, v, r, alpha)
        return one + np.interp(t, fine, random[0]), two + np.interp(t, fine, random[1])

    start = float(alpha_from_y(y * (1 + 0.02 * rng.normal()), beta, tow))
    if planted in ("elastic_line", "sagging line") and line_keeps == "surge":  # a spring, and the model bounces on it
        spring = replace(tow, stiffness_n_m=1 / size) if planted == "elastic_line" else _hanging(tow, size)
        motion = simulate_full(hull, spring, Start(beta_rad=beta, alpha_rad=start), motion_t, extra=force)
        alpha, pose = motion["alpha_rad"].to_numpy(), motion[["x_cg_m", "y_cg_m", "beta_rad"]].to_numpy()
    else:
        path = _swum(hull, tow, np.array([start, beta, 0.0, 0.0]), motion_t, histories, force)
        alpha, heading = path[:, 0], path[:, 1]
        pose = np.column_stack([full_x_cg(alpha, heading, tow), full_y_cg(0.0, alpha, heading, tow), heading])
        if planted == "marker_roll":  # by what the line pulls to the side, of a straight tow's pull
            pull = full_state(motion_t, tuple(path.T), hull, tow).tension_n / tow.tension_n
            pose[:, 1] += size * pull * np.sin(alpha + heading)
    pose = _geometry(planted, size, pose, motion_t)
    tracks = _filmed(planted, size, camera, pose, depth, t_s, rng, noise)
    held = np.tile(pose[:1], (int(STATIC_S * RATE_HZ), 1))
    static = _filmed(planted, size, camera, held, depth, np.arange(len(held)) / RATE_HZ, rng, noise)
    return run, tracks, static


def _swum(hull: Hull, tow: Tow, state: np.ndarray, t_s: np.ndarray, histories: Histories, force) -> np.ndarray:
    """Classical Runge-Kutta from sample to sample: (alpha, beta, v, r)."""
    hull = hull.at_speed(tow.speed_m_s)

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        here = (hull, tow) if histories.empty else histories.at(t, hull, tow)
        return full_rates(t, x, *here, force)

    path = [state]
    for t, step in zip(t_s[:-1], np.diff(t_s), strict=True):
        k1 = rates(t, state)
        k2 = rates(t + step / 2, state + step / 2 * k1)
        k3 = rates(t + step / 2, state + step / 2 * k2)
        k4 = rates(t + step, state + step * k3)
        state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        path.append(state)
    return np.array(path)


def _settings(planted: str, size: float, tow: Tow, hull: Hull) -> tuple[Histories, Tow, Hull]:
    speed = tow.speed_m_s
    if planted == "speed_drift":
        return Histories(speed_m_s=lambda t: speed * (1 + size * (t / DURATION_S - 0.5))), tow, hull
    if planted == "tension_variation":
        return Histories(), replace(tow, tension_n=None, resistance_n=tow.tension_n), hull
    if planted == "constant_tension":
        return Histories(), replace(tow, line="constant"), hull
    if planted == "tow_point_offset":
        return Histories(), replace(tow, tow_point_offset_m=size), hull
    if planted == "elastic_line":
        longer = size * tow.tension_n if tow.line == "constant" else 0.0
        return Histories(), replace(tow, line_length_m=tow.line_length_m + longer), hull
    if planted == "sagging line" and tow.line == "constant":
        assert tow.tension_n is not None
        return Histories(), replace(tow, line_length_m=chord_m(tow.line_length_m, tow.tension_n, size)), hull
    if planted == "slack_line":
        full = tow.tension_n

        def pull(t: float) -> float:
            share = (t - 20.0) / 3.0
            return full * (1 - size * np.sin(np.pi * share)) if 0 < share < 1 else full

        return Histories(tension_n=pull), tow, hull
    if planted == "hull_asymmetry":
        return Histories(), tow, replace(hull, y_bias_n=size, n_bias_n_m=-0.5 * size)
    if planted == "added_mass_coupling":
        return Histories(), tow, replace(hull, y_rdot=size, n_vdot=0.5 * size)
    return Histories(), tow, hull


def _force(planted: str, size: float, tow: Tow, hull: Hull, index: int):
    here = hull.at_speed(tow.speed_m_s)
    strips = (np.arange(24) + 0.5) / 24 * LENGTH_M - LENGTH_M / 2
    past: dict[str, float] = {"t": 0.0, "v": 0.0}

    def none(t, y, beta, v, r, alpha):
        return 0.0, 0.0

    def drag(t, y, beta, v, r, alpha):
        across = v + strips * r
        each = -0.5 * DENSITY * size * (1 - 0.2 * strips / LENGTH_M) * across * np.abs(across) * LENGTH_M / 24
        return each.sum(), (strips * each).sum()

    def cubic(t, y, beta, v, r, alpha):
        return -size * v**3, -0.4 * size * v**3 - size * r**3

    def current(t, y, beta, v, r, alpha):
        return -here.y_v * size, -here.n_v * size

    def bank(t, y, beta, v, r, alpha):
        half = WIDTH_M / 2
        pull = (half / (half - y)) ** 2 - (half / (half + y)) ** 2
        return (
            0.25 * size * DENSITY * tow.speed_m_s**2 * pull,
            -0.1 * size * DENSITY * tow.speed_m_s**2 * LENGTH_M * pull,
        )

    def friction(t, y, beta, v, r, alpha):
        turning = (v + tow.tow_point_m * r + tow.speed_m_s * np.sin(beta)) / (
            tow.line_length_m * np.cos(alpha + beta)
        ) + r
        return 0.0, -size * np.sign(turning) * min(1.0, abs(turning) / 0.006)

    def washboard(t, y, beta, v, r, alpha):
        return size * np.sin(2 * np.pi * y / 0.13), 0.3 * size * np.cos(2 * np.pi * y / 0.13)

    def kick(t, y, beta, v, r, alpha):
        return size * np.tanh((abs(beta) - 0.06) / 0.01) * np.sign(beta), -0.5 * size * np.tanh((abs(v) - 0.05) / 0.01)

    def memory(t, y, beta, v, r, alpha):
        # a lag of 1.5 s, stepped along with the integrator (its steps are short beside the lag)
        step = max(t - past["t"], 0.0)
        past["v"] += (v - past["v"]) * (1 - np.exp(-step / 1.5))
        past["t"] = t
        return size * here.y_v * (past["v"] - v), 0.0

    return {
        "crossflow_drag": drag,
        "cubic_damping": cubic,
        "cross_current": current,
        "bank_suction": bank,
        "swivel_friction": friction,
        "fluid_memory": memory,
        "unknown washboard": washboard,
        "unknown kick": kick,
    }.get(planted, none)


def chord_m(length_m: float, tension_n: float, weight_n_m: float) -> float:
    """From end to end of a chain of this length that hangs level under a horizontal pull: a catenary, in closed form."""
    a = tension_n / weight_n_m
    return 2 * a * float(np.arcsinh(length_m / (2 * a)))


def _hanging(tow: Tow, weight_n_m: float) -> Tow:
    """The spring that a hanging chain is about the straight tow's pull."""
    pull = tow.tension_n
    assert pull is not None
    early, late = (chord_m(tow.line_length_m, pull * (1 + d), weight_n_m) for d in (-0.01, 0.01))
    stiffness = 0.02 * pull / (late - early)
    return replace(tow, line_length_m=(early + late) / 2 - pull / stiffness, stiffness_n_m=stiffness)


def _geometry(planted: str, size: float, pose: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    pose = pose.copy()
    if planted == "slack_line":
        share = (t_s - 20.0) / 3.0
        ahead = np.where((share > 0) & (share < 1), 0.02 * np.sin(np.pi * np.clip(share, 0, 1)), 0.0)
        pose[:, :2] += ahead[:, None] * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    if planted == "datum_bias":
        pose[:, :2] += [0.5 * size, size]
    return pose


def _filmed(planted, size, camera: Camera, pose, depth, t_s, rng: np.random.Generator, noise: float) -> pd.DataFrame:
    seen_by, deep = camera, np.array(depth)
    if planted == "lens_distortion":
        seen_by = replace(camera, lens=_bent(camera.lens, size))
    if planted == "camera_shift":
        turn = Rotation.from_rotvec([0.6 * size, size, 0.3 * size]).as_matrix()
        seen_by = replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation)
    if planted == "deck_height":
        deep = deep + size
    late = np.zeros((len(pose), 2))
    pixel = np.zeros((len(pose), 2, 2))
    for _ in range(2 if planted == "rolling_shutter" else 1):
        for m, (ahead, _) in enumerate(BODY):
            x, y, beta = (np.interp(t_s + late[:, m], t_s, p) for p in pose.T)
            place = np.column_stack([x + ahead * np.cos(beta), y + ahead * np.sin(beta), np.full(len(x), deep[m])])
            pixel[:, m] = seen_by.project(place)
        late = size * (pixel[:, :, 1] / SIZE[1] - 0.5)
    shake = np.column_stack([_slow(t_s, 0.04 * noise, 0.6, rng) for _ in range(2)])
    pixel = pixel + 0.1 * noise * rng.normal(size=pixel.shape) + shake[:, None]
    n = len(t_s)
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(n), 2),
            "t_s": np.repeat(t_s, 2),
            "marker": np.tile(["bow", "stern"], n),
            "u_px": pixel[:, :, 0].ravel(),
            "v_px": pixel[:, :, 1].ravel(),
            "sigma_u_px": 0.1,
            "sigma_v_px": 0.1,
            "status": "measured",
        }
    )


def _bent(lens: Lens, by: float) -> Lens:
    return replace(lens, distortion=lens.distortion + np.array([by, 0, 0, 0, 0]))


def _slow(t_s: np.ndarray, sd: float, time_s: float, rng: np.random.Generator) -> np.ndarray:
    """A first-order random process."""
    keep = np.exp(-np.diff(t_s, prepend=t_s[0]) / time_s)
    kicks = sd * rng.normal(size=len(t_s)) * np.sqrt(1 - keep**2)
    values = np.empty(len(t_s))
    last = sd * rng.normal()
    for k in range(len(t_s)):
        last = keep[k] * last + kicks[k]
        values[k] = last
    return values


def _run(
    index: int, lens: Lens, picks, x_t: float, line: float, speed: float, tension: float, depth, line_keeps: Line
) -> Run:
    numbers = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), map(float, lens.vector[:4]), strict=True))
    content = {
        "name": f"tow-{index + 1}",
        "source": {"tracks": "tracks.csv"},
        "noise": {"static": "static.csv"},
        "camera": {"image_size_px": list(SIZE), **numbers, "distortion": [float(k) for k in lens.distortion]},
        "datum": [
            {"name": f"d{k + 1}", "pixel_px": [float(u) for u in p], "tank_m": [float(v) for v in d], "sigma_px": 0.15}
            for k, (p, d) in enumerate(zip(picks, DATUM, strict=True))
        ],
        "marker": [
            {"name": name, "body_m": list(b), "depth_m": float(d)}
            for name, b, d in zip(("bow", "stern"), BODY, depth, strict=True)
        ],
        "tow": {"speed_m_s": speed, "line_length_m": line, "tow_point_m": x_t, "tension_n": float(tension)}
        | {"line": line_keeps},
        "model": {"length_pp_m": LENGTH_M, "mass_kg": 78.0},
        "water": {"density_kg_m3": DENSITY, "tank_width_m": WIDTH_M},
    }
    return Run(Path(f"tow-{index + 1}"), check_tables(content, RunFile, Path("run.toml")))
