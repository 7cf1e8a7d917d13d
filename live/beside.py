"""A process beside the one that films, so that no frame's values wait for what it works out."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

from ..pipeline.executor.processes import THREADS, end_with, undisturbed


class Beside:
    """A process that sends what it finds until it is ended, or until nobody is left who asks.

    Parameters
    ----------
    target : what it does, with the arguments and then the end of a pipe to send by
    name : of the process
    arguments : that can be pickled; events of ``event`` among them
    """

    def __init__(self, target: Callable[..., None], name: str, *arguments: Any) -> None:
        for variable in THREADS:
            os.environ.setdefault(variable, "1")
        context = _context()
        self._pipe, theirs = context.Pipe(duplex=False)
        everything = (target, os.getpid(), *arguments, theirs)
        self._process = context.Process(target=_begin, args=everything, name=name, daemon=True)
        with undisturbed():
            self._process.start()
        theirs.close()

    def told(self, within_s: float = 0.0) -> Iterator[Any]:
        """What it sent since it was asked last.

        Parameters
        ----------
        within_s : so long what is still to come is waited for, or until it has ended
        """
        end_s = time.monotonic() + within_s
        try:
            while self._pipe.poll(max(end_s - time.monotonic(), 0.0)):
                yield self._pipe.recv()
        except (EOFError, OSError):
            return

    def end(self) -> None:
        """Nobody asks any more."""
        self._process.terminate()
        self._process.join()
        self._pipe.close()


def event() -> Any:
    """A flag that such a process sees when it is set."""
    return _context().Event()


def _context() -> Any:
    from multiprocessing import get_context

    return get_context("spawn")


def _begin(target: Callable[..., None], parent: int, *arguments: Any) -> None:
    """In the process."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)
    target(*arguments)


__all__ = ["Beside", "event"]
