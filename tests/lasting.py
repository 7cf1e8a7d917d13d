"""Noise that lasts."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from towline.diagnose.tow.slow import SLOW_S


def lasting(rng: np.random.Generator, count: int, step_s: float) -> np.ndarray:
    """(count,) of unit variance that forgets itself within SLOW_S.

    Parameters
    ----------
    rng : that draws
    count : of samples
    step_s : between them
    """
    a = np.exp(-step_s / SLOW_S)
    drawn = rng.normal(size=count)
    drawn[0] /= np.sqrt(1 - a**2)
    return np.asarray(lfilter([np.sqrt(1 - a**2)], [1, -a], drawn))
