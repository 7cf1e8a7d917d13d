"""The stages of a run - tracks, motion - each redone only when its inputs, options or the version changed.

Every stage writes into RUN/out/ with the hash of what it was made from in the file's first line; a stage whose hash still
matches is read back. Video -> tracks -> motion; what comes after takes several runs and stands in ``cli``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from sys import getswitchinterval, setswitchinterval
from threading import Thread
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from .. import __version__
from ..record.errors import InputError, TowlineError
from ..record.files import read_array, sha256_of_texts, write_array
from ..record.results import CameraFile, TruthFile, read_result, write_result
from ..record.run import RUN_FILE, Run
from ..record.tables import input_hash_of, read_motion, read_tracks, write_table
from .progress import Progress, loading, throttled

if TYPE_CHECKING:
    import pandas as pd

    from ..geometry import DatumFit
    from ..report import RunPage
    from ..vision import ClipInfo, Frame, Tracking

TRACKS, MARKS, MOTION, CAMERA = "tracks.csv", "marks.csv", "motion.csv", "camera.json"
COMMON, LAG = "motion_common.npy", "motion_lag.npy"
DATUM, STATIC = "datum.csv", "static.csv"
TABLES = (".csv", ".parquet")
OVERLAY, SHEET = "overlay.mp4", "worst.png"
# fmt: off
LOSSLESS = frozenset({
    "rawvideo", "ffv1", "huffyuv", "ffvhuff", "hymt", "utvideo", "magicyuv", "lagarith", "vble", "loco", "zlib",
    "mszh", "zmbv", "qtrle", "png", "apng", "tiff", "bmp", "dpx", "targa", "sgi", "ppm", "pgm", "pam", "r10k",
    "r210", "v210", "v210x", "v308", "v408", "v410", "y41p", "yuv4",
})
# fmt: on
"""Codecs, by ffmpeg's names, that keep every pixel; others may be set to, but their files do not say so."""
INTRA = frozenset(
    {"mjpeg", "mjpegb", "ljpeg", "jpegls", "jpeg2000", "prores", "dnxhd", "dvvideo", "cfhd", "webp", "gif"}
)
"""Codecs with loss that make no picture from another."""
AMBIGUOUS = (
    "when the marks were first found, another assignment of spots to markers fitted nearly as well: check which is which, and "
    "if need be say where each marker is in the first frame (marker.seen_at_px)"
)
MOTION_ROOMS = ("record", "geometry", "vision")
SWITCH_S = 3e-4
"""How long one thread may keep Python to itself while another waits: the decoder needs it for 0.3 ms in every frame's 3 ms, and
with Python's own 5 ms decoding beside tracking is half as fast."""
T = TypeVar("T")


@dataclass(frozen=True)
class Tracked:
    """A run with its tracks.

    Attributes
    ----------
    table : tracks, with ``reason`` (why lost) where they are towline's own
    anew : they come from the video, now; else they were read from a file
    notes : for the user; only where tracked anew
    """

    run: Run
    table: pd.DataFrame
    anew: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Moved:
    """A run with its motion.

    Attributes
    ----------
    motion : motion table
    common, lag : (k, n, 3), (l, n, 3), modes of (y_cg, beta, alpha) as in ``geometry.Motion``; None where the motion came from
        outside
    camera : camera file; None where the motion came from outside
    tracks : None where the motion came from outside
    """

    run: Run
    motion: pd.DataFrame
    common: np.ndarray | None
    camera: CameraFile | None
    tracks: pd.DataFrame | None
    lag: np.ndarray | None = None


# tracks ------------------------------------------------------------------------------------------------------------


def tracked(run: Run, progress: Progress | None = None, fresh: bool = False, device: str = "cpu") -> Tracked:
    """Tracks of a run: from its own file, from out/, or from the video and then written to out/.

    Parameters
    ----------
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
        return Tracked(run, read_tracks(run.source_path))
    from ..vision.backend import backend_for

    backend = backend_for(device)
    target = run.out / TRACKS
    if not fresh and target.is_file() and input_hash_of(target) == _tracks_hash(run):
        return Tracked(run, read_tracks(target))
    # a large video is hashed while it is tracked; run.toml comes first, so one that is edited meanwhile is not vouched for
    stamp = _Aside(lambda: _tracks_hash(run))
    found = _follow_marks(run, backend, progress)
    if found.datum is not None:
        write_table(run.out / DATUM, found.datum, stamp.result())
    write_table(target, found.table, stamp.result())  # last: its stamp vouches for both
    return Tracked(run, found.table, True, (AMBIGUOUS,) if found.ambiguous else ())


def static_tracks(run: Run, progress: Progress | None = None) -> pd.DataFrame | None:
    """Tracks of the model held still ([noise] static): the run's own table, or of the video, kept in out/; None without one.

    Raises
    ------
    TowlineError : the table or the video cannot be used
    """
    if run.file.noise is None:
        return None
    name = run.file.noise.static
    if Path(name).suffix in TABLES:
        return read_tracks(run.path(name))
    from ..vision.backend import backend_for

    source = run.file.source.model_copy(update={"video": name, "tracks": None, "motion": None, "span_s": None})
    still = replace(run, file=run.file.model_copy(update={"source": source, "name": f"{run.name} (held still)"}))
    target, stamp = run.out / STATIC, still.input_hash("static", code_hash())
    if input_hash_of(target) != stamp:
        write_table(target, _follow_marks(still, backend_for("cpu"), progress).table, stamp)
    return read_tracks(target)


def static_motion(run: Run, progress: Progress | None = None) -> pd.DataFrame | None:
    """Motion of the model held still, seen by the run's camera; None without a static record, or where the run came as motion."""
    if run.file.source.motion is not None or run.file.noise is None:
        return None
    tracks = static_tracks(run, progress)
    if tracks is None:
        return None
    from ..geometry import motion_from_tracks

    return motion_from_tracks(run, tracks, datum_of(run)).motion


def _tracks_hash(run: Run) -> str:
    return run.input_hash("tracks", code_hash())


def _follow_marks(run: Run, backend: Any, progress: Progress | None) -> Tracking:
    """Track the video of a run."""
    with _begun(_frames(run)) as frames:
        with loading("vision.tracker"):  # imported while the first frames are decoded
            from ..vision import clip_info, track

        info = clip_info(run.source_path)
        datum = datum_of(run, info)
        total = _frames_expected(run, info)

        def tell(done: int, lost: int) -> None:
            if progress is not None:
                progress(f"{run.name}: tracking, {lost} lost", done, total)

        tell(0, 0)
        found = track(run, frames, datum.mapping, throttled(tell), backend, *losses(info.codec))
        total = found.frames
        tell(found.frames, int((found.table["status"] == "lost").sum()))
    return found


def losses(codec: str) -> tuple[bool, bool]:
    """Whether a codec, by ffmpeg's name, compresses with loss, and whether it then makes pictures from others."""
    lossy = codec not in LOSSLESS
    return lossy, lossy and codec not in INTRA


def _frames(run: Run) -> Iterator[Frame]:
    """The frames of a run's video that are analysed."""
    from ..vision import read_frames

    source = run.file.source
    return read_frames(run.source_path, source.span_s, source.frame_rate_hz, source.exposure_s)


class _Aside(Generic[T]):
    """A call under way in a thread of its own."""

    def __init__(self, call: Callable[[], T]) -> None:
        self._call = call
        self._answer: list[T] = []
        self._error: BaseException | None = None
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            self._answer.append(self._call())
        except BaseException as error:
            self._error = error

    @property
    def done(self) -> bool:
        """It has ended, well or not."""
        return not self._thread.is_alive()

    def result(self) -> T:
        """Wait for it; hand over what it returned or raise what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._answer[0]


@contextmanager
def _begun(frames: Iterator[Frame]) -> Iterator[Iterator[Frame]]:
    """Have the first frames decoded while the rest is made ready; decoding ends with the block."""
    first = _Aside(lambda: next(frames, None))

    def coming() -> Iterator[Frame]:
        frame = first.result()
        while frame is not None:
            yield frame
            frame = next(frames, None)

    before_s = getswitchinterval()
    setswitchinterval(SWITCH_S)
    try:
        yield coming()
    finally:
        setswitchinterval(before_s)
        close: Callable[[], None] | None = getattr(frames, "close", None)
        if close is not None and first.done:  # else its thread is the last to hold it, and closes it by letting go
            close()


def datum_of(run: Run, info: ClipInfo | None = None) -> DatumFit:
    """The fitted datum of a run; ``info`` of its video, if it has one."""
    from ..geometry import run_datum

    if run.file.source.video is None:
        return run_datum(run, None)
    if info is None:
        from ..vision import clip_info

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


@cache
def code_hash(*rooms: str) -> str:
    """Hash of the code of rooms (none: those behind tracks and motion): results of another version, or of another day's checkout,
    are redone.
    """
    house = Path(__file__).parent.parent
    paths = sorted(path for room in rooms or MOTION_ROOMS for path in (house / room).rglob("*.py"))
    return sha256_of_texts(__version__, *(path.read_text(encoding="utf-8") for path in paths))


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


def draw(found: Tracked, overlay: bool = True, sheet: bool = True, progress: Progress | None = None) -> list[Path]:
    """Draw the tracks of a video over it, in one more pass; what is not older than the tracks stays as it is.

    Parameters
    ----------
    overlay, sheet : write out/overlay.mp4 (all frames), out/worst.png (the worst frames on one sheet)

    Returns
    -------
    list : the files that were written

    Raises
    ------
    TowlineError : the video cannot be read
    """
    run, table = found.run, found.table
    overlay = overlay and not _drawn_before(run.out / OVERLAY, found)
    sheet = sheet and not _drawn_before(run.out / SHEET, found)
    if not overlay and not sheet:
        return []
    from ..vision import clip_info
    from ..vision.overlay import write_overlay
    from ..vision.sheet import Sheet, worst_frames, write_sheet

    total = int(table["frame"].nunique())
    tiles = Sheet(table, worst_frames(table), f"{run.name}: the worst of {total} frames")

    def tell(done: int, _: int) -> None:
        if progress is not None:
            progress(f"{run.name}: drawing", done, total)

    tell(0, 0)
    sometimes = throttled(tell)

    def watched() -> Iterator[Frame]:
        for done, frame in enumerate(_frames(run), 1):
            complete = tiles.look(frame)
            yield frame
            sometimes(done, 0)
            if complete and not overlay:
                return

    if overlay:
        rate_hz = run.file.source.frame_rate_hz or clip_info(run.source_path).rate_hz
        write_overlay(run.out / OVERLAY, watched(), table, run.file.datum, rate_hz)
    else:
        for _ in watched():
            pass
    if sheet:
        write_sheet(run.out / SHEET, tiles.picture())
    tell(total, 0)
    return [run.out / name for name, wanted in ((OVERLAY, overlay), (SHEET, sheet)) if wanted]


def _drawn_before(path: Path, found: Tracked) -> bool:
    """The drawing shows these tracks: it was made after them."""
    return not found.anew and path.is_file() and path.stat().st_mtime_ns >= (found.run.out / TRACKS).stat().st_mtime_ns


# motion ------------------------------------------------------------------------------------------------------------


def _kept(run: Run, paths: dict[str, Path], tracks: pd.DataFrame) -> Moved | None:
    """The motion as it stands; None where a file of it is damaged, so that it is made anew."""
    try:
        common, lag = (read_array(paths[name]) for name in (COMMON, LAG))
        motion, camera = read_motion(paths[MOTION]), read_result(paths[CAMERA], CameraFile)
    except (OSError, ValueError, EOFError, TowlineError):
        return None
    whole = common.shape[1:] == lag.shape[1:] == (len(motion), 3)
    return Moved(run, motion, common, camera, tracks, lag) if whole else None


def moved(run: Run, method: str = "exact", progress: Progress | None = None, fresh: bool = False) -> Moved:
    """Motion of a run, from its own file, from out/ or from its tracks."""
    if run.file.source.motion is not None:
        return Moved(run, _in_span(run, read_motion(run.source_path)), None, None, None)
    found = tracked(run, progress, fresh)
    # as they stand in the file: the motion is the same whether they were tracked now or before
    tracks = read_tracks(run.out / TRACKS) if found.anew else found.table
    stamp = run.input_hash("motion", code_hash(), method)
    paths = {name: run.out / name for name in (MARKS, MOTION, COMMON, LAG, CAMERA)}
    if not fresh and input_hash_of(paths[MOTION]) == stamp and all(p.is_file() for p in paths.values()):
        kept = _kept(run, paths, tracks)
        if kept is not None:
            return kept
    if progress is not None:
        progress(f"{run.name}: motion", 0, None)
    from ..geometry import motion_from_tracks

    refound = run.out / DATUM
    moving = run.file.source.video is not None and any(p.track for p in run.file.datum) and refound.is_file()
    datum_tracks = read_tracks(refound) if moving else None
    result = motion_from_tracks(run, tracks, datum_of(run), method, __version__, run.input_hashes(), datum_tracks)
    write_table(paths[MARKS], result.marks, stamp)
    write_result(paths[CAMERA], result.camera)
    for name, modes in ((COMMON, result.common), (LAG, result.lag)):
        write_array(paths[name], modes)
    write_table(paths[MOTION], result.motion, stamp)  # last: its stamp vouches for the others
    return Moved(run, read_motion(paths[MOTION]), result.common, result.camera, tracks, result.lag)


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


def run_page(m: Moved, fitted: pd.DataFrame | None, problem: str | None) -> RunPage:
    """What a page shows of a run: its picture, tracks and motion beside a fit, or why there is none."""
    from ..report import RunPage

    return RunPage(
        m.run.name, picture_of(m.run, m.tracks), m.tracks, m.motion, fitted, truth_motion(m.run), m.camera, problem
    )


def picture_of(run: Run, tracks: pd.DataFrame | None, share: float = 0.15) -> np.ndarray | None:
    """A frame of the run with its marks drawn, (h, w, 3) BGR; None without a video."""
    if run.file.source.video is None or tracks is None or tracks.empty:
        return None
    from ..vision import draw_overlay, read_frames

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
    source = run.file.source
    stamped_s = t_s - source.exposure_s / 2
    for frame in read_frames(
        run.source_path, (stamped_s - 1e-6, stamped_s + 1.0), source.frame_rate_hz, source.exposure_s
    ):
        return draw_overlay(frame.bgr(), places, run.file.datum, trails, f"{run.name}  t = {frame.t_s:.2f} s")
    return None


def read_priors(path: str | Path):
    """A priors.toml."""
    from ..record.priors import Priors
    from ..record.toml import read_toml

    return read_toml(path, Priors)


__all__ = [
    "Moved",
    "Tracked",
    "code_hash",
    "datum_of",
    "draw",
    "moved",
    "picture_of",
    "read_priors",
    "run_page",
    "tracked",
    "truth_motion",
    "truth_of",
]
