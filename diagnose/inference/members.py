"""The evidence of an effect that may have any of its sizes, and any of its members (``effects.members``).

Each is a normal prior of its own: a share of each number's usual standard deviation, 0 where the member has not got the number. The
data's part is the same for all, so that a hundred priors cost as little as one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import log_ndtr, logsumexp

from ...simulate.model import Array
from ..effects import Effect


def shares_of(effects: Sequence[Effect]) -> Array:
    """(m, p): of every prior that the effects may have together, the share of each number's standard deviation; all as likely.

    Parameters
    ----------
    effects : with p numbers together
    """
    every = np.zeros((1, 0))
    for own in map(_shares, effects):
        every = np.hstack([np.repeat(every, len(own), axis=0), np.tile(own, (len(every), 1))])
    return every


def _shares(effect: Effect) -> Array:
    names = [p.name for p in effect.parameters]
    members = effect.members or (tuple(names),)
    there = np.array([[name in member for name in names] for member in members], dtype=float)
    return np.concatenate([size * there for size in effect.sizes])


def log_evidence(data: Array, pull: Array, shares: Array, sided: Sequence[int] | Array = ()) -> Array:
    """(m,): what priors of these shares add to the log evidence of no number at all.

    Parameters
    ----------
    data : (p, p) information of the data, in units of the numbers' standard deviations
    pull : (p,) half the slope of minus chi-square at no number, in the same units
    shares : (m, p)
    sided : numbers that are on one side only

    Examples
    --------
    >>> one = log_evidence(np.array([[3.0]]), np.array([6.0]), np.array([[1.0], [0.0]]))
    >>> (one - [0.5 * 36 / 4 - 0.5 * np.log(4), 0.0]).round(12).tolist()
    [0.0, 0.0]
    """
    scaled = np.eye(len(pull)) + shares[:, :, None] * data * shares[:, None, :]
    pulled = shares * pull
    there = np.linalg.inv(scaled)
    mean = np.einsum("mij,mj->mi", there, pulled)
    logs = 0.5 * (pulled * mean).sum(axis=1) - 0.5 * np.linalg.slogdet(scaled)[1]
    with np.errstate(invalid="ignore"):  # of a fit that has run off a variance may be below zero: it has no evidence
        for k in sided:
            logs = logs + on_its_side(mean[:, k] / np.sqrt(there[:, k, k]))
    return logs


def over_widest(mean: Array, covariance: Array, shares: Array, sided: Sequence[int] | Array = ()) -> Array:
    """(m,): the log evidence of priors of these shares over that of the widest, by the posterior beside the widest.

    A prior that is narrower is the widest with a measurement of nothing beside it. Nothing is taken from a sum that was far
    larger: a number may be known to any part of its prior.

    Parameters
    ----------
    mean : (p,) of the posterior beside the widest prior, in units of the numbers' standard deviations
    covariance : (p, p) of the same
    shares : (m, p), 0 to 1
    sided : numbers that are on one side only

    Examples
    --------
    >>> one = over_widest(np.array([1.5]), np.array([[0.25]]), np.array([[1.0], [0.0]]))
    >>> (one - [0.0, -0.5 * 1.5**2 / 0.25 - 0.5 * np.log(0.25)]).round(12).tolist()
    [0.0, 0.0]
    """
    p = len(mean)
    tight = shares < 1
    rest = np.where(tight, 1 - shares**2, 1.0)
    held = np.where(tight[:, :, None] & tight[:, None, :], covariance, 0.0)
    held[:, range(p), range(p)] += np.where(tight, shares**2 / rest, 1.0)
    away = np.where(tight, mean, 0.0)
    weights = np.linalg.solve(held, away[:, :, None])[:, :, 0]
    logs = -0.5 * ((away * weights).sum(axis=1) + np.linalg.slogdet(held)[1] + np.log(rest).sum(axis=1))
    for k in sided:
        across = np.where(tight, covariance[k], 0.0)
        at = mean[k] - (across * weights).sum(axis=1)
        taken = (across * np.linalg.solve(held, across[:, :, None])[:, :, 0]).sum(axis=1)
        left = covariance[k, k] - taken
        there = (shares[:, k] > 0) & (left > 0)
        logs = logs + on_its_side(np.where(there, at / np.sqrt(np.where(there, left, 1.0)), 0.0))
    return logs


def mixed(logs: Array) -> float:
    """Log evidence of priors that are as likely, by theirs.

    Parameters
    ----------
    logs : (m,)
    """
    return float(logsumexp(logs) - np.log(len(logs)))


def on_its_side(z: Array) -> Array:
    """What a one-sided prior adds to the log evidence: log of twice the probability that a number, z of its own standard deviations
    on its side, is there.

    Parameters
    ----------
    z : any shape
    """
    return np.log(2) + log_ndtr(z)


__all__ = ["log_evidence", "mixed", "on_its_side", "over_widest", "shares_of"]
