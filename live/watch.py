"""What is wrong with a tow while it is filmed, named within two seconds: marks, camera, line, wall.

Each watch takes frames as they are seen and says what began and what is over. What a watch cannot judge it does not name.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np

from ..identify.cut import hull_reach
from ..record.run import Run
from .arrivals import ArrivalWatch
from .event import Event, Lasting
from .seen import Seen

NEVER_S, LOST_S = 1.0, 0.5
"""A mark that was not seen for so long is named, from the first frame on and once it was seen: half a second is what a hand, or
a wave, takes to pass. Choices."""
MOVED_HOLD_S, MOVED_SD, MOVED_PX = 0.3, 6.0, 0.7
"""A camera has moved when its datum points have, by so many standard deviations of its turn and by more pixels than ripples
about a point feign, in so many seconds' looks: choices."""
SLACK_HOLD_S, SLACK_SD, SLACK_M = 0.15, 5.0, 0.006
"""A line is slack when the tow point has come nearer by so many standard deviations and so many metres, longer than a wave
lasts: choices; the second is above what the camera's own errors make of a swing."""
FIRST_S = 1.0
"""The line's length, as this camera sees it, is the median of the first second; the model is held or released on a taut line
then."""
MIDDLE_FRAMES = 5
"""The median of so many frames speaks for the line: a choice, so that one bad frame says nothing."""
WALL_HOLD_S = 0.1
"""A hull is near a wall when more than three frames say so."""
WALL_M = 0.05
"""Room to the wall below which it is named: as in plan.toml's [limits], where nothing else is said."""


class Watching(Protocol):
    """One watch."""

    def step(self, seen: Seen) -> Iterable[Event]:
        """Take a frame; what is to be named now."""
        ...


class MarkWatch:
    """A mark that is not seen."""

    def __init__(self) -> None:
        self._lost: dict[str, Lasting] = {}
        self._ever: set[str] = set()

    def step(self, seen: Seen) -> Iterator[Event]:
        """Take a frame."""
        for mark in seen.marks:
            known = self._lost.setdefault(mark.marker, Lasting(NEVER_S))
            if mark.seen and mark.marker not in self._ever:
                self._ever.add(mark.marker)
                if not known.named:
                    known = self._lost[mark.marker] = Lasting(LOST_S)
            if seen.damaged:
                continue
            lasted = known.since(seen.t_s)
            change = known.step(seen.t_s, not mark.seen)
            if change:
                yield Event(
                    "mark", seen.t_s, f"{mark.marker} is lost for {lasted or LOST_S:.1f} s: {mark.reason}", "fault"
                )
            elif change is False:
                yield Event("mark", seen.t_s, f"{mark.marker} is seen again", "good")


class CameraWatch:
    """A camera that was knocked."""

    def __init__(self) -> None:
        self._moved, self._gone = Lasting(MOVED_HOLD_S), Lasting(LOST_S)
        self.doubted = False
        """It has moved, or the last look seems so."""

    def step(self, seen: Seen) -> Iterator[Event]:
        """Take a frame."""
        turn = seen.turn
        if turn is None:
            return
        gone = self._gone.step(seen.t_s, not np.isfinite(turn.angle_rad))
        self.doubted = True
        if gone:
            words = f"{turn.points} of {turn.of} datum points are seen: they are covered, or the camera was moved far"
            yield Event("camera", seen.t_s, words, "fault")
        if not np.isfinite(turn.angle_rad):
            return
        moved = turn.shift_px > MOVED_PX and turn.angle_rad > MOVED_SD * turn.sd_rad
        change = self._moved.step(seen.t_s, moved)
        self.doubted = moved or self._moved.named
        if change:
            angle, sd = np.degrees(turn.angle_rad), np.degrees(turn.sd_rad)
            words = f"the camera has moved: it is turned by {angle:.2f} +- {sd:.2f} deg ({turn.shift_px:.1f} px)"
            yield Event("camera", seen.t_s, words, "fault")
        elif change is False or gone is False:
            yield Event("camera", seen.t_s, "the camera is where it was", "good")


class LineWatch:
    """A line that hangs slack: the tow point is nearer to the post than a taut line lets it.

    Parameters
    ----------
    camera : where it seems to have moved, what it shows of the line says nothing
    """

    def __init__(self, camera: CameraWatch) -> None:
        self._camera = camera
        self._slack = Lasting(SLACK_HOLD_S)
        self._first: list[float] = []
        self._began_s: float | None = None
        self._usual: float | None = None
        self._last: deque[float] = deque(maxlen=MIDDLE_FRAMES)

    def step(self, seen: Seen) -> Iterator[Event]:
        """Take a frame."""
        slack = seen.slack_m
        if not np.isfinite(slack.value) or self._camera.doubted:
            return
        self._began_s = seen.t_s if self._began_s is None else self._began_s
        if self._usual is None:
            self._first.append(slack.value)
            if seen.t_s - self._began_s < FIRST_S:
                return
            self._usual = float(np.median(self._first))
        self._last.append(slack.value)
        nearer = float(np.median(self._last)) - self._usual
        change = self._slack.step(seen.t_s, nearer > max(SLACK_M, SLACK_SD * slack.sd))
        if change:
            words = f"the line is slack: the tow point is {1e3 * nearer:.0f} +- {1e3 * slack.sd:.1f} mm nearer than on a taut line"
            yield Event("line", seen.t_s, words, "fault")
        elif change is False:
            yield Event("line", seen.t_s, "the line is taut again", "good")


class WallWatch:
    """A hull that comes near a wall.

    Parameters
    ----------
    run : with [model] and the tank's width; without them nothing is watched
    wall_m : room that is wanted
    """

    def __init__(self, run: Run, wall_m: float) -> None:
        water, self._model = run.file.water, run.file.model
        self._half_m = None if water is None or water.tank_width_m is None else water.tank_width_m / 2
        self._wall_m, self._near = wall_m, Lasting(WALL_HOLD_S)

    @property
    def able(self) -> bool:
        """The tank and the hull are known."""
        return self._half_m is not None and self._model is not None

    def step(self, seen: Seen) -> Iterator[Event]:
        """Take a frame."""
        if self._half_m is None or self._model is None or not np.isfinite(seen.y_cg_m.value):
            return
        y = seen.y_cg_m.value
        room = self._half_m - abs(y) - float(hull_reach(self._model, np.array(seen.beta_rad.value)))
        change = self._near.step(seen.t_s, room < self._wall_m)
        if change:
            side = "starboard" if y > 0 else "port"
            words = f"{1e3 * room:.0f} mm to the {side} wall (less than {1e3 * self._wall_m:.0f} mm)"
            yield Event("wall", seen.t_s, words, "warning")
        elif change is False:
            yield Event("wall", seen.t_s, "clear of the wall", "good")


class DamageWatch:
    """Pictures that could not be decoded as they were written."""

    def __init__(self) -> None:
        self._damaged, self._whole = Lasting(0.0), Lasting(LOST_S)
        self.count = 0

    def step(self, seen: Seen) -> Iterator[Event]:
        """Take a frame."""
        self.count += seen.damaged
        if self._damaged.step(seen.t_s, seen.damaged or None):
            yield Event("damaged", seen.t_s, "the picture is damaged; the marks are lost in it", "warning")
        elif self._damaged.named and self._whole.step(seen.t_s, not seen.damaged):
            self._damaged, self._whole = Lasting(0.0), Lasting(LOST_S)
            yield Event("damaged", seen.t_s, f"the pictures are whole again ({self.count} were damaged)", "good")


class Watch:
    """All of them, for one tow.

    Parameters
    ----------
    run : as its run.toml says
    wall_m : room to the wall that is wanted
    """

    def __init__(self, run: Run, wall_m: float = WALL_M) -> None:
        self.arrivals = ArrivalWatch()
        self.damage = DamageWatch()
        wall, camera = WallWatch(run, wall_m), CameraWatch()
        self._each: tuple[Watching, ...] = (
            self.arrivals,
            self.damage,
            MarkWatch(),
            camera,
            LineWatch(camera),
            *([wall] if wall.able else []),
        )

    def step(self, seen: Seen) -> list[Event]:
        """Take a frame; what is to be named now."""
        return [event for watch in self._each for event in watch.step(seen)]

    def tick(self, now_s: float) -> list[Event]:
        """No frame came until ``now_s`` (by the clock of ``Stamped.arrived_s``); what is to be named now."""
        return list(self.arrivals.tick(now_s))


__all__ = ["Watch"]
