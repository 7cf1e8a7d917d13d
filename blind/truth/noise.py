"""Random processes of the first order, by the spectrum (not by a recursion)."""

from __future__ import annotations

import numpy as np

from .lanes import Array


def wandering(count: int, step_s: float, sd: float, time_s: float, rng: np.random.Generator, kinds: int = 1) -> Array:
    """Stationary Gaussian noise whose correlation falls as exp(-t/time).

    Parameters
    ----------
    count, step_s : samples and their distance
    sd, time_s : size and correlation time
    rng : that draws
    kinds : how many independent ones

    Returns
    -------
    ``(kinds, count)``
    """
    if sd <= 0:
        return np.zeros((kinds, count))
    # circulant embedding: exact as long as the record's double length outlasts the correlation
    length = 2 * (count + int(12 * time_s / step_s))
    lag = np.minimum(np.arange(length), length - np.arange(length)) * step_s
    power = np.maximum(np.fft.rfft(np.exp(-lag / time_s)).real, 0.0)
    white = np.fft.rfft(rng.normal(size=(kinds, length)), axis=-1)
    return sd * np.fft.irfft(white * np.sqrt(power), n=length, axis=-1)[:, :count]
