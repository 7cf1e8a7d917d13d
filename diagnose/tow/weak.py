"""Numbers by which a measured motion moves as it does: the equations in their weak form, without any simulation.

Over a second the velocities change by what the forces give (momentum, the equations integrated once), so that nothing is
differentiated beyond the velocities. Noise biases the answer, and it is a start only: for motions that a simulation with rough
numbers cannot follow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...geometry.normal import inverse_of_normal
from ...simulate.model import Array
from ..inference.hypothesis import Hypothesis
from .model import TowModel

WINDOW_S = 1.0
"""Over which the equations are integrated: a choice between noise and what a window flattens."""
TURNS = 8
"""Gauss-Newton steps."""
UNLIKE = 0.7
"""How far the derivatives may be from where they begin, as a share of it: weak knowledge."""
LARGEST_SD = 1.5
"""No effect's number changes by more of its standard deviations in a step."""
HELD = 1e-6
"""A number that is held may move by so little of itself."""
MAD_TO_SD = 1.4826
"""Of a normal distribution."""


def by_motion(
    model: TowModel, h: Hypothesis, prior: tuple[Array, Array] | None, first_only: bool = False
) -> Hypothesis:
    """The hypothesis with shared and effects' numbers by which its path moves as it does.

    Parameters
    ----------
    model : of the runs
    h : with a path along the measured motion
    prior : mean and standard deviation of the shared numbers; inf: nothing is known
    first_only : the first number of every effect only; all others, and the shared ones, are as they shall be
    """
    if h.path is None or not h.effects:
        return h
    effects = [q for e in h.effects for q in e.parameters]
    begun, sd = h.shared, np.array([q.sd for q in effects])
    spread = np.where(np.abs(begun) > 0, UNLIKE * np.abs(begun), np.inf)
    mean, centre = begun, np.array([q.none for q in effects])
    if prior is not None:
        known = np.isfinite(prior[1])
        mean, spread = np.where(known, prior[0], begun), np.where(known, prior[1], spread)
    if first_only:
        later = np.concatenate([np.arange(len(n)) > 0 for n in h.numbers])
        mean, spread, centre = begun, HELD * (np.abs(begun) + 1), np.where(later, np.concatenate(h.numbers), centre)
        precision = np.concatenate([spread**-2.0, np.where(later, HELD * sd, sd) ** -2.0])
    else:
        precision = np.concatenate([spread**-2.0, sd**-2.0])
    width = max(1, round(WINDOW_S / (model.step_s / 2)))
    forced = [2, 3, *range(5, len(h.path.states) - 2 * len(h.path.lags_s))]
    count = len(h.shared)
    for _ in range(TURNS):
        missed, change = model.momentum(h, width)
        # (windows, runs, states) and with every number; what nothing measured holds (beyond a run's end) is zero on both sides
        missed, change = missed[..., forced], change[..., forced, :]
        own = slice(count, change.shape[-1] - len(sd))
        change = np.delete(change, np.arange(own.start, own.stop), axis=-1)
        scale = MAD_TO_SD * np.median(np.abs(missed), axis=(0, 1)) + 1e-12
        rows, left = change / scale[:, None], missed / scale
        # robust: a window that fits badly (a jerk, a slack line) counts little
        weight = 1 / np.maximum(1.0, np.abs(left) / 2.0)
        flat, right = (rows * weight[..., None]).reshape(-1, len(precision)), (left * weight).reshape(-1)
        numbers = np.concatenate(h.numbers)
        gap = np.concatenate([mean - h.shared, centre - numbers])
        matrix = flat.T @ flat / width + np.diag(precision)
        step = inverse_of_normal(matrix) @ (flat.T @ right / width + precision * gap)
        share = 1.0 / max(1.0, float((np.abs(step[count:]) / (LARGEST_SD * sd)).max(initial=0.0)))
        after = numbers + share * step[count:]
        one_sided = np.array([q.one_sided for q in effects], dtype=bool)
        none = np.array([q.none for q in effects])
        after = np.where(one_sided, np.maximum(after, none), after)
        shared = h.shared + share * step[:count]
        shared[:2] = np.maximum(shared[:2], 0.2 * begun[:2])
        parts, at = [], 0
        for n in h.numbers:
            parts.append(after[at : at + len(n)])
            at += len(n)
        h = replace(h, shared=shared, numbers=tuple(parts))
    return h


__all__ = ["by_motion"]
