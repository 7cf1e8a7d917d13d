"""The noise of a run's residuals: scatter of each channel and its colour, and the filter that whitens both.

Compressed video is not white: a codec repeats a mark's image over several frames and its error with it. Taken as white, a
minute of it would seem to hold several times more information than it does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from ..simulate.model import Array

LARGEST_ORDER = 20
"""No autoregression is longer, however long the record: a choice."""
ORDER_SHARE = 0.05
"""No autoregression longer than this share of the samples."""
SMALLEST_SCALE = 1e-3
"""No run is believed to scatter less than this share of its stated sigma (a simulated record without noise does)."""
GAP_STEPS = 1.5
"""Samples farther apart than this many usual steps are not neighbours for the filter."""


@dataclass(frozen=True)
class Whitener:
    """Makes residuals (and their sensitivities) white and of unit variance.

    Attributes
    ----------
    matrices : (n, 2, 2), W with W'W = inverse covariance of a sample, from the stated sigmas
    regression : per channel (p,), autoregressive coefficients of the scaled residual
    scale : (2,), stationary scatter of the residual over the stated sigmas
    innovation : (2,), scatter of the innovations over the stationary scatter
    begins : (n,), sample at which each sample's unbroken stretch begins
    """

    matrices: Array
    regression: tuple[Array, Array]
    scale: Array
    innovation: Array
    begins: Array

    def __call__(self, values: Array) -> Array:
        """Whiten ``(n, 2)`` or ``(n, 2, k)``; a stretch's first samples by the shorter regressions that belong to them."""
        flat = np.moveaxis(values.reshape(len(values), 2, -1), 0, -1)
        white = self.along(np.ascontiguousarray(flat))
        return np.moveaxis(white, -1, 0).reshape(values.shape)

    def along(self, values: Array) -> Array:
        """The same with time last: ``(2, n)`` or ``(2, k, n)``."""
        samples = values.shape[-1]
        flat = values.reshape(2, -1, samples)
        root = self.matrices
        scaled = np.empty_like(flat)
        np.multiply(flat[0], root[:, 0, 0] / self.scale[0], out=scaled[0])
        np.multiply(flat[1], root[:, 1, 1] / self.scale[1], out=scaled[1])
        if self.mixes:
            scaled[1] += flat[0] * (root[:, 1, 0] / self.scale[1])
        for channel, coefficients in enumerate(self.regression):
            if not len(coefficients):
                scaled[channel] /= self.innovation[channel]
                continue
            here = scaled[channel].copy()
            filtered = scaled[channel]
            for lag, a in enumerate(coefficients, start=1):
                filtered[:, lag:] -= a * here[:, :-lag]
            filtered /= self.innovation[channel]
            first = self._firsts[channel]
            for begin, count in self._stretches:
                some = slice(begin, begin + min(count, len(first)))
                filtered[:, some] = here[:, some] @ first[: some.stop - begin, : some.stop - begin].T
        return scaled.reshape(values.shape)

    @cached_property
    def mixes(self) -> bool:
        """Whether the first channel is part of the second one's whitened."""
        return bool(self.matrices[:, 1, 0].any())

    @cached_property
    def _stretches(self) -> list[tuple[int, int]]:
        """Begin and length of each unbroken stretch."""
        return [(int(b), int(n)) for b, n in zip(*np.unique(self.begins, return_counts=True), strict=True)]

    @cached_property
    def _firsts(self) -> list[Array]:
        """Per channel (p, p): what whitens a stretch's first p samples, each by those before it."""
        found = []
        for coefficients, innovation in zip(self.regression, self.innovation, strict=True):
            rows = np.zeros((len(coefficients), len(coefficients)))
            for order, (shorter, spread) in enumerate(_shorter(coefficients, innovation)):
                rows[order, :order] = -shorter[::-1] / spread
                rows[order, order] = 1 / spread
            found.append(rows)
        return found

    def uncoloured(self, rows: Array) -> Array:
        """Whitened ``rows (2, k, n)`` times the colour's filter: what multiplies noise that is white, of the scatter it has.

        The adjoint of the regressions in ``along``, so that rows @ rows' of the answer is what white noise would do to rows @ e.
        """
        found = np.zeros_like(rows)
        since = np.arange(rows.shape[-1]) - self.begins
        for channel, coefficients in enumerate(self.regression):
            orders = [
                *_shorter(coefficients, self.innovation[channel]),
                (coefficients, float(self.innovation[channel])),
            ]
            for order, (regression, spread) in enumerate(orders):
                whole = order == len(coefficients)
                at = np.flatnonzero(since >= order if whole else since == order)
                part = rows[channel][:, at] / spread
                found[channel][:, at] += part
                for lag, a in enumerate(regression, start=1):
                    found[channel][:, at - lag] -= a * part
        return found


def _shorter(coefficients: Array, innovation: float) -> list[tuple[Array, float]]:
    """Regressions of order 0 .. p - 1 of the same noise, with their innovations' scatter: Levinson's recursion backwards.

    Without them the first p samples of a slow noise would count as p separate looks at it.
    """
    found, spread = [], innovation
    while len(coefficients):
        last = coefficients[-1]
        coefficients = (coefficients[:-1] + last * coefficients[-2::-1]) / (1 - last**2)
        spread = spread / np.sqrt(1 - last**2)
        found.insert(0, (coefficients, spread))
    return found


def stated(covariance: Array, t_s: Array) -> Whitener:
    """The whitener of the stated sigmas alone: white, scatter 1.

    Parameters
    ----------
    covariance : (n, 2, 2) of the samples
    t_s : (n,) times, s
    """
    # inverse Cholesky factor of a 2 x 2 matrix, lower triangular
    matrices = np.zeros((len(covariance), 2, 2))
    first = np.sqrt(covariance[:, 0, 0])
    along = covariance[:, 0, 1] / first
    second = np.sqrt(covariance[:, 1, 1] - along**2)
    matrices[:, 0, 0], matrices[:, 1, 1] = 1 / first, 1 / second
    matrices[:, 1, 0] = -along / (first * second)
    gaps = np.diff(t_s) > GAP_STEPS * np.median(np.diff(t_s))
    begins = np.maximum.accumulate(np.where(np.concatenate([[True], gaps]), np.arange(len(t_s)), 0))
    return Whitener(matrices, (np.zeros(0), np.zeros(0)), np.ones(2), np.ones(2), begins)


def measured(residual: Array, before: Whitener) -> Whitener:
    """The whitener that the residuals ``(n, 2)`` themselves ask for: scatter, and an autoregression chosen by AIC.

    Parameters
    ----------
    residual : (n, 2)
    before : the whitener so far
    """
    scaled = np.einsum("nij,nj->ni", before.matrices, residual)
    scale = np.maximum(np.sqrt(np.mean(scaled**2, axis=0)), SMALLEST_SCALE)
    regressions, innovations = [], []
    for channel in range(2):
        largest = int(min(LARGEST_ORDER, ORDER_SHARE * len(scaled)))
        coefficients, share = autoregression(scaled[:, channel], largest)
        regressions.append(coefficients)
        innovations.append(np.sqrt(share))
    return Whitener(before.matrices, (regressions[0], regressions[1]), scale, np.array(innovations), before.begins)


def autocorrelation(residual: Array, lags: int, centred: bool = True) -> Array:
    """Biased sample autocorrelation of one channel ``(n,)``, lags 0 .. ``lags``, (lags + 1,).

    Parameters
    ----------
    residual : (n,), one channel
    lags : how many
    centred : its mean is taken off first
    """
    values = residual - residual.mean() if centred else residual
    size = 1 << int(np.ceil(np.log2(2 * len(values))))
    power = np.abs(np.fft.rfft(values, size)) ** 2
    covariance = np.fft.irfft(power, size)[: lags + 1]
    return covariance / covariance[0] if covariance[0] > 0 else np.eye(1, lags + 1)[0]


def autoregression(values: Array, largest_order: int) -> tuple[Array, float]:
    """Levinson-Durbin on the autocorrelation, order by AIC.

    Parameters
    ----------
    values : (n,)
    largest_order : of the autoregression

    Returns
    -------
    coefficients : (p,), of x_t = a_1 x_(t-1) + ... + a_p x_(t-p) + e
    share : variance of e over that of x
    """
    return from_correlation(autocorrelation(values, largest_order, centred=False), len(values))


def from_correlation(rho: Array, count: int) -> tuple[Array, float]:
    """The autoregression of ``count`` samples whose autocorrelation is ``rho (k + 1,)``: ``autoregression``'s answer.

    Parameters
    ----------
    rho : (k + 1,), lags 0 .. k
    count : of samples
    """
    best, best_aic, best_share = np.zeros(0), 0.0, 1.0
    coefficients = np.zeros(0)
    share = 1.0
    for order in range(1, len(rho)):
        reflection = (rho[order] - coefficients @ rho[order - 1 : 0 : -1]) / share
        coefficients = np.concatenate([coefficients - reflection * coefficients[::-1], [reflection]])
        share *= 1 - reflection**2
        if share <= 1e-9:
            break
        aic = count * np.log(share) + 2 * order
        if aic < best_aic - 2:
            best, best_aic, best_share = coefficients, aic, share
    return best, best_share


def ljung_box_p(residual: Array, fitted: int = 0, lags: int = 30, elsewhere: tuple[int, int] = (0, 1)) -> float:
    """p value of the Ljung-Box test that ``residual (n,)`` is white.

    Parameters
    ----------
    residual : (n,), one channel
    fitted : coefficients of an autoregression that was fitted to the residual itself
    lags : how many
    elsewhere : (coefficients, samples) of one fitted to another record: its errors add p n / m to the statistic's mean
    """
    n = len(residual)
    lags = min(max(lags, fitted + 5), n // 4)
    rho = autocorrelation(residual, lags)[1:]
    statistic = n * (n + 2) * float((rho**2 / (n - np.arange(1, lags + 1))).sum())
    statistic /= 1 + elsewhere[0] * n / (elsewhere[1] * lags)
    # many lags of a short record scatter more than chi-square, by 1 + 2 lags/n in variance (8,000 white records of 300 to 3840)
    wider = 1 + 2 * lags / n
    return float(chdtrc(max(lags - fitted, 1) / wider, statistic / wider))
