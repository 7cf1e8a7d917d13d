"""Slow errors of measured values that a static record does not show: of a mark's place (codec, texture, the pixels' grid) and of a
taut line's length.

How large they are is not known: they are granted at first (SLOW_PX, LINE_SD_M), and runs that show less of them are granted less
(``quiet.py``). They last, so that a run's means do not wear them off: where they are small, granting them hides every weak effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class SlowErrors:
    """Of one run.

    Attributes
    ----------
    marks : (4,) standard deviations of y, heading, line and distance, by the marks' places; 0 where nothing was measured
    line : (4,) the same, by the line's length
    shared : correlation of the marks' in y with those in the heading
    """

    marks: Array
    line: Array
    shared: float

    def covariance(self, lag_s: Array) -> Array:
        """(4, n, n) of the channels, at such distances in time.

        Parameters
        ----------
        lag_s : (n, n)
        """
        return (self.marks**2 + self.line**2)[:, None, None] * np.exp(-lag_s / SLOW_S)

    def cross(self, lag_s: Array) -> Array:
        """Of y with the heading, at such distances in time.

        Parameters
        ----------
        lag_s : (n, n)
        """
        return self.shared * self.marks[0] * self.marks[1] * np.exp(-lag_s / SLOW_S)

    def scaled(self, marks: float, line: float) -> SlowErrors:
        """These shares of the marks' and of the line's.

        Parameters
        ----------
        marks : of what the marks' places do
        line : of what the line's length does
        """
        return replace(self, marks=marks * self.marks, line=line * self.line)


__all__ = ["LINE_SD_M", "SLOW_PX", "SLOW_S", "SLOW_UNSEEN_PX", "SlowErrors"]
