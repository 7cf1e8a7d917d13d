"""The stages of a run - tracks, motion - each redone only when its inputs, options or the version changed.

Every stage writes into RUN/out/ with the hash of what it was made from in the file's first line; a stage whose hash still
matches is read back. Video -> tracks -> motion; what comes after takes several runs and stands in ``cli``.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from . import __version__
from .geometry import DatumFit, motion_from_tracks, run_datum
from .record.errors import InputError, TowlineError
from .record.files import replacing, sha256_of_texts
from .record.results import CameraFile, TruthFile, read_result, write_result
from .record.run import RUN_FILE, Run
from .record.tables import input_hash_of, read_motion, read_tracks, write_table

TRACKS, MARKS, MOTION, COMMON, CAMERA = "tracks.csv", "marks.csv", "motion.csv", "motion_common.npy", "camera.json"
Progress = Callable[[str, int, int | None], None]
"""Called with what is going on, how far, and out of how much (None = unknown)."""


@dataclass(frozen=True)
class Moved:
    """A run with its motion.

    Attributes
    ----------
    motion : motion table
    common : (k, n, 3) common modes of (y_cg, beta, alpha); None where the motion came from outside
    camera : camera file; None where the motion came from outside
    tracks : None where the motion came from outside
    """

    run: Run
    motion: pd.DataFrame
    common: np.ndarray | None
    camera: CameraFile | None
    tracks: pd.DataFrame | None


def tracked(
    run: Run, progress: Progress | None = None, overlay: bool = False, fresh: bool = False
) -> tuple[pd.DataFrame, DatumFit]:
    """Tracks of a run, from its own file, from out/ or from the video; and the fitted datum.

    Parameters
    ----------
    overlay : also write out/overlay.mp4 (tracks the video again)
    fresh : track again even where out/ is up to date
    """
    if run.file.source.motion is not None:
        raise InputError(
            run.folder / RUN_FILE, "source.motion", "the run comes with its motion; there is nothing to track"
        )
    if run.file.source.tracks is not None:
        return read_tracks(run.source_path), run_datum(run, None)
    from .vision import clip_info, overlay_writer, read_frames, track

    info = clip_info(run.source_path)
    datum = run_datum(run, (info.width_px, info.height_px))
    if run.file.camera is not None and run.file.camera.image_size_px != (info.width_px, info.height_px):
        stated = run.file.camera.image_size_px
        raise InputError(
            run.folder / RUN_FILE,
            "camera.image_size_px",
            f"{list(stated)}, but the video's picture is {info.width_px} x {info.height_px}; the lens would be another",
        )
    target = run.out / TRACKS
    stamp = run.input_hash("tracks", _code_hash())
    if not overlay and not fresh and input_hash_of(target) == stamp:
        return read_tracks(target), datum
    source = run.file.source
    total = _frames_expected(info, source.span_s)
    frames = read_frames(run.source_path, source.span_s, source.frame_rate_hz)

    def count(done: int, lost: int) -> None:
        if progress is not None:
            progress(f"{run.name}: tracking" + (f", {lost} lost" if lost else ""), done, total)

    writer = overlay_writer(run.out / "overlay.mp4", run.file.datum, info.rate_hz) if overlay else nullcontext(None)
    with writer as drawn:
        found = track(run, frames, datum.mapping, count, drawn.watch if drawn is not None else None)
    write_table(target, found.table, stamp)
    return read_tracks(target), datum


@cache
def _code_hash() -> str:
    """Hash of the code behind tracks and motion: results of another version, or of another day's checkout, are redone."""
    house = Path(__file__).parent
    paths = sorted(path for room in ("record", "geometry", "vision") for path in (house / room).glob("*.py"))
    return sha256_of_texts(__version__, *(path.read_text(encoding="utf-8") for path in paths))


def _frames_expected(info, span_s: tuple[float, float] | None) -> int | None:
    length = info.duration_s
    if span_s is not None:
        length = min(span_s[1], length or span_s[1]) - span_s[0]
    return None if length is None else max(1, round(length * info.rate_hz))


def moved(run: Run, method: str = "exact", progress: Progress | None = None, fresh: bool = False) -> Moved:
    """Motion of a run, from its own file, from out/ or from its tracks."""
    if run.file.source.motion is not None:
        return Moved(run, _in_span(run, read_motion(run.source_path)), None, None, None)
    tracks, datum = tracked(run, progress, fresh=fresh)
    stamp = run.input_hash("motion", _code_hash(), method)
    paths = {name: run.out / name for name in (MARKS, MOTION, COMMON, CAMERA)}
    if not fresh and input_hash_of(paths[MOTION]) == stamp and all(p.is_file() for p in paths.values()):
        common = np.load(paths[COMMON], allow_pickle=False)
        motion = read_motion(paths[MOTION])
        if common.shape[1:] == (len(motion), 3):
            return Moved(run, motion, common, read_result(paths[CAMERA], CameraFile), tracks)
    if progress is not None:
        progress(f"{run.name}: motion", 0, None)
    result = motion_from_tracks(run, tracks, datum, method, __version__, run.input_hashes())
    write_table(paths[MARKS], result.marks, stamp)
    write_result(paths[CAMERA], result.camera)
    with replacing(paths[COMMON]) as temporary:
        np.save(temporary, result.common)
    write_table(paths[MOTION], result.motion, stamp)  # last: its stamp vouches for the others
    return Moved(run, read_motion(paths[MOTION]), result.common, result.camera, tracks)


def _in_span(run: Run, motion: pd.DataFrame) -> pd.DataFrame:
    span = run.file.source.span_s
    if span is None:
        return motion
    inside = motion[motion["t_s"].between(*span)].reset_index(drop=True)
    if inside.empty:
        raise InputError(
            run.folder / RUN_FILE, "source.span_s", f"{list(span)} holds no sample of {run.file.source.motion}"
        )
    return inside


def truth_of(run: Run) -> TruthFile | None:
    """truth/derivatives.json of a rendered run, or None; a broken one is as good as none."""
    path = run.folder / "truth" / "derivatives.json"
    if not path.is_file():
        return None
    try:
        return read_result(path, TruthFile)
    except TowlineError:
        return None


def truth_motion(run: Run) -> pd.DataFrame | None:
    """truth/motion.csv of a rendered run (truth.csv beside run.toml is read as well), or None."""
    for path in (run.folder / "truth" / "motion.csv", run.folder / "truth.csv"):
        if path.is_file():
            try:
                return read_motion(path)
            except TowlineError:
                return None
    return None


def picture_of(run: Run, tracks: pd.DataFrame | None, share: float = 0.15) -> np.ndarray | None:
    """A frame of the run with its marks drawn, (h, w, 3) BGR; None without a video."""
    if run.file.source.video is None or tracks is None or tracks.empty:
        return None
    from .vision import draw_overlay, read_frames

    frames = np.unique(tracks["frame"].to_numpy())
    wanted = int(frames[int(share * (len(frames) - 1))])
    rows = tracks[tracks["frame"] == wanted]
    places: dict[str, np.ndarray | None] = {
        str(r.marker): np.array([r.u_px, r.v_px]) if r.status == "measured" else None for r in rows.itertuples()
    }
    t_s = float(rows["t_s"].iloc[0])
    trails = {}
    for name in places:
        path = tracks[(tracks["marker"] == name) & (tracks["status"] == "measured")]
        trails[name] = list(path[["u_px", "v_px"]].to_numpy())
    for frame in read_frames(run.source_path, (t_s - 1e-6, t_s + 1.0), run.file.source.frame_rate_hz):
        return draw_overlay(frame.bgr(), places, run.file.datum, trails, f"{run.name}  t = {frame.t_s:.2f} s")
    return None


def read_priors(path: str | Path):
    """A priors.toml."""
    from .record.priors import Priors
    from .record.toml import read_toml

    return read_toml(path, Priors)


__all__ = ["Moved", "moved", "picture_of", "read_priors", "tracked", "truth_motion", "truth_of"]
