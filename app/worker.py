"""One process beside the page that does the long jobs, one at a time; it says how far it is, and can be stopped."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from .jobs import Found

GRACE_S = 3.0
"""A job that does not heed the wish to stop within this is ended with its process; what it wrote is whole or absent."""
TELL_EVERY_S = 0.1
"""Between two reports of a job: ten a second, no more than an eye follows."""


@dataclass(frozen=True)
class Status:
    """How a job stands.

    Attributes
    ----------
    name : of the job; "" = none was started
    running : it is under way
    text, done, total : of its progress; total None = unknown
    began_s, ended_s : on the monotonic clock
    found : what it ended with; None while it runs, or where it failed or was stopped
    error : why it failed; "" = it did not
    stopped : it was stopped
    number : counts the jobs started
    """

    name: str = ""
    running: bool = False
    text: str = ""
    done: int = 0
    total: int | None = None
    began_s: float = 0.0
    ended_s: float = 0.0
    found: Found | None = None
    error: str = ""
    stopped: bool = False
    number: int = 0

    @property
    def took_s(self) -> float:
        """Since it began, to its end or to now."""
        return (self.ended_s or time.monotonic()) - self.began_s if self.name else 0.0


class Stopped(Exception):
    """The user wishes no more of this job."""


class Worker:
    """Runs ``jobs.JOBS`` in a process of its own, started with the first job (or ``warm``) and kept."""

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._process: Any = None
        self._pipe: Any = None
        self._stop: Any = None
        self._lock = threading.Lock()
        self._stop_asked_s = 0.0
        self._status = Status()

    def warm(self) -> None:
        """Have the process started and its rooms imported before they are needed."""
        with self._lock:
            self._alive()

    def start(self, name: str, folders: Sequence[Path], **options: Any) -> bool:
        """Begin a job; False where one is under way."""
        with self._lock:
            if self._status.running:
                return False
            self._alive()
            self._stop.clear()
            self._stop_asked_s = 0.0
            self._status = Status(name, True, "starting", began_s=time.monotonic(), number=self._status.number + 1)
            self._pipe.send((self._status.number, name, [Path(f) for f in folders], options))
            return True

    def stop(self) -> None:
        """Wish for the end of the job under way."""
        with self._lock:
            if self._status.running and not self._stop_asked_s:
                self._stop.set()
                self._stop_asked_s = time.monotonic()

    def poll(self) -> Status:
        """How the job stands now."""
        with self._lock:
            if self._status.running:
                self._take()
            return self._status

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._end()

    def _take(self) -> None:
        try:
            while self._pipe.poll():
                number, kind, content = self._pipe.recv()
                if number == self._status.number:
                    self._heed(kind, content)
        except (EOFError, OSError):
            why = (
                ""
                if self._stop_asked_s
                else f"the process ended ({self._process.exitcode}); was there too little memory?"
            )
            self._finish(error=why, stopped=bool(self._stop_asked_s))
            self._end()
            return
        if self._status.running and self._stop_asked_s and time.monotonic() - self._stop_asked_s > GRACE_S:
            self._end()
            self._finish(stopped=True)

    def _heed(self, kind: str, content: Any) -> None:
        if kind == "progress":
            text, done, total = content
            self._status = replace(self._status, text=text, done=done, total=total)
        elif kind == "found":
            self._finish(found=content)
        elif kind == "stopped":
            self._finish(stopped=True)
        else:
            self._finish(error=content)

    def _finish(self, **how: Any) -> None:
        self._status = replace(self._status, running=False, ended_s=time.monotonic(), **how)

    def _alive(self) -> None:
        if self._process is not None and self._process.is_alive():
            return
        self._end()
        self._pipe, theirs = self._context.Pipe()
        self._stop = self._context.Event()
        self._process = self._context.Process(target=_work, args=(theirs, self._stop, os.getpid()), daemon=True)
        self._process.start()
        theirs.close()

    def _end(self) -> None:
        if self._process is None:
            return
        self._process.terminate()
        self._process.join(GRACE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._pipe.close()
        self._process = self._pipe = None

    @property
    def process_id(self) -> int | None:
        """Of the process; None where none was started."""
        return None if self._process is None else self._process.pid


def _work(pipe: Any, stop: Any, parent: int) -> None:
    """The process: take a job, do it, say how it ended."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C is the page's to handle
    from ..record.errors import TowlineError
    from .jobs import JOBS

    while True:
        while not pipe.poll(0.5):
            if os.getppid() != parent:
                return
        try:
            number, name, folders, options = pipe.recv()
        except (EOFError, OSError):
            return
        last_s = 0.0

        def tell(text: str, done: int, total: int | None, number: int = number) -> None:
            nonlocal last_s
            if stop.is_set():
                raise Stopped
            now_s = time.monotonic()
            if now_s - last_s >= TELL_EVERY_S or (total and done >= total):
                last_s = now_s
                pipe.send((number, "progress", (text, done, total)))

        try:
            answer = ("found", JOBS[name](folders, tell, **options))
        except Stopped:
            answer = ("stopped", None)
        except TowlineError as error:
            answer = ("error", str(error))
        except OSError as error:
            answer = ("error", f"{error.filename or ''}: {error.strerror or error}")
        except Exception as error:
            import traceback

            traceback.print_exc()
            answer = ("error", f"a fault of the program: {type(error).__name__}: {error}")
        try:
            pipe.send((number, *answer))
        except (BrokenPipeError, OSError):
            return


__all__ = ["Status", "Worker"]
