"""A recording frame by frame: luma, true presentation time, and one clear line when it cannot be read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..record.errors import VideoError

_PLANAR_8_BIT = ("yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "yuvj444p", "nv12", "gray")
TRUNCATED_SHARE = 0.01
"""A recording that ends more than this share (and two frames) before its stated end has lost its tail."""


@dataclass(frozen=True)
class ClipInfo:
    """What the container says.

    Attributes
    ----------
    width_px, height_px : of the upright picture
    rate_hz : mean frame rate
    duration_s : stated length; None where the container does not say
    codec : name
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
    index : from 0 in the recording, whatever the span
    t_s : presentation time from the recording's start
    luma : (h, w) uint8; valid until the next frame is taken (copy what must last)
    raw : the decoder's frame
    """

    index: int
    t_s: float
    luma: NDArray[np.uint8]
    raw: Any

    def bgr(self) -> NDArray[np.uint8]:
        """The picture in colour, (h, w, 3) uint8."""
        return _turned(self.raw.to_ndarray(format="bgr24"), self.raw)


def clip_info(path: str | Path) -> ClipInfo:
    """Read the container's header.

    Raises
    ------
    VideoError : no such file, empty, no video, no video stream
    """
    with _opened(path) as container:
        return _info(container.streams.video[0], path)


def read_frames(
    path: str | Path, span_s: tuple[float, float] | None = None, frame_rate_hz: float | None = None
) -> Iterator[Frame]:
    """Decode the frames in ``span_s`` one by one.

    Parameters
    ----------
    span_s : first and last time wanted, s; None = all
    frame_rate_hz : replaces the container's timestamps by index/rate

    Raises
    ------
    VideoError : it cannot be read, holds no frame, ends before its stated end (or the span's), or its times do not rise
    """
    import av
    import av.error

    with _opened(path) as container:
        stream = container.streams.video[0]
        info = _info(stream, path)
        stream.thread_type = "AUTO"
        base = float(stream.time_base or 0) or 1.0 / info.rate_hz
        origin = stream.start_time or 0
        last_t: float | None = None
        index = -1
        stopped_at: str | None = None
        decoder = container.decode(stream)
        while True:
            try:
                raw = next(decoder)
            except StopIteration:
                break
            except av.error.FFmpegError as error:
                stopped_at = _reason(error)
                break
            index += 1
            if frame_rate_hz is not None:
                t_s = index / frame_rate_hz
            elif raw.pts is not None:
                t_s = (raw.pts - origin) * base
            else:
                t_s = index / info.rate_hz
            if last_t is not None and t_s <= last_t:
                raise VideoError(f"{path}: frame {index} has time {t_s:.6f} s after {last_t:.6f} s; times must rise")
            last_t = t_s
            if span_s is not None and t_s < span_s[0]:
                continue
            if span_s is not None and t_s > span_s[1]:
                return
            yield Frame(index, t_s, _luma(raw), raw)
        if last_t is None:
            raise VideoError(f"{path}: holds no frame that can be decoded{f' ({stopped_at})' if stopped_at else ''}")
        wanted = span_s[1] if span_s is not None else None
        stated = info.duration_s if frame_rate_hz is None else None
        end = min(x for x in (wanted, stated, float("inf")) if x is not None)
        short = end - (last_t + 1 / info.rate_hz)
        if stopped_at or (np.isfinite(end) and short > max(TRUNCATED_SHARE * end, 2 / info.rate_hz)):
            until = f" of {end:.2f} s" if np.isfinite(end) else ""
            raise VideoError(
                f"{path}: ends after frame {index} at {last_t:.2f} s{until}: truncated or damaged"
                f"{f' ({stopped_at})' if stopped_at else ''}; source.span_s = [0.0, {last_t:.2f}] would use what is left"
            )


def _opened(path: str | Path):
    import av
    import av.error

    path = Path(path)
    if not path.is_file():
        raise VideoError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise VideoError(f"{path}: is empty")
    try:
        container = av.open(str(path))
    except (av.error.FFmpegError, ValueError) as error:
        raise VideoError(f"{path}: is not a video that can be read, or is cut short ({_reason(error)})") from None
    if not container.streams.video:
        container.close()
        raise VideoError(f"{path}: holds no video stream")
    return container


def _info(stream: Any, path: str | Path) -> ClipInfo:
    width, height = stream.codec_context.width, stream.codec_context.height
    if not width or not height:
        raise VideoError(f"{path}: holds no picture (size {width} x {height})")
    rate = float(stream.average_rate or stream.guessed_rate or 0) or 25.0
    duration = float(stream.duration * stream.time_base) if stream.duration and stream.time_base else None
    return ClipInfo(width, height, rate, duration, stream.codec_context.name)


def _luma(raw: Any) -> NDArray[np.uint8]:
    if raw.format.name in _PLANAR_8_BIT:
        plane = raw.planes[0]
        whole = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        return _turned(whole[: raw.height, : raw.width], raw)
    return _turned(raw.to_ndarray(format="gray"), raw)


def _turned(picture: NDArray[np.uint8], raw: Any) -> NDArray[np.uint8]:
    """Upright by the container's rotation (counter-clockwise degrees)."""
    quarter = round(getattr(raw, "rotation", 0) / 90) % 4
    return np.rot90(picture, quarter) if quarter else picture


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return text.lower().splitlines()[0] if text else type(error).__name__
