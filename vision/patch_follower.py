"""Markers that are known by themselves - a template picked in one frame, a printed fiducial - as rows of tracks.csv."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..record.errors import TrackingError
from ..record.run import Run
from ..record.schema import Marker
from .recording import Frame

DAMAGED = "damaged frame"


class _Rows:
    """Rows of one or several markers, in the order of the frames."""

    ambiguous = False

    def __init__(self, run: Run) -> None:
        self.run = run
        self.losses = 0
        self.rows: list[tuple] = []

    def add(self, index: int, t_s: float, marker: Marker, place, reason: str) -> None:
        """One mark in one frame; ``place`` has centre_px and sigma_px."""
        seen = (*place.centre_px, *place.sigma_px) if not reason else (np.nan,) * 4
        self.rows.append((index, t_s, marker.name, *seen, "lost" if reason else "measured", reason))
        self.losses += bool(reason)

    def table(self) -> pd.DataFrame:
        """The rows so far."""
        names = ["frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status", "reason"]
        return pd.DataFrame(sorted(self.rows, key=lambda row: row[0]), columns=names)

    def never(self, marker: Marker, hint: str) -> None:
        """TrackingError unless the marker was measured twice."""
        if sum(row[2] == marker.name and not row[-1] for row in self.rows) < 2:
            raise TrackingError(
                f"{self.run.source_path}: marker {marker.name!r} ({marker.look}) was never followed; {hint}"
            )


class TemplateMark(_Rows):
    """A patch that the user picked in the first analysed frame."""

    def __init__(self, run: Run, marker: Marker) -> None:
        super().__init__(run)
        self.marker = marker
        self.follower = None

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        from .template import TemplateFollower

        if frame.damaged:
            self.add(frame.index, frame.t_s, self.marker, None, DAMAGED)
            return
        if self.follower is None:
            self.follower = TemplateFollower(np.array(self.marker.seen_at_px), white_dn=float(frame.white_dn))
        self._take(self.follower.step(frame.index, frame.t_s, frame.luma))

    def finish(self) -> pd.DataFrame:
        """All rows."""
        if self.follower is not None:
            self._take(self.follower.finish())
        self.never(self.marker, "seen_at_px must be its place in the first analysed frame, on something with texture")
        return self.table()

    def _take(self, places) -> None:
        for place in places:
            self.add(place.index, place.t_s, self.marker, place, place.reason)


class FiducialMarks(_Rows):
    """Printed ArUco and AprilTag marks."""

    def __init__(self, run: Run, markers: tuple[Marker, ...]) -> None:
        super().__init__(run)
        self.markers = markers
        self.follower = None

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        from .fiducial import FiducialFollower

        if frame.damaged:
            for marker in self.markers:
                self.add(frame.index, frame.t_s, marker, None, DAMAGED)
            return
        if self.follower is None:
            self.follower = FiducialFollower([m.look for m in self.markers], float(frame.white_dn))
        for marker, place in zip(self.markers, self.follower.step(frame.index, frame.t_s, frame.luma), strict=True):
            self.add(frame.index, frame.t_s, marker, place, place.reason)

    def finish(self) -> pd.DataFrame:
        """All rows."""
        for marker in self.markers:
            self.never(marker, "no family of tags shows this number; is it in the picture, and sharp?")
        return self.table()
