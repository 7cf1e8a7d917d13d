"""Two matched views -> one course of poses on the first camera's clock, with its frames' covariance and its common modes.

Where both cameras see the model each pose is weighed by its covariance, after what the match found of the common errors was
taken from both; where one sees it, that one stands alone, corrected in the same way, so that nothing steps where a view ends but by
what the match leaves open. The modes are the cameras' own, turned by the root of their covariance after the match: what the match
does not tell keeps its unit variance and stays what it was, so that runs of one set-up may go on sharing it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..camera import Array
from .match import Match
from .view import View, between, rates

NEITHER, FIRST, SECOND, BOTH = 0, 1, 2, 3
"""Which camera a row is from: BOTH is FIRST + SECOND."""


@dataclass(frozen=True)
class Joined:
    """One course of poses.

    Attributes
    ----------
    t_s : (n,), the first camera's clock
    pose, covariance : (n, D), (n, D, D); NaN where neither sees the model
    modes : (k, n, D), change with each unit-variance common mode: the slow ones, then those that stay, the marks' own, and
        two of the clock
    slow : so many of the modes, the first ones, are pulls and lags
    source : (n,) of NEITHER, FIRST, SECOND, BOTH
    """

    t_s: Array
    pose: Array
    covariance: Array
    modes: Array
    slow: int
    source: NDArray[np.int_]


def join_views(match: Match, alone: bool = False) -> Joined:
    """Join two views.

    Parameters
    ----------
    match : of the two
    alone : where both see the model the first one counts alone: of a clock that is not told yet, the second one adds nothing then
    """
    first, second, clock = match.first, match.second, match.clock
    own_s = clock.first(second.t_s)
    aside = (own_s < first.t_s[0] - second.step_s / 2) | (own_s > first.t_s[-1] + second.step_s / 2)
    before = np.flatnonzero(aside & (own_s < first.t_s[0]))
    after = np.flatnonzero(aside & (own_s > first.t_s[0]))
    t_s = np.concatenate([own_s[before], first.t_s, own_s[after]])
    middle = slice(len(before), len(before) + len(first.t_s))
    one = _spread(first, len(t_s), middle)
    two = _beside(match, len(t_s), middle, before, after)
    if alone:
        two = replace(two, seen=two.seen & ~one.seen)
    modes = _root(match)
    first_modes, second_modes = _in_order(match, one.modes, two.modes, two.rate, two.second_s)
    values = np.concatenate([np.zeros(2), match.values])
    pose = [
        part.pose - np.einsum("knd,k->nd", by_mode, values)
        for part, by_mode in ((one, first_modes), (two, second_modes))
    ]
    size = first.pose.shape[1]
    weight = [_weight(part.covariance, part.seen) for part in (one, two)]
    total = weight[0] + weight[1]
    known = one.seen | two.seen
    covariance = np.linalg.inv(np.where(known[:, None, None], total, np.eye(size)))
    share = [covariance @ w for w in weight]
    joined = sum(np.einsum("nij,nj->ni", s, np.nan_to_num(p)) for s, p in zip(share, pose, strict=True))
    by_mode = sum(
        np.einsum("nij,knj->kni", s, np.nan_to_num(m)) for s, m in zip(share, (first_modes, second_modes), strict=True)
    )
    turned = np.einsum("knd,kl->lnd", by_mode, modes)
    order = _slow_first(match)
    return Joined(
        t_s,
        np.where(known[:, None], joined, np.nan),
        np.where(known[:, None, None], covariance, np.nan),
        turned[order],
        first.slow + second.slow,
        one.seen * FIRST + two.seen * SECOND,
    )


@dataclass(frozen=True)
class _Part:
    """What one camera says at the joined times: NaN and False where it does not see the model."""

    pose: Array
    covariance: Array
    modes: Array
    seen: NDArray[np.bool_]
    rate: Array
    second_s: Array


def _spread(view: View, n: int, place: slice) -> _Part:
    """The first camera's, at its own frames."""
    size = view.pose.shape[1]
    pose, covariance = np.full((n, size), np.nan), np.full((n, size, size), np.nan)
    modes, seen = np.zeros((len(view.modes), n, size)), np.zeros(n, dtype=bool)
    pose[place], covariance[place], modes[:, place], seen[place] = view.pose, view.covariance, view.modes, view.seen
    return _Part(pose, covariance, modes, seen, np.zeros((n, size)), np.zeros(n))


def _beside(match: Match, n: int, place: slice, before: NDArray[np.int_], after: NDArray[np.int_]) -> _Part:
    """The second camera's: between its frames where the first one filmed, at its frames elsewhere."""
    view, size = match.second, match.second.pose.shape[1]
    pose, covariance = np.full((n, size), np.nan), np.full((n, size, size), np.nan)
    modes, seen = np.zeros((len(view.modes), n, size)), np.zeros(n, dtype=bool)
    second_s = np.zeros(n)
    second_s[place] = match.clock.second(match.first.t_s)
    at = between(view, second_s[place])
    pose[place] = np.where(at.told[:, None], at.of(view.pose), np.nan)
    covariance[place] = np.where(at.told[:, None, None], at.covariance(view.covariance), np.nan)
    for index, mode in enumerate(view.modes):
        modes[index, place] = at.of(mode)
    seen[place] = at.told
    for where, frames in ((slice(0, len(before)), before), (slice(n - len(after), n), after)):
        pose[where], covariance[where] = view.pose[frames], view.covariance[frames]
        modes[:, where], seen[where], second_s[where] = view.modes[:, frames], view.seen[frames], view.t_s[frames]
    return _Part(pose, covariance, modes, seen, rates(view, second_s), second_s)


def _weight(covariance: Array, seen: NDArray[np.bool_]) -> Array:
    """Inverse covariance; 0 where not seen."""
    size = covariance.shape[1]
    return np.where(seen[:, None, None], np.linalg.inv(np.where(seen[:, None, None], covariance, np.eye(size))), 0.0)


def _in_order(match: Match, one: Array, two: Array, rate: Array, second_s: Array) -> tuple[Array, Array]:
    """Both cameras' modes in the order of ``Match.covariance``: the clock's two, the first's own, the second's own, the shared."""
    first, second = match.first, match.second
    clock = np.stack([rate, rate * ((second_s - match.middle_s) / match.span_s)[:, None]])
    none = np.zeros_like(clock)
    return (
        np.concatenate([none, one[: first.own], np.zeros_like(two[: second.own]), one[first.own :]]),
        np.concatenate([clock, np.zeros_like(one[: first.own]), two[: second.own], two[second.own :]]),
    )


def _root(match: Match) -> Array:
    """Symmetric root of the modes' covariance after the match, the clock counted in its own standard deviations."""
    scale = np.ones(len(match.covariance))
    scale[:2] = np.sqrt(np.diag(match.covariance)[:2])
    share, mixture = np.linalg.eigh(match.covariance / np.outer(scale, scale))
    root = (mixture * np.sqrt(np.maximum(share, 0.0))) @ mixture.T
    return match.widened * scale[:, None] * root


def _slow_first(match: Match) -> NDArray[np.int_]:
    """Places of the joined modes: both cameras' slow ones, then theirs that stay, the shared, the clock's."""
    first, second = match.first, match.second
    one, two = 2 + np.arange(first.own), 2 + first.own + np.arange(second.own)
    shared = 2 + first.own + second.own + np.arange(first.shared)
    return np.concatenate(
        [one[: first.slow], two[: second.slow], one[first.slow :], two[second.slow :], shared, [0, 1]]
    )


__all__ = ["BOTH", "FIRST", "NEITHER", "SECOND", "Joined", "join_views"]
