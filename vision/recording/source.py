"""One door to every recording: what a source of frames is, the table of those that are there, and reading ahead of use.

Video files and sequences of pictures are built in; ``register_source`` takes in another kind (docs/developer/source.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...record.registry import Registry, code_stamp
from ...record.sources import PICTURES, VIDEO_FILE, SourceKind, kind_of, register_kind
from .ahead import Ahead
from .decode import ClipInfo, Frame, frame_of, video_frames, video_info
from .sequence import PictureSequence

FRAMES_AHEAD = 40
"""Frames decoded ahead of their use at most (less where they are large: the next line): a choice."""
BYTES_AHEAD = 64 << 20
"""Decoded frames waiting to be used: so many, and no more than this."""


class FrameSource(Protocol):
    """A recording that was opened."""

    def info(self) -> ClipInfo:
        """Size of the picture, frame rate, length, how it is coded; VideoError where it cannot be read."""
        ...

    def frames(
        self, span_s: tuple[float, float] | None, frame_rate_hz: float | None, exposure_s: float
    ) -> Iterator[Frame]:
        """The frames one by one, each with its number, its time and its picture (``timed_frames`` makes them of pictures).

        Read in a thread of its own, ahead of use; closed there when no more are wanted.

        Parameters
        ----------
        span_s : first and last time wanted, s, as stamped, before ``exposure_s`` moves it; None: all
        frame_rate_hz : replaces the recording's own times by number / rate
        exposure_s : half of it is added to the stamped time, which is the exposure's start

        Raises
        ------
        VideoError : it cannot be read, or holds no frame
        """
        ...


Open = Callable[[Path], FrameSource]
"""Path -> the recording; reads nothing yet."""
OpenT = TypeVar("OpenT", bound=Open)
OPENED_BY: Registry[Open] = Registry()
"""By the name of the kind that is opened."""


@dataclass(frozen=True)
class VideoFile:
    """The built-in source: a video file, decoded by PyAV.

    Attributes
    ----------
    decode_threads : None: as many as help. Where several would hide damage (HEVC; H.264 with B frames once an error has shown)
        one works
    """

    path: Path
    decode_threads: int | None = None

    def info(self) -> ClipInfo:
        """What the container's header says."""
        return video_info(self.path)

    def frames(
        self, span_s: tuple[float, float] | None = None, frame_rate_hz: float | None = None, exposure_s: float = 0.0
    ) -> Iterator[Frame]:
        """The frames, with the container's own times."""
        return video_frames(self.path, span_s, frame_rate_hz, exposure_s, self.decode_threads)


def register_source(
    name: str, takes: Callable[[Path], bool], files: Callable[[Path], Sequence[Path]]
) -> Callable[[OpenT], OpenT]:
    """Say what opens a kind of recording; to be put over a class that is made of a path, or a function.

    Parameters
    ----------
    name : for errors: "folder of pictures"; a kind of this name that is there is replaced
    takes : whether a path is such a recording. It is asked of every path that run.toml names as a recording, before the video
        file, and of what lies in a run folder that has no run.toml yet: quick, false where nothing is there
    files : the plain files that it is made of, in their order: tracks are kept until one of them changes

    Returns
    -------
    Callable
        a decorator that hands back what it is put over: an ``Open``
    """

    def registered(opened_by: OpenT) -> OpenT:
        register_kind(SourceKind(name, takes, files, code_stamp(opened_by)))
        OPENED_BY.add(name, opened_by)
        return opened_by

    return registered


def open_source(path: str | Path) -> FrameSource:
    """The recording at ``path``, by the first kind that takes it; else as a video file. Nothing is read yet."""
    kind = kind_of(path)
    built_in = PictureSequence if kind is PICTURES else VideoFile
    opened_by = None if kind in (VIDEO_FILE, PICTURES) else OPENED_BY.get(kind.name)
    return (opened_by or built_in)(Path(path))


def clip_info(path: str | Path) -> ClipInfo:
    """What a recording says of itself: size, rate, length, codec. Of a video file the header is read, and the first picture for
    the way it is turned.

    Parameters
    ----------
    path : what a source takes: a video file, a folder of pictures, a pattern of their names, or what was registered

    Raises
    ------
    VideoError : no such file, empty, no video, no video stream
    """
    return open_source(path).info()


def read_frames(
    path: str | Path,
    span_s: tuple[float, float] | None = None,
    frame_rate_hz: float | None = None,
    exposure_s: float = 0.0,
    decode_threads: int | None = None,
) -> Iterator[Frame]:
    """Decode the frames in ``span_s`` one by one, ahead of their use in a background thread.

    A picture that cannot be decoded, or has no time of its own, is left out; the ones around it keep their own number and time.
    One that was decoded but cannot be trusted is ``damaged``. What is doubtful about the recording stands in a frame's ``notes``.
    Closing the iterator ends the thread.

    Parameters
    ----------
    path : as in ``clip_info``
    span_s : first and last time wanted, s, in the recording's own time: as stamped, before ``exposure_s`` moves it; None = all
    frame_rate_hz : replaces the recording's timestamps by index/rate
    exposure_s : exposure time; half of it is added to the stamped time, which is taken as the exposure's start
    decode_threads : of a video file's decoder, which it then is; None = as many as help

    Raises
    ------
    VideoError : it cannot be read, or holds no frame
    """

    def begun() -> Iterator[Frame]:
        source = open_source(path) if decode_threads is None else VideoFile(Path(path), decode_threads)
        return source.frames(span_s, frame_rate_hz, exposure_s)

    ahead = Ahead(begun, FRAMES_AHEAD, BYTES_AHEAD, lambda frame: frame.luma.nbytes * 3 // 2)
    try:
        yield from ahead
    finally:
        ahead.close()


def timed_frames(
    pictures: Iterable[tuple[int, Callable[[], NDArray[np.generic]]]],
    rate_hz: float,
    span_s: tuple[float, float] | None = None,
    exposure_s: float = 0.0,
) -> Iterator[Frame]:
    """Frames of pictures that come at an even rate; for sources.

    Parameters
    ----------
    pictures : number from 0, and what reads the picture, called for those within the span only: (h, w) uint8 or uint16 grey, or
        (h, w, 3) uint8 BGR
    rate_hz : the frame of number n is stamped n / rate
    span_s, exposure_s : as in ``FrameSource.frames``
    """
    for index, read in pictures:
        t_s = index / rate_hz
        if span_s is not None and t_s > span_s[1]:
            return
        if span_s is None or t_s >= span_s[0]:
            yield frame_of(read(), index, t_s + exposure_s / 2)


__all__ = [
    "OPENED_BY",
    "FrameSource",
    "VideoFile",
    "clip_info",
    "frame_of",
    "open_source",
    "read_frames",
    "register_source",
    "timed_frames",
]
