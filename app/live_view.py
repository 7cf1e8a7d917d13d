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
from ..live.log import LOG, LogReader, camera_logs, in_all, spoiling
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
    """The end of a tow's live.jsonl, and of those of its two cameras, where two film it.

    Attributes
    ----------
    folder : of the tow
    frames : of the last ``SHOWN_S``; of two cameras what both say together, with all that is unsure of it
    events : newest last
    steady : what was said last of where a steady tow comes to rest; None: nothing
    ready : by what it is of: words, and whether it is in order
    pair : what was said last of the two cameras' clocks; None: nothing, or there is one camera
    lost : marks that are not seen now, by camera; "" of one camera alone
    version : goes up with everything new
    """

    folder: Path
    frames: deque[dict[str, Any]] = field(default_factory=deque)
    events: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_EVENTS))
    ready: dict[str, tuple[str, bool]] = field(default_factory=dict)
    steady: dict[str, Any] | None = None
    pair: dict[str, Any] | None = None
    lost: dict[str, list[str]] = field(default_factory=dict)
    version: int = 0
    _readers: dict[str, LogReader] = field(default_factory=dict)

    def read(self) -> None:
        """What is new."""
        for name, path in {"": self.folder / "out" / LOG, **camera_logs(self.folder / "out")}.items():
            reader = self._readers.setdefault(name, LogReader(path))
            for record in reader.records():
                self.version += 1
                self._take(record, name)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the two that film it; ("",) of one."""
        return tuple(name for name in self._readers if name) or ("",)

    def _take(self, record: dict[str, Any], camera: str) -> None:
        """A line of the log of the tow (""), or of one of two cameras."""
        whose = f"{camera}: " if camera else ""
        if "frame" in record:
            self.lost[camera] = [name for name, mark in record["marks"].items() if isinstance(mark, str)]
        if "event" in record:
            self.events.append(record | {"words": whose + record["words"]})
        elif "steady" in record:
            self.steady = record
        elif "ready" in record:
            self.ready[whose + record["ready"]] = record["words"], record["good"]
        elif "cameras" in record:
            self.pair = record
        elif "joint" in record or ("frame" in record and not camera):
            self.frames.append(_together(record) if "joint" in record else record)
            while record["t_s"] - self.frames[0]["t_s"] > SHOWN_S:
                self.frames.popleft()

    def picture(self, camera: str = "") -> tuple[int, float]:
        """Which picture is there, by when it was drawn, in ns (0: none), and how old it is in s.

        Parameters
        ----------
        camera : one of ``cameras``
        """
        try:
            drawn_ns = (self.folder / "out" / camera / PICTURE).stat().st_mtime_ns
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
        said = [f"{last['t_s']:.1f} s"]
        if "joint" in last:
            said.append(f"by {last['camera'].replace('+', ' and ')}" if last["camera"] else "by no camera")
        for key, label, unit, factor in CURVES:
            if last[key] is not None:
                digits = 1 if unit == "mm" else 2
                value, sd = (factor * v for v in last[key][:2])
                said.append(f"{label.partition(',')[0]} {value:+.{digits}f} ± {sd:.{digits}f} {unit}")
        by = {name: f" by {name}" if name else "" for name in self.lost}
        said += [f"not seen{by[name]}: {', '.join(lost)}" for name, lost in self.lost.items() if lost]
        late = [f["latency_s"] for f in list(self.frames)[-RATE_FRAMES:]]
        return "   ".join([*said, f"({1e3 * float(np.median(late)):.0f} ms behind)"])


def _together(record: dict[str, Any]) -> dict[str, Any]:
    """A line of both cameras as one of a frame: its number, and all that is unsure of a value as one standard deviation."""
    values = {key: record[key] for key, *_ in CURVES}
    sure = {key: None if v is None else list(in_all(v)) for key, v in values.items()}
    return {**record, **sure, "frame": record["joint"]}


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
        logs = {"": path / "out" / LOG, **camera_logs(path / "out")}
        size = sum(log.stat().st_size for log in logs.values() if log.is_file())
        known = self._rows.get(path)
        if known is None or known[0] != size:
            frames = [r["t_s"] for r in LogReader(logs[""]).records() if "frame" in r or "joint" in r]
            seconds = frames[-1] - frames[0] if frames else None
            named = [f"{name}: {words}" if name else words for name, log in logs.items() for words in spoiling(log)]
            known = self._rows[path] = size, TowRow(path, seconds, tuple(named))
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
    sources : as typed, one for each camera of the set-up
    plan : as typed
    day : what lies in the day's folder
    tail : of the tow that is filmed, or was last; None: none yet
    """

    sources: list[str]
    plan: str
    day: DayView
    tail: Tail | None = None

    @classmethod
    def beside(cls, setup: Path, date: str, cameras: int = 1) -> Live:
        """Of a set-up, on a date: the day's folder stands beside it, as does plan.toml; what was filmed there is shown again.

        Parameters
        ----------
        setup : run folder
        date : for the day's name
        cameras : that film
        """
        plans = [p for p in (setup / "plan.toml", setup.parent / "plan.toml") if p.is_file()]
        return cls([""] * cameras, str(plans[0]) if plans else "", DayView(setup.parent / f"day-{date}"))

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
