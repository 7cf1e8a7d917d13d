"""Which derivatives a covariance fixes one by one, and which only in combination with others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array

UNDETERMINED_SHARE = 0.25
"""A derivative whose standard deviation exceeds this share of its size is not determined."""
TIED = 0.9
"""Correlation from which two derivatives are said to be known only together."""
TIED_SHARE = 0.12
"""A derivative as uncertain as this share, and correlated beyond 0.9 with one that is not determined, goes with it."""
ADDED_SD = 1.2
"""A term may be left out of a combination where that widens it by no more than this factor ..."""
STILL_SMALL = 0.02
"""... or where the combination stays known to this share of its derivative."""
PIVOTS_FIRST = (0, 1)
"""Derivatives that others are combined with before any other: m' and I', of which most is known beforehand."""


@dataclass(frozen=True)
class Combination:
    """A sum of derivatives that the record fixes.

    Attributes
    ----------
    coefficients : (6,), of (m', I', Y_v, Y_R, N_v, N_r); the first named one has 1
    leading : index of the derivative whose coefficient is 1
    value, sd : of the sum, in that derivative's unit
    """

    coefficients: Array
    leading: int
    value: float
    sd: float


@dataclass(frozen=True)
class Determined:
    """What a covariance fixes.

    Attributes
    ----------
    single : indices that are determined by themselves
    refused : indices that are not
    combinations : of the refused ones, as many as are known beyond ``single``
    directions : (k, 6), unit vectors in (derivative / its size) that the record leaves open, weakest first
    """

    single: tuple[int, ...]
    refused: tuple[int, ...]
    combinations: tuple[Combination, ...]
    directions: Array


def determined(six: Array, covariance: Array, share: float = UNDETERMINED_SHARE) -> Determined:
    """Split six derivatives with their covariance (6, 6) into single ones and combinations.

    Parameters
    ----------
    six : (6,) derivatives, in the order of ``DERIVATIVE_UNITS``
    covariance : (6, 6)
    share : relative standard deviation from which a derivative is not determined
    """
    size = np.abs(six)
    scaled = covariance / size[:, None] / size[None, :]
    values, vectors = np.linalg.eigh(scaled)
    open_ = vectors[:, values > share**2].T[::-1]
    refused = _refused(scaled, share)
    single = tuple(i for i in range(6) if i not in refused)
    pivots = [i for i in PIVOTS_FIRST if i in refused]
    rest = [i for i in refused if i not in pivots]
    while rest and any(_left(scaled, pivots)[i] > share**2 for i in rest):
        pivots.append(max(rest, key=lambda i: _left(scaled, pivots)[i]))
        rest = [i for i in refused if i not in pivots]
    found = tuple(_combination(i, pivots, six, covariance) for i in rest)
    return Determined(single, tuple(refused), found, open_)


def _refused(scaled: Array, share: float) -> list[int]:
    """Derivatives that are wide themselves, and those that are tied to one of them."""
    sd = np.sqrt(np.diag(scaled))
    wide = sd > share
    tied = np.abs(scaled / sd[:, None] / sd[None, :]) > TIED
    return [i for i in range(6) if wide[i] or (sd[i] > TIED_SHARE and (tied[i] & wide).any())]


def _left(scaled: Array, pivots: list[int]) -> Array:
    """Variances left when the pivots are known."""
    if not pivots:
        return np.diag(scaled)
    cross = scaled[:, pivots]
    return np.diag(scaled - cross @ np.linalg.pinv(scaled[np.ix_(pivots, pivots)], hermitian=True) @ cross.T)


def _combination(leading: int, pivots: list[int], six: Array, covariance: Array) -> Combination:
    """The leading derivative minus its regression on the pivots, with as few terms as it takes."""
    terms = list(pivots)
    vector, variance = _regressed(leading, terms, six, covariance)
    for pivot in sorted(pivots, key=lambda p: abs(vector[p] * six[p])):
        fewer = [t for t in terms if t != pivot]
        shorter, wider = _regressed(leading, fewer, six, covariance)
        if wider <= max(ADDED_SD**2 * variance, (STILL_SMALL * six[leading]) ** 2):
            terms, vector, variance = fewer, shorter, wider
    return Combination(vector, leading, float(vector @ six), float(np.sqrt(max(variance, 0.0))))


def _regressed(leading: int, terms: list[int], six: Array, covariance: Array) -> tuple[Array, float]:
    vector = np.zeros(6)
    vector[leading] = 1.0
    if terms:
        size = np.abs(six)[terms]
        inner = covariance[np.ix_(terms, terms)] / size[:, None] / size[None, :]
        vector[terms] = -np.linalg.pinv(inner, hermitian=True) @ (covariance[terms, leading] / size) / size
    return vector, float(vector @ covariance @ vector)
