"""Frame times from presentation timestamps, and whether they can be believed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from ...record.errors import VideoError
from .ledger import OrderError, Picture
from .pictures import Stream

TRUNCATED_SHARE = 0.01
"""A recording that ends more than this share (and three frames) before its stated end has lost its tail."""
LONGEST_STEP_S = 10.0
"""No two frames are further apart, unless the recording's own step is that long (a time lapse: a few of its steps)."""
LONGEST_STEPS = 5.0
"""How many of the recording's own steps two frames of a time lapse may lie apart: a choice."""
LEAST_EVEN, LONGEST_UNEVEN = 3, 4
"""Frames in a row that make a beat; frames in a row off it that are doubted, not the beat."""
STRIKES = 3
"""So many times up to ``LONGEST_UNEVEN`` timestamps off the beat: the recording's beat is not even, no more is made of them."""
_HALF = Fraction(1, 2)
"""The most that rounding moves a timestamp, ticks."""
FORGIVEN_AFTER = 1000
"""Frames in a row on the beat after which earlier strikes do not count."""


class Clock:
    """Gives each picture its time.

    Parameters
    ----------
    container, stream : the open recording and its pictures
    duration_s : stated length, or None
    frame_rate_hz : times are index/rate, whatever the container says; None = its timestamps
    """

    def __init__(
        self, path: str | Path, container: Any, stream: Stream, duration_s: float | None, frame_rate_hz: float | None
    ) -> None:
        video = container.streams.video[0]
        self._path, self._stream, self._given_hz = path, stream, frame_rate_hz
        self._rate = Fraction(video.average_rate or video.guessed_rate or 25)
        self._base = video.time_base
        self._start = video.start_time
        # AVI has no timestamps: it numbers the pictures it holds
        self._stated = video.frames if "avi" in container.format.name.split(",") and frame_rate_hz is None else 0
        self._duration_s = duration_s if frame_rate_hz is None else None
        self._origin: int | None = None
        self._index = -1
        self._t_s: float | None = None
        self._strikes = self._even_frames = 0
        self._late_ticks, self._early_ticks = -_HALF, _HALF

    def timed(self, pictures: Iterable[Picture]) -> Iterator[tuple[Picture, float]]:
        """Give each picture its time, s from the recording's start; each is held back until the next ones' times agree.

        Raises
        ------
        VideoError : a time cannot be true
        """
        held: list[tuple[Picture, float]] = []
        anchored = False  # the first one held lies on the beat
        for picture in self._in_order(pictures):
            t_s, even = self._time_s(picture)
            if self._given_hz is None:
                self._check(picture, t_s)
            if even or len(held) > LONGEST_UNEVEN:
                self._believe(held, anchored and even)
                yield from held
                held.clear()
                anchored = even
            held.append((picture, t_s))
            self._index, self._t_s = picture.index, t_s
        self._believe(held, anchored)
        yield from held

    def check_end(self, wanted_s: float | None, reason: str) -> None:
        """Look back over the whole recording.

        Parameters
        ----------
        wanted_s : end of the part wanted, or None
        reason : the container's last error, or ""

        Raises
        ------
        VideoError : no frame at all; or it ends before its stated end and before ``wanted_s``
        """
        said = f" ({reason})" if reason else ""
        if self._t_s is None:
            raise VideoError(f"{self._path}: holds no frame that can be decoded{said}")
        places = (self._stream.last_stamp or 0) + 1
        if self._stream.by_place and places < self._stated:
            raise VideoError(
                f"{self._path}: holds {places} of the {self._stated} frames that it states; "
                f"an AVI has no timestamps, so those after a missing one would come too early{said}"
            )
        last_s = self._last_read_s()
        ends = [s for s in (wanted_s, self._duration_s) if s is not None]
        if not ends:
            if reason:
                raise VideoError(f"{self._path}: ends after frame {self._index} at {last_s:.2f} s: damaged{said}")
            return
        end_s, step_s = min(ends), float(1 / self._rate)
        if end_s - (last_s + step_s) > max(TRUNCATED_SHARE * end_s, 3 * step_s):
            raise VideoError(
                f"{self._path}: ends after frame {self._index} at {last_s:.2f} s of {end_s:.2f} s: truncated or damaged{said}; "
                f"source.span_s = [0.0, {last_s:.2f}] would use what is left"
            )

    @property
    def _way_out(self) -> str:
        """What the user can do about timestamps that are wrong."""
        return f"source.frame_rate_hz (stated: {float(self._rate):.6g}) would count frames instead"

    def _in_order(self, pictures: Iterable[Picture]) -> Iterator[Picture]:
        try:
            yield from pictures
        except OrderError as error:
            base, origin = self._base or Fraction(1), self._origin or 0
            late_s, before_s = float((error.stamp - origin) * base), float((error.before - origin) * base)
            raise VideoError(
                f"{self._path}: the picture of time {late_s:.6f} s is shown after the one of {before_s:.6f} s; "
                f"times must rise ({self._way_out})"
            ) from None

    def _time_s(self, picture: Picture) -> tuple[float, bool]:
        """Time, and whether it lies on the even beat of the mean rate."""
        if self._given_hz is not None:
            return picture.index / self._given_hz, True
        if picture.stamp is None or not self._base:
            return float(picture.index / self._rate), True
        if self._origin is None:
            self._origin = self._first_stamp(picture.stamp)
            if self._origin == 0:
                self._late_ticks = self._early_ticks = Fraction(0)  # zero is zero, not rounded
        # whole numbers up to the one division: exact after hours, and at rates such as 30000/1001
        exact = (picture.stamp - self._origin) * self._base
        beat = round(exact * self._rate) / self._rate
        return (float(beat), True) if self._on_beat((exact - beat) / self._base) else (float(exact), False)

    def _first_stamp(self, shown: int) -> int:
        """The recording's start: as stated, or the first packet's, whose picture may be lost."""
        start = None if self._stream.by_place else self._start
        return min((stamp for stamp in (start, self._stream.first_stamp) if stamp is not None), default=shown)

    def _on_beat(self, off_ticks: Fraction) -> bool:
        """Whether the container can only have rounded an even beat (Matroska: to milliseconds).

        Rounding moves a timestamp by half a tick at most, the first one too; every frame on the beat narrows down by how much
        that one was moved.
        """
        late, early = max(self._late_ticks, off_ticks - _HALF), min(self._early_ticks, off_ticks + _HALF)
        if late > early:
            return False
        self._late_ticks, self._early_ticks = late, early
        return True

    def _believe(self, held: list[tuple[Picture, float]], between: bool) -> None:
        """A few timestamps off the beat, ``between`` others on it, are not true: a flipped bit in an index looks like this."""
        if len(held) == 1:
            self._even_frames += 1
            if self._even_frames >= FORGIVEN_AFTER:
                self._strikes = 0
            return
        known, self._even_frames = self._even_frames >= LEAST_EVEN, 0
        if known and between and self._strikes < STRIKES:
            self._strikes += 1
            for picture, _ in held[1:]:
                picture.damaged = True

    def _last_read_s(self) -> float:
        """Time of the last packet that could be read: pictures lost to damage at the end are no truncation."""
        assert self._t_s is not None
        last = self._stream.last_stamp
        if self._given_hz is not None or last is None or self._origin is None or not self._base:
            return self._t_s
        return max(self._t_s, float((last - self._origin) * self._base))

    def _check(self, picture: Picture, t_s: float) -> None:
        place = f"{self._path}: frame {picture.index} has time {t_s:.6f} s"
        if self._t_s is not None and t_s <= self._t_s:
            raise VideoError(f"{place} after {self._t_s:.6f} s; times must rise ({self._way_out})")
        before_s = 0.0 if self._t_s is None else self._t_s
        step_s = float(1 / self._rate)
        longest_s = max(LONGEST_STEP_S, LONGEST_STEPS * step_s) * (picture.index - self._index)
        if t_s - before_s > longest_s:
            raise VideoError(f"{place} after {before_s:.6f} s, more than {longest_s:g} s later; {self._way_out}")
        if self._duration_s is not None and t_s > self._duration_s + max(
            TRUNCATED_SHARE * self._duration_s, 2 * step_s
        ):
            raise VideoError(f"{place}, but the recording states a length of {self._duration_s:.6f} s; {self._way_out}")
