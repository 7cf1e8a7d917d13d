"""The working area of a run in the picture: the box of its datum points, its marks and their tracks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...record.errors import InputError
from ...record.run import RUN_FILE, Run
from ...record.tables import seen_rows
from .coverage import Coverage, uncovered

if TYPE_CHECKING:
    import pandas as pd

Box = tuple[float, float, float, float]


def working_box(run: Run, tracks: pd.DataFrame | None) -> Box:
    """Left, top, right, bottom, px.

    Parameters
    ----------
    run : the run folder as read
    tracks : tracks table, or None

    Raises
    ------
    InputError : the run names no pixel at all.
    """
    places = [point.pixel_px for point in run.file.datum]
    places += [marker.seen_at_px for marker in run.file.marker if marker.seen_at_px is not None]
    found = np.array(places, dtype=float).reshape(-1, 2)
    if tracks is not None:
        rows = tracks[seen_rows(tracks)] if "status" in tracks else tracks
        found = np.concatenate([found, rows[["u_px", "v_px"]].dropna().to_numpy(dtype=float)])
    if not len(found):
        raise InputError(run.folder / RUN_FILE, "datum", "no pixel is named, and out/tracks.csv is not there")
    return (*map(float, found.min(0)), *map(float, found.max(0)))  # type: ignore[return-value]


def area_notes(found: Coverage, box: Box, name: str, size: tuple[int, int] | None) -> list[str]:
    """Warnings where the lens was calibrated for another picture, or not where the work is done; else that it was.

    Parameters
    ----------
    found : from ``coverage``
    box : left, top, right, bottom, px
    name : of the run, in the notes
    size : width and height of the picture that is to be measured, px, or None
    """
    if size is not None and size != found.image_size_px:
        return [
            f"run {name}: its picture is {size[0]} x {size[1]} px, the calibration's "
            f"{found.image_size_px[0]} x {found.image_size_px[1]}: this lens does not hold for it"
        ]
    text = f"u {box[0]:.0f} to {box[2]:.0f}, v {box[1]:.0f} to {box[3]:.0f} px"
    missing = uncovered(found, box)
    if missing:
        return [
            f"run {name}: the working area ({text}) was not covered by boards at its {', '.join(missing)}: the lens is guessed "
            "there; add pictures with the board in that place"
        ]
    return [f"run {name}: the working area ({text}) was covered by boards"]
