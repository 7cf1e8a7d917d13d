"""Delimited text of other programs: tab, semicolon, comma or blanks between cells; points or commas as decimals."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import TABLE_BYTES, read_bytes
from .convention import Array

LONGEST = 100_000
"""Letters of a line; a cell of more would be refused by the csv module."""
EMPTY = frozenset({"", "nan", "na", "n/a", "-"})
"""Cells, in lower case, that hold no value."""


@dataclass(frozen=True)
class Sheet:
    """A table as text.

    Attributes
    ----------
    path : where it came from
    header : names of its columns, as they stand
    rows : cells of each row, as many as the header has
    lines : line of each row in the file, from 1
    """

    path: Path
    header: list[str]
    rows: list[list[str]]
    lines: list[int]

    def column(self, name: str) -> int:
        """Index of the column called ``name`` (capitals count as small letters); InputError where it is absent."""
        folded = [cell.strip().lower() for cell in self.header]
        if name.lower() not in folded:
            found = ", ".join(cell.strip() for cell in self.header if cell.strip())
            raise InputError(self.path, f"column {name}", f"missing; found {found or 'none'}")
        return folded.index(name.lower())

    def numbers(self, index: int) -> Array:
        """A column as numbers, (n,); NaN where a cell is empty. InputError names line and column of what is no number."""
        name = self.header[index].strip() or str(index + 1)
        return np.array(
            [number(self.path, line, name, row[index]) for line, row in zip(self.lines, self.rows, strict=True)]
        )


def read_text(path: Path) -> list[str]:
    """Lines of a text file, UTF-8 or else Latin-1.

    Raises
    ------
    InputError : it is absent, empty, or no text
    """
    content = read_bytes(path, TABLE_BYTES)
    if b"\0" in content[:4096]:
        raise InputError(path, "", "is no text; a table as text is expected")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = text.splitlines()
    long = next((index for index, line in enumerate(lines) if len(line) > LONGEST), None)
    if long is not None:
        raise InputError(path, f"line {long + 1}", f"has {len(lines[long])} letters; no table does")
    if not any(line.strip() for line in lines):
        raise InputError(path, "", "is empty; a table is expected")
    return lines


def delimiter_of(line: str) -> str:
    """What stands between the cells of ``line``: tab, semicolon, comma, or blanks."""
    return next((mark for mark in "\t;," if mark in line), " ")


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of one line, quotes taken off.

    Parameters
    ----------
    line : of the file
    delimiter : between the cells
    """
    if delimiter == " ":
        return line.split()
    return next(csv.reader([line], delimiter=delimiter), [])


def sheet_of(path: Path, lines: list[str], start: int, header: list[str], delimiter: str) -> Sheet:
    """The rows below line ``start`` (from 0) under ``header``; empty lines and ``#`` lines are left out.

    Parameters
    ----------
    path : of the file
    lines : of the file
    start : line of the header, from 0
    header : its cells
    delimiter : between the cells

    Raises
    ------
    InputError : no row, or a row with more or fewer cells than the header
    """
    rows: list[list[str]] = []
    numbers: list[int] = []
    for index in range(start, len(lines)):
        line = lines[index]
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = cells_of(line, delimiter)
        while len(cells) > len(header) and not cells[-1].strip():
            cells.pop()
        if len(cells) != len(header):
            raise InputError(path, f"line {index + 1}", f"{len(cells)} cells; the header has {len(header)}")
        rows.append(cells)
        numbers.append(index + 1)
    if not rows:
        raise InputError(path, "", "holds a header and no row")
    return Sheet(path, header, rows, numbers)


def read_sheet(path: Path) -> Sheet:
    """A table whose first line (after ``#`` lines) is its header."""
    lines = read_text(path)
    start = next((i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    if start is None:
        raise InputError(path, "", "holds no header row")
    delimiter = delimiter_of(lines[start])
    return sheet_of(path, lines, start + 1, cells_of(lines[start], delimiter), delimiter)


def number(path: Path, line: int, column: str, cell: str) -> float:
    """One cell as a number; a comma is a decimal comma; NaN where the cell is empty.

    Parameters
    ----------
    path : of the file
    line : of the file
    column : its name, for messages
    cell : its text
    """
    text = cell.strip()
    if text.lower() in EMPTY:
        return math.nan
    try:
        if "," in text and ("." in text or text.count(",") > 1):
            raise ValueError
        value = float(text.replace(",", "."))
        if math.isinf(value):
            raise ValueError
    except ValueError:
        raise InputError(path, f"line {line}, column {column}", f"{cell!r} is not a finite number") from None
    return value
