"""corrections.toml: what a person set right in the tracks of a run's video; an input, applied again whenever it is tracked.

A seed says where a mark is in a frame, and it is followed anew from there; a point is a place set by hand; a removed point is
lost. Nothing measured goes: without the file the tracks are what they were, and beside a corrected row stands what it had.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, model_validator

from .errors import InputError
from .looks import look_of
from .run import CORRECTIONS, Run
from .schema import Marker
from .tables import BY_HAND
from .toml import Table, read_toml
from .typed import linked, write_typed

if TYPE_CHECKING:
    import pandas as pd

HAND_SIGMA_PX = 1.0
"""Of a place set by hand where its file does not say how well it was set, along each axis: a pixel, twice what a careful click on a
sharp mark has (run.toml's datum takes half a pixel). A choice."""
REMOVED = "removed by hand"
"""The reason of a removed point in tracks.csv."""
AUTOMATIC = ("u_px", "v_px", "sigma_u_px", "sigma_v_px")
"""Columns of tracks.csv of which a corrected row keeps the automatic value, as auto_NAME."""
VERSION = 1
"""Of the file, raised when a key changes its meaning."""
_HEAD = "# What was set right by hand in the tracks of this run's video (docs/formats/formats.md). Delete a table to take it back."


class Placed(Table):
    """A mark's place in a frame, as a person sees it."""

    frame: int = Field(ge=0, description="number of the frame in the recording, as in tracks.csv")
    marker: str = Field(min_length=1, description="name of a [[marker]] of run.toml")
    pixel_px: tuple[float, float] = Field(description="(u, v), where the mark is")
    sigma_px: float = Field(
        default=HAND_SIGMA_PX, gt=0, le=100, description="how well that is known, standard deviation along each axis"
    )


class Removed(Table):
    """A mark that is not where it was measured, in one frame or several."""

    frame: int = Field(ge=0, description="number of the frame in the recording, as in tracks.csv")
    last_frame: int | None = Field(default=None, ge=0, description="to this frame, itself included; absent: one frame")
    marker: str = Field(min_length=1, description="name of a [[marker]] of run.toml")

    @model_validator(mode="after")
    def _ends(self) -> Removed:
        if self.last_frame is not None and self.last_frame < self.frame:
            raise ValueError(f"last_frame {self.last_frame} comes before frame {self.frame}")
        return self

    @property
    def end(self) -> int:
        """The last frame."""
        return self.frame if self.last_frame is None else self.last_frame


class Corrections(Table):
    """The file."""

    version: Literal[1] = Field(default=VERSION, description="of the file")
    seed: tuple[Placed, ...] = Field(default=(), description="marks that are followed anew from a frame on")
    point: tuple[Placed, ...] = Field(default=(), description="places set by hand; status by_hand in tracks.csv")
    removed: tuple[Removed, ...] = Field(default=(), description="points taken away; status lost in tracks.csv")

    def __bool__(self) -> bool:
        return bool(self.seed or self.point or self.removed)

    def seeded(self, seeds: Iterable[Placed]) -> Corrections:
        """With more seeds; a seed of the same mark in the same frame is replaced.

        Parameters
        ----------
        seeds : new ones
        """
        new = {(s.frame, s.marker): s for s in (*self.seed, *seeds)}
        return self.model_copy(update={"seed": tuple(new[key] for key in sorted(new))})

    def words(self, points: bool = True) -> tuple[str, ...]:
        """All that changes the tracks, in words, for the stamp of what is made from it; nothing where there is nothing.

        Parameters
        ----------
        points : what needs no tracking (points, removed ones) as well as the seeds
        """
        tables = (("seed", self.seed), ("point", self.point), ("removed", self.removed))
        return tuple(f"{name} {row!r}" for name, rows in tables if points or name == "seed" for row in rows)


def read_corrections(run: Run) -> Corrections:
    """The corrections of a run, checked against its markers; none where there is no file, or no video that it belongs to.

    Parameters
    ----------
    run : the run folder as read

    Raises
    ------
    InputError : the file cannot be used: which table and key, and why
    """
    path = run.folder / CORRECTIONS
    if run.file.source.video is None or not (path.exists() or path.is_symlink()):
        return Corrections()
    found = read_toml(path, Corrections)
    check_corrections(found, run.file.marker, path)
    return found


def check_corrections(found: Corrections, markers: Collection[Marker], path: str | Path) -> None:
    """Every mark is one of the run, stands once in a frame, and can be seeded where it is.

    Parameters
    ----------
    found : corrections
    markers : of run.toml
    path : quoted in errors

    Raises
    ------
    InputError : which table and key, and why
    """
    looks = {marker.name: marker.look for marker in markers}
    for table, rows in (("seed", found.seed), ("point", found.point), ("removed", found.removed)):
        for number, row in enumerate(rows, 1):
            if row.marker not in looks:
                raise InputError(
                    path, f"{table}[{number}].marker", f"{row.marker!r} is none of the run's markers {', '.join(looks)}"
                )
    for number, seed in enumerate(found.seed, 1):
        look = look_of(looks[seed.marker])
        if look is not None and look.numbered:
            raise InputError(
                path,
                f"seed[{number}].marker",
                f"{seed.marker!r} ({looks[seed.marker]}) is known by its number and takes no seed; set its points instead",
            )
    _once("seed", path, [(s.marker, s.frame, s.frame) for s in found.seed])
    _once(
        "point or removed",
        path,
        [(p.marker, p.frame, p.frame) for p in found.point] + [(r.marker, r.frame, r.end) for r in found.removed],
    )


def _once(table: str, path: str | Path, spans: list[tuple[str, int, int]]) -> None:
    """No frame of a mark stands in two spans (marker, first, last)."""
    ordered = sorted(spans)
    for (marker, _, last), (other, first, _) in pairwise(ordered):
        if marker == other and first <= last:
            raise InputError(path, table, f"frame {first} of {marker!r} stands there twice")


def write_corrections(folder: Path, corrections: Corrections, outside: bool = False) -> Path:
    """Write corrections.toml, whole or not at all; without any correction the file goes.

    Parameters
    ----------
    folder : of the run
    corrections : all of them
    outside : it may be a link out of the folder

    Raises
    ------
    InputError : it is a link out of the folder, and may not be
    """
    path = folder / CORRECTIONS
    if corrections:
        write_typed(path, text_of(corrections), outside)
    elif path.is_symlink():
        write_typed(linked(path, outside), text_of(corrections), outside)
    else:
        path.unlink(missing_ok=True)
    return path


def text_of(corrections: Corrections) -> str:
    """The file's text, by frame and marker.

    Parameters
    ----------
    corrections : all of them
    """
    import tomlkit

    lines = [_HEAD, f"version = {VERSION}"]
    for table in ("seed", "point", "removed"):
        rows: tuple[Table, ...] = getattr(corrections, table)
        for row in sorted(rows, key=lambda row: (row.frame, row.marker)):  # pyright: ignore
            lines += ["", f"[[{table}]]"]
            for key, value in row.model_dump(exclude_none=True).items():
                item = list(value) if isinstance(value, tuple) else value
                lines.append(f"{key} = {tomlkit.item(item).as_string()}")
    return "\n".join(lines) + "\n"


def check_places(corrections: Corrections, size_px: tuple[int, int], path: str | Path) -> None:
    """Every place lies inside the picture.

    Parameters
    ----------
    corrections : all of them
    size_px : width, height of the picture
    path : quoted in errors

    Raises
    ------
    InputError : which table, the place, and the picture's size
    """
    for table, rows in (("seed", corrections.seed), ("point", corrections.point)):
        for number, row in enumerate(rows, 1):
            u, v = row.pixel_px
            if not (-0.5 <= u <= size_px[0] - 0.5 and -0.5 <= v <= size_px[1] - 0.5):
                raise InputError(
                    path,
                    f"{table}[{number}].pixel_px",
                    f"({u:g}, {v:g}) lies outside the picture of {size_px[0]} x {size_px[1]} pixels",
                )


def unreached(corrections: Corrections, frames: Collection[int]) -> list[tuple[str, int]]:
    """Corrections of which no frame was tracked: (table with number, frame).

    Parameters
    ----------
    corrections : all of them
    frames : numbers of the frames that were tracked
    """
    have = np.array(sorted(frames), dtype=int)
    found: list[tuple[str, int]] = []
    for table, rows in (("seed", corrections.seed), ("point", corrections.point), ("removed", corrections.removed)):
        for number, row in enumerate(rows, 1):
            end = row.end if isinstance(row, Removed) else row.frame
            if not ((have >= row.frame) & (have <= end)).any():
                found.append((f"{table}[{number}].frame", row.frame))
    return found


def corrected(table: pd.DataFrame, corrections: Corrections) -> pd.DataFrame:
    """Tracks with the points set by hand and the removed ones; what those rows had stands in auto_u_px and its like.

    Parameters
    ----------
    table : tracks as they were followed
    corrections : of which the seeds are in the table already

    Returns
    -------
    DataFrame : rows set by hand have status ``by_hand`` and the sigma that their file states; removed ones are ``lost``
    """
    if not (corrections.point or corrections.removed):
        return table
    table = table.copy()
    table["reason"] = table["reason"].fillna("").astype(object) if "reason" in table else ""
    for name in AUTOMATIC:
        table[f"auto_{name}"] = np.nan
    row_of = {key: row for row, key in enumerate(zip(table["marker"], table["frame"].astype(int), strict=True))}
    at = table.index

    def keep(rows: list[int]) -> None:
        table.loc[at[rows], [f"auto_{name}" for name in AUTOMATIC]] = table.loc[at[rows], list(AUTOMATIC)].to_numpy()

    for point in corrections.point:
        if (row := row_of.get((point.marker, point.frame))) is not None:
            keep([row])
            table.loc[at[row], list(AUTOMATIC)] = (*point.pixel_px, point.sigma_px, point.sigma_px)
            table.loc[at[row], ["status", "reason"]] = BY_HAND, ""
            if "repeated" in table:
                table.loc[at[row], "repeated"] = 0
    for gone in corrections.removed:
        inside = table["frame"].between(gone.frame, gone.end) & (table["marker"] == gone.marker)
        rows = np.flatnonzero(inside.to_numpy()).tolist()
        keep(rows)
        table.loc[at[rows], list(AUTOMATIC)] = np.nan
        table.loc[at[rows], ["status", "reason"]] = "lost", REMOVED
    return table


def in_words(corrections: Corrections) -> str:
    """How many of each: "seeds in frame 120, 3 points by hand, 1 removed"; "" = none."""
    said = []
    if corrections.seed:
        frames = sorted(Counter(seed.frame for seed in corrections.seed))
        said.append(f"seeds in frame{'s' if len(frames) > 1 else ''} {', '.join(map(str, frames))}")
    if count := len(corrections.point):
        said.append(f"{count} point{'s' if count > 1 else ''} by hand")
    if count := sum(gone.end - gone.frame + 1 for gone in corrections.removed):
        said.append(f"{count} removed")
    return ", ".join(said)


__all__ = [
    "HAND_SIGMA_PX",
    "REMOVED",
    "Corrections",
    "Placed",
    "Removed",
    "check_corrections",
    "check_places",
    "corrected",
    "in_words",
    "read_corrections",
    "text_of",
    "unreached",
    "write_corrections",
]
