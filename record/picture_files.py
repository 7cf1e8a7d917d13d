"""Recordings that are pictures: which files, in which order, and what their names say of number and time."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".jpg", ".jpeg", ".webp")
"""Of pictures that a folder is looked through for."""
LEAST_PICTURES = 3
"""A folder with fewer numbered pictures of one series is no recording: a choice."""
UNITS_S = {"s": Decimal(1), "ms": Decimal("1e-3"), "us": Decimal("1e-6"), "ns": Decimal("1e-9")}
"""What ``{ms}`` and the like in a pattern mean, seconds."""
_NUMBER = re.compile(r"\d+(?=\D*$)")
_PLACE = re.compile(r"%0?\d*d|\*|\?|\{(?:s|ms|us|ns)\}")


@dataclass(frozen=True)
class PictureFile:
    """One picture of a recording.

    Attributes
    ----------
    path : of the file
    number : from its name, the first one's is 0; where names hold times, or no number, its place
    t_s : time since the first one, s, from its name; None: the name holds none
    """

    path: Path
    number: int
    t_s: float | None = None


def is_pattern(path: str | Path) -> bool:
    """Whether a path's last part is a pattern: ``*``, ``?``, ``%04d``, or a time such as ``{ms}``."""
    return _PLACE.search(Path(path).name) is not None


def picture_files(path: str | Path) -> list[PictureFile]:
    """The pictures of a folder, or of a pattern, in their order; none where there is no such recording.

    Parameters
    ----------
    path : a folder with one series of numbered pictures, or ``folder/img_%04d.png``, ``folder/*.png``, ``folder/img_{ms}.png``
        (times in s, ms, us or ns)
    """
    path = Path(path)
    if path.is_dir():
        found = [p for p in _listed(path) if p.suffix.lower() in SUFFIXES and _NUMBER.search(p.stem)]
        series = {(_NUMBER.split(p.stem)[0], p.suffix.lower()) for p in found}
        return _numbered(found) if len(series) == 1 and len(found) >= LEAST_PICTURES else []
    if not is_pattern(path) or path.exists():
        return []
    form, unit = _compiled(path.name)
    matched = [(p, form.fullmatch(p.name)) for p in _listed(path.parent)]
    if unit is None:
        return _numbered([p for p, match in matched if match])
    timed = sorted((Decimal(match["t"].replace(",", ".")) * UNITS_S[unit], p) for p, match in matched if match)
    return [PictureFile(p, place, float(t_s - timed[0][0])) for place, (t_s, p) in enumerate(timed)]


def _listed(folder: Path) -> list[Path]:
    try:
        return sorted(folder / entry.name for entry in os.scandir(folder) if not entry.name.startswith("."))
    except OSError:
        return []


def _numbered(found: list[Path]) -> list[PictureFile]:
    """By the last number of their names; by their names where one has none, or two have the same."""
    numbers = [_NUMBER.search(p.stem) for p in found]
    known = [int(n[0]) for n in numbers if n is not None]
    if len(known) < len(found) or len(set(known)) < len(known):
        return [PictureFile(p, place) for place, p in enumerate(sorted(found))]
    first = min(known, default=0)
    return [PictureFile(p, number - first) for number, p in sorted(zip(known, found, strict=True))]


def _compiled(pattern: str) -> tuple[re.Pattern[str], str | None]:
    """A regular expression for a pattern's names, and the unit of the time in them."""
    unit, parts, at = None, [], 0
    for place in _PLACE.finditer(pattern):
        parts.append(re.escape(pattern[at : place.start()]))
        at = place.end()
        if place[0] in ("*", "?"):
            parts.append(".*" if place[0] == "*" else ".")
        elif place[0].startswith("%"):
            parts.append(r"\d+")
        else:
            parts.append(r"(?P<t>\d+(?:[.,]\d+)?)" if unit is None else r"\d+(?:[.,]\d+)?")
            unit = unit or place[0][1:-1]
    return re.compile("".join([*parts, re.escape(pattern[at:])])), unit


__all__ = ["LEAST_PICTURES", "SUFFIXES", "UNITS_S", "PictureFile", "is_pattern", "picture_files"]
