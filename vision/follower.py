"""The contract of what follows some markers of a run through its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import pandas as pd

from .recording import Frame


class Follower(Protocol):
    """What follows some markers of a run through its frames.

    Attributes
    ----------
    losses : rows that are lost so far, for the progress line
    """

    losses: int

    @property
    def ambiguous(self) -> bool:
        """When the marks were found, another assignment of what was seen to the markers was nearly as good."""
        ...

    def step(self, frame: Frame) -> None:
        """Take the next frame; it may be ``damaged``."""
        ...

    def finish(self) -> pd.DataFrame:
        """A row a frame and marker, frame by frame.

        Columns as in tracks.csv: frame, t_s, marker, u_px, v_px, sigma_u_px, sigma_v_px, status ("measured", "lost"), and reason
        (why lost, "" where measured). Sigmas are what the frame itself shows; path and rigid body widen them later (``scatter``).

        Raises
        ------
        TrackingError : the marks were never found
        """
        ...


@dataclass(frozen=True)
class Glance:
    """One mark in one frame.

    Attributes
    ----------
    marker : its name
    u_px, v_px : place; NaN where it is not seen
    sigma_u_px, sigma_v_px : standard deviations, what its path shows beyond the fit included; NaN where it is not seen
    reason : why it is not seen; "" where it is
    peak_dn : brightest pixel of its window; NaN where there is none
    width_px : standard deviation of its picture; NaN where it is not known
    clipped : share of its light's pixels that are as bright as the recording can say
    lag_px : how far a codec may hold it back (standard deviation), which is in sigma_u_px and sigma_v_px, too
    """

    marker: str
    u_px: float = np.nan
    v_px: float = np.nan
    sigma_u_px: float = np.nan
    sigma_v_px: float = np.nan
    reason: str = ""
    peak_dn: float = np.nan
    width_px: float = np.nan
    clipped: bool = False
    lag_px: float = 0.0

    @property
    def seen(self) -> bool:
        """It has a place."""
        return not self.reason


@runtime_checkable
class Glancing(Protocol):
    """A follower that can be asked while the film is taken (``glance.Glances``); one that cannot serves recordings only."""

    def see(self, frame: Frame) -> None:
        """The first half of ``Follower.step``: what ``glance`` needs, quickly done."""
        ...

    def settle(self, frame: Frame) -> None:
        """The other half, before the next frame: what takes longer."""
        ...

    def look_often(self) -> None:
        """Someone waits for the places: judge what is seen as soon as may be."""
        ...

    def glance(self, frame: Frame) -> list[Glance]:
        """Where each mark seems to be in the frame that ``see`` took last, by that frame alone."""
        ...


__all__ = ["Follower", "Glance", "Glancing"]
