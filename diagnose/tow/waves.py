"""Forces that repeat across the tank or with the heading: at which wave number random forces would have to stand for them.

The free form ``placed`` has some wave numbers only, and a wave between two of them is neither. Here each of a fine grid is asked,
as ``pushes`` asks each time, and the hypothesis itself is fitted afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ...simulate.model import Array
from ..inference.evidence import Fitted, Inference, Solved
from ..inference.noise import TIMES_S, Forces, force_colour
from .pushes import NOTABLE, SHARES, gains, left_to_it

GRIDS = {"y": np.arange(1.0, 20.01, 0.25), "b": np.arange(2.0, 20.01, 0.5)}
"""Waves to a metre across the tank, and to a radian of heading: a run spans a metre or half a radian at most, so that no peak is
missed."""
CHANNEL = {"y": 0, "b": 1}
"""Of the measured motion: where each is."""


@dataclass(frozen=True)
class Wave:
    """A force that repeats.

    Attributes
    ----------
    along : "y" or "b"
    per_unit : waves to a metre, or to a radian
    cost : log of how many were looked at
    """

    along: str
    per_unit: float
    cost: float


def waves(inference: Inference, fitted: Fitted) -> list[Wave]:
    """The best wave beside which smaller random forces explain the runs better; none where none does.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    best, chosen = NOTABLE, list[Wave]()
    alone = inference.solve(fitted.grams, fitted.hypothesis, fitted.forces).log_evidence
    cost = float(np.log(sum(len(grid) for grid in GRIDS.values())))
    for share in SHARES:
        forces = fitted.forces.scaled(share)
        solved = inference.solve(fitted.grams, fitted.hypothesis, forces)
        for along, grid in GRIDS.items():
            gain = _gain(inference, fitted, forces, solved, along, grid) + solved.log_evidence - alone - cost
            at = int(np.argmax(gain))
            if gain[at] > best:
                best, chosen = float(gain[at]), [Wave(along, float(grid[at]), cost)]
    return chosen


def _gain(inference: Inference, fitted: Fitted, forces: Forces, solved: Solved, along: str, grid: Array) -> Array:
    """(waves,) log evidence of a side force and a moment that go with sine and cosine, the same in all runs, against nothing."""
    matrix, pull, through = 0.0, 0.0, 0.0
    for run, measured in enumerate(inference.simulator.runs):
        white = _whitened(inference, forces, run, measured.values[:, CHANNEL[along]], grid)
        rest = inference.left(fitted.linear, forces, solved.shared, solved.own[run], run)
        slopes = inference.noise.whitened(run, forces, [fitted.linear.columns.tables[run][:, :, 1:]])[0]
        taken, own = left_to_it(solved, run, white, slopes)
        matrix, pull, through = matrix + own, pull + white @ rest, through + taken
    through = np.asarray(through)
    return gains(np.asarray(matrix) - through @ through.swapaxes(1, 2), np.asarray(pull))


def _whitened(inference: Inference, forces: Forces, run: int, place: Array, grid: Array) -> Array:
    """(waves, 4, N) what they do in a run, whitened; where the place was not measured, nothing."""
    noise, count = inference.noise, len(place)
    step_s = inference.simulator.step_s
    angle = 2 * np.pi * np.nan_to_num(place)[:, None] * grid
    courses = np.concatenate([np.sin(angle), np.cos(angle)], axis=1) * np.isfinite(place)[:, None]
    lag_s = step_s * np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    even = solve_triangular(force_colour(TIMES_S[forces.time], lag_s), courses, lower=True)
    moving, channels = noise.measured[run].moving, noise.runs[run].good.shape[1]
    values = np.zeros((count, channels, 2, 2 * len(grid)))
    for kind, root in enumerate(noise.measured[run].roots(forces.time)):
        values[:, :moving, kind] = (root @ even).reshape(moving, count, -1).swapaxes(0, 1)
    white = noise.whitened(run, forces, [values])[0]
    return white.reshape(len(white), 4, len(grid)).transpose(2, 1, 0)


__all__ = ["Wave", "waves"]
