"""Normal equations of a campaign under one noise, for many sizes of its random forces at the cost of a few."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from ...simulate.model import Array
from .noise import Forces, Noise, shown_covariance


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
        self._shown: dict[tuple[int, int], Array] = {}
        self._stretches: dict[tuple[int, int, int], _Stretch] = {}
        self._last: tuple[Forces, Array, Array] | None = None

    def at(self, forces: Forces) -> tuple[Array, Array]:
        """Inner products (runs, m, m) and log determinants of the noise (runs,); not to be written to."""
        if self._last is None or self._last[0] != forces:
            self._last = (forces, *self._at(forces))
        return self._last[1:]

    def _at(self, forces: Forces) -> tuple[Array, Array]:
        whole, logs = np.empty_like(self._whole), self._measured.copy()
        potrf, trtrs = get_lapack_funcs(("potrf", "trtrs"), dtype=float)
        for k, part in enumerate(self._stretched(forces)):
            # one run after the other: each fits a processor's cache
            lower, failed = potrf(shown_covariance(part.by_force, forces).T, lower=0, overwrite_a=1, clean=0)
            if failed:
                raise np.linalg.LinAlgError("the noise's covariance is not positive definite")
            logs[k] += 2 * float(np.log(np.diagonal(lower)).sum())
            white, _ = trtrs(lower, part.shown, lower=0, trans=1)
            np.add(part.rest, white.T @ white, out=whole[k])
        return whole, logs

    def _stretched(self, forces: Forces) -> list[_Stretch]:
        """Where forces of this size show in each run."""
        found = []
        for i, moving, whole in zip(self.runs, self._moving, self._whole, strict=True):
            space = self._noise.space(i, forces.time)
            key = (i, forces.time, space.wide(forces))
            if key not in self._stretches:
                if key[:2] not in self._shown:
                    self._shown[key[:2]] = space.base.T @ moving
                shown = self._shown[key[:2]][: key[2]]
                by_force = np.ascontiguousarray(space.by_force[:, : key[2], : key[2]])
                self._stretches[key] = _Stretch(np.asfortranarray(shown), by_force, whole - shown.T @ shown)
            found.append(self._stretches[key])
        return found


@dataclass(frozen=True)
class _Stretch:
    """The first directions in which forces of one time constant show in a run.

    Attributes
    ----------
    shown : (k, m), the columns there
    by_force : (2, k, k), covariance by a unit side force and a unit moment
    rest : (m, m), inner products of what does not show there
    """

    shown: Array
    by_force: Array
    rest: Array


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
