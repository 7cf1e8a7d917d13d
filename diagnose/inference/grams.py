"""Normal equations of a campaign under one noise, for many sizes of its random forces at the cost of a few."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtrs

from ...simulate.model import Array
from .noise import Forces, Noise


@dataclass(frozen=True)
class Columns:
    """What a run says: one residual column, then slopes by shared numbers, then by the run's own.

    Attributes
    ----------
    tables : per run (n, 4, 1 + shared + own)
    shared : how many shared numbers
    """

    tables: list[Array]
    shared: int


class Grams:
    """Inner products of all columns, whitened.

    Parameters
    ----------
    columns, noise : of one linearisation
    only : these runs; None: all
    """

    def __init__(self, columns: Columns, noise: Noise, only: Sequence[int] | None = None) -> None:
        self.runs = list(range(len(columns.tables)) if only is None else only)
        self.shared, self._noise = columns.shared, noise
        parts = [noise.white(i, columns.tables[i]) for i in self.runs]
        self._moving = [moving for moving, _ in parts]
        self._whole = np.array([m.T @ m + s.T @ s for m, s in parts])
        self._measured = np.array([noise.runs[i].log for i in self.runs])
        self._shown: dict[int, list[Array]] = {}
        self._stretches: dict[tuple[int, tuple[int, ...]], _Stretch] = {}
        self._last: tuple[Forces, Array, Array] | None = None

    def at(self, forces: Forces) -> tuple[Array, Array]:
        """Inner products (runs, m, m) and log determinants of the noise (runs,); not to be written to."""
        if self._last is None or self._last[0] != forces:
            self._last = (forces, *self._at(forces))
        return self._last[1:]

    def _at(self, forces: Forces) -> tuple[Array, Array]:
        stretch = self._stretched(forces)
        total = forces.side_n**2 * stretch.by_force[0] + forces.moment_n_m**2 * stretch.by_force[1]
        total.reshape(len(total), -1)[:, :: total.shape[1] + 1] += 1.0
        lower = np.linalg.cholesky(total)
        logs = self._measured + 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        whole = stretch.rest.copy()
        for k, (one, shown) in enumerate(zip(lower, stretch.shown, strict=True)):
            white = _forward(one, shown)
            whole[k] += white.T @ white
        return whole, logs

    def _stretched(self, forces: Forces) -> _Stretch:
        """Where forces of this size show, of all runs side by side."""
        time, spaces = forces.time, [self._noise.space(i, forces.time) for i in self.runs]
        wide = tuple(s.wide(forces) for s in spaces)
        if (time, wide) not in self._stretches:
            if time not in self._shown:
                self._shown[time] = [s.base.T @ moving for s, moving in zip(spaces, self._moving, strict=True)]
            shown = np.zeros((len(spaces), max(wide), self._whole.shape[1]))
            by_force = np.zeros((2, len(spaces), max(wide), max(wide)))
            for i, (space, k) in enumerate(zip(spaces, wide, strict=True)):
                shown[i, :k] = self._shown[time][i][:k]
                by_force[:, i, :k, :k] = space.by_force[:, :k, :k]
            self._stretches[time, wide] = _Stretch(shown, by_force, self._whole - shown.transpose(0, 2, 1) @ shown)
        return self._stretches[time, wide]


@dataclass(frozen=True)
class _Stretch:
    """The first directions in which forces of one time constant show, of all runs; nothing stands in those that a run needs not.

    Attributes
    ----------
    shown : (runs, k, m), the columns there
    by_force : (2, runs, k, k), covariance by a unit side force and a unit moment
    rest : (runs, m, m), inner products of what does not show there
    """

    shown: Array
    by_force: Array
    rest: Array


def _forward(lower: Array, right: Array) -> Array:
    """Solve ``lower`` x = ``right``; the two are not looked at for what is no number."""
    answer, _ = dtrtrs(lower.T, right, lower=0, trans=1)
    return answer


@dataclass(frozen=True)
class Reduced:
    """Normal equations of the shared numbers, the runs' own eliminated; without the shared numbers' priors.

    Attributes
    ----------
    matrix, right : of the shared numbers, summed over the runs
    before, chi_square : whitened residuals as they stand (but for the modes, which no hypothesis holds: they are fitted), and with
        each run's own numbers fitted
    log : log determinants of the noise and of the own numbers
    inverse, cross, to_own : per run: how the own numbers follow from the shared ones
    """

    matrix: Array
    right: Array
    before: float
    chi_square: float
    log: float
    inverse: Array
    cross: Array
    to_own: Array

    def own_step(self, shared: Array) -> Array:
        """(runs, own) step of the own numbers beside a step of the shared ones."""
        return np.einsum("nij,nj->ni", self.inverse, self.to_own - self.cross @ shared)


def reduced(
    grams: Grams,
    forces: Forces,
    away: Array,
    sd: Array,
    only: Sequence[int] | None = None,
    modes: slice = slice(0, 0),
) -> Reduced:
    """Eliminate the runs' own numbers.

    Parameters
    ----------
    grams : sums over the runs' samples
    forces : random forces on the hull
    away, sd : (runs, own) of all runs: from the numbers to their priors' means, and the priors' standard deviations
    only : positions among the grams' runs; None: all
    modes : which of the shared numbers are the cameras' modes, of unit variance
    """
    whole, logs = grams.at(forces)
    chosen = np.arange(len(grams.runs)) if only is None else np.asarray(only)
    whole, logs = whole[chosen], logs[chosen]
    at = np.asarray(grams.runs)[chosen]
    away, sd = away[at], sd[at]
    shared, own = slice(1, 1 + grams.shared), slice(1 + grams.shared, None)
    inner = whole[:, own, own] + np.einsum("ni,ij->nij", sd**-2.0, np.eye(sd.shape[1]))
    to_own = whole[:, own, 0] + away / sd**2
    cross = whole[:, own, shared]
    inverse = np.linalg.inv(inner)
    followed = inverse @ cross
    matrix = (whole[:, shared, shared] - cross.transpose(0, 2, 1) @ followed).sum(axis=0)
    right = (whole[:, shared, 0] - np.einsum("nij,ni->nj", followed, to_own)).sum(axis=0)
    before = float(whole[:, 0, 0].sum() + (away**2 / sd**2).sum())
    alone = whole[:, shared, 0].sum(axis=0)[modes]
    fitted = whole[:, shared, shared].sum(axis=0)[modes, modes] + np.eye(len(alone))
    still = before - float(alone @ np.linalg.solve(fitted, alone))
    left = before - float(np.einsum("ni,nij,nj->", to_own, inverse, to_own))
    log = float(logs.sum() + np.linalg.slogdet(inner)[1].sum() + 2 * np.log(sd).sum())
    return Reduced(matrix, right, still, left, log, inverse, cross, to_own)


__all__ = ["Columns", "Grams", "Reduced", "reduced"]
