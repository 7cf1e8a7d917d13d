"""A video file frame by frame: luma, true presentation time, and one clear line when it cannot be read."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...record.errors import VideoError
from ...record.files import refusal
from .clock import Clock
from .ledger import Picture
from .luma import WHITE_FULL_DN, luma, quarters, turned, white_dn
from .matroska import MatroskaSums
from .mp4 import contradiction
from .pictures import Doubt, Stream

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
    """

    index: int
    t_s: float
    luma: NDArray[np.uint8]
    raw: Any
    damaged: bool = False
    white_dn: int = WHITE_FULL_DN

    def bgr(self) -> NDArray[np.uint8]:
        """The picture in colour, upright, (h, w, 3) uint8."""
        return turned(self.raw.to_ndarray(format="bgr24"), self.raw)

    @property
    def stamp(self) -> int | None:
        """Timestamp by which the picture is found again in its container; None: by reading from the start."""
        return getattr(self.raw, "pts", None)


def video_info(path: str | Path) -> ClipInfo:
    """Read the container's header, and the first picture for the way it is turned.

    Parameters
    ----------
    path : of the file

    Raises
    ------
    VideoError : no such file, empty, no video, no video stream
    """
    with _opened(path) as container:
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
) -> Iterator[Frame]:
    """Decode the frames in ``span_s`` one by one, as ``source.read_frames`` has it, when they are asked for.

    Read in haste; at the first sign of damage begin again with care, and go on where haste had come to.

    Parameters
    ----------
    path : of the file
    span_s : first and last time wanted, s, in the recording's own time: as stamped, before ``exposure_s`` moves it; None = all
    frame_rate_hz : replaces the container's timestamps by index/rate
    exposure_s : exposure time; half of it is added to the stamped time, which is taken as the exposure's start
    decode_threads : decoder threads; None = as many as help. Where several would hide damage (HEVC; H.264 with B frames once an
        error has shown) one works

    Raises
    ------
    VideoError : it cannot be read, holds no frame, ends before its stated end (or the span's), or its times are not plausible:
        they do not rise, jump, or leave the stated length
    """
    given = 0
    try:
        for frame in _decoded_once(path, span_s, frame_rate_hz, exposure_s, decode_threads, haste=True):
            yield frame
            given += 1
    except Doubt:
        again = _decoded_once(path, span_s, frame_rate_hz, exposure_s, decode_threads, haste=False)
        with closing(again):
            yield from islice(again, given, None)


def _decoded_once(
    path: str | Path,
    span_s: tuple[float, float] | None,
    frame_rate_hz: float | None,
    exposure_s: float,
    decode_threads: int | None,
    haste: bool,
) -> Generator[Frame]:
    contradicted = contradiction(path) if refusal(path) is None else None
    if contradicted is not None and frame_rate_hz is None:
        raise _index_error(path, contradicted)
    # an edit list cuts by times: where those are wrong, and frames are counted instead, nothing is cut
    with _opened(path, {"ignore_editlist": "1"} if contradicted is not None else {}) as container:
        info = _info(container, path)
        sums = MatroskaSums(path) if "matroska" in container.format.name.split(",") else None
        with closing(sums) if sums is not None else nullcontext():
            damaged_at = sums.damaged_at if sums is not None else None
            stream = Stream(container, decode_threads, damaged_at, frame_rate_hz is None, haste)
            clock = Clock(path, container, stream, info.duration_s, frame_rate_hz)
            if sums is not None and frame_rate_hz is None:
                _check_sums(path, container, sums)
            try:
                yield from _in_span(clock, stream, span_s, exposure_s)
                clock.check_end(span_s[1] if span_s is not None else None, _reason(stream.stopped_by))
            except VideoError:
                if stream.in_haste:
                    raise Doubt from None
                raise


def _in_span(clock: Clock, stream: Stream, span_s: tuple[float, float] | None, exposure_s: float) -> Iterator[Frame]:
    for picture, t_s in clock.timed(_of_one_size(stream)):
        if span_s is not None and t_s < span_s[0]:
            continue
        if span_s is not None and t_s > span_s[1]:
            return
        raw = picture.raw
        yield Frame(picture.index, t_s + exposure_s / 2, luma(raw), raw, picture.damaged, white_dn(raw))


def _of_one_size(pictures: Iterable[Picture]) -> Iterator[Picture]:
    """Leave out pictures of another size: a damaged header; were it a real change, no calibration would hold."""
    size: tuple[int, int] | None = None
    for picture in pictures:
        size = size or (picture.raw.width, picture.raw.height)
        if (picture.raw.width, picture.raw.height) == size:
            yield picture


def _check_sums(path: str | Path, container: Any, sums: MatroskaSums) -> None:
    """Raise VideoError where the elements that times come from are damaged."""
    if sums.timing_damaged:
        raise _index_error(path, "the header does not match its checksum")
    if sums.start_damaged and container.streams.video[0].start_time:
        raise _index_error(path, "the first cluster does not match its checksum")


def _index_error(path: str | Path, wrong: str) -> VideoError:
    return VideoError(
        f"{path}: the index is damaged, no time in it is sure: {wrong}; source.frame_rate_hz would count frames instead"
    )


def _opened(path: str | Path, options: dict[str, str] | None = None):
    import av
    import av.error

    path = Path(path)
    wrong = refusal(path)
    if wrong is not None:
        raise VideoError(f"{path}: {wrong}")
    if path.stat().st_size == 0:
        raise VideoError(f"{path}: is empty")
    given = {"format_whitelist": _formats(), **(options or {})}
    try:
        # absolute: a name such as "concat:a|b" would be taken for a protocol
        container = av.open(os.path.abspath(path), options=given, metadata_errors="replace")
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
    rate = float(stream.average_rate or stream.guessed_rate or 0) or 25.0
    return ClipInfo(width, height, rate, _duration_s(container), stream.codec_context.name)


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
