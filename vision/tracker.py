"""Follow the markers of a run through its recording, whatever they look like."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import pandas as pd

from ..geometry.mapping import Mapping
from ..record.errors import InputError, TrackingError
from ..record.run import RUN_FILE, Run
from .backend import NUMPY, Backend
from .datum_marks import DatumMarks
from .recording import Frame
from .scatter import with_scatter
from .spots import SpotFollower


@dataclass(frozen=True)
class Tracking:
    """Tracks of a recording.

    Attributes
    ----------
    table : tracks.csv, with a column ``reason`` (why lost)
    frames : frames looked at
    measured : marker -> frames measured
    reasons : marker -> reason -> frames lost
    ambiguous : at some acquisition another assignment of spots to markers was nearly as good
    datum : datum points with ``track = true`` as in ``table``, by the point's name; None without one
    """

    table: pd.DataFrame
    frames: int
    measured: dict[str, int]
    reasons: dict[str, dict[str, int]]
    ambiguous: bool
    datum: pd.DataFrame | None = None


class Follower(Protocol):
    """What follows some markers of a run through its frames."""

    losses: int
    ambiguous: bool

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        ...

    def finish(self) -> pd.DataFrame:
        """Rows of tracks.csv with a reason, frame by frame; TrackingError where the marks were never found."""
        ...


def track(
    run: Run,
    frames: Iterable[Frame],
    mapping: Mapping,
    progress: Callable[[int, int], None] | None = None,
    backend: Backend = NUMPY,
    lossy: bool = True,
    linked: bool = False,
) -> Tracking:
    """Track the markers of ``run`` through ``frames``.

    Parameters
    ----------
    mapping : pixel -> tank of the run's datum
    progress : called with frames done and losses so far
    backend : where the fits run
    lossy : the recording was compressed with loss
    linked : and its pictures are made from others

    Raises
    ------
    TrackingError : the marks were never found
    """
    followers = _followers(run, mapping, backend)
    fixed = DatumMarks(run)
    count = 0
    for frame in frames:
        if fixed.points:
            fixed.step(frame)
        for follower in followers:
            follower.step(frame)
        count += 1
        if progress is not None:
            progress(count, sum(f.losses for f in followers))
    if not count:
        raise TrackingError(f"{run.source_path}: no frame lies within source.span_s")
    table = _merged([f.finish() for f in followers], [m.name for m in run.file.marker])
    table = with_scatter(table, run.file.marker, mapping, lossy, linked)
    return _tracking(table, run, count, any(f.ambiguous for f in followers), fixed.finish())


def _followers(run: Run, mapping: Mapping, backend: Backend) -> list[Follower]:
    """One for all lights and discs, one for all fiducials, one for each template."""
    from .patch_follower import FiducialMarks, TemplateMark

    spots = tuple(m for m in run.file.marker if m.look in ("led", "disc"))
    tags = tuple(m for m in run.file.marker if ":" in m.look)
    patches = [m for m in run.file.marker if m.look == "template"]
    if len(spots) == 1:
        raise InputError(
            run.folder / RUN_FILE,
            f"marker {spots[0].name!r}.look",
            f"{spots[0].look!r} alone: which spot it is shows only beside a second led or disc",
        )
    found: list[Follower] = [SpotFollower(run, spots, mapping, backend)] if spots else []
    if tags:
        found.append(FiducialMarks(run, tags))
    return [*found, *(TemplateMark(run, marker) for marker in patches)]


def _merged(tables: list[pd.DataFrame], names: list[str]) -> pd.DataFrame:
    """One table, the rows of a frame together in run.toml's order."""
    if len(tables) == 1:
        return tables[0]
    table = pd.concat(tables, ignore_index=True)
    table["order"] = table["marker"].map({name: at for at, name in enumerate(names)})
    return table.sort_values(["frame", "order"]).drop(columns="order").reset_index(drop=True)


def _tracking(table: pd.DataFrame, run: Run, frames: int, ambiguous: bool, datum: pd.DataFrame | None) -> Tracking:
    seen = table["status"] == "measured"
    measured = {m.name: int(((table["marker"] == m.name) & seen).sum()) for m in run.file.marker}
    reasons = {
        str(name): {str(k): int(v) for k, v in rows["reason"].value_counts().items()}
        for name, rows in table[~seen].groupby("marker")
    }
    return Tracking(table, frames, measured, reasons, ambiguous, datum)
