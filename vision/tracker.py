"""Follow the markers of a run through its recording, whatever they look like."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..geometry.mapping import Mapping
from ..record.corrections import Placed
from ..record.errors import TrackingError
from ..record.run import Run
from .backend import NUMPY, Backend
from .datum_marks import DatumMarks
from .looks import followers
from .recording import Frame
from .recording.beat import on_beat
from .scatter import with_scatter


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
    notes : what is doubtful about the recording
    """

    table: pd.DataFrame
    frames: int
    measured: dict[str, int]
    reasons: dict[str, dict[str, int]]
    ambiguous: bool
    datum: pd.DataFrame | None = None
    notes: tuple[str, ...] = ()


def track(
    run: Run,
    frames: Iterable[Frame],
    mapping: Mapping,
    progress: Callable[[int, int], None] | None = None,
    backend: Backend = NUMPY,
    lossy: bool = True,
    linked: bool = False,
    seeds: Sequence[Placed] = (),
) -> Tracking:
    """Track the markers of ``run`` through ``frames``.

    Parameters
    ----------
    run : the run folder as read
    frames : of the recording
    mapping : pixel -> tank of the run's datum
    progress : called with frames done and losses so far
    backend : where the fits run
    lossy : the recording was compressed with loss
    linked : and its pictures are made from others
    seeds : frames in which a person says where marks are: they are followed anew from there; frames before keep what they had

    Raises
    ------
    TrackingError : the marks were never found
    """
    following = followers(run, mapping, backend, seeds)
    fixed = DatumMarks(run)
    count = 0
    notes: list[str] = []
    arrived_s: dict[int, float] = {}
    for frame in frames:
        notes += frame.notes
        if frame.on_arrival:
            arrived_s[frame.index] = frame.t_s
        if fixed.points:
            fixed.step(frame)
        for follower in following:
            follower.step(frame)
        count += 1
        if progress is not None:
            progress(count, sum(f.losses for f in following))
    if not count:
        raise TrackingError(f"{run.source_path}: no frame lies within source.span_s")
    table = _merged([f.finish() for f in following], [m.name for m in run.file.marker])
    datum = fixed.finish()
    if arrived_s:
        beat = on_beat(np.array(list(arrived_s.values())))
        taken_s = dict(zip(arrived_s, beat.t_s, strict=True))
        for one in (table,) if datum is None else (table, datum):
            one["t_s"] = one["frame"].map(taken_s)
        notes.append(f"{run.source_path.name}: {beat.words}")
    table = with_scatter(table, run.file.marker, mapping, lossy, linked, seeds)
    return _tracking(table, run, count, any(f.ambiguous for f in following), datum, notes)


def _merged(tables: list[pd.DataFrame], names: list[str]) -> pd.DataFrame:
    """One table, the rows of a frame together in run.toml's order."""
    if len(tables) == 1:
        return tables[0]
    table = pd.concat(tables, ignore_index=True)
    table["order"] = table["marker"].map({name: at for at, name in enumerate(names)})
    return table.sort_values(["frame", "order"]).drop(columns="order").reset_index(drop=True)


def _tracking(
    table: pd.DataFrame, run: Run, frames: int, ambiguous: bool, datum: pd.DataFrame | None, notes: list[str]
) -> Tracking:
    seen = table["status"] == "measured"
    measured = {m.name: int(((table["marker"] == m.name) & seen).sum()) for m in run.file.marker}
    reasons = {
        str(name): {str(k): int(v) for k, v in rows["reason"].value_counts().items()}
        for name, rows in table[~seen].groupby("marker")
    }
    return Tracking(table, frames, measured, reasons, ambiguous, datum, tuple(dict.fromkeys(notes)))
