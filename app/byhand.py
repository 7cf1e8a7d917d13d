"""Marks digitised by hand on every n-th frame: clicks become rows of a tracks.csv, each with its stated sigma."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..record.errors import InputError
from ..record.tables import TRACK_COLUMNS, read_tracks, write_table
from ..record.typed import replacing_typed

if TYPE_CHECKING:
    import pandas as pd

FILE = "tracks_by_hand.csv"
SIGMA_PX = 0.5
"""How well a click by hand places a mark where nobody says otherwise: half a pixel, as in run.toml's datum."""


@dataclass(frozen=True)
class Click:
    """One mark in one frame: u, v and how well it was clicked (standard deviation along each)."""

    frame: int
    marker: str
    u_px: float
    v_px: float
    sigma_px: float


@dataclass
class ByHand:
    """The clicks so far and what is clicked next.

    Attributes
    ----------
    markers : names, in the order in which they are clicked in every frame
    every : frames from one that is clicked to the next
    clicks : in the order they were made
    frame : the one that is being clicked
    dirty : something is not written
    """

    markers: Sequence[str]
    every: int = 15
    clicks: list[Click] = field(default_factory=list)
    frame: int = 0
    dirty: bool = False
    _undone: list[tuple[Click, Click | None]] = field(default_factory=list)
    _replaced: list[Click | None] = field(default_factory=list)

    @property
    def wanted(self) -> str:
        """The mark that the next click is taken for; "" = the frame has all of them."""
        have = {c.marker for c in self.clicks if c.frame == self.frame}
        return next((name for name in self.markers if name not in have), "")

    def click(self, u_px: float, v_px: float, sigma_px: float = SIGMA_PX, marker: str = "") -> bool:
        """Take a click for the wanted mark (or ``marker``; what it had in this frame is replaced).

        Returns
        -------
        bool : the frame is complete, and the next one is ``frame + every``

        Raises
        ------
        ValueError : the frame has all of its marks, or there is no such marker
        """
        name = marker or self.wanted
        if not name:
            raise ValueError(f"frame {self.frame} has all of its marks")
        if name not in self.markers:
            raise ValueError(f"{name!r} is none of the markers {', '.join(self.markers)}")
        old = next((c for c in self.clicks if (c.frame, c.marker) == (self.frame, name)), None)
        if old is not None:
            self.clicks.remove(old)
        self.clicks.append(Click(self.frame, name, float(u_px), float(v_px), float(sigma_px)))
        self._replaced.append(old)
        self._undone.clear()
        self.dirty = True
        return not self.wanted

    def next_frame(self, last: int | None = None) -> bool:
        """Go on to the next frame to be clicked; False where the recording ends before it."""
        frame = self.frame + self.every
        if last is not None and frame > last:
            return False
        self.frame = frame
        return True

    def undo(self) -> Click | None:
        """Take the last click back and go to its frame; None where there is none."""
        if not self.clicks or not self._replaced:
            return None
        gone, old = self.clicks.pop(), self._replaced.pop()
        if old is not None:
            self.clicks.append(old)
            self._settle(old)
        self._undone.append((gone, old))
        self.frame = gone.frame
        self.dirty = True
        return gone

    def redo(self) -> Click | None:
        """Do again what was taken back last."""
        if not self._undone:
            return None
        gone, old = self._undone.pop()
        if old is not None:
            self.clicks.remove(old)
        self.clicks.append(gone)
        self._replaced.append(old)
        self.frame = gone.frame
        self.dirty = True
        return gone

    def _settle(self, old: Click) -> None:
        """A click that comes back stands where it stood: before all that is still to be undone."""
        self.clicks.remove(old)
        self.clicks.insert(len(self.clicks) - len(self._replaced), old)

    @property
    def frames(self) -> list[int]:
        """Frames that have all of their marks."""
        have: dict[int, set[str]] = {}
        for c in self.clicks:
            have.setdefault(c.frame, set()).add(c.marker)
        return sorted(frame for frame, names in have.items() if names >= set(self.markers))

    def table(self, time_s: Callable[[int], float]) -> pd.DataFrame:
        """Rows of tracks.csv by frame and mark.

        Parameters
        ----------
        time_s : frame -> its time

        Raises
        ------
        ValueError : nothing was clicked
        """
        import pandas as pd

        if not self.clicks:
            raise ValueError("nothing was clicked yet")
        order = {name: k for k, name in enumerate(self.markers)}
        rows = [
            (c.frame, time_s(c.frame), c.marker, c.u_px, c.v_px, c.sigma_px, c.sigma_px, "measured")
            for c in sorted(self.clicks, key=lambda c: (c.frame, order.get(c.marker, len(order))))
        ]
        return pd.DataFrame(rows, columns=list(TRACK_COLUMNS))

    def write(self, folder: Path, time_s: Callable[[int], float], outside: bool = False) -> Path:
        """Write RUN/tracks_by_hand.csv, whole or not at all; ``outside``: it may be a link out of the folder."""
        path = folder / FILE
        table = self.table(time_s)
        with replacing_typed(path, outside) as temporary:
            write_table(temporary, table)
        self.dirty = False
        return path


def begun(folder: Path, markers: Sequence[str], every: int = 15) -> ByHand:
    """What was digitised in a folder before, to go on with.

    Parameters
    ----------
    folder : of the run
    markers : names
    every : frames from one to the next

    Raises
    ------
    InputError : the file there cannot be used
    """
    path = folder / FILE
    found = ByHand(list(markers), every)
    if not path.is_file():
        return found
    for number, row in enumerate(read_tracks(path).itertuples(), 1):
        if row.status != "measured":
            continue
        if str(row.marker) not in found.markers:
            raise InputError(
                path, f"row {number}, marker", f"{row.marker!r} is none of the markers {', '.join(markers)}"
            )
        sigma = float(np.hypot(row.sigma_u_px, row.sigma_v_px) / np.sqrt(2))  # pyright: ignore
        found.clicks.append(
            Click(int(row.frame), str(row.marker), float(row.u_px), float(row.v_px), sigma if sigma > 0 else SIGMA_PX)  # pyright: ignore
        )
    if found.clicks:
        found.frame = max(c.frame for c in found.clicks)
        frames = sorted({c.frame for c in found.clicks})
        if len(frames) > 1:
            found.every = int(np.median(np.diff(frames)))
        if not found.wanted:
            found.frame += found.every
    return found


__all__ = ["FILE", "SIGMA_PX", "ByHand", "Click", "begun"]
