"""Run folders below a folder."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ...record.errors import InputError
from ...record.files import ABSENT, refusal
from ...record.run import RUN_FILE

OUT = "out"
SKIPPED = {OUT, "truth"}
"""Folders of a run that hold no run."""
MOST_FOLDERS = 50_000
"""Are looked through; where there are more, a link or a word too few led to the whole disk."""
RUN, BELOW, NOTHING = "run", "below", "nothing"


@dataclass(frozen=True)
class Found:
    """What lies below a folder.

    Attributes
    ----------
    runs : folders with a run.toml, relative to the folder, in order
    without : folders that hold files or nothing at all but no run.toml and no run below them
    """

    runs: list[str]
    without: list[str]


def run_folders(folder: Path) -> Found:
    """All run folders below ``folder`` (itself, if it is one).

    Raises
    ------
    InputError : no such folder, no run in it, or more than ``MOST_FOLDERS`` folders
    """
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder; expected one with run folders below it")
    held = _looked_through(folder)
    runs = [place for place, holds in held.items() if holds is RUN]
    if not runs:
        raise InputError(folder, "", f"no {RUN_FILE} in it or below it; towline init writes one")
    without = [place for place in _topmost(place for place in held if held[place] is NOTHING) if place != folder]
    return Found(*([place.relative_to(folder).as_posix() for place in sorted(some)] for some in (runs, without)))


def _looked_through(top: Path) -> dict[Path, str]:
    """What every folder below ``top`` holds: it is a RUN, has one BELOW it, or holds NOTHING of the kind.

    A folder is looked at once, whatever links lead to it, and links are followed after everything else: a run is called by the
    name of its own folder where that lies below ``top``, too.
    """
    held: dict[Path, str] = {}
    seen: set[str] = set()
    waiting, links = [top], []
    while waiting or links:
        place = waiting.pop() if waiting else links.pop(0)
        real = os.path.realpath(place)
        if real in seen:
            _not_empty(held, place)
            continue
        seen.add(real)
        if len(seen) > MOST_FOLDERS:
            raise InputError(top, "", f"more than {MOST_FOLDERS} folders in it; name the one that holds the runs")
        held[place] = NOTHING
        if refusal(place / RUN_FILE) != ABSENT:
            held[place] = RUN
            _not_empty(held, place)
            continue
        inside = [p for p in sorted(place.iterdir()) if _may_hold_runs(p)]
        waiting += [p for p in inside if not p.is_symlink()]
        links += [p for p in inside if p.is_symlink()]
    return held


def _not_empty(held: dict[Path, str], place: Path) -> None:
    """The folders above a run, or above what was looked at already, do not hold nothing."""
    for above in place.parents:
        if held.get(above) != NOTHING:
            break
        held[above] = BELOW


def _may_hold_runs(path: Path) -> bool:
    return path.name not in SKIPPED and not path.name.startswith(".") and path.is_dir()


def _topmost(folders: Iterable[Path]) -> list[Path]:
    """Those that lie in none of the others."""
    chosen = set(folders)
    return [folder for folder in chosen if folder.parent not in chosen]


__all__ = ["Found", "run_folders"]
