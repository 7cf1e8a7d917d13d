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
SAY_EVERY_S = 1.0
"""A line of values is printed so often: a choice, what a person can follow."""


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument(
        "source",
        metavar="SOURCE",
        help="0 or /dev/video0: a camera; rtsp://..., udp://..., http://...: a stream; or a video file, played at its own rate",
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
    sub.add_argument("--no-fit", action="store_true", help="film and watch only; no track, no derivatives afterwards")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..live.folder import make_folder, next_tow, tows_of
    from ..live.session import live_tow
    from ..live.tows import Day, standing_lines
    from ..live.watch import WALL_M
    from ..pipeline.mistaken import named
    from ..record.errors import InputError
    from ..record.run import RUN_FILE, Run, read_run, refuse_two_cameras

    setup = read_run(options.like)
    refuse_two_cameras(setup, "towline live")
    if setup.file.source.motion is not None or not setup.file.marker or not setup.file.datum:
        raise InputError(
            setup.folder / RUN_FILE, "source", "a run with marks and a datum is expected, one that was filmed"
        )
    day = Day(options.plan)
    if not options.no_fit:
        with show_progress() as show:
            day.prepare(show)
    folder = next_tow(options.day)

    def begin(recording: str, size_px: tuple[int, int]) -> tuple[Run, Any]:
        from ..geometry import run_datum

        stated = setup.file.camera
        if stated is not None and stated.image_size_px != size_px:
            raise InputError(
                setup.folder / RUN_FILE,
                "camera.image_size_px",
                f"{list(stated.image_size_px)}, but the source's picture is {size_px[0]} x {size_px[1]}; the lens would be another",
            )
        with named(setup):
            fit = run_datum(setup, size_px)
        return make_folder(setup, folder, recording), fit

    stop = _Stop(options.seconds)
    print(f"{options.source} -> {folder}; Ctrl+C ends the tow")
    with stop:
        wall_m = WALL_M if day.wall_m is None else day.wall_m
        counts = live_tow(options.source, folder, begin, _Terminal(), stop, wall_m, not options.no_fit)
    print(counts.words)
    options.outcome.result["tow"] = folder.name
    options.outcome.result["frames"] = vars(counts)
    options.outcome.wrote(folder / RUN_FILE)
    if options.no_fit:
        return EXIT_OK
    began = time.monotonic()
    with show_progress():
        standing = day.after(tows_of(options.day))
    print("\n".join(standing_lines(standing)))
    print(f"({time.monotonic() - began:.1f} s after the tow's end)")
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

    def __init__(self) -> None:
        self._console, self._said_s = console(), float("-inf")

    def frame(self, seen: Any, latency_s: float) -> None:
        """A frame's values."""
        if seen.t_s - self._said_s < SAY_EVERY_S:
            return
        self._said_s = seen.t_s
        y, beta, alpha = seen.y_cg_m, seen.beta_rad, seen.alpha_rad
        lost = [mark.marker for mark in seen.marks if not mark.seen]
        degrees = math.degrees(1.0)
        words = (
            f"{seen.t_s:7.2f} s  y {1e3 * y.value:+8.1f} +- {1e3 * y.sd:.1f} mm  beta {degrees * beta.value:+7.2f} +- "
            f"{degrees * beta.sd:.2f} deg  alpha {degrees * alpha.value:+7.2f} +- {degrees * alpha.sd:.2f} deg"
        )
        if lost:
            words = f"{seen.t_s:7.2f} s  not seen: {', '.join(lost)}"
        self._console.print(f"{words}  [dim]({1e3 * latency_s:.0f} ms)[/dim]", markup=True)

    def event(self, event: Any) -> None:
        """Something was named."""
        self._console.print(f"{event.t_s:7.2f} s  {event.words}", style=COLOURS[event.level], markup=False)
        sys.stdout.flush()

    def ready(self, lines: list[Any]) -> None:
        """What is to be said before the tow."""
        for line in lines:
            style = COLOURS["good" if line.good else "warning"]
            self._console.print(f"  {line.what}: {line.words}", style=style, markup=False)
        good = all(line.good for line in lines)
        self._console.print("ready" if good else "not all is in order", style=COLOURS["good" if good else "warning"])
