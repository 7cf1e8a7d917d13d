"""Lights and discs through a recording: acquisition on the whole frame, then a predicted window per marker.

Windows are cut frame by frame (``live``) and fitted a stretch at a time (``refine``); what the fits say of the end of a
stretch is where the next one begins.
"""

from __future__ import annotations

from dataclasses import dataclass, field

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
from .alike import Seen, like_their_fellows
from .candidates import Array, Candidates
from .identity import CLEAR_COST, SEEN_SD_PX, Assignment
from .judge import BRIGHTNESS_RANGE, JUMP_PX, WIDTH_RANGE, Rigid, judge, largest_sigma_px, seen_sigma_px
from .live import LiveMark
from .refine import WIDEST_PX, Refined, Refiner, Stack, wide_as_seemed
from .search import Search
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
KNOCK_PX, KNOCK_PX_S = 30.0, 100.0
"""A mark that is lost is looked for on the whole frame, about where it was seen last: a knocked camera, and its own way since."""
SEEN_S = 2.0
"""What the user says of where a mark is seen holds for so long, less and less: by ``KNOCK_PX_S``."""
SECOND_PX_S = 300.0
"""How fast a mark may be in the second frame in which it is seen, standard deviation: a choice, 10 px a frame of usual film."""
UNCLEAR = 10
"""After so many frames in which marks could be taken for one another, nothing is expected of more: a choice."""
SURE_COST = 16.0
"""A set of spots that costs more than this (four standard deviations) is not taken at first sight, however clear of others it is:
the marks themselves may not be among the spots."""
UNCLEAR_MARGIN = 2.0
"""One set of spots that moves on through all of these frames, and fits better than any other by a cost of so much in their mean
(odds of e to 1 in each), is taken: a choice."""
SECOND_TURN_RAD = np.radians(30.0)
"""No model turns by more than this from the first to the second frame in which it is seen: a choice."""
MOST_RETRIES, RETRY_COST = 2, 2 * CLEAR_COST
"""A frame in which a set of spots that did not hold was taken for the marks is looked at again for the next best, so often, as
long as that costs no more than the first by so much: choices."""
CONFIRMED = 0.6
"""Of the frames of its probation a mark must be measured in this share."""
ACQUIRE_EVERY_FRAME = 20
"""While nothing has been found: every frame at first, then ..."""
ACQUIRE_STRIDE = 15
"""... every so many frames: a choice, half a second of usual film."""


@dataclass(frozen=True)
class Steady:
    """One set of spots, the best of every frame but not by much: since when it moves on unchanged.

    Attributes
    ----------
    places_px, t_s : of the last frame, (marks, 2)
    chosen : which marks have a spot
    margins : of each frame, by how much the next set costs more
    """

    places_px: Array = field(default_factory=lambda: np.zeros((0, 2)))
    t_s: float = 0.0
    chosen: tuple[bool, ...] = ()
    margins: tuple[float, ...] = ()

    def with_next(self, best: Assignment, candidates: Candidates, t_s: float) -> Steady:
        """The best set of another frame: the same one moved on, or a new beginning."""
        chosen = tuple(c >= 0 for c in best.chosen)
        places = candidates.centre_px[[c for c in best.chosen if c >= 0]]
        margins: tuple[float, ...] = ()
        if chosen == self.chosen:
            reach = SEEN_SD_PX + SECOND_PX_S * (t_s - self.t_s)
            if (np.linalg.norm(places - self.places_px, axis=1) < reach).all():
                margins = self.margins
        return Steady(places, t_s, chosen, (*margins, best.margin))

    @property
    def settled(self) -> bool:
        """It was the best for long enough, and by enough."""
        return len(self.margins) >= UNCLEAR and float(np.mean(self.margins)) >= UNCLEAR_MARGIN


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
        self.unclear = 0
        self.waiting: list[tuple[Frame, Candidates]] = []
        self.steady = self.steady_moving = Steady()
        self.tries: list[Frame] = []
        self.taken: list[Array | None] = []
        self.taken_cost = np.inf
        self.on_probation = True
        self.unproven: list[Found] = []
        self.first_sight = False
        self.looks: list[tuple[float, float] | None] = [None] * len(markers)
        self.began_s: float | None = None
        self.losses = 0
        self.searched = -REACQUIRE_FRAMES
        self.stretch_frames = STRETCH_FRAMES

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
        sign = -1.0 if self._dark(index) else 1.0
        bright = sign * float(fit.amplitude_dn[0]) / mark.brightness_dn
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
        if self.waiting:
            return 2 * UNCLEAR
        short = self.on_probation or any(m is not None and m.lost for m in self.marks)
        return PROBATION_FRAMES if short else self.stretch_frames

    @staticmethod
    def _not_turned(
        chosen: tuple[int, ...], held: list[Array | None], candidates: Candidates
    ) -> tuple[int, ...] | None:
        """The spots of marks that were ``held`` a frame before, two of them in the other order where the body would have turned.

        Noise makes small marks brighter in turn, and two that move by half of their distance lie as near to each other's places as
        to their own. None: they are other spots.
        """
        known = [index for index, place in enumerate(held) if place is not None]
        first, last = known[0], known[-1]
        if first == last:
            return chosen
        exchanged = list(chosen)
        exchanged[first], exchanged[last] = chosen[last], chosen[first]
        was = np.asarray(held[last]) - np.asarray(held[first])
        for spots in (chosen, *([tuple(exchanged)] if len(known) == 2 else [])):
            now = candidates.centre_px[spots[last]] - candidates.centre_px[spots[first]]
            if was @ now >= np.cos(SECOND_TURN_RAD) * np.hypot(*was) * np.hypot(*now):
                return spots
        return None

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
        near, near_sd = self._seen_by_user(frame.t_s)
        chosen, every = self.search.anywhere(frame, near, near_sd)
        candidates = every
        again = any(index == frame.index for index, _ in self.search.refused)
        if not chosen.accepted or (again and chosen.cost > self.taken_cost + RETRY_COST):
            return
        told = all(place is not None for place in near) and frame.t_s == self.began_s and not self._doubtful(chosen)
        settled = False
        if self._unclear(chosen) and not told and not chosen.turned:  # what stands still is not towed
            moving = self.search.moving(candidates, near, near_sd)
            if moving is not None and moving[0].accepted:
                self.steady_moving = self.steady_moving.with_next(*moving, frame.t_s)
                settled = self.steady_moving.settled
                if moving[0].cost < chosen.cost + CLEAR_COST or settled:
                    chosen, candidates = moving
        if self._unclear(chosen) and (chosen.turned or not told):  # the user's pick is the nearest that fits
            self.unclear += 1
            self.waiting.append((frame, every))
            if chosen.turned and self.unclear >= UNCLEAR:
                raise TrackingError(self.search.why_unclear())
            self.steady = self.steady.with_next(chosen, candidates, frame.t_s)
            if chosen.turned or not (self.steady.settled or settled):
                return
            self.ambiguous = True
            self.waiting.pop()
        begun: dict[int, tuple[Mark, Array]] = {}
        looks: list[tuple[float, float] | None] = [None] * len(self.markers)
        for index, spot in enumerate(chosen.chosen):
            if spot >= 0:
                mark = self._begin(frame, index, candidates.centre_px[spot], float(candidates.width_px[spot]))
                if mark is not None:
                    begun[index] = mark
                    looks[index] = float(candidates.contrast_dn[spot]), float(candidates.width_px[spot])
        if len(begun) < min(2, len(self.markers)):
            return
        self.search.learn_lamps(candidates, chosen.chosen)
        self.on_probation = self.first_sight = True
        self.unproven = []
        self.looks = looks
        self.tries = [frame]
        self.taken = [candidates.centre_px[spot] if spot >= 0 else None for spot in chosen.chosen]
        self.taken_cost = self.taken_cost if again else chosen.cost
        earlier = self._earlier({index: place for index, (_, place) in begun.items()})
        # frames before these hold nothing: they are written as they are, so that probation counts from here
        before, now = self.stretch.frames[: -1 - len(earlier)], self.stretch.frames[-1 - len(earlier) :]
        self._write_unseen(before)
        self.stretch.frames = []
        for index, (mark, _) in begun.items():
            self.marks[index] = mark
        for info, (seen, places) in zip(now, [*earlier, (frame, {i: p for i, (_, p) in begun.items()})], strict=True):
            self.stretch.frames.append(info)
            for index, place in places.items():
                half = begun[index][0].refiner.half_px
                self.stretch.keep(index, seen.luma, float(place[0]), float(place[1]), half)
        if earlier:
            self.first_sight = False
            times = [seen.t_s for seen, _ in [*earlier, (frame, None)]]
            for index, (mark, place) in begun.items():
                mark.began([*(places[index] for _, places in earlier), place], times)

    def _doubtful(self, chosen: Assignment) -> bool:
        """The marks fit so badly that they may be something else."""
        return len(self.markers) > 1 and chosen.cost > SURE_COST

    def _unclear(self, chosen: Assignment) -> bool:
        """Something else fits nearly as well, or nothing fits well."""
        return chosen.ambiguous or self._doubtful(chosen)

    def _earlier(self, places: dict[int, Array]) -> list[tuple[Frame, dict[int, Array]]]:
        """Where marks that are now known stood in the frames before, in which nothing told them from other spots."""
        found: list[tuple[Frame, dict[int, Array]]] = []
        waiting, self.waiting = self.waiting, []
        last = self.stretch.frames[-1]
        for frame, candidates in reversed(waiting):
            near = [places.get(index) for index in range(len(self.markers))]
            reach = SEEN_SD_PX + SECOND_PX_S * (last[1] - frame.t_s)
            chosen = self.search.assigned(candidates, near, [reach] * len(near), self.looks)
            if frame.index != last[0] - 1 or not chosen.accepted or any(chosen.chosen[index] < 0 for index in places):
                break
            places = {index: candidates.centre_px[chosen.chosen[index]] for index in places}
            found.append((frame, places))
            last = frame.index, frame.t_s
        return found[::-1]

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

    def _seen_by_user(self, t_s: float) -> tuple[list[Array | None], list[float]]:
        """seen_at_px holds for the first analysed frame, and ever less after it."""
        self.began_s = t_s if self.began_s is None else self.began_s
        since_s = t_s - self.began_s
        stale = since_s > SEEN_S
        near = [None if stale or m.seen_at_px is None else np.array(m.seen_at_px) for m in self.markers]
        return near, [SEEN_SD_PX + KNOCK_PX_S * since_s] * len(near)

    def _second_sight(self, frame: Frame) -> None:
        """The frame after the first: the marks are found anew about where they were, and their velocity with that."""
        self.first_sight = False
        held = [None if mark is None else np.array([mark.live.filter.u, mark.live.filter.v]) for mark in self.marks]
        step_s = max(frame.t_s - mark.live.filter.t_s for mark in self.marks if mark is not None)
        reach = SEEN_SD_PX + SECOND_PX_S * step_s

        def whole(found: Assignment) -> bool:
            every = zip(found.chosen, held, strict=True)
            return found.accepted and not any(c < 0 for c, place in every if place is not None)

        chosen, candidates = self.search.about(frame, held, reach, self.looks)
        if not whole(chosen) or chosen.ambiguous:
            chosen, candidates = self.search.anywhere(frame, held, [reach] * len(held), self.looks)
        if not whole(chosen):
            return
        spots = self._not_turned(chosen.chosen, held, candidates)
        if spots is None:
            return
        for spot, mark in zip(spots, self.marks, strict=True):
            if mark is not None:
                mark.live.expect(candidates.centre_px[spot], frame.t_s)
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
            self.waiting.clear()
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
        again = bool(tries) and tries[0].index == found.frames[0][0] and len(self.search.refused) < MOST_RETRIES
        if again:
            self.search.dismissed(found, [m is not None for m in self.marks])
            self.search.refused.append((tries[0].index, self.taken))
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
