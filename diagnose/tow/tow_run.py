"""One run as the diagnosis sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ...geometry import DatumFit
from ...geometry.poses import Framed
from ...identify.data import RunData
from ...record.run import Run
from ...simulate.model import Array
from .channels import LINE, PULL
from .slow import SlowErrors, lag_of


@dataclass(frozen=True)
class Marks:
    """What camera faults need to be tried again on the same pixels.

    Attributes
    ----------
    run, tracks, fit : run, its tracks, its datum
    few : about one frame of each block, side by side
    seen : values (k, 4) of those
    """

    run: Run
    tracks: pd.DataFrame
    fit: DatumFit
    few: Framed
    seen: Array


@dataclass(frozen=True)
class TowRun:
    """One run, in blocks.

    Attributes
    ----------
    name : of the run
    data : for the estimators (stated tow, priors)
    marks : None where the run came as motion
    start_s, step_s : of the blocks
    centre_s : (n,), mean time of the frames in each block, from start_s
    spread_s2 : (n,), variance of those times
    values : (n, c), CHANNELS; NaN where not measured
    covariance : (c, n, n), measurement noise of each channel
    cross : (n, n), of y with beta
    slow : errors that last, as both hold them
    modes : (k, n, c), change with each common mode of the camera (unit variance)
    lags : (l, n, c), the same of how a film's codec holds the marks back (``geometry.lag``); none of marks without a film
    shutter : (2, n, 4, 3), change of x, y, beta and distance by 1 s of readout, row by row or column by column, per rate of x, y,
        beta
    length_pp_m, density_kg_m3, half_width_m : of model, water and tank (NaN: not given)
    run : as stated
    cell_s, cell_spread_s2 : (n,), mean time and variance of the load cell's samples in each block, by its own clock
    frame_s, radius_m : (f,), of every frame its time from start_s, and the taut-line radius (as in ``values``) that it shows
    x_m : (n,) mean x of LCG in each block; NaN where the run came as motion
    """

    name: str
    data: RunData
    marks: Marks | None
    start_s: float
    step_s: float
    centre_s: Array
    spread_s2: Array
    values: Array
    covariance: Array
    cross: Array
    slow: SlowErrors
    modes: Array
    lags: Array
    shutter: Array
    length_pp_m: float
    density_kg_m3: float
    half_width_m: float
    run: Run
    cell_s: Array
    cell_spread_s2: Array
    frame_s: Array
    radius_m: Array
    x_m: Array

    @property
    def shared(self) -> tuple[tuple[str, Array], ...]:
        """Keys and modes (k, n, c) of unit variance that are shared with runs of the same keys."""
        sets = (self.data.common_key, self.modes), (self.data.lag_key, self.lags)
        return tuple((key, modes) for key, modes in sets if len(modes))

    @property
    def celled(self) -> bool:
        """Whether it has the load cell's channel (all runs of a campaign, or none)."""
        return self.values.shape[1] > PULL

    def off_middle(self, radius: Array, least: int) -> Array | None:
        """(n,) a residual of the line's radius about its median, over its noise; 0 where it was not measured.

        Parameters
        ----------
        radius : (n,) NaN where not measured
        least : None where fewer were measured
        """
        good = np.isfinite(radius)
        if good.sum() < least:
            return None
        return np.where(good, radius - np.nanmedian(radius), 0.0) / self.usual_sd(LINE)

    def radius_by_parts(self, most: int) -> tuple[Array, Array, float]:
        """The taut-line radius in parts of a block, as many as the frames allow: what is quick shows its course.

        Parameters
        ----------
        most : parts of a block at most

        Returns
        -------
        middles (p,), s from start_s, means (p,), m, NaN where nothing was measured, and their sd: as if a block's noise were white
        """
        good = np.isfinite(self.radius_m)
        often = len(self.centre_s) * self.step_s / max(int(good.sum()), 1)
        parts = int(np.clip(self.step_s / often + 1e-6, 1, most))
        size, width = parts * len(self.centre_s), self.step_s / parts
        part = np.floor(self.frame_s / width + 1e-9).astype(int)
        inside = good & (part < size)
        means = means_of(part[inside], self.radius_m[inside, None], size)[0][:, 0]
        return width * (np.arange(size) + 0.5), means, self.usual_sd(LINE) * float(np.sqrt(parts))

    def usual_sd(self, channel: int) -> float:
        """Standard deviation of a block's mean in a channel, the median over the blocks."""
        return float(np.sqrt(np.median(np.diag(self.covariance[channel]))))

    def granted(self, slow: SlowErrors) -> TowRun:
        """The same with other slow errors.

        Parameters
        ----------
        slow : instead of its own
        """
        lag = lag_of(self.centre_s)
        covariance = self.covariance.copy()
        covariance[:4] += slow.covariance(lag) - self.slow.covariance(lag)
        return replace(
            self, covariance=covariance, cross=self.cross + slow.cross(lag) - self.slow.cross(lag), slow=slow
        )


def means_of(index: Array, values: Array, size: int) -> tuple[Array, Array]:
    """Means (size, columns) of the rows of each index, NaN where there are none, and how many there are.

    Parameters
    ----------
    index : (rows,) from 0
    values : (rows, columns)
    size : indices
    """
    count = np.bincount(index, minlength=size)
    total = np.stack([np.bincount(index, v, minlength=size) for v in values.T], axis=1)
    return np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], np.nan), count


__all__ = ["Marks", "TowRun", "means_of"]
