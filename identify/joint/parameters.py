"""What one run's response depends on, in one order.

Parameters of a run (``RUN_PARAMETERS``): the six derivatives, the start (side, beta, v, r), T, X_T, L, U.
The side is y for the linear form and alpha for the full one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...simulate.model import DERIVATIVE_UNITS, Array, Hull, Tow, alpha_from_y
from ..data import RunData

RUN_PARAMETERS = (*DERIVATIVE_UNITS, "side", "beta", "v", "r", "tension", "tow_point", "line_length", "speed")
COUNT = len(RUN_PARAMETERS)
TENSION, TOW_POINT, LINE_LENGTH, SPEED = range(10, 14)
"""Places in a run's parameter vector."""
EVERY = tuple(range(COUNT))
STEEPEST_RAD = np.radians(80.0)


def run_tow(tow: Tow, values: Array) -> Tow:
    """The tow with T, X_T, L and U of a run's parameter vector (14,)."""
    return replace(
        tow,
        tension_n=values[TENSION],
        tow_point_m=values[TOW_POINT],
        line_length_m=values[LINE_LENGTH],
        speed_m_s=values[SPEED],
    )


def hull_from(values: Array, speed_m_s: float) -> Hull:
    """A hull from the first six of a parameter vector, real or complex, quoted at ``speed_m_s``."""
    return Hull(*values[:6], speed_m_s=speed_m_s)


def side_from_y(form: str, data: RunData, y_m: float, beta_rad: float) -> float:
    """The start's side parameter: y itself, or the tow line angle that puts the model there (at most 80 degrees)."""
    if form == "linear":
        return y_m
    post_y, _ = data.tow.post_motion(float(data.t_s[0]))
    alpha = float(alpha_from_y(y_m, beta_rad, data.tow, post_y))
    reach = y_m + data.tow.tow_point_m * np.sin(beta_rad)
    if not np.isfinite(alpha):
        return float(np.sign(reach) * STEEPEST_RAD)
    return float(np.clip(alpha, -STEEPEST_RAD, STEEPEST_RAD))
