"""How far the gap shrinks: each run kept aside in turn, the others fitted, only what is the run's own fitted again to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from .evidence import Fitted, Inference
from .noise import Forces

BLOCKS_TOGETHER = 12
"""Means that are drawn together, so that neighbours stay neighbours (a block bootstrap): a choice."""
DRAWS = 400
"""Of the bootstrap: a choice."""
LOW, HIGH = 5.0, 95.0
"""Percentiles of a 90 % interval."""
UNTOLD = 1e-9
"""An effect's number that the others tell by less than this share of what a run tells of it is that run's own: an event's time."""


@dataclass(frozen=True)
class Shrink:
    """Gap before and after, on runs kept aside.

    Attributes
    ----------
    before, after : root mean square of whitened residuals of y and beta; 1 = noise
    shrink, interval : 1 - excess ratio, and its 90 % interval
    residuals : run -> before and after (2n,), whitened
    alone : how many of the effects' numbers no other run tells: they are fitted to the run that is kept aside
    """

    before: float
    after: float
    shrink: float
    interval: tuple[float, float]
    residuals: dict[int, tuple[Array, Array]]
    alone: int = 0


def none_left(count: int, held: Sequence[int] | None) -> bool:
    """Whether, of ``count`` runs, none would be left to fit with ``held`` kept aside (None: each in turn): nothing is, then.

    Parameters
    ----------
    count : of runs
    held : runs kept aside; None: each in turn
    """
    return count < 2 or (held is not None and len(held) == count)


def aside(inference: Inference, fitted: Fitted, forces: Forces, run: int, others: Sequence[int]) -> Array:
    """Whitened residual (m n,) of what moves, of a run that took no part in the fit.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    forces : random forces on the hull
    run : that is kept aside
    others : runs that are fitted
    """
    return _aside(inference, fitted, forces, run, others, alone=False)[0]


def _aside(
    inference: Inference, fitted: Fitted, forces: Forces, run: int, others: Sequence[int], alone: bool
) -> tuple[Array, int]:
    """``aside``, and how many of the effects' numbers are fitted to the run itself; ``alone``: those that no other tells are."""
    h, grams = fitted.hypothesis, fitted.grams
    told, own = inference.solve(grams, h, forces, others), inference.reduced(grams, h, forces, [run])
    step, first = told.shared.copy(), inference.fixed(h)
    here, there = (np.diag(part.matrix)[first:] for part in (own, told.reduced))
    untold = first + np.flatnonzero((here > 0) & (there <= UNTOLD * here) & alone)
    if len(untold):
        prior = inference.priors(h)
        step[untold] = 0.0
        matrix = own.matrix[np.ix_(untold, untold)] + np.diag(prior.precision[untold])
        step[untold] = np.linalg.solve(matrix, (own.right - own.matrix @ step + prior.pull)[untold])
    left = inference.left(fitted.linear, forces, step, own.own_step(step)[0], run)
    return left[: len(inference.noise.runs[run].white)], len(untold)


def shrink(
    inference: Inference,
    base: Fitted,
    best: Fitted,
    held: Sequence[int] | None,
    rng: np.random.Generator,
    forces: Forces | None = None,
) -> Shrink:
    """Gap before and after. What no other run tells of an effect (when, how long and how hard an event came) is the run's own.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    base : the fit without effects
    best : the best hypothesis, fitted
    held : runs kept aside (all at once); None: each in turn. Where that leaves no run to fit, all are fitted themselves
    rng : that draws
    forces : random forces that both are measured by; None: those of ``best``
    """
    count, free = len(inference.simulator.runs), inference.simulator.free
    lengths = [len(run.centre_s) for run in inference.simulator.runs]
    forces = forces or best.forces
    turns = _turns(count, held)
    if none_left(count, held):
        turns = [(i, list(range(count))) for i in range(count)]
    residuals: dict[int, tuple[Array, Array]] = {}
    fitted, parts = np.zeros((len(turns), 2)), []
    for k, (run, others) in enumerate(turns):
        (without, _), (left, alone) = (_aside(inference, f, forces, run, others, alone=True) for f in (base, best))
        residuals[run], fitted[k] = (without, left), (free, free + alone)
        parts.append(_sums(without, left, lengths[run]))
    before, after = (_gap([r[k] for r in residuals.values()], float(fitted[:, k].sum())) for k in (0, 1))
    values = np.array([removed_share(b, a) for b, a in _drawn(parts, fitted, rng)])
    interval = (float(np.percentile(values, LOW)), float(np.percentile(values, HIGH)))
    alone = int(fitted[:, 1].sum()) - free * len(turns)
    return Shrink(before, after, removed_share(before, after), interval, residuals, alone)


def size_aside(inference: Inference, fitted: Fitted, forces: Forces) -> float:
    """Mean square of the whitened residuals of what moves, each run kept aside in turn; 1: noise alone.

    Parameters
    ----------
    inference : the simulator with its runs and noise, two at least
    fitted : a hypothesis, fitted
    forces : random forces
    """
    turns = _turns(len(inference.simulator.runs), None)
    left = [aside(inference, fitted, forces, run, others) for run, others in turns]
    return _gap(left, inference.simulator.free * len(left)) ** 2


def worse_aside(inference: Inference, one: Fitted, other: Fitted, held: Sequence[int] | None) -> float:
    """By how many of its standard errors one fit leaves more of the runs kept aside than another does.

    Both are measured beside the same random forces, the smaller ones of the two. The error is that of a sum over stretches of
    ``BLOCKS_TOGETHER`` means, each run's own: neighbours are not independent.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    one, other : fitted
    held : runs kept aside; None: each in turn

    Returns
    -------
    errors : above 0 where the first leaves more; NaN where no run can be kept aside
    """
    count = len(inference.simulator.runs)
    if none_left(count, held):
        return float("nan")
    side, moment = (min(getattr(f.forces, name) for f in (one, other)) for name in ("side_n", "moment_n_m"))
    forces = Forces(side, moment, other.forces.time)
    parts = []
    for run, others in _turns(count, held):
        n = len(inference.simulator.runs[run].centre_s)
        a, b = (np.square(aside(inference, f, forces, run, others)).reshape(-1, n).sum(axis=0) for f in (one, other))
        parts.append(np.add.reduceat(a - b, np.arange(0, n, BLOCKS_TOGETHER)))
    differences = np.concatenate(parts)
    error = float(np.sqrt(len(differences)) * differences.std(ddof=1)) if len(differences) > 1 else 0.0
    return float(differences.sum()) / error if error > 0 else float("nan")


def _turns(count: int, held: Sequence[int] | None) -> list[tuple[int, list[int]]]:
    """Runs that are kept aside, each with those that are fitted then."""
    return [(i, [j for j in range(count) if j not in (held or (i,))]) for i in held or range(count)]


def _gap(parts: Sequence[Array], fitted: float) -> float:
    """Root mean square of parts to which so many numbers were fitted."""
    total = sum(float(p @ p) for p in parts)
    return float(np.sqrt(total / max(sum(len(p) for p in parts) - fitted, 1)))


def removed_share(before: float, after: float) -> float:
    """Share of a gap's excess over noise that an effect removes.

    Parameters
    ----------
    before, after : root mean square of whitened residuals; noise alone has 1

    Returns
    -------
    share : of ``taken``
    """
    return taken(before**2, after**2)


def taken(before: float, after: float, noise: float = 1.0) -> float:
    """Share of a gap's power beyond noise that goes.

    Parameters
    ----------
    before, after : mean squares of whitened residuals
    noise : the same of noise alone

    Returns
    -------
    share : 1 - (after - noise)/(before - noise), within 0 and 1; 0 where there was no gap
    """
    return float(np.clip(1 - max(after - noise, 0.0) / (before - noise), 0.0, 1.0)) if before > noise else 0.0


def _sums(before: Array, after: Array, n: int) -> tuple[Array, int, int]:
    """(2, n + 1) squared residuals of all channels up to each time, how many values there are, and n."""
    squares = np.array([(r.reshape(-1, n) ** 2).sum(axis=0) for r in (before, after)])
    return np.concatenate([np.zeros((2, 1)), np.cumsum(squares, axis=1)], axis=1), before.size, n


def _drawn(parts: Sequence[tuple[Array, int, int]], fitted: Array, rng: np.random.Generator) -> Array:
    """(DRAWS, 2) bootstrap draws over runs, and stretches of time within them; parts are of ``_sums``, and ``fitted`` (runs, 2) how
    many numbers were fitted to each before and after.
    """
    chosen = rng.integers(len(parts), size=(DRAWS, len(parts)))
    sums, total = np.zeros((DRAWS, 2)), np.zeros((DRAWS, 2))
    for index, (up_to, values, n) in enumerate(parts):
        # a run that is drawn twice is so with stretches of its own
        draw = np.nonzero(chosen == index)[0]
        begin = rng.integers(0, max(n - BLOCKS_TOGETHER, 1), size=(len(draw), max(n // BLOCKS_TOGETHER, 1)))
        end = np.minimum(begin + BLOCKS_TOGETHER, n)
        found = (up_to[:, end] - up_to[:, begin]).sum(axis=2) * (n / (end - begin).sum(axis=1))
        np.add.at(sums, draw, found.T)
        np.add.at(total, draw, values - fitted[index])
    return np.sqrt(sums / np.maximum(total, 1))
