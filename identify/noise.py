"""The noise of a run's residuals: scatter of each channel and its colour, and the filter that whitens both.

Compressed video is not white: a codec repeats a mark's image over several frames and its error with it. Taken as white, a
minute of it would seem to hold several times more information than it does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ..simulate.model import Array

LARGEST_ORDER = 20
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
        """Whiten ``(n, 2)`` or ``(n, 2, k)``; the first samples of a stretch keep their stationary variance."""
        flat = values.reshape(len(values), 2, -1)
        scaled = self.matrices @ flat / self.scale[None, :, None]
        white = np.empty_like(scaled)
        index = np.arange(len(values))
        for channel, coefficients in enumerate(self.regression):
            here = scaled[:, channel]
            filtered = here.copy()
            whole = index - self.begins >= len(coefficients)
            for lag, a in enumerate(coefficients, start=1):
                filtered[lag:] -= a * here[:-lag]
            white[:, channel] = np.where(whole[:, None], filtered / self.innovation[channel], here)
        return white.reshape(values.shape)

    def along(self, values: Array) -> Array:
        """The same with time last: ``(2, n)`` or ``(2, k, n)``."""
        samples = values.shape[-1]
        flat = values.reshape(2, -1, samples)
        root = self.matrices
        scaled = np.empty_like(flat)
        np.multiply(flat[0], root[:, 0, 0] / self.scale[0], out=scaled[0])
        np.multiply(flat[1], root[:, 1, 1] / self.scale[1], out=scaled[1])
        if root[:, 1, 0].any():
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
            first = np.flatnonzero(np.arange(samples) - self.begins < len(coefficients))
            filtered[:, first] = here[:, first]
        return scaled.reshape(values.shape)


def stated(covariance: Array, t_s: Array) -> Whitener:
    """The whitener of the stated sigmas alone: white, scatter 1."""
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
    """The whitener that the residuals ``(n, 2)`` themselves ask for: scatter, and an autoregression chosen by AIC."""
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
    """Biased sample autocorrelation of one channel ``(n,)``, lags 0 .. ``lags``, (lags + 1,)."""
    values = residual - residual.mean() if centred else residual
    size = 1 << int(np.ceil(np.log2(2 * len(values))))
    power = np.abs(np.fft.rfft(values, size)) ** 2
    covariance = np.fft.irfft(power, size)[: lags + 1]
    return covariance / covariance[0] if covariance[0] > 0 else np.eye(1, lags + 1)[0]


def autoregression(values: Array, largest_order: int) -> tuple[Array, float]:
    """Levinson-Durbin on the autocorrelation, order by AIC.

    Returns
    -------
    coefficients : (p,), of x_t = a_1 x_(t-1) + ... + a_p x_(t-p) + e
    share : variance of e over that of x
    """
    rho = autocorrelation(values, largest_order, centred=False)
    best, best_aic, best_share = np.zeros(0), 0.0, 1.0
    coefficients = np.zeros(0)
    share = 1.0
    for order in range(1, largest_order + 1):
        reflection = (rho[order] - coefficients @ rho[order - 1 : 0 : -1]) / share
        coefficients = np.concatenate([coefficients - reflection * coefficients[::-1], [reflection]])
        share *= 1 - reflection**2
        if share <= 1e-9:
            break
        aic = len(values) * np.log(share) + 2 * order
        if aic < best_aic - 2:
            best, best_aic, best_share = coefficients, aic, share
    return best, best_share


def ljung_box_p(residual: Array, fitted: int = 0, lags: int = 30) -> float:
    """p value of the Ljung-Box test that ``residual (n,)`` is white; ``fitted`` coefficients of an autoregression count."""
    n = len(residual)
    lags = min(max(lags, fitted + 5), n // 4)
    rho = autocorrelation(residual, lags)[1:]
    statistic = n * (n + 2) * float((rho**2 / (n - np.arange(1, lags + 1))).sum())
    return float(chi2.sf(statistic, max(lags - fitted, 1)))
