"""Tracker (Open Source Physics): an exported table; names of the point masses above, then t, x, y, x, y, ...

x and y are world coordinates: from the origin of Tracker's axes, y upward, in its length unit (pixels where no calibration was
made). Tracker's image position starts at the picture's upper left corner, so the middle of the first pixel is 0.5. Columns
pixelx and pixely are that image position itself, y down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError
from .convention import Convention
from .points import Points, Wanted, frames_of_times
from .text import Sheet, cells_of, delimiter_of, read_text, sheet_of

PAIRS = (("pixelx", "pixely"), ("x", "y"))


def header_line(lines: list[str]) -> int | None:
    """Index of the line that holds t, x, y among the first few, or None."""
    for index, line in enumerate(lines[:20]):
        cells = [cell.strip().lower() for cell in cells_of(line, delimiter_of(line))]
        if "t" in cells and any(x in cells and y in cells for x, y in PAIRS):
            return index
    return None


def read_tracker(path: Path, wanted: Wanted) -> Points:
    """Read an exported table of one or more point masses.

    Parameters
    ----------
    path : of the file
    wanted : what the file does not say

    Raises
    ------
    InputError : no t, x, y; an x without its y; the axes' origin not said; times that do not rise; a cell that is no number
    """
    lines = read_text(path)
    start = header_line(lines)
    if start is None:
        raise InputError(path, "header", f"no line with t, x, y; found {lines[0][:60]!r}")
    delimiter = delimiter_of(lines[start])
    sheet = sheet_of(path, lines, start + 1, cells_of(lines[start], delimiter), delimiter)
    above = next((lines[i] for i in range(start - 1, -1, -1) if lines[i].strip()), "")
    names = _names(cells_of(above, delimiter if delimiter in above else delimiter_of(above)), len(sheet.header))
    found, pixels = _masses(sheet, names)
    t_s = sheet.numbers([cell.strip().lower() for cell in sheet.header].index("t"))
    if np.isnan(t_s).any():
        row = int(np.flatnonzero(np.isnan(t_s))[0])
        raise InputError(path, f"line {sheet.lines[row]}, column t", "is empty")
    frame, times = frames_of_times(path, t_s, wanted.rate_hz, sheet.lines)
    if pixels:
        convention = Convention(first_pixel=0.5 if wanted.first_pixel is None else wanted.first_pixel)
    else:
        if wanted.origin_px is None:
            raise InputError(
                path,
                "",
                "x and y count from the origin of Tracker's axes; its image position is needed (--origin X,Y; half the width "
                "and height where the axes were never moved)",
            )
        convention = wanted.convention(first_pixel=0.5, y_up=True)
    x, y = (np.stack([sheet.numbers(pair[axis]) for pair in found.values()], axis=1) for axis in (0, 1))
    return Points(tuple(found), frame, times, x, y, convention)


def _names(cells: list[str], count: int) -> list[str]:
    """The point mass of each column: a name holds until the next one."""
    said = [cell.strip().lstrip("#").strip() for cell in cells][:count]
    said += [""] * (count - len(said))
    if sum(bool(name) for name in said) == 1:
        return [next(name for name in said if name)] * count
    names, last = [], ""
    for name in said:
        last = name or last
        names.append(last)
    return names


def _masses(sheet: Sheet, names: list[str]) -> tuple[dict[str, tuple[int, int]], bool]:
    """Columns of x and y by point mass; whether they are image positions."""
    low = [cell.strip().lower() for cell in sheet.header]
    for x_name, y_name in PAIRS:
        found: dict[str, tuple[int, int]] = {}
        places = [index for index, cell in enumerate(low) if cell == x_name]
        for number, index in enumerate(places):
            end = places[number + 1] if number + 1 < len(places) else len(low)
            after = [i for i in range(index + 1, end) if low[i] == y_name]
            if not after:
                raise InputError(sheet.path, f"header, column {index + 1}", f"{x_name} without its {y_name}")
            name = names[index] or f"mass_{number + 1}"
            if name in found:
                raise InputError(sheet.path, f"header, column {index + 1}", f"point mass {name!r} stands twice")
            found[name] = (index, after[0])
        if found:
            return found, x_name == "pixelx"
    raise InputError(sheet.path, "header", "no x and y")
