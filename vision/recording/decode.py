"""A video file frame by frame: luma, true presentation time, and one clear line when it cannot be read."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from io import RawIOBase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...record.errors import VideoError
from ...record.files import refusal
from .clock import GOES_ON, Clock
from .ledger import OrderError, Picture, Places
from .luma import WHITE_FULL_DN, luma, quarters, turned, white_dn
from .matroska import MatroskaSums
from .mp4 import IndexDoubt, contradiction
from .pictures import USUAL_RATE_HZ, Doubt, Stream, mean_rate

LISTS_OF_FILES = frozenset(
    {
        "concat",
        "dash",
        "hls",
        "image2",
        "imf",
        "rtp",
        "rtsp",
        "sap",
        "sdp",
        "tedcaptions",
        "vobsub",
        "webm_dash_manifest",
    }
)
"""Formats, by ffmpeg's names, whose pictures stand in other files or come from a network."""

INTERLACED = (
    "its pictures are interlaced (odd rows half a frame before or after the even ones): a mark that moves is drawn twice; film "
    "progressive, or turn each field into a frame first"
)
"""Said of a recording whose pictures are marked so."""


@dataclass(frozen=True)
class ClipInfo:
    """What the recording says of itself.

    Attributes
    ----------
    width_px, height_px : of the upright picture
    rate_hz : mean frame rate
    duration_s : stated length; None where it does not say
    codec : by ffmpeg's name: it says whether pixels were lost (``codecs.losses``); "rawvideo": none were
    """

    width_px: int
    height_px: int
    rate_hz: float
    duration_s: float | None
    codec: str


@dataclass(frozen=True)
class Frame:
    """One picture.

    Attributes
    ----------
    index : from 0 in the recording, whatever the span; one that could not be decoded is missing, and the next keeps its own number
    t_s : presentation time from the recording's start (of the exposure's middle, where the exposure is given)
    luma : (h, w) uint8, upright, read-only; a view of ``raw`` where that can be, valid as long as the frame is held
    raw : the decoder's frame, an ``av.VideoFrame``
    damaged : the picture, or one it may predict from, could not be decoded as it was written
    white_dn : luma of white: 235 where the recording has limited range, 255 for full range; values stay as decoded
    notes : what is doubtful about the recording, one line each, with the first frame by which it is known
    on_arrival : the source stamps nothing: ``t_s`` is when the picture came
    """

    index: int
    t_s: float
    luma: NDArray[np.uint8]
    raw: Any
    damaged: bool = False
    white_dn: int = WHITE_FULL_DN
    notes: tuple[str, ...] = ()
    on_arrival: bool = False

    def bgr(self) -> NDArray[np.uint8]:
        """The picture in colour, upright, (h, w, 3) uint8."""
        return turned(self.raw.to_ndarray(format="bgr24"), self.raw)

    @property
    def stamp(self) -> int | None:
        """Timestamp by which the picture is found again in its container; None: by reading from the start."""
        return getattr(self.raw, "pts", None)


def frame_of(picture: NDArray[Any], index: int, t_s: float) -> Frame:
    """A frame of a picture in memory.

    Parameters
    ----------
    picture : (h, w) uint8 or uint16 grey, or (h, w, 3) uint8 BGR
    index : its number, from 0
    t_s : its time
    """
    import av

    kind = "bgr24" if picture.ndim == 3 else "gray16le" if picture.dtype == np.uint16 else "gray"
    raw = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format=kind)
    return Frame(index, t_s, luma(raw), raw, False, white_dn(raw))


def video_info(path: str | Path) -> ClipInfo:
    """Read the container's header, and the first picture for the way it is turned.

    Parameters
    ----------
    path : of the file

    Raises
    ------
    VideoError : no such file, empty, no video, no video stream
    """
    with opened(path) as container:
        info = _info(container, path)
        first = next(iter(Stream(container, 1, believe_stamps=False)), None)
        if first is not None and quarters(first.raw) % 2:
            return replace(info, width_px=info.height_px, height_px=info.width_px)
        return info


def video_frames(
    path: str | Path,
    span_s: tuple[float, float] | None = None,
    frame_rate_hz: float | None = None,
    exposure_s: float = 0.0,
    decode_threads: int | None = None,
    growing: Callable[[], RawIOBase] | None = None,
) -> Iterator[Frame]:
    """Decode the frames in ``span_s`` one by one, as ``source.read_frames`` has it, when they are asked for.

    Read in haste; at the first sign of damage, or where pictures and their timestamps are in different orders, begin again with
    care, and go on where the first reading had come to.

    Parameters
    ----------
    path : of the file
    span_s : first and last time wanted, s, in the recording's own time: as stamped, before ``exposure_s`` moves it; None = all
    frame_rate_hz : replaces the container's timestamps by index/rate
    exposure_s : exposure time; half of it is added to the stamped time, which is taken as the exposure's start
    decode_threads : decoder threads; None = as many as help. Where several would hide damage (HEVC; H.264 with B frames once an
        error has shown) one works
    growing : opens the file where it is still being written, so that reading waits for what comes (``Growing``)

    Raises
    ------
    VideoError : it cannot be read, or holds no frame
    """
    said, waiting = set[str](), list[str]()
    given, last_s = 0, -math.inf
    haste, places = True, None
    while True:
        try:
            with closing(
                _decoded_once(path, span_s, frame_rate_hz, exposure_s, decode_threads, haste, places, growing)
            ) as frames:
                for number, frame in enumerate(frames):
                    waiting += [note for note in frame.notes if note not in said]
                    said.update(frame.notes)
                    if number >= given and frame.t_s > last_s:
                        named = tuple(f"{Path(path).name}: {words}" for words in waiting)
                        yield replace(frame, notes=named) if named or frame.notes else frame
                        last_s = frame.t_s
                        waiting.clear()
                    given = max(given, number + 1)
            return
        except Doubt:
            haste = False
        except OrderError as error:
            haste, places = False, _places(path, growing)
            waiting.append(str(error))


def _places(path: str | Path, growing: Callable[[], RawIOBase] | None) -> Places:
    """The timestamps of all pictures that are shown, without decoding one."""
    import av.error

    stamps: list[int] = []
    with opened(path, file=growing) as container, suppress(av.error.FFmpegError):
        stamps.extend(
            packet.pts
            for packet in container.demux(container.streams.video[0])
            if packet.size and packet.pts is not None and not packet.is_discard
        )
    in_order = sorted(stamps)
    return Places(in_order, in_order == stamps)


def _decoded_once(
    path: str | Path,
    span_s: tuple[float, float] | None,
    frame_rate_hz: float | None,
    exposure_s: float,
    decode_threads: int | None,
    haste: bool,
    places: Places | None,
    growing: Callable[[], RawIOBase] | None,
) -> Generator[Frame]:
    wrong = contradiction(path) if refusal(path) is None else None
    # where the index is wrong and frames are counted instead, an edit list that shows all would cut by wrong times
    counted = frame_rate_hz is not None and wrong is not None and not wrong.cuts
    with opened(path, {"ignore_editlist": "1"} if counted else {}, growing) as container:
        info = _info(container, path)
        summed = growing is None  # what is not written yet has no sum
        sums = MatroskaSums(path) if summed and "matroska" in container.format.name.split(",") else None
        with closing(sums) if sums is not None else nullcontext():
            damaged_at = sums.damaged_at if sums is not None else None
            stream = Stream(container, decode_threads, damaged_at, frame_rate_hz is None, haste, places)
            clock = Clock(path, container, stream, info.duration_s, frame_rate_hz)
            doubts = _index_doubts(container, wrong, sums) if frame_rate_hz is None else ()
            yield from _noted(_in_span(clock, stream, span_s, exposure_s), doubts)


def _noted(frames: Iterable[Frame], notes: tuple[str, ...]) -> Iterator[Frame]:
    """The first frame says ``notes``."""
    for frame in frames:
        yield replace(frame, notes=(*notes, *frame.notes)) if notes else frame
        notes = ()


def _in_span(clock: Clock, stream: Stream, span_s: tuple[float, float] | None, exposure_s: float) -> Iterator[Frame]:
    """Frames of the span; the last one of the recording says how it ended."""
    held: Frame | None = None
    for picture, t_s in clock.timed(_of_one_size(stream)):
        if span_s is not None and t_s < span_s[0]:
            continue
        if held is not None:
            yield held
            held = None
        if span_s is not None and t_s > span_s[1]:
            return
        raw = picture.raw
        notes = (*clock.new_notes(), *_looks(raw), *_joints(stream, picture))
        held = Frame(
            picture.index,
            t_s + exposure_s / 2,
            luma(raw),
            raw,
            picture.damaged,
            white_dn(raw),
            notes,
            clock.on_arrival,
        )
    clock.check_end(span_s[1] if span_s is not None else None, _reason(stream.stopped_by))
    notes = clock.new_notes()
    if notes and stream.in_haste:
        raise Doubt
    if held is not None:
        yield replace(held, notes=(*held.notes, *notes))


def _looks(raw: Any) -> tuple[str, ...]:
    """What the user should know of how the pictures were taken."""
    if raw.interlaced_frame:
        return (INTERLACED,)
    return ()


def _joints(stream: Stream, picture: Picture) -> tuple[str, ...]:
    """Where the recording was put together of several."""
    begun = [number for number in stream.begun_again if number <= picture.number]
    return tuple(
        f"its clock begins again near frame {number}, as of files put one behind the other; {GOES_ON}"
        for number in begun
    )


def _of_one_size(pictures: Iterable[Picture]) -> Iterator[Picture]:
    """Leave out pictures of another size: a damaged header; were it a real change, no calibration would hold."""
    size: tuple[int, int] | None = None
    for picture in pictures:
        size = size or (picture.raw.width, picture.raw.height)
        if (picture.raw.width, picture.raw.height) == size:
            yield picture


def _index_doubts(container: Any, index: IndexDoubt | None, sums: MatroskaSums | None) -> tuple[str, ...]:
    """Where the container's statements on time contradict each other: one line each."""
    wrong = index.words if index is not None else None
    if sums is not None and sums.timing_damaged:
        wrong = "the header does not match its checksum"
    elif sums is not None and sums.start_damaged and container.streams.video[0].start_time:
        wrong = "the first cluster does not match its checksum"
    if wrong is None:
        return ()
    return (f"the index is doubtful, no time in it is sure: {wrong}; source.frame_rate_hz would count frames instead",)


def opened(path: str | Path, options: dict[str, str] | None = None, file: Callable[[], RawIOBase] | None = None) -> Any:
    """A video file's container, open; to be closed by who asks.

    Parameters
    ----------
    path : of the file
    options : of the container, by ffmpeg's names
    file : opens it instead of the system

    Raises
    ------
    VideoError : it cannot be read, or holds no video
    """
    import av
    import av.error

    path = Path(path)
    wrong = refusal(path)
    if wrong is not None:
        raise VideoError(f"{path}: {wrong}")
    if path.stat().st_size == 0:
        raise VideoError(f"{path}: is empty")
    try:
        # absolute: a name such as "concat:a|b" would be taken for a protocol
        container = av.open(
            os.path.abspath(path) if file is None else file(),
            options={"format_whitelist": _formats(), **(options or {})},
            metadata_errors="replace",
        )
    except (av.error.FFmpegError, ValueError) as error:
        raise VideoError(f"{path}: is not a video that can be read, or is cut short ({_reason(error)})") from None
    if not container.streams.video or container.streams.video[0].codec_context is None:
        held = "no video stream" if not container.streams.video else "a video of a kind that cannot be decoded"
        container.close()
        raise VideoError(f"{path}: holds {held}")
    return container


@cache
def _formats() -> str:
    """All that the decoder reads but lists of other files: a recording is the one file that was named."""
    from av import formats_available

    return ",".join(sorted(formats_available - LISTS_OF_FILES))


def _info(container: Any, path: str | Path) -> ClipInfo:
    stream = container.streams.video[0]
    width, height = stream.codec_context.width, stream.codec_context.height
    if not width or not height:
        raise VideoError(f"{path}: holds no picture (size {width} x {height})")
    rate_hz = float(mean_rate(container) or USUAL_RATE_HZ)
    return ClipInfo(width, height, rate_hz, _duration_s(container), stream.codec_context.name)


def _duration_s(container: Any) -> float | None:
    """Stated length of the video, s: its stream's, else (Matroska) its tag's, else the whole recording's if it is only video."""
    stream = container.streams.video[0]
    if stream.duration and stream.time_base:
        return float(stream.duration * stream.time_base)
    start_s = float((stream.start_time or 0) * (stream.time_base or 0))
    with suppress(ValueError):
        hours, minutes, seconds = stream.metadata.get("DURATION", "").split(":")
        return 3600 * int(hours) + 60 * int(minutes) + float(seconds) - start_s
    if container.duration and len(container.streams) == 1:
        return container.duration / 1e6
    return None


def _reason(error: Exception | None) -> str:
    if error is None:
        return ""
    text = getattr(error, "strerror", None) or str(error)
    return text.lower().splitlines()[0] if text else type(error).__name__
