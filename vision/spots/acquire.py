"""Which spots of a picture are the marks, while none is followed: taken at first sight where nothing else fits nearly as well, else
once one set of spots has moved on for long enough; and found anew in the picture after that.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...record.errors import TrackingError
from ..recording import Frame
from .candidates import Array, Candidates
from .identity import CLEAR_COST, SEEN_SD_PX, Assignment
from .search import Search

SEEN_S = 2.0
"""What the user says of where a mark is seen holds for so long, less and less: by ``KNOCK_PX_S``."""
KNOCK_PX_S = 100.0
"""How fast a mark may go elsewhere that is not seen, its camera being knocked, standard deviation."""
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
EVERY_FRAME = 20
"""While nothing has been found: every frame at first, then ..."""
STRIDE = 15
"""... every so many frames: a choice, half a second of usual film."""
Look = tuple[float, float]
"""How a spot looks: its contrast, DN, and its width, px."""


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


@dataclass(frozen=True)
class Sighting:
    """Spots of a picture that are taken for the marks.

    Attributes
    ----------
    frame : the picture
    spots : which of the candidates each mark is, -1: none
    candidates : its spots
    cost : of this set
    """

    frame: Frame
    spots: tuple[int, ...]
    candidates: Candidates
    cost: float

    def look(self, spot: int) -> Look:
        """How one of the candidates looks."""
        return float(self.candidates.contrast_dn[spot]), float(self.candidates.width_px[spot])


class Acquisition:
    """Finds the marks in the pictures it is shown, and knows which sets of spots did not hold.

    Attributes
    ----------
    ambiguous : another set of spots was nearly as good as one that was taken
    """

    def __init__(self, search: Search) -> None:
        self.ambiguous = False
        self._search = search
        self._tried = self._unclear = 0
        self._waiting: list[tuple[Frame, Candidates]] = []
        self._steady = self._steady_moving = Steady()
        self._taken: list[Array | None] = []
        self._taken_cost = np.inf
        self._began_s: float | None = None

    @property
    def waits(self) -> bool:
        """Frames are kept until it is known which spots are the marks."""
        return bool(self._waiting)

    def forget_waiting(self) -> None:
        """The frames that were kept are written as they are."""
        self._waiting.clear()

    def look(self, frame: Frame) -> Sighting | None:
        """The spots that are the marks; None: not found, or not clear yet.

        Raises
        ------
        TrackingError : they are found, and nothing tells which is which
        """
        self._tried += 1
        if self._tried > EVERY_FRAME and self._tried % STRIDE:
            return None
        near, near_sd = self._seen_by_user(frame.t_s)
        chosen, every = self._search.anywhere(frame, near, near_sd)
        candidates = every
        if not chosen.accepted or (self._again(frame) and chosen.cost > self._taken_cost + RETRY_COST):
            return None
        told = all(place is not None for place in near) and frame.t_s == self._began_s and not self._doubtful(chosen)
        settled = False
        if self._is_unclear(chosen) and not told and not chosen.turned:  # what stands still is not towed
            moving = self._search.moving(candidates, near, near_sd)
            if moving is not None and moving[0].accepted:
                self._steady_moving = self._steady_moving.with_next(*moving, frame.t_s)
                settled = self._steady_moving.settled
                if moving[0].cost < chosen.cost + CLEAR_COST or settled:
                    chosen, candidates = moving
        if self._is_unclear(chosen) and (chosen.turned or not told):  # the user's pick is the nearest that fits
            self._unclear += 1
            self._waiting.append((frame, every))
            if chosen.turned and self._unclear >= UNCLEAR:
                raise TrackingError(self._search.why_unclear())
            self._steady = self._steady.with_next(chosen, candidates, frame.t_s)
            if chosen.turned or not (self._steady.settled or settled):
                return None
            self.ambiguous = True
            self._waiting.pop()
        return Sighting(frame, chosen.chosen, candidates, chosen.cost)

    def took(self, sighting: Sighting) -> None:
        """Its spots are followed from now on."""
        self._search.learn_lamps(sighting.candidates, sighting.spots)
        self._taken = [sighting.candidates.centre_px[spot] if spot >= 0 else None for spot in sighting.spots]
        self._taken_cost = self._taken_cost if self._again(sighting.frame) else sighting.cost

    def earlier(
        self, places: dict[int, Array], looks: list[Look | None], last: tuple[int, float]
    ) -> list[tuple[Frame, dict[int, Array]]]:
        """Where marks that are now known stood in the frames before, in which nothing told them from other spots.

        Parameters
        ----------
        places : px, by the mark's number
        looks : of every mark
        last : number and time of the frame in which they are known
        """
        found: list[tuple[Frame, dict[int, Array]]] = []
        waiting, self._waiting = self._waiting, []
        for frame, candidates in reversed(waiting):
            near = [places.get(index) for index in range(len(self._search.markers))]
            reach = SEEN_SD_PX + SECOND_PX_S * (last[1] - frame.t_s)
            chosen = self._search.assigned(candidates, near, [reach] * len(near), looks)
            if frame.index != last[0] - 1 or not chosen.accepted or any(chosen.chosen[index] < 0 for index in places):
                break
            places = {index: candidates.centre_px[chosen.chosen[index]] for index in places}
            found.append((frame, places))
            last = frame.index, frame.t_s
        return found[::-1]

    def second(
        self, frame: Frame, held: list[Array | None], step_s: float, looks: list[Look | None]
    ) -> list[Array] | None:
        """Of every mark its place in the frame after the first, in which the marks are found anew about where they were.

        Parameters
        ----------
        frame : the second one
        held : where the marks were seen, px; None: not followed
        step_s : how long ago
        looks : of every mark
        """
        reach = SEEN_SD_PX + SECOND_PX_S * step_s

        def whole(found: Assignment) -> bool:
            every = zip(found.chosen, held, strict=True)
            return found.accepted and not any(c < 0 for c, place in every if place is not None)

        chosen, candidates = self._search.about(frame, held, reach, looks)
        if not whole(chosen) or chosen.ambiguous:
            chosen, candidates = self._search.anywhere(frame, held, [reach] * len(held), looks)
        if not whole(chosen):
            return None
        spots = _not_turned(chosen.chosen, held, candidates)
        return None if spots is None else [candidates.centre_px[spot] for spot in spots]

    def may_retry(self) -> bool:
        """Another set of spots may be looked for where one did not hold."""
        return len(self._search.refused) < MOST_RETRIES

    def refuse(self, index: int) -> None:
        """The spots taken in the frame of this number were not the marks: it is looked at once more for the next best.

        Parameters
        ----------
        index : of the frame
        """
        self._search.refused.append((index, self._taken))

    def _again(self, frame: Frame) -> bool:
        return any(index == frame.index for index, _ in self._search.refused)

    def _doubtful(self, chosen: Assignment) -> bool:
        """The marks fit so badly that they may be something else."""
        return len(self._search.markers) > 1 and chosen.cost > SURE_COST

    def _is_unclear(self, chosen: Assignment) -> bool:
        """Something else fits nearly as well, or nothing fits well."""
        return chosen.ambiguous or self._doubtful(chosen)

    def _seen_by_user(self, t_s: float) -> tuple[list[Array | None], list[float]]:
        """seen_at_px holds for the first analysed frame, and ever less after it."""
        self._began_s = t_s if self._began_s is None else self._began_s
        since_s = t_s - self._began_s
        stale = since_s > SEEN_S
        near = [None if stale or m.seen_at_px is None else np.array(m.seen_at_px) for m in self._search.markers]
        return near, [SEEN_SD_PX + KNOCK_PX_S * since_s] * len(near)


def _not_turned(chosen: tuple[int, ...], held: list[Array | None], candidates: Candidates) -> tuple[int, ...] | None:
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
