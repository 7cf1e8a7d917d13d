"""The hulls and the tank that the campaigns are drawn from."""

from __future__ import annotations

FREE = ("m", "i", "y_v", "y_r", "n_v", "n_r")
"""m-Y_vdot kg, I-N_rdot kg m2, Y_v N s/m, Y_r-mU N s, N_v N s, N_r N m s."""

MARINER = {
    "m": 149.19,
    "i": 62.11,
    "y_v": -52.87,
    "y_r": -66.33,
    "n_v": -48.51,
    "n_r": -57.60,
    "speed_ref": 1.28,
    "length_pp": 2.66,
    "mass": 78.0,
    "surge_mass": 82.0,
    "x_vr": 0.0,
    "x_vv": 0.0,
    "x_rr": 0.0,
    "power": 1.85,
    "stiffness_n_m": 20000.0,
    "line_damping": 0.15,
    "tension": 3.96,
    "line": 0.91,
    "marker_bow": 1.30,
    "marker_stern": -1.10,
    "density": 1000.0,
    "tank_width": 4.6,
}
"""The thesis's hull (theory.md 3)."""

FRIGATE = {
    "m": 61.0,
    "i": 14.2,
    "y_v": -32.5,
    "y_r": -25.5,
    "n_v": -17.5,
    "n_r": -16.6,
    "speed_ref": 1.10,
    "length_pp": 2.00,
    "mass": 33.0,
    "surge_mass": 34.5,
    "x_vr": 0.0,
    "x_vv": 0.0,
    "x_rr": 0.0,
    "power": 1.9,
    "stiffness_n_m": 20000.0,
    "line_damping": 0.15,
    "tension": 1.90,
    "line": 0.75,
    "marker_bow": 0.95,
    "marker_stern": -0.85,
    "density": 1000.0,
    "tank_width": 3.7,
}
"""A finer hull of 2 m: steadier on its course, with more drag sideways for its mass."""

HULLS = {"mariner": MARINER, "frigate": FRIGATE}
