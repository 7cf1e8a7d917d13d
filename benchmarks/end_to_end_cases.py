"""Random campaigns from hull to film: what reality is, and what the person in the hall believes of it.

Reality is the tow with surge in full (theory.md 10): the line keeps its length, its pull follows the model. What the hull does
along its way (X_udot, X_vr, X_vv, X_rr, the exponent of R) is drawn from what ``[priors.surge]`` takes for usual, which is all
that the person knows of it; a tow whose line would fall slack is drawn again.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from towline.record.scenario import ScenarioFile
from towline.simulate.model import DERIVATIVE_UNITS
from towline.simulate.render import render_scenario
from towline.simulate.scenario import read_scenario, scenario_stability, simulate_scenario

Rng = np.random.Generator
SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446" / "scenario.toml"
"""Its hull is the ITTC MARINER, thesis Table 8.2."""
SPEED_M_S = 1.28
"""Of every tow, at which the hulls' damping is drawn."""
PRIORS = {
    "tension_sd_rel": 0.005,
    "tow_point_sd_m": 0.0005,
    "tension_common_sd_rel": 0.003,
    "line_length_sd_m": 0.001,
    "speed_sd_rel": 0.002,
    "marker_depth_sd_m": 0.002,
    "marker_place_sd_m": 0.001,
}
"""What the person says of scale, tape measure and carriage; the errors are drawn from it."""
TOW_POINTS = 4
MASS_KG, LENGTH_M = 78.0, 2.66
ALONG = ("x_udot_kg", "x_vr_kg", "x_vv_kg_m", "x_rr_kg_m", "resistance_exponent")
KNOWN_SD = 1e-5
"""Of each of them where the true settings are put in; a standard deviation has to be above 0."""
PICTURES = (((800, 600), 920.0), ((1280, 720), 1150.0), ((960, 720), 1000.0))


def campaign(seed: int, duration_s: float | None = None, rate_hz: float | None = None) -> list[dict[str, Any]]:
    """Scenarios of one campaign, as scenario.toml holds them: one hull, one camera, four tow points.

    Parameters
    ----------
    duration_s : of each run; 30 to 45 s where absent
    rate_hz : of the frames; 25 or 30 where absent
    """
    rng = np.random.default_rng([seed, 0])
    sample = read_scenario(SAMPLE).hull
    while True:
        hull = {name: round(getattr(sample, name) * float(rng.uniform(0.85, 1.15)), 4) for name in DERIVATIVE_UNITS}
        hull |= _along(rng, hull["m_minus_y_vdot"])
        tows = _tows(rng)
        film, markers = _film(rng), _markers(rng)
        if film["codec"] != "ffv1":
            film |= _lossy(seed)
        time = {
            "duration_s": duration_s or round(float(rng.uniform(30, 45)), 1),
            "rate_hz": float(rng.choice([25.0, 30.0])),
        }
        if rate_hz is not None:
            time["rate_hz"] = rate_hz
        if duration_s is None and rng.random() < 0.3:
            begin = float(rng.uniform(5, 25))
            film["occlusion"] = [[round(begin, 2), round(begin + float(rng.uniform(0.3, 1.0)), 2), "bow"]]
        runs = [
            {
                "name": f"e{seed:03d}-{k + 1}",
                "seed": int(rng.integers(1 << 30)),
                "time": time,
                "hull": {"speed_m_s": SPEED_M_S, **hull},
                "tow": tow,
                "start": {"y_cg_m": round(float(rng.choice([-1, 1]) * rng.uniform(0.12, 0.2)), 3)},
                "model": {"length_pp_m": LENGTH_M, "mass_kg": MASS_KG},
                "water": {"density_kg_m3": 1000.0, "tank_width_m": 4.6},
                "marker": markers,
                "film": film,
            }
            for k, tow in enumerate(tows)
        ]
        verdicts = [scenario_stability(_scenario(run)) for run in runs]
        if all(v is not None and v.stable for v in verdicts) and all(_taut(_scenario(run)) for run in runs):
            return runs


def _along(rng: Rng, sway_mass_kg: float) -> dict[str, float]:
    """What the hull does along its way: within physical bounds (X_udot < 0 < X_vr < -Y_vdot), else the usual scatter."""
    usual = {
        "x_udot_kg": -MASS_KG * float(rng.uniform(0.02, 0.08)),
        "x_vr_kg": float(rng.uniform(0.0, sway_mass_kg - MASS_KG)),
        "x_vv_kg_m": MASS_KG / LENGTH_M * float(rng.normal(-0.4, 1.2)),
        "x_rr_kg_m": MASS_KG * LENGTH_M * float(rng.normal(0.0, 0.02)),
        "resistance_exponent": float(rng.normal(1.85, 0.1)),
    }
    return {name: round(value, 4) for name, value in usual.items()}


def _taut(file: ScenarioFile) -> bool:
    return bool((simulate_scenario(file, Path())["tension_n"] > 0.0).all())


def _scenario(run: dict[str, Any]) -> ScenarioFile:
    return ScenarioFile.model_validate_json(json.dumps(run))


def _tows(rng: Rng) -> list[dict[str, float]]:
    line, pull = round(float(rng.uniform(0.7, 1.1)), 3), float(rng.uniform(3.6, 4.4))
    points = np.linspace(1.45, 1.78, TOW_POINTS) + rng.uniform(-0.02, 0.02, TOW_POINTS)
    return [
        {
            "speed_m_s": SPEED_M_S,
            "line_length_m": line,
            "tow_point_m": round(float(x), 4),
            "tension_n": round(pull * float(1 + 0.01 * rng.normal()), 4),
        }
        for x in points
    ]


def _markers(rng: Rng) -> list[dict[str, Any]]:
    light = {"peak_dn": round(float(rng.uniform(120, 220)), 1), "width_px": round(float(rng.uniform(1.4, 2.3)), 2)}
    light["colour"] = str(rng.choice(["red", "white"]))
    depths = rng.uniform(0.08, 0.16, 3)
    made = [
        {
            "name": "bow",
            "body_m": [round(float(rng.uniform(1.1, 1.25)), 3), 0.0],
            "depth_m": round(float(depths[0]), 3),
        },
        {
            "name": "stern",
            "body_m": [round(float(rng.uniform(-1.2, -1.0)), 3), 0.0],
            "depth_m": round(float(depths[1]), 3),
        },
    ]
    if rng.random() < 0.3:
        made.append({"name": "middle", "body_m": [0.1, 0.05], "depth_m": round(float(depths[2]), 3)})
    return [m | light for m in made]


def _lossy(seed: int) -> dict[str, Any]:
    """How a camera writes a film that it does not write without loss; drawn apart, so that seeds keep their hulls and cameras."""
    rng = np.random.default_rng([seed, 2])
    codec = rng.choice(["h264", "hevc", "hevc10"], p=[0.5, 0.25, 0.25])
    return {"codec": str(codec), "crf": int(rng.integers(17, 29))}


def _film(rng: Rng) -> dict[str, Any]:
    (width, height), focal = PICTURES[int(rng.integers(len(PICTURES)))]
    focal *= float(rng.uniform(0.95, 1.05))
    corners = [(x, y) for x in (-0.55, -4.35) for y in (-1.2, 1.2)]
    datum = [
        {"name": f"p{k + 1}", "tank_m": [x, y, depth]}
        for k, (x, y, depth) in enumerate((x, y, d) for d in (0.0, 0.25) for x, y in corners)
    ]
    lossless = rng.random() < 0.1
    return {
        "camera": {
            "image_size_px": [width, height],
            "fx_px": round(focal, 2),
            "fy_px": round(focal, 2),
            "cx_px": (width - 1) / 2,
            "cy_px": (height - 1) / 2,
            "distortion": [round(float(rng.uniform(-0.1, 0.02)), 4), 0.0, 0.0, 0.0, 0.0],
        },
        "pose": {
            "place_m": [round(float(v), 3) for v in (rng.uniform(-7.6, -6.9), rng.uniform(-0.5, 0.5), rng.uniform(-4.0, -3.2))],
            "look_at_m": [-2.5, round(float(rng.uniform(-0.1, 0.1)), 3), 0.15],
        },
        "datum": datum,
        "pick_sigma_px": 0.15,
        "exposure": round(float(rng.uniform(0.7, 1.15)), 3),
        "read_noise_dn": round(float(rng.uniform(0.8, 3.0)), 2),
        "codec": "ffv1" if lossless else "h264",
        "crf": int(rng.integers(17, 26)),
        "ripple": round(float(rng.uniform(0.3, 1.5)), 2),
        "reflection": round(float(rng.uniform(0.0, 0.5)), 2),
        "hull_length_m": 2.8,
    }  # fmt: skip


def filmed(
    folder: Path, runs: list[dict[str, Any]], seed: int, progress: Callable[[int, int], None] | None = None
) -> list[Path]:
    """Render the runs; their run.toml then says what was measured, not what is."""
    rng = np.random.default_rng([seed, 1])
    common = {
        "tension": 1 + PRIORS["tension_common_sd_rel"] * rng.normal(),
        "line": PRIORS["line_length_sd_m"] * rng.normal(),
        "speed": 1 + PRIORS["speed_sd_rel"] * rng.normal(),
    }
    marks = [
        (rng.normal(0, PRIORS["marker_place_sd_m"], 2), rng.normal(0, PRIORS["marker_depth_sd_m"]))
        for _ in runs[0]["marker"]
    ]
    made = []
    for run in runs:
        here = folder / run["name"]
        # drawn for runs that stand already, too: the next one's errors are the same
        pull, place = (float(z) for z in rng.normal(size=2))
        if not is_told(here / "run.toml"):
            render_scenario(_scenario(run), folder, here, progress)
            _believed(here / "run.toml", common, marks, pull, place, run["hull"])
        made.append(here)
    return made


def is_told(path: Path) -> bool:
    """The run stands, and its run.toml says what was measured: one that was stopped before is made again."""
    return path.is_file() and "[priors]" in path.read_text(encoding="utf-8")


def _believed(
    path: Path, common: dict[str, float], marks: list[Any], pull: float, place: float, hull: dict[str, float]
) -> None:
    told: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    tow = told["tow"]
    known = {name: {"value": hull[name], "std": KNOWN_SD} for name in ALONG}
    true = tomlkit.parse(path.read_text(encoding="utf-8"))
    true["priors"] = {"surge": known}
    (path.parent / "truth" / "run.toml").write_text(tomlkit.dumps(true), encoding="utf-8")
    tow["tension_n"] = round(tow["tension_n"] * common["tension"] * (1 + PRIORS["tension_sd_rel"] * pull), 5)
    tow["tow_point_m"] = round(tow["tow_point_m"] + PRIORS["tow_point_sd_m"] * place, 5)
    tow["line_length_m"] = round(tow["line_length_m"] + common["line"], 5)
    tow["speed_m_s"] = round(tow["speed_m_s"] * common["speed"], 5)
    for marker, (body, depth) in zip(told["marker"], marks, strict=True):
        marker["body_m"] = [round(float(a + b), 5) for a, b in zip(marker["body_m"], body, strict=True)]
        marker["depth_m"] = round(float(marker["depth_m"] + depth), 5)
    told["priors"] = PRIORS
    path.write_text(tomlkit.dumps(told), encoding="utf-8")


__all__ = ["PRIORS", "campaign", "filmed", "is_told"]
