"""What is drawn for a path-traced campaign: hull, tows, camera, lens, lamps, water, marks, codec, and what run.toml then says.

Nothing here or in the rooms beside it is shared with the project's own renderer: the camera's formulae, the picture and the
encoding are written anew. The motion is the project's own simulator's, with surge in full (theory.md 10).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from surge_cases import MARINER

from towline.simulate.characteristic import stability
from towline.simulate.model import DERIVATIVE_UNITS, Hull, Tow
from towline.simulate.motion import Start, simulate_full

Array = NDArray[Any]
Rng = np.random.Generator

MASS_KG, LENGTH_PP_M, HULL_LENGTH_M, SPEED_M_S, TANK_WIDTH_M = 78.0, 2.66, 2.80, 1.28, 4.6
TOWS, DURATION_S = 4, 30.0
RATES_HZ = (25.0, 12.5, 12.5)
"""Frames a second of the campaigns, in turn."""
PRIORS = {
    "tension_sd_rel": 0.005,
    "tension_common_sd_rel": 0.003,
    "tow_point_sd_m": 0.0005,
    "line_length_sd_m": 0.001,
    "speed_sd_rel": 0.002,
    "marker_depth_sd_m": 0.002,
    "marker_place_sd_m": 0.001,
}
"""What the person says of scale, tape measure and carriage; what run.toml says is wrong by errors drawn from it."""
PICK_SIGMA_PX = 0.15
PLANTED = {2: "swivel_friction", 5: "lens_distortion", 8: "deck_height"}
"""Campaign -> the effect that is there and that its run.toml knows nothing of."""
FRICTION_N_M, TURNED_RAD_S = 0.08, 0.003
"""Dry friction of the swivel, and the rate at which it has turned over."""
LENS_K1, DECK_M = 0.05, 0.02
"""By what the lens and the marks' depth are stated wrong where that is planted."""
CODECS = ("h264", "hevc10", "h264", "hevc")
"""Of the campaigns, in turn."""


@dataclass(frozen=True)
class Camera:
    """A pinhole with OpenCV's five distortion numbers; pixel centres at whole numbers.

    Attributes
    ----------
    size_px : width, height
    fx_px, cx_px, cy_px : focal length of both axes, principal point
    distortion : k1, k2, p1, p2, k3
    turn, place_m : (3, 3) tank to camera, (3,) camera in the tank
    """

    size_px: tuple[int, int]
    fx_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...]
    turn: Array
    place_m: Array

    def pixel(self, tank_m: Array) -> Array:
        """(..., 3) m -> (..., 2) px."""
        seen = (np.asarray(tank_m, dtype=float) - self.place_m) @ self.turn.T
        return self.bent(seen[..., :2] / seen[..., 2:])

    def bent(self, straight: Array) -> Array:
        """Pinhole coordinates (..., 2) -> px."""
        x, y = straight[..., 0], straight[..., 1]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        down = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([self.cx_px + self.fx_px * across, self.cy_px + self.fx_px * down], axis=-1)

    def straight(self, pixel_px: Array) -> Array:
        """px -> pinhole coordinates, by repeated correction (to 1e-12: lenses here are weak)."""
        goal = np.asarray(pixel_px, dtype=float)
        found = (goal - (self.cx_px, self.cy_px)) / self.fx_px
        for _ in range(30):
            found = found + (goal - self.bent(found)) / self.fx_px
        return found

    def rays(self, pixel_px: Array) -> Array:
        """Unit directions in the tank, (..., 3), of pixels (..., 2)."""
        flat = self.straight(pixel_px)
        ahead = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1) @ self.turn
        return ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)


def looking(place_m: Array, at_m: Array) -> Array:
    """Tank to camera of one that is held level: x right, y down the picture, z ahead."""
    ahead = (at_m - place_m) / np.linalg.norm(at_m - place_m)
    right = np.cross(np.array([0.0, 0.0, 1.0]), ahead)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def drawn(number: int, seed: int) -> dict[str, Any]:
    """Campaign ``number``: everything that its films are made from; drawn anew until every tow is stable and its line taut."""
    rng = np.random.default_rng([seed, number])
    while True:
        case = _case(rng, number)
        try:
            motions = [motion_of(case, k) for k in range(TOWS)]
        except ArithmeticError:
            continue
        if all(m is not None and _inside(case, m) for m in motions):
            return case


def _case(rng: Rng, number: int) -> dict[str, Any]:
    hull = {name: round(value * float(rng.uniform(0.85, 1.15)), 4) for name, value in MARINER.items()}
    beside = {
        "x_udot_kg": -MASS_KG * float(rng.uniform(0.02, 0.08)),
        "x_vr_kg": float(rng.uniform(0.0, hull["m_minus_y_vdot"] - MASS_KG)),
        "x_vv_kg_m": MASS_KG / LENGTH_PP_M * float(rng.normal(-0.4, 1.2)),
        "x_rr_kg_m": MASS_KG * LENGTH_PP_M * float(rng.normal(0.0, 0.02)),
        "resistance_exponent": float(rng.normal(1.85, 0.1)),
    }
    line, pull = round(float(rng.uniform(0.7, 1.1)), 3), float(rng.uniform(3.6, 4.4))
    points = np.linspace(1.45, 1.78, TOWS) + rng.uniform(-0.02, 0.02, TOWS)
    tows = [
        {
            "line_length_m": line,
            "tow_point_m": round(float(x), 4),
            "tension_n": round(pull * float(1 + 0.01 * rng.normal()), 4),
            "start_y_m": round(float(rng.choice([-1, 1]) * rng.uniform(0.12, 0.2)), 3),
        }
        for x in points
    ]
    depth = float(rng.uniform(0.08, 0.22))
    marks = [
        {
            "name": name, "body_m": [round(float(rng.uniform(*where)), 3), 0.0],
            "depth_m": round(depth + float(rng.uniform(-0.02, 0.02)), 3),
        }
        for name, where in (("bow", (1.1, 1.3)), ("stern", (-1.2, -1.0)))
    ]  # fmt: skip
    if rng.random() < 0.3:
        marks.append({"name": "middle", "body_m": [0.1, 0.05], "depth_m": round(depth, 3)})
    focal = round(float(rng.uniform(930, 1080)), 1)
    return {
        "number": number,
        "planted": PLANTED.get(number, ""),
        "hull": hull | {name: round(value, 4) for name, value in beside.items()},
        "tows": tows,
        "marks": marks,
        "camera": {
            "fx_px": focal,
            "k1": round(float(rng.uniform(-0.1, 0.02)), 4),
            "place_m": [round(float(v), 3) for v in (rng.uniform(-7.4, -6.6), rng.uniform(-0.4, 0.4), rng.uniform(-3.9, -3.0))],
            "look_at_m": [-2.3, round(float(rng.uniform(-0.1, 0.1)), 3), 0.2],
            "blur_px": round(float(rng.uniform(0.45, 0.8)), 3),
            "exposure_s": round(float(rng.uniform(0.002, 0.016)), 4),
            "read_noise": round(float(rng.uniform(0.0015, 0.006)), 5),
            "full_well": round(float(rng.uniform(6e3, 2e4))),
        },
        "light": {
            "lamps": [
                [
                    round(float(v), 2)
                    for v in (rng.uniform(-6, 3), rng.uniform(-2.0, 2.0), rng.uniform(-5.5, -4.2), rng.uniform(0.4, 1.6))
                ]
                for _ in range(int(rng.integers(2, 5)))
            ],
            "deck_level": round(float(np.exp(rng.uniform(np.log(0.05), np.log(0.3)))), 4),
            "peak_level": round(float(np.exp(rng.uniform(np.log(0.6), np.log(5.0)))), 3),
            "led_radius_m": round(float(rng.uniform(0.003, 0.005)), 5),
            "led_colour": [[1.0, 0.25, 0.2], [1.0, 0.95, 0.9], [0.35, 1.0, 0.45]][int(rng.integers(3))],
            "stand_off_m": [round(float(v), 4) for v in rng.uniform(0.002, 0.02, len(marks))],
        },
        "deck": {
            "colour": [round(float(v), 3) for v in rng.uniform(0.2, 0.7, 3)],
            "hull_colour": [round(float(v), 3) for v in rng.uniform(0.05, 0.6, 3)],
            "gloss": round(float(rng.uniform(0.12, 0.35)), 3),
            "beam_m": round(float(rng.uniform(0.36, 0.46)), 3),
            "bar_gloss": round(float(rng.uniform(0.05, 0.25)), 3),
            "bar_from_m": round(float(rng.uniform(-0.25, -0.05)), 3),
        },
        "water": {
            "z_m": round(depth + float(rng.uniform(0.12, 0.2)), 3),
            "height_m": round(float(np.exp(rng.uniform(np.log(0.0004), np.log(0.002)))), 5),
            "gloss": round(float(rng.uniform(0.02, 0.08)), 3),
            "seed": int(rng.integers(1 << 30)),
        },
        "rate_hz": RATES_HZ[number % len(RATES_HZ)],
        "codec": CODECS[number % len(CODECS)],
        "crf": int(rng.integers(17, 29)),
    }  # fmt: skip


def camera_of(case: dict[str, Any]) -> Camera:
    """The camera as it is."""
    said = case["camera"]
    place, at = np.array(said["place_m"]), np.array(said["look_at_m"])
    return Camera((960, 540), said["fx_px"], 479.5, 269.5, (said["k1"], 0.0, 0.0, 0.0, 0.0), looking(place, at), place)


def datum_of(case: dict[str, Any]) -> list[list[float]]:
    """Discs on the rails, tank_m."""
    return [[x, y, 0.0] for x in (-3.9, -2.5, -0.9) for y in (-0.95, 0.95)]


def motion_of(case: dict[str, Any], k: int) -> Any:
    """Motion of tow ``k`` at the frames' times, or None where it is unstable or its line falls slack."""
    hull = Hull(**case["hull"], speed_m_s=SPEED_M_S, mass_kg=MASS_KG)
    said = case["tows"][k]
    tow = Tow(SPEED_M_S, said["line_length_m"], said["tow_point_m"], said["tension_n"], line="surge")
    if not stability(hull, tow).stable:
        return None
    times = np.arange(round(DURATION_S * case["rate_hz"])) / case["rate_hz"]
    extra = None
    if case["planted"] == "swivel_friction":

        def extra(_t, _y, beta, v, r, alpha):
            turning = (v + tow.tow_point_m * r + SPEED_M_S * np.sin(beta)) / (
                tow.line_length_m * np.cos(alpha + beta)
            ) + r
            return 0.0 * turning, -FRICTION_N_M * np.tanh(turning / TURNED_RAD_S)

    motion = simulate_full(hull, tow, Start(y_cg_m=said["start_y_m"]), times, extra=extra)
    return motion if (motion["tension_n"] > 0.5).all() else None


def placed(motion: Any, body_m: Array, depth_m: Array) -> Array:
    """Points of the body (n, 2), at depths (n,), along a motion: (frames, n, 3) m in the tank; the post is its origin."""
    beta = motion["beta_rad"].to_numpy()[:, None]
    x, y = np.asarray(body_m, dtype=float).T
    ahead = motion["x_cg_m"].to_numpy()[:, None] + x * np.cos(beta) - y * np.sin(beta)
    aside = motion["y_cg_m"].to_numpy()[:, None] + x * np.sin(beta) + y * np.cos(beta)
    return np.stack([ahead, aside, np.broadcast_to(np.asarray(depth_m, dtype=float), ahead.shape)], axis=-1)


def marks_px(case: dict[str, Any], motion: Any) -> Array:
    """True pixel of every mark, (frames, marks, 2)."""
    marks = case["marks"]
    return camera_of(case).pixel(placed(motion, [m["body_m"] for m in marks], [m["depth_m"] for m in marks]))


def _inside(case: dict[str, Any], motion: Any) -> bool:
    camera = camera_of(case)
    seen = [marks_px(case, motion).reshape(-1, 2), camera.pixel(np.array(datum_of(case)))]
    return all(bool(((p > 15) & (p < np.array(camera.size_px) - 15)).all()) for p in seen)


def told(case: dict[str, Any], seed: int) -> list[str]:
    """run.toml of each tow: what was measured, not what is."""
    rng = np.random.default_rng([seed, case["number"], 1])
    camera, sd = camera_of(case), PRIORS
    k1 = case["camera"]["k1"] + (LENS_K1 if case["planted"] == "lens_distortion" else 0.0)
    deck = DECK_M if case["planted"] == "deck_height" else 0.0
    pull, line, speed = (float(z) for z in rng.normal(size=3))
    marks = [
        (rng.normal(0, sd["marker_place_sd_m"], 2), float(rng.normal(0, sd["marker_depth_sd_m"])))
        for _ in case["marks"]
    ]
    picked = camera.pixel(np.array(datum_of(case))) + rng.normal(0, PICK_SIGMA_PX, (len(datum_of(case)), 2))
    pages = []
    for k, tow in enumerate(case["tows"]):
        z = rng.normal(size=2)
        tension = tow["tension_n"] * (1 + sd["tension_common_sd_rel"] * pull) * (1 + sd["tension_sd_rel"] * z[0])
        lines = [
            f'name = "p{case["number"]:02d}-{k + 1}"\nkind = "tow"\n\n[source]\nvideo = "video.mp4"\n',
            f"[camera]\nimage_size_px = [960, 540]\nfx_px = {camera.fx_px}\nfy_px = {camera.fx_px}\ncx_px = 479.5\ncy_px = 269.5",
            f"distortion = [{k1:.4f}, 0.0, 0.0, 0.0, 0.0]\n",
        ]
        for i, (point, pixel) in enumerate(zip(datum_of(case), picked, strict=True)):
            lines.append(f'[[datum]]\nname = "d{i + 1}"\npixel_px = [{pixel[0]:.3f}, {pixel[1]:.3f}]\ntank_m = {point}')
            lines.append(f"sigma_px = {PICK_SIGMA_PX}\n")
        for mark, (place, depth) in zip(case["marks"], marks, strict=True):
            body = [round(float(a + b), 5) for a, b in zip(mark["body_m"], place, strict=True)]
            lines.append(
                f'[[marker]]\nname = "{mark["name"]}"\nbody_m = {body}\ndepth_m = {mark["depth_m"] + depth + deck:.5f}\n'
            )
        lines.append(
            f"[tow]\nspeed_m_s = {SPEED_M_S * (1 + sd['speed_sd_rel'] * speed):.5f}\n"
            f"line_length_m = {tow['line_length_m'] + sd['line_length_sd_m'] * line:.5f}\n"
            f"tow_point_m = {tow['tow_point_m'] + sd['tow_point_sd_m'] * z[1]:.5f}\npost_m = [0.0, 0.0]\n"
            f"tension_n = {tension:.5f}\n\n[model]\nlength_pp_m = {LENGTH_PP_M}\nmass_kg = {MASS_KG}\n\n"
            f"[water]\ndensity_kg_m3 = 1000.0\ntank_width_m = {TANK_WIDTH_M}\n\n[priors]"
        )
        lines += [f"{name} = {value}" for name, value in sd.items()]
        pages.append("\n".join(lines) + "\n")
    return pages


def truth_of(case: dict[str, Any]) -> dict[str, Any]:
    """The six at their speed, and what was planted."""
    return {"at_speed_m_s": SPEED_M_S, "planted": case["planted"]} | {
        name: case["hull"][name] for name in DERIVATIVE_UNITS
    }
