"""Before the tow: is all in order? Every mark seen, how sharp, how bright; how well y will be known; the datum; the camera; the
line."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ..geometry import DatumFit
from ..record.run import Run
from .arrivals import ArrivalWatch
from .datum_watch import EVERY, LEARNT_FRAMES
from .seen import Seen, Valued

LAST_S = 2.0
"""What is said rests on the last so many seconds."""
SEEN_SHARE = 0.95
"""A mark is seen when it is in so many of the frames: a choice."""
BLURRED = 2.5
"""A mark whose place is known this much worse than the best one's is said to be blurred or faint: a choice."""
DATUM_SD = 3.0
"""The datum stands when its points are off by no more than so many of their own standard deviations, as in their mean square."""
TAUT_M = 0.02
"""A line is as stated when the tow point is within this of it, and within ``TAUT_SD`` of what the camera knows: choices; a
knot's place, or a hand that still holds the model."""
TAUT_SD = 4.0
"""Standard deviations of that."""


@dataclass(frozen=True)
class Line:
    """One line of the answer; ``good``: nothing to do about it."""

    what: str
    words: str
    good: bool


class Ready:
    """Gathers what the frames before a tow say.

    Parameters
    ----------
    run : as its run.toml says
    fit : of its datum
    """

    def __init__(self, run: Run, fit: DatumFit) -> None:
        self._run, self._fit = run, fit
        self._last: deque[Seen] = deque()
        self._count = 0

    def step(self, seen: Seen) -> None:
        """Take a frame."""
        self._last.append(seen)
        self._count += not seen.damaged
        while seen.t_s - self._last[0].t_s > LAST_S:
            self._last.popleft()

    def lines(self, arrivals: ArrivalWatch) -> list[Line]:
        """What is to be said now.

        Parameters
        ----------
        arrivals : of the same frames
        """
        frames = [seen for seen in self._last if not seen.damaged]
        if not frames:
            return [Line("frames", "none has come that can be used", False)]
        return [
            *self._marks(frames),
            self._precision(frames),
            self._datum(),
            self._camera(frames),
            *self._taut(frames),
            self._clock(frames, arrivals),
        ]

    def _marks(self, frames: list[Seen]) -> list[Line]:
        found: list[Line] = []
        sigma = [_middle([m.sigma_u_px for m in marks]) for marks in zip(*(f.marks for f in frames), strict=True)]
        for marks, own in zip(zip(*(f.marks for f in frames), strict=True), sigma, strict=True):
            here = [mark for mark in marks if mark.seen]
            share = len(here) / len(marks)
            if not here:
                found.append(Line(marks[0].marker, f"not seen: {marks[-1].reason}", False))
                continue
            clipped = sum(mark.clipped for mark in here) / len(here)
            words = [f"seen in {100 * share:.0f} % of the frames, place to {own:.3f} px"]
            words.append(
                f"width {_middle([m.width_px for m in here]):.1f} px, peak {_middle([m.peak_dn for m in here]):.0f}"
            )
            blurred = own > BLURRED * float(np.nanmin(sigma))
            words += ["clipped: less light or a shorter exposure"] if clipped > 0.5 else []
            words += ["much worse than the best mark: blurred or faint"] if blurred else []
            found.append(
                Line(marks[0].marker, "; ".join(words), share >= SEEN_SHARE and clipped <= 0.5 and not blurred)
            )
        return found

    @staticmethod
    def _precision(frames: list[Seen]) -> Line:
        y, beta = (_valued([getattr(f, name) for f in frames]) for name in ("y_cg_m", "beta_rad"))
        if not np.isfinite(y.sd):
            return Line("precision", "no frame shows two marks: no y, no beta", False)
        words = (
            f"y_CG to {1e3 * y.sd:.2f} mm a frame and {1e3 * y.common_sd:.2f} mm in common, beta to {np.degrees(beta.sd):.3f} and "
            f"{np.degrees(beta.common_sd):.3f} deg"
        )
        return Line("precision", words, True)

    def _datum(self) -> Line:
        ratio = self._fit.residual_px / self._fit.sigma_px[:, None]
        off = float(np.sqrt(np.mean(ratio**2)))
        words = f"{len(ratio)} points, off by {self._fit.rms_px:.2f} px rms, {off:.1f} of their standard deviations"
        return Line("datum", words, off < DATUM_SD)

    def _camera(self, frames: list[Seen]) -> Line:
        turns = [f.turn for f in frames if f.turn is not None]
        if not turns and self._count <= LEARNT_FRAMES + EVERY:
            words = f"it is not known yet whether it stands still ({self._count} of {LEARNT_FRAMES} pictures were looked at)"
            return Line("camera", words, False)
        if not turns:
            return Line(
                "camera",
                "no datum point can be known again in the picture: it is not watched whether it stands still",
                False,
            )
        last = turns[-1]
        if not np.isfinite(last.angle_rad):
            return Line(
                "camera",
                f"{last.points} of {last.of} datum points are seen: it is not known whether it stands still",
                False,
            )
        worst = max(turn.shift_px for turn in turns if np.isfinite(turn.shift_px))
        return Line("camera", f"still to {worst:.2f} px by {last.points} datum points", worst < 1.0)

    def _taut(self, frames: list[Seen]) -> list[Line]:
        slack = _valued([f.slack_m for f in frames])
        if not np.isfinite(slack.value):
            return []
        tow = self._run.tow
        sd = float(np.hypot(slack.common_sd, slack.sd))
        way = "shorter" if slack.value > 0 else "longer"
        words = f"{1e3 * abs(slack.value):.0f} +- {1e3 * sd:.1f} mm {way} than {tow.line_length_m} m"
        return [Line("line", words, abs(slack.value) < max(TAUT_M, TAUT_SD * sd))]

    @staticmethod
    def _clock(frames: list[Seen], arrivals: ArrivalWatch) -> Line:
        usual = arrivals.usual_s
        if usual is None:
            return Line("clock", "too few frames to know the rate", False)
        whose = "the source's stamps" if frames[-1].by_source else "stamped on arrival: the source sends no times"
        words = f"{1 / usual:.2f} frames/s ({whose}), {arrivals.missing} missing, {arrivals.uneven} uneven steps"
        return Line("clock", words, not arrivals.missing and not arrivals.uneven)


def _middle(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def _valued(values: list[Valued]) -> Valued:
    return Valued(*(_middle([getattr(v, name) for v in values]) for name in ("value", "sd", "common_sd")))


__all__ = ["Line", "Ready"]
