"""When the pictures of an even camera were taken, told from when they came: each late by something, none early.

A source without stamps has its pictures stamped on arrival. An encoder, a network, a busy machine make each of them late, one by a
millisecond, the next by forty, and a burst after a pause by more still. The camera itself is even, and many pictures are hardly
late: the earliest ones of each second lie on its beat, a line of time over number. Which number a picture has is known from its own
time and those of the pictures after it: it is the highest with which none of them would be early.

Moved so, a picture's time is that of its taking but for one constant, the shortest way here, which nothing in the times tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.robust import robust_sd

Array = NDArray[np.float64]

LEAST_FRAMES = 60
"""Fewer pictures in a row show no beat: a choice, two seconds."""
BLOCK_FRAMES, MOST_BLOCKS = 15, 300
"""The earliest of so many pictures is looked at; of a long recording there are so many of them at most."""
PAUSE_S, PAUSE_STEPS = 0.5, 10.0
"""Where nothing came for so long, and for so many steps, a source has stopped, and may begin anew on another beat: choices."""
EARLY_STEPS = 0.25
"""A picture may seem early by so much of a step and keep its number: the line is not exact while it is looked for."""
ON_TIME_STEPS, ON_TIME_SHARE = 1 / 6, 1 / 3
"""Of an even camera so many pictures at least are late by no more than this share of a step: of a camera whose rate wavers, or one
that is read whenever there is time, a sixth are."""
LEAST_STEP_S = 1e-6
"""Two pictures are at least so far apart."""
EVEN_STEPS, EVEN_BLOCKS = 0.05, 0.8
"""And of the earliest pictures so many at least lie about the line by no more than this share of a step; the others are those of
blocks that came late as a whole."""


@dataclass(frozen=True)
class Beat:
    """Times of pictures that were stamped on arrival.

    Attributes
    ----------
    t_s : (n,) when they were taken, but for a constant; where no beat was told, when they came
    even : (n,) a beat was told
    late_s : (n,) how much later they came; 0 where none was told
    wavers_s : by so much the earliest pictures waver about the beat (standard deviation of most of them, of the worst part); the
        line through all of them is known better
    rate_hz : of the camera, of the longest even part; NaN: there is none
    zero_s, step_s : the last part's beat, which goes on after it; NaN: it has none
    """

    t_s: Array
    even: NDArray[np.bool_]
    late_s: Array
    wavers_s: float
    rate_hz: float
    zero_s: float
    step_s: float

    def after(self, arrived_s: float, last_s: float) -> float:
        """When a picture was taken that came after these, as far as is known while none after it is there; when it came, where the
        one before has its place on the beat. Times rise.

        Parameters
        ----------
        arrived_s : when it came
        last_s : time of the one before it
        """
        taken_s = arrived_s
        if not np.isnan(self.step_s):
            number = np.floor((arrived_s - self.zero_s) / self.step_s + EARLY_STEPS)
            taken_s = float(self.zero_s + self.step_s * number)
        return taken_s if taken_s > last_s else max(arrived_s, last_s + LEAST_STEP_S)

    @property
    def words(self) -> str:
        """For the user."""
        if not self.even.any():
            return "its pictures were stamped when they came, and show no even beat: their times are as late as each was on its way"
        late_ms = 1e3 * np.percentile(self.late_s[self.even], [50, 99])
        said = (
            f"its pictures were stamped when they came, late by {late_ms[0]:.1f} ms (median; 99 % by at most {late_ms[1]:.0f}) "
            f"against an even beat of {self.rate_hz:.3f} Hz: their times are those of the beat, about which the earliest of each "
            f"{BLOCK_FRAMES} waver by {1e3 * self.wavers_s:.1f} ms"
        )
        rest = int((~self.even).sum())
        return said + (f"; {rest} in parts without a beat keep when they came" if rest else "")


def on_beat(arrived_s: Array) -> Beat:
    """The beat of a camera whose pictures were stamped on arrival.

    Parameters
    ----------
    arrived_s : (n,) when they came, s, rising

    Examples
    --------
    >>> taken = np.arange(100) / 25
    >>> beat = on_beat(taken + np.where(np.arange(100) % 3, 0.0, 0.015))
    >>> bool(np.allclose(beat.t_s, taken)), round(beat.rate_hz, 6)
    (True, 25.0)
    """
    arrived_s = np.asarray(arrived_s, dtype=float)
    t_s, even = arrived_s.copy(), np.zeros(len(arrived_s), dtype=bool)
    steps = np.diff(arrived_s)
    longest, wavers_s, rate_hz = 0, 0.0, np.nan
    zero_s = step_s = np.nan
    pauses = np.flatnonzero(steps > max(PAUSE_S, PAUSE_STEPS * float(np.median(steps)))) + 1 if len(steps) else []
    for part in np.split(np.arange(len(arrived_s)), pauses):
        found = _part(arrived_s[part]) if len(part) >= LEAST_FRAMES else None
        zero_s = step_s = np.nan
        if found is None or (part[0] and found[0][0] <= t_s[part[0] - 1]):
            continue
        times, wavers, step_s = found
        zero_s = times[0]
        t_s[part], even[part] = times, True
        if len(part) > longest:
            longest, rate_hz = len(part), 1 / step_s
        wavers_s = max(wavers, wavers_s)
    return Beat(t_s, even, np.where(even, arrived_s - t_s, 0.0), wavers_s, rate_hz, float(zero_s), float(step_s))


def _part(arrived_s: Array) -> tuple[Array, float, float] | None:
    """Times, how much the earliest waver, and the step, of pictures without a pause between them; None: no even beat."""
    from scipy.stats import theilslopes  # half a second, for recordings that need it

    begin, step = float(arrived_s[0]), float(np.median(np.diff(arrived_s)))
    if step <= 0:
        return None
    since = arrived_s - begin
    first = since[:BLOCK_FRAMES]
    zero = float((first - step * np.arange(len(first))).min())
    count, rows = 2 * BLOCK_FRAMES, np.zeros(0, dtype=int)
    while True:
        count = min(count, len(since))
        for _ in range(2):  # numbers by the line, the line by the earliest of them
            number = _numbers((since[:count] - zero) / step)
            rows = _earliest(since[:count] - zero - step * number)
            line: Any = theilslopes(since[rows], number[rows])
            step, zero = float(line.slope), float(line.intercept)
            if not step > 0:
                return None
        if count == len(since):
            break
        count *= 2
    number = _numbers((since - zero) / step)
    late = since - zero - step * number
    earliest = late[rows]
    usual = float(np.median(earliest))
    zero += usual
    wavers = float(np.quantile(np.abs(earliest - usual), EVEN_BLOCKS))
    on_time = float(np.mean(late < usual + ON_TIME_STEPS * step))
    if wavers > EVEN_STEPS * step or on_time < ON_TIME_SHARE:
        return None
    return np.asarray(begin + zero + step * number, dtype=float), robust_sd(earliest), step


def _numbers(steps: Array) -> NDArray[np.int_]:
    """The highest number of each picture (n,) with which neither it nor one after it comes early, from its time in steps."""
    alone = np.floor(steps + EARLY_STEPS).astype(int)
    place = np.arange(len(steps))
    number = np.minimum.accumulate((alone - place)[::-1])[::-1] + place
    number[-1] = min(number[-1], number[-2] + 1)  # none is after it: it is late rather than after one that is missing
    return number


def _earliest(late_s: Array) -> NDArray[np.int_]:
    """The place of the earliest picture of each block."""
    blocks = np.array_split(np.arange(len(late_s)), min(max(len(late_s) // BLOCK_FRAMES, 2), MOST_BLOCKS))
    return np.array([block[np.argmin(late_s[block])] for block in blocks])


__all__ = ["Beat", "on_beat"]
