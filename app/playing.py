"""The recording played: which frame is due by the clock, at a speed of the person's choice."""

from __future__ import annotations

from dataclasses import dataclass

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Times the recording's own pace: a choice."""
TURN_S = 1 / 30
"""The page asks so often which frame is due: as often as a usual film changes."""


@dataclass
class Player:
    """Frames by the clock, from one on.

    Attributes
    ----------
    speed : times the recording's own pace
    running : it plays
    """

    speed: float = 1.0
    running: bool = False
    _begin: tuple[int, float] = (0, 0.0)
    _shown: int = -1

    def start(self, frame: int, now_s: float) -> None:
        """Play from a frame on.

        Parameters
        ----------
        frame : that is shown
        now_s : of a clock that only rises
        """
        self.running, self._begin, self._shown = True, (frame, now_s), frame

    def stop(self) -> None:
        """Stay where it is."""
        self.running = False

    def at_speed(self, speed: float, frame: int, now_s: float) -> None:
        """Go on at another speed; parameters as in ``start``."""
        self.speed = speed
        if self.running:
            self.start(frame, now_s)

    def due(self, frame: int, now_s: float, rate_hz: float, count: int) -> int:
        """The frame to show now; at the last one it stops. Where the person has gone elsewhere meanwhile, it plays from there.

        Parameters
        ----------
        frame : that is shown
        now_s : of the clock
        rate_hz : of the recording
        count : its frames
        """
        if frame != self._shown:
            self.start(frame, now_s)
        wanted = self._begin[0] + int((now_s - self._begin[1]) * rate_hz * self.speed + 1e-9)
        self._shown = min(wanted, max(count - 1, 0))
        if wanted >= count - 1:
            self.stop()
        return self._shown


def other_speed(speed: float, way: int) -> float:
    """The next faster (``way`` 1) or slower (-1) one.

    Parameters
    ----------
    speed : one of ``SPEEDS``
    way : 1 or -1
    """
    at = min(range(len(SPEEDS)), key=lambda k: abs(SPEEDS[k] - speed))
    return SPEEDS[min(max(at + way, 0), len(SPEEDS) - 1)]


__all__ = ["SPEEDS", "TURN_S", "Player", "other_speed"]
