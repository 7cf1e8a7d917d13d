"""The motion of a run as the plots show it, and the tracks as they are drawn over a frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..record.errors import TowlineError
from ..record.run import Run
from ..record.tables import input_hash_of, read_motion, read_tracks, seen_rows

if TYPE_CHECKING:
    import pandas as pd

MOST_POINTS = 1500
"""Of a curve on the screen."""
CURVES = (
    ("alpha_rad", "sigma_alpha_rad", "α, tow line angle", "deg", 180 / np.pi),
    ("beta_rad", "sigma_beta_rad", "β, heading", "deg", 180 / np.pi),
    ("y_cg_m", "sigma_y_cg_m", "y_CG, to starboard", "mm", 1e3),
)
"""Column, its sigma, what the axis is called, its unit, and the factor to it."""


@dataclass(frozen=True)
class Shown:
    """The motion and tracks in out/.

    Attributes
    ----------
    motion, tracks : tables; None where there are none
    current : made from run.toml and the recording as they are saved now
    words : what is wrong with them; "" = nothing
    """

    motion: pd.DataFrame | None = None
    tracks: pd.DataFrame | None = None
    current: bool = False
    words: str = ""


def read_shown(run: Run | None, folder: Path) -> Shown:
    """What lies in out/ of a run folder (and its source, where that is a motion or tracks).

    Parameters
    ----------
    run : as saved; None where run.toml cannot be read
    folder : of the run
    """
    from ..pipeline.stages.motion import MOTION
    from ..pipeline.stages.tracks import TRACKS
    from ..pipeline.stages.versions import stamp_of

    source = None if run is None else run.file.source
    out = folder / "out"
    motion_path = folder / source.motion if source and source.motion else out / MOTION
    tracks_path = folder / source.tracks if source and source.tracks else out / TRACKS
    motion = tracks = None
    words = ""
    try:
        motion = read_motion(motion_path) if motion_path.is_file() else None
        tracks = read_tracks(tracks_path) if tracks_path.is_file() else None
    except TowlineError as error:
        words = str(error)
    current = False
    if run is not None and motion is not None:
        made_from = input_hash_of(motion_path)
        current = bool(source and source.motion) or made_from == stamp_of(run, "motion", "exact")
        words = words or (
            "" if current else "made before the last change of run.toml, corrections or recording: track again"
        )
    return Shown(motion, tracks, current, words)


def curves(motion: pd.DataFrame) -> dict[str, Any]:
    """The plots' data: times, and for each curve its label, unit, values and standard deviations; None = not measured."""
    stride = max(1, int(np.ceil(len(motion) / MOST_POINTS)))
    part = motion.iloc[::stride]
    lost = (part["status"] == "lost").to_numpy()
    panels = []
    for name, sigma, label, unit, factor in CURVES:
        value = np.where(lost, np.nan, part[name].to_numpy(dtype=float)) * factor
        if not np.isfinite(value).any():
            continue
        spread = part[sigma].to_numpy(dtype=float) * factor if sigma in part else np.full(len(part), np.nan)
        panels.append({"label": label, "unit": unit, "y": _plain(value), "sd": _plain(spread)})
    return {"t": _plain(part["t_s"].to_numpy(dtype=float)), "panels": panels}


def _plain(values: np.ndarray) -> list[float | None]:
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values]


def value_at(motion: pd.DataFrame, t_s: float) -> str:
    """alpha, beta and y_CG at the sample next to a time, in words.

    Parameters
    ----------
    motion : motion table
    t_s : time, s
    """
    times = motion["t_s"].to_numpy(dtype=float)
    if not len(times):
        return ""
    k = int(np.argmin(np.abs(times - t_s)))
    if len(times) > 1 and abs(times[k] - t_s) > 2 * float(np.median(np.diff(times))):
        return "not analysed at this time"
    row = motion.iloc[k]
    if row["status"] == "lost":
        return "lost in this frame"
    said = []
    for name, _, label, unit, factor in CURVES:
        if np.isfinite(row[name]):
            said.append(f"{label.partition(',')[0]} {row[name] * factor:+.{1 if unit == 'mm' else 2}f} {unit}")
    return "   ".join(said)


def marks_at(
    tracks: pd.DataFrame, frame: int, trail: int = 40
) -> tuple[dict[str, tuple[float, float]], dict[str, list[list[float]]]]:
    """Marks seen in a frame, measured or set by hand, and the last places of each: marker -> u, v px.

    Parameters
    ----------
    tracks : tracks table
    frame : of the recording
    trail : places before it
    """
    part = tracks[(tracks["frame"] <= frame) & (tracks["frame"] > frame - trail) & seen_rows(tracks)]
    places: dict[str, tuple[float, float]] = {}
    trails: dict[str, list[list[float]]] = {}
    for name, rows in part.groupby("marker", sort=False):
        trails[str(name)] = rows[["u_px", "v_px"]].to_numpy(dtype=float).round(2).tolist()
        here = rows[rows["frame"] == frame]
        if len(here):
            places[str(name)] = (float(here["u_px"].iloc[0]), float(here["v_px"].iloc[0]))
    return places, trails


__all__ = ["Shown", "curves", "marks_at", "read_shown", "value_at"]
