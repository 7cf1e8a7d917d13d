"""Normal matrices of many runs: a run's own parameters meet those of no other run, only the shared ones.

Such a matrix is an arrow: a block of each run, a border of the shared parameters. Each run's own are eliminated by themselves
(Schur complement), so that solving and inverting cost as much per run whatever their number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...simulate.model import Array

LEAST = 1e-15
"""A direction of less information than this, in a matrix whose diagonal is 1, is rounding and may come out below 0: it has this."""


@dataclass(frozen=True)
class Layout:
    """Where each run's own parameters stand in a parameter vector: one run after the other, shared ones before and behind.

    Attributes
    ----------
    begin : of the first run's
    own : parameters of a run
    runs : their number
    size : of the parameter vector
    """

    begin: int
    own: int
    runs: int
    size: int

    @property
    def end(self) -> int:
        """Behind the last run's."""
        return self.begin + self.own * self.runs

    @property
    def shared(self) -> NDArray[np.int_]:
        """Places of the shared parameters, (s,)."""
        return np.concatenate([np.arange(self.begin), np.arange(self.end, self.size)])

    def own_of(self, run: int) -> NDArray[np.int_]:
        """Places of a run's own."""
        at = self.begin + self.own * run
        return np.arange(at, at + self.own)

    def split(self, values: Array) -> tuple[Array, Array]:
        """Shared (s,) and own (runs, own) of a vector over all parameters."""
        return values[self.shared], values[self.begin : self.end].reshape(self.runs, self.own)

    def whole(self, shared: Array, own: Array) -> Array:
        """The vector over all parameters."""
        found = np.empty(self.size, dtype=shared.dtype)
        found[self.shared], found[self.begin : self.end] = shared, own.ravel()
        return found

    def places(self, columns: NDArray[np.int_]) -> Iterator[tuple[int, NDArray[np.int_], NDArray[np.int_]]]:
        """Run by run among ``columns`` (-1: shared): the run, which of the columns are its own, and their places there."""
        inside = (columns >= self.begin) & (columns < self.end)
        run = np.where(inside, (columns - self.begin) // self.own, -1)
        place = np.where(
            inside,
            (columns - self.begin) % self.own,
            columns - np.where(columns >= self.end, self.end - self.begin, 0),
        )
        for number in np.unique(run):
            at = np.flatnonzero(run == number)
            yield int(number), at, place[at]


@dataclass
class Arrow:
    """A symmetric matrix over all parameters.

    Attributes
    ----------
    layout : of the parameters
    shared : (s, s)
    border : (runs, own, s), each run's own with the shared
    own : (runs, own, own)
    """

    layout: Layout
    shared: Array
    border: Array
    own: Array

    @classmethod
    def zeros(cls, layout: Layout) -> Arrow:
        """Nothing yet."""
        s, runs, own = len(layout.shared), layout.runs, layout.own
        return cls(layout, np.zeros((s, s)), np.zeros((runs, own, s)), np.zeros((runs, own, own)))

    def copy(self) -> Arrow:
        """One that can be added to."""
        return Arrow(self.layout, self.shared.copy(), self.border.copy(), self.own.copy())

    def add(self, columns: NDArray[np.int_], block: Array) -> None:
        """Add ``block`` (k, k) at the places ``columns`` (k,), which are shared ones and one run's own."""
        parts = {run: (at, place) for run, at, place in self.layout.places(columns)}
        at, place = parts.pop(-1, (np.zeros(0, dtype=int), np.zeros(0, dtype=int)))
        self.shared[np.ix_(place, place)] += block[np.ix_(at, at)]
        if len(parts) > 1:
            raise ValueError("parameters of two runs do not meet")
        for run, (mine, here) in parts.items():
            self.own[run][np.ix_(here, here)] += block[np.ix_(mine, mine)]
            self.border[run][np.ix_(here, place)] += block[np.ix_(mine, at)]

    def add_diagonal(self, columns: NDArray[np.int_], values: Array) -> None:
        """Add to the diagonal; a place may come several times."""
        for run, at, place in self.layout.places(columns):
            np.add.at(self.shared if run < 0 else self.own[run], (place, place), values[at])

    @property
    def diagonal(self) -> Array:
        """Over all parameters."""
        return self.layout.whole(np.diag(self.shared), np.diagonal(self.own, axis1=1, axis2=2))

    def dense(self) -> Array:
        """The whole matrix, (size, size): for few runs."""
        found = np.zeros((self.layout.size, self.layout.size))
        shared = self.layout.shared
        found[np.ix_(shared, shared)] = self.shared
        for run in range(self.layout.runs):
            own = self.layout.own_of(run)
            found[np.ix_(own, own)] = self.own[run]
            found[np.ix_(own, shared)] = self.border[run]
            found[np.ix_(shared, own)] = self.border[run].T
        return found

    def times(self, vector: Array) -> Array:
        """The matrix times a vector over all parameters."""
        shared, own = self.layout.split(vector)
        return self.layout.whole(
            self.shared @ shared + np.einsum("ros,ro->s", self.border, own),
            self.border @ shared + np.einsum("rop,rp->ro", self.own, own),
        )

    def scaled(self, scale: Array) -> Arrow:
        """Rows and columns divided by ``scale`` (size,)."""
        shared, own = self.layout.split(scale)
        return Arrow(
            self.layout,
            self.shared / shared[:, None] / shared[None, :],
            self.border / own[:, :, None] / shared[None, None, :],
            self.own / own[:, :, None] / own[:, None, :],
        )

    def held(self, free: NDArray[np.bool_]) -> Arrow:
        """What is not ``free`` cut off: rows and columns 0, diagonal 1."""
        shared, own = self.layout.split(free)
        found = Arrow(
            self.layout,
            self.shared * (shared[:, None] & shared[None, :]),
            self.border * (own[:, :, None] & shared[None, None, :]),
            self.own * (own[:, :, None] & own[:, None, :]),
        )
        found.shared += np.diag(~shared)
        found.own += np.eye(self.layout.own) * ~own[:, None, :]
        return found

    def solve(self, right: Array, damping: float = 0.0) -> Array:
        """(matrix + damping I)^-1 right, over all parameters."""
        shared, own = self.layout.split(right)
        one = np.eye(self.layout.own)
        both = np.linalg.solve(self.own + damping * one, np.concatenate([self.border, own[:, :, None]], axis=2))
        towards, alone = both[:, :, :-1], both[:, :, -1]
        left = self.shared + damping * np.eye(len(shared)) - np.einsum("ros,rot->st", self.border, towards)
        found = np.linalg.solve(left, shared - np.einsum("ros,ro->s", self.border, alone))
        return self.layout.whole(found, alone - towards @ found)


@dataclass(frozen=True)
class Inverse:
    """Inverse of an information: shared block, and each run's own by what they take over from it.

    Attributes
    ----------
    layout : of the parameters
    shared : (s, s), covariance of the shared parameters
    towards : (runs, own, s), change of a run's own estimate against one of the shared, with the sign turned
    own : (runs, own, own), covariance of a run's own, were the shared known
    """

    layout: Layout
    shared: Array
    towards: Array
    own: Array

    @cached_property
    def _apart(self) -> Array:
        return self.towards @ self.shared

    def of(self, columns: NDArray[np.int_]) -> Array:
        """Covariance (k, k) of the parameters ``columns`` (k,), shared ones and one run's own."""
        rows = self.rows(columns)
        found = rows @ self.shared @ rows.T
        for run, at, place in self.layout.places(columns):
            if run >= 0:
                found[np.ix_(at, at)] += self.own[run][np.ix_(place, place)]
        return found

    def rows(self, columns: NDArray[np.int_]) -> Array:
        """(k, s): how the parameters ``columns`` go with the shared ones, the run's own fitted anew."""
        found = np.zeros((len(columns), len(self.shared)))
        for run, at, place in self.layout.places(columns):
            found[at] = np.eye(len(self.shared))[place] if run < 0 else -self.towards[run, place]
        return found

    @property
    def variance(self) -> Array:
        """Diagonal over all parameters."""
        own = np.diagonal(self.own, axis1=1, axis2=2) + np.einsum("ros,ros->ro", self._apart, self.towards)
        return self.layout.whole(np.diag(self.shared), own)


def inverse_of(information: Arrow, free: NDArray[np.bool_]) -> Inverse:
    """Covariance of an information; zero where a parameter is not free, and where nothing is known at all.

    Parameters
    ----------
    information : of the whole parameter vector
    free : (size,) of bool
    """
    layout = information.layout
    free_shared, free_own = layout.split(free)
    scale = np.sqrt(information.diagonal)
    scale = np.where((scale > 0) & free, scale, 1.0)
    inner = information.held(free).scaled(scale)
    # the root of a run's inverse, so that what is subtracted from the shared block is a square, and rounding no more than that
    root = _inverse_root(inner.own)
    half = root.transpose(0, 2, 1) @ inner.border
    towards, own = root @ half, root @ root.transpose(0, 2, 1)
    root = _inverse_root(inner.shared - np.einsum("ros,rot->st", half, half))
    shared = root @ root.T
    across, along = layout.split(scale)
    return Inverse(
        layout,
        shared / across[:, None] / across[None, :] * (free_shared[:, None] & free_shared[None, :]),
        towards / along[:, :, None] * across[None, None, :] * free_own[:, :, None],
        own / along[:, :, None] / along[:, None, :] * (free_own[:, :, None] & free_own[:, None, :]),
    )


def _inverse_root(matrices: Array) -> Array:
    """R (..., k, k) with R R' = inverse, of matrices whose diagonals were 1 before anything was subtracted."""
    values, vectors = np.linalg.eigh(matrices)
    return vectors / np.sqrt(np.maximum(values, LEAST))[..., None, :]


def widened(inverse: Inverse, more: list[tuple[NDArray[np.int_], Array]]) -> tuple[Array, Array]:
    """The sandwich inverse (information + more) inverse, where ``more`` adds to the variance of the score.

    Parameters
    ----------
    inverse : of the information
    more : (columns (k,), block (k, k)) of each run, in their order

    Returns
    -------
    covariance of the shared parameters (s, s), and variances over all parameters (size,)
    """
    layout = inverse.layout
    rows = [inverse.rows(columns) for columns, _ in more]
    total = sum((w.T @ block @ w for w, (_, block) in zip(rows, more, strict=True)), np.zeros_like(inverse.shared))
    spread = inverse.shared @ total @ inverse.shared
    own = np.einsum("ros,st,rot->ro", inverse.towards, spread, inverse.towards)
    for w, (columns, block) in zip(rows, more, strict=True):
        for number, at, place in layout.places(columns):
            if number < 0:
                continue
            alone = np.zeros((layout.own, len(columns)))
            alone[:, at] = inverse.own[number][:, place]
            through = -inverse.towards[number] @ inverse.shared @ w.T
            own[number] += np.einsum("ok,kl,ol->o", alone, block, alone) + 2 * np.einsum(
                "ok,kl,ol->o", alone, block, through
            )
    return inverse.shared + spread, inverse.variance + layout.whole(np.diag(spread), own)


@dataclass(frozen=True)
class Shares:
    """What each run says of the shared parameters at an optimum, its own parameters fitted anew at each of their values.

    Attributes
    ----------
    information : (runs, s, s)
    score : (runs, s), half the slope of its -2 log L, sign turned
    meat : (runs, s, s), variance of the score beyond the information
    known, pull : (s, s) and (s,), information and score of what is known beside the runs
    free : (s,)
    """

    information: Array
    score: Array
    meat: Array
    known: Array
    pull: Array
    free: NDArray[np.bool_]

    def without(self, run: int) -> tuple[Array, Array]:
        """Step (s,) from the optimum to that of all other runs, by quadratics, and its covariance (s, s)."""
        inverse = inverted(self.known + self.information.sum(axis=0) - self.information[run], self.free)
        return -inverse @ self.score[run], self._covariance(inverse, self.meat.sum(axis=0) - self.meat[run])

    def alone(self, run: int) -> tuple[Array, Array]:
        """Step to the optimum of this run by itself and its covariance."""
        inverse = inverted(self.known + self.information[run], self.free)
        return inverse @ (self.pull + self.score[run]), self._covariance(inverse, self.meat[run])

    def drop(self, run: int, held: int) -> float:
        """How much lower -2 log L of a run is at its own optimum than with the first ``held`` shared ones as they are."""
        matrix, slope = self.known + self.information[run], self.pull + self.score[run]
        rest = self.free & (np.arange(len(slope)) >= held)
        return float(slope @ (inverted(matrix, self.free) - inverted(matrix, rest)) @ slope)

    @staticmethod
    def _covariance(inverse: Array, meat: Array) -> Array:
        return inverse + inverse @ meat @ inverse


def inverted(information: Array, free: NDArray[np.bool_]) -> Array:
    """Inverse (s, s) of a dense information; 0 where not free.

    Parameters
    ----------
    information : (s, s)
    free : (s,) of bool
    """
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    known = free & (scale > 0)
    scale = np.where(known, scale, 1.0)
    inner = information / scale[:, None] / scale * (known[:, None] & known)
    root = _inverse_root(inner + np.diag(~known)) * known[:, None] / scale[:, None]
    return root @ root.T


Part = tuple[NDArray[np.int_], Array, Array, Array]
"""Of a run: columns (k,), its information (k, k), score (k,), and the score's further variance (k, k)."""


def shares_of(prior: Arrow, pull: Array, inverse: Inverse, free: NDArray[np.bool_], parts: list[Part]) -> Shares:
    """Every run's share.

    Parameters
    ----------
    prior, pull : information and score (size,) of what is known beside the runs
    inverse : of the whole information
    free : (size,)
    parts : each run's information and score
    """
    layout = prior.layout
    pull_shared, pull_own = layout.split(pull)
    information, score, meat = [], [], []
    for run, (columns, block, slope, more) in enumerate(parts):
        rows, towards = inverse.rows(columns), inverse.towards[run]
        information.append(rows.T @ block @ rows + towards.T @ prior.own[run] @ towards)
        score.append(rows.T @ slope - towards.T @ pull_own[run])
        meat.append(rows.T @ more @ rows)
    return Shares(
        np.array(information), np.array(score), np.array(meat), prior.shared, pull_shared, layout.split(free)[0]
    )
