"""Random set-ups as people write them, and one mistake planted in each: what the product reads, and what it should name.

Shares the pinhole camera with the product, and nothing else. Models of 0.35 to 6 m, lines of a fifth to four model lengths, cameras
that look down by 15 to 88 degrees from every side, 240 to 2160 lines, with and without a calibrated lens, 4 to 10 datum points at
one depth or two, marks above and below the datum plane; places, heights, lens and picks are off by what a tape measure and a
careful hand leave.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from towline.geometry import Camera, Lens
from towline.record import GeometryError

FRAMES, DURATION_S = 60, 30.0
SIZES = ((320, 240), (640, 480), (800, 600), (1280, 720), (1920, 1080), (3840, 2160))
PICK_PX, MARK_PX, PLACE_M, DEPTH_M = 0.4, 0.05, 7e-4, 1.5e-3
"""Standard deviations of picks, marks, places on deck and heights: what is really off in every set-up, mistake or none."""
DEGREE = np.pi / 180
Content = dict[str, Any]


@dataclass(frozen=True)
class SetUp:
    """What the product gets.

    Attributes
    ----------
    content : of run.toml
    tracks : of the film
    size_px : of its video's picture, where only that tells the camera
    """

    content: Content
    tracks: pd.DataFrame
    size_px: tuple[int, int] | None


@dataclass(frozen=True)
class Planted:
    """A mistake in a set-up.

    Attributes
    ----------
    name : what it is
    keys : beginnings of keys, one of which must be named; of an exchange both
    kind : kinds of mistake that say it; empty: any
    set_up : with the mistake in it
    """

    name: str
    keys: tuple[str, ...]
    kind: tuple[str, ...]
    set_up: SetUp


def random_set_up(rng: np.random.Generator) -> SetUp:
    """A set-up without a mistake."""
    while True:
        found = _tried(rng)
        if found is not None:
            return found


def _tried(rng: np.random.Generator) -> SetUp | None:
    length = float(np.exp(rng.uniform(np.log(0.35), np.log(6.0))))
    body = [[rng.uniform(0.3, 0.5) * length, 0.0], [-rng.uniform(0.28, 0.47) * length, 0.0]]
    for _ in range(int(rng.choice([0, 0, 1, 2]))):
        body.append([rng.uniform(-0.2, 0.2) * length, rng.choice([-1, 1]) * rng.uniform(0.04, 0.09) * length])
    body = np.array(body)
    level = rng.choice([-1.0, 1.0, 1.0, 1.0]) * max(0.025, rng.uniform(0.02, 0.12) * length)
    depth = level + rng.uniform(-0.01, 0.01, len(body)) * length * (rng.random() < 0.5)
    line = rng.choice([rng.uniform(0.2, 0.8), rng.uniform(0.8, 4.0)], p=[0.7, 0.3]) * length
    ahead = rng.uniform(0.25, 0.65) * length
    post = np.array([0.0, 0.0]) if rng.random() < 0.7 else rng.uniform(-0.3, 0.3, 2) * length
    t_s, pose = _motion(rng, length, line, ahead, post)
    half = rng.uniform(0.5, 1.5) * length
    middle = pose[:, :2].mean(axis=0)
    low = rng.uniform(0.04, 0.15) * length
    method = rng.choice(
        ["lens", "lens two depths", "two depths", "one plane", "in the plane"], p=[0.35, 0.3, 0.1, 0.15, 0.1]
    )
    if method == "in the plane":
        depth = np.zeros(len(body))
    points = _points(rng, method, middle, length, half, low)
    size = SIZES[int(rng.integers(len(SIZES)))]
    camera = _camera(rng, size, np.array([*middle, 0.0]), length, method)
    true_body = body + rng.normal(0, PLACE_M, body.shape)
    true_depth = depth + (rng.normal(0, DEPTH_M, len(depth)) if method != "in the plane" else 0.0)
    seen = _pixels(camera, pose, true_body, true_depth)
    picks = camera.project(points)
    everything = np.vstack([picks, seen.reshape(-1, 2)])
    if not np.isfinite(everything).all() or (everything < 2).any() or (everything > np.array(size) - 3).any():
        return None
    if np.ptp(picks, axis=0).min() < 0.12 * min(size):
        return None
    try:
        camera.lens.normalise(everything)
    except GeometryError:
        return None
    picks = picks + rng.normal(0, PICK_PX, picks.shape)
    seen = seen + rng.normal(0, MARK_PX, seen.shape)
    names = ["bow", "stern", "port", "mast"][: len(body)]
    content = _content(rng, length, line, ahead, post, half)
    content["datum"] = [
        {"name": f"p{i}", "pixel_px": _floats(p, 2), "tank_m": _floats(t, 4), "sigma_px": PICK_PX}
        for i, (p, t) in enumerate(zip(picks, points, strict=True))
    ]
    content["marker"] = [
        {"name": name, "body_m": _floats(b, 4), "depth_m": float(round(d, 4))}
        for name, b, d in zip(names, body, depth, strict=True)
    ]
    if method.startswith("lens"):
        lens = camera.lens.vector
        content["camera"] = {
            "image_size_px": list(size),
            **dict(
                zip(("fx_px", "fy_px", "cx_px", "cy_px"), _floats(lens[:4] * [1.0005, 1.0005, 1, 1], 3), strict=True)
            ),
            "distortion": _floats(lens[4:], 5),
        }
    return SetUp(content, _tracks(t_s, seen, names), None if "camera" in content else size)


def _motion(
    rng: np.random.Generator, length: float, line: float, ahead: float, post: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A swing, or a tow that has settled askew, on a taut line."""
    t_s = np.arange(FRAMES) * DURATION_S / FRAMES
    swing = 2 * np.pi * t_s / rng.uniform(8, 25)
    beta = rng.uniform(0.02, 0.35) * np.exp(-rng.uniform(0, 0.05) * t_s) * np.sin(swing + rng.uniform(0, 6))
    alpha = rng.uniform(0.02, 0.35) * np.exp(-rng.uniform(0, 0.05) * t_s) * np.cos(swing + rng.uniform(0, 6))
    alpha, beta = alpha + rng.normal(0, 0.04), beta + rng.normal(0, 0.04)
    point = post + line * np.column_stack([-np.cos(alpha), np.sin(alpha)])
    place = point - ahead * np.column_stack([np.cos(beta), np.sin(beta)])
    return t_s, np.column_stack([place, beta])


def _points(
    rng: np.random.Generator, method: str, middle: np.ndarray, length: float, half: float, low: float
) -> np.ndarray:
    """Datum points along both sides of the tank, four to ten, at one depth or two."""
    rows = int(rng.integers(2, 4))
    along = middle[0] + length * np.linspace(rng.uniform(0.6, 1.0), -rng.uniform(0.6, 1.0), rows)
    top = [(x, y, 0.0) for x in along for y in (-half, half)]
    if "two depths" in method:
        top += [(x, y, low) for x in (along[0], along[-1]) for y in (-half, half)]
    return np.round(np.array(top), 3)


def _camera(rng: np.random.Generator, size: tuple[int, int], middle: np.ndarray, length: float, method: str) -> Camera:
    """Looks down at the model from any side, mostly along the tow."""
    tilt, roll = np.radians(rng.uniform(15, 88)), np.radians(rng.normal(0, 4))
    side = rng.normal(0, 0.4) if rng.random() < 0.7 else rng.uniform(-np.pi, np.pi)
    distance = length * rng.uniform(1.6, 4.5)
    away = np.array([-np.cos(side) * np.cos(tilt), -np.sin(side) * np.cos(tilt), -np.sin(tilt)])
    focal = size[0] * rng.uniform(0.7, 1.6)
    centre = np.array(size) / 2 - 0.5 + rng.normal(0, 0.004, 2) * size[0]
    bend = np.array([rng.uniform(-0.25, 0.15), 0.0, 0.0, 0.0, 0.0]) if method.startswith("lens") else np.zeros(5)
    if method in ("one plane",):
        centre = np.array(size) / 2 - 0.5
    target = middle + np.array([*(rng.normal(0, 0.1, 2) * length), 0.0])
    return Camera.looking_at(Lens(focal, focal, *centre, bend), target + distance * away, target, roll)


def _pixels(camera: Camera, pose: np.ndarray, body: np.ndarray, depth: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x = pose[:, :1] + cosine[:, None] * body[:, 0] - sine[:, None] * body[:, 1]
    y = pose[:, 1:2] + sine[:, None] * body[:, 0] + cosine[:, None] * body[:, 1]
    tank = np.stack([x, y, np.broadcast_to(depth, x.shape)], axis=2)
    return camera.project(tank.reshape(-1, 3)).reshape(len(pose), len(body), 2)


def _content(
    rng: np.random.Generator, length: float, line: float, ahead: float, post: np.ndarray, half: float
) -> Content:
    """run.toml without what the camera sees."""
    mass = 1000 * rng.uniform(1.2e-3, 9e-3) * length**3
    speed = rng.uniform(0.1, 0.35) * np.sqrt(9.81 * length)
    friction = 0.075 / (np.log10(speed * length / 1.1e-6) - 2) ** 2
    plate = 0.5 * 1000 * 2.6 * np.sqrt(mass / 1000 * length) * speed**2 * friction
    content: Content = {
        "name": "case",
        "source": {"tracks": "tracks.csv"},
        "tow": {
            "speed_m_s": float(round(speed, 4)),
            "line_length_m": float(round(line, 4)),
            "tow_point_m": float(round(ahead, 4)),
            "post_m": _floats(post, 4),
            "tension_n": float(plate * rng.uniform(0.95, 2.6)),
        },
        "model": {"length_pp_m": float(round(length, 4)), "mass_kg": float(mass)},
        "water": {"density_kg_m3": 1000.0},
        "priors": {},
    }
    if rng.random() < 0.5:
        content["model"]["beam_m"] = float(round(length / rng.uniform(4, 9), 4))
    if rng.random() < 0.5:
        content["model"]["rudder_arm_m"] = float(round(-length * rng.uniform(0.4, 0.5), 4))
    if rng.random() < 0.4:
        content["model"]["trim_rad"] = float(round(rng.normal(0, 0.01), 4))
    if rng.random() < 0.5:
        content["tow"]["rudder_rad"] = float(round(rng.uniform(-35, 35) * DEGREE, 4))
    if rng.random() < 0.6:
        content["water"]["tank_width_m"] = float(round(2 * half * rng.uniform(1.0, 1.6) + 0.3 * length, 3))
    for key, most in (
        ("line_length_sd_m", 3e-3),
        ("tow_point_sd_m", 3e-3),
        ("marker_place_sd_m", 2e-3),
        ("marker_depth_sd_m", 4e-3),
    ):
        if rng.random() < 0.3:
            content["priors"][key] = float(round(rng.uniform(0.3, 1) * most, 5))
    if rng.random() < 0.3:
        content["priors"]["beta_bias_sd_rad"] = float(round(rng.uniform(0.002, 0.03), 4))
    return content


def _floats(values: Any, digits: int) -> list[float]:
    return [float(round(v, digits)) for v in values]


def _tracks(t_s: np.ndarray, seen: np.ndarray, names: list[str]) -> pd.DataFrame:
    n, m = seen.shape[:2]
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(n), m),
            "t_s": np.repeat(t_s, m),
            "marker": np.tile(names, n),
            "u_px": seen[:, :, 0].ravel(),
            "v_px": seen[:, :, 1].ravel(),
            "sigma_u_px": MARK_PX,
            "sigma_v_px": MARK_PX,
            "status": "measured",
        }
    )


# mistakes --------------------------------------------------------------------------------------------------------------

Plant = Callable[[np.random.Generator, Content], tuple[tuple[str, ...], tuple[str, ...]] | None]
"""Changes the content; returns keys and kinds that name it, or None where this set-up cannot hold it."""


def planted(rng: np.random.Generator, name: str, clean: SetUp) -> Planted | None:
    """The set-up with a mistake in it; None where it cannot hold this one."""
    content = copy.deepcopy(clean.content)
    found = MISTAKES[name](rng, content)
    return None if found is None else Planted(name, *found, SetUp(content, clean.tracks, clean.size_px))


def _datum_mirrored(_: np.random.Generator, c: Content):
    for p in c["datum"]:
        p["tank_m"][1] = -p["tank_m"][1]
    return ("datum",), ("y mirrored",)


def _body_mirrored(_: np.random.Generator, c: Content):
    if len(c["marker"]) < 3:
        return None
    for m in c["marker"]:
        m["body_m"][1] = -m["body_m"][1]
    return ("marker.body_m", "marker["), ("y mirrored", "wrong sign")


def _marker_depth_sign(rng: np.random.Generator, c: Content):
    if not any(m["depth_m"] for m in c["marker"]):
        return None
    one = rng.random() < 0.25
    for m in c["marker"][:1] if one else c["marker"]:
        m["depth_m"] = -m["depth_m"]
    return (('marker[1 "bow"].depth_m',) if one else ("marker.depth_m",)), ("wrong sign",)


def _datum_heights(rng: np.random.Generator, c: Content):
    deepest = max(p["tank_m"][2] for p in c["datum"])
    if not deepest:
        return None
    negative = rng.random() < 0.5
    for p in c["datum"]:
        p["tank_m"][2] = float(round((0 if negative else deepest) - p["tank_m"][2], 4))
    return ("datum",), ("wrong sign",)


def _points_exchanged(rng: np.random.Generator, c: Content):
    i, j = sorted(rng.choice(len(c["datum"]), 2, replace=False))
    a, b = c["datum"][i], c["datum"][j]
    a["tank_m"], b["tank_m"] = b["tank_m"], a["tank_m"]
    return (f'datum[{i + 1} "p{i}"].tank_m', f'datum[{j + 1} "p{j}"].tank_m'), ("exchanged",)


def _marks_exchanged(rng: np.random.Generator, c: Content):
    i, j = sorted(rng.choice(len(c["marker"]), 2, replace=False))
    a, b = c["marker"][i], c["marker"][j]
    a["body_m"], b["body_m"] = b["body_m"], a["body_m"]
    return tuple(f'marker[{k + 1} "{c["marker"][k]["name"]}"].body_m' for k in (i, j)), ("exchanged",)


def _one_length(factor: float, keys: tuple[tuple[str, str], ...]) -> Plant:
    def plant(rng: np.random.Generator, c: Content):
        there = [(t, k) for t, k in keys if k in c.get(t, {}) and c[t][k] not in (0.0, [0.0, 0.0])]
        if not there:
            return None
        table, key = there[int(rng.integers(len(there)))]
        value = c[table][key]
        c[table][key] = [factor * v for v in value] if isinstance(value, list) else factor * value
        return (f"{table}.{key}",), ()

    return plant


LENGTHS = (
    ("tow", "line_length_m"), ("tow", "tow_point_m"), ("tow", "post_m"), ("model", "length_pp_m"), ("model", "beam_m"),
    ("model", "rudder_arm_m"), ("water", "tank_width_m"), ("priors", "line_length_sd_m"), ("priors", "tow_point_sd_m"),
    ("priors", "marker_place_sd_m"), ("priors", "marker_depth_sd_m"),
)  # fmt: skip
TOW = (("tow", "line_length_m"), ("tow", "tow_point_m"))


def _seen_length(factor: float) -> Plant:
    def plant(rng: np.random.Generator, c: Content):
        which = rng.choice(["datum", "point", "body", "mark", "depth"])
        if which == "datum":
            for p in c["datum"]:
                p["tank_m"] = [factor * v for v in p["tank_m"]]
            return ("datum",), ()
        if which == "point":
            i = int(rng.integers(len(c["datum"])))
            axis = int(np.argmax(np.abs(c["datum"][i]["tank_m"])))
            c["datum"][i]["tank_m"][axis] *= factor
            return (f"datum[{i + 1}",), ()
        if which == "depth":
            if not any(m["depth_m"] for m in c["marker"]):
                return None
            for m in c["marker"]:
                m["depth_m"] *= factor
            return ("marker.depth_m", 'marker[1 "bow"].depth_m'), ()
        some = c["marker"] if which == "body" else c["marker"][:1]
        for m in some:
            m["body_m"] = [factor * v for v in m["body_m"]]
        return ("marker.body_m", 'marker[1 "bow"].body_m'), ()

    return plant


def _all_mm(_: np.random.Generator, c: Content):
    for p in c["datum"]:
        p["tank_m"] = [1e3 * v for v in p["tank_m"]]
    for m in c["marker"]:
        m["body_m"], m["depth_m"] = [1e3 * v for v in m["body_m"]], 1e3 * m["depth_m"]
    for table, key in LENGTHS:
        if key in c[table]:
            v = c[table][key]
            c[table][key] = [1e3 * x for x in v] if isinstance(v, list) else 1e3 * v
    return ("datum",), ()


def _degrees(rng: np.random.Generator, c: Content):
    there = [("tow", "rudder_rad"), ("model", "trim_rad"), ("priors", "beta_bias_sd_rad")]
    there = [(t, k) for t, k in there if abs(c[t].get(k, 0.0)) > 0.004]
    if not there:
        return None
    table, key = there[int(rng.integers(len(there)))]
    c[table][key] = float(round(c[table][key] / DEGREE, 2))
    return (f"{table}.{key}",), ()


def _template(rng: np.random.Generator, c: Content):
    from towline.record.template import example_datum

    size = tuple(c["camera"]["image_size_px"]) if "camera" in c else (1280, 720)
    points = example_datum(size, 1.0, -1.0, 0.5)
    if rng.random() < 0.4:  # renamed, the rest left
        for p, name in zip(points, "abcd", strict=True):
            p["name"] = name
    if rng.random() < 0.3 and "camera" in c:  # and made sure
        for p in points:
            del p["sigma_px"], p["tank_sd_m"]
    c["datum"] = points
    return ("datum",), ("template",)


def _other_picture(rng: np.random.Generator, c: Content):
    if "camera" not in c:
        return None
    camera = c["camera"]
    size = camera["image_size_px"]
    others = [s for s in SIZES if s[0] * size[1] == s[1] * size[0] and list(s) != size]
    if not others:
        return None
    other = others[int(rng.integers(len(others)))]
    scale = other[0] / size[0]
    if rng.random() < 0.5:
        for p in c["datum"]:
            p["pixel_px"] = [float(round((v + 0.5) * scale - 0.5, 2)) for v in p["pixel_px"]]
        return ("datum",), ("other picture",)
    camera["image_size_px"] = list(other)
    for key in ("fx_px", "fy_px"):
        camera[key] *= scale
    for key in ("cx_px", "cy_px"):
        camera[key] = (camera[key] + 0.5) * scale - 0.5
    return ("camera.image_size_px",), ("other picture",)


def _force(factor: float) -> Plant:
    def plant(_: np.random.Generator, c: Content):
        c["tow"]["tension_n"] *= factor
        return ("tow.tension_n",), ()

    return plant


MISTAKES: dict[str, Plant] = {
    "datum: y mirrored": _datum_mirrored,
    "body_m: y mirrored": _body_mirrored,
    "depth_m: wrong sign": _marker_depth_sign,
    "datum: heights for depths": _datum_heights,
    "datum: two points exchanged": _points_exchanged,
    "two marks exchanged": _marks_exchanged,
    "one length in mm": _one_length(1e3, LENGTHS),
    "one length in cm": _one_length(1e2, LENGTHS[:7]),
    "one length a thousandth": _one_length(1e-3, LENGTHS[:7]),
    "datum or marks in mm": _seen_length(1e3),
    "datum or marks in cm": _seen_length(1e2),
    "all lengths in mm": _all_mm,
    "line or tow point in inches": _one_length(1 / 0.0254, TOW),
    "line or tow point in feet": _one_length(1 / 0.3048, TOW),
    "degrees": _degrees,
    "datum of the template": _template,
    "picture of another clip": _other_picture,
    "tension in kgf": _force(1 / 9.80665),
    "tension in grams-force": _force(1e3 / 9.80665),
}
