"""Frame times from presentation timestamps, and what is to be said of them where they are doubtful.

The container's timestamps are the truth, edits included. Nothing here refuses a recording: a picture whose time cannot be true is
left out or ``damaged``, and said.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from ...record.errors import VideoError
from .ledger import LONGEST_STEPS as GAP_STEPS
from .ledger import Picture
from .pictures import USUAL_RATE_HZ, Stream, is_avi, may_begin_again, mean_rate

TRUNCATED_SHARE = 0.01
"""A recording that ends more than this share (and three frames) before its stated end has lost its tail."""
LONGEST_STEP_S = 10.0
"""Two frames further apart are said, unless the recording's own step is that long (a time lapse: a few of its steps)."""
LONGEST_STEPS = 5.0
"""How many of the recording's own steps two frames of a time lapse may lie apart: a choice."""
LEAST_EVEN, LONGEST_UNEVEN = 3, 4
"""Frames in a row that make a beat; frames in a row off it that are doubted, not the beat."""
STAMPED, ON_ARRIVAL = "TOWLINE_STAMPS", "arrival"
"""A recording's tag, and what it says where its stamps are no source's own but those of when each picture came
(``live.recorder``)."""
STRIKES = 3
"""So many times up to ``LONGEST_UNEVEN`` timestamps off the beat: the recording's beat is not even, no more is made of them."""
_HALF = Fraction(1, 2)
"""The most that rounding moves a timestamp, ticks."""
FORGIVEN_AFTER = 1000
"""Frames in a row on the beat after which earlier strikes do not count."""
GOES_ON = "times go on from there one step after the frame before: if a pause lies between, let source.span_s end or begin there"
"""What becomes of times after a clock that was set back, in words."""
BEGINS_AGAIN = 5
"""So many frames in a row, rising among themselves, that lie before the ones before them: the clock was set back (a choice)."""


class Clock:
    """Gives each picture its time.

    Parameters
    ----------
    container, stream : the open recording and its pictures
    duration_s : stated length, or None
    frame_rate_hz : times are index/rate, whatever the container says; None = its timestamps

    Attributes
    ----------
    on_arrival : times are those at which the pictures came: their source stamps nothing
    """

    def __init__(
        self, path: str | Path, container: Any, stream: Stream, duration_s: float | None, frame_rate_hz: float | None
    ) -> None:
        video = container.streams.video[0]
        self._path, self._stream, self._given_hz = path, stream, frame_rate_hz
        self._rate = mean_rate(container) or Fraction(USUAL_RATE_HZ)
        self._base = video.time_base
        self._start = video.start_time
        # AVI has no timestamps: it numbers the pictures it holds
        self._stated = video.frames if is_avi(container) and frame_rate_hz is None else 0
        self._duration_s = duration_s if frame_rate_hz is None and not may_begin_again(container) else None
        self._origin: int | None = None
        self._index = -1
        self._t_s: float | None = None
        self.on_arrival = frame_rate_hz is None and container.metadata.get(STAMPED) == ON_ARRIVAL
        # stamps of arrival waver: one off the beat is as true as the others
        self._strikes = STRIKES if self.on_arrival else 0
        self._even_frames = 0
        self._late_ticks, self._early_ticks = -_HALF, _HALF
        self._gaps: int | None = 0  # None: times fall, the decoder's order tells
        self._notes: dict[str, str] = {}
        self._said: set[str] = set()

    def new_notes(self) -> tuple[str, ...]:
        """What is to be said and has not been handed out yet; of each kind of doubt the first."""
        notes = tuple(self._notes.values())
        self._notes.clear()
        return notes

    def timed(self, pictures: Iterable[Picture]) -> Iterator[tuple[Picture, float]]:
        """Give each picture its time, s from the recording's start; each is held back until the next ones' times agree.

        Raises
        ------
        OrderError : pictures and timestamps are in different orders
        """
        held: list[tuple[Picture, float]] = []
        anchored = False  # the first one held lies on the beat
        for picture in self._counted(pictures) if self._given_hz is not None else self._rising(pictures):
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
        """Look back over the whole recording, where it was read to its end.

        Parameters
        ----------
        wanted_s : end of the part wanted, or None
        reason : the container's last error, or ""

        Raises
        ------
        VideoError : no frame at all
        """
        said = f" ({reason})" if reason else ""
        if self._t_s is None:
            raise VideoError(f"{self._path}: holds no frame that can be decoded{said}")
        gaps = self._stream.gaps if self._gaps is None else self._gaps
        if self._given_hz is not None and gaps:
            self._say(
                "gaps",
                f"source.frame_rate_hz counts its frames evenly, but in {gaps} places its own times leave one out: "
                "times after a frame that is really missing are too early",
            )
        last_s = self._last_read_s()
        place = f"ends after frame {self._index} at {last_s:.2f} s"
        places = (self._stream.last_stamp or 0) + max(round(self._stream.step_ticks), 1)
        if self._stream.by_place and places < self._stated:
            self._say(
                "end",
                f"holds {places} of the {self._stated} frames that it states; an AVI has no timestamps, "
                f"so frames after a missing one would come too early{said}",
            )
        ends = [s for s in (wanted_s, self._duration_s) if s is not None]
        if not ends:
            if reason:
                self._say("end", f"{place}: damaged{said}")
            return
        end_s, step_s = min(ends), float(1 / self._rate)
        if end_s - (last_s + step_s) > max(TRUNCATED_SHARE * end_s, 3 * step_s):
            self._say("end", f"{place} of {end_s:.2f} s: truncated or damaged{said}; what is left is used")

    def _say(self, kind: str, words: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            self._notes[kind] = words

    @property
    def _way_out(self) -> str:
        """What the user can do about timestamps that are wrong."""
        return f"source.frame_rate_hz (stated: {float(self._rate):.6g}) would count frames instead"

    def _counted(self, pictures: Iterable[Picture]) -> Iterator[Picture]:
        """Pictures as they are; where their own times leave one out is counted, as long as these rise."""
        last: Picture | None = None
        for picture in pictures:
            if last is not None and picture.stamp is not None and last.stamp is not None and self._gaps is not None:
                apart = picture.stamp - last.stamp
                self._gaps = None if apart <= 0 else self._gaps + self._leaves_out(apart, picture.index - last.index)
            last = picture
            yield picture

    def _leaves_out(self, apart: int, count: int) -> bool:
        """Whether there is room for another picture between two that are ``count`` steps apart."""
        usual = self._stream.step_ticks
        return usual > 0 and apart > (count - 1 + GAP_STEPS) * usual

    def _rising(self, pictures: Iterable[Picture]) -> Iterator[Picture]:
        """Pictures whose timestamps rise: one that falls, or leapt before it, is left out; a clock that was set back goes on."""
        last: Picture | None = None
        before: int | None = None
        shift, fallen = 0, list[Picture]()
        for picture in pictures:
            if picture.stamp is None:
                yield picture
                continue
            picture.stamp += shift
            if last is None or last.stamp is None or picture.stamp > last.stamp:
                if last is not None:
                    yield last
                    before = last.stamp
                last, fallen = picture, []
            elif before is not None and picture.stamp > before and self._leapt(before, last, picture):
                self._fell(last, picture.stamp, "lies after the next one's")
                last = picture
            else:
                self._fell(picture, last.stamp, "is not after")
                rising = not fallen or (fallen[-1].stamp or 0) < picture.stamp
                fallen = [*fallen, picture] if rising else [picture]
                if len(fallen) >= BEGINS_AGAIN:
                    first = fallen[0]
                    back = last.stamp + self._steps(first.index - last.index) - (first.stamp or 0)
                    self._say("again", self._again(first, back))
                    shift += back
                    yield last
                    for again in fallen:
                        again.stamp = (again.stamp or 0) + back
                    yield from fallen[:-1]
                    before, last, fallen = fallen[-2].stamp, fallen[-1], []
        if last is not None:
            yield last

    def _steps(self, count: int) -> int:
        """So many steps of the mean rate, ticks."""
        return max(round(max(count, 1) / (self._rate * self._base)), 1) if self._base else max(count, 1)

    def _leapt(self, before: int, last: Picture, picture: Picture) -> bool:
        """Whether ``last`` is further from where the beat puts it than ``picture``; ``before`` is the stamp before both."""
        assert last.stamp is not None
        assert picture.stamp is not None
        first = before + self._steps(1)
        return abs(last.stamp - first) > abs(picture.stamp - first - self._steps(picture.index - last.index))

    def _fell(self, picture: Picture, other: int, words: str) -> None:
        self._say(
            "rise",
            f"the time of frame {picture.index}, {self._seconds(picture.stamp):.3f} s, {words} {self._seconds(other):.3f} s; "
            f"frames without a time of their own are left out ({self._way_out})",
        )

    def _again(self, first: Picture, back: int) -> str:
        self._duration_s = None  # of the first part at most
        stands = self._seconds((first.stamp or 0) + back)
        return f"its clock begins again at frame {first.index}; {GOES_ON} ({stands:.3f} s)"

    def _seconds(self, stamp: int | None) -> float:
        base = self._base or Fraction(1)
        return float(((stamp or 0) - (self._first_stamp(stamp or 0) if self._origin is None else self._origin)) * base)

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
        place = f"frame {picture.index} has time {t_s:.6f} s"
        before_s = 0.0 if self._t_s is None else self._t_s
        step_s = float(1 / self._rate)
        longest_s = max(LONGEST_STEP_S, LONGEST_STEPS * step_s) * (picture.index - self._index)
        if t_s - before_s > longest_s:
            self._say("jump", f"{place} after {before_s:.6f} s, more than {longest_s:g} s later; {self._way_out}")
        if self._duration_s is not None and t_s > self._duration_s + max(
            TRUNCATED_SHARE * self._duration_s, 2 * step_s
        ):
            self._say("length", f"{place}, but it states a length of {self._duration_s:.6f} s; {self._way_out}")
