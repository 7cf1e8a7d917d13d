"""The whole frame searched for the markers: spots, what of them are lamps, and which is which."""

from __future__ import annotations

import numpy as np

from ...geometry.mapping import Mapping
from ...record.run import Run
from ...record.schema import Marker
from ..recording import Frame
from .candidates import Array, Candidates, find_candidates, with_tint
from .identity import TINTS, Assignment, assign

STATIC_PX = 1.0
"""A spot within this of where it was seen before stands still."""
MOVED_PX = 8.0
"""A spot that stands while the marks move this far is a lamp or a glare, and never a mark."""


class Search:
    """Finds the markers of a run in a frame, and learns what stands there that is none of them."""

    def __init__(self, run: Run, markers: tuple[Marker, ...], mapping: Mapping) -> None:
        self.run, self.markers, self.mapping = run, markers, mapping
        self.last: Assignment | None = None
        self.most = 0
        self.standing = self.others = np.zeros((0, 2))
        self.begun_at: dict[int, Array] = {}

    def spots(
        self,
        frame: Frame,
        widths_px: tuple[float, ...],
        near: list[Array | None],
        near_sd_px: list[float] | None = None,
    ) -> tuple[Assignment, Candidates]:
        """Assign the frame's spots to the markers, trying ``widths_px`` in turn."""
        best = None
        for width in widths_px:
            candidates = self._without_lamps(self._candidates(frame, width))
            self.most = max(self.most, len(candidates))
            chosen = assign(candidates, self.markers, self.mapping, self.run, near, near_sd_px)
            if best is None or chosen.cost < best[0].cost:
                best = (chosen, candidates)
            if chosen.accepted and not chosen.ambiguous:
                break
        assert best is not None
        self.last = best[0]
        return best

    def _candidates(self, frame: Frame, width_px: float) -> Candidates:
        """Spots of the frame, bright and dark as the markers are, with their colour where a marker has one."""
        found = None
        for dark in sorted({m.colour == "dark" for m in self.markers}):
            one = find_candidates(frame.luma, dark, width_px)
            found = one if found is None else found.and_also(one)
        assert found is not None
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

    def why_never(self) -> str:
        """What to tell the user when the marks were never found."""
        names = ", ".join(m.name for m in self.markers)
        text = f"{self.run.source_path}: markers never found ({names}): {self.most} spots in the best frame"
        if self.last is not None and self.last.nearest_m is not None:
            apart, stated = self.last.nearest_m
            text += (
                f"; no set of them fits the markers' distances, the taut line, the heading and a common brightness "
                f"(pair distance stated {stated:.3f} m, nearest {apart:.3f} m)"
            )
        return text + "; check marker.body_m, depth_m, colour and the datum, or give marker.seen_at_px"
