"""Lights and discs through a recording: acquisition on the whole frame, then a predicted window per marker.

Windows are cut frame by frame (``live``) and fitted a stretch at a time (``refine``); what the fits say of the end of a
stretch is where the next one begins.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from ...geometry.mapping import Mapping
from ...record.errors import TrackingError
from ...record.run import Run
from ...record.schema import Marker
from ..backend import Backend
from ..recording import Frame
from .candidates import Array
from .identity import SEEN_SD_PX
from .judge import JUMP_PX, Rigid, judge
from .live import LiveMark
from .refine import Refiner, Stack
from .search import Search
from .stretch import Found, Mark, Stretch, table_of

STRETCH_FRAMES = 64
"""Frames fitted together; a window of 31 x 31 pixels is kept of each."""
PROBATION_FRAMES = 8
"""A set of spots that loses one of its members within this many frames was not the set of marks."""
REFERENCE_FRAMES = 16
"""A mark's brightness is the median over its last so many frames: a choice."""
DOUBT_FRAMES = 4
"""What does not look like the mark for so many frames is judged at once."""
REACQUIRE_FRAMES = 10
"""While marks are lost, the whole frame is searched every so many frames: a choice, for its cost."""
SEARCH_SOON = (2, 5)
"""When all marks are lost at once, it is searched after so many frames too."""
KNOCK_PX, KNOCK_PX_S = 30.0, 100.0
"""A mark that is lost is looked for on the whole frame, about where it was seen last: a knocked camera, and its own way since."""
SEEN_FRAMES = 10
"""What the user says of where a mark is seen holds for so many frames of the search."""
ACQUIRE_WIDTHS_PX = (2.0, 4.0, 7.0)
"""Spot widths tried one after the other while nothing is known."""
ACQUIRE_EVERY_FRAME = 20
"""While nothing has been found: every frame at first, then ..."""
ACQUIRE_STRIDE = 15
"""... every so many frames: a choice, half a second of usual film."""


class SpotFollower:
    """Lights and discs: known by their distances, their common brightness, the taut line and the heading."""

    def __init__(self, run: Run, markers: tuple[Marker, ...], mapping: Mapping, backend: Backend) -> None:
        self.markers, self.backend = markers, backend
        self.search = Search(run, markers, mapping)
        self.rigid = Rigid(markers, mapping)
        self.marks: list[Mark | None] = [None] * len(markers)
        self.stretch = Stretch(len(markers))
        self.done: list[Found] = []
        self.size_px = (0, 0)
        self.tried = 0
        self.ambiguous = False
        self.on_probation = True
        self.losses = 0
        self.searched = -REACQUIRE_FRAMES

    @property
    def never_found(self) -> bool:
        """No marker was measured in two frames or more."""
        measured = np.array([(found.reason == "").sum(axis=1) for found in self.done]).sum(axis=0)
        return not (measured >= 2).any()

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        self.size_px = frame.luma.shape[1], frame.luma.shape[0]
        damaged = frame.damaged
        self.stretch.frames.append((frame.index, frame.t_s, damaged))
        if damaged:
            pass
        elif not any(self.marks):
            self._acquire(frame)
        else:
            self._look(frame)
        if len(self.stretch) >= self._length() or any(
            m is not None and m.live.doubtful == DOUBT_FRAMES for m in self.marks
        ):
            self.flush()
        if not damaged and any(self.marks) and self._search_due(frame):
            self.flush()
            if any(self.marks):
                self.searched = frame.index
                self._recover(frame)

    def _look(self, frame: Frame) -> None:
        for index, mark in enumerate(self.marks):
            if mark is None:
                continue
            seen = mark.live.look(frame.luma, frame.t_s)
            if seen is not None:
                self.stretch.keep(index, frame.luma, *seen, mark.refiner.half_px)

    def _length(self) -> int:
        """Frames of a stretch: few while the marks are new or one of them is lost, so that the end is known soon."""
        short = self.on_probation or any(m is not None and m.lost for m in self.marks)
        return PROBATION_FRAMES if short else STRETCH_FRAMES

    def _search_due(self, frame: Frame) -> bool:
        """Time to look for a lost mark on the whole frame."""
        unseen = [0 if m is None else max(m.live.unseen, m.lost) for m in self.marks]
        if all(m is None or m.live.unseen for m in self.marks) and max(unseen) in SEARCH_SOON:
            return True  # all at once: the camera was knocked, or a cut
        if frame.index - self.searched < REACQUIRE_FRAMES:
            return False
        return (
            not all(self.marks) or max(unseen) >= REACQUIRE_FRAMES or any(m is not None and m.lost for m in self.marks)
        )

    def _acquire(self, frame: Frame) -> None:
        self.tried += 1
        if self.tried > ACQUIRE_EVERY_FRAME and self.tried % ACQUIRE_STRIDE:
            return
        chosen, candidates = self.search.spots(frame, ACQUIRE_WIDTHS_PX, self._seen_by_user())
        if not chosen.accepted:
            return
        begun = {}
        for index, spot in enumerate(chosen.chosen):
            if spot >= 0:
                mark = self._begin(frame, index, candidates.centre_px[spot], float(candidates.width_px[spot]))
                if mark is not None:
                    begun[index] = mark
        if len(begun) < 2:
            return
        self.ambiguous |= chosen.ambiguous
        self.search.learn_lamps(candidates, chosen.chosen)
        # frames before this one hold nothing: they are written as they are, so that probation counts from here
        before, self.stretch.frames = self.stretch.frames[:-1], self.stretch.frames[-1:]
        self._write_unseen(before)
        self.on_probation = True
        for index, (mark, place) in begun.items():
            self.marks[index] = mark
            self.stretch.keep(index, frame.luma, float(place[0]), float(place[1]), mark.refiner.half_px)

    def _begin(self, frame: Frame, index: int, place: Array, width: float) -> tuple[Mark, Array] | None:
        """A new mark where a spot stands; None where it is none."""
        refiner = Refiner(width, self._dark(index), float(frame.white_dn), self.backend)
        fit = refiner.once(self._one(frame, place, refiner))
        sign = -1.0 if self._dark(index) else 1.0
        if not fit.good[0] or sign * fit.amplitude_dn[0] <= 0:
            return None
        centre = fit.centre_px[0]
        live = LiveMark(centre, frame.t_s, float(fit.width_px[0]), abs(float(fit.amplitude_dn[0])), self._dark(index))
        refiner.width_px = float(np.clip(fit.width_px[0], 0.6, 12.0))
        return Mark(live, refiner), centre

    def _one(self, frame: Frame, place: Array, refiner: Refiner) -> Stack:
        alone = Stretch(1)
        alone.frames.append((frame.index, frame.t_s, False))
        alone.keep(0, frame.luma, float(place[0]), float(place[1]), refiner.half_px)
        kept = alone.stack(0, self.size_px)
        assert kept is not None
        return kept[1]

    def _seen_by_user(self) -> list[Array | None]:
        """seen_at_px holds for the first analysed frame and a moment after it."""
        stale = self.tried > SEEN_FRAMES
        return [None if stale or m.seen_at_px is None else np.array(m.seen_at_px) for m in self.markers]

    def _recover(self, frame: Frame) -> None:
        """Look for lost marks on the whole frame; believed only where the marks that are still held are found as well."""
        now = self.done[-1]
        held = [None if r else p for r, p in zip(now.reason[:, -1], now.place[:, -1], strict=True)]
        if all(place is not None for place in held):
            return
        width = float(np.median([m.refiner.width_px for m in self.marks if m is not None]))
        near, near_sd = list(held), [SEEN_SD_PX] * len(held)
        for index, mark in enumerate(self.marks):
            if mark is not None and near[index] is None:  # tells a pair of marks from the same pair turned round
                near[index] = np.array([mark.replay.u, mark.replay.v])
                near_sd[index] = KNOCK_PX + KNOCK_PX_S * (frame.t_s - mark.replay.t_s)
        chosen, candidates = self.search.spots(frame, (width,), near, near_sd)
        if not chosen.accepted or chosen.ambiguous:
            return
        self.search.learn_lamps(candidates, chosen.chosen)
        centres = [candidates.centre_px[c] if c >= 0 else None for c in chosen.chosen]
        for place, centre in zip(held, centres, strict=True):
            if place is not None and (centre is None or np.hypot(*(centre - place)) > JUMP_PX + width):
                return
        for index, centre in enumerate(centres):
            if held[index] is not None or centre is None:
                continue
            begun = self._begin(frame, index, centre, width)
            if begun is None:
                continue
            mark, place = begun
            known = self.marks[index]
            fit = (known or mark).refiner.once(self._one(frame, place, mark.refiner))
            if not fit.good[0] or not self.rigid.fits(index, fit.centre_px[0], fit.sigma_px[0], now):
                continue
            now.place[index, -1], now.sigma[index, -1], now.reason[index, -1] = fit.centre_px[0], fit.sigma_px[0], ""
            self.losses -= 1
            if known is not None:
                mark.refiner, mark.brightness_dn = known.refiner, known.brightness_dn
            self.marks[index] = mark

    def _dark(self, index: int) -> bool:
        return self.markers[index].colour == "dark"

    def flush(self) -> None:
        """Fit the windows of the stretch, judge every place, and write it."""
        stretch = self.stretch
        if not len(stretch):
            return
        if not any(self.marks):
            self._write_unseen(stretch.frames)
            stretch.clear()
            return
        found = self._unseen(stretch.frames)
        width = np.full(found.brightness.shape, np.nan)
        excess = np.full(found.brightness.shape, np.nan)
        flux = np.full(found.brightness.shape, np.nan)
        for index, mark in enumerate(self.marks):
            kept = None if mark is None else stretch.stack(index, self.size_px)
            if mark is None or kept is None:
                continue
            rows, stack, repeated = kept
            fit = (refined := mark.refiner.refine(stack)).fit
            good = fit.good
            found.reason[index, rows] = np.where(good, "", "no spot")
            found.place[index, rows[good]] = fit.centre_px[good]
            found.sigma[index, rows[good]] = fit.sigma_px[good]
            found.repeated[index, rows] = repeated
            found.brightness[index, rows] = np.where(good, fit.amplitude_dn, np.nan)
            width[index, rows] = fit.width_px / mark.refiner.width_px
            excess[index, rows] = refined.excess
            flux[index, rows] = np.where(refined.odd, refined.flux, 1.0)
        self.rigid.check(found, judge(self.marks, found, width, excess, flux))
        if self.on_probation and self._broken(found):
            self._dismiss(found)
        else:
            self.on_probation = False
            self._learn(found)
        self._write(found)
        stretch.clear()

    def _unseen(self, frames: list[tuple[int, float, bool]]) -> Found:
        """Nothing seen in these frames, and why."""
        shape = len(self.markers), len(frames)
        reason = np.full(shape, "not found yet", dtype=object)
        for index, mark in enumerate(self.marks):
            if mark is not None:
                reason[index] = "outside the picture"
        reason[:, [damaged for _, _, damaged in frames]] = "damaged frame"
        nowhere = np.full((*shape, 2), np.nan)
        return Found(nowhere, nowhere.copy(), reason, np.full(shape, np.nan), np.zeros(shape, dtype=bool), frames)

    def _write_unseen(self, frames: list[tuple[int, float, bool]]) -> None:
        if frames:
            self._write(self._unseen(frames))

    def _write(self, found: Found) -> None:
        missing = found.reason != ""
        found.place[missing] = np.nan
        found.sigma[missing] = np.nan
        self.losses += int(missing.sum())
        found.brightness = np.zeros(0)
        self.done.append(found)

    def _broken(self, found: Found) -> bool:
        followed = [i for i, mark in enumerate(self.marks) if mark is not None]
        reasons = found.reason[followed]
        return bool(((reasons != "") & (reasons != "damaged frame")).any())

    def _dismiss(self, found: Found) -> None:
        """What was acquired did not hold: those frames were not the marks, and the search begins anew."""
        found.reason[found.reason != "damaged frame"] = "not confirmed"
        self.marks = [None] * len(self.markers)
        self.rigid.distances.clear()
        self.search.begun_at.clear()

    def _learn(self, found: Found) -> None:
        """Carry distances, brightness and the filters' state into the next stretch."""
        self.rigid.learn(found)
        for index, mark in enumerate(self.marks):
            if mark is None:
                continue
            seen = np.flatnonzero(found.reason[index] == "")
            if len(seen):
                mark.brightness_dn = float(np.median(np.abs(found.brightness[index, seen[-REFERENCE_FRAMES:]])))
                mark.live.rise_dn = mark.brightness_dn
                mark.live.width_px = mark.refiner.width_px
            mark.live.filter = mark.replay.copy()
            mark.live.unseen = mark.lost

    def finish(self) -> pd.DataFrame:
        """All rows."""
        self.flush()
        if self.never_found:
            raise TrackingError(self.search.why_never())
        return table_of(self.done, [m.name for m in self.markers])
