"""What a person sets right in the tracks, as it is being made: clicks become corrections.toml, each can be taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..record.corrections import (
    Corrections,
    Placed,
    Removed,
    check_corrections,
    in_words,
    read_corrections,
    write_corrections,
)
from ..record.errors import InputError
from ..record.files import TOML_BYTES, read_text
from ..record.run import CORRECTIONS, Run
from ..record.schema import Marker
from ..record.typed import write_aside

DIGITS = 2
"""Decimals of a clicked place in pixels that are written: far finer than a click."""


@dataclass
class Correcting:
    """The corrections so far.

    Attributes
    ----------
    folder, markers : of the run
    made : the corrections
    saved : what the file holds
    version : goes up with every change
    """

    folder: Path
    markers: tuple[Marker, ...]
    made: Corrections
    saved: Corrections
    version: int = 0
    _before: list[tuple[str, Corrections]] = field(default_factory=list)
    _after: list[tuple[str, Corrections]] = field(default_factory=list)
    _text: str = ""

    @classmethod
    def of(cls, run: Run) -> Correcting:
        """Those of a run folder, to go on with.

        Raises
        ------
        InputError : the file there cannot be used
        """
        found = read_corrections(run)
        return cls(run.folder, run.file.marker, found, found, _text=_on_disk(run.folder))

    @property
    def dirty(self) -> bool:
        """Something is not written."""
        return self.made != self.saved

    @property
    def can_undo(self) -> bool:
        """There is a change to take back."""
        return bool(self._before)

    @property
    def can_redo(self) -> bool:
        """There is one that was taken back."""
        return bool(self._after)

    @property
    def changed_outside(self) -> bool:
        """Another program has changed the file since it was read or written here."""
        return _on_disk(self.folder) != self._text

    @property
    def words(self) -> str:
        """What there is, and whether it is written."""
        text = in_words(self.made) or "nothing corrected"
        return f"{text[0].upper()}{text[1:]}" + (", not saved" if self.dirty else "")

    # changes ---------------------------------------------------------------------------------------------------------

    def move(self, frame: int, marker: str, place_px: Sequence[float], sigma_px: float) -> None:
        """A point is where a person sees it.

        Parameters
        ----------
        frame : of the recording
        marker : name
        place_px : (u, v)
        sigma_px : how well that is known

        Raises
        ------
        InputError : there is no such marker
        """
        free = self._without(frame, marker)
        self._take(f"move {marker}", free, point=(*free.point, _placed(frame, marker, place_px, sigma_px)))

    def remove(self, frame: int, marker: str) -> None:
        """What was measured in a frame is not the mark."""
        free = self._without(frame, marker)
        self._take(f"remove {marker}", free, removed=(*free.removed, Removed(frame=frame, marker=marker)))

    def seed(self, frame: int, marker: str, place_px: Sequence[float], sigma_px: float) -> None:
        """A mark is to be followed anew from a frame on; parameters and errors as in ``move``."""
        made = self.made.seeded([_placed(frame, marker, place_px, sigma_px)])
        self._take(f"seed {marker}", made)

    def release(self, frame: int, marker: str) -> bool:
        """What the tracker found holds again in a frame, and no seed stands there; whether there was anything."""
        free = self._without(frame, marker)
        seeds = tuple(s for s in free.seed if (s.frame, s.marker) != (frame, marker))
        free = free.model_copy(update={"seed": seeds})
        if free == self.made:
            return False
        self._take(f"{marker} as it was tracked", free)
        return True

    def undo(self) -> str:
        """Take the last change back; what it was, "" = there is none."""
        return self._step(self._before, self._after)

    def redo(self) -> str:
        """Do again what was taken back last."""
        return self._step(self._after, self._before)

    def _step(self, source: list[tuple[str, Corrections]], target: list[tuple[str, Corrections]]) -> str:
        if not source:
            return ""
        words, made = source.pop()
        target.append((words, self.made))
        self.made = made
        self.version += 1
        return words

    def _take(self, words: str, made: Corrections, **rows: tuple[Placed | Removed, ...]) -> None:
        made = made.model_copy(update=rows)
        check_corrections(made, self.markers, self.folder / CORRECTIONS)
        self._before.append((words, self.made))
        self._after.clear()
        self.made = made
        self.version += 1

    def _without(self, frame: int, marker: str) -> Corrections:
        """The corrections with nothing set or removed of a mark in a frame."""
        points = tuple(p for p in self.made.point if (p.frame, p.marker) != (frame, marker))
        removed: list[Removed] = []
        for gone in self.made.removed:
            if gone.marker != marker or not gone.frame <= frame <= gone.end:
                removed.append(gone)
                continue
            if gone.frame < frame:
                removed.append(gone.model_copy(update={"last_frame": frame - 1}))
            if frame < gone.end:
                removed.append(gone.model_copy(update={"frame": frame + 1, "last_frame": gone.end}))
        return self.made.model_copy(update={"point": points, "removed": tuple(removed)})

    # what stands in a frame ------------------------------------------------------------------------------------------

    def point(self, frame: int, marker: str) -> Placed | None:
        """A place set by hand; None without one."""
        return next((p for p in self.made.point if (p.frame, p.marker) == (frame, marker)), None)

    def removed(self, frame: int, marker: str) -> bool:
        """The mark was removed there."""
        return any(r.marker == marker and r.frame <= frame <= r.end for r in self.made.removed)

    def seeds(self, frame: int) -> dict[str, Placed]:
        """Seeds of a frame by the marker's name."""
        return {s.marker: s for s in self.made.seed if s.frame == frame}

    # writing ---------------------------------------------------------------------------------------------------------

    def write(self, outside: bool = False) -> list[Path]:
        """Write the file, whole or not at all; what another program wrote into it meanwhile is kept beside it.

        Parameters
        ----------
        outside : it may be a link out of the folder

        Returns
        -------
        list : the file, and where the other's text is

        Raises
        ------
        InputError, OSError : it cannot be written
        """
        written = []
        if self.changed_outside and (theirs := _on_disk(self.folder)):
            written.append(write_aside(self.folder / CORRECTIONS, theirs, "theirs"))
        written.insert(0, write_corrections(self.folder, self.made, outside))
        self.saved, self._text = self.made, _on_disk(self.folder)
        return written


def _placed(frame: int, marker: str, place_px: Sequence[float], sigma_px: float) -> Placed:
    place = round(float(place_px[0]), DIGITS), round(float(place_px[1]), DIGITS)
    return Placed(frame=frame, marker=marker, pixel_px=place, sigma_px=float(f"{sigma_px:.3g}"))


def _on_disk(folder: Path) -> str:
    try:
        return read_text(folder / CORRECTIONS, TOML_BYTES)
    except InputError:
        return ""


__all__ = ["Correcting"]
