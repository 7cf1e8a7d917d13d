"""What one of two cameras saw so far, by its ``live.jsonl``: as poses, as a view to be matched with the other's.

Where the source stamps nothing, times are those of the camera's beat (``vision.recording.beat``) as soon as one is told.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import DatumFit
from ..geometry.cameras.afloat import NUMBERS, afloat_view
from ..geometry.cameras.flash import Lit
from ..geometry.cameras.view import View, shared_modes, view_of
from ..geometry.lag import lag_modes
from ..geometry.phase import phase_modes
from ..geometry.poses import Framed, Poses, poses_of
from ..record.errors import InputError
from ..record.run import Run
from ..vision.flash import flashes
from ..vision.glance import LEAST_WIDEN
from ..vision.recording.beat import Beat, on_beat

LONGEST_S = 60.0
"""No more than the last so many seconds are matched: some swings, in some tenths of a second."""
MARGIN_S = 0.7
"""Frames so long before those that are joined go with them: the rates of a path rest on 0.6 s about it (``view.rates``), and a
cubic between frames on the two before."""


class CameraFrames:
    """Frames of one camera by what its log says; the oldest are put away.

    Parameters
    ----------
    view : the run as this camera sees it
    fit : of its datum

    Attributes
    ----------
    mapping : pixel -> tank
    t_s, arrived_s : of each frame: on the camera's own clock, and when it was here
    began_s : time of the first frame that came
    """

    def __init__(self, view: Run, fit: DatumFit) -> None:
        self.view, self.mapping = view, fit.mapping
        self._names = [mark.name for mark in view.file.marker]
        self.t_s: list[float] = []
        self.arrived_s: list[float] = []
        self.began_s = np.nan
        self._frames: list[int] = []
        self._marks: list[NDArray[np.float64]] = []
        self._light: list[float] = []
        self._lag_px = self._lag_now_px = np.zeros(len(self._names))
        self._put_away = 0
        # of a source that stamps nothing: when its pictures came, and the camera's beat as far as that tells it
        self._came_s: list[float] = []
        self._stamped_on_arrival = False
        self._beat: Beat | None = None

    def add(self, records: Iterable[dict[str, Any]]) -> None:
        """Take new lines of its log."""
        nothing = [np.nan] * 4
        for record in records:
            if "frame" not in record or (self._came_s and record["t_s"] <= self._came_s[-1]):
                continue
            marks = [record["marks"].get(name) for name in self._names]
            seen = [m if isinstance(m, list) and None not in m else nothing for m in marks]
            self._frames.append(record["frame"])
            self._came_s.append(record["t_s"])
            self._stamped_on_arrival |= record.get("on_arrival", False)
            self.t_s.append(self._taken_s())
            self.arrived_s.append(record["arrived_s"])
            lag_px = record.get("lag_px", {})
            self._lag_now_px = np.array([lag_px.get(name, 0.0) for name in self._names])
            of_marks = np.array(seen, dtype=float)
            # what a codec holds back is in the log's sigma; here it is apart, as in tables
            of_marks[:, 2:] = np.sqrt(of_marks[:, 2:] ** 2 - self._lag_now_px[:, None] ** 2)
            self._marks.append(of_marks)
            light = record.get("light")
            self._light.append(np.nan if light is None else light)
        if self.t_s and np.isnan(self.began_s):
            self.began_s = self.t_s[0]
        old = bisect_right(self.t_s, self.t_s[-1] - LONGEST_S - MARGIN_S) if self.t_s else 0
        for kept in (self._frames, self.t_s, self._came_s, self.arrived_s, self._marks, self._light):
            del kept[:old]
        self._put_away += old

    def _taken_s(self) -> float:
        """When the newest picture was taken."""
        came_s = self._came_s[-1]
        return came_s if self._beat is None or not self.t_s else self._beat.after(came_s, self.t_s[-1])

    def take_beat(self) -> None:
        """Of a source that stamps nothing: times are those of the camera's beat from now on, those that are kept as well."""
        if self._stamped_on_arrival:
            self._beat = on_beat(np.array(self._came_s))
            self.t_s = self._beat.t_s.tolist()

    @property
    def sure(self) -> slice:
        """Frames whose marks' sigma holds what their paths show, and the codec: not the first ones."""
        return slice(max(LEAST_WIDEN - self._put_away, 0), None)

    def poses(self, some: slice = slice(None)) -> Poses:
        """Of some of the frames; InputError where no two marks are seen in any of them."""
        marks, t_s, frames = np.array(self._marks[some]), np.array(self.t_s[some]), np.array(self._frames[some])
        pixel, sigma = marks[..., :2], marks[..., 2:]
        repeated = np.zeros(pixel.shape[:2], dtype=bool)
        lags = lag_modes(frames, t_s, pixel, self._lag_px, repeated)
        framed = Framed(frames, t_s, pixel, sigma, lags, phase_modes(t_s, pixel), notes=())
        return poses_of(self.view, framed, self.mapping, pulled=True)

    def take_lags(self) -> None:
        """From now on a codec's lags are as large as was said of them last; they stay so until this is called again."""
        self._lag_px = self._lag_now_px

    def view_from(self, begin_s: float, least: int, size: int, like: View | None) -> View:
        """What it sees of the model from a time of its own clock on, at least so many frames, in so many numbers a pose.

        ``like``: another view of its own, with whose modes it goes.
        """
        first = min(bisect_right(self.t_s, begin_s), max(len(self.t_s) - least, 0))
        some = slice(first, None)
        try:
            poses = self.poses(some)
            view = view_of(self.view, poses) if size < NUMBERS else afloat_view(self.view, poses, self.mapping)
        except InputError:
            view = None
        if view is not None and (like is None or len(view.modes) == len(like.modes)):
            return view
        t_s, shared = np.array(self.t_s[some]), shared_modes(self.view)
        n, modes, slow, pulls = len(t_s), shared, 0, 0
        if like is not None:
            modes, slow, pulls = len(like.modes), like.slow, like.pulls
        nowhere = np.full((n, size), np.nan), np.full((n, size, size), np.nan)
        return View(t_s, *nowhere, np.zeros((modes, n, size)), slow, pulls, shared)

    def lit(self) -> list[Lit]:
        """Flashes that it saw."""
        level = np.array(self._light)
        known = np.isfinite(level)
        return flashes(np.array(self.t_s)[known], level[known], self.view.file.source.exposure_s)

    @property
    def late_s(self) -> float:
        """How much more this machine's clock shows than the camera's, in the middle of its frames."""
        return float(np.median(np.array(self.arrived_s) - np.array(self.t_s)))


__all__ = ["MARGIN_S", "CameraFrames"]
