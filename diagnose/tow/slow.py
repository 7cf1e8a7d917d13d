"""Slow errors of measured values that a static record does not show: of a mark's place (codec, texture, the pixels' grid) and of a
taut line's length.

They last, so that a run's means do not wear them off. Granted where there are none they hide every weak effect; where there are
more than are granted, some effect explains them. So much is granted at first (SLOW_PX, LINE_SD_M); a film's marks are granted what
their distance shows (``lasting.py``), marks without a film what the simulator as it is shows (``quiet.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array
from .channels import LINE

SLOW_PX = 0.015
"""Of a mark's place, beside a static record."""
SLOW_UNSEEN_PX = 0.12
"""The same where no static record says what the codec does."""
SLOW_S = 4.0
"""Correlation time of those slow errors: a choice."""
LINE_SD_M = 2e-4
"""A taut line's length is not known to be steadier than this."""
LEAST = 0.125
"""The least share that is granted: white noise hides what is left."""


@dataclass(frozen=True)
class SlowErrors:
    """Of one run.

    Attributes
    ----------
    sd : (4,) standard deviations of y, heading, line and distance; 0 where nothing was measured
    shared : correlation of y with the heading
    size_px : of a mark's place; NaN where the run came as motion
    unfilmed : the marks came without a film, beside a static record: there may be less of them
    """

    sd: Array
    shared: float
    size_px: float = float("nan")
    unfilmed: bool = False

    @property
    def by_distance(self) -> bool:
        """Whether the distance between two marks tells how large they are: not where ``quiet.py`` does, nor without marks."""
        return bool(np.isfinite(self.size_px)) and not self.unfilmed

    def less(self, channels: Sequence[int], share: float) -> SlowErrors:
        """A share of them in some channels.

        Parameters
        ----------
        channels : of CHANNELS, their places
        share : of what these have
        """
        return replace(self, sd=np.where(np.isin(np.arange(4), channels), share, 1.0) * self.sd)

    def of_size(self, size_px: float) -> SlowErrors:
        """With another size of a mark's; a line's own errors stay.

        Parameters
        ----------
        size_px : of a mark's place
        """
        ratio = size_px / self.size_px
        sd = ratio * self.sd
        if self.sd[LINE] > 0:
            sd[LINE] = np.hypot(ratio * np.sqrt(max(self.sd[LINE] ** 2 - LINE_SD_M**2, 0.0)), LINE_SD_M)
        return replace(self, sd=sd, size_px=size_px)

    def covariance(self, lag_s: Array) -> Array:
        """(4, n, n) of the channels, at such distances in time.

        Parameters
        ----------
        lag_s : (n, n)
        """
        return (self.sd**2)[:, None, None] * np.exp(-lag_s / SLOW_S)

    def cross(self, lag_s: Array) -> Array:
        """Of y with the heading, at such distances in time.

        Parameters
        ----------
        lag_s : (n, n)
        """
        return self.shared * self.sd[0] * self.sd[1] * np.exp(-lag_s / SLOW_S)


def lag_of(centre_s: Array) -> Array:
    """(n, n) distances of times (n,)."""
    return np.abs(centre_s[:, None] - centre_s[None, :])


__all__ = ["LEAST", "LINE_SD_M", "SLOW_PX", "SLOW_S", "SLOW_UNSEEN_PX", "SlowErrors", "lag_of"]
