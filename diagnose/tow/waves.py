"""Forces that repeat across the tank or with the heading: at which wave number random forces would have to stand for them.

The free form ``placed`` has some wave numbers only, and a wave between two of them is neither. Here each of a fine grid is asked,
as ``pushes`` asks each time, and the hypothesis itself is fitted afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from ..inference.evidence import Fitted, Inference
from .beside import NOTABLE, beside_smaller, gains

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
    cost = float(np.log(sum(len(grid) for grid in GRIDS.values())))
    for beside in beside_smaller(inference, fitted):
        runs = [(beside.run(k), run.values) for k, run in enumerate(inference.simulator.runs)]
        for along, grid in GRIDS.items():
            # the same force in all runs
            found = [asked.scores(_courses(values[:, CHANNEL[along]], grid)) for asked, values in runs]
            pull, matrix, through = (np.sum(parts, axis=0) for parts in zip(*found, strict=True))
            gain = gains(pull, matrix, through) + beside.loss - cost
            at = int(np.argmax(gain))
            if gain[at] > best:
                best, chosen = float(gain[at]), [Wave(along, float(grid[at]), cost)]
    return chosen


def _courses(place: Array, grid: Array) -> Array:
    """(n, 2, waves): sine and cosine; where the place was not measured, nothing."""
    angle = 2 * np.pi * np.nan_to_num(place)[:, None] * grid
    return np.stack([np.sin(angle), np.cos(angle)], axis=1) * np.isfinite(place)[:, None, None]


__all__ = ["Wave", "waves"]
