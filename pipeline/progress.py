"""What a long command says while it works: on a terminal one line that moves, elsewhere nothing or a line a second."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any, TextIO

Progress = Callable[[str, int, int | None], None]
"""Called with what is going on, how far, and out of how much (None = unknown)."""

CALL_EVERY_S = 0.1
"""Between two calls of a caller's own progress: ten a second, no more than an eye follows."""
LINE_EVERY_S = 1.0
"""Between two lines where there is no terminal."""
RATE_OVER_S = 3.0
"""A rate is that of the last seconds, so that it follows a recording that gets harder."""


def throttled(call: Callable[[int, int], None], every_s: float = CALL_EVERY_S) -> Callable[[int, int], None]:
    """``call`` at most once every so many seconds; the calls between cost a tenth of a microsecond each.

    Parameters
    ----------
    call : what is called
    every_s : between two calls
    """
    due_s = monotonic() + every_s

    def sometimes(done: int, more: int = 0) -> None:
        nonlocal due_s
        now_s = monotonic()
        if now_s >= due_s:
            due_s = now_s + every_s
            call(done, more)

    return sometimes


class Rate:
    """Steps per second over the last seconds."""

    def __init__(self, over_s: float = RATE_OVER_S) -> None:
        self._over_s = over_s
        self._past: deque[tuple[float, int]] = deque()

    def at(self, now_s: float, done: int) -> float | None:
        """Take a count in; the rate, 1/s, or None while it is not known."""
        if self._past and done < self._past[-1][1]:
            self._past.clear()
        self._past.append((now_s, done))
        while len(self._past) > 2 and now_s - self._past[1][0] >= self._over_s:
            self._past.popleft()
        first_s, first = self._past[0]
        return (done - first) / (now_s - first_s) if now_s > first_s else None


class PlainLines:
    """A line every second to where no terminal is, and one more when something is done.

    Parameters
    ----------
    stream : where to
    clock : time now, s
    """

    def __init__(self, stream: TextIO, every_s: float = LINE_EVERY_S, clock: Callable[[], float] = monotonic) -> None:
        self._stream, self._every_s, self._clock = stream, every_s, clock
        self._rate = Rate()
        self._due_s = clock() + every_s
        self._unsaid = ""
        self._last: tuple[str, int] = "", 0

    def show(self, text: str, done: int, total: int | None) -> None:
        """Fits ``Progress``."""
        stage = text.partition(",")[0]
        if stage != self._last[0] or done < self._last[1]:
            self.finish()
            self._rate = Rate()
        self._last = stage, done
        now_s = self._clock()
        self._unsaid = _line(text, done, total, self._rate.at(now_s, done))
        if now_s >= self._due_s or done == total:
            self.finish()
            self._due_s = now_s + self._every_s

    def finish(self) -> None:
        """Say what has not been said yet."""
        if self._unsaid:
            print(self._unsaid, file=self._stream, flush=True)
        self._unsaid = ""


def _line(text: str, done: int, total: int | None, rate_hz: float | None) -> str:
    parts = [text, f"frame {done} of {total}" if total else f"frame {done}"]
    if rate_hz is not None:
        parts.append(f"{rate_hz:.0f} frames/s")
        if total and rate_hz > 0 and done < total:
            parts.append(f"{(total - done) / rate_hz:.0f} s left")
    return ", ".join(parts)


@contextmanager
def progress(follow: bool = False) -> Iterator[Progress]:
    """Show progress on standard error while the block runs.

    Parameters
    ----------
    follow : with frames per second, and, where standard error is no terminal, as plain lines; else it is silent there
    """
    if sys.stderr.isatty():
        with _bar(follow) as show:
            yield show
    elif follow:
        lines = PlainLines(sys.stderr)
        yield lines.show
        lines.finish()
    else:
        yield lambda text, done, total: None


@contextmanager
def _bar(follow: bool) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns: list[Any] = [SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()]
    if follow:
        columns.append(TextColumn("{task.fields[rate]}"))
    columns.append(TimeRemainingColumn())
    console = Console(stderr=True, highlight=False)
    # drawn when told, not by a thread of its own that would take turns with the work
    with Bar(
        *columns,
        console=console,
        transient=True,
        disable=not console.is_terminal,
        speed_estimate_period=RATE_OVER_S,
        auto_refresh=not follow,
    ) as bar:
        task = bar.add_task("starting", total=None, rate="")
        rate, last = Rate(), 0

        def show(text: str, done: int, total: int | None) -> None:
            nonlocal last
            if done < last:
                bar.reset(task)
            last = done
            hertz = rate.at(monotonic(), done)
            said = "" if hertz is None else f"{hertz:.0f} frames/s"
            bar.update(task, description=text, completed=done, total=total, rate=said, refresh=follow)

        yield show


@contextmanager
def loading(room: str) -> Iterator[None]:
    """Import in this block a room and what it stands on.

    Python's collector would look through all that this makes again and again, and once more at exit: a third of a second that
    frees nothing. It sleeps in the block, and never looks at what was made there.
    """
    if f"{__name__.partition('.')[0]}.{room}" in sys.modules:
        yield
        return
    import gc

    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
