"""Gross mistakes of a run.toml, where a run is read, tracked, mapped or checked: found with all that the run folder holds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from ..record.errors import InputError, TowlineError
from ..record.run import RUN_FILE, Run
from ..record.tables import read_history
from ..record.template import left_of_template

if TYPE_CHECKING:
    import pandas as pd

    from ..geometry.checks.mistakes import Mistake


def mistakes_of(run: Run, tracks: pd.DataFrame | None) -> tuple[Mistake, ...]:
    """Gross mistakes of a run's set-up; empty where it is an ordinary one.

    Parameters
    ----------
    run : the run folder as read
    tracks : its tracks; None: not tracked yet, then less can be told
    """
    from ..geometry.checks.mistakes import find_mistakes

    tow = run.file.tow
    tension = _history(run, tow.tension if tow else None, "tension_n")
    rudder = _history(run, tow.rudder if tow else None, "rudder_rad")
    return find_mistakes(
        run,
        tracks,
        _size_px(run),
        None if tension is None else float(np.median(tension)),
        None if rudder is None else float(np.abs(rudder).max()),
    )


def refuse_untouched(run: Run) -> None:
    """Stop before anything is computed from datum points that are still the example of ``towline init``.

    Parameters
    ----------
    run : the run folder as read; one that came with its motion needs no datum

    Raises
    ------
    InputError : names the point, its key and what was expected
    """
    if run.file.source.motion is not None:
        return
    left = left_of_template(run.file, _size_px(run))
    if left is not None:
        raise InputError(run.folder / RUN_FILE, *left)


@contextmanager
def named(run: Run, tracks: pd.DataFrame | None = None) -> Iterator[None]:
    """What cannot be done because of a gross mistake ends with the mistake's line instead of what it led to.

    Parameters
    ----------
    run : the run folder as read
    tracks : its tracks; None: not tracked yet
    """
    try:
        yield
    except TowlineError as error:
        first = next((m for m in mistakes_of(run, tracks) if m.keys), None)
        if first is None:
            raise
        path = run.folder / RUN_FILE
        words, where = first.line.removeprefix(f"{path}: "), first.keys[0]
        if len(first.keys) > 1:
            raise InputError(path, "", words) from error
        raise InputError(path, where, words.removeprefix(where).lstrip(":= ")) from error


def mistake_lines(run: Run, notes: list[str]) -> list[str]:
    """Those of a motion's notes that name a mistake, with the file's whole path again.

    Parameters
    ----------
    run : whose motion it is
    notes : of its camera file
    """
    return [str(run.folder / note) for note in notes if note.startswith(f"{RUN_FILE}: ")]


def mistake_notes(run: Run, tracks: pd.DataFrame | None) -> list[str]:
    """What ``mistakes_of`` finds, as notes of a result file: the same wherever the run folder stands.

    Parameters
    ----------
    run : the run folder as read
    tracks : its tracks
    """
    return [mistake.line.replace(str(run.folder / RUN_FILE), RUN_FILE) for mistake in mistakes_of(run, tracks)]


def _size_px(run: Run) -> tuple[int, int] | None:
    if run.file.source.video is None:
        return None
    from ..vision import clip_info

    try:
        info = clip_info(run.source_path)
    except TowlineError:
        return None
    return info.width_px, info.height_px


def _history(run: Run, name: str | None, column: str) -> np.ndarray | None:
    if name is None:
        return None
    try:
        return read_history(run.path(name), column)[column].to_numpy(dtype=float)
    except TowlineError:  # told where it is used
        return None


__all__ = ["mistake_lines", "mistake_notes", "mistakes_of", "named", "refuse_untouched"]
