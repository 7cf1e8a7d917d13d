"""Rows of tracks.csv as a follower that knows its marks one by one writes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..record.errors import TrackingError
from ..record.run import Run
from ..record.schema import Marker
from .recording import Frame

DAMAGED = "damaged frame"
COLUMNS = ["frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status", "reason"]


class Rows:
    """Rows of some markers, to begin a follower with (``looks.Follower``): ``measured`` or ``lost`` once a marker and frame.

    Attributes
    ----------
    run, markers : what is followed
    losses : rows that are lost so far
    ambiguous : another assignment of what was seen to the marks is nearly as good; false: each is known by itself
    """

    ambiguous = False

    def __init__(self, run: Run, markers: Sequence[Marker], *_: object) -> None:
        self.run, self.markers = run, tuple(markers)
        self.losses = 0
        self._rows: list[tuple] = []

    def measured(
        self, index: int, t_s: float, marker: Marker, centre_px: Sequence[float], sigma_px: Sequence[float]
    ) -> None:
        """A mark that was seen: place and standard deviation, each u and v."""
        self._rows.append((index, t_s, marker.name, *centre_px, *sigma_px, "measured", ""))

    def lost(self, index: int, t_s: float, marker: Marker, reason: str) -> None:
        """A mark that was not seen, and why ("covered")."""
        self._rows.append((index, t_s, marker.name, *[np.nan] * 4, "lost", reason))
        self.losses += 1

    def damaged(self, frame: Frame) -> bool:
        """Whether the frame is damaged; all marks are lost in it then."""
        if frame.damaged:
            for marker in self.markers:
                self.lost(frame.index, frame.t_s, marker, DAMAGED)
        return frame.damaged

    def finish(self) -> pd.DataFrame:
        """All rows, frame by frame; TrackingError where a marker was measured less than twice."""
        return self.table("is it in the picture from the first analysed frame on?")

    def table(self, hint: str) -> pd.DataFrame:
        """As ``finish``, with a hint for the user in the error."""
        for marker in self.markers:
            if sum(row[2] == marker.name and not row[-1] for row in self._rows) < 2:
                raise TrackingError(
                    f"{self.run.source_path}: marker {marker.name!r} ({marker.look}) was never followed; {hint}"
                )
        return pd.DataFrame(sorted(self._rows, key=lambda row: row[0]), columns=COLUMNS)


__all__ = ["COLUMNS", "DAMAGED", "Rows"]
