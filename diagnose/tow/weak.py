"""Numbers by which a measured motion moves as it does: the equations in their weak form, without any simulation.

Over a second the velocities change by what the forces give (momentum, the equations integrated once), so that nothing is
differentiated beyond the velocities. Noise biases the answer, and it is a start only: for motions that a simulation with rough
numbers cannot follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...geometry.normal import inverse_of_normal
from ...geometry.robust import MAD_TO_SD
from ...simulate.model import Array
from ..inference.hypothesis import Hypothesis
from .columns import STATES
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
USUAL_SD, OUTLYING, SMALLEST = 2.0, 3.0, 1e-12
"""Beyond so many standard deviations a window counts less, and beyond the second no more; a spread is above the third."""
FORCED = [2, 3, STATES + 1]
"""States that forces change: v, r, u."""


def by_motion(
    model: TowModel, h: Hypothesis, prior: tuple[Array, Array] | None, first_only: bool = False
) -> Hypothesis:
    """The hypothesis with shared and effects' numbers by which its path moves as it does; as it stands where they have no size.

    Parameters
    ----------
    model : of the runs
    h : with a path along the measured motion
    prior : mean and standard deviation of the shared numbers; inf: nothing is known
    first_only : the first number of every effect only; all others, and the shared ones, are as they shall be
    """
    assert h.path is not None
    mean, precision = _known(h, prior, first_only)
    effects, count = [q for e in h.effects for q in e.parameters], len(h.shared)
    sd, least = np.array([q.sd for q in effects]), 0.2 * h.shared[:2]
    lowest = np.array([q.none if q.one_sided else -np.inf for q in effects])
    ends = np.cumsum([len(n) for n in h.numbers])[:-1]
    for _ in range(TURNS):
        # (windows, runs, states), and with every number
        left, change, width = _windows(model, h)
        if not (np.isfinite(left).all() and np.isfinite(change).all()):
            break
        change = np.concatenate([change[..., :count], change[..., change.shape[-1] - len(sd) :]], axis=-1)
        scale = MAD_TO_SD * np.median(np.abs(left), axis=(0, 1)) + SMALLEST
        rows, left = change / scale[:, None], left / scale
        # a window that fits badly (a jerk, a slack line) counts little
        weight = 1 / np.maximum(1.0, np.abs(left) / USUAL_SD)
        flat, right = (rows * weight[..., None]).reshape(-1, len(mean)), (left * weight).reshape(-1)
        numbers = np.concatenate(h.numbers)
        gap = mean - np.concatenate([h.shared, numbers])
        step = inverse_of_normal(flat.T @ flat / width + np.diag(precision)) @ (
            flat.T @ right / width + precision * gap
        )
        step /= max(1.0, float((np.abs(step[count:]) / (LARGEST_SD * sd)).max(initial=0.0)))
        shared = h.shared + step[:count]
        shared[:2] = np.maximum(shared[:2], least)
        after = np.maximum(numbers + step[count:], lowest)
        h = replace(h, shared=shared, numbers=tuple(np.split(after, ends)))
    return h


def missed(model: TowModel, hypotheses: Sequence[Hypothesis]) -> Array:
    """(k,) how far each hypothesis's forces are from what moves its path: chi-square by the scatter that the first one leaves.

    Parameters
    ----------
    model : of the runs
    hypotheses : with one path, along the measured motion
    """
    every = [_windows(model, h) for h in hypotheses]
    scale = MAD_TO_SD * np.median(np.abs(every[0][0]), axis=(0, 1)) + SMALLEST
    # a second's windows begin at every node
    return np.array([(np.clip(left / scale, -OUTLYING, OUTLYING) ** 2).sum() / width for left, _, width in every])


def _windows(model: TowModel, h: Hypothesis) -> tuple[Array, Array, int]:
    """(windows, runs, states) what the forces miss, with every number (.., k), and how many nodes a window has."""
    width = max(1, round(WINDOW_S / (model.step_s / 2)))
    left, change = (found[:, :, FORCED] for found in model.momentum(h, width))
    return left, change, width


def _known(h: Hypothesis, prior: tuple[Array, Array] | None, first_only: bool) -> tuple[Array, Array]:
    """Mean and inverse variance of shared and effects' numbers, as far as they are known or held."""
    here, effects = np.concatenate(h.numbers), [q for e in h.effects for q in e.parameters]
    none, sd = np.array([q.none for q in effects]), np.array([q.sd for q in effects])
    if first_only:
        later = np.concatenate([np.arange(len(n)) > 0 for n in h.numbers])
        mean = np.concatenate([h.shared, np.where(later, here, none)])
        return mean, np.concatenate([HELD * (np.abs(h.shared) + 1), np.where(later, HELD * sd, sd)]) ** -2.0
    spread = np.where(np.abs(h.shared) > 0, UNLIKE * np.abs(h.shared), np.inf)
    shared = h.shared
    if prior is not None:
        known = np.isfinite(prior[1])
        shared, spread = np.where(known, prior[0], shared), np.where(known, prior[1], spread)
    return np.concatenate([shared, none]), np.concatenate([spread, sd]) ** -2.0


__all__ = ["by_motion", "missed"]
