"""The stage of tracks: from a run's own table, from out/, or from its video."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...record.corrections import (
    Corrections,
    check_corrections,
    check_places,
    corrected,
    read_corrections,
    unreached,
    write_corrections,
)
from ...record.errors import InputError
from ...record.run import CORRECTIONS, RUN_FILE, Run
from ...record.tables import input_hash_of, notes_of, read_tracks, seen_rows, write_table
from ..mistaken import named, refuse_untouched
from ..progress import Progress, loading, throttled
from .versions import stamp_of
from .waiting import Aside, begun

if TYPE_CHECKING:
    import pandas as pd

    from ...geometry import DatumFit
    from ...vision import ClipInfo, Frame, Tracking

TRACKS, DATUM, STATIC = "tracks.csv", "datum.csv", "static.csv"
AUTOMATIC = "automatic.csv"
"""The tracks before points were set or removed by hand, so that such a correction, and taking it back, tracks nothing again."""
TABLES = (".csv", ".parquet")
ENDED_S = 0.1
"""How often it is looked whether a recording that is being written has ended."""
SEED_PX = 12.0
"""A mark measured farther than this from its seed is said to be: three standard deviations of a rough pick. A choice."""
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
    notes : for the user, on the recording and on how the marks were found
    """

    run: Run
    table: pd.DataFrame
    anew: bool = False
    notes: tuple[str, ...] = ()


def track_run(
    run: Run,
    progress: Progress | None = None,
    fresh: bool = False,
    device: str = "cpu",
    corrections: Corrections | None = None,
) -> RunTracks:
    """Tracks of a run: from its own file, from out/, or from the video and then written to out/, as corrected by hand.

    Parameters
    ----------
    run : with a video or tracks
    progress : told words, frames done and frames in all, now and then
    fresh : track again even where out/ is up to date
    device : "cpu" or "cuda": where the fits run
    corrections : all of them; written as the run's once they have served. None: those of the run folder

    Raises
    ------
    InputError : the run comes with its motion, its datum is still that of ``towline init``, its video is not what run.toml
        describes, a correction fits neither run nor video, or there is no such device
    TowlineError : the video cannot be read, or no mark was found in it
    """
    if run.file.source.motion is not None:
        raise InputError(
            run.folder / RUN_FILE, "source.motion", "the run comes with its motion; there is nothing to track"
        )
    refuse_untouched(run)
    from ...geometry.poses import missing_with_one

    alone = tuple(filter(None, [missing_with_one(run)]))
    if run.file.source.tracks is not None:
        if corrections:
            raise InputError(
                run.folder / RUN_FILE, "source.tracks", "the run comes with its tracks; no video of it is tracked again"
            )
        return RunTracks(run, read_tracks(run.source_path), notes=alone)
    from ...vision.backend import backend_for

    backend = backend_for(device)
    new, target = corrections, run.out / TRACKS
    corrections = _checked(run, new)
    # a large video is hashed while it is tracked; run.toml comes first, so one that is edited meanwhile is not vouched for
    stamp = Aside(lambda: _stamp(run, corrections.words()))
    if not fresh and target.is_file() and input_hash_of(target) == stamp.result():
        if new is not None:
            write_corrections(run.folder, corrections, run.file.outside)
        return RunTracks(run, read_tracks(target), notes=(*alone, *notes_of(target)))
    by_points = bool(corrections.point or corrections.removed)
    before = stamp if not by_points else Aside(lambda: _stamp(run, corrections.words(points=False)))
    kept = None if fresh else _kept(run, before)
    datum = None
    if kept is not None:
        table, said = read_tracks(kept), notes_of(kept)
    else:
        found = _follow_marks(run, backend, progress, corrections)
        table, datum = found.table, found.datum
        said = (*found.notes, *((AMBIGUOUS,) if found.ambiguous else ()))
    notes = tuple(dict.fromkeys((*said, *_reached(run, corrections, table, asked=new is not None))))
    if new is not None:
        write_corrections(run.folder, corrections, run.file.outside)
    if datum is not None:
        write_table(run.out / DATUM, datum, before.result())
    if by_points:
        write_table(run.out / AUTOMATIC, table, before.result(), said)
        table = corrected(table, corrections)
    write_table(target, table, stamp.result(), notes)  # last: its stamp vouches for all
    return RunTracks(run, table, True, alone + notes)


def _stamp(run: Run, corrections: tuple[str, ...]) -> str:
    """Of tracks with these corrections, whose file may be written later; without any, as if there were none."""
    return stamp_of(run, "tracks", *corrections, without=(CORRECTIONS,))


def _checked(run: Run, corrections: Corrections | None) -> Corrections:
    """Corrections that fit the run and its picture: those given, else those of the run folder."""
    if corrections is None:
        corrections = read_corrections(run)
    else:
        check_corrections(corrections, run.file.marker, run.folder / CORRECTIONS)
    if corrections.seed or corrections.point:
        from ...vision import clip_info

        info = clip_info(run.source_path)
        check_places(corrections, (info.width_px, info.height_px), run.folder / CORRECTIONS)
    return corrections


def _kept(run: Run, stamp: Aside) -> Path | None:
    """The tracks in out/ before points were set by hand, where they are up to date with all that was tracked beside them."""
    there = [path for path in (run.out / AUTOMATIC, run.out / TRACKS) if path.is_file()]
    if not there:  # the video is hashed while it is tracked
        return None
    now = stamp.result()
    if any(point.track for point in run.file.datum) and input_hash_of(run.out / DATUM) != now:
        return None
    return next((path for path in there if input_hash_of(path) == now), None)


def _reached(run: Run, corrections: Corrections, table: pd.DataFrame, asked: bool) -> tuple[str, ...]:
    """Corrections that did not do what they were made for, as notes; InputError where a frame is none of the recording."""
    path, notes = run.folder / CORRECTIONS, []
    frames = table["frame"].astype(int)
    first, last = int(frames.min()), int(frames.max())
    for where, frame in unreached(corrections, set(frames)):
        span = run.file.source.span_s
        words = f"frame {frame} is none of the analysed frames {first} to {last}"
        if asked or span is None or first <= frame <= last:
            raise InputError(path, where, words + (f" (source.span_s = {list(span)})" if span else ""))
        notes.append(f"{CORRECTIONS}: {where}: {words}; it waits there")
    for seed in corrections.seed:
        rows = table[(frames == seed.frame) & (table["marker"] == seed.marker)]
        if rows.empty:
            continue
        if not seen_rows(rows)[0]:
            why = rows["reason"].iloc[0] if "reason" in rows else ""
            notes.append(
                f"{seed.marker} was not found at its seed in frame {seed.frame}" + (f" ({why})" if why else "")
            )
            continue
        away = float(((rows[["u_px", "v_px"]].iloc[0] - list(seed.pixel_px)) ** 2).sum() ** 0.5)
        if away > SEED_PX:
            notes.append(f"{seed.marker} was found {away:.0f} px from its seed in frame {seed.frame}")
    return tuple(notes)


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
    target, stamp = run.out / STATIC, stamp_of(still, "static", without=(CORRECTIONS,))
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


def track_growing(run: Run, ended: Callable[[], bool]) -> None:
    """Track a video that is still being written, and keep the tracks as ``track_run`` would have made them of the whole.

    Parameters
    ----------
    run : its recording is there, if only its beginning
    ended : whether the recording is whole

    Raises
    ------
    TowlineError : the video cannot be read, or no mark was found in it
    """
    from ...vision.backend import NUMPY
    from ...vision.recording.decode import video_frames
    from ...vision.recording.growing import Growing

    path, source = run.source_path, run.file.source
    frames = video_frames(
        path, source.span_s, source.frame_rate_hz, source.exposure_s, None, lambda: Growing(path, ended)
    )
    found = _follow_marks(run, NUMPY, None, frames=frames)
    while not ended():  # the rest holds nothing that is analysed
        time.sleep(ENDED_S)
    notes = (*found.notes, *((AMBIGUOUS,) if found.ambiguous else ()))
    stamp = _stamp(run, ())
    if found.datum is not None:
        write_table(run.out / DATUM, found.datum, stamp)
    write_table(run.out / TRACKS, found.table, stamp, notes)


def _follow_marks(
    run: Run,
    backend: Any,
    progress: Progress | None,
    corrections: Corrections | None = None,
    frames: Iterator[Frame] | None = None,
) -> Tracking:
    """Track the video of a run, from its seeds on anew; ``frames`` instead of reading it."""
    with begun(frames_of(run) if frames is None else frames) as frames:
        with loading("vision.tracker"):  # imported while the first frames are decoded
            from ...vision import clip_info, track
            from ...vision.recording.codecs import losses

        info = clip_info(run.source_path)
        datum = fit_run_datum(run, info)
        total = _frames_expected(run, info)

        def tell(done: int, lost: int) -> None:
            if progress is not None:
                progress(f"{run.name}: tracking, {lost} lost", done, total)

        seeds = () if corrections is None else corrections.seed
        tell(0, 0)
        with named(run):
            found = track(run, frames, datum.mapping, throttled(tell), backend, *losses(info.codec), seeds)
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
        with named(run):
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
    with named(run):
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
