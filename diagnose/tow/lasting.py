"""How large the marks' slow errors are, by the distance between two marks: no motion changes it.

That length is known: what it does beside white noise is the marks' own, by the codec, the texture of the deck, light that goes with
the place. What a fault of the camera or of a clock makes of it goes smoothly with the model's place, heading and rates, in all runs
alike; that is taken out, and is left to the effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.linalg import solve_triangular

from ...simulate.model import Array
from .channels import DISTANCE
from .slow import SLOW_PX, SLOW_UNSEEN_PX, lag_of
from .tow_run import TowRun

TRIED_PX = (SLOW_PX, 0.02, 0.03, 0.04, 0.06, 0.085, SLOW_UNSEEN_PX)
"""Sizes that are tried."""
SURE = 2.0
"""Log evidence that another size than that granted before has to bring."""
FREE = 3
"""There must be so many times as many means as numbers of what is smooth."""


@dataclass(frozen=True)
class Distances:
    """Of one run.

    Attributes
    ----------
    values : (n,) its means over its blocks, less the stated one
    white : (n, n) their covariance without slow errors
    slow : (n, n) the covariance of slow errors of 1 px of every mark
    place : (n, 3) x, y and heading of the blocks
    rates : (n, 3) their rates
    """

    values: Array
    white: Array
    slow: Array
    place: Array
    rates: Array


def as_distances_show(runs: Sequence[TowRun]) -> list[TowRun]:
    """The runs, granted the slow errors that their marks' distances show.

    Marks that came without a film, beside a static record, and runs that came as motion stay as they are.

    Parameters
    ----------
    runs : filmed alike
    """
    answer = list(runs)
    for size in {run.slow.size_px for run in runs if run.slow.by_distance}:
        alike = [k for k, run in enumerate(runs) if run.slow.by_distance and run.slow.size_px == size]
        shown = lasting_px([_distances(runs[k]) for k in alike], size)
        if shown != size:
            for k in alike:
                answer[k] = runs[k].granted(runs[k].slow.of_size(shown))
    return answer


def shown_px(runs: Sequence[TowRun]) -> float | None:
    """The largest slow errors that marks were granted by their distance, px; None where none were.

    Parameters
    ----------
    runs : of ``tow_runs``
    """
    return max((run.slow.size_px for run in runs if run.slow.by_distance), default=None)


def _distances(run: TowRun) -> Distances:
    good = np.isfinite(run.values[:, [0, 1, DISTANCE]]).all(axis=1) & np.isfinite(run.x_m)
    place = np.column_stack([run.x_m, run.values[:, :2]])[good]
    each = np.ix_(good, good)
    slow = run.slow.covariance(lag_of(run.centre_s))[DISTANCE][each]
    rates = np.gradient(place, run.centre_s[good], axis=0) if len(place) > 1 else np.zeros_like(place)
    white = run.covariance[DISTANCE][each] - slow
    return Distances(run.values[good, DISTANCE], white, slow / run.slow.size_px**2, place, rates)


def lasting_px(runs: Sequence[Distances], before_px: float) -> float:
    """Standard deviation of the marks' slow errors, px: the best of TRIED_PX by restricted likelihood.

    Parameters
    ----------
    runs : of one campaign, filmed alike
    before_px : kept where the runs are too short to tell, or tell nothing else clearly

    Returns
    -------
    size : px
    """
    smooth = _smooth(np.concatenate([r.place for r in runs]), np.concatenate([r.rates for r in runs]))
    if len(smooth) < FREE * smooth.shape[1]:
        return before_px
    ends = np.cumsum([len(r.values) for r in runs])[:-1]
    parts = list(zip(runs, np.split(smooth, ends), strict=True))
    found = {size: _evidence(parts, size) for size in {*TRIED_PX, before_px}}
    best = max(found, key=lambda size: found[size])
    return best if found[best] > found[before_px] + SURE else before_px


def _smooth(place: Array, rates: Array) -> Array:
    """(n, k) an orthonormal basis of what is quadratic in the place, cubic along the tank, linear in rates, or in rates times x."""

    def scaled(columns: Array) -> Array:
        centred = columns - columns.mean(axis=0)
        return centred / np.maximum(np.abs(centred).max(axis=0), 1e-12)

    place, rates = scaled(place), scaled(rates)
    twice = [place[:, i] * place[:, j] for i, j in combinations_with_replacement(range(place.shape[1]), 2)]
    columns = np.column_stack([np.ones(len(place)), place, *twice, place[:, 0] ** 3, rates, rates * place[:, :1]])
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return vectors[:, sizes > 1e-6 * sizes[0]]


def _evidence(parts: Sequence[tuple[Distances, Array]], size_px: float) -> float:
    """Log of the restricted likelihood, up to a constant."""
    k = parts[0][1].shape[1]
    normal, total = np.zeros((k + 1, k + 1)), 0.0
    for run, smooth in parts:
        root = np.linalg.cholesky(run.white + size_px**2 * run.slow)
        rows = solve_triangular(root, np.column_stack([smooth, run.values]), lower=True)
        normal += rows.T @ rows
        total -= float(np.log(np.diag(root)).sum())
    right = normal[:k, k]
    left = normal[k, k] - right @ np.linalg.solve(normal[:k, :k], right)
    return total - 0.5 * float(left) - 0.5 * float(np.linalg.slogdet(normal[:k, :k])[1])


__all__ = ["Distances", "as_distances_show", "lasting_px", "shown_px"]
