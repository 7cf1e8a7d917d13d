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
from ..follower import Glance
from ..recording import Frame
from ..rows import DAMAGED
from .acquire import KNOCK_PX_S, UNCLEAR, Acquisition, Look
from .alike import Seen, like_their_fellows
from .candidates import Array
from .identity import SEEN_SD_PX
from .judge import BRIGHTNESS_RANGE, JUMP_PX, WIDTH_RANGE, Rigid, as_bright, judge, largest_sigma_px, seen_sigma_px
from .live import LiveMark
from .model import SpotFit
from .refine import WIDEST_PX, Refined, Refiner, wide_as_seemed
from .search import Search
from .stack import Stack
from .stretch import Found, Mark, Stretch, table_of

NOT_FOUND, OUTSIDE, NO_SPOT = "not found yet", "outside the picture", "no spot"
STRETCH_FRAMES = 64
"""Frames fitted together; a window of 31 x 31 pixels is kept of each."""
SHORT_STRETCH_FRAMES = 16
"""The same where someone waits for the places: no fit of a stretch takes long then, and it teaches as much as any other
(``refine.LEARN_ALL``)."""
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
KNOCK_PX = 30.0
"""A mark that is lost is looked for on the whole frame, about where it was seen last: a knocked camera, and with ``KNOCK_PX_S`` its
own way since."""
CONFIRMED = 0.6
"""Of the frames of its probation a mark must be measured in this share."""


class SpotFollower:
    """Lights and discs: known by their distances, their common brightness, the taut line and the heading."""

    def __init__(self, run: Run, markers: tuple[Marker, ...], mapping: Mapping, backend: Backend) -> None:
        self.markers, self.backend = markers, backend
        self.search = Search(run, markers, mapping)
        self.acquisition = Acquisition(self.search)
        self.rigid = Rigid(markers, mapping)
        self.marks: list[Mark | None] = [None] * len(markers)
        self.stretch = Stretch(len(markers))
        self.done: list[Found] = []
        self.size_px = (0, 0)
        self.tries: list[Frame] = []
        self.on_probation = True
        self.unproven: list[Found] = []
        self.first_sight = False
        self.looks: list[Look | None] = [None] * len(markers)
        self.losses = 0
        self.searched = -REACQUIRE_FRAMES
        self.stretch_frames = STRETCH_FRAMES

    @property
    def ambiguous(self) -> bool:
        """When the marks were found, another set of spots was nearly as good."""
        return self.acquisition.ambiguous

    @property
    def never_found(self) -> bool:
        """No marker was measured in two frames or more."""
        measured = np.array([(found.reason == "").sum(axis=1) for found in self.done]).sum(axis=0)
        return not (measured >= 2).any()

    def look_often(self) -> None:
        """Judge what is seen sooner, in shorter stretches."""
        self.stretch_frames = SHORT_STRETCH_FRAMES

    def glance(self, frame: Frame) -> list[Glance]:
        """Where each mark seems to be in the frame taken last, by a fit of that frame alone, which teaches nothing."""
        return [self._glance(index, frame) for index in range(len(self.markers))]

    def _glance(self, index: int, frame: Frame) -> Glance:
        name, mark, kept = self.markers[index].name, self.marks[index], self.stretch.last[index]
        if frame.damaged:
            return Glance(name, reason=DAMAGED)
        if mark is None:
            return Glance(name, reason=NOT_FOUND)
        if kept is None or kept[0] != frame.index:
            return Glance(name, reason=OUTSIDE)
        cut, corner = kept[1]
        start = np.array([corner], dtype=float) + len(cut) // 2
        alone = Stack(cut[None], np.array([corner]), start, self.size_px)
        fit = mark.refiner.once(alone)
        if not fit.good[0]:  # more is free than one frame may tell
            fit = mark.refiner.simplest(alone)
        peak, width = float(cut.max()), float(fit.width_px[0])
        bright = float(fit.amplitude_dn[0]) / mark.height_dn
        reason = ""
        if mark.live.unseen or not fit.good[0]:
            reason = NO_SPOT
        elif not BRIGHTNESS_RANGE[0] < bright < BRIGHTNESS_RANGE[1]:
            reason = "brightness"
        elif not WIDTH_RANGE[0] < width / mark.refiner.width_px < WIDTH_RANGE[1]:
            reason = "shape"
        elif fit.sigma_px[0].max() > largest_sigma_px(mark):
            reason = "too faint"
        if reason:
            return Glance(name, reason=reason, peak_dn=peak)
        place, sigma = fit.centre_px[0], fit.sigma_px[0]
        clipped = not self._dark(index) and peak >= frame.white_dn
        return Glance(
            name, float(place[0]), float(place[1]), float(sigma[0]), float(sigma[1]), "", peak, width, clipped
        )

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        self.see(frame)
        self.settle(frame)

    def see(self, frame: Frame) -> None:
        """Take one frame's windows."""
        self.size_px = frame.luma.shape[1], frame.luma.shape[0]
        damaged = frame.damaged
        if self.tries:
            self.tries.append(frame)
        self.stretch.frames.append((frame.index, frame.t_s, damaged))
        if damaged:
            pass
        elif not any(self.marks):
            self._acquire(frame)
        else:
            if self.first_sight:
                self._second_sight(frame)
            self._look(frame)

    def settle(self, frame: Frame) -> None:
        """End the stretch if it is time, and look for what is lost in the frame just taken."""
        damaged = frame.damaged
        if len(self.stretch) >= self._length() or any(
            m is not None and m.live.doubtful == DOUBT_FRAMES for m in self.marks
        ):
            self.flush()
        if not damaged and any(self.marks) and self._search_due(frame):
            self.flush()
            if any(self.marks) and not len(self.stretch):
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
        """Frames of a stretch: few while the marks are new or one of them is lost, so that the end is known soon.

        While it is open which spots are the marks, the frames that wait for it are kept together.
        """
        if self.acquisition.waits:
            return 2 * UNCLEAR
        short = self.on_probation or any(m is not None and m.lost for m in self.marks)
        return PROBATION_FRAMES if short else self.stretch_frames

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
        sighting = self.acquisition.look(frame)
        if sighting is None:
            return
        begun: dict[int, tuple[Mark, Array]] = {}
        looks: list[Look | None] = [None] * len(self.markers)
        for index, spot in enumerate(sighting.spots):
            if spot >= 0:
                look = sighting.look(spot)
                mark = self._begin(frame, index, sighting.candidates.centre_px[spot], look[1])
                if mark is not None:
                    begun[index] = mark
                    looks[index] = look
        if len(begun) < min(2, len(self.markers)):
            return
        self.acquisition.took(sighting)
        self.on_probation = self.first_sight = True
        self.unproven = []
        self.looks = looks
        self.tries = [frame]
        places = {index: place for index, (_, place) in begun.items()}
        earlier = self.acquisition.earlier(places, looks, (frame.index, frame.t_s))
        # frames before these hold nothing: they are written as they are, so that probation counts from here
        before, now = self.stretch.frames[: -1 - len(earlier)], self.stretch.frames[-1 - len(earlier) :]
        self._write_unseen(before)
        self.stretch.frames = []
        for index, (mark, _) in begun.items():
            self.marks[index] = mark
        for info, (seen, there) in zip(now, [*earlier, (frame, places)], strict=True):
            self.stretch.frames.append(info)
            for index, place in there.items():
                half = begun[index][0].refiner.half_px
                self.stretch.keep(index, seen.luma, float(place[0]), float(place[1]), half)
        if earlier:
            self.first_sight = False
            times = [seen.t_s for seen, _ in [*earlier, (frame, None)]]
            for index, (mark, place) in begun.items():
                mark.began([*(places[index] for _, places in earlier), place], times)

    def _begin(self, frame: Frame, index: int, place: Array, width: float) -> tuple[Mark, Array] | None:
        """A new mark where a spot stands; None where it is none."""
        refiner = Refiner(width, self._dark(index), float(frame.white_dn), self.backend)
        if (shorter := STRETCH_FRAMES // self.stretch_frames) > 1:
            refiner.reflection_every *= shorter
            refiner.reflection_turn = index * refiner.reflection_every // len(self.markers)
        alone = self._one(frame, place, refiner)
        for fit in (refiner.once(alone), refiner.simplest(alone)):
            rises = fit.amplitude_dn[0] < 0 if self._dark(index) else fit.amplitude_dn[0] > 0
            if fit.good[0] and rises and wide_as_seemed(fit.width_px / width)[0]:
                break
        else:
            return None  # the fit went to something else
        centre = fit.centre_px[0]
        live = LiveMark(centre, frame.t_s, float(fit.width_px[0]), abs(float(fit.amplitude_dn[0])), self._dark(index))
        live.learn_height(frame.luma)
        refiner.width_px = float(np.clip(fit.width_px[0], 0.6, WIDEST_PX))
        return Mark(live, refiner), centre

    def _one(self, frame: Frame, place: Array, refiner: Refiner) -> Stack:
        alone = Stretch(1)
        alone.frames.append((frame.index, frame.t_s, False))
        alone.keep(0, frame.luma, float(place[0]), float(place[1]), refiner.half_px)
        kept = alone.stack(0, self.size_px)
        assert kept is not None
        return kept[1]

    def _second_sight(self, frame: Frame) -> None:
        """The frame after the first: the marks are found anew about where they were, and their velocity with that."""
        self.first_sight = False
        held = [None if mark is None else np.array([mark.live.filter.u, mark.live.filter.v]) for mark in self.marks]
        step_s = max(frame.t_s - mark.live.filter.t_s for mark in self.marks if mark is not None)
        places = self.acquisition.second(frame, held, step_s, self.looks)
        if places is None:
            return
        for place, mark in zip(places, self.marks, strict=True):
            if mark is not None:
                mark.live.expect(place, frame.t_s)
                mark.replay = mark.live.filter.copy()

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
        chosen, candidates = self.search.like(frame, width, near, near_sd)
        if not chosen.accepted or chosen.ambiguous:
            return
        self.search.learn_lamps(candidates, chosen.chosen)
        centres = [candidates.centre_px[c] if c >= 0 else None for c in chosen.chosen]
        for place, centre in zip(held, centres, strict=True):
            if place is not None and (centre is None or np.hypot(*(centre - place)) > JUMP_PX + width):
                return
        found: dict[int, tuple[Mark, SpotFit]] = {}
        height = np.array(
            [np.nan if place is None or m is None else m.height_dn for place, m in zip(held, self.marks, strict=True)]
        )
        for index, centre in enumerate(centres):
            if held[index] is not None or centre is None:
                continue
            begun = self._begin(frame, index, centre, width)
            if begun is None:
                continue
            mark, place = begun
            fit = (self.marks[index] or mark).refiner.once(self._one(frame, place, mark.refiner))
            if fit.good[0]:
                found[index] = mark, fit
                height[index] = fit.amplitude_dn[0]
        bright = as_bright(self.marks, height)
        for index, (mark, fit) in found.items():
            if not bright[index] or not self.rigid.fits(index, fit.centre_px[0], fit.sigma_px[0], now):
                continue
            now.place[index, -1], now.sigma[index, -1], now.reason[index, -1] = fit.centre_px[0], fit.sigma_px[0], ""
            self.losses -= 1
            known = self.marks[index]
            if known is not None:
                mark.refiner, mark.brightness_dn = known.refiner, known.brightness_dn
                mark.sigma_px = known.sigma_px
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
            self.acquisition.forget_waiting()
            return
        found = self._unseen(stretch.frames)
        width = np.full(found.brightness.shape, np.nan)
        excess = np.full(found.brightness.shape, np.nan)
        flux = np.full(found.brightness.shape, np.nan)
        for index, (rows, refined, repeated) in self._refined().items():
            mark = self.marks[index]
            assert mark is not None
            fit = refined.fit
            good = fit.good
            found.reason[index, rows] = np.where(good, "", NO_SPOT)
            found.place[index, rows[good]] = fit.centre_px[good]
            found.sigma[index, rows[good]] = fit.sigma_px[good]
            found.repeated[index, rows] = repeated
            found.ground_px2[index] = refined.ground_px2
            found.brightness[index, rows] = np.where(good, fit.amplitude_dn, np.nan)
            width[index, rows] = fit.width_px / mark.refiner.width_px
            excess[index, rows] = refined.excess
            flux[index, rows] = np.where(refined.odd, refined.flux, 1.0)
        self.rigid.check(found, judge(self.marks, found, width, excess, flux))
        if self.on_probation and self._broken(found):
            if self._try_again(found):
                return
            self._dismiss(found)
        else:
            self.tries = []
            self._learn(found)
            if self.on_probation:
                self.unproven.append(found)
                self.on_probation = sum(len(one.frames) for one in self.unproven) < PROBATION_FRAMES
        self._write(found)
        stretch.clear()

    def _refined(self) -> dict[int, tuple[Array, Refined, Array]]:
        """By the mark's number: the rows of the stretch in which it was kept, its fits, whether a picture was the one before."""
        answer: dict[int, tuple[Array, Refined, Array]] = {}
        first: dict[bool, dict[int, Seen]] = {}
        for index, mark in enumerate(self.marks):
            kept = None if mark is None else self.stretch.stack(index, self.size_px)
            if mark is None or kept is None:
                continue
            rows, stack, repeated = kept
            answer[index] = rows, mark.refiner.refine(stack), repeated
            if mark.refiner.stretches == 1:
                first.setdefault(self._dark(index), {})[index] = mark.refiner, stack, answer[index][1]
        for seen in first.values():
            for index, (refiner, refined) in like_their_fellows(seen).items():
                mark = self.marks[index]
                assert mark is not None
                mark.refiner = refiner
                answer[index] = answer[index][0], refined, answer[index][2]
        return answer

    def _unseen(self, frames: list[tuple[int, float, bool]]) -> Found:
        """Nothing seen in these frames, and why."""
        shape = len(self.markers), len(frames)
        reason = np.full(shape, NOT_FOUND, dtype=object)
        for index, mark in enumerate(self.marks):
            if mark is not None:
                reason[index] = OUTSIDE
        reason[:, [damaged for _, _, damaged in frames]] = DAMAGED
        nowhere = np.full((*shape, 2), np.nan)
        return Found(
            nowhere,
            nowhere.copy(),
            reason,
            np.full(shape, np.nan),
            np.zeros(shape, dtype=bool),
            frames,
            np.zeros((len(self.markers), 2)),
            np.array([largest_sigma_px(mark) for mark in self.marks]),
        )

    def _write_unseen(self, frames: list[tuple[int, float, bool]]) -> None:
        if frames:
            self._write(self._unseen(frames))

    def _write(self, found: Found) -> None:
        self.losses += found.forget_missing()
        found.brightness = np.zeros(0)
        self.done.append(found)

    def _broken(self, found: Found) -> bool:
        followed = [i for i, mark in enumerate(self.marks) if mark is not None]
        whole = [not damaged for _, _, damaged in found.frames]
        measured = (found.reason[followed][:, whole] == "").mean(axis=1) if any(whole) else np.ones(1)
        return bool(measured.min() < CONFIRMED)

    def _try_again(self, found: Found) -> bool:
        """Look once more for another set of spots, from the frame on in which what did not hold was taken for the marks."""
        tries, self.tries = self.tries, []
        again = bool(tries) and tries[0].index == found.frames[0][0] and self.acquisition.may_retry()
        if again:
            self.search.dismissed(found, [m is not None for m in self.marks])
            self.acquisition.refuse(tries[0].index)
            self._forget()
            self.stretch.clear()
            for frame in tries:
                self.step(frame)
        return again

    def _dismiss(self, found: Found) -> None:
        """What was acquired did not hold: those frames, and what was written of it before, were not the marks; the search begins
        anew.
        """
        self.search.dismissed(found, [m is not None for m in self.marks])
        for one in self.unproven:
            self.losses -= int((one.reason != "").sum())
            _not_confirmed(one)
            self.losses += one.forget_missing()
        _not_confirmed(found)
        self._forget()

    def _forget(self) -> None:
        """What was followed was not the marks."""
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
                mark.sigma_px = seen_sigma_px(found, index)
            mark.live.filter = mark.replay.copy()
            mark.live.unseen = mark.lost

    def finish(self) -> pd.DataFrame:
        """All rows."""
        while len(self.stretch):
            self.flush()
        if self.never_found:
            raise TrackingError(self.search.why_never())
        return table_of(self.done, [m.name for m in self.markers])


def _not_confirmed(found: Found) -> None:
    """None of it was the marks; what was wrong besides stays said."""
    why = np.array([f"not confirmed ({r})" if r else "not confirmed" for r in found.reason.ravel()], dtype=object)
    found.reason = np.where(found.reason == DAMAGED, found.reason, why.reshape(found.reason.shape))
