"""Datum points with ``track = true``, re-found in every frame: what the camera itself does."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..record.run import Run
from .recording import Frame
from .rows import COLUMNS, DAMAGED


class DatumMarks:
    """One template per point, picked where run.toml says; a point that the model hides is `lost` there."""

    def __init__(self, run: Run) -> None:
        self.points = {p.name or f"point {i + 1}": p for i, p in enumerate(run.file.datum) if p.track}
        self.followers: list | None = None
        self.rows: list[tuple] = []

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        from .template import TemplateFollower

        if frame.damaged:
            self.rows += [(frame.index, frame.t_s, name, *[np.nan] * 4, "lost", DAMAGED) for name in self.points]
            return
        if self.followers is None:
            white = float(frame.white_dn)
            self.followers = [TemplateFollower(np.array(p.pixel_px), white_dn=white) for p in self.points.values()]
        for name, follower in zip(self.points, self.followers, strict=True):
            self._take(name, follower.step(frame.index, frame.t_s, frame.luma))

    def finish(self) -> pd.DataFrame | None:
        """All rows, frame by frame; None where no point is tracked."""
        if not self.points:
            return None
        for name, follower in zip(self.points, self.followers or [], strict=False):
            self._take(name, follower.finish())
        return pd.DataFrame(sorted(self.rows, key=lambda row: row[0]), columns=COLUMNS)

    def _take(self, name: str, places) -> None:
        for place in places:
            seen = (*place.centre_px, *place.sigma_px) if not place.reason else (np.nan,) * 4
            self.rows.append(
                (place.index, place.t_s, name, *seen, "lost" if place.reason else "measured", place.reason)
            )
