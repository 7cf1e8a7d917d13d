"""The stage of tracks: from a run's own table, from out/, or from its video."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...record.errors import InputError
from ...record.run import RUN_FILE, Run
from ...record.tables import input_hash_of, read_tracks, write_table
from ..progress import Progress, loading, throttled
from .versions import stamp_of
from .waiting import Aside, begun

if TYPE_CHECKING:
    import pandas as pd

    from ...geometry import DatumFit
    from ...vision import ClipInfo, Frame, Tracking

TRACKS, DATUM, STATIC = "tracks.csv", "datum.csv", "static.csv"
TABLES = (".csv", ".parquet")
AMBIGUOUS = (
    "when the marks were first found, another assignment of spots to markers fitted nearly as well: check which is which, and "
    "if need be say where each marker is in the first frame (marker.seen_at_px)"
)


@dataclass(frozen=True)
class RunTracks:
    """A run with its tracks.

    Attributes
    ----------
    run : whose they are
    table : tracks, with ``reason`` (why lost) where they are towline's own
    anew : they come from the video, now; else they were read from a file
    notes : for the user; only where tracked anew
    """

    run: Run
    table: pd.DataFrame
    anew: bool = False
    notes: tuple[str, ...] = ()


def track_run(run: Run, progress: Progress | None = None, fresh: bool = False, device: str = "cpu") -> RunTracks:
    """Tracks of a run: from its own file, from out/, or from the video and then written to out/.

    Parameters
    ----------
    run : with a video or tracks
    progress : told words, frames done and frames in all, now and then
    fresh : track again even where out/ is up to date
    device : "cpu" or "cuda": where the fits run

    Raises
    ------
    InputError : the run comes with its motion, its video is not what run.toml describes, or there is no such device
    TowlineError : the video cannot be read, or no mark was found in it
    """
    if run.file.source.motion is not None:
        raise InputError(
            run.folder / RUN_FILE, "source.motion", "the run comes with its motion; there is nothing to track"
        )
    if run.file.source.tracks is not None:
        return RunTracks(run, read_tracks(run.source_path))
    from ...vision.backend import backend_for

    backend = backend_for(device)
    target = run.out / TRACKS
    if not fresh and target.is_file() and input_hash_of(target) == stamp_of(run, "tracks"):
        return RunTracks(run, read_tracks(target))
    # a large video is hashed while it is tracked; run.toml comes first, so one that is edited meanwhile is not vouched for
    stamp = Aside(lambda: stamp_of(run, "tracks"))
    found = _follow_marks(run, backend, progress)
    if found.datum is not None:
        write_table(run.out / DATUM, found.datum, stamp.result())
    write_table(target, found.table, stamp.result())  # last: its stamp vouches for both
    return RunTracks(run, found.table, True, (AMBIGUOUS,) if found.ambiguous else ())


def track_static(run: Run, progress: Progress | None = None) -> pd.DataFrame | None:
    """Tracks of the model held still ([noise] static): the run's own table, or of the video, kept in out/; None without one.

    Parameters
    ----------
    run : whose ``[noise] static`` is meant
    progress : as in ``track_run``

    Raises
    ------
    TowlineError : the table or the video cannot be used
    """
    if run.file.noise is None:
        return None
    name = run.file.noise.static
    if Path(name).suffix in TABLES:
        return read_tracks(run.path(name))
    from ...vision.backend import backend_for

    source = run.file.source.model_copy(update={"video": name, "tracks": None, "motion": None, "span_s": None})
    still = replace(run, file=run.file.model_copy(update={"source": source, "name": f"{run.name} (held still)"}))
    target, stamp = run.out / STATIC, stamp_of(still, "static")
    if input_hash_of(target) != stamp:
        write_table(target, _follow_marks(still, backend_for("cpu"), progress).table, stamp)
    return read_tracks(target)


def compute_static_motion(run: Run, progress: Progress | None = None) -> pd.DataFrame | None:
    """Motion of the model held still, seen by the run's camera; None without a static record, or where the run came as motion.

    Parameters
    ----------
    run : whose ``[noise] static`` is meant
    progress : as in ``track_run``
    """
    if run.file.source.motion is not None or run.file.noise is None:
        return None
    tracks = track_static(run, progress)
    if tracks is None:
        return None
    from ...geometry import motion_from_tracks

    return motion_from_tracks(run, tracks, fit_run_datum(run)).motion


def _follow_marks(run: Run, backend: Any, progress: Progress | None) -> Tracking:
    """Track the video of a run."""
    with begun(frames_of(run)) as frames:
        with loading("vision.tracker"):  # imported while the first frames are decoded
            from ...vision import clip_info, track
            from ...vision.recording.codecs import losses

        info = clip_info(run.source_path)
        datum = fit_run_datum(run, info)
        total = _frames_expected(run, info)

        def tell(done: int, lost: int) -> None:
            if progress is not None:
                progress(f"{run.name}: tracking, {lost} lost", done, total)

        tell(0, 0)
        found = track(run, frames, datum.mapping, throttled(tell), backend, *losses(info.codec))
        total = found.frames
        tell(found.frames, int((found.table["status"] == "lost").sum()))
    return found


def frames_of(run: Run) -> Iterator[Frame]:
    """The frames of a run's video that are analysed."""
    from ...vision import read_frames

    source = run.file.source
    return read_frames(run.source_path, source.span_s, source.frame_rate_hz, source.exposure_s)


def fit_run_datum(run: Run, info: ClipInfo | None = None) -> DatumFit:
    """Fit the camera to a run's datum points.

    Parameters
    ----------
    run : with ``[[datum]]``
    info : of its video, where that was asked for already

    Raises
    ------
    InputError : ``camera.image_size_px`` is not the video's
    """
    from ...geometry import run_datum

    if run.file.source.video is None:
        return run_datum(run, None)
    if info is None:
        from ...vision import clip_info

        info = clip_info(run.source_path)
    size_px = info.width_px, info.height_px
    if run.file.camera is not None and run.file.camera.image_size_px != size_px:
        stated = run.file.camera.image_size_px
        raise InputError(
            run.folder / RUN_FILE,
            "camera.image_size_px",
            f"{list(stated)}, but the video's picture is {info.width_px} x {info.height_px}; the lens would be another",
        )
    return run_datum(run, size_px)


def _frames_expected(run: Run, info: ClipInfo) -> int | None:
    """About how many frames will be analysed; None where the container does not say how long it is."""
    source = run.file.source
    rate_hz = source.frame_rate_hz or info.rate_hz
    # frame_rate_hz counts the frames anew: there are as many of them, on another clock
    length_s = None if info.duration_s is None else info.duration_s * info.rate_hz / rate_hz
    if source.span_s is not None:
        begin_s, end_s = source.span_s
        length_s = min(end_s, length_s or end_s) - begin_s
    return None if length_s is None else max(1, round(length_s * rate_hz))
