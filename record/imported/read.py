"""One door to all readers: by the program's name, or by what the file looks like."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import InputError
from .dltdv import COLUMN, read_dltdv
from .kinovea import read_kinovea
from .points import Imported, Points, Wanted, tracks_table
from .text import cells_of, delimiter_of, read_text
from .tracker import header_line, read_tracker
from .trackpy import NEEDED, read_trackpy

READERS: dict[str, Callable[[Path, Wanted], Points]] = {
    "trackpy": read_trackpy,
    "dltdv": read_dltdv,
    "kinovea": read_kinovea,
    "tracker": read_tracker,
}
PROGRAMS = tuple(READERS)
_PICKLES = (".pkl", ".pickle", ".p")


def program_of(path: Path) -> str:
    """Which program's format a file has.

    Parameters
    ----------
    path : of the file

    Returns
    -------
    name of the program, a key of the readers

    Raises
    ------
    InputError : none of them, or a pickle
    """
    if path.suffix == ".parquet":
        return "trackpy"
    lines = read_text(path)
    first = next(line.strip() for line in lines if line.strip())
    if first.startswith("<") or first.lower().startswith("#kinovea"):
        return "kinovea"
    cells = [cell.strip() for cell in cells_of(first, delimiter_of(first))]
    folded = [cell.lower() for cell in cells]
    if any(COLUMN.match(cell) for cell in cells):
        return "dltdv"
    if all(name in folded for name in NEEDED):
        return "trackpy"
    if folded[0].startswith("time"):
        return "kinovea"
    if header_line(lines) is not None:
        return "tracker"
    raise InputError(path, "header", f"{first[:60]!r} is none of {', '.join(PROGRAMS)}; say which (--from)")


def import_tracks(path: str | Path, program: str = "auto", wanted: Wanted | None = None) -> Imported:
    """Read the point tracks of another program as towline's.

    Parameters
    ----------
    path : the program's file
    program : trackpy, dltdv, kinovea, tracker, or auto: told from the file
    wanted : what the file does not say

    Returns
    -------
    tracks (frame, t_s, marker, u_px, v_px, sigma_u_px, sigma_v_px, status); a hole is a row with status lost

    Raises
    ------
    InputError : names file, line and column of what cannot be used
    """
    path, wanted = Path(path), wanted or Wanted()
    if path.suffix.lower() in _PICKLES:
        raise InputError(path, "", "is a pickle, which can run any code when read; write CSV or Parquet instead")
    if program == "auto":
        program = program_of(path)
    points = READERS[program](path, wanted)
    return Imported(tracks_table(path, points, wanted), program, points.notes)
