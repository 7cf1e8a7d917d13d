"""Marks that a person has seeded: what follows them begins again at a frame, where the person saw them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

import numpy as np
import pandas as pd

from ..record.corrections import Placed
from ..record.errors import TrackingError
from ..record.looks import look_of
from ..record.schema import Marker
from ..record.tables import seen_rows
from .follower import Follower
from .recording import Frame
from .rows import COLUMNS, DAMAGED

BEFORE_SEED = "not found yet"
"""Why a mark is lost in the frames before a seed where nothing was found without it."""
OTHER_MARK_PX = 8.0
"""A mark without a seed of its own begins where it was held; not where that is this near a seed of another: then the two were taken
for each other. Two standard deviations of a rough pick (``spots.identity.SEEN_SD_PX``)."""


@runtime_checkable
class BeginsAgain(Protocol):
    """A follower of one mark that takes a seed itself, and keeps what it has learnt of the mark."""

    def begin_again(self, seed: Placed) -> None:
        """In the next frame the mark is there."""
        ...


class SeededFollower:
    """A follower (``looks.Follower``) that is begun anew at every seeded frame; frames before keep what they had.

    Parameters
    ----------
    begin : makes a follower of the markers, whose ``seen_at_px`` holds for the first frame that it is given
    markers : of run.toml
    seeds : frame -> marker -> seed

    Attributes
    ----------
    losses : rows that are lost so far
    ambiguous : another assignment of what was seen to the marks was nearly as good, and no seed has told them apart since
    """

    def __init__(
        self,
        begin: Callable[[tuple[Marker, ...]], Follower],
        markers: tuple[Marker, ...],
        seeds: Mapping[int, Mapping[str, Placed]],
    ) -> None:
        self._begin, self.markers, self._seeds = begin, markers, dict(seeds)
        self._follower = begin(markers)
        self._frames: list[tuple[int, float, bool]] = []
        self._done: list[pd.DataFrame] = []
        self._lost = 0
        self._failed: TrackingError | None = None
        self._from = -1
        self.losses = 0
        self.ambiguous = False

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        seeds = self._seeds.pop(frame.index, None)
        if seeds is not None:
            self._again(frame, seeds)
        if self._failed is None:
            self._step(frame)
        self._frames.append((frame.index, frame.t_s, frame.damaged))
        self.losses = self._lost + self._follower.losses
        self.ambiguous = self._from < 0 and self._follower.ambiguous

    def finish(self) -> pd.DataFrame:
        """All rows; TrackingError where the marks were not found at the last seed, or without one never."""
        table = pd.concat([*self._done, self._last()], ignore_index=True)
        if "repeated" in table:
            table["repeated"] = table["repeated"].fillna(0).astype(int)
        return table

    def _step(self, frame: Frame) -> None:
        try:
            self._follower.step(frame)
        except TrackingError as error:
            if not self._seeds:
                raise self._named(error) from None
            self._failed = error  # a seed that is still to come may help

    def _again(self, frame: Frame, seeds: Mapping[str, Placed]) -> None:
        """Begin anew in a frame that the old follower has not seen."""
        self._from = frame.index
        if isinstance(self._follower, BeginsAgain) and self._frames:
            for seed in seeds.values():
                self._follower.begin_again(seed)
            return
        held = self._close(frame) if self._frames else {}
        known = {name: seed.pixel_px for name, seed in seeds.items()}
        for name, place in held.items():
            if all(np.hypot(place[0] - u, place[1] - v) > OTHER_MARK_PX for u, v in known.values()):
                known.setdefault(name, place)
        for marker in self.markers:
            look = look_of(marker.look)
            if marker.name not in known and look is not None and "seen_at_px" in look.needs:
                words = f"is not seen in frame {frame.index}, where others are seeded: give it a seed too"
                raise TrackingError(f"{marker.name!r} ({marker.look}) {words}")
        self._follower = self._begin(
            tuple(m.model_copy(update={"seen_at_px": known.get(m.name)}) for m in self.markers)
        )
        self._frames, self._failed = [], None

    def _close(self, frame: Frame) -> dict[str, tuple[float, float]]:
        """Keep the rows so far; where the marks are in ``frame`` as the old follower sees it."""
        table = None
        try:
            if self._failed is None:
                self._follower.step(frame)
                table = self._follower.finish()
        except TrackingError:
            pass
        if table is None:
            table = self._nothing()
        before = table["frame"] < frame.index
        self._done.append(table[before])
        self._lost += int((table["status"][before] == "lost").sum())
        here = table[~before & seen_rows(table)]
        return {str(row.marker): (float(row.u_px), float(row.v_px)) for row in here.itertuples()}  # pyright: ignore

    def _nothing(self) -> pd.DataFrame:
        rows = [
            (index, t_s, marker.name, *[np.nan] * 4, "lost", DAMAGED if damaged else BEFORE_SEED)
            for index, t_s, damaged in self._frames
            for marker in self.markers
        ]
        return pd.DataFrame(rows, columns=COLUMNS)

    def _last(self) -> pd.DataFrame:
        try:
            if self._failed is not None:
                raise self._failed
            return self._follower.finish()
        except TrackingError as error:
            raise self._named(error) from None

    def _named(self, error: TrackingError) -> TrackingError:
        return error if self._from < 0 else TrackingError(f"from the seed in frame {self._from} on: {error}")


__all__ = ["SeededFollower"]
