"""trackpy: a DataFrame with frame, x, y, particle as CSV or Parquet; pixel centres at integers, y down (numpy's indices)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError
from ..tables import read_table
from .convention import Array
from .points import LARGEST, Points, Wanted, frame_times
from .text import read_sheet

NEEDED = ("frame", "x", "y", "particle")
ERRORS = (("ep_x", "ep_y"), ("ep", "ep"))
"""Columns of the stated position error, px: of x and of y, or one for both."""


def read_trackpy(path: Path, wanted: Wanted) -> Points:
    """Read linked features.

    Parameters
    ----------
    path : of the file
    wanted : what the file does not say

    Raises
    ------
    InputError : a column is missing, a cell is no number, frame or particle is no integer, or one particle stands twice in a frame
    """
    columns, place = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    for name in ("frame", "particle"):
        wrong = ~(np.abs(columns[name]) < LARGEST) | (columns[name] != np.round(columns[name]))
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise InputError(path, f"{place(row)}, column {name}", f"{columns[name][row]:g}; an integer is expected")
    frame, particle = columns["frame"].astype(int), columns["particle"].astype(int)
    frames, row_of = np.unique(frame, return_inverse=True)
    ids, column_of = np.unique(particle, return_inverse=True)
    _, first = np.unique(row_of * len(ids) + column_of, return_index=True)
    if len(first) < len(frame):
        row = int(np.setdiff1d(np.arange(len(frame)), first)[0])
        raise InputError(path, place(row), f"particle {particle[row]} stands twice in frame {frame[row]}")

    def spread(values: Array) -> Array:
        full = np.full((len(frames), len(ids)), np.nan)
        full[row_of, column_of] = values
        return full

    named = next((names for names in ERRORS if all(name in columns for name in names)), None)
    sigma = None if named is None else np.stack([spread(columns[name]) for name in named], axis=-1)
    convention = wanted.convention()
    names = tuple(str(value) for value in ids)
    times = frame_times(path, frames, wanted.rate_hz)
    return Points(names, frames, times, spread(columns["x"]), spread(columns["y"]), convention, sigma)


def _csv(path: Path):
    sheet = read_sheet(path)
    present = {cell.strip().lower() for cell in sheet.header}
    wanted = [*NEEDED, *(name for pair in ERRORS for name in pair if name in present)]
    return {name: sheet.numbers(sheet.column(name)) for name in wanted}, lambda row: f"line {sheet.lines[row]}"


def _parquet(path: Path):
    table = read_table(path, NEEDED)
    columns: dict[str, Array] = {}
    for name in (*NEEDED, "ep_x", "ep_y", "ep"):
        if name in table:
            try:
                columns[name] = table[name].to_numpy(dtype=float, na_value=np.nan)
            except (TypeError, ValueError):
                raise InputError(path, f"column {name}", "holds something that is no number") from None
    return columns, lambda row: f"row {row + 1}"
