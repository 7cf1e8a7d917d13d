"""live.jsonl read again while it is written: by the page, after a crash, after the day."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..record.run import Run, cameras_of

LOG = "live.jsonl"
"""In out/ of a tow: a line for every frame and for everything that was named, written as it happens."""
SPOILING = ("mark", "camera", "line", "source")
"""Kinds of what is named that may spoil a tow for the fit."""
MOST_BYTES = 1 << 24
"""Read at once: more than half an hour's lines; the rest comes with the next reading."""


class LogReader:
    """Reads what was written since it was asked last; a line that is not whole yet waits, one that never will be is left out.

    Parameters
    ----------
    path : of live.jsonl; need not be there yet
    """

    def __init__(self, path: Path) -> None:
        self._path, self._at, self._begun = path, 0, b""

    def records(self) -> Iterator[dict[str, Any]]:
        """The new ones, in their order."""
        try:
            with self._path.open("rb") as stream:
                stream.seek(self._at)
                new = stream.read(MOST_BYTES)
        except OSError:
            return
        self._at += len(new)
        *lines, self._begun = (self._begun + new).split(b"\n")
        for line in lines:
            try:
                record = json.loads(line)
            except ValueError:  # of a machine that died while it wrote
                continue
            if isinstance(record, dict):
                yield record


def logs_of(run: Run) -> list[Path]:
    """Where what was named of a tow stands: of each camera that filmed it.

    Parameters
    ----------
    run : the run folder as read
    """
    return [view.out / LOG for view in cameras_of(run)]


def camera_logs(out: Path) -> dict[str, Path]:
    """Logs of the cameras of a tow that two filmed, by their names; {} of a tow of one.

    Parameters
    ----------
    out : of the tow's folder; need not be there yet
    """
    return {path.parent.name: path for path in sorted(out.glob(f"*/{LOG}"))}


def in_all(value: Sequence[float] | None) -> tuple[float, float]:
    """A value of two cameras' joint course with all that is unsure of it as one standard deviation; NaN where there is none.

    Parameters
    ----------
    value : as the line of a joint frame holds it: the value, its own standard deviation, and that of what is common to all frames
    """
    return (math.nan, math.nan) if value is None else (value[0], math.hypot(value[1], value[2]))


def spoiling(path: Path) -> list[str]:
    """What was named in a tow that may spoil it, a line each, at its time.

    Parameters
    ----------
    path : of live.jsonl; [] where there is none
    """
    found = [r for r in LogReader(path).records() if r.get("event") in SPOILING and r.get("level") != "good"]
    return [f"{float(r.get('t_s', 0.0)):.1f} s: {r.get('words', '')}" for r in found]


__all__ = ["LOG", "LogReader", "camera_logs", "in_all", "logs_of", "spoiling"]
