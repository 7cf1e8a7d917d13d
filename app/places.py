"""Which folders and files the page may touch: those of the run that is open, and what a person named outright."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from ..record.errors import InputError
from ..record.run import RUN_FILE
from ..record.sources import VIDEOS, recordings_in

MOST_FOLDERS = 4000
"""Folders looked into for runs."""
MOST_RUNS = 200
"""Found in one search at most: what a list can show."""
DEEPEST = 6
"""Levels of folders below that are searched."""
NUMBERS = re.compile(r"[^/\\\0]+/[^/\\\0]+\.csv")
LEFT_OUT = ("out", "truth", "node_modules", "__pycache__")


@dataclass(frozen=True)
class Place:
    """A folder that can be opened: with a run.toml, or with videos only."""

    folder: Path
    has_run: bool
    videos: tuple[str, ...]


def place(folder: str | Path) -> Place:
    """What a folder named outright holds.

    Raises
    ------
    InputError : no such folder, or neither a run.toml nor a video is in it
    """
    path = Path(os.path.expanduser(str(folder).strip()))
    if path.name == RUN_FILE and path.is_file():
        path = path.parent
    if "\0" in str(folder) or not str(folder).strip():
        raise InputError("folder", "", "a folder's path is expected")
    if not path.is_dir():
        raise InputError(path, "", "no such folder")
    path = path.resolve()
    found = Place(path, (path / RUN_FILE).is_file(), tuple(recordings_in(path)))
    if not found.has_run and not found.videos:
        raise InputError(path, "", f"neither a {RUN_FILE} nor a video ({', '.join(VIDEOS)}) is in it")
    return found


def places_below(folder: Path) -> list[Place]:
    """Run folders, and folders with videos that are none yet, in a folder and below it; links are not followed."""
    found: list[Place] = []
    top = folder.resolve()
    for looked, (here, folders, files) in enumerate(os.walk(top), 1):
        path = Path(here)
        depth = len(path.relative_to(top).parts)
        kept = [] if depth >= DEEPEST else folders
        folders[:] = sorted(f for f in kept if not f.startswith(".") and f not in LEFT_OUT)
        videos = tuple(sorted(f for f in files if Path(f).suffix.lower() in VIDEOS and not f.startswith(".")))
        if RUN_FILE in files or videos:
            found.append(Place(path, RUN_FILE in files, videos))
        if looked >= MOST_FOLDERS or len(found) >= MOST_RUNS:
            break
    return found


def inside(folder: Path, name: str) -> Path:
    """The file of a folder that a relative path names.

    Parameters
    ----------
    folder : that the file must lie in
    name : relative path

    Raises
    ------
    InputError : it is no relative path, leads out of the folder (also through a link), or no such file is there
    """
    if not name or "\0" in name or Path(name).is_absolute() or Path(name).drive:
        raise InputError(folder, "", f"{name!r} is no path inside the folder")
    root = folder.resolve()
    path = (root / name).resolve()
    if path != root and root not in path.parents:
        raise InputError(folder, "", f"{name!r} leads out of the folder")
    if not path.is_file():
        raise InputError(folder, "", f"no such file: {name}")
    return path


def page_file(page: Path, name: str) -> Path:
    """What the page of results ``page`` (RUN/out/x.html) may show: itself, or the numbers of a figure in a folder beside it.

    Parameters
    ----------
    page : RUN/out/x.html
    name : the path that is asked for

    Raises
    ------
    InputError : it is neither, or a link that leads out of the run's folder
    """
    if name != page.name and not (NUMBERS.fullmatch(name) and ".." not in name.split("/")):
        raise InputError(page, "", f"{name!r} is no part of it")
    return inside(page.parent.parent, f"{page.parent.name}/{name}")


__all__ = ["VIDEOS", "Place", "inside", "page_file", "place", "places_below"]
