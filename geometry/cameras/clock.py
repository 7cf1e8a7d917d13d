"""The second camera's clock against the first one's, and where on it a search may begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..camera import Array
from .view import View

RIVAL = 100.0
"""And no offset whose dip is so many times shallower than the deepest: its difference is ten times as large."""
GRID_S = 0.05
"""Offsets are tried so far apart, and the poses thinned to such steps: a swing of 4 s moves by 1/80 of its period."""
LEAST_TOGETHER_S = 3.0
"""The model must be seen by both cameras for so long at least: a choice, about a swing."""
LEAST_SHARE = 0.2
"""And for so much of what the shorter of the two saw: two ends that happen to look alike are no proof."""
STARTS = 6
"""So many of the best offsets are looked at closely: a swing that dies away has a dip for each of its periods."""


@dataclass(frozen=True)
class Clock:
    """t_first = offset_s + (1 + rate) t_second.

    Attributes
    ----------
    offset_s : what the first camera's clock shows when the second one's shows 0
    rate : how much faster the first one's clock runs, relative
    covariance : (2, 2) of (offset_s, rate)
    """

    offset_s: float
    rate: float
    covariance: Array

    @property
    def offset_sd_s(self) -> float:
        """Standard deviation of offset_s."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def rate_sd(self) -> float:
        """Standard deviation of rate."""
        return float(np.sqrt(self.covariance[1, 1]))

    def first(self, second_s: Array) -> Array:
        """Times of the second camera on the first one's clock."""
        return self.offset_s + (1 + self.rate) * second_s

    def second(self, first_s: Array) -> Array:
        """Times of the first camera on the second one's clock."""
        return (first_s - self.offset_s) / (1 + self.rate)

    def sd_at(self, second_s: Array) -> Array:
        """Standard deviation of ``first`` at times of the second camera, s."""
        slope = np.stack([np.ones_like(second_s), second_s], axis=-1)
        return np.sqrt(np.einsum("...i,ij,...j->...", slope, self.covariance, slope))


@dataclass(frozen=True)
class Start:
    """An offset to begin from. ``misfit`` is that of the rough curves, in squares of what a swing is."""

    offset_s: float
    misfit: float


def starts(first: View, second: View, within_s: tuple[float, float] | None = None) -> list[Start]:
    """Offsets at which the two cameras' poses look alike, the best first; none where the model is never seen long enough by both.

    Constant differences are taken out: a camera may be off by them. Poses are compared by their own size, component by component.

    Parameters
    ----------
    first, second : two views
    within_s : least and largest offset; None: wherever the two overlap long enough
    """
    rough = [_gridded(view) for view in (first, second)]
    if any(grid is None for grid in rough):
        return []
    (from_a, a), (from_b, b) = rough[0], rough[1]  # type: ignore[misc]
    a, b = _by_size([a, b])
    least = max(LEAST_TOGETHER_S, LEAST_SHARE * GRID_S * min(np.isfinite(v).all(axis=1).sum() for v in (a, b))) / GRID_S
    shifts = np.arange(-len(b) + 1, len(a))  # b's sample k stands beside a's sample k + shift
    offsets = from_a - from_b + shifts * GRID_S
    if within_s is not None:
        asked = (offsets >= within_s[0] - GRID_S) & (offsets <= within_s[1] + GRID_S)
        shifts, offsets = shifts[asked], offsets[asked]
    misfit = np.full(len(shifts), np.inf)
    for place, shift in enumerate(shifts):
        low, high = max(0, shift), min(len(a), len(b) + shift)
        if high - low < least:
            continue
        gap = a[low:high] - b[low - shift : high - shift]
        gap = gap[np.isfinite(gap).all(axis=1)]
        if len(gap) >= least:
            misfit[place] = ((gap - gap.mean(axis=0)) ** 2).mean()
    return _lowest(offsets, misfit)


def _lowest(offsets: Array, misfit: Array) -> list[Start]:
    """The deepest dips, each by the parabola through its three lowest offsets: at the right one little is left."""
    left, right = np.r_[np.inf, misfit[:-1]], np.r_[misfit[1:], np.inf]
    found = []
    for k in np.flatnonzero(np.isfinite(misfit) & (misfit <= left) & (misfit <= right)):
        move, deep = 0.0, misfit[k]
        bend = left[k] + right[k] - 2 * misfit[k]
        if np.isfinite(bend) and bend > 0:
            move = 0.5 * (left[k] - right[k]) / bend
            deep -= (left[k] - right[k]) ** 2 / (8 * bend)
        found.append(Start(float(offsets[k] + move * GRID_S), float(deep)))
    found.sort(key=lambda start: start.misfit)
    return [start for start in found[:STARTS] if start.misfit < RIVAL * found[0].misfit or start is found[0]]


def _gridded(view: View) -> tuple[float, Array] | None:
    """(begin, (n, D)) poses at steps of ``GRID_S`` from the first on; NaN where the model is not seen; None: hardly ever."""
    seen = np.flatnonzero(view.seen)
    if len(seen) < 2:
        return None
    times = view.t_s[seen]
    grid = np.arange(times[0], times[-1] + GRID_S / 2, GRID_S)
    poses = np.column_stack([np.interp(grid, times, column) for column in view.pose[seen].T])
    after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
    poses[times[after] - times[after - 1] > max(4 * GRID_S, 2.5 * view.step_s)] = np.nan
    return float(times[0]), poses


def _by_size(grids: Sequence[Array]) -> list[Array]:
    """Poses over what they vary by, both cameras together; what hardly varies beside the rest of its kind counts by the rest."""
    spread = np.sqrt(np.mean([np.nanvar(grid, axis=0) for grid in grids], axis=0))
    # lengths by the largest of the lengths: x of a tow stands still, and its noise is no motion
    lengths = np.zeros(len(spread), dtype=bool)
    lengths[[0, 1, *range(3, min(4, len(spread)))]] = True
    size = np.where(lengths, spread[lengths].max(), spread[~lengths].max())
    return [grid / np.where(size > 0, size, 1.0) for grid in grids]


__all__ = ["Clock", "Start", "starts"]
