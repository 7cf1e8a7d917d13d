"""Tables (tracks, motion, marks, histories) as pandas frames, CSV or Parquet, checked when read."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .files import TABLE_BYTES, read_text, reading, replacing

if TYPE_CHECKING:
    import pandas as pd

BY_HAND = "by_hand"
"""Status of a point that a person set in the tracks of a video (corrections.toml)."""
SEEN = ("measured", BY_HAND)
"""Statuses of a row of tracks whose place was seen, by the tracker or by a person."""
STATUS = ("measured", "predicted", "lost")
"""Of motion."""
TRACK_STATUS = ("measured", BY_HAND, "predicted", "lost")
TRACK_COLUMNS = ("frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status")
MARK_COLUMNS = ("t_s", "marker", "x_m", "y_m", "sigma_x_m", "sigma_y_m", "status")
MOTION_COLUMNS = ("t_s", "y_cg_m", "beta_rad", "alpha_rad")
FOUND_LETTERS, SHOWN_LETTERS = 300, 100
"""Of a bad line and of a bad cell, as many are shown in a message."""
CELL_BYTES = 8
"""Of a number in memory: float64."""
_FORMULA = re.compile(r"(^|[;\t\r\n])(?='*[=+\-@\t\r\uff1d\uff0b\uff0d\uff20])")
_NO_FORMULA = re.compile(r"(^|[;\t\r\n])'(?='*[=+\-@\t\r\uff1d\uff0b\uff0d\uff20])")
_HASH_PREFIX = "# inputs sha256 "
_NOTE_PREFIX = "# note: "
_HASH_LETTERS, _NOTE_LETTERS = 200, 4000
"""The first line of a table, where its hash stands, is no longer."""


def read_table(path: str | Path, needed: tuple[str, ...]) -> pd.DataFrame:
    """Read a CSV (comma, header row, UTF-8, ``#`` comments before the header) or a Parquet file.

    Parameters
    ----------
    path : of the file
    needed : columns that must be there

    Raises
    ------
    InputError : missing or empty file, no header, a needed column absent, or a value that is no number (row named).
    """
    path = Path(path)
    try:
        if path.suffix == ".parquet":
            table = _read_parquet(path)
        else:
            table = _read_csv(path)
    except InputError:
        raise
    except (OSError, ValueError, csv.Error) as error:  # pandas and pyarrow raise their own ValueErrors
        raise InputError(path, "", f"cannot be read as a table ({_first_line(error)})") from None
    missing = [name for name in needed if name not in table.columns]
    if missing:
        found = ", ".join(" ".join(str(c).split()) for c in table.columns)
        found = found if len(found) <= FOUND_LETTERS else found[:FOUND_LETTERS] + "..."
        raise InputError(path, f"column {missing[0]}", f"missing; found {found or 'none'}")
    return table


def _read_csv(path: Path) -> pd.DataFrame:
    import pandas as pd

    text = read_text(path, TABLE_BYTES)
    lines = text.splitlines(keepends=True)
    skip = 0
    while skip < len(lines) and (lines[skip].startswith("#") or not lines[skip].strip()):
        skip += 1
    if skip == len(lines):
        raise InputError(path, "", "is empty; a header row is expected")
    if skip + 1 < len(lines):  # pandas would take the first column for names of rows
        head, first = (len(next(csv.reader([line.strip("\r\n")]), [])) for line in lines[skip : skip + 2])
        if first > head:
            raise InputError(path, "row 1", f"{first} cells; the header has {head}")
    return _texts_changed(pd.read_csv(io.StringIO("".join(lines[skip:])), skip_blank_lines=False), as_meant)


def _read_parquet(path: Path) -> pd.DataFrame:
    import pyarrow.parquet as parquet

    try:
        with reading(path, TABLE_BYTES) as stream:
            file = parquet.ParquetFile(stream)
            rows, columns = file.metadata.num_rows, file.metadata.num_columns
            if CELL_BYTES * rows * max(columns, 1) > TABLE_BYTES:  # repeated values take no room in the file
                raise InputError(path, "", f"holds {rows} rows of {columns} columns; no table here is so long")
            return file.read().to_pandas().reset_index(drop=True)
    except (OSError, InputError, MemoryError):
        raise
    except Exception as error:  # of damaged bytes and damaged descriptions in them: whatever came of it
        raise ValueError(_first_line(error)) from None


def _first_line(error: Exception) -> str:
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__


def write_table(
    path: str | Path, table: pd.DataFrame, input_hash: str | None = None, notes: Sequence[str] = ()
) -> None:
    """Write CSV or Parquet (by the suffix) atomically; ``input_hash`` and ``notes`` go into comment lines before the header.

    Parameters
    ----------
    path : of the file
    table : what is written
    input_hash : what it was made from
    notes : for the user
    """
    path = Path(path)
    with replacing(path) as temporary:
        if path.suffix == ".parquet":
            with temporary.open("wb") as stream:
                table.to_parquet(stream, index=False)
            return
        with open(temporary, "w", encoding="utf-8", newline="") as stream:
            if input_hash is not None:
                stream.write(f"{_HASH_PREFIX}{input_hash}\n")
            stream.writelines(f"{_NOTE_PREFIX}{' '.join(note.split())}\n" for note in notes)
            for_people(table).to_csv(stream, index=False, float_format="%.10g", lineterminator="\n")


def no_formula(text: str) -> str:
    """``text`` as a cell that no spreadsheet calculates: a ' before =, +, -, @, tab or CR at its start, or behind a semicolon, tab
    or line end within it (a cell of its own where semicolons part them).
    """
    return _FORMULA.sub(r"\1'", text)


def as_meant(text: str) -> str:
    """What ``no_formula`` was given."""
    return _NO_FORMULA.sub(r"\1", text)


def for_people(table: pd.DataFrame) -> pd.DataFrame:
    """A table for a CSV that a spreadsheet may open: texts, and names of columns, by ``no_formula``; numbers as they are."""
    return _texts_changed(table, no_formula).rename(columns=lambda name: no_formula(str(name)))


def _texts_changed(table: pd.DataFrame, change: Callable[[str], str]) -> pd.DataFrame:
    new = {}
    for name in table.columns:
        if table[name].dtype.kind not in "biufcmM":
            texts = (value for value in table[name].unique() if isinstance(value, str))
            other = {text: change(text) for text in texts if change(text) != text}
            if other:
                new[name] = table[name].map(lambda value, other=other: other.get(value, value))
    return table.assign(**new) if new else table


def input_hash_of(path: str | Path) -> str | None:
    """The hash that ``write_table`` put into a CSV, or None."""
    try:
        with reading(path) as stream:
            first = stream.readline(_HASH_LETTERS).decode("ascii")
    except (OSError, UnicodeDecodeError, InputError):
        return None
    return first.removeprefix(_HASH_PREFIX).strip() if first.startswith(_HASH_PREFIX) else None


def notes_of(path: str | Path) -> tuple[str, ...]:
    """The notes that ``write_table`` put into a CSV.

    Parameters
    ----------
    path : of the file
    """
    notes = []
    try:
        with reading(path) as stream:
            while (line := stream.readline(_NOTE_LETTERS)).startswith(b"#"):
                text = line.decode("utf-8", "replace")
                if text.startswith(_NOTE_PREFIX):
                    notes.append(text.removeprefix(_NOTE_PREFIX).strip())
    except (OSError, InputError):
        return ()
    return tuple(notes)


def read_tracks(path: str | Path) -> pd.DataFrame:
    """Read pixel tracks: ``frame, t_s, marker, u_px, v_px`` and optionally sigmas and status.

    A point without u or v is ``lost``. Times rise strictly per marker, and the rows of one frame share their time.

    Parameters
    ----------
    path : of the file
    """
    table = read_table(path, ("frame", "t_s", "marker", "u_px", "v_px")).copy()
    _numbers(path, table, ("frame", "t_s", "u_px", "v_px"))
    for name in ("sigma_u_px", "sigma_v_px"):
        if name in table:
            _numbers(path, table, (name,))
        else:
            table[name] = np.nan
    if "status" not in table:
        table["status"] = "measured"
    _known_status(path, table, TRACK_STATUS)
    absent = table[["u_px", "v_px"]].isna().any(axis=1)
    table.loc[absent, "status"] = "lost"
    _no_gap(path, table, ("frame", "t_s"))
    _named(path, table)
    table["marker"] = table["marker"].astype(str)
    for marker, rows in table.groupby("marker", sort=False):
        _rising(path, rows["t_s"], f"of marker {marker!r}")
    shared = table.groupby("frame")["t_s"].agg(["min", "max"])
    apart = shared.index[shared["min"] != shared["max"]]
    if len(apart):
        row = int(np.flatnonzero((table["frame"] == apart[0]).to_numpy())[-1])
        raise InputError(path, _row(row), f"frame {apart[0]:g} stands at two times; its rows must share one t_s")
    return table


def seen_rows(table: pd.DataFrame) -> NDArray[np.bool_]:
    """(n,) rows of tracks whose mark was seen: measured, or set by hand.

    Parameters
    ----------
    table : tracks table
    """
    return table["status"].isin(SEEN).to_numpy()


def read_motion(path: str | Path) -> pd.DataFrame:
    """Read motion: ``t_s, y_cg_m, beta_rad`` and optionally alpha_rad, x_cg_m, tension_n, sigmas, status.

    Parameters
    ----------
    path : of the file
    """
    table = read_table(path, ("t_s", "y_cg_m", "beta_rad")).copy()
    for name in ("alpha_rad", "x_cg_m"):
        if name not in table:
            table[name] = np.nan
    numeric = [c for c in table.columns if c.startswith(("t_s", "y_cg", "x_cg", "beta", "alpha", "sigma_", "tension"))]
    _numbers(path, table, tuple(numeric))
    _no_gap(path, table, ("t_s",))
    _rising(path, table["t_s"], "")
    if "status" not in table:
        table["status"] = "measured"
    _known_status(path, table)
    table.loc[table[["y_cg_m", "beta_rad"]].isna().any(axis=1), "status"] = "lost"
    return table


def read_history(path: str | Path, column: str) -> pd.DataFrame:
    """Read a history (``t_s`` and one ``column``) on its own clock; times rise strictly, no value is missing.

    Parameters
    ----------
    path : of the file
    column : its name
    """
    table = read_table(path, ("t_s", column)).copy()
    _numbers(path, table, ("t_s", column))
    _no_gap(path, table, ("t_s", column))
    _rising(path, table["t_s"], "")
    if len(table) < 2:
        raise InputError(path, "", f"{len(table)} rows; a history needs at least 2")
    return table


def _numbers(path: str | Path, table: pd.DataFrame, names: tuple[str, ...]) -> None:
    for name in names:
        numbers = numbers_of(table[name])
        wrong = (np.isnan(numbers) & table[name].notna().to_numpy()) | np.isinf(numbers)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            shown = repr(table[name].iloc[row])
            shown = shown if len(shown) <= SHOWN_LETTERS else shown[:SHOWN_LETTERS] + "..."
            raise InputError(path, f"{_row(row)}, {name}", f"{shown} is not a finite number")
        table[name] = numbers


def numbers_of(column: pd.Series) -> NDArray[np.float64]:
    """A column as floats; NaN where a cell is empty or no number."""
    import pandas as pd

    if isinstance(column.dtype, pd.CategoricalDtype) or column.dtype.kind in "mM":
        return np.full(len(column), np.nan)  # a date is no number of seconds
    try:
        return pd.to_numeric(column, errors="coerce").to_numpy(dtype=float, na_value=np.nan)
    except (TypeError, ValueError, OverflowError):  # bytes, lists, whole numbers of hundreds of digits
        return np.array([_number_or_nan(value) for value in column], dtype=float)


def _number_or_nan(value: object) -> float:
    try:
        return float(value) if isinstance(value, (int, float, str)) else math.nan
    except (ValueError, OverflowError):
        return math.nan


def _known_status(path: str | Path, table: pd.DataFrame, known: tuple[str, ...] = STATUS) -> None:
    import pandas as pd

    found = table["status"]
    if isinstance(found.dtype, pd.StringDtype):
        unknown = ~found.isin(known).to_numpy(dtype=bool)
    else:
        unknown = np.array([not (isinstance(status, str) and status in known) for status in found], dtype=bool)
    if unknown.any():
        row = int(np.flatnonzero(unknown)[0])
        raise InputError(path, _row(row), f"status {found.iloc[row]!r}; expected {', '.join(known)}")
    table["status"] = found.astype(str)


def _named(path: str | Path, table: pd.DataFrame) -> None:
    nameless = np.array(
        [not isinstance(m, (list, dict, np.ndarray)) and not str(m).strip() for m in table["marker"]], dtype=bool
    )
    nameless |= table["marker"].isna().to_numpy()
    if nameless.any():
        raise InputError(path, f"{_row(int(np.flatnonzero(nameless)[0]))}, marker", "is empty")


def _no_gap(path: str | Path, table: pd.DataFrame, names: tuple[str, ...]) -> None:
    for name in names:
        gaps = table[name].isna().to_numpy()
        if gaps.any():
            raise InputError(path, f"{_row(int(np.flatnonzero(gaps)[0]))}, {name}", "is empty")
    if table.empty:
        raise InputError(path, "", "holds no row")


def first_fall(times: NDArray[Any]) -> int | None:
    """Place of the first time that does not rise beyond the one before it; None: all do.

    Parameters
    ----------
    times : (n,)
    """
    falls = np.flatnonzero(~(np.diff(times) > 0))
    return int(falls[0]) + 1 if len(falls) else None


def _rising(path: str | Path, times: pd.Series, whose: str) -> None:
    index = first_fall(times.to_numpy())
    if index is not None:
        row = int(times.index[index])
        before, here = times.iloc[index - 1], times.iloc[index]
        word = "repeats" if here == before else "falls"
        detail = f"{here:g} after {before:g}; times must rise strictly {whose}".rstrip()
        raise InputError(path, f"{_row(row)}, t_s", f"{word}: {detail}")


def _row(index: int) -> str:
    return f"row {index + 1}"
