"""What the live page shows: the last half minute of a tow, what was named, what is in order, the day so far. Read from the disk, so
that a reload or a crash loses nothing."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..live.folder import STATIC, tows_of
from ..live.kept import DAY, kept_day
from ..live.log import LOG, LogReader, spoiling
from ..live.picture import PICTURE
from ..record.day_file import DayFile
from ..record.errors import TowlineError

SHOWN_S = 30.0
"""Of the rolling plot."""
MOST_POINTS = 300
"""Of a curve on the screen: what half a panel's width can show."""
MOST_EVENTS = 60
"""Kept of what was named."""
CURVES = (
    ("alpha_rad", "α, tow line angle", "deg", 180 / np.pi),
    ("beta_rad", "β, heading", "deg", 180 / np.pi),
    ("y_cg_m", "y_CG, to starboard", "mm", 1e3),
)
"""Key of live.jsonl, what the axis is called, its unit, and the factor to it."""
GAP_S = 0.4
"""Frames farther apart are not joined by a line: between them nothing was seen."""
RATE_FRAMES = 30
"""Frames whose latency is averaged for the line of values."""


@dataclass
class Tail:
    """The end of a tow's live.jsonl.

    Attributes
    ----------
    folder : of the tow
    frames : of the last ``SHOWN_S``
    events : newest last
    steady : what was said last of where a steady tow comes to rest; None: nothing
    ready : by what it is of: words, and whether it is in order
    version : goes up with everything new
    """

    folder: Path
    frames: deque[dict[str, Any]] = field(default_factory=deque)
    events: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_EVENTS))
    ready: dict[str, tuple[str, bool]] = field(default_factory=dict)
    steady: dict[str, Any] | None = None
    version: int = 0
    _reader: LogReader | None = None

    def read(self) -> None:
        """What is new."""
        self._reader = self._reader or LogReader(self.folder / "out" / LOG)
        for record in self._reader.records():
            self.version += 1
            if "frame" in record:
                self.frames.append(record)
                while record["t_s"] - self.frames[0]["t_s"] > SHOWN_S:
                    self.frames.popleft()
            elif "event" in record:
                self.events.append(record)
            elif "steady" in record:
                self.steady = record
            elif "ready" in record:
                self.ready[record["ready"]] = record["words"], record["good"]

    def picture(self) -> tuple[int, float]:
        """Which picture is there, by when it was drawn, in ns (0: none), and how old it is in s."""
        try:
            drawn_ns = (self.folder / "out" / PICTURE).stat().st_mtime_ns
        except OSError:
            return 0, float("inf")
        return drawn_ns, time.time() - drawn_ns / 1e9

    def curves(self) -> dict[str, Any]:
        """The plots' data, as ``motion_view.curves`` has it; {} where there is nothing yet."""
        if len(self.frames) < 2:
            return {}
        every, last_s = max(1, -(-len(self.frames) // MOST_POINTS)), self.frames[0]["t_s"]
        first = -self.frames[-1]["frame"] % every  # the same frames from one drawing to the next
        part: list[dict[str, Any]] = []
        for f in self.frames:
            if part and f["t_s"] - last_s > GAP_S:
                part.append({"t_s": (f["t_s"] + last_s) / 2})
            if (f["frame"] + first) % every == 0 or (part and f["t_s"] - part[-1]["t_s"] > GAP_S):
                part.append(f)
            last_s = f["t_s"]
        panels = []
        for key, label, unit, factor in CURVES:
            values = [f.get(key) for f in part]
            if any(values):
                y, sd = ([_scaled(v, i, factor) for v in values] for i in (0, 1))
                panels.append({"label": label, "unit": unit, "y": y, "sd": sd})
        return {"t": [f["t_s"] for f in part], "panels": panels} if panels else {}

    def now(self) -> str:
        """The last values, in words."""
        if not self.frames:
            return ""
        last = self.frames[-1]
        lost = [name for name, mark in last["marks"].items() if isinstance(mark, str)]
        said = [f"{last['t_s']:.1f} s"]
        for key, label, unit, factor in CURVES:
            if last[key] is not None:
                digits = 1 if unit == "mm" else 2
                value, sd = (factor * v for v in last[key][:2])
                said.append(f"{label.partition(',')[0]} {value:+.{digits}f} ± {sd:.{digits}f} {unit}")
        said += [f"not seen: {', '.join(lost)}"] if lost else []
        late = [f["latency_s"] for f in list(self.frames)[-RATE_FRAMES:]]
        return "   ".join([*said, f"({1e3 * float(np.median(late)):.0f} ms behind)"])


def _scaled(value: list[float | None] | None, place: int, factor: float) -> float | None:
    number = None if value is None else value[place]
    return None if number is None else float(f"{factor * number:.5g}")


@dataclass(frozen=True)
class TowRow:
    """A tow of the day in the list: its folder, how long, and what was named that may spoil it."""

    folder: Path
    seconds: float | None
    named: tuple[str, ...]


class DayView:
    """The day's folder, looked at again and again.

    Parameters
    ----------
    folder : need not be there yet
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: dict[Path, tuple[int, TowRow]] = {}
        self._kept: tuple[int, DayFile | None, str] = (-1, None, "")

    def rows(self) -> list[TowRow]:
        """The tows so far and the static records, in their order."""
        return [self._row(path) for kind in (STATIC, "tow-") for path in tows_of(self.folder, kind)]

    def _row(self, path: Path) -> TowRow:
        log = path / "out" / LOG
        size = log.stat().st_size if log.is_file() else 0
        known = self._rows.get(path)
        if known is None or known[0] != size:
            frames = [r["t_s"] for r in LogReader(log).records() if "frame" in r]
            seconds = frames[-1] - frames[0] if frames else None
            known = self._rows[path] = size, TowRow(path, seconds, tuple(spoiling(log)))
        return known[1]

    def standing(self) -> tuple[DayFile | None, str]:
        """Where the day stands, and what is wrong with its file ("": nothing)."""
        path = self.folder / DAY
        at = path.stat().st_mtime_ns if path.is_file() else 0
        if self._kept[0] != at:
            try:
                self._kept = at, kept_day(self.folder), ""
            except TowlineError as error:
                self._kept = at, None, str(error)
        return self._kept[1], self._kept[2]

    @property
    def version(self) -> tuple[Any, ...]:
        """Changes with whatever the list or the standing would show."""
        path = self.folder / DAY
        rows = tuple(p.name for kind in (STATIC, "tow-") for p in tows_of(self.folder, kind))
        return self.folder, rows, path.stat().st_mtime_ns if path.is_file() else 0

    def last(self) -> Path | None:
        """The tow or static record that was filmed last; None: none yet."""
        there = [path for kind in (STATIC, "tow-") for path in tows_of(self.folder, kind)]
        return max(there, key=lambda path: (path / "run.toml").stat().st_mtime_ns, default=None)


@dataclass
class Live:
    """What all windows show of the live page.

    Attributes
    ----------
    source, plan : as typed
    day : what lies in the day's folder
    tail : of the tow that is filmed, or was last; None: none yet
    """

    source: str
    plan: str
    day: DayView
    tail: Tail | None = None

    @classmethod
    def beside(cls, setup: Path, date: str) -> Live:
        """Of a set-up, on a date: the day's folder stands beside it, as does plan.toml; what was filmed there is shown again.

        Parameters
        ----------
        setup : run folder
        date : for the day's name
        """
        plans = [p for p in (setup / "plan.toml", setup.parent / "plan.toml") if p.is_file()]
        return cls("", str(plans[0]) if plans else "", DayView(setup.parent / f"day-{date}"))

    def turn_to(self, day: Path) -> None:
        """Another day's folder."""
        if day != self.day.folder:
            self.day, self.tail = DayView(day), None

    def follow(self, folder: Path | None) -> None:
        """Read what is new of the tow that is filmed; None: of the one that was filmed last.

        Parameters
        ----------
        folder : of the tow, where one is filmed
        """
        if folder is None and self.tail is None:
            folder = self.day.last()
        if folder is not None and (self.tail is None or self.tail.folder != folder):
            self.tail = Tail(folder)
        if self.tail is not None:
            self.tail.read()


__all__ = ["CURVES", "DayView", "Live", "Tail", "TowRow"]
