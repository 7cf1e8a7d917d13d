"""The measurement's own noise in the means of blocks, from the static records of all runs of one camera.

A record of 12 s holds some thirty means: alone it tells their variance to a quarter and their colour hardly at all, and a wrong one
looks like a gap. The records of one camera share a colour, and nearly share a size: both are found together, by restricted
likelihood, and a record keeps of its own size what the records' scatter about the common one shows to be real. Channels that come
from the same pixels err together: a camera that shakes moves y and, where its two marks are not equally far, beta with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert
from scipy.optimize import minimize

from ...simulate.model import Array

FEWEST_MEANS = 12
"""Fewer in the longest record tell no colour: a choice."""
LONGEST = 150
"""Means that are looked at together; a longer record is taken in stretches, each with a mean of its own: for time."""
STARTS = ((0.5, 2.0), (0.8, 8.0))
"""White share and time constant, in steps, from which the search begins."""
ROUNDS, SAME_SIZE = 3, 0.1
"""A colour is found of records of one size: in so many rounds, unless the sizes differ by less than this share."""
LEAST, MOST = 1e-2, 1e2
"""A root of a variance, in units of the records' own, is between these."""


@dataclass(frozen=True)
class StillNoise:
    """Of channels that err together, in one run; in units of the variance that the stated sigmas give a block's mean.

    Attributes
    ----------
    white, slow : (k, k), covariance of the white part and of the lasting one
    time_s : time constant of the lasting one
    """

    white: Array
    slow: Array
    time_s: float

    def covariance(self, one: int, other: int, lag_s: Array) -> Array:
        """(n, n) of the means of two of the channels.

        Parameters
        ----------
        one, other : index among the k
        lag_s : (n, n) between the means
        """
        lasting = np.exp(-lag_s / max(self.time_s, 1e-3))
        return self.white[one, other] * (lag_s == 0) + self.slow[one, other] * lasting


def still_noise(records: Sequence[Array | None], step_s: float) -> list[StillNoise | None]:
    """Noise of every run, by the records of them all.

    Parameters
    ----------
    records : of each run (n, k), means over blocks of the model held still in units of their stated standard deviation, NaN where
        nothing was measured; None: there is none
    step_s : between means

    Returns
    -------
    noise : of each run, None where it has no record

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> noise = still_noise([rng.normal(size=(400, 1)), None], 0.5)
    >>> bool(abs(noise[0].white[0, 0] - 1) < 0.2), noise[1]
    (True, None)
    """
    stretches = {k: _stretches(record) for k, record in enumerate(records) if record is not None}
    stretches = {k: parts for k, parts in stretches.items() if parts}
    found: list[StillNoise | None] = [None] * len(records)
    if not stretches:
        return found
    parts = list(stretches.values())
    colour, sizes = _together(parts, np.ones(len(parts)))
    for _ in range(ROUNDS - 1):
        if np.ptp(sizes) < SAME_SIZE * sizes.max():
            break
        colour, sizes = _together(parts, sizes)
    for k, size in zip(stretches, sizes, strict=True):
        found[k] = StillNoise(size * colour.white, size * colour.slow, colour.time_s * step_s)
    return found


def _together(records: Sequence[Sequence[tuple[Array, Array]]], sizes: Array) -> tuple[StillNoise, Array]:
    """Colour of records (stretches each) of these sizes, its time constant in steps, and their sizes beside it."""
    colour = _colour(
        [(t, values / np.sqrt(size)) for parts, size in zip(records, sizes, strict=True) for t, values in parts]
    )
    squares, freedoms = np.array(
        [np.sum([_Turned(t, values[None]).whitened(colour)[::2] for t, values in parts], axis=0) for parts in records]
    ).T
    return colour, _sizes(squares, freedoms)


def _stretches(record: Array) -> list[tuple[Array, Array]]:
    """Index and values (n, k) of what was measured, in stretches."""
    at = np.flatnonzero(np.isfinite(record).all(axis=1))
    parts = np.array_split(at, max(1, -(-len(at) // LONGEST)))
    return [(part.astype(float) - part[0], record[part]) for part in parts if len(part) > 1]


def _colour(stretches: Sequence[tuple[Array, Array]]) -> StillNoise:
    """The noise by restricted likelihood, its time constant in steps."""
    channels = stretches[0][1].shape[1]
    freedom = sum(len(t) - 1 for t, _ in stretches)
    centred = np.concatenate([values - values.mean(axis=0) for _, values in stretches])
    whole = centred.T @ centred / freedom
    nothing = np.zeros((channels, channels))
    plain = StillNoise(whole, nothing, 0.0)
    # records measured at the same times are looked at together
    alike: dict[bytes, list[int]] = {}
    for index, (t, _) in enumerate(stretches):
        alike.setdefault(t.tobytes(), []).append(index)
    groups = [(stretches[found[0]][0], np.stack([stretches[k][1] for k in found])) for found in alike.values()]
    longest = max(t[-1] for t, _ in groups)
    if longest < FEWEST_MEANS or freedom < 2 * channels or not (np.diag(whole) > 0).all():
        return plain
    size = np.sqrt(np.diag(whole))
    lower, diagonal = np.tril_indices(channels), np.diag_indices(channels)

    def split(at: Array) -> list[Array]:
        found = []
        for numbers in (at[: len(lower[0])], at[len(lower[0]) : -1]):
            root = nothing.copy()
            root[lower] = numbers
            root[diagonal] = np.exp(root[diagonal])
            found.append(root)
        return found

    def noise(at: Array) -> StillNoise:
        white, slow = (size[:, None] * (root @ root.T) * size for root in split(at))
        return StillNoise(white, slow, float(np.exp(at[-1])))

    turned = [_Turned(t, values) for t, values in groups]

    def cost(colour: StillNoise) -> float:
        found = [group.whitened(colour) for group in turned]
        return 0.5 * sum(square + log for square, log, _ in found)

    def steep(at: Array) -> tuple[float, Array]:
        colour = noise(at)
        found = [group.slopes(colour) for group in turned]
        value, by_white, by_slow, by_time = (sum(part) for part in zip(*found, strict=True))
        parts = []
        for root, slope in zip(split(at), (by_white, by_slow), strict=True):
            by_root = 2 * (size[:, None] * slope * size) @ root
            by_root[diagonal] *= root[diagonal]
            parts.append(by_root[lower])
        return value, np.concatenate([*parts, [by_time * colour.time_s]])

    edge = (np.log(LEAST), np.log(MOST))
    entries = [edge if i == j else (-MOST, MOST) for i, j in zip(*lower, strict=True)]
    last = np.log(max(longest / 2, 1.0))
    ends = []
    for share, time in STARTS:
        roots = [np.linalg.cholesky(part * whole / np.outer(size, size)) for part in (share, 1 - share)]
        for root in roots:
            root[diagonal] = np.log(root[diagonal])
        start = np.concatenate([*(root[lower] for root in roots), [min(np.log(time), last)]])
        bounds = [*entries, *entries, (np.log(0.3), last)]
        ends.append(minimize(steep, start, method="L-BFGS-B", jac=True, bounds=bounds))
    best = min(ends, key=lambda end: end.fun)
    # a colour must bring as much as it has numbers (Akaike)
    return noise(best.x) if best.fun + len(lower[0]) + 1 < cost(plain) else plain


class _Turned:
    """Records (m, n, k) at the same times, turned to where a colour of one time constant is diagonal.

    A search steps every number of a colour in turn: only one of them is the time constant, and the turn is kept until that moves.
    """

    def __init__(self, t: Array, values: Array) -> None:
        self._lag, self._apart = np.abs(t[:, None] - t[None, :]), helmert(len(t))  # differences that no level changes
        self._values = values
        self._kept: tuple[float, Array, Array, Array] | None = None

    def _at(self, time_s: float) -> tuple[Array, Array]:
        """Powers (n - 1,), and the records there."""
        return self._turn(time_s)[:2]

    def _turn(self, time_s: float) -> tuple[Array, Array, Array]:
        """Powers, the records there, and what turns them (n - 1, n)."""
        if self._kept is None or self._kept[0] != time_s:
            lasting = np.exp(-self._lag / max(time_s, 1e-3))
            power, turn = np.linalg.eigh(self._apart @ lasting @ self._apart.T)
            turn = turn.T @ self._apart
            self._kept = (time_s, np.maximum(power, 0.0), turn @ self._values, turn)
        return self._kept[1:]

    def _longer(self, time_s: float) -> Array:
        """(n - 1, n - 1) how the lasting part's correlation grows with its time constant."""
        time_s, turn = max(time_s, 1e-3), self._turn(time_s)[2]
        return turn @ (self._lag / time_s**2 * np.exp(-self._lag / time_s)) @ turn.T

    def slopes(self, noise: StillNoise) -> tuple[float, Array, Array, float]:
        """Half the squares and log determinant of ``whitened``, and its slopes by white and slow covariance, (k, k) each, and
        by the time constant.
        """
        power, numbers = self._at(noise.time_s)
        covariance = noise.white + power[:, None, None] * noise.slow
        inverse = np.linalg.inv(covariance)
        value = 0.5 * len(numbers) * float(np.log(np.linalg.det(covariance)).sum())
        gone = np.einsum("nkl,mnl->mnk", inverse, numbers)
        by_covariance = 0.5 * (len(numbers) * inverse - np.einsum("mnk,mnl->nkl", gone, gone))
        longer = self._longer(noise.time_s)
        held = len(numbers) * np.diag(longer) @ np.einsum("nkl,lk->n", inverse, noise.slow)
        pulled = np.einsum("mnk,no,mok->", gone @ noise.slow, longer, gone)
        value += 0.5 * float(np.vdot(gone, numbers))
        return value, by_covariance.sum(axis=0), np.tensordot(power, by_covariance, 1), float(0.5 * (held - pulled))

    def whitened(self, noise: StillNoise) -> tuple[float, float, int]:
        """In the noise's unit: sum of squares in white units, log determinant of the covariance, and how many numbers are free
        beside the levels, of which nothing is known.
        """
        power, numbers = self._at(noise.time_s)
        records, n, channels = self._values.shape
        covariance = noise.white + power[:, None, None] * noise.slow
        square = np.einsum("mnk,nkl,mnl->", numbers, np.linalg.inv(covariance), numbers)
        log = float(np.log(np.linalg.det(covariance)).sum())
        return float(square), records * log, records * channels * (n - 1)


def _sizes(squares: Array, freedoms: Array) -> Array:
    """Of every record: between its own and the common one, by how far they scatter beyond what their lengths say (DerSimonian and
    Laird's way, in logarithms).
    """
    common = float(squares.sum() / freedoms.sum())
    if not (squares > 0).all():
        return np.full(len(squares), common)
    logs, weight = np.log(squares / freedoms / common), freedoms / 2.0
    room = float(weight.sum() - (weight**2).sum() / weight.sum())
    excess = float(weight @ (logs - weight @ logs / weight.sum()) ** 2) - (len(logs) - 1)
    between = max(excess / room, 0.0) if room > 0 else 0.0
    return common * np.exp(between / (between + 1.0 / weight) * logs)


__all__ = ["StillNoise", "still_noise"]
