"""The record that would best tell the hypotheses apart that are still open, of those that could be made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array
from ..inference.discern import distance_left, expected
from ..inference.evidence import STEEP, Fitted
from ..inference.hypothesis import Hypothesis
from ..inference.ranking import Ranking
from .designs import Design
from .simulator import OwnSimulator

OPEN = 0.01
"""A hypothesis of less probability is closed."""
MOST_OPEN = 5
"""So many hypotheses are told apart: a choice, for time."""
MOST_FITTED, FIT_STEPS = 6, 8
"""Designs whose hypotheses are fitted to one another, and steps of a fit: choices, for time."""
DAMPED, MORE = 1.0, 4.0
"""A step of such a fit is whole at first; after one that makes it worse it is this much shorter."""


@dataclass(frozen=True)
class Open:
    """A hypothesis that may be true.

    Attributes
    ----------
    names : of its effects; none: nothing is missing; "unknown": the free form that stands for it
    weight : probability
    fitted : it
    """

    names: tuple[str, ...]
    weight: float
    fitted: Fitted


@dataclass(frozen=True)
class Experiment:
    """What a record would tell.

    Attributes
    ----------
    design : of the record
    told : probability that two of the open hypotheses, each drawn by its probability, are told apart
    distance : their squared distance in the mean
    """

    design: Design
    told: float
    distance: float


def open_hypotheses(ranking: Ranking) -> list[Open]:
    """Those of OPEN and more, the most probable first; at least two.

    Parameters
    ----------
    ranking : of all
    """
    every = [Open((), ranking.p_no_gap, ranking.base)]
    every += [Open(c.names, float(p), c.fitted) for c, p in zip(ranking.candidates, ranking.named, strict=True)]
    free = ranking.for_unknown
    if free is not None:
        every.append(Open(("unknown",), ranking.p_unknown, free.fitted))
    every.sort(key=lambda one: -one.weight)
    kept = [one for one in every if one.weight >= OPEN][:MOST_OPEN]
    return kept if len(kept) > 1 else every[:2]


def experiments(simulator: OwnSimulator, hypotheses: Sequence[Open], designs: Sequence[Design]) -> list[Experiment]:
    """What each design would tell, the best first; those that some hypothesis cannot follow left out.

    All by their slopes; then the best once more, every hypothesis fitted to what every other one would give there, until the best
    has been so: far from the records made slopes promise too much.

    Parameters
    ----------
    simulator : with the records made
    hypotheses : that are open, at least two
    designs : that could be made
    """
    if len(hypotheses) < 2 or not designs:
        return []
    weights = [max(o.weight, OPEN) for o in hypotheses]
    found = {}
    for index, distances in _all_by_slopes(simulator, hypotheses, designs).items():
        found[index] = Experiment(designs[index], *expected(weights, distances))
    fitted: set[int] = set()
    while found and len(fitted) < MOST_FITTED:
        best = min(found, key=lambda k: _order(found[k]))
        if best in fitted:
            break
        fitted.add(best)
        found[best] = Experiment(designs[best], *expected(weights, _fitted(simulator, hypotheses, designs[best])))
    return sorted(found.values(), key=_order)


def _order(e: Experiment) -> tuple[float, float]:
    return -round(e.told, 3), -e.distance


def _all_by_slopes(simulator: OwnSimulator, hypotheses: Sequence[Open], designs: Sequence[Design]) -> dict[int, Array]:
    """Index of a design -> (h, h) distances left."""
    trial = simulator.with_records([d.record for d in designs])
    begun = _begun(simulator, hypotheses, designs)
    linear = trial.linear(begun)
    noise = trial.noise(begun[0])
    found = {}
    for index in range(len(designs)):
        rows = [slopes.rows[index] for slopes in linear]
        if not all(np.nanmax(np.abs(r)) < trial.gone and np.nanmax(np.abs(s)) < STEEP for r, s in rows):
            continue
        distances = np.zeros((len(hypotheses), len(hypotheses)))
        changes = [_changes(trial, o.fitted, slope) for o, (_, slope) in zip(hypotheses, rows, strict=True)]
        for i, true in enumerate(hypotheses):
            white = noise.whitened(index, true.fitted.forces, [rows[i][0] - r for r, _ in rows])
            moved = noise.whitened(index, true.fitted.forces, changes)
            for j in range(len(hypotheses)):
                if i != j:
                    # the other's start is fitted to the new record, and both have their numbers as well as they are known
                    columns = np.concatenate([moved[j], moved[i][:, trial.own_sd.shape[1] :]], axis=1)
                    distances[i, j] = distance_left(white[j], columns)
        found[index] = distances
    return found


def _fitted(simulator: OwnSimulator, hypotheses: Sequence[Open], design: Design) -> Array:
    """(h, h) squared distances that are left when the second is fitted to what the first gives (Levenberg and Marquardt)."""
    trial = simulator.with_records([design.record])
    begun = _begun(simulator, hypotheses, [design])
    noise = trial.noise(begun[0])
    given = [slopes.rows[0] for slopes in trial.linear(begun)]
    own = trial.own_sd.shape[1]
    count = len(hypotheses)
    pairs = [(i, j) for i in range(count) for j in range(count) if i != j]
    turns = [_root(o.fitted) for o in hypotheses]
    uncertain = [_changes(trial, o.fitted, slope)[..., own:] for o, (_, slope) in zip(hypotheses, given, strict=True)]
    best = np.full(len(pairs), np.inf)
    # standard deviations by which the fitted one's start and numbers, and the true one's numbers, are moved
    at = [np.zeros(own + len(turns[j]) + len(turns[i])) for i, j in pairs]
    tried, steps = [z.copy() for z in at], [np.zeros_like(z) for z in at]
    damping = np.full(len(pairs), DAMPED)
    for _ in range(FIT_STEPS):
        moved = [
            _moved(begun[j], trial.own_sd[0] * z[:own], turns[j] @ z[own : own + len(turns[j])])
            for (_, j), z in zip(pairs, tried, strict=True)
        ]
        for k, ((i, j), slopes) in enumerate(zip(pairs, trial.linear(moved), strict=True)):
            residual, slope = slopes.rows[0]
            changes = np.concatenate([_changes(trial, hypotheses[j].fitted, slope), -uncertain[i]], axis=2)
            if not np.isfinite(changes).all():
                damping[k] *= MORE
                tried[k] = at[k] + steps[k] / damping[k]
                continue
            # the true one gives what it gave, and the change by its own numbers
            white, columns = noise.whitened(0, hypotheses[i].fitted.forces, [residual - given[i][0], changes])
            z = tried[k]
            white = white - columns[:, own + len(turns[j]) :] @ z[own + len(turns[j]) :]
            cost = float(white @ white + z @ z)
            if cost < best[k]:
                best[k], at[k] = cost, z
                matrix = np.concatenate([columns, np.eye(len(z))])
                steps[k] = np.asarray(np.linalg.lstsq(matrix, np.concatenate([white, -z]), rcond=None)[0], dtype=float)
                damping[k] = max(damping[k] / MORE, 1.0)
            else:
                damping[k] *= MORE
            tried[k] = at[k] + steps[k] / damping[k]
    distances = np.zeros((count, count))
    for (i, j), cost in zip(pairs, best, strict=True):
        distances[i, j] = cost if np.isfinite(cost) else 0.0
    return distances


def _moved(h: Hypothesis, own: Array, rest: Array) -> Hypothesis:
    first = len(h.shared)
    numbers, k = [], first
    for those in h.numbers:
        numbers.append(those + rest[k : k + len(those)])
        k += len(those)
    return replace(h, shared=h.shared + rest[:first], own=h.own + own, numbers=tuple(numbers))


def _begun(simulator: OwnSimulator, hypotheses: Sequence[Open], designs: Sequence[Design]) -> list[Hypothesis]:
    """With the designs' starts; all others as the records made began, by the best hypothesis."""
    own = np.tile(np.median(hypotheses[0].fitted.hypothesis.own, axis=0), (len(designs), 1))
    names = simulator.own_names
    for row, design in zip(own, designs, strict=True):
        for name, value in design.start.items():
            row[names.index(name)] = value
    return [replace(o.fitted.hypothesis, own=own) for o in hypotheses]


def _root(fitted: Fitted) -> Array:
    """(n, n) change of the shared numbers and effects by a standard deviation of each of as many independent ones."""
    size, turn = np.linalg.eigh(fitted.solved.covariance)
    return turn * np.sqrt(np.maximum(size, 0.0))


def _changes(trial: OwnSimulator, fitted: Fitted, slope: Array) -> Array:
    """(n, c, k) change of a record by a prior standard deviation of each start, then of each other number as it is known."""
    shared, own = len(fitted.hypothesis.shared), fitted.hypothesis.own.shape[1]
    rest = np.concatenate([slope[..., :shared], slope[..., shared + own :]], axis=2)
    return np.concatenate([slope[..., shared : shared + own] * trial.own_sd[0], rest @ _root(fitted)], axis=2)


__all__ = ["Experiment", "Open", "experiments", "open_hypotheses"]
