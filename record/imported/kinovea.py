"""Kinovea: its CSV (one table, a pair of columns per point), its text export (a block per trajectory), its own KVA (XML).

CSV and text hold coordinates in Kinovea's axes, y upward, decimals with a point or a comma as the user's settings have it, and
times in a unit that the file may not say. KVA holds the points in pixels of the picture, y down, beside the time stamp.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from ..errors import InputError
from .convention import Array, Convention
from .points import LARGEST, Points, Wanted, frames_of_times
from .text import number, read_sheet, read_text

TIMECODE = re.compile(r"^(?:(\d{1,6}):)?(\d{1,6}):(\d{1,6})[:.,](\d{1,9})$")
PAIR = re.compile(r"^(?P<name>.*?)[/ _]?(?P<axis>[xy])(?:\s*\(.*\))?$", re.IGNORECASE)
UNITS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "us": 1e-6}
"""Seconds to the unit that a Kinovea file names."""
NEAR = 0.2
"""A time unit fits a frame rate where the usual step is one frame to within this share."""
LATE = "time unit taken as {}: the usual step is then one frame"


def read_kinovea(path: Path, wanted: Wanted) -> Points:
    """Read any of Kinovea's three.

    Parameters
    ----------
    path : of the file
    wanted : what the file does not say

    Raises
    ------
    InputError : another file, a spreadsheet, no trajectory, a cell that is no number, no unit of time and no rate
    """
    lines = read_text(path)
    first = next(line.strip() for line in lines if line.strip())
    if first.startswith("<"):
        return _kva(path, "\n".join(lines), wanted)
    return _blocks(path, lines, wanted) if first.startswith("#") else _table(path, wanted)


def _axes(path: Path, wanted: Wanted) -> Convention:
    if wanted.origin_px is None:
        raise InputError(
            path,
            "",
            "x and y count from the origin of Kinovea's axes; its place in the picture is needed (--origin X,Y; 0,HEIGHT for the "
            "lower left corner)",
        )
    return wanted.convention(y_up=True)


def _table(path: Path, wanted: Wanted) -> Points:
    sheet = read_sheet(path)
    if not sheet.header[0].strip().lower().startswith(("time", "t")):
        raise InputError(path, "header", f"the first column is {sheet.header[0]!r}; Time is expected")
    pairs: dict[str, dict[str, int]] = {}
    for index, cell in enumerate(sheet.header[1:], start=1):
        match = PAIR.match(cell.strip())
        if not match:
            raise InputError(path, f"header, column {index + 1}", f"{cell!r} is no x or y of a point")
        pairs.setdefault(match["name"].strip() or "1", {})[match["axis"].lower()] = index
    for name, axes in pairs.items():
        if set(axes) != {"x", "y"}:
            raise InputError(path, "header", f"point {name!r} has {' and '.join(axes)}; x and y are expected")
    raw, coded = _times(path, [(line, row[0]) for line, row in zip(sheet.lines, sheet.rows, strict=True)])
    unit = re.search(r"\((\w+)\)", sheet.header[0])
    t_s, notes = _seconds(path, raw, coded, unit[1].lower() if unit else None, wanted.rate_hz)
    frame, times = frames_of_times(path, t_s, wanted.rate_hz, sheet.lines)
    x, y = (np.stack([sheet.numbers(axes[axis]) for axes in pairs.values()], axis=1) for axis in "xy")
    return Points(_short(list(pairs)), frame, times, x, y, _axes(path, wanted), notes=notes)


def _short(names: list[str]) -> tuple[str, ...]:
    """``Trajectory 1/0`` -> ``Trajectory 1`` where that stays unique."""
    heads = [name.partition("/")[0] for name in names]
    return tuple(heads if len(set(heads)) == len(names) else names)


def _blocks(path: Path, lines: list[str], wanted: Wanted) -> Points:
    tracks: dict[str, list[tuple[int, list[str]]]] = {}
    name, fresh = "", True
    for index, line in enumerate(lines):
        text = line.strip()
        if not text:
            fresh = True
        elif text.startswith("#"):
            name, fresh = text[1:].strip(), True
        else:
            cells = text.split()
            if len(cells) != 3:
                raise InputError(path, f"line {index + 1}", f"{len(cells)} cells; time, x and y are expected")
            if fresh:
                own = bool(name) and not name.lower().startswith(("kinovea", "t x y"))
                label = name if own and name not in tracks else str(len(tracks) + 1)
                tracks[label], name, fresh = [], "", False
            tracks[next(reversed(tracks))].append((index + 1, cells))
    if not tracks:
        raise InputError(path, "", "holds no trajectory")
    rows = [(line, cells, label) for label, block in tracks.items() for line, cells in block]
    raw, coded = _times(path, [(line, cells[0]) for line, cells, _ in rows])
    moments, first, place = np.unique(raw, return_index=True, return_inverse=True)
    x, y = np.full((2, len(moments), len(tracks)), np.nan)
    labels = list(tracks)
    for row, (line, cells, label) in enumerate(rows):
        column = labels.index(label)
        if np.isfinite(x[place[row], column]):
            raise InputError(path, f"line {line}, column T", f"{cells[0]} stands twice in {label!r}")
        x[place[row], column] = number(path, line, "X", cells[1])
        y[place[row], column] = number(path, line, "Y", cells[2])
    t_s, notes = _seconds(path, moments, coded, None, wanted.rate_hz)
    frame, times = frames_of_times(path, t_s, wanted.rate_hz, [rows[i][0] for i in first])
    return Points(tuple(labels), frame, times, x, y, _axes(path, wanted), notes=notes)


def _times(path: Path, cells: list[tuple[int, str]]) -> tuple[Array, bool]:
    """Times as numbers; True where they were h:mm:ss:cc, which are seconds."""
    if ":" not in cells[0][1]:
        values = np.array([number(path, line, "Time", cell) for line, cell in cells])
        if np.isnan(values).any():
            raise InputError(
                path, f"line {cells[int(np.flatnonzero(np.isnan(values))[0])][0]}, column Time", "is empty"
            )
        return values, False
    found = []
    for line, cell in cells:
        match = TIMECODE.match(cell.strip())
        if not match:
            raise InputError(path, f"line {line}, column Time", f"{cell!r} is no time such as 0:00:01:04")
        hours, minutes, seconds, part = match.groups()
        found.append(3600 * int(hours or 0) + 60 * int(minutes) + int(seconds) + int(part) / 10 ** len(part))
    return np.array(found), True


def _seconds(
    path: Path, raw: Array, coded: bool, unit: str | None, rate_hz: float | None
) -> tuple[Array, tuple[str, ...]]:
    """Times in s; without a stated unit the one that makes the usual step one frame."""
    if coded:
        return raw, ()
    if unit in UNITS:
        return raw * UNITS[unit], ()
    if rate_hz is None:
        raise InputError(path, "column Time", "states no unit; the frame rate is needed to tell it (--rate HZ)")
    step = float(np.median(np.diff(raw))) if len(raw) > 1 else 1 / rate_hz
    for name, factor in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("frames", 1 / rate_hz)):
        if abs(step * factor * rate_hz - 1) < NEAR:
            return raw * factor, (LATE.format(name),)
    raise InputError(
        path, "column Time", f"steps of {step:g} are one frame at {rate_hz:g} Hz in none of s, ms, µs and frames"
    )


def _kva(path: Path, text: str, wanted: Wanted) -> Points:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(path, "", "declares entities; Kinovea's own files do not")
    try:
        root = ElementTree.fromstring(text.encode("utf-8"))
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: it names an encoding that is none
        raise InputError(path, "", f"is no XML ({error})") from None
    if root.tag != "KinoveaVideoAnalysis":
        raise InputError(path, root.tag.rpartition("}")[2], "is not Kinovea's KVA; KVA, CSV or text is expected")
    tick = _setting(path, root, "AverageTimeStampsPerFrame", "1")
    start = _setting(path, root, "FirstTimeStamp", "0")
    rate = wanted.rate_hz or _setting(path, root, "CaptureFramerate", "0") or _setting(path, root, "UserFramerate", "0")
    if not tick > 0:
        raise InputError(path, "AverageTimeStampsPerFrame", f"{tick:g}; a number above 0 is expected")
    if not rate > 0:
        raise InputError(path, "CaptureFramerate", "states no frame rate (--rate HZ)")
    tracks: dict[str, dict[int, tuple[float, float]]] = {}
    for count, track in enumerate(root.iter("Track"), start=1):
        label = track.find("MainLabel")
        name = track.get("name") or (label.get("Text") if label is not None else None) or str(count)
        name = name if name not in tracks else f"{name} {count}"
        points = tracks.setdefault(name, {})
        for row, point in enumerate(track.iter("TrackPoint"), start=1):
            where = f"track {name!r}, point {row}"
            cells = (point.text or "").split(";")
            if len(cells) != 3:
                raise InputError(path, where, f"{point.text!r}; x;y;time is expected")
            x, y, stamp = (_plain(path, where, cell) for cell in cells)
            if not abs(stamp - start) < LARGEST * min(tick, 1.0):
                raise InputError(path, where, f"{stamp:g} is no time stamp of a recording")
            frame = round((stamp - start) / tick)
            if frame in points:
                raise InputError(path, where, f"frame {frame} stands twice")
            points[frame] = (x, y)
    if not any(tracks.values()):
        raise InputError(path, "Tracks", "holds no trajectory")
    frames = np.array(sorted({frame for points in tracks.values() for frame in points}))
    x, y = np.full((2, len(frames), len(tracks)), np.nan)
    for column, points in enumerate(tracks.values()):
        for frame, (right, down) in points.items():
            row = int(np.searchsorted(frames, frame))
            x[row, column], y[row, column] = right, down
    convention = Convention(first_pixel=wanted.first_pixel or 0.0)
    return Points(tuple(tracks), frames, frames / rate, x, y, convention)


def _plain(path: Path, where: str, cell: str) -> float:
    try:
        value = float(cell.strip().replace(",", "."))
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(path, where, f"{cell!r} is not a finite number")
    return value


def _setting(path: Path, root: ElementTree.Element, name: str, default: str) -> float:
    return _plain(path, name, root.findtext(name, default))
