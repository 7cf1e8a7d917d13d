"""Markers that are known by themselves - a template picked in one frame, a printed fiducial - as rows of tracks.csv."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from ..record.corrections import Placed
from ..record.errors import InputError
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from .follower import Glance
from .recording import Frame
from .rows import Rows


class _Placed(Rows):
    """Rows from places: with centre_px, sigma_px, and a reason where nothing was found."""

    def take(self, index: int, t_s: float, marker: Marker, place) -> None:
        """One mark in one frame."""
        if place.reason:
            self.lost(index, t_s, marker, place.reason)
        else:
            self.measured(index, t_s, marker, place.centre_px, place.sigma_px)


class TemplateMark(_Placed):
    """A patch that the user picked in the first analysed frame."""

    def __init__(self, run: Run, markers: Sequence[Marker], *_: object) -> None:
        super().__init__(run, markers)
        [self.marker] = self.markers
        self.follower = None
        self._seed: Placed | None = None
        self._pick_px = 0.0

    def begin_again(self, seed: Placed) -> None:
        """In the next frame the point is where a person saw it.

        The template is looked for there, so that the point stays the same point of the body; where it is not there, another is cut
        out of that frame, and all places from it hold what the person's pick is off by.
        """
        self._seed = seed

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        from .template import TemplateFollower

        if self.damaged(frame):
            return
        if self._seed is not None:
            seed, self._seed = self._seed, None
            place = np.array(seed.pixel_px)
            if self.follower is not None:
                self._take(self.follower.finish())
            if self.follower is None or not self.follower.seek(place, frame.t_s, frame.luma):
                self.follower = TemplateFollower(place, white_dn=float(frame.white_dn))
                self._pick_px = seed.sigma_px
        if self.follower is None:
            self.follower = TemplateFollower(np.array(self.marker.seen_at_px), white_dn=float(frame.white_dn))
        self._take(self.follower.step(frame.index, frame.t_s, frame.luma))

    def finish(self) -> pd.DataFrame:
        """All rows."""
        if self.follower is not None:
            self._take(self.follower.finish())
        return self.table("seen_at_px must be its place in the first analysed frame, on something with texture")

    def _take(self, places) -> None:
        for place in places:
            if self._pick_px:
                place = replace(place, sigma_px=np.hypot(place.sigma_px, self._pick_px))
            self.take(place.index, place.t_s, self.marker, place)


class FiducialMarks(_Placed):
    """Printed ArUco and AprilTag marks."""

    def __init__(self, run: Run, markers: Sequence[Marker], *_: object) -> None:
        from .fiducial import FiducialFollower

        super().__init__(run, markers)
        self.looks = [m.look for m in self.markers]
        try:
            FiducialFollower(self.looks)
        except ValueError as error:
            raise InputError(run.folder / RUN_FILE, "marker.look", str(error)) from None
        self.follower: FiducialFollower | None = None

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        from .fiducial import FiducialFollower

        if self.damaged(frame):
            return
        if self.follower is None:
            self.follower = FiducialFollower(self.looks, float(frame.white_dn))
        for marker, place in zip(self.markers, self.follower.step(frame.index, frame.t_s, frame.luma), strict=True):
            self.take(frame.index, frame.t_s, marker, place)

    def finish(self) -> pd.DataFrame:
        """All rows."""
        return self.table(
            "is it in the picture, whole and sharp? Tags of several dictionaries in one run, and a worn one, name theirs: "
            '"aruco:4x4:7"'
        )

    def look_often(self) -> None:
        """Every frame is told by itself already."""

    def see(self, frame: Frame) -> None:
        """Take one frame."""
        self.step(frame)

    def settle(self, frame: Frame) -> None:
        """Nothing is left to do."""

    def glance(self, frame: Frame) -> list[Glance]:
        """The frame's own rows."""
        last = [row for row in self._rows[-len(self.markers) :] if row[0] == frame.index]
        return [Glance(*row[2:7], reason=row[-1]) for row in last]
