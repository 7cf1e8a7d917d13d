"""Slow errors of measured values that a static record does not show: of a mark's place (codec, texture, the pixels' grid) and of a
taut line's length.

How large they are is not known: they are granted (SLOW_PX, LINE_SD_M). They last, so that a run's means do not wear them off: where
there are none, granting them hides every weak effect. Marks that came without a film are granted what they show (``quiet.py``); a
film's are not, as what light on a deck and a codec do to a mark goes with its place and is no steady noise whose size runs tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array

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
    unfilmed : the marks came without a film, beside a static record: there may be less of them
    """

    sd: Array
    shared: float
    unfilmed: bool = False

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


__all__ = ["LEAST", "LINE_SD_M", "SLOW_PX", "SLOW_S", "SLOW_UNSEEN_PX", "SlowErrors"]
