"""Any frame of a recording at once: read once through in the background, kept as JPEGs; exact pixels decoded again where needed.

The decoder of ``vision.recording`` is the only judge of a frame's number, time and damage. While it reads the recording through,
every picture goes, compressed, into a temporary file that is bounded; scrubbing is answered from there. What needs the pixels as
they were decoded (snapping, detection) takes them from the nearest key frame on, and a few of them are kept.
"""

from __future__ import annotations

import tempfile
from _thread import LockType
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Condition, Event, Lock, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..record.errors import TowlineError, VideoError
from ..vision.recording import ClipInfo, Frame, clip_info, read_frames
from ..vision.recording.luma import luma, white_dn

MOST_BYTES = 1 << 30
"""Of the temporary file; frames beyond it are decoded when they are asked for."""
QUALITY = 90
"""Of the JPEGs that are shown (0 to 100): a choice; what is measured is decoded again."""
EXACT = 6
"""Exact frames kept."""
WAIT_S = 20.0
"""A frame is waited for this long at most."""
CLOCK_S = 1e-6
"""A frame that is read again has its time to within this."""


@dataclass(frozen=True)
class Known:
    """What is known of one frame: its time, its timestamp in the container, whether it is damaged, its JPEG's place and length."""

    t_s: float
    stamp: int | None
    damaged: bool
    place: int
    length: int


@dataclass(frozen=True)
class Kept(Frame):
    """A frame that several threads may look at: the decoder's own picture may be converted by one at a time."""

    lock: LockType = field(default_factory=Lock)
    pictures: list[NDArray[np.uint8]] = field(default_factory=list)

    def bgr(self) -> NDArray[np.uint8]:
        """The picture in colour, upright, (h, w, 3) uint8, made once; read-only."""
        with self.lock:
            if not self.pictures:
                picture = super().bgr()
                picture.flags.writeable = False
                self.pictures.append(picture)
            return self.pictures[0]

    @classmethod
    def of(cls, frame: Frame, known: Known) -> Kept:
        """A frame as the decoder gave it, with what is known of it."""
        return cls(frame.index, known.t_s, frame.luma, frame.raw, known.damaged, frame.white_dn)


class Frames:
    """The frames of one recording.

    Parameters
    ----------
    path : of the video
    frame_rate_hz, exposure_s : of [source]
    most_bytes : of the temporary file

    Raises
    ------
    VideoError : it cannot be opened

    Attributes
    ----------
    info : what the container says
    problem : why reading ended before its time; "" = it did not
    """

    def __init__(
        self,
        path: Path,
        frame_rate_hz: float | None = None,
        exposure_s: float = 0.0,
        most_bytes: int = MOST_BYTES,
    ) -> None:
        self.path, self.info = path, clip_info(path)
        self.problem = ""
        self.rate_hz, self.exposure_s, self._most_bytes = frame_rate_hz, exposure_s, most_bytes
        self._known: dict[int, Known] = {}
        self._order: list[int] = []
        self._changed, self._stop = Condition(), Event()
        self._complete = False
        self._file = tempfile.TemporaryFile(prefix="towline-")  # noqa: SIM115 - closed with the recording
        self._file_lock, self._exact_lock = Lock(), Lock()
        self._exact: OrderedDict[int, Kept] = OrderedDict()
        self._again: _Again | None = None
        self._thread = Thread(target=self._read_through, name="towline-frames", daemon=True)
        self._thread.start()

    # reading through ---------------------------------------------------------------------------------------------------

    def _read_through(self) -> None:
        place = 0
        frames = read_frames(self.path, None, self.rate_hz, self.exposure_s)
        try:
            for frame in frames:
                if self._stop.is_set():
                    return
                length = 0
                if place < self._most_bytes:
                    data = _compressed(frame)
                    length = len(data)
                    with self._file_lock:
                        self._file.seek(place)
                        self._file.write(data)
                known = Known(frame.t_s, frame.stamp, frame.damaged, place, length)
                with self._changed:
                    if not self._order:
                        self._exact[frame.index] = Kept.of(frame, known)
                    self._known[frame.index] = known
                    self._order.append(frame.index)
                    self._changed.notify_all()
                place += length
        except TowlineError as error:
            self.problem = str(error)
        except Exception as error:  # a fault of the decoder must not leave the page waiting
            self.problem = f"{self.path}: {type(error).__name__}: {error}"
        finally:
            close = getattr(frames, "close", None)
            if close is not None:
                close()
            with self._changed:
                self._complete = True
                self._changed.notify_all()

    def close(self) -> None:
        """Stop reading and give the memory back."""
        self._stop.set()
        self._thread.join(WAIT_S)
        with self._exact_lock:
            if self._again is not None:
                self._again.close()
            self._again = None
            self._exact.clear()
        with self._file_lock:
            self._file.close()

    @property
    def read(self) -> int:
        """Frames read so far."""
        return len(self._order)

    @property
    def complete(self) -> bool:
        """All of them are."""
        return self._complete

    @property
    def count(self) -> int:
        """Numbers of frames run from 0 to this - 1; an estimate until all are read."""
        if self._complete:
            return self._order[-1] + 1 if self._order else 0
        rate_hz, length_s = self.info.rate_hz, self.info.duration_s
        expected = 0 if length_s is None else round(length_s * rate_hz)
        return max(expected, self._order[-1] + 1 if self._order else 1)

    def wait(self, index: int = 0, timeout_s: float = WAIT_S) -> bool:
        """Wait until a frame was read, or all were; whether it is there."""
        with self._changed:
            self._changed.wait_for(
                lambda: index in self._known or self._complete or (self._order and self._order[-1] > index), timeout_s
            )
            return index in self._known

    def time_s(self, index: int) -> float:
        """Time of a frame; by the mean rate while it is not read."""
        known = self._known.get(index)
        if known is not None:
            return known.t_s
        return index / (self.rate_hz or self.info.rate_hz) + self.exposure_s / 2

    def at_time(self, t_s: float) -> int:
        """The frame nearest to a time."""
        rate_hz = self.rate_hz or self.info.rate_hz
        guess = min(max(round((t_s - self.exposure_s / 2) * rate_hz), 0), max(self.count - 1, 0))
        near = [i for i in range(max(guess - 30, 0), guess + 31) if i in self._known]
        return min(near, key=lambda i: abs(self._known[i].t_s - t_s)) if near else guess

    def known(self, index: int) -> bool:
        """The frame was read."""
        return index in self._known

    def damaged(self, index: int) -> bool:
        """The frame could not be decoded as it was written."""
        known = self._known.get(index)
        return known is not None and known.damaged

    def clamp(self, index: int) -> int:
        """The number of the nearest frame that can be asked for."""
        return min(max(index, 0), max(self.count - 1, 0))

    # pictures ----------------------------------------------------------------------------------------------------------

    def jpeg(self, index: int) -> tuple[bytes, bool]:
        """A frame as a JPEG, and whether it surely is the one; where its picture could not be decoded, the one before it.

        While the recording is being read, a frame that was not reached is looked up by the mean rate.

        Raises
        ------
        VideoError : there is none
        """
        if index not in self._known and not self._complete and self._order:
            looked_up = self._looked_up(index)
            if looked_up is not None:
                return looked_up, False
        self.wait(index)
        known = self._known.get(index)
        if known is None:
            before = [i for i in self._order if i < index]
            if not before:
                raise VideoError(self.problem or f"{self.path}: no frame {index}")
            known = self._known[before[-1]]
            index = before[-1]
        if known.length:
            with self._file_lock:
                self._file.seek(known.place)
                return self._file.read(known.length), True
        return _compressed(self.exact(index)), True

    def _looked_up(self, index: int) -> bytes | None:
        first = self._known[self._order[0]]
        with self._exact_lock:
            if first.stamp is None:
                return None
            if self._again is None:
                self._again = _Again(self.path)
            raw = self._again.near(first.stamp, index - self._order[0])
        return None if raw is None else _compressed(Frame(index, 0.0, luma(raw), raw))

    def exact(self, index: int) -> Frame:
        """A frame as it was decoded.

        Raises
        ------
        VideoError : there is none of this number
        """
        self.wait(index)
        known = self._known.get(index)
        if known is None:
            raise VideoError(self.problem or f"{self.path}: no frame {index}")
        with self._exact_lock:
            if index in self._exact:
                self._exact.move_to_end(index)
                return self._exact[index]
            frame = self._exact[index] = Kept.of(self._decoded(index, known), known)
            while len(self._exact) > EXACT:
                self._exact.popitem(last=False)
            return frame

    def _decoded(self, index: int, known: Known) -> Frame:
        if known.stamp is not None:
            if self._again is None:
                self._again = _Again(self.path)
            raw = self._again.picture(known.stamp)
            if raw is not None:
                return Frame(index, known.t_s, luma(raw), raw, known.damaged, white_dn(raw))
        # no timestamps to seek by, or they do not lead there: from the start
        stamped_s = known.t_s - self.exposure_s / 2
        for frame in self._read((stamped_s - CLOCK_S, stamped_s + CLOCK_S)):
            if frame.index == index:
                return frame
        raise VideoError(f"{self.path}: frame {index} could not be decoded again")

    def _read(self, span_s: tuple[float, float]) -> Iterator[Frame]:
        frames = read_frames(self.path, span_s, self.rate_hz, self.exposure_s)
        try:
            yield from frames
        finally:
            close = getattr(frames, "close", None)
            if close is not None:
                close()


def _compressed(frame: Frame) -> bytes:
    import cv2

    return cv2.imencode(".jpg", frame.bgr(), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


class _Again:
    """The recording opened once more, for pictures by their timestamps: forwards from where it stands, or from a key frame on."""

    def __init__(self, path: Path) -> None:
        import av

        self._container = av.open(str(path), metadata_errors="replace")
        self._stream = self._container.streams.video[0]
        self._stream.thread_type = "AUTO"
        self._from: int | None = None
        self._coming = self._pictures()
        self._at: int | None = None
        self._step = 1.0
        rate, base = self._stream.average_rate, self._stream.time_base
        if rate and base:
            self._step = float(1 / (rate * base))

    def near(self, first_stamp: int, steps: int) -> Any | None:
        """The picture about so many steps of the mean rate after a timestamp, or None."""
        return self.picture(first_stamp + round(steps * self._step), exactly=False)

    def picture(self, stamp: int, exactly: bool = True) -> Any | None:
        """The picture of a timestamp (not ``exactly``: the first one from it on), or None."""
        import av.error

        near = self._at is not None and 0 < stamp - self._at < 60 * self._step
        self._from = stamp if exactly else None
        try:
            if not near:
                self._container.seek(stamp, stream=self._stream, backward=True)
                self._coming = self._pictures()
            for raw in self._coming:
                if raw.pts is None:
                    return None
                self._at = raw.pts
                if raw.pts == stamp or (raw.pts > stamp and not exactly):
                    return raw
                if raw.pts > stamp:
                    break
        except (av.error.FFmpegError, ValueError):
            pass
        self._at = None
        return None

    def _pictures(self) -> Iterator[Any]:
        """Decoded from here on; what comes before the one that is wanted only where others are made from it."""
        for packet in self._container.demux(self._stream):
            skipped = self._from is not None and packet.pts is not None and packet.pts < self._from
            self._stream.codec_context.skip_frame = "NONREF" if skipped else "DEFAULT"
            yield from packet.decode()

    def close(self) -> None:
        """Close the container."""
        self._container.close()


__all__ = ["ClipInfo", "Frames", "Known"]
