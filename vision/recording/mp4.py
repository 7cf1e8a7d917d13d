"""What an mp4's index says twice: its tables must agree with each other.

A flipped bit in an index gives times that look like any others; only contradictions show it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

_BOXES_WITHIN = (b"trak", b"edts", b"mdia", b"minf", b"stbl")
_LARGEST_INDEX_BYTES = 1 << 28
"""256 MiB: a `moov` box stated to be larger is not read; hours of film have a few MiB."""
_MOST_BOXES = 1 << 18
"""Beside the index: fragments bring two each, one or more a second."""
STEPS_APART = 1.5
"""Stated length and sum of the frame times may differ by so many frames (encoders count the last one differently)."""
MOST_FRAMES = 1 << 24
"""An index of more (a week of film) is not spread out frame by frame: a bound on memory."""
CUT_FRAMES = 3
"""An edit list that leaves more frames out cuts the recording; stated lengths differ by up to the delay of B frames."""
LENGTHS_APART = 1e-3
"""An edit list counts in coarser ticks than the frames."""


@dataclass(frozen=True)
class IndexDoubt:
    """Where the tables of a video track contradict each other.

    Attributes
    ----------
    words : for the user
    cuts : the edit list leaves a part of the track out, and does not only undo the delay of B frames
    """

    words: str
    cuts: bool = False


def contradiction(path: str | Path) -> IndexDoubt | None:
    """Where the tables of the first video track contradict each other; None if nowhere, or if there is no such track."""
    with Path(path).open("rb") as file:
        index = _index_of(file)
    if index is None:
        return None
    for track in _children(index, b"trak"):
        try:
            found = dict(_tables(track))
        except RecursionError:
            return IndexDoubt("its boxes stand too deep in one another")
        if found.get(b"hdlr", b"")[8:12] == b"vide":
            found.update((name, box) for name, box in _boxes(index) if name == b"mvhd")
            try:
                words = _contradiction(found)
            except IndexError:
                words = "a table is cut short"
            return None if words is None else IndexDoubt(words, _cuts(found))
    return None


def _index_of(file: BinaryIO) -> bytes | None:
    """The moov box; None where there is none, or where fragments follow it (they bring tables of their own)."""
    end = file.seek(0, 2)
    at = 0
    for _ in range(_MOST_BOXES):
        if at + 8 > end:
            break
        file.seek(at)
        head = file.read(16)
        size = int.from_bytes(head[:4], "big")
        if size == 1:
            size = int.from_bytes(head[8:16], "big")
        elif size == 0:
            size = end - at
        if head[4:8] == b"moov" and size < _LARGEST_INDEX_BYTES:
            file.seek(at + 8)
            index = file.read(size - 8)
            return None if any(_children(index, b"mvex")) else index
        if size < 8:
            return None
        at += size
    return None


def _children(data: bytes, kind: bytes) -> Iterator[bytes]:
    return (content for name, content in _boxes(data) if name == kind)


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        if size < 8:
            return
        yield data[at + 4 : at + 8], data[at + 8 : at + size]
        at += size


def _tables(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    for name, content in _boxes(data):
        if name in _BOXES_WITHIN:
            yield from _tables(content)
        else:
            yield name, content


def _rows(tables: dict[bytes, bytes], name: bytes, columns: int) -> NDArray[np.int64] | None:
    """A table of 32-bit numbers, (n, columns); IndexError where it is cut short."""
    table = tables.get(name)
    if table is None:
        return None
    count = int.from_bytes(table[4:8], "big")
    if 8 + 4 * columns * count > len(table):
        raise IndexError(name)
    return np.frombuffer(table, ">u4", columns * count, 8).reshape(-1, columns).astype(np.int64)


def _contradiction(tables: dict[bytes, bytes]) -> str | None:
    sizes = tables.get(b"stsz") or tables.get(b"stz2")
    steps = _rows(tables, b"stts", 2)
    if sizes is None or steps is None:
        return None
    frames = int.from_bytes(sizes[8:12], "big")
    shifts = _rows(tables, b"ctts", 2)
    return (
        _counts(tables, frames, steps, shifts)
        or _matrices(tables)
        or _shifts(steps, shifts)
        or (_lengths(tables, frames, steps, shifts) if frames else None)
    )


def _counts(
    tables: dict[bytes, bytes], frames: int, steps: NDArray[np.int64], shifts: NDArray[np.int64] | None
) -> str | None:
    """Every table is about the same number of frames."""
    found = {"stts": int(steps[:, 0].sum())}
    if shifts is not None:
        found["ctts"] = int(shifts[:, 0].sum())
    runs, places = _rows(tables, b"stsc", 3), tables.get(b"stco") or tables.get(b"co64")
    if runs is not None and len(runs) and places is not None:
        chunks = int.from_bytes(places[4:8], "big")
        found["stsc"] = int((np.diff(runs[:, 0], append=chunks + 1) * runs[:, 1]).sum())
    for name, count in found.items():
        if count != frames:
            return f"{name} is about {count} frames, stsz about {frames}"
    return None


def _matrices(tables: dict[bytes, bytes]) -> str | None:
    for name, at in ((b"mvhd", 36), (b"tkhd", 40)):
        wide = 12 if tables.get(name, b"\0")[:1] == b"\1" else 0
        matrix = np.frombuffer(tables.get(name, b"")[at + wide :][:20], ">i4").astype(float)
        if len(matrix) == 5 and matrix[0] * matrix[4] == matrix[1] * matrix[3]:
            return f"the matrix of {name.decode()} puts no picture upright"
    return None


def _shifts(steps: NDArray[np.int64], shifts: NDArray[np.int64] | None) -> str | None:
    """Frames decoded at an even beat are shown at the same one."""
    if shifts is None or not len(shifts) or len(steps) != 1 or steps[0, 1] <= 0:
        return None
    relative = shifts[:, 1] - shifts[0, 1]
    if 2 * np.count_nonzero(relative % steps[0, 1]) > max(np.count_nonzero(relative), 2):
        return f"the shifts of ctts are no multiples of the one step of stts, {steps[0, 1]} ticks"
    return None


def _lengths(
    tables: dict[bytes, bytes], frames: int, steps: NDArray[np.int64], shifts: NDArray[np.int64] | None
) -> str | None:
    """The frame times add up to the stated length, as decoded or as shown, and the edit list shows no more than that."""
    unit, stated = _header_times(tables.get(b"mdhd", b""))
    if not unit:
        return None
    summed = int((steps[:, 0] * steps[:, 1]).sum())
    off = min(abs(length - stated) for length in (summed, *_shown_ticks(steps, shifts)))
    if stated and off * frames > STEPS_APART * max(summed, stated):
        return f"stts adds up to {summed} ticks, mdhd states {stated}"
    shown_s, track_s = _edited_s(tables), summed / unit
    if shown_s is not None and shown_s > (1 + LENGTHS_APART) * track_s + 2 * track_s / frames:
        return f"elst shows {shown_s:.3f} s of a track of {track_s:.3f} s"
    return None


def _shown_ticks(steps: NDArray[np.int64], shifts: NDArray[np.int64] | None) -> tuple[int, ...]:
    """From the first frame shown, or decoded, to the end of the last one shown.

    More than the steps add up to where a cut left frames before the last one out; programs that write an index state either.
    """
    if steps[:, 0].sum() > MOST_FRAMES:
        return ()
    lasts = np.repeat(steps[:, 1], steps[:, 0])
    begins = np.concatenate([[0], np.cumsum(lasts[:-1])])
    if shifts is not None:
        begins = begins + np.repeat(shifts[:, 1].astype(np.uint32).astype(np.int32), shifts[:, 0])
    last = int(np.argmax(begins))
    end = int(begins[last] + lasts[last])
    return end - int(begins.min()), end


def _header_times(header: bytes) -> tuple[int, int]:
    """Ticks per second, and duration in them (0: not stated), of an mdhd or mvhd."""
    at, width = (20, 8) if header[:1] == b"\1" else (12, 4)
    return int.from_bytes(header[at : at + 4], "big"), _stated(header[at + 4 : at + 4 + width])


def _stated(field: bytes) -> int:
    return 0 if field == b"\xff" * len(field) else int.from_bytes(field, "big")


def _edited_s(tables: dict[bytes, bytes]) -> float | None:
    """Length of the one part that the edit list shows, s; None with no list or several parts."""
    parts = _parts(tables)
    return parts[0][0] if len(parts) == 1 else None


def _cuts(tables: dict[bytes, bytes]) -> bool:
    """Whether the edit list leaves anything out: it begins later than the first frame, ends early, or shows several parts."""
    parts = _parts(tables)
    if not parts:
        return False
    unit, stated = _header_times(tables.get(b"mdhd", b""))
    shifts = tables.get(b"ctts", b"")
    first = int.from_bytes(shifts[12:16], "big")
    frames = int.from_bytes((tables.get(b"stsz") or tables.get(b"stz2") or b"")[8:12], "big")
    ends_early = unit > 0 and parts[0][0] * frames < (frames - CUT_FRAMES) * stated / unit
    return len(parts) > 1 or parts[0][1] > first or ends_early


def _parts(tables: dict[bytes, bytes]) -> list[tuple[float, int]]:
    """The first parts that the edit list shows: length, s, and where it begins, ticks; parts that only delay left out."""
    table = tables.get(b"elst")
    unit, _ = _header_times(tables.get(b"mvhd", b""))
    if table is None or not unit:
        return []
    width = 8 if table[0] == 1 else 4
    parts = []
    for index in range(min(int.from_bytes(table[4:8], "big"), 3)):
        at = 8 + index * (2 * width + 4)
        begins = table[at + width : at + 2 * width]
        if begins != b"\xff" * width:  # an empty part only delays
            length_s = int.from_bytes(table[at : at + width], "big") / unit
            parts.append((length_s, int.from_bytes(begins, "big")))
    return parts
