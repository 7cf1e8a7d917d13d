"""The whole frame searched for the markers: spots, what of them are lamps, and which is which."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from ...geometry.mapping import Mapping
from ...record.run import Run
from ...record.schema import Marker
from ..recording import Frame
from .candidates import Array, Candidates, find_candidates, with_tint
from .identity import SEEN_SD_PX, TINTS, Assignment, assign
from .scales import find_spots, free_of_rims
from .stretch import Found
from .taut import MOST_WEAK, REACH_PX, leading_of, taut_places

STATIC_PX = 1.0
"""A spot within this of where it was seen before stands still."""
MOVED_PX = 8.0
"""A spot that stands while the marks move this far is a lamp or a glare, and never a mark."""


USUAL_WIDTH_PX = 2.0
"""Of a mark of which nothing is known, for what stands out of the picture: a choice."""
WIDEST_SHARE = 1.8
"""What stands out of a picture whose ground was taken for marks of a width is not well outlined where it is this much wider."""
NEAR_SD = 3.0
"""Weak spots are kept within so many standard deviations of where a mark is expected."""
BESIDE_PX = 40
"""What lies within this beyond is looked at too: the ring about a wide mark, and noise to know it by. A choice."""
MOST_BESIDE = 30
"""So many spots about a mark are looked at: a choice, for time."""


class Search:
    """Finds the markers of a run in a frame, and learns what stands there that is none of them."""

    def __init__(self, run: Run, markers: tuple[Marker, ...], mapping: Mapping) -> None:
        self.run, self.markers, self.mapping = run, markers, mapping
        self.last: Assignment | None = None
        self.most = 0
        self.standing = self.others = np.zeros((0, 2))
        self.begun_at: dict[int, Array] = {}
        self.at_first: Array | None = None
        self.first_dismissed = ""
        self.refused: list[tuple[int, list[Array | None]]] = []

    def anywhere(
        self,
        frame: Frame,
        near: list[Array | None],
        near_sd_px: list[float] | None = None,
        looks: list[tuple[float, float] | None] | None = None,
    ) -> tuple[Assignment, Candidates]:
        """Assign spots of whatever size to the markers, but for the sets that are refused."""
        known = [place for place in near if place is not None]
        reach = NEAR_SD * max(near_sd_px or [SEEN_SD_PX])
        parts = []
        for dark in self._shades():
            narrow = find_candidates(frame.luma, dark, USUAL_WIDTH_PX).narrower(WIDEST_SHARE * USUAL_WIDTH_PX)
            narrow = free_of_rims(frame.luma, narrow)
            rest = find_spots(frame.luma, dark, np.array(known) if known else None, reach)
            parts.append(narrow.and_also(rest.apart_from(narrow)))
        refused = [places for index, places in self.refused if index == frame.index]
        spots = self._coloured(frame, parts)
        found = self._assigned(spots, near, near_sd_px, looks, refused)
        if known or (found[0].accepted and not found[0].ambiguous) or len(self.markers) == 1:
            return found
        # one of the marks may be weak, or on uneven ground: where the taut line leads from the others less is asked of a spot
        size = frame.luma.shape[1], frame.luma.shape[0]
        leading = leading_of(found[1])
        places = taut_places(leading, self.markers, self.mapping, self.run, size)
        if not len(places):
            return found
        weak = [
            find_spots(frame.luma, dark, places, REACH_PX, MOST_WEAK).apart_from(part)
            for dark, part in zip(self._shades(), parts, strict=True)
        ]
        return self._assigned(spots.and_also(self._coloured(frame, weak)), near, near_sd_px, looks, refused, leading)

    def about(
        self,
        frame: Frame,
        held: list[Array | None],
        sd_px: float,
        looks: list[tuple[float, float] | None] | None = None,
    ) -> tuple[Assignment, Candidates]:
        """Assign spots of whatever size that lie near where marks were held; the whole picture is not looked at."""
        reach = int(np.ceil(NEAR_SD * sd_px)) + BESIDE_PX
        parts: list[Candidates] = []
        for place in (p for p in held if p is not None):
            u0, v0 = (max(int(c) - reach, 0) for c in place)
            part = np.ascontiguousarray(frame.luma[v0 : int(place[1]) + reach + 1, u0 : int(place[0]) + reach + 1])
            for dark in self._shades():
                found = find_spots(part, dark, most=MOST_BESIDE)
                found = replace(found, centre_px=found.centre_px + np.array([u0, v0]))
                for before in parts:
                    found = found.apart_from(before)
                parts.append(found)
        return self._assigned(self._coloured(frame, parts), held, [sd_px] * len(held), looks)

    def like(
        self, frame: Frame, width_px: float, near: list[Array | None], near_sd_px: list[float] | None = None
    ) -> tuple[Assignment, Candidates]:
        """Assign spots of about a width to the markers: what stands out of the picture; else what stands out of a ring."""
        found = self._coloured(frame, [find_candidates(frame.luma, dark, width_px) for dark in self._shades()])
        first = self._assigned(found, near, near_sd_px)
        if first[0].accepted and not first[0].ambiguous:
            return first
        return self.anywhere(frame, near, near_sd_px)

    def moving(
        self, candidates: Candidates, near: list[Array | None], near_sd_px: list[float] | None = None
    ) -> tuple[Assignment, Candidates] | None:
        """Assign what has moved since this was first asked for; None: nothing to compare with yet."""
        if self.at_first is None:
            self.at_first = candidates.centre_px
            return None
        if not len(self.at_first) or not len(candidates):
            return None
        away = np.linalg.norm(candidates.centre_px[:, None] - self.at_first[None], axis=2).min(axis=1)
        moved = candidates.rows(away > 2 * STATIC_PX)
        return assign(moved, self.markers, self.mapping, self.run, near, near_sd_px), moved

    def assigned(
        self,
        candidates: Candidates,
        near: list[Array | None],
        near_sd_px: list[float],
        looks: list[tuple[float, float] | None],
    ) -> Assignment:
        """Assign spots that were found before."""
        return assign(candidates, self.markers, self.mapping, self.run, near, near_sd_px, looks)

    def _assigned(
        self,
        found: Candidates,
        near: list[Array | None],
        near_sd_px: list[float] | None,
        looks: list[tuple[float, float] | None] | None = None,
        refused: list[list[Array | None]] | None = None,
        sure: Candidates | None = None,
    ) -> tuple[Assignment, Candidates]:
        candidates = self._without_lamps(found)
        if sure is None:
            self.most = max(self.most, len(candidates))
        self.last = assign(
            candidates, self.markers, self.mapping, self.run, near, near_sd_px, looks, refused or (), sure
        )
        return self.last, candidates

    def _shades(self) -> list[bool]:
        """Bright and dark, as the markers are."""
        return sorted({m.colour == "dark" for m in self.markers})

    def _coloured(self, frame: Frame, parts: list[Candidates]) -> Candidates:
        """Spots together, with their colour where a marker has one."""
        found = parts[0]
        for more in parts[1:]:
            found = found.and_also(more)
        if len(found) and frame.raw is not None and any(m.colour in TINTS for m in self.markers):
            found = with_tint(found, frame.bgr())
        return found

    def _without_lamps(self, candidates: Candidates) -> Candidates:
        """Leave out spots that stood where they stand now when the marks were elsewhere."""
        if not len(self.standing) or not len(candidates):
            return candidates
        apart = np.linalg.norm(candidates.centre_px[:, None] - self.standing[None], axis=2).min(axis=1)
        return candidates.rows(apart > STATIC_PX)

    def learn_lamps(self, candidates: Candidates, chosen: tuple[int, ...]) -> None:
        """Once the marks have moved away, what still stands where it stood at acquisition is no mark."""
        if not self.begun_at:
            self.begun_at = {i: candidates.centre_px[c] for i, c in enumerate(chosen) if c >= 0}
            self.others = np.delete(candidates.centre_px, [c for c in chosen if c >= 0], axis=0)
            return
        moved = [
            np.hypot(*(candidates.centre_px[c] - self.begun_at[i]))
            for i, c in enumerate(chosen)
            if c >= 0 and i in self.begun_at
        ]
        if moved and min(moved) > MOVED_PX and len(self.others) and len(candidates):
            apart = np.linalg.norm(self.others[:, None] - candidates.centre_px[None], axis=2).min(axis=1)
            self.standing = self.others[apart < STATIC_PX]

    def dismissed(self, found: Found, followed: list[bool]) -> None:
        """Remember of the first set of spots that did not hold when it was seen and what was wrong with it."""
        if self.first_dismissed:
            return
        parts = []
        for marker, reasons, was in zip(self.markers, found.reason, followed, strict=True):
            counts = Counter(str(r) for r in reasons if r)
            if was and counts:
                said = ", ".join(f"{reason} in {count}" for reason, count in counts.most_common())
                parts.append(f"{marker.name}: {said} of {len(reasons)} frames")
        self.first_dismissed = (
            f"; spots taken for them at t = {found.frames[0][1]:.2f} s did not hold ({'; '.join(parts)})"
        )

    def why_unclear(self) -> str:
        """What to tell the user when the marks were found and nothing says which is which."""
        names = " and ".join(m.name for m in self.markers)
        told = all(m.seen_at_px is not None for m in self.markers)
        seed = "" if told else "Say where each is seen at first (marker.seen_at_px), give"
        return (
            f"{self.run.source_path}: {names} are found, but nothing tells them apart: turned round they fit as well"
            f"{self.first_dismissed}. {seed or 'Give'} one another colour, add a third mark out of their middle, or, for a tow, "
            "tow.tow_point_m and tow.line_length_m"
        )

    def why_never(self) -> str:
        """What to tell the user when the marks were never found."""
        names = ", ".join(m.name for m in self.markers)
        text = f"{self.run.source_path}: markers never found ({names}): {self.most} spots in the best frame"
        if len(self.markers) == 1 and self.last is not None and self.last.ambiguous:
            return f"{text}, several of which could be it; say where it is seen at first (marker.seen_at_px)"
        if self.last is not None and self.last.nearest_m is not None:
            apart, stated = self.last.nearest_m
            text += (
                f"; no set of them fits the markers' distances, the taut line, the heading and a common brightness "
                f"(pair distance stated {stated:.3f} m, nearest {apart:.3f} m)"
            )
        text += self.first_dismissed
        return text + "; check marker.body_m, depth_m, colour and the datum, or give marker.seen_at_px"
