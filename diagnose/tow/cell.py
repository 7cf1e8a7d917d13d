"""What a load cell says of a line that keeps its length: an observation of its pull, on a clock of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...identify.data import RunData
from ...identify.joint.gauge import white_sd
from ...simulate.model import Array

SCALE_REL, ZERO_REL = 0.003, 0.003
"""Scale and zero of a load cell where [priors] is silent, as a share of its reading and of its mean."""
SLOW_REL, SLOW_S = 0.002, 4.0
"""What else comes and goes within the second, as a share of its mean (a creeping cell, ripples of the carriage)."""
SETTLES_S = 3.0
"""A model that is let go bounces on its line for so long: no pull of a line that keeps its length. 80 kg on 20 kN/m, damped by a
twentieth, has a third of its bounce left after one and a half seconds, a tenth after three.
"""


@dataclass(frozen=True)
class CellMeans:
    """Means over a run's blocks.

    Attributes
    ----------
    pull_n : (n,), NaN where the cell says nothing
    covariance : (n, n), N2
    centre_s, spread_s2 : (n,), mean time of the samples in each block, from the run's start, and their variance
    """

    pull_n: Array
    covariance: Array
    centre_s: Array
    spread_s2: Array


def cell_means(data: RunData, start_s: float, step_s: float, count: int) -> CellMeans | None:
    """A run's load cell in means over its blocks; None where there is none, or it says nothing while the run lasts.

    Parameters
    ----------
    data : of the run
    start_s, step_s, count : of the blocks

    Notes
    -----
    Its noise is judged from third differences, which a swing hardly moves. Scale and zero stand in the covariance.
    """
    if data.gauge is None:
        return None
    t_s, pull = data.gauge[0] - start_s, data.gauge[1]
    block = np.floor(t_s / step_s).astype(int)
    inside = (t_s >= SETTLES_S) & (block < count)
    block, t_s, pull = block[inside], t_s[inside], pull[inside]
    number = np.bincount(block, minlength=count)
    there = number > 0
    if there.sum() < 2:
        return None
    share = 1 / np.maximum(number, 1)
    usual = (np.arange(count) + 0.5) * step_s
    centre = np.where(there, np.bincount(block, t_s, minlength=count) * share, usual)
    spread = np.bincount(block, (t_s - centre[block]) ** 2, minlength=count) * share
    mean = np.where(there, np.bincount(block, pull, minlength=count) * share, np.nan)
    white, level, reading = white_sd(pull), abs(float(np.nanmean(mean))), np.nan_to_num(mean)
    priors = data.priors
    scale = priors.tension_sd_rel or SCALE_REL
    zero = priors.tension_zero_sd_n or ZERO_REL * level
    lag = np.abs(centre[:, None] - centre[None, :])
    covariance = np.diag(white**2 * np.where(there, share, 1.0)) + (SLOW_REL * level) ** 2 * np.exp(-lag / SLOW_S)
    covariance += scale**2 * np.outer(reading, reading) + zero**2
    return CellMeans(mean, covariance, centre, spread)


__all__ = ["CellMeans", "cell_means"]
