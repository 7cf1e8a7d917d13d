"""Where the fit of a model begins: many places at once, over longer and longer beginnings of the records.

A motion that swings for long says nothing of the way to its optimum: a frequency a tenth off is out of phase after five swings.
Over the first part of a record the way is open; from there the rest follows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from ...simulate.model import Array
from ..inference.hypothesis import Hypothesis, Slopes
from ..users import UsersRun
from .model import Number

BEGINNINGS = (0.0625, 0.125, 0.25, 0.5, 1.0)
"""Shares of the records."""
PLACES, WITHIN = 64, 3.0
"""So many sets of numbers are tried, each number up to this factor off."""
KEPT = (8, 6, 4, 3, 2)
"""So many go on from each beginning."""
STEPS = 12
"""Of one least squares fit: a choice, for time."""
FEWEST = 3
"""A beginning has so many measured values for each number that is fitted: fewer fix nothing."""
DAMPED, LESS, MORE = 1e-2, 0.2, 8.0
"""Damping of the first step (Levenberg and Marquardt), and how it changes after one that is better or worse."""
ENOUGH = 1e-4
"""A fit whose square falls by less than this share is at its end."""
SAME = 0.01
"""Ends whose numbers differ by less, in units of their sizes, are one: a choice."""


@dataclass(frozen=True)
class Beginning:
    """What is needed to begin.

    Attributes
    ----------
    numbers : of all runs, that are fitted
    own : (k,) sizes of each run's own
    values : (hypotheses, share) -> (n, c) of each and each run
    linear : (hypotheses, 0, share) -> residuals and slopes of each
    runs : as measured
    """

    numbers: Sequence[Number]
    own: Array
    values: Callable[[Sequence[Hypothesis], float], list[list[Array]]]
    linear: Callable[[Sequence[Hypothesis], int, float], list[Slopes]]
    runs: Sequence[UsersRun]

    @property
    def size(self) -> Array:
        """(p,) of all numbers, each run's own one after the other."""
        return np.concatenate([[n.usual for n in self.numbers], np.tile(self.own, len(self.runs))]).astype(float)


def begun(here: Beginning, given: Hypothesis) -> list[Hypothesis]:
    """The best distinct ends, the best first, then the one given.

    Parameters
    ----------
    here : what is needed
    given : where the user says
    """
    if not len(here.size):
        return [given]
    tried = _places(here, given)
    sd = [np.sqrt(np.einsum("cnn->nc", run.covariance)) for run in here.runs]
    shares = [s for s in BEGINNINGS if _enough(here, s)] or [1.0]
    left = [
        _square(here, h, values, sd, shares[0]) for h, values in zip(tried, here.values(tried, shares[0]), strict=True)
    ]
    order = np.argsort(left, kind="stable")[: KEPT[0]]
    # where the user says is always among them
    going = [given, *(tried[k] for k in order if k and np.isfinite(left[k]))]
    for share, kept in zip(shares, KEPT[-len(shares) :], strict=True):
        going = _distinct(_ends(here, going, sd, share), here.size)[:kept]
    return [*going, given]


def _enough(here: Beginning, share: float) -> bool:
    if share == 1.0:
        return True
    fewest = min(int(np.isfinite(run.values[: _count(run, share)]).sum()) for run in here.runs)
    return fewest >= FEWEST * (len(here.own) + len(here.numbers))


def _count(run: UsersRun, share: float) -> int:
    return max(int(np.ceil(share * len(run.values))), 2)


def _places(here: Beginning, given: Hypothesis) -> list[Hypothesis]:
    """The one given, and others about it; the same each time."""
    free = [k for k, n in enumerate(here.numbers) if n.sd is None]
    if not free:
        return [given]
    table = qmc.Halton(len(free), scramble=False).random(PLACES)[1:]
    found = [given]
    for row in table:
        shared = given.shared.copy()
        for k, at in zip(free, 2 * row - 1, strict=True):
            n = here.numbers[k]
            other = n.start * WITHIN**at if n.start else n.usual * at
            shared[k] = np.clip(other, n.least, n.most)
        found.append(replace(given, shared=shared))
    return found


def _square(here: Beginning, h: Hypothesis, values: Sequence[Array], sd: Sequence[Array], share: float) -> float:
    """Sum of squares over a beginning, by the noise."""
    total = 0.0
    for run, found, s in zip(here.runs, values, sd, strict=True):
        count = _count(run, share)
        z = ((run.values - found) / s)[:count]
        total += float(np.sum(z[np.isfinite(run.values[:count])] ** 2))
    return (total if np.isfinite(total) else np.inf) + _prior(here, h)


def _prior(here: Beginning, h: Hypothesis) -> float:
    return sum(((v - n.start) / n.sd) ** 2 for v, n in zip(h.shared, here.numbers, strict=True) if n.sd)


def _ends(here: Beginning, going: Sequence[Hypothesis], sd: Sequence[Array], share: float) -> list[Hypothesis]:
    """Least squares over a beginning, from all of these side by side; the best first."""
    now, damping = list(going), [DAMPED] * len(going)
    best = [np.inf] * len(now)
    normal: list[tuple[Array, Array] | None] = [None] * len(now)
    ended = [False] * len(now)
    tried = list(now)
    for _ in range(STEPS):
        active = [k for k, end in enumerate(ended) if not end]
        if not active:
            break
        for k, slopes in zip(active, here.linear([tried[k] for k in active], 0, share), strict=True):
            square, matrix, right = _normal(here, tried[k], slopes, sd, share)
            if square < best[k]:
                ended[k] = best[k] - square < ENOUGH * best[k] if np.isfinite(best[k]) else False
                now[k], best[k], normal[k] = tried[k], square, (matrix, right)
                damping[k] *= LESS
            else:
                damping[k] *= MORE
                ended[k] = damping[k] > 1e8
            known = normal[k]
            if known is None:
                ended[k] = True
            elif not ended[k]:
                tried[k] = _stepped(here, now[k], *known, damping[k])
    order = np.argsort(best, kind="stable")
    return [now[k] for k in order if np.isfinite(best[k])] or [going[0]]


def _normal(
    here: Beginning, h: Hypothesis, slopes: Slopes, sd: Sequence[Array], share: float
) -> tuple[float, Array, Array]:
    """Sum of squares, normal matrix and right side in units of the numbers' sizes."""
    first, own, runs = len(h.shared), h.own.shape[1], len(here.runs)
    count = first + own * runs
    matrix, right, total = np.zeros((count, count)), np.zeros(count), _prior(here, h)
    for index, (run, (residual, slope), s) in enumerate(zip(here.runs, slopes.rows, sd, strict=True)):
        good = np.isfinite(run.values)
        good[_count(run, share) :] = False
        z, wide = (residual / s)[good], np.zeros((int(good.sum()), count))
        white = (slope / s[..., None])[good]
        wide[:, :first] = white[:, :first]
        wide[:, first + own * index : first + own * (index + 1)] = white[:, first : first + own]
        wide *= here.size
        if not (np.isfinite(z).all() and np.isfinite(wide).all()):
            return np.inf, matrix, right
        total += float(z @ z)
        matrix += wide.T @ wide
        right += wide.T @ z
    for k, (value, n) in enumerate(zip(h.shared, here.numbers, strict=True)):
        if n.sd:
            matrix[k, k] += (n.usual / n.sd) ** 2
            right[k] += n.usual * (n.start - value) / n.sd**2
    return total, matrix, right


def _stepped(here: Beginning, h: Hypothesis, matrix: Array, right: Array, damping: float) -> Hypothesis:
    """A step; what would leave its bounds is held there, and the others step beside it."""
    least, most = np.full(len(right), -np.inf), np.full(len(right), np.inf)
    for k, n in enumerate(here.numbers):
        least[k], most[k] = (n.least - h.shared[k]) / n.usual, (n.most - h.shared[k]) / n.usual
    diagonal = np.maximum(np.diag(matrix), 1e-12 * max(float(np.diag(matrix).max()), 1e-300))
    damped = matrix + damping * np.diag(diagonal)
    step, free = np.zeros(len(right)), np.ones(len(right), dtype=bool)
    for _ in range(len(here.numbers) + 1):
        held = damped[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.lstsq(damped[np.ix_(free, free)], right[free] - held, rcond=None)[0]
        over = free & ((step < least) | (step > most))
        if not over.any():
            break
        step[over] = np.clip(step, least, most)[over]
        free &= ~over
    moved = step * here.size
    first = len(h.shared)
    shared = np.clip(h.shared + moved[:first], [n.least for n in here.numbers], [n.most for n in here.numbers])
    return replace(h, shared=shared, own=h.own + moved[first:].reshape(h.own.shape))


def _distinct(found: Sequence[Hypothesis], size: Array) -> list[Hypothesis]:
    """Those that are not one another."""
    answer: list[Hypothesis] = []
    for h in found:
        here = np.concatenate([h.shared, h.own.ravel()])
        others = [np.concatenate([o.shared, o.own.ravel()]) for o in answer]
        if all(np.abs((here - other) / size).max() > SAME for other in others):
            answer.append(h)
    return answer


__all__ = ["Beginning", "begun"]
