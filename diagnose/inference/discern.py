"""How far a record that is not made yet would set two hypotheses apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from ...simulate.model import Array

SURE = 3.0
"""Log evidence beyond which one hypothesis is told from another: 20 to 1."""
ENOUGH = 1000.0
"""Beyond this a distance tells no more: a choice."""


def distance_left(apart: Array, columns: Array) -> float:
    """Squared distance of two predictions that is left when numbers of prior standard deviation 1 take up what they can.

    Parameters
    ----------
    apart : (n,) difference of the predictions, white
    columns : (n, k) change of a prediction by a standard deviation of each number, white

    Examples
    --------
    >>> distance_left(np.array([3.0, 4.0]), np.zeros((2, 1)))
    25.0
    >>> distance_left(np.array([3.0, 4.0]), np.array([[1.0], [0.0]]))  # half of the 9 is one standard deviation of that number
    20.5
    """
    base, size, _ = np.linalg.svd(columns, full_matrices=False)
    along = base.T @ apart
    # of what is taken up by many standard deviations nothing is left, however large the number is
    return float(max(apart @ apart - np.sum(along**2 * (size**2 / (1 + size**2))), 0.0))


def told(distance: float) -> float:
    """Probability that the true one of two hypotheses is told, their predictions so far apart.

    Its log evidence over the other is normal, half the distance in the mean, with the distance for variance.

    Parameters
    ----------
    distance : squared, by the noise
    """
    if distance <= 0:
        return 0.0
    return float(ndtr((0.5 * distance - SURE) / np.sqrt(distance)))


def expected(weights: Sequence[float], distances: Array) -> tuple[float, float]:
    """What a record would tell, over the posterior: of two hypotheses, each drawn by its probability, that they are told apart, and
    how far they are apart in the mean, each distance counted to where telling is sure.

    Some pairs no record tells apart; they lower what is expected of every record alike.

    Parameters
    ----------
    weights : (h,) probabilities of the hypotheses; only their ratios count
    distances : (h, h) squared distance left when the first is true and the second is fitted

    Examples
    --------
    >>> told_by, mean = expected([0.5, 0.5], np.array([[0.0, 20.0], [20.0, 0.0]]))
    >>> round(told_by, 2), mean
    (0.94, 20.0)
    """
    share = np.outer(weights, weights) * (1 - np.eye(len(weights)))
    share /= share.sum()
    by_each = np.vectorize(told)(distances)
    return float((share * by_each).sum()), float((share * np.minimum(distances, ENOUGH)).sum())


__all__ = ["distance_left", "expected", "told"]
