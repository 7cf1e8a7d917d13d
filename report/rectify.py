"""A run's recording from above and its scale grid: out/top.png, out/top.mp4, out/grid.png."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..geometry import DatumFit, run_datum
from ..geometry.camera import Array
from ..record.errors import GeometryError, InputError, VideoError
from ..record.files import replacing
from ..record.run import RUN_FILE, Run
from ..record.tables import read_table
from ..vision.recording import ClipInfo, Frame, clip_info, read_frames
from .scale_grid import draw_grid
from .topview import Area, TopView, area_around, top_view

STILL, FILM, GRID = "top.png", "top.mp4", "grid.png"
MARKS = "marks.csv"


@dataclass(frozen=True)
class Wanted:
    """What to make.

    Attributes
    ----------
    depth_m : of the plane below the datum; None: the mean depth of the model's markers
    area_m : x0, x1, y0, y1; None: around the datum points and the marks' places (out/marks.csv, if there)
    mm_per_px : of the top view; None: as fine as the picture
    frame, time_s : of the stills: the frame of this number, the first one at or after this time; neither: the first analysed
    film, grid : also out/top.mp4, also out/grid.png
    """

    depth_m: float | None = None
    area_m: tuple[float, float, float, float] | None = None
    mm_per_px: float | None = None
    frame: int | None = None
    time_s: float | None = None
    film: bool = False
    grid: bool = False


@dataclass(frozen=True)
class Rectified:
    """What was made.

    Attributes
    ----------
    paths : the files written
    view : the top view
    frame, t_s : of the stills
    notes : of the datum, for the user
    """

    paths: tuple[Path, ...]
    view: TopView
    frame: int
    t_s: float
    notes: tuple[str, ...]


def rectify(run: Run, wanted: Wanted, progress: Callable[[int], None] | None = None) -> Rectified:
    """Make the top view of a run, and what else is wanted.

    Parameters
    ----------
    run : the run folder as read
    wanted : area, scale and frame
    progress : called with the frames of the film done

    Raises
    ------
    InputError : no video, the picture has another size than [camera] says, or the area or scale cannot be shown
    VideoError : the video cannot be read, or does not hold the frame
    """
    if run.file.source.video is None:
        raise InputError(run.folder / RUN_FILE, "source.video", "missing key; a top view needs the recording")
    info = clip_info(run.source_path)
    size_px = info.width_px, info.height_px
    if run.file.camera is not None and run.file.camera.image_size_px != size_px:
        stated = list(run.file.camera.image_size_px)
        raise InputError(
            run.folder / RUN_FILE, "camera.image_size_px", f"{stated}, but the video's picture is {list(size_px)}"
        )
    datum = run_datum(run, size_px)
    try:
        area = _area(run, wanted)
        view = top_view(datum.mapping, area, size_px, wanted.mm_per_px)
    except GeometryError as error:
        raise InputError(run.folder, "", str(error)) from None
    frame = chosen_frame(run, wanted.frame, wanted.time_s)
    paths = _stills(run, wanted, datum, view, frame)
    if wanted.film:
        _film(run, view, info, progress)
        paths.append(run.out / FILM)
    return Rectified(tuple(paths), view, frame.index, frame.t_s, datum.notes)


def _area(run: Run, wanted: Wanted) -> Area:
    depth = wanted.depth_m
    if depth is None:
        depth = float(np.mean([m.depth_m for m in run.file.marker if m.on == "model"]))
    if wanted.area_m is not None:
        x0, x1, y0, y1 = wanted.area_m
        return Area((x0, x1), (y0, y1), depth)
    return area_around(run.file.datum, depth, _marks(run))


def _marks(run: Run) -> Array | None:
    """The marks' places of an earlier evaluation, (n, 2) m; None where there is none."""
    path = run.out / MARKS
    if not path.is_file():
        return None
    return read_table(path, ("x_m", "y_m"))[["x_m", "y_m"]].to_numpy(dtype=float)


def chosen_frame(run: Run, frame: int | None = None, time_s: float | None = None) -> Frame:
    """The frame of this number, or the first one at or after this time, or the first analysed one.

    Parameters
    ----------
    run : the run folder as read
    frame : its number, or None
    time_s : its time, or None

    Raises
    ------
    VideoError : there is none
    """
    source = run.file.source
    span, where = source.span_s, "no frame"
    if frame is not None:
        span, where = None, f"no frame {frame}"
    elif time_s is not None:
        stamped_s = time_s - source.exposure_s / 2
        span, where = (stamped_s - 1e-6, stamped_s + 3600.0), f"no frame at or after {time_s:g} s"
    frames = read_frames(run.source_path, span, source.frame_rate_hz, source.exposure_s)
    try:
        for found in frames:
            if frame is None or found.index >= frame:
                if frame is None or found.index == frame:
                    return found
                raise VideoError(f"{run.source_path}: frame {frame} could not be decoded")
    finally:
        _close(frames)
    raise VideoError(f"{run.source_path}: {where}")


def _close(frames: Iterator[Frame]) -> None:
    close = getattr(frames, "close", None)
    if close is not None:
        close()


def _stills(run: Run, wanted: Wanted, datum: DatumFit, view: TopView, frame: Frame) -> list[Path]:
    from ..vision.sheet import write_sheet

    picture = frame.bgr()
    write_sheet(run.out / STILL, view.annotated(picture, _caption(view, frame)))
    paths = [run.out / STILL]
    if wanted.grid:
        drawn = draw_grid(picture, datum.mapping, view.area, run.file.datum, datum.residual_px, f"frame {frame.index}")
        write_sheet(run.out / GRID, drawn)
        paths.append(run.out / GRID)
    return paths


def _caption(view: TopView, frame: Frame) -> str:
    return f"z = {view.area.depth_m:g} m  {view.mm_per_px:g} mm/px  frame {frame.index}  t = {frame.t_s:.3f} s"


def _film(run: Run, view: TopView, info: ClipInfo, progress: Callable[[int], None] | None) -> None:
    """The analysed frames from above, with their own times, whole or not at all."""
    import av

    from ..vision.overlay import Encoder

    source = run.file.source
    with replacing(run.out / FILM) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        encoder = Encoder(container, source.frame_rate_hz or info.rate_hz)
        count = 0
        for frame in read_frames(run.source_path, source.span_s, source.frame_rate_hz, source.exposure_s):
            encoder.put(view.annotated(frame.bgr(), _caption(view, frame)), frame.t_s)
            count += 1
            if progress is not None:
                progress(count)
        if not count:
            raise VideoError(f"{run.source_path}: no frame to draw")
        encoder.finish()
