"""The run that would determine what the records leave open: predicted from the Fisher information of runs not yet made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..data import RunData
from ..fit import Fit
from ..joint.linear import linear_paths
from .bound import information, information_of_six
from .combinations import UNDETERMINED_SHARE

RELEASED_M = 0.15
"""Release of a proposed run, to the side: a choice; information goes with its square."""
MOVES_M = (0.0, 0.1, -0.1, 0.2, -0.2, 0.4, -0.4)
"""Tow points tried: moved by so much from a run's own; 0 = the same point, with its release in the record."""
WIDEST_SHARE = 0.8
"""A run that swings wider than this share of the line's length is not proposed."""


@dataclass(frozen=True)
class Cure:
    """A proposed run.

    Attributes
    ----------
    tow_point_m, move_m : its tow point, and how far that is from the run ``beside``
    beside : name of the run it is like
    sd : (6,) predicted standard deviations of the six, all runs together
    """

    tow_point_m: float
    move_m: float
    beside: str
    sd: Array


def cure(fit: Fit, six: Array, covariance: Array, runs: list[RunData]) -> list[Cure]:
    """Proposed runs that would determine all six: the best one that holds a release at the same tow point, the nearest
    tow point that does it; best first, empty where none of those tried would.

    Parameters
    ----------
    fit : with the residuals' scatter
    six, covariance : (6,) and (6, 6), what is known now
    runs : the runs, in their order
    """
    size = np.abs(six)
    known = np.linalg.inv(covariance / size[:, None] / size[None, :])
    found: list[Cure] = []
    run = runs[int(np.argmax([len(d.t_s) for d in runs]))]
    scale = fit.scale[runs.index(run)]
    for move in MOVES_M:
        trial = released_run(run, six, fit.speed_m_s, move, scale)
        if trial is None:
            continue
        try:
            more = information_of_six(*information([trial], six, "linear", fit.speed_m_s))
        except (EstimationError, np.linalg.LinAlgError):
            continue
        together = np.linalg.inv(known + more * size[:, None] * size[None, :])
        sd = np.sqrt(np.maximum(np.diag(together), 0.0)) * size
        if (sd < UNDETERMINED_SHARE * size).all():
            found.append(Cure(trial.tow.tow_point_m, move, run.name, sd))
    same = [c for c in found if c.move_m == 0.0]
    moved = [c for c in found if c.move_m != 0.0]
    return (moved[:1] + same[:1]) if moved else same[:1]


def released_run(run: RunData, six: Array, speed_m_s: float, move_m: float, scale: Array) -> RunData | None:
    """Simulate a run that was not made: like ``run``, but from a release at rest, with its tow point moved.

    Parameters
    ----------
    run : the run it is like: line, speed, tension, sampling and noise
    six : (6,) derivatives, in the order of ``DERIVATIVE_UNITS``
    speed_m_s : at which they are quoted
    move_m : how far forward of the run's own the tow point stands
    scale : (2,) residual scatter of y and beta over their stated sigma

    Returns
    -------
    made : motion of the linear form, RELEASED_M to the side at first, without noise; its covariance is the run's median one times
        the scatter. None where the tow point stands aft of the neutral point X_v or of the centre of gravity, and where the run
        would swing wider than WIDEST_SHARE of its line
    """
    point = run.tow.tow_point_m + move_m
    if point <= 0 or six[4] / six[2] >= point:
        return None
    step = float(np.median(np.diff(run.t_s)))
    times = np.arange(len(run.t_s)) * step
    covariance = np.median(run.covariance, axis=0) * scale[:, None] * scale[None, :]
    tow = replace(run.tow, tow_point_m=point, post_amplitude_m=0.0)
    made = replace(
        run,
        t_s=times,
        covariance=np.tile(covariance, (len(times), 1, 1)),
        common=np.zeros((0, len(times), 2)),
        tow=tow,
        tension=None,
        speed=None,
        y_m=np.zeros(len(times)),
        beta_rad=np.zeros(len(times)),
    )
    values = np.array([[*six, RELEASED_M, 0, 0, 0, tow.tension_n, point, tow.line_length_m, tow.speed_m_s]])
    motion, _ = linear_paths([made], values, speed_m_s, ())[0]
    if not np.isfinite(motion).all() or np.abs(motion[0]).max() > WIDEST_SHARE * tow.line_length_m:
        return None
    return replace(made, y_m=motion[0], beta_rad=motion[1])
