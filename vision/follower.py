"""The contract of what follows some markers of a run through its frames."""

from __future__ import annotations

from typing import Protocol

import pandas as pd

from .recording import Frame


class Follower(Protocol):
    """What follows some markers of a run through its frames.

    Attributes
    ----------
    losses : rows that are lost so far, for the progress line
    ambiguous : when the marks were found, another assignment of what was seen to the markers was nearly as good
    """

    losses: int
    ambiguous: bool

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


__all__ = ["Follower"]
