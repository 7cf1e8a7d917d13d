"""Writing what a person typed or clicked: on the disk when it is done, through links, nothing left of writers that were killed."""

from __future__ import annotations

import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import InputError
from .files import replacing

MOST_ASIDE = 100
"""Texts that are kept beside a file when another program has changed it: a choice."""
LEFT_OVER_S = 60.0
"""A temporary file of something typed that is older than this has no writer any more: such a file is written in one go."""


@contextmanager
def replacing_typed(path: str | Path, outside: bool = False) -> Iterator[Path]:
    """As ``replacing``, for what a person typed or clicked: on the disk when the block ends, and a link stays a link.

    What a writer that was killed has left beside it goes.

    Parameters
    ----------
    path : of the file
    outside : the link may lead out of the folder

    Raises
    ------
    InputError : it leads out, and may not
    """
    target = linked(path, outside)
    sweep(target)
    with replacing(target, lasting=True) as temporary:
        yield temporary


def write_typed(path: str | Path, text: str, outside: bool = False) -> None:
    """Write what a person typed, as UTF-8; ``replacing_typed`` says how.

    Parameters
    ----------
    path : of the file
    text : what is written
    outside : a link may lead out of the folder
    """
    with replacing_typed(path, outside) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_aside(path: str | Path, text: str, whose: str) -> Path:
    """Put another text beside a file, under a name that is free (``run.theirs1.toml``) and with the file's permissions.

    Parameters
    ----------
    path : of the file
    text : what is kept
    whose : word in the name: "mine", "theirs"

    Raises
    ------
    InputError, OSError : it cannot be written
    """
    path = Path(path)
    mode = stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666
    for number in range(1, MOST_ASIDE):
        aside = path.with_name(f"{path.stem}.{whose}{number}{path.suffix}")
        try:
            aside.touch(mode, exist_ok=False)
        except FileExistsError:
            continue
        write_typed(aside, text)
        return aside
    raise InputError(path, "", f"{MOST_ASIDE - 1} texts are kept beside it already; remove some")


def linked(path: str | Path, outside: bool = False) -> Path:
    """The file that a path stands for: its own, or the one that it links to.

    Parameters
    ----------
    path : of the file
    outside : a link may lead out of the folder

    Raises
    ------
    InputError : the link leads out of the folder and ``outside`` is false
    """
    path = Path(path)
    if not path.is_symlink():
        return path
    target, folder = Path(os.path.realpath(path)), path.parent.resolve()
    if not outside and folder not in target.parents:
        raise InputError(
            path, "", f"is a link to {target}, out of its folder; outside = true at the run's top lets that be written"
        )
    return target


def sweep(path: str | Path) -> None:
    """Remove temporary files of ``path`` that a writer left which was killed (``replacing_typed`` writes in one go)."""
    target = Path(path)
    before_s = time.time() - LEFT_OVER_S
    named = re.compile(rf"\.{re.escape(target.stem)}-\w{{8}}\.tmp{re.escape(target.suffix)}")
    with suppress(OSError):
        for found in os.scandir(target.parent):
            ours = named.fullmatch(found.name)
            if ours and found.is_file(follow_symlinks=False) and found.stat(follow_symlinks=False).st_mtime < before_s:
                os.unlink(found.path)
