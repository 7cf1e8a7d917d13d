"""A process beside the page that films: one tow or static record at a time, then the day's fit. A reload of the page is nothing to
it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

END_S = 10.0
"""When the page ends while a tow is filmed, its film is closed; who takes longer is ended. Nothing that was filmed is lost."""
TELL_EVERY_S = 0.2
"""Between two words on how far the preparation is."""


@dataclass(frozen=True)
class Order:
    """What is to be filmed.

    Attributes
    ----------
    setup : run folder of the set-up
    sources : as typed; one for each of the set-up's cameras
    day : folder of the day's tows
    plan : plan.toml; None: no wish
    what : a tow; the model held still; or nothing, and the day's tows are fitted together anew
    """

    setup: Path
    sources: tuple[str, ...]
    day: Path
    plan: Path | None = None
    what: Literal["tow", "static", "fit"] = "tow"


@dataclass(frozen=True)
class FilmStatus:
    """How the filming stands.

    Attributes
    ----------
    phase : "" (nothing was begun), "preparing", "filming", "fitting", "done", "failed"
    words : for the person
    folder : of the tow or static record; None: not begun
    number : goes up with every one
    stopping : its end was asked for
    began_s : on the monotonic clock
    """

    phase: str = ""
    words: str = ""
    folder: Path | None = None
    number: int = 0
    stopping: bool = False
    began_s: float = 0.0

    @property
    def running(self) -> bool:
        """Something is under way."""
        return self.phase in ("preparing", "filming", "fitting")


class Filming:
    """Films in a process of its own, started with the first order and kept: what a plan allows is judged once."""

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._process: Any = None
        self._pipe: Any = None
        self._stop: Any = None
        self._lock = threading.Lock()
        self._status = FilmStatus()

    def start(self, order: Order, seconds: float | None = None) -> bool:
        """Begin; False where something is under way.

        Parameters
        ----------
        order : what is to be filmed
        seconds : ends it by itself; None: when ``stop`` is called, or the source ends
        """
        with self._lock:
            self._heed()
            if self._status.running:
                return False
            self._alive()
            self._stop.clear()
            number = self._status.number + 1
            self._status = FilmStatus("preparing", "starting", None, number, began_s=time.monotonic())
            self._pipe.send((number, order, seconds))
            return True

    def stop(self) -> None:
        """End the tow; its fit follows."""
        with self._lock:
            if self._status.running and self._stop is not None:
                self._stop.set()
                self._status = replace(self._status, stopping=True)

    def poll(self) -> FilmStatus:
        """How it stands now."""
        with self._lock:
            self._heed()
            return self._status

    def close(self) -> None:
        """End the tow that is filmed, and the process."""
        with self._lock:
            if self._process is None:
                return
            self._stop.set()
            self._pipe.close()
            self._process.join(END_S)
            if self._process.is_alive():
                self._process.terminate()
                self._process.join()
            self._process = self._pipe = None

    def _heed(self) -> None:
        if self._pipe is None:
            return
        try:
            while self._pipe.poll():
                number, changes = self._pipe.recv()
                if number == self._status.number:
                    self._status = replace(self._status, **changes)
        except (EOFError, OSError):
            if self._status.running:
                words = f"the process ended ({self._process.exitcode}); what was filmed is kept"
                self._status = replace(self._status, phase="failed", words=words)
            self._process.join(0)
            self._pipe.close()
            self._process = self._pipe = None

    def _alive(self) -> None:
        if self._process is not None and self._process.is_alive():
            return
        self._pipe, theirs = self._context.Pipe()
        self._stop = self._context.Event()
        # no daemon: it has a process of its own, which tracks
        self._process = self._context.Process(target=_films, args=(theirs, self._stop, os.getpid()), name="filming")
        self._process.start()
        theirs.close()


class _Nobody:
    """What is seen stands in live.jsonl, which the page reads."""

    ended_s = float("nan")

    def ended(self) -> None:
        """The film is whole."""
        self.ended_s = time.monotonic()

    def frame(self, seen: Any, latency_s: float) -> None:
        """A frame's values."""

    def event(self, event: Any) -> None:
        """Something was named."""

    def camera(self, name: str) -> _Nobody:
        """Of one of two cameras."""
        return self

    def joint(self, told: Any) -> None:
        """What two cameras say together."""

    def ready(self, lines: Any) -> None:
        """What is to be said before the tow."""

    def steady(self, told: Any) -> None:
        """Where a steady tow comes to rest."""


def _films(pipe: Any, stop: Any, parent: int) -> None:
    """The process: take an order, film, say how it ended."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C is the page's to handle
    from ..record.errors import TowlineError

    films = _Films(stop, parent)
    while True:
        while not pipe.poll(0.5):
            if os.getppid() != parent:
                return
        try:
            number, order, seconds = pipe.recv()
        except (EOFError, OSError):
            return

        def say(number: int = number, **changes: Any) -> None:
            try:
                pipe.send((number, changes))
            except (BrokenPipeError, OSError):  # the page is gone: the tow ends, what was filmed is kept
                stop.set()

        try:
            films.film(order, seconds, say)
        except TowlineError as error:
            say(phase="failed", words=str(error))
        except OSError as error:
            say(phase="failed", words=f"{error.filename or ''}: {error.strerror or error}")
        except Exception as error:
            import traceback

            traceback.print_exc()
            say(phase="failed", words=f"a fault of the program: {type(error).__name__}: {error}")


class _Films:
    """What the process keeps from one tow to the next: the tows that a plan allows, judged."""

    def __init__(self, stop: Any, parent: int) -> None:
        self._stop, self._parent = stop, parent
        self._days: dict[tuple[Path | None, int], Any] = {}

    def film(self, order: Order, seconds: float | None, say: Callable[..., None]) -> None:
        """Film as ordered, and fit the day's tows."""
        from ..live.filming import film_static, film_tow, setup_of
        from ..live.session import Wanted

        setup = setup_of(order.setup)
        if order.what == "fit":
            self._fit(order, self._day(order.plan, say), time.monotonic(), "", say)
            return
        day = None if order.what == "static" else self._day(order.plan, say)
        end_s = None if seconds is None else time.monotonic() + seconds

        def told(folder: Path) -> None:
            say(phase="filming", words="", folder=folder)

        def stopped() -> bool:
            late = end_s is not None and time.monotonic() > end_s
            return late or self._stop.is_set() or os.getppid() != self._parent

        telling = _Nobody()
        if day is None:
            folder, counts = film_static(
                setup, order.sources[0], order.day, telling, stopped, Wanted(pictures=True), told
            )
            say(phase="done", words=f"{folder.name}: {counts.words}; the tows that come know it")
            return
        wanted = replace(day.wanted, pictures=True)
        folder, counts = film_tow(setup, order.sources, order.day, telling, stopped, wanted, True, told)
        names = [f"{camera.name}: " for camera in setup.file.cameras] or [""]
        words = "; ".join(name + one.words for name, one in zip(names, counts, strict=True))
        if os.getppid() == self._parent:
            self._fit(order, day, telling.ended_s, f"{folder.name}: {words}. ", say)

    def _fit(self, order: Order, day: Any, ended_s: float, words: str, say: Callable[..., None]) -> None:
        """What the day's tows tell, kept beside them."""
        from ..live.folder import tows_of
        from ..live.kept import keep_day

        say(phase="fitting", words=words)
        keep_day(order.day, day.after(tows_of(order.day)))
        say(phase="done", words=f"{words}Fitted, {time.monotonic() - ended_s:.1f} s after its end")

    def _day(self, plan: Path | None, say: Callable[..., None]) -> Any:
        from ..live.tows import Day

        key = plan, 0 if plan is None else plan.stat().st_mtime_ns
        if key not in self._days:
            day = Day(plan)
            said_s = [0.0]

            def show(what: str, done: int, total: int | None) -> None:
                if time.monotonic() - said_s[0] > TELL_EVERY_S:
                    said_s[0] = time.monotonic()
                    say(words=f"{what}: {done} of {total}" if total else what)

            day.prepare(show)
            self._days = {key: day}
        return self._days[key]


__all__ = ["FilmStatus", "Filming", "Order"]
