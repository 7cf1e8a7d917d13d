"""``towline live``: a tow while it is filmed: recorded, watched, and fitted with the day's others when it is over."""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from typing import Any

from .common import EXIT_OK, console, show_progress

NAME = "live"
HELP = "film a tow: recorded as it comes, watched while it runs, fitted with the day's other tows when it is over (docs/live.md)"
COLOURS = {"good": "green", "warning": "yellow", "fault": "bold red"}
STEADY_EVERY_S = 5.0
"""Where a steady tow comes to rest, so often: it changes slowly."""
SAY_EVERY_S = 1.0
"""A line of values is printed so often: a choice, what a person can follow."""


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument(
        "source",
        metavar="SOURCE",
        nargs="+",
        help="0 or /dev/video0: a camera; genicam:PRODUCER.cti#CAMERA: an industrial one; rtsp://..., udp://..., http://...: "
        "a stream; or a video file, played at its own rate; "
        "two of them where the set-up has two [[camera]], in their order",
    )
    sub.add_argument(
        "day", type=Path, metavar="DAY", help="folder of the day's tows; this one becomes DAY/tow-01, -02, ..."
    )
    sub.add_argument(
        "--like",
        type=Path,
        required=True,
        metavar="RUN",
        help="the set-up: a run folder with this camera, datum, marks, model and tow; its run.toml is the new tow's",
    )
    sub.add_argument(
        "--plan", type=Path, metavar="plan.toml", help="the wish: what is enough, and which tow helps most next"
    )
    sub.add_argument(
        "--seconds", type=float, metavar="S", help="end the tow after so long (default: Ctrl+C, or the source's end)"
    )
    sub.add_argument(
        "--static",
        action="store_true",
        help="film the model held still (20 s): the static record of the tows that come, which gives the measurement's noise",
    )
    sub.add_argument("--no-fit", action="store_true", help="film and watch only; no track, no derivatives afterwards")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..live.filming import STATIC_S, film_static, film_tow, setup_of
    from ..live.folder import tows_of
    from ..live.kept import keep_day
    from ..live.tows import Day, standing_lines
    from ..record.errors import InputError
    from ..record.run import RUN_FILE

    setup = setup_of(options.like)
    day = Day(options.plan)
    fits = not options.no_fit and not options.static
    if fits:
        with show_progress() as show:
            day.prepare(show)
    seconds = STATIC_S if options.static and options.seconds is None else options.seconds
    stop, terminal = _Stop(seconds), _Terminal()

    def told(folder: Path) -> None:
        print(
            f"{' and '.join(options.source)} -> {folder}; Ctrl+C ends the {'static record' if options.static else 'tow'}"
        )

    with stop:
        if options.static:
            if len(options.source) > 1:
                raise InputError("towline live", "--static", "two sources; a static record is filmed by one camera")
            folder, one = film_static(setup, options.source[0], options.day, terminal, stop, told=told)
            counts = (one,)
        else:
            folder, counts = film_tow(
                setup, options.source, options.day, terminal, stop, day.wanted, not options.no_fit, told
            )
    names = [camera.name for camera in setup.file.cameras] or [""]
    for name, one in zip(names, counts, strict=True):
        print(f"{name}: {one.words}" if name else one.words)
    options.outcome.result["static" if options.static else "tow"] = folder.name
    frames = {name: vars(one) for name, one in zip(names, counts, strict=True)}
    options.outcome.result["frames"] = frames.get("", frames)
    options.outcome.wrote(folder / RUN_FILE)
    if not fits:
        return EXIT_OK
    with show_progress():
        standing = day.after(tows_of(options.day))
        kept = keep_day(options.day, standing)
    print("\n".join(standing_lines(standing)))
    print(f"({time.monotonic() - terminal.ended_s:.1f} s after the tow's end)")
    options.outcome.wrote(kept)
    options.outcome.result["standing"] = standing
    options.outcome.result["enough"] = standing.enough
    return EXIT_OK


class _Stop:
    """Whether the tow is to end: Ctrl+C was pressed, or its time is over."""

    def __init__(self, seconds: float | None) -> None:
        self._end_s = None if seconds is None else time.monotonic() + seconds
        self._pressed = False

    def __call__(self) -> bool:
        return self._pressed or (self._end_s is not None and time.monotonic() > self._end_s)

    def __enter__(self) -> None:
        import signal
        import threading

        self._before: Any = None
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, lambda *_: self._press())

    def __exit__(self, *_: object) -> None:
        import signal

        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _press(self) -> None:
        if self._pressed:  # a second time: at once
            raise KeyboardInterrupt
        self._pressed = True


class _Terminal:
    """Prints what is seen, a line a second, and what is named at once."""

    def __init__(self, name: str = "", pair: _Terminal | None = None) -> None:
        self._name = f"{name}: " if name else ""
        self._pair = pair
        self._console, self._said_s, self._was_ready = console(), float("-inf"), False
        self._steady_said_s, self._stood = float("-inf"), False
        self._joined, self._cameras = False, ""
        self.ended_s = float("nan")

    def camera(self, name: str) -> _Terminal:
        """Of one of two cameras."""
        return _Terminal(name, self)

    def joint(self, told: dict[str, Any]) -> None:
        """What two cameras say together: a line a second instead of each camera's; of their clocks what is new."""
        from ..live.log import in_all

        if "cameras" in told:
            self._tell_cameras(told)
            return
        self._joined = True
        if told["t_s"] - self._said_s < SAY_EVERY_S:
            return
        self._said_s = told["t_s"]
        values = [told[name] for name in ("y_cg_m", "beta_rad", "alpha_rad")]
        if None in values[:2]:
            words = "no camera sees the model" if not told["camera"] else f"{told['camera']}: not seen"
        else:
            words = f"{told['camera']}: {_values(*(in_all(value) for value in values))}"
        self._console.print(
            f"{told['t_s']:7.2f} s  {words}  [dim]({1e3 * told['latency_s']:.0f} ms)[/dim]", markup=True
        )

    def _tell_cameras(self, told: dict[str, Any]) -> None:
        said = f"{told['told']} {told['agree']}"
        if said == self._cameras:
            return
        self._cameras = said
        style = COLOURS["good" if told["agree"] else "warning"]
        for words in told["cameras"]:
            self._console.print(f"{told['t_s']:7.2f} s  {words}", style=style, markup=False)

    def ended(self) -> None:
        """The film is whole."""
        self.ended_s = time.monotonic()

    def frame(self, seen: Any, latency_s: float) -> None:
        """A frame's values."""
        joined = self._pair is not None and self._pair._joined
        if joined or seen.t_s - self._said_s < SAY_EVERY_S:
            return
        self._said_s = seen.t_s
        lost = [mark.marker for mark in seen.marks if not mark.seen]
        values = _values(*((v.value, v.sd) for v in (seen.y_cg_m, seen.beta_rad, seen.alpha_rad)))
        words = f"{seen.t_s:7.2f} s  {self._name}{values}"
        if lost:
            words = f"{seen.t_s:7.2f} s  {self._name}not seen: {', '.join(lost)}"
        self._console.print(f"{words}  [dim]({1e3 * latency_s:.0f} ms)[/dim]", markup=True)

    def event(self, event: Any) -> None:
        """Something was named."""
        self._console.print(f"{event.t_s:7.2f} s  {self._name}{event.words}", style=COLOURS[event.level], markup=False)
        sys.stdout.flush()

    def steady(self, told: dict[str, Any]) -> None:
        """Where a steady tow comes to rest: at once when X_v stands, or no longer does, else now and then."""
        turned, self._stood = told["stands"] != self._stood, told["stands"]
        if turned or told["t_s"] - self._steady_said_s >= STEADY_EVERY_S:
            self._steady_said_s = told["t_s"]
            style = COLOURS["good"] if told["stands"] else None
            self._console.print(f"{told['t_s']:7.2f} s  {told['steady']}", style=style, markup=False)

    def ready(self, lines: list[Any]) -> None:
        """What is to be said before the tow, once; ``live.jsonl`` has it as it changes."""
        if self._was_ready:
            return
        self._was_ready = True
        for line in lines:
            style = COLOURS["good" if line.good else "warning"]
            self._console.print(f"  {self._name}{line.what}: {line.words}", style=style, markup=False)
        good = all(line.good for line in lines)
        self._console.print(
            self._name + ("ready" if good else "not all is in order"), style=COLOURS["good" if good else "warning"]
        )


def _values(y: tuple[float, float], beta: tuple[float, float], alpha: tuple[float, float]) -> str:
    """Each with its standard deviation."""
    degrees = math.degrees(1.0)
    return (
        f"y {1e3 * y[0]:+8.1f} +- {1e3 * y[1]:.1f} mm  beta {degrees * beta[0]:+7.2f} +- {degrees * beta[1]:.2f} deg  "
        f"alpha {degrees * alpha[0]:+7.2f} +- {degrees * alpha[1]:.2f} deg"
    )
