"""The valid files that are damaged: run.toml and the other descriptions, tables, other programs' tracks, results."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
from pydantic import BaseModel

RUN = """\
name = "t"
kind = "tow"
notes = ""

[source]
tracks = "tracks.csv"
span_s = [0.0, 9.0]

[camera]
image_size_px = [1280, 720]
fx_px = 1100.0
fy_px = 1100.0
cx_px = 639.5
cy_px = 359.5
distortion = [-0.05, 0.0, 0.0, 0.0, 0.0]

[[datum]]
name = "a"
pixel_px = [402.1, 120.5]
tank_m = [0.0, -0.7, 0.0]

[[datum]]
name = "b"
pixel_px = [877.9, 120.5]
tank_m = [0.0, 0.7, 0.0]
look = "mark"

[[datum]]
name = "c"
pixel_px = [100.0, 600.0]
tank_m = [-3.0, -0.7, 0.0]

[[datum]]
name = "d"
pixel_px = [1180.0, 600.0]
tank_m = [-3.0, 0.7, 0.0]

[[marker]]
name = "bow"
body_m = [1.2, 0.0]
depth_m = 0.1
look = "led"
seen_at_px = [612.0, 402.0]

[[marker]]
name = "stern"
body_m = [-1.1, 0.0]
depth_m = 0.1

[tow]
speed_m_s = 1.28
line_length_m = 0.91
tow_point_m = 1.548
tension = "tension.csv"
tension_delay_s = 0.1

[model]
length_pp_m = 2.66
mass_kg = 78.0

[water]
density_kg_m3 = 1000.0

[priors]
tension_sd_rel = 0.01

[priors.derivatives.y_v]
value = -52.0
std = 3.0
"""
PLAN = """\
[tank]
length_m = 77.0
lost_m = 17.0
width_m = 4.6
speeds_m_s = [0.5, 1.28]

[model]
length_pp_m = 2.66
mass_kg = 78.0

[guess.dimensional]
speed_m_s = 1.28
m_minus_y_vdot = 149.19
i_minus_n_rdot = 62.11
y_v = -52.87
y_r_minus_mu = -66.33
n_v = -48.51
n_r = -57.60

[choices]
tension_n = 3.96
tension_speed_m_s = 1.28
tow_points_m = [1.243, 1.344]

[wish]
percent = 1.5

[[run]]
tow_point_m = 1.446
line_length_m = 0.91
speed_m_s = 1.28
release_y_m = 0.15
"""
SETUP = """\
[tow]
line_length_m = 0.91

[bar]
lcg_m = 0.0421
station_m = 1.099
hole = 8

[[clock]]
name = "logger"
events_s = [[1.0, 1.1], [9.0, 9.1]]

[[channel]]
name = "y1"
measures = "y"
hole = 1
sd = 0.001

[[channel]]
name = "y2"
measures = "y"
hole = 21
sd = 0.001

[[channel]]
name = "p2"
measures = "alpha_beta"
clock = "logger"
sd = 0.01
time = "t_log"
"""
PRIORS = "tension_sd_rel = 0.01\ny_bias_sd_m = 0.01\n\n[derivatives.y_v]\nvalue = -52.0\nstd = 3.0\n"
SCENARIO = """\
name = "s"
kind = "tow"
seed = 3

[time]
duration_s = 4.0
rate_hz = 10.0

[hull]
speed_m_s = 1.28
m_minus_y_vdot = 149.19
i_minus_n_rdot = 62.11
y_v = -52.87
y_r_minus_mu = -66.33
n_v = -48.51
n_r = -57.60

[tow]
speed_m_s = 1.28
line_length_m = 0.91
tow_point_m = 1.446
tension_n = 3.96

[[effect]]
name = "crossflow_drag"

[effect.numbers]
y_vv = -100.0

[start]
y_cg_m = 0.2

[model]
length_pp_m = 2.66
mass_kg = 78.0
"""
T_S = np.round(np.arange(30) / 10, 3)
Y_M, BETA_RAD = np.round(0.2 * np.cos(T_S), 6), np.round(0.1 * np.sin(T_S), 6)
TRACK_HEAD = ("frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status")
TRACK_ROWS = [
    (k, t, name, 600 + 10 * k, 300 + place, 0.1, 0.1, "measured")
    for k, t in enumerate(T_S[:6])
    for name, place in (("bow", 0.5), ("stern", 90.25))
]
MOTION_HEAD = ("t_s", "y_cg_m", "beta_rad", "alpha_rad", "status")
MOTION_ROWS = [(t, y, b, 0.1, "measured") for t, y, b in list(zip(T_S, Y_M, BETA_RAD, strict=True))[:8]]
HISTORY_ROWS = [(t, 3.96) for t in T_S[:8]]
CHANNEL_HEAD = ("t_s", "y1", "y2", "t_log", "p2")
CHANNEL_ROWS = [
    (t, round(y + 1.446 * np.sin(b), 6), round(y - 0.43 * np.sin(b), 6), t, round(b + np.arcsin(y / 0.91), 6))
    for t, y, b in zip(T_S, Y_M, BETA_RAD, strict=True)
]
TRACKPY_HEAD = ("frame", "particle", "y", "x", "ep")
TRACKPY_ROWS = [(k, p, 300.5 + k, 600.25 + 90 * p, 0.03) for k in range(6) for p in (3, 4)]
DLTDV_HEAD = ("pt1_cam1_X", "pt1_cam1_Y", "pt2_cam1_X", "pt2_cam1_Y")
DLTDV_ROWS = [(601 + k, 400.5, 501 + k, 410.5) for k in range(5)] + [("NaN", "NaN", 506, 410.5)]
KINOVEA_CSV = (
    "Time (ms);Trajectory 1/0/X;Trajectory 1/0/Y;Trajectory 2/0/X;Trajectory 2/0/Y\n"
    "0;10,5;20;30;40\n40;11,5;21;31;41\n80;12;22;32;42\n"
)
KINOVEA_TXT = "#Kinovea Trajectory data export\n#T X Y\n0 10.5 20.0\n40 11.5 21.0\n80 12 22\n\n#bow\n0 1 2\n40 3 4\n"
KINOVEA_CODE = "Time,a X,a Y\n0:00:00:00,10,20\n0:00:00:04,11,21\n0:00:00:08,12,22\n"
KINOVEA_KVA = """\
<?xml version="1.0" encoding="utf-8"?>
<KinoveaVideoAnalysis>
  <AverageTimeStampsPerFrame>512</AverageTimeStampsPerFrame>
  <FirstTimeStamp>0</FirstTimeStamp>
  <CaptureFramerate>25</CaptureFramerate>
  <Tracks>
    <Track name="bow"><TrackPointList><TrackPoint>10;20;0</TrackPoint><TrackPoint>11;21;512</TrackPoint></TrackPointList></Track>
    <Track><MainLabel Text="stern"/><TrackPointList><TrackPoint>30;40;512</TrackPoint></TrackPointList></Track>
  </Tracks>
</KinoveaVideoAnalysis>
"""
TRACKER = "mass_A\t\t\tmass_B\nt\tx\ty\tx\ty\n0.00\t10.5\t20\t30\t40\n0.04\t11.5\t21\t31\t41\n0.08\t12\t22\t\t\n"
REFERENCE = (
    "# a set\nname,value,std\nm_minus_y_vdot,0.0159,0.001\ni_minus_n_rdot,0.00093,0\ny_v,-0.0117,0\n"
    "y_r_minus_mu,-0.0055,0\nn_v,-0.004,0\nn_r,-0.0018,0\n"
)


def tree_of(text: str) -> dict[str, Any]:
    """A TOML text as a tree."""
    return tomllib.loads(text)


def example_of(model: type[BaseModel]) -> dict[str, Any]:
    """The smallest content that a result file's schema takes, with one item in every list and mapping."""
    whole = model.model_json_schema()

    def made(part: dict[str, Any]) -> Any:
        if "$ref" in part:
            return made(whole["$defs"][part["$ref"].rpartition("/")[2]])
        if "const" in part or "enum" in part:
            return part.get("const", part.get("enum", [None])[0])
        if "anyOf" in part:
            return made(part["anyOf"][0])
        match part.get("type"):
            case "object" if "properties" in part:
                return {key: made(inner) for key, inner in part["properties"].items()}
            case "object":
                return (
                    {"a": made(part["additionalProperties"])}
                    if isinstance(part.get("additionalProperties"), dict)
                    else {}
                )
            case "array" if "prefixItems" in part:
                return [made(inner) for inner in part["prefixItems"]]
            case "array":
                return [made(part["items"])] if "items" in part else []
            case kind:
                return {"number": 1.5, "integer": 1, "boolean": True, "string": "a"}.get(str(kind))

    return made(whole)


def lens_example(model: type[BaseModel]) -> dict[str, Any]:
    """``example_of`` lens.json, with a covariance that can be one."""
    tree = example_of(model)
    tree["image_size_px"] = [1280, 720]
    tree["covariance"] = np.diag(np.r_[np.ones(4), np.full(5, 1e-6)]).tolist()
    return tree
