"""The measurement's own noise from a record of the model held still: its colour, frame by frame and in block means.

The residuals of a fit hold that colour too, but a fit with some ten free numbers a run takes the slow part of it away, and a
force on the hull may look like it. A model that is held still shows the camera alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..simulate.model import Array
from .noise import (
    LARGEST_ORDER,
    ORDER_SHARE,
    SMALLEST_SCALE,
    Whitener,
    autocorrelation,
    from_correlation,
    measured,
    stated,
)

FEWEST = 100
"""Samples that a static record needs: below, its colour is not known to a tenth."""
SAME_STEP = 0.02
"""Sampling steps that differ by less than this share are the same."""
CENTRINGS = 4
"""Rounds in which what the mean took away is put back, always all of them."""
LARGEST_LOSS = 0.5
"""The mean of a record takes no more than this share of its variance away; a slower noise is not known from it."""
SLOWEST_STEPS = 15.0
"""A time constant of more steps than this is looked for in blocks twice as long ..."""
LONGEST_STEP_S = 2.0
"""... up to this length."""
SMALLEST_COLOUR = 0.12
"""First correlation of the block means, beside its own scatter 1/sqrt(n), below which they count as white: a
choice."""
FEWEST_BLOCKS = 12
"""Fewer means do not tell a colour: a choice."""


@dataclass(frozen=True)
class Still:
    """A record of the model held still.

    Attributes
    ----------
    t_s : (n,)
    values : (n, 2), y m and beta rad
    covariance : (n, 2, 2), stated, frame part
    """

    t_s: Array
    values: Array
    covariance: Array

    @property
    def step_s(self) -> float:
        """The usual sampling step."""
        return float(np.median(np.diff(self.t_s)))

    def useless(self, step_s: float) -> str:
        """Why it says nothing of a run sampled every ``step_s``; empty where it does."""
        if len(self.t_s) < FEWEST:
            return f"{len(self.t_s)} measured samples; {FEWEST} are needed"
        if abs(self.step_s / step_s - 1) > SAME_STEP:
            return f"{1 / self.step_s:.4g} samples a second against the run's {1 / step_s:.4g}"
        return ""

    @property
    def scaled(self) -> Array:
        """(n, 2), in units of the stated sigmas."""
        return np.einsum(
            "nij,nj->ni", stated(self.covariance, self.t_s).matrices, self.values - self.values.mean(axis=0)
        )


@dataclass(frozen=True)
class Colour:
    """What static records say of the measurement's colour.

    Attributes
    ----------
    regression : per channel (p,), autoregressive coefficients
    share : (2,), variance of the innovations over that of the noise
    left : per channel (k + 1,), autocorrelation that the regression leaves, lags 0 ..; for the covariance
    samples : they come from
    """

    regression: tuple[Array, Array]
    share: Array
    left: tuple[Array, Array]
    samples: int


@dataclass(frozen=True)
class Slow:
    """The measurement's colour as white noise and a first-order slow part, of one sample (or block mean).

    Attributes
    ----------
    share : (2,), white share of the variance of y and beta
    time_s : (2,), time constant of the rest
    """

    share: Array
    time_s: Array


def colour_of(records: Sequence[Still], step_s: float) -> Colour | None:
    """Colour of the records of one camera, pooled; None where none has enough samples at the step ``step_s``.

    Parameters
    ----------
    records : static records
    step_s : between samples, s
    """
    usable = [s for s in records if not s.useless(step_s)]
    if not usable:
        return None
    series = [s.scaled for s in usable]
    count = sum(len(s) for s in series)
    largest = int(min(LARGEST_ORDER, ORDER_SHARE * max(len(s) for s in series)))
    regressions, shares, left = [], [], []
    for channel in range(2):
        regression, share = _regression([s[:, channel] for s in series], largest)
        regressions.append(regression)
        shares.append(share)
        left.append(correlation_left([s[:, channel] for s in series], regression))
    return Colour((regressions[0], regressions[1]), np.array(shares), (left[0], left[1]), count)


def slow_part(records: Sequence[Still], step_s: float) -> Slow | None:
    """The slow part that the records of one camera show in means over ``step_s``; None without records, or where they show none.

    Parameters
    ----------
    records : static records
    step_s : of a mean, s
    """
    records = [s for s in records if len(s.t_s) >= FEWEST]
    if not records:
        return None
    share, time = np.ones(2), np.full(2, step_s)
    for channel in range(2):
        step = step_s
        while True:
            parts = np.array([block_colour(s.t_s, s.values[:, channel], step) for s in records])
            _, white, lasting = np.median(parts, axis=0)
            if lasting < SLOWEST_STEPS * step or step > LONGEST_STEP_S:
                break
            step *= 2  # too slow to be told in so short blocks
        if lasting > 0:
            fast = white * step / step_s
            share[channel], time[channel] = fast / (fast + 1 - white), lasting
    return Slow(share, time) if (share < 1).any() else None


def _regression(series: list[Array], largest: int) -> tuple[Array, float]:
    """Autoregression of centred series, (p,) and its share; what their means took away is put back."""
    sizes = np.array([len(x) for x in series])
    whole = sum(_autocovariance(x, largest) * len(x) for x in series) / sizes.sum()
    found = from_correlation(whole / whole[0], int(sizes.sum()))
    for _ in range(CENTRINGS):
        # the variance of a mean, from the spectrum at frequency 0
        lost = whole[0] * found[1] / max(1.0 - float(found[0].sum()), 1e-3) ** 2 * len(sizes) / sizes.sum()
        more = whole + min(lost, LARGEST_LOSS * whole[0])
        found = from_correlation(more / more[0], int(sizes.sum()))
    return found


def _autocovariance(values: Array, lags: int) -> Array:
    centred = values - values.mean()
    return autocorrelation(centred, lags, centred=False) * float(centred @ centred) / len(centred)


def correlation_left(series: list[Array], regression: Array) -> Array:
    """Autocorrelation of series after an autoregression was taken out.

    Parameters
    ----------
    series : of one channel, centred
    regression : (p,) coefficients

    Returns
    -------
    correlation : (k + 1,), 1 at lag 0, to a tenth of the shortest series
    """
    lags = max(1, min(len(x) for x in series) // 10)
    total = np.zeros(lags + 1)
    for x in series:
        white = x[len(regression) :].copy()
        for lag, a in enumerate(regression, start=1):
            white -= a * x[len(regression) - lag : len(x) - lag]
        total += _autocovariance(white, lags) * len(white)
    return total / total[0]


def as_held_still(residual: Array, before: Whitener, colour: Colour) -> Whitener:
    """The whitener with the static records' colour; the scatter is the residuals' ``(n, 2)`` own, at unit variance.

    Parameters
    ----------
    residual : (n, 2)
    before : the whitener so far
    colour : of the static records
    """
    innovation = np.sqrt(colour.share)
    trial = Whitener(before.matrices, colour.regression, np.ones(2), innovation, before.begins)
    scale = np.maximum(np.sqrt(np.mean(trial(residual) ** 2, axis=0)), SMALLEST_SCALE)
    return Whitener(before.matrices, colour.regression, scale, innovation, before.begins)


def reweighted(residual: Array, before: Whitener, colour: Colour | None) -> Whitener:
    """The whitener of residuals ``(n, 2)``: of a known colour, or of their own.

    Parameters
    ----------
    residual : (n, 2)
    before : the whitener so far
    colour : of the static records
    """
    return measured(residual, before) if colour is None else as_held_still(residual, before, colour)


def block_colour(t_s: Array, values: Array, step_s: float) -> tuple[float, float, float]:
    """Variance of a mean over ``step_s``, the white share of it, and the time constant in s of the rest.

    Parameters
    ----------
    t_s, values : (n,), one channel of a static record, NaN where not measured
    step_s : of a mean, s
    """
    good = np.isfinite(values)
    index = np.floor((t_s - t_s[0]) / step_s + 1e-9).astype(int)
    size = max(int(index.max()), 1)
    inside = good & (index < size)
    count = np.bincount(index[inside], minlength=size)
    x = (np.bincount(index[inside], values[inside], minlength=size) / np.maximum(count, 1))[count > 0]
    return scatter(x, step_s)


def scatter(means: Array, step_s: float) -> tuple[float, float, float]:
    """``block_colour`` of the means themselves, (n,).

    Parameters
    ----------
    means : (n,)
    step_s : between samples, s
    """
    x = means[np.isfinite(means)]
    x = x - x.mean()
    n = len(x)
    variance = float(x @ x) / max(n - 1, 1)
    if n < FEWEST_BLOCKS:
        return variance, 1.0, 0.0
    rho = [float(x[k:] @ x[:-k]) / float(x @ x) + 1.0 / n for k in (1, 2, 3)]
    if rho[0] < SMALLEST_COLOUR + 1.0 / np.sqrt(n):
        return variance, 1.0, 0.0
    decay = np.clip(np.mean([rho[1] / rho[0], np.sqrt(max(rho[2], 0.0) / rho[0])]), 0.2, 0.95)
    return variance, float(np.clip(1 - rho[0] / decay, 0.0, 1.0)), float(-step_s / np.log(decay))
