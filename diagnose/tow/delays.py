"""Load cells whose clock is off in each run by another time, or from a time on: found where record and motion disagree.

The pull of a line that keeps its length follows from the measured motion at once; what the cell says of it earlier or later is
compared with that, run by run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...simulate.model import Array
from ..effects import Effect, delayed_each, delayed_since
from ..effects.base import share_since
from .channels import PULL
from .tow_run import TowRun

LEAST_BLOCKS = 20
"""Means that a run must have for it ..."""
LEAST_SIDE = 8
"""... and to either side of a jump."""
FOUND_COST = 3.0
"""Log evidence that a time found beforehand costs: a choice."""
FINER = 4
"""Parts of a block to which a jump's time is sought; the fit goes on from there."""
TURNS = 3
"""Steps to the delay: the pull bends between here and there."""


def delay_effects(runs: Sequence[TowRun], node_s: Array, pull_n: Array) -> list[Effect]:
    """The delay of each run's load cell, and the likeliest time since when all are late by another one.

    Parameters
    ----------
    runs : as the diagnosis sees them
    node_s : (nodes,) times
    pull_n : (nodes, runs) what the lines pull with, by the measured motion
    """
    celled = [i for i, run in enumerate(runs) if run.celled and _good(run).sum() >= LEAST_BLOCKS]
    if not celled:
        return []
    each = {i: _late(runs[i], node_s, pull_n[:, i], None)[1] for i in celled}
    step_s = runs[celled[0]].step_s

    def left(since_s: float) -> float:
        return sum(_late(runs[i], node_s, pull_n[:, i], since_s)[0] for i in celled)

    said_s = np.concatenate([runs[i].cell_s[_good(runs[i])] for i in celled])
    about = min(np.arange(said_s.min(), said_s.max(), step_s), key=left)
    since = min(about + step_s * np.arange(-FINER, FINER + 1) / FINER, key=left)
    found = [delayed_since(float(since), step_s, FOUND_COST)]
    if len(celled) > 1:
        found.append(delayed_each({runs[i].name: float(late[0]) for i, late in each.items()}, FOUND_COST * len(celled)))
    return found


def _good(run: TowRun) -> Array:
    return np.isfinite(run.values[:, PULL])


def _late(run: TowRun, node_s: Array, pull_n: Array, since_s: float | None) -> tuple[float, Array]:
    """What remains of the squares, in the noise's, and by how much the cell is late before and since a time (or throughout)."""
    good = _good(run)
    t_s, said = run.cell_s[good], run.values[good, PULL]
    after = None if since_s is None else share_since(t_s, since_s, run.step_s)
    parts = [np.ones_like(t_s)] if after is None else [1.0 - after, after]
    if min(part.sum() for part in parts) < LEAST_SIDE:
        parts = [np.ones_like(t_s)]
    course, late = np.array(parts), np.zeros(len(parts))
    rate = np.gradient(pull_n, node_s)
    left = said
    for _ in range(TURNS):
        at = t_s + late @ course
        # the cell's scale and zero, and the resistance, are free
        rows = np.column_stack(
            [np.ones_like(t_s), np.interp(at, node_s, pull_n), *(course * np.interp(at, node_s, rate))]
        )
        numbers, *_ = np.linalg.lstsq(rows, said, rcond=None)
        left, late = said - rows @ numbers, late + numbers[2:] / max(numbers[1], 0.1)
    return float(left @ left) / run.usual_sd(PULL) ** 2, late


__all__ = ["delay_effects"]
