"""One-off pushes: what random forces must do once, and far harder than they ever do elsewhere.

Random forces follow any push, and what they leave has nothing of it (``inference.scan`` looks there). Here it is asked whether
pushes at some times, with smaller random forces beside them, explain the runs better; the hypothesis itself is fitted afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from ...simulate.model import Array
from ..inference.evidence import Fitted, Inference
from .beside import NOTABLE, Asked, beside_smaller, gains

LASTS = (2, 5, 12)
"""Blocks that a push may last: a shorter one moves a model by its impulse alone, a longer one is a force of some course."""


@dataclass(frozen=True)
class Push:
    """One push in one run.

    Attributes
    ----------
    run : index
    begin_s, end_s : in the run's own time
    cost : log of how many stretches were looked at
    """

    run: int
    begin_s: float
    end_s: float
    cost: float


@dataclass(frozen=True)
class _Found:
    """A push with what its run says of it.

    Attributes
    ----------
    push : where
    gain : log evidence of it alone
    pull, matrix, through : of ``Asked.scores``
    """

    push: Push
    gain: float
    pull: Array
    matrix: Array
    through: Array


def pushes(inference: Inference, fitted: Fitted) -> list[Push]:
    """The pushes, at most one of a run, beside which smaller random forces explain the runs better; none where they do not.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    best, chosen = NOTABLE, list[Push]()
    for beside in beside_smaller(inference, fitted):
        every = [_best_of(beside.run(run)) for run in range(len(inference.simulator.runs))]
        order = sorted((found for found in every if found is not None), key=lambda found: -found.gain)
        for count in range(1, len(order) + 1):
            gain = _together(order[:count]) + beside.loss
            if gain > best:
                best, chosen = gain, [found.push for found in order[:count]]
    return sorted(chosen, key=lambda push: push.run)


def _together(found: Sequence[_Found]) -> float:
    """Log evidence of some pushes against none, what looking costs taken off."""
    pull, through = (np.concatenate(parts)[None] for parts in zip(*((f.pull, f.through) for f in found), strict=True))
    matrix: Array = np.asarray(block_diag(*(one.matrix for one in found)))
    gain = gains(pull, matrix[None], through)
    return float(gain[0]) - sum(one.push.cost for one in found)


def _best_of(asked: Asked) -> _Found | None:
    """The best push of a run, if it gains more than looking everywhere costs."""
    count, step_s = len(asked.colour), asked.beside.inference.simulator.step_s
    lasts = [blocks for blocks in LASTS if blocks < count]
    cost, best = float(np.log(sum(count - blocks + 1 for blocks in lasts))) if lasts else 0.0, None
    for blocks in lasts:
        pull, matrix, through = asked.scores(_courses(count, blocks)[:, None])
        gain = gains(pull, matrix, through)
        at = int(np.argmax(gain))
        if gain[at] > (cost if best is None else best.gain):
            push = Push(asked.run, at * step_s, (at + blocks) * step_s, cost)
            best = _Found(push, float(gain[at]), pull[at], matrix[at], through[at])
    return best


def _courses(count: int, blocks: int) -> Array:
    """(count, tiles): a push that rises and falls, over every stretch of so many blocks, of mean 1 there."""
    one = np.sin(np.pi * (np.arange(blocks) + 0.5) / blocks) ** 2
    courses = np.zeros((count, count - blocks + 1))
    for k, value in enumerate(2 * one):
        courses[np.arange(courses.shape[1]) + k, np.arange(courses.shape[1])] = value
    return courses


__all__ = ["Push", "pushes"]
