"""What a tow still does: a mean, an exponential and one swing shared by its angles (8.20, reduced), on block means.

``methods.decay`` fits the same form to a record that is known to swing. Here the record may be at rest, may drift, swing, grow or
shear off: the exponential's rate is free in sign, the swing may be slower than one of them, and the question is whether there is
anything beside the noise. The noise's own colour weighs it: the first fit's residuals say it, the second fit uses it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..record.errors import EstimationError, solvable
from ..simulate.model import Array
from .decay_search import best_model, inverse_of_squares, search
from .noise import Whitener, measured, stated

BLOCKS_A_SWING = 80
"""Block means to a swing of the longest period: shake and codec average out, a swing does not."""
FEWEST_BLOCKS = 24
"""Fewer do not carry a fit of eleven numbers: a choice."""
SHORTEST_SHARE = 0.2
"""No swing is looked for that is faster than this share of the longest period; the mean does not feel it."""
FEWEST_SWINGS = 0.75
"""Of a slower swing the record shows less than its mean needs: an exponential stands for it."""
GRID = 24
"""Frequencies at which the search begins, evenly on a logarithmic scale: a choice."""
LARGEST_RATIO = 0.5
"""A swing that falls faster than this share of its circular frequency is none; exponentials stand for it."""
LARGEST_GROWTH = 6.0
"""What grows is looked for up to this power of e over the record ..."""
SWING_GROWTH = 0.3
"""... and a swing up to this share of the slowest circular frequency: what runs away faster is no swing."""
LEAST_FREEDOM = 10.0
"""Of a covariance, however slow the noise: with fewer no swing would ever be significant."""
ROUNDS = 2
"""Fits after the first, with the noise measured from what the last one left: a choice."""
TOLERANCE, ROUGH = 1e-8, 1e-4
"""Relative, of the search's steps; and from each start, of which the best goes on."""


@dataclass(frozen=True)
class Transient:
    """A record's mean, exponential and swing, by ``fit_transient``.

    Attributes
    ----------
    begin_s, end_s : of the record
    rates : (3,): l2 of the exponential e^(-l2 t), l3 and w of the swing e^(-l3 t) cos, sin(w t); t from ``begin_s``
    amplitudes : (2, 4), of alpha and beta: mean, exponential, cos, sin; rad
    covariance : (11, 11), of rates, then amplitudes of alpha, then of beta; the noise's colour included
    t_s, residual : (n,) and (n, 2), block means, rad
    freedom : degrees of freedom of the covariance: as many samples as the coloured noise is worth, less what was fitted
    """

    begin_s: float
    end_s: float
    rates: Array
    amplitudes: Array
    covariance: Array
    t_s: Array
    residual: Array
    freedom: float

    @property
    def period_s(self) -> float:
        """Of the swing."""
        return float(2 * np.pi / self.rates[2])

    def swing(self, t_s: float) -> tuple[Array, Array]:
        """The swing of (alpha, beta) at a time: cos and sin amplitudes (2, 2), rad, and the (4, 4) covariance, alpha's first.

        The phase is counted from ``begin_s``; that of the envelope's rate is in the covariance.
        """
        t = t_s - self.begin_s
        fall = float(np.exp(-self.rates[1] * t))
        found = self.amplitudes[:, 2:] * fall
        slope = np.zeros((4, 11))
        slope[:, 1] = -t * found.ravel()
        for row, column in enumerate((5, 6, 9, 10)):
            slope[row, column] = fall
        return found, slope @ self.covariance @ slope.T

    def drift(self, from_s: float, to_s: float) -> tuple[Array, Array]:
        """What the exponential changes (alpha, beta) by between two times, (2,) rad, and its covariance (2, 2)."""
        a, b = np.array([from_s, to_s]) - self.begin_s
        l2 = self.rates[0]
        change = float(np.exp(-l2 * b) - np.exp(-l2 * a))
        found = self.amplitudes[:, 1] * change
        slope = np.zeros((2, 11))
        slope[:, 0] = self.amplitudes[:, 1] * float(a * np.exp(-l2 * a) - b * np.exp(-l2 * b))
        slope[0, 4] = slope[1, 8] = change
        return found, slope @ self.covariance @ slope.T

    def rate(self, index: int) -> tuple[float, float]:
        """lambda and its standard deviation, 1/s, negative = decaying: of the exponential (0) or the swing (1)."""
        return -float(self.rates[index]), float(np.sqrt(max(self.covariance[index, index], 0.0)))


def blocks(t_s: Array, values: Array, step_s: float) -> tuple[Array, Array]:
    """Means over blocks of ``step_s``: their times (m,) and values (m, k); blocks without a sample are left out.

    Parameters
    ----------
    t_s : (n,) times, s
    values : (n, k)
    step_s : of a block, s
    """
    index = np.floor((t_s - t_s[0]) / step_s + 1e-9).astype(int)
    count = np.bincount(index)
    full = count > 0
    columns = [np.bincount(index, column)[full] / count[full] for column in (t_s, *values.T)]
    return columns[0], np.column_stack(columns[1:])


@solvable(EstimationError)
def fit_transient(t_s: Array, angles: Array, slowest_s: float) -> Transient:
    """Fit mean, exponential and swing to angles.

    Parameters
    ----------
    t_s, angles : (n,) s rising, (n, 2) alpha and beta, rad; gaps are allowed
    slowest_s : the longest period that a swing may have, s

    Raises
    ------
    EstimationError : fewer than 24 block means

    >>> t = np.arange(0, 60, 0.04)
    >>> noise = 1e-4 * np.random.default_rng(1).normal(size=(len(t), 2))
    >>> swing = 0.02 * np.exp(-0.01 * t) * np.cos(0.35 * t)
    >>> found = fit_transient(t, np.column_stack([0.3 + swing, 0.05 - swing / 3]) + noise, 20.0)
    >>> round(found.period_s, 1), round(found.rate(1)[0], 3)
    (18.0, -0.01)
    """
    span = float(t_s[-1] - t_s[0])
    usual = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    times, means = blocks(t_s, angles, max(slowest_s / BLOCKS_A_SWING, usual))
    if len(times) < FEWEST_BLOCKS:
        raise EstimationError(f"{len(times)} means of the angles in {span:.1f} s; {FEWEST_BLOCKS} are needed")
    t = times - times[0]
    limits = _limits(t[-1], slowest_s)
    # one scale for both channels; what is left in each is measured below
    scatter = np.maximum(np.std(np.diff(means, axis=0), axis=0), 1e-9)
    weight = stated(np.broadcast_to(np.diag(scatter**2), (len(t), 2, 2)), t)
    best = min(
        (search(t, means, weight, start, limits, True, ROUGH) for start in _starts(t, means / scatter, limits)),
        key=lambda found: found.cost,
    ).x
    for _ in range(ROUNDS):
        weight = measured(means - best_model(t, best, means, weight, True)[0], weight)
        best = search(t, means, weight, best, limits, True, TOLERANCE).x
    return _result(float(times[0]), times, means, weight, best)


def _limits(span: float, slowest_s: float) -> tuple[Array, Array]:
    """Lower and upper of (l2, l3, w)."""
    slow = max(2 * np.pi * FEWEST_SWINGS / span, np.pi / slowest_s)
    fast = max(2 * np.pi / (SHORTEST_SHARE * slowest_s), 1.2 * slow)
    grow = LARGEST_GROWTH / span
    return np.array([-grow, -min(grow, SWING_GROWTH * 2 * np.pi / slowest_s), slow]), np.array(
        [fast, LARGEST_RATIO * fast, fast]
    )


def _starts(t: Array, scaled: Array, limits: tuple[Array, Array]) -> list[Array]:
    """The two best of a grid of frequencies and dampings, with a line for the exponential, each with both signs of its rate."""
    span, found = t[-1], []
    line = np.column_stack([np.ones_like(t), t / span])
    for w in np.geomspace(limits[0][2], limits[1][2], GRID):
        for l3 in (0.0, 0.15 * w):
            fall = np.exp(-l3 * t)
            q, _ = np.linalg.qr(np.column_stack([line, fall * np.cos(w * t), fall * np.sin(w * t)]))
            found.append((float(((scaled - q @ (q.T @ scaled)) ** 2).sum()), l3, w))
    found.sort()
    first = found[0]
    other = next((f for f in found if abs(np.log(f[2] / first[2])) > 0.3), found[-1])
    return [np.array([l2, l3, w]) for _, l3, w in (first, other) for l2 in (1.0 / span, -1.0 / span)]


def _result(begin_s: float, times: Array, means: Array, weight: Whitener, p: Array) -> Transient:
    t = times - times[0]
    model, amplitudes, residual, _ = best_model(t, p, means, weight, True)
    inverse = inverse_of_squares(t, p, amplitudes, weight, True, 1e-12)
    per_dof = float(residual @ residual) / max(len(residual) - 11, 1)
    return Transient(
        begin_s=begin_s,
        end_s=float(times[-1]),
        rates=p,
        amplitudes=amplitudes,
        covariance=inverse * max(per_dof, 1e-300),
        t_s=times,
        residual=means - model,
        freedom=max(_worth(weight, len(t)) - 11, LEAST_FREEDOM),
    )


def _worth(weight: Whitener, count: int) -> float:
    """Samples of white noise that know a mean as well as ``count`` of both channels do."""
    share = [(1 - float(np.sum(a))) ** 2 / s**2 for a, s in zip(weight.regression, weight.innovation, strict=True)]
    return float(count * sum(min(max(one, 0.0), 1.0) for one in share))
