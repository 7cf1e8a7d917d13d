"""Choice of runs: greedy, then exchange, by the A or the D criterion."""

from __future__ import annotations

import numpy as np

from ...simulate.model import Array
from .information import relative_covariance

CRITERIA = ("A", "D")
BETTER = 1e-9
"""An exchange must gain this share of the score (A) or this much of its logarithm (D)."""
MOST_PASSES = 20
"""Of exchanges over all runs; it ends earlier when none is better."""


def score(criterion: str, covariance: Array, wish: Array) -> Array:
    """What is made small, (...): A the logarithm of the mean of (sd/wish)^2, D log det of the covariance.

    Parameters
    ----------
    criterion : "A" or "D"
    covariance : (..., 6, 6), relative
    wish : (6,), relative standard deviations wished for
    """
    if criterion == "A":
        variance = np.diagonal(covariance, axis1=-2, axis2=-1)
        return np.log(np.maximum((variance / wish**2).mean(axis=-1), 1e-300))
    size = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 1e-300))
    scaled = covariance / size[..., :, None] / size[..., None, :]
    return np.linalg.slogdet(scaled)[1] + 2 * np.log(size).sum(axis=-1)


def greedy(information: Array, prior: Array, wish: Array, criterion: str, count: int) -> list[int]:
    """Indices of ``count`` runs, each the best beside those before it; one may be taken more than once.

    Parameters
    ----------
    information : (candidates, k, k)
    prior : (k, k)
    wish : (6,) relative standard deviations wished for
    criterion : "A" or "D"
    count : how many runs
    """
    chosen: list[int] = []
    have = prior
    for _ in range(count):
        best = int(np.argmin(score(criterion, relative_covariance(have + information), wish)))
        chosen.append(best)
        have = have + information[best]
    return chosen


def exchange(chosen: list[int], information: Array, prior: Array, wish: Array, criterion: str) -> list[int]:
    """Replace one run after another by a better candidate until none is (Fedorov); never worse than ``chosen``.

    Parameters
    ----------
    chosen : indices of the runs to begin with
    information : (candidates, k, k) of each candidate
    prior : (k, k), what is known before any run
    wish : (6,) relative standard deviations wished for
    criterion : "A" or "D"

    Returns
    -------
    indices of the runs
    """
    chosen = list(chosen)
    have = prior + information[chosen].sum(axis=0)
    here = float(score(criterion, relative_covariance(have), wish))
    for _ in range(MOST_PASSES):
        moved = False
        for place, old in enumerate(chosen):
            without = prior + information[[c for i, c in enumerate(chosen) if i != place]].sum(axis=0)
            scores = score(criterion, relative_covariance(without + information), wish)
            best = int(np.argmin(scores))
            if best != old and scores[best] < here - BETTER:
                chosen[place], here, moved = best, float(scores[best]), True
        if not moved:
            break
    return chosen


def best_campaigns(information: Array, prior: Array, wish: Array, criterion: str, most: int) -> list[list[int]]:
    """The best campaign found of 1, 2, ... ``most`` runs: greedy with exchange, and the last one with a run more.

    Parameters
    ----------
    information : (candidates, k, k) of each candidate
    prior : (k, k), what is known before any run
    wish : (6,) relative standard deviations wished for
    criterion : "A" or "D"
    most : runs of the largest campaign

    Returns
    -------
    of each campaign the indices of its runs
    """
    order = greedy(information, prior, wish, criterion, most)
    campaigns: list[list[int]] = []
    for count in range(1, most + 1):
        starts = [order[:count]]
        if campaigns:
            last = campaigns[-1]
            have = prior + information[last].sum(axis=0)
            starts.append([*last, int(np.argmin(score(criterion, relative_covariance(have + information), wish)))])
        tried = [exchange(s, information, prior, wish, criterion) for s in starts]
        scores = [float(score(criterion, relative_covariance(prior + information[t].sum(axis=0)), wish)) for t in tried]
        campaigns.append(tried[int(np.argmin(scores))])
    return campaigns
