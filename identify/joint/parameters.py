"""What one run's response depends on, in one order.

Parameters of a run (``RUN_PARAMETERS``): the six derivatives, the start (side, beta, v, r), T, X_T, L, U; then what the full form
knows beside: the model along its way (theory.md 10), rudder and asymmetry. The side is y for the linear form and alpha for the
full one; T of a line that keeps its length is R.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...simulate.model import DERIVATIVE_UNITS, Array, Hull, Tow, alpha_from_y
from ..data import RunData

ALONG = ("x_udot_kg", "x_vr_kg", "x_vv_kg_m", "x_rr_kg_m", "resistance_exponent")
"""Numbers of the model along its way, as ``Hull`` and [priors.surge] call them."""
ACROSS = ("y_delta", "n_delta", "y_bias_n", "n_bias_n_m")
"""Constant forces, as ``Hull`` and [priors.derivatives] call them."""
BOTH_FORMS = (*DERIVATIVE_UNITS, "side", "beta", "v", "r", "tension", "tow_point", "line_length", "speed")
RUN_PARAMETERS = (*BOTH_FORMS, *ALONG, *ACROSS)
COUNT = len(RUN_PARAMETERS)
LINEAR_COUNT = len(BOTH_FORMS)
TENSION, TOW_POINT, LINE_LENGTH, SPEED = range(10, 14)
"""Places of the tow in a run's parameter vector: after the six derivatives and the start (y, beta, v, r)."""
X_UDOT, X_VR, X_VV, X_RR, EXPONENT, Y_DELTA, N_DELTA, Y_BIAS, N_BIAS = range(LINEAR_COUNT, COUNT)
"""Places in a run's parameter vector."""
EVERY = tuple(range(LINEAR_COUNT))
"""What the linear form depends on."""
STEEPEST_RAD = np.radians(80.0)
"""Largest line angle of a start, ten degrees short of broadside, where the equations end."""


def run_tow(tow: Tow, values: Array) -> Tow:
    """The tow with T, X_T, L and U of a run's parameter vector (``COUNT``,).

    Parameters
    ----------
    tow : T, X_T, L, U of the tow
    values : (COUNT,) of a run, or six
    """
    return replace(
        tow,
        tension_n=values[TENSION],
        tow_point_m=values[TOW_POINT],
        line_length_m=values[LINE_LENGTH],
        speed_m_s=values[SPEED],
    )


def hull_from(values: Array, speed_m_s: float, mass_kg: Any = None) -> Hull:
    """A hull from a parameter vector (six or ``COUNT`` long), real or complex, quoted at ``speed_m_s``.

    Parameters
    ----------
    values : (COUNT,) of a run, or six
    speed_m_s : at which the derivatives are quoted
    mass_kg : or None
    """
    rest = dict(zip((*ALONG, *ACROSS), values[LINEAR_COUNT:COUNT], strict=True)) if len(values) > LINEAR_COUNT else {}
    return Hull(*values[:6], speed_m_s=speed_m_s, mass_kg=mass_kg, **rest)


def side_from_y(form: str, data: RunData, y_m: float, beta_rad: float) -> float:
    """The start's side parameter: y itself, or the tow line angle that puts the model there (at most 80 degrees).

    Parameters
    ----------
    form : "full" or "linear"
    data : one run
    y_m : y_CG, m
    beta_rad : heading, rad
    """
    if form == "linear":
        return y_m
    post_y, _ = data.tow.post_motion(float(data.t_s[0]))
    alpha = float(alpha_from_y(y_m, beta_rad, data.tow, post_y))
    reach = y_m + data.tow.tow_point_m * np.sin(beta_rad)
    if not np.isfinite(alpha):
        return float(np.sign(reach) * STEEPEST_RAD)
    return float(np.clip(alpha, -STEEPEST_RAD, STEEPEST_RAD))
