"""The tow's response and its exact sensitivities to derivatives, start and tow, run by run.

The linear form is exact (``joint.linear``), the full one a Runge-Kutta of small step (``joint.full``); both take the one
equation of motion of ``simulate.model``.
"""

from __future__ import annotations

from ..simulate.model import Array
from .data import RunData
from .joint.full import full_paths
from .joint.linear import linear_paths
from .joint.parameters import (
    COUNT,
    LINE_LENGTH,
    RUN_PARAMETERS,
    SPEED,
    TENSION,
    TOW_POINT,
    hull_from,
    run_tow,
    side_from_y,
)


def linear_response(data: RunData, values: Array, reference_speed_m_s: float) -> tuple[Array, Array]:
    """(y, beta) at the run's samples by the exact matrix exponential, with analytic sensitivities.

    Parameters
    ----------
    data : one run
    values : (14,), ``RUN_PARAMETERS``; side = y m
    reference_speed_m_s : at which the derivatives are quoted, m/s

    Returns
    -------
    response : (n, 2)
    sensitivity : (n, 2, 14)
    """
    response, slope = linear_paths([data], values[None], reference_speed_m_s)[0]
    return response.T, slope.transpose(2, 0, 1)


def full_response(runs: list[RunData], values: Array, reference_speed_m_s: float) -> list[tuple[Array, Array]]:
    """(y, beta) of all runs by the full equations, with exact sensitivities.

    Parameters
    ----------
    runs : the runs, in their order
    values : (runs, 14), ``RUN_PARAMETERS``; side = alpha rad
    reference_speed_m_s : at which the derivatives are quoted, m/s

    Returns
    -------
    per run response (n, 2) and sensitivity (n, 2, 14)
    """
    answers, _ = full_paths(runs, values, reference_speed_m_s)
    return [(response.T, slope.transpose(2, 0, 1)) for response, slope in answers]


__all__ = [
    "COUNT",
    "LINE_LENGTH",
    "RUN_PARAMETERS",
    "SPEED",
    "TENSION",
    "TOW_POINT",
    "full_response",
    "hull_from",
    "linear_response",
    "run_tow",
    "side_from_y",
]
