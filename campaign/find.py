"""Run folders below a folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..record.errors import InputError
from ..record.run import RUN_FILE

OUT = "out"
SKIPPED = {OUT, "truth"}
"""Folders of a run that hold no run."""


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
    InputError : no such folder, or no run in it
    """
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder; expected one with run folders below it")
    runs: list[str] = []
    without: list[str] = []
    _look(folder, folder, runs, without)
    if not runs:
        raise InputError(folder, "", f"no {RUN_FILE} in it or below it; towline init writes one")
    return Found(runs, without)


def _look(top: Path, folder: Path, runs: list[str], without: list[str]) -> bool:
    """Whether a run lies here or below."""
    if (folder / RUN_FILE).is_file():
        runs.append(folder.relative_to(top).as_posix())
        return True
    below = [p for p in sorted(folder.iterdir()) if p.is_dir() and p.name not in SKIPPED and not p.name.startswith(".")]
    held = [_look(top, p, runs, without) for p in below]
    if not any(held) and folder != top:
        for p in below:
            without.remove(p.relative_to(top).as_posix())
        without.append(folder.relative_to(top).as_posix())
    return any(held)


__all__ = ["Found", "run_folders"]
