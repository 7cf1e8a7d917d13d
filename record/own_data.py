"""Records for a model of one's own: a table (CSV, Parquet, MAT, messages) and data.toml, which says what its columns are."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .bags import Meant, bag_columns, is_bag
from .errors import InputError
from .files import TABLE_BYTES, read_bytes
from .schema import Number, Positive, Span
from .tables import numbers_of, read_table
from .toml import Table, read_toml

DATA_FILE = "data.toml"
"""Beside the tables; a table NAME.csv that differs may have its own NAME.toml."""
Array = NDArray[np.float64]


class OwnClock(Table):
    """[clock]: when each row was taken."""

    column: str = Field(
        default="",
        description="column of the time (of messages: log_time, or header.stamp); empty: rows come at rate_hz",
    )
    unit: str = Field(default="s", description="of that column: s, ms, min, ...")
    rate_hz: Positive | None = Field(default=None, description="rows per second, where no column has the time")

    @model_validator(mode="after")
    def _one(self) -> OwnClock:
        if bool(self.column) == (self.rate_hz is not None):
            raise ValueError("column or rate_hz, one of the two")
        return self


class OwnColumn(Table):
    """[[column]]: what a column of the tables is."""

    name: str = Field(description="the column's header; of a recording of messages topic and field: /joint.position[1]")
    role: Literal["input", "output"] = Field(description="what the model is given, or what it must explain")
    of: str = Field(default="", description="name of that input or output in the model; empty: the column's own")
    unit: str | None = Field(default=None, description="of the column; absent: the model's own")
    noise_sd: Positive | None = Field(
        default=None, description="of an output: standard deviation of one sample, in the column's unit"
    )
    hold: Literal["linear", "step"] = Field(
        default="linear", description="of an input between samples: straight to the next, or as it was (a command)"
    )


class OwnNumber(Table):
    """[[number]]: what these records say of a number of the model, instead of what the model says."""

    name: str = Field(description="of the number (an FMU: of its parameter)")
    unit: str | None = Field(default=None, description="of what stands here; absent: the model's own")
    start: Number | None = Field(default=None, description="where its fit begins")
    size: Positive | None = Field(default=None, description="how large it usually is")
    least: Number | None = Field(default=None, description="lower bound")
    most: Number | None = Field(default=None, description="upper bound")
    sd: Positive | None = Field(
        default=None, description="prior standard deviation about start; absent: the data alone decide"
    )
    known: bool | None = Field(default=None, description="true: it is not fitted")


class OwnState(Table):
    """[[state]]: the same of a state's start."""

    name: str = Field(description="of the state")
    start: Number | None = Field(
        default=None, description="value at the first row, in the model's unit, where it is not measured"
    )
    known: bool | None = Field(default=None, description="true: it is exactly that; else each run's is fitted")
    size: Positive | None = Field(default=None, description="how large it usually is")


class OwnStage(Table):
    """[[stage]]: what a place is called in the answer."""

    name: str = Field(description="of an input, an output, or a state (its equation)")
    stage: str = Field(description="what it is called")


class OwnNext(Table):
    """[[next]]: what could be done in the next record, to tell what is still open."""

    input: str = Field(default="", description="name of an input of the model that can be moved as one likes")
    state: str = Field(default="", description="or of a state that can be begun where one likes")
    unit: str | None = Field(default=None, description="of what stands here; absent: the model's own")
    amplitude: Span | None = Field(default=None, description="of an input: smallest and largest of a sine or a sweep")
    frequency_hz: Span | None = Field(default=None, description="of an input: slowest and fastest of it")
    offset: Number = Field(
        default=0.0, description="of an input: about which it moves, and where it rests while others move"
    )
    range: Span | None = Field(default=None, description="of a state: smallest and largest value at first")

    @model_validator(mode="after")
    def _one(self) -> OwnNext:
        if bool(self.input) == bool(self.state):
            raise ValueError("input or state, one of the two")
        wanted = (
            {"amplitude": self.amplitude, "frequency_hz": self.frequency_hz} if self.input else {"range": self.range}
        )
        for key, span in wanted.items():
            if span is None:
                raise ValueError(f"{key}: missing; two numbers are expected")
            if not span[0] <= span[1] or (self.input and span[0] <= 0):
                raise ValueError(
                    f"{key}: {span[0]:g}, {span[1]:g}: the smaller first{', above 0' if self.input else ''}"
                )
        return self


class OwnData(Table):
    """data.toml."""

    clock: OwnClock = Field(description="when each row was taken")
    column: tuple[OwnColumn, ...] = Field(description="what a column is; others are left out")
    number: tuple[OwnNumber, ...] = Field(default=(), description="numbers of the model")
    state: tuple[OwnState, ...] = Field(default=(), description="starts of its states")
    stage: tuple[OwnStage, ...] = Field(default=(), description="names of stages, of an FMU say")
    next: tuple[OwnNext, ...] = Field(default=(), description="what could be done next")
    static: str = Field(
        default="",
        description="table of the same columns with everything at rest: its scatter is the noise, where no noise_sd is given",
    )


def read_data_file(table: Path, given: Path | None) -> tuple[Path, OwnData]:
    """Of a table: the file that is given, else NAME.toml, else data.toml beside it.

    Parameters
    ----------
    table : a table of records
    given : the file, or None

    Raises
    ------
    InputError : there is none, or it is wrong
    """
    own, common = table.with_suffix(".toml"), table.with_name(DATA_FILE)
    path = given or (own if own.is_file() else common)
    if not path.is_file():
        raise InputError(path, "", f"no such file; it says what the columns of {table.name} are (docs/gap.md)")
    file = read_toml(path, OwnData)
    if not any(c.role == "output" for c in file.column):
        raise InputError(path, "column", 'none has role = "output": something must be measured')
    return path, file


def read_columns(path: Path, names: tuple[str, ...], file: OwnData) -> dict[str, Array]:
    """Columns of a table as numbers.

    Parameters
    ----------
    path : CSV, Parquet, MAT (vectors of one length), or a recording of messages (``bags``)
    names : of the columns
    file : says what they are, of messages that come at times of their own

    Returns
    -------
    columns : name -> (n,); NaN where a cell is empty

    Raises
    ------
    InputError : it cannot be read, has no row, or not these columns
    """
    if is_bag(path):
        told = {c.name: c for c in file.column}
        clock = file.clock.column if file.clock.column in names else ""
        return bag_columns(path, {n: _meant(told[n]) for n in names if n != clock}, clock)
    if path.suffix.lower() == ".mat":
        return _mat_columns(path, names)
    table = read_table(path, names)
    if not len(table):
        raise InputError(path, "", "holds no row")
    return {name: _of_numbers(path, name, table[name]) for name in names}


def _meant(column: OwnColumn) -> Meant:
    return "output" if column.role == "output" else column.hold


def _of_numbers(path: Path, name: str, column: Any) -> Array:
    found = numbers_of(column)
    wrong = np.flatnonzero(np.isnan(found) & ~np.asarray(column.isna()))
    if len(wrong):
        raise InputError(path, f"column {name}", f"row {wrong[0] + 1}: {column.iloc[wrong[0]]!r} is no number")
    return found


def _mat_columns(path: Path, names: tuple[str, ...]) -> dict[str, Array]:
    import io

    from scipy.io import loadmat

    content = read_bytes(path, TABLE_BYTES)
    try:
        found = loadmat(io.BytesIO(content))
    except NotImplementedError:
        raise InputError(path, "", "is a MAT file of version 7.3; save it with -v7") from None
    except Exception as error:  # whatever damaged bytes bring about
        raise InputError(path, "", f"cannot be read as a MAT file ({type(error).__name__})") from None
    there = [name for name in found if not name.startswith("__")]
    columns: dict[str, Array] = {}
    for name in names:
        if name not in there:
            raise InputError(path, f"column {name}", f"missing; found {', '.join(there) or 'none'}")
        try:
            columns[name] = np.asarray(found[name], dtype=float).ravel()
        except (TypeError, ValueError):
            raise InputError(path, f"column {name}", "holds no numbers") from None
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(path, "", f"vectors of different lengths: {', '.join(f'{k} {v}' for k, v in lengths.items())}")
    if not next(iter(lengths.values()), 0):
        raise InputError(path, "", "holds no row")
    return columns


__all__ = [
    "DATA_FILE",
    "OwnClock",
    "OwnColumn",
    "OwnData",
    "OwnNext",
    "OwnNumber",
    "OwnStage",
    "OwnState",
    "read_columns",
    "read_data_file",
]
