"""Frames by their times alone: missing, late, slow, by a clock that steps, or not coming at all."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median
from typing import Protocol

from ..vision.recording.beat import PAUSE_S, PAUSE_STEPS
from .event import Event, Lasting

LEARN_FRAMES, USUAL_FRAMES = 10, 61
"""Steps from which the source's usual one is known, and the last ones it is the median of: choices."""
EVEN = 0.25
"""A step that is off a whole number of usual ones by more than this share of one is uneven; cameras' stamps waver by a few per
cent."""
EVEN_ARRIVED = 1.5
"""The same where the source stamps nothing and frames are stamped on arrival: what a busy network does to one frame is no
fault."""
UNEVEN_OF, UNEVEN_LEAST = 30, 1
"""So many uneven steps of the last so many are named."""
RATE_S, SLOW = 1.5, 0.8
"""A source is slow when fewer than this share of its usual frames came in so many seconds: choices."""
SAID_EVERY_S = 5.0
"""What happens again and again is named at most so often, with its count."""


class Timed(Protocol):
    """A frame's times, as in ``Stamped``."""

    @property
    def t_s(self) -> float:
        """By the source's stamp."""
        ...

    @property
    def arrived_s(self) -> float:
        """When its last byte was here."""
        ...

    @property
    def by_source(self) -> bool:
        """The source stamps its frames."""
        ...


@dataclass(frozen=True)
class Arrival:
    """The times alone."""

    t_s: float
    arrived_s: float
    by_source: bool


class ArrivalWatch:
    """Steps from frame to frame, by the source's clock and by this machine's.

    Attributes
    ----------
    frames, missing : frames that came, and those that the stamps say did not
    uneven : steps of the source's clock that are no whole number of its usual one
    """

    def __init__(self) -> None:
        self.frames = self.missing = self.uneven = 0
        self._last: Timed | None = None
        self._steps: deque[float] = deque(maxlen=USUAL_FRAMES)
        self._arrived: deque[float] = deque()
        self._first_rate_hz: float | None = None
        self._silent: float | None = None
        self._slow = Lasting(0.0)
        self._said: dict[str, float] = {}
        self._missing_said = 0

    @property
    def usual_s(self) -> float | None:
        """The usual step; None while it is not known."""
        return median(self._steps) if len(self._steps) >= LEARN_FRAMES else None

    def step(self, seen: Timed) -> Iterator[Event]:
        """Take a frame."""
        last, self._last = self._last, seen
        self.frames += 1
        if last is not None:
            yield from self._after(last, seen)
        yield from self._rate(seen)

    def tick(self, now_s: float) -> Iterator[Event]:
        """No frame came until ``now_s``."""
        last = self._last
        if last is None or self._silent is not None:
            return
        quiet = now_s - last.arrived_s
        if quiet > max(PAUSE_S, PAUSE_STEPS * (self.usual_s or 0.0)):
            self._silent = last.arrived_s
            yield Event("source", last.t_s + quiet, f"no frame for {quiet:.1f} s: the source has stopped", "fault")

    def _after(self, last: Timed, seen: Timed) -> Iterator[Event]:
        step, waited = seen.t_s - last.t_s, seen.arrived_s - last.arrived_s
        usual = self.usual_s
        if self._silent is not None:
            self._silent = None
            self._arrived.clear()
            self._slow = Lasting(0.0)
            yield Event("source", seen.t_s, f"the source is back after {waited:.1f} s", "good")
            return
        if step > 0:
            self._steps.append(step)
        if usual is None:
            return
        whole = max(round(step / usual), 1)
        off = abs(step - whole * usual)
        if not seen.by_source:
            if off > EVEN_ARRIVED * usual and whole == 1:
                yield from self._uneven(step, usual, seen)
            return
        if whole > 1 and off <= EVEN * usual and waited > step / 2:
            self.missing += whole - 1
            yield from self._now_and_then(
                "missing",
                seen,
                f"{self.missing - self._missing_said} frames are missing: the source or the way here drops them",
            )
        elif whole > 1 and waited <= step / 2:
            yield from self._uneven(step, usual, seen, f"the source's clock stepped by {step - usual:+.3f} s")
        elif off > EVEN * usual:
            yield from self._uneven(step, usual, seen)

    def _uneven(self, step: float, usual: float, seen: Timed, words: str = "") -> Iterator[Event]:
        self.uneven += 1
        words = words or f"the clock is irregular: a step of {1e3 * step:.1f} ms, usual is {1e3 * usual:.1f} ms"
        yield from self._now_and_then("clock", seen, words)

    def _now_and_then(self, kind: str, seen: Timed, words: str) -> Iterator[Event]:
        if seen.t_s - self._said.get(kind, -SAID_EVERY_S) < SAID_EVERY_S:
            return
        self._said[kind] = seen.t_s
        self._missing_said = self.missing if kind == "missing" else self._missing_said
        yield Event(kind, seen.t_s, words, "warning")

    def _rate(self, seen: Timed) -> Iterator[Event]:
        """Frames of the last seconds by this machine's clock, against the source's usual step."""
        arrived, usual = self._arrived, self.usual_s
        arrived.append(seen.arrived_s)
        if seen.arrived_s - arrived[0] < RATE_S:
            return
        while seen.arrived_s - arrived[0] > RATE_S:
            arrived.popleft()
        rate_hz = (len(arrived) - 1) / max(seen.arrived_s - arrived[0], 1e-9)
        if self._first_rate_hz is None:
            self._first_rate_hz = rate_hz
            return
        wanted = max(self._first_rate_hz, 1 / usual if usual else 0.0) if seen.by_source else self._first_rate_hz
        change = self._slow.step(seen.arrived_s, rate_hz < SLOW * wanted)
        if change:
            yield Event(
                "source",
                seen.t_s,
                f"the source is slow: {rate_hz:.1f} frames/s come, {wanted:.1f} are usual",
                "warning",
            )
        elif change is False:
            yield Event("source", seen.t_s, f"the source is as fast as before ({rate_hz:.1f} frames/s)", "good")


__all__ = ["Arrival", "ArrivalWatch", "Timed"]
