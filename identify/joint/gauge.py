"""A load cell's history as an observation of a line that keeps its length: T follows from the motion, the gauge says it again.

The gauge reads T with a scale, a zero and a delay of its own; their priors stand in its covariance, so that block means weigh what
they are worth: a zero moves all of them, a scale those of the swings too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from ..data import RunData

BLOCK_S = 0.4
"""Means over so long: a tow swings in 10-20 s, springing and the cell's own ringing are faster."""
LEAST_SHARE = 0.002
"""Noise of a block's mean is not taken for smaller than this of the mean tension."""


@dataclass(frozen=True)
class GaugeBlocks:
    """A run's history in block means.

    Attributes
    ----------
    t_s : (q,), from the run's first sample
    tension_n : (q,)
    white : (q, q), whitens them
    noise_n : standard deviation of a mean without scale, zero and delay
    shapes : what one standard deviation of scale, zero and delay does to them, (q,), by the name of its prior
    """

    t_s: Array
    tension_n: Array
    white: Array
    noise_n: float
    shapes: dict[str, Array]


def white_sd(values: Array) -> float:
    """Standard deviation of a record's white noise, by third differences, which a swing hardly moves; 0 of fewer than seven values.

    Parameters
    ----------
    values : (n,), evenly spaced
    """
    third = np.diff(values, 3)
    return float(np.median(np.abs(third))) / 0.6745 / np.sqrt(20.0) if len(third) > 3 else 0.0


def gauge_blocks(data: RunData) -> GaugeBlocks | None:
    """The history within the run's record; None without one.

    Its noise is judged from third differences of the means, which a swing hardly moves.
    """
    if data.gauge is None:
        return None
    clock, tension = data.gauge[0] - data.t_s[0], data.gauge[1]
    inside = (clock >= 0) & (clock <= data.t_s[-1] - data.t_s[0])
    cell = np.floor(clock[inside] / BLOCK_S).astype(int)
    cell -= cell[0]
    count = np.bincount(cell)
    full = count > 0.5 * np.median(count[count > 0])
    times = np.bincount(cell, clock[inside])[full] / count[full]
    means = np.bincount(cell, tension[inside])[full] / count[full]
    mean = abs(float(means.mean()))
    noise = max(white_sd(means), LEAST_SHARE * mean)
    priors = data.priors
    slope = np.gradient(means, times) if len(means) > 1 else np.zeros(1)
    shapes = {
        "tension_sd_rel": priors.tension_sd_rel * means,
        "tension_zero_sd_n": np.full(len(means), priors.tension_zero_sd_n),
        "tension_delay_sd_s": priors.tension_delay_sd_s * slope,
    }
    covariance = noise**2 * np.eye(len(means)) + sum(np.outer(s, s) for s in shapes.values())
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    return GaugeBlocks(times, means, white, noise, shapes)


__all__ = ["GaugeBlocks", "gauge_blocks", "white_sd"]
