"""Slow noise that an autoregression leaves: seen in the spectrum of the whitened residuals, pooled over channels and runs.

An autoregression of some twenty lags is blind to noise slower than its reach, and a fit's own freedom takes most of that noise
out of the residuals just where a tow swings. So the residuals' periodogram is compared with what the fit leaves of white noise
at each frequency (Whittle's likelihood); what is too much there is carried down to the swing's frequency by its form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...simulate.model import Array

CORNERS_HZ = (0.1, 0.2, 0.4, 0.8)
"""Excess power is a / (1 + (f / corner)^2): noise of 0.2 to 1.6 s, slower than an autoregression of a video reaches."""
SIZES = np.geomspace(0.02, 100.0, 100)
"""Sizes a that are tried, with each corner ..."""
BEFORE = np.minimum(1.0, SIZES**-2.0)
"""... and how probable they are beforehand: without residuals that say more, the excess is a fifth."""
NO_EXCESS = 0.5
"""Probability beforehand that there is none."""
HIGHEST_HZ = 3.0
"""Above this the autoregression sees for itself."""
LEAST_LEFT = 0.2
"""Where the fit takes more than the rest of white noise's power, the residuals say nothing."""


@dataclass(frozen=True)
class Whitened:
    """One run at the optimum, whitened.

    Attributes
    ----------
    error : (2, n)
    slope : (2, k, n), change of the response with the parameters ``columns``
    columns : (k,), places in the parameter vector
    step_s : of the samples
    """

    error: Array
    slope: Array
    columns: NDArray[np.int_]
    step_s: float


@dataclass(frozen=True)
class Leftover:
    """Power of the whitened noise beyond white noise's.

    Attributes
    ----------
    size : one per ``CORNERS_HZ``, mean of a over what the residuals allow
    none_p : probability that there is no excess
    """

    size: Array
    none_p: float

    def power(self, frequency_hz: Array) -> Array:
        """Excess over 1 at each frequency."""
        return self.size @ _forms(frequency_hz)

    def meat(self, run: Whitened) -> Array:
        """(k, k): what it adds to the variance of the information J'e, white noise's being J'J."""
        n, k = run.slope.shape[2], run.slope.shape[1]
        padded = 1 << int(np.ceil(np.log2(2 * n)))
        frequency = np.fft.rfftfreq(padded, run.step_s)
        weight = np.where((frequency > 0) & (frequency < frequency[-1]), 2.0, 1.0) / padded
        root = np.sqrt(weight * self.power(frequency))
        found = np.zeros((k, k))
        for rows in run.slope:
            wave = np.fft.rfft(rows, padded, axis=1) * root
            found += (wave.conj() @ wave.T).real
        return found


def leftover(runs: Sequence[Whitened], spreads: Sequence[Array]) -> Leftover:
    """What the runs of one fit show together.

    Parameters
    ----------
    runs : their residuals, whitened
    spreads : of each run (k, k), covariance of the parameters ``columns``, had the whitened noise been white
    """
    gain = np.zeros((len(CORNERS_HZ), len(SIZES)))
    for run, spread in zip(runs, spreads, strict=True):
        n = run.error.shape[1]
        frequency = np.fft.rfftfreq(n, run.step_s)
        inside = (frequency > 0) & (frequency < HIGHEST_HZ)
        for error, slope in zip(run.error, run.slope, strict=True):
            power = np.abs(np.fft.rfft(error)[inside]) ** 2 / n
            wave = np.fft.rfft(slope, axis=1)[:, inside]
            left = 1.0 - np.einsum("kf,kf->f", wave.conj(), spread @ wave).real / n
            told = left > LEAST_LEFT
            gain += _gain(frequency[inside][told], power[told] / left[told])
    # a mean over what is probable: the odds of each corner and size against no excess, whose gain is 0
    top = max(float(gain.max()), 0.0)
    odds = (1 - NO_EXCESS) / len(gain) * BEFORE / BEFORE.sum() * np.exp(gain - top)
    none = NO_EXCESS * np.exp(-top)
    total = none + odds.sum()
    return Leftover(odds @ SIZES / total, float(none / total))


def _gain(frequency_hz: Array, power: Array) -> Array:
    """Log likelihood of a periodogram (white: 1) for each corner and size, less that of white noise; (corners, sizes)."""
    much = 1.0 + SIZES[:, None] * _forms(frequency_hz)[:, None]
    return (power - power / much - np.log(much)).sum(axis=2)


def _forms(frequency_hz: Array) -> Array:
    """(corners, n)"""
    return 1.0 / (1.0 + (frequency_hz / np.array(CORNERS_HZ)[:, None]) ** 2)


__all__ = ["Leftover", "Whitened", "leftover"]
