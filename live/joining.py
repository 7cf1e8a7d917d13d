"""Two cameras joined while they film, by a process of its own, so that no frame's values wait for it.

It reads what ``live.jsonl`` of each says, and asks ``joint``.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from typing import Any

from ..geometry import DatumFit
from ..pipeline.executor.processes import THREADS, end_with, undisturbed
from ..record.run import Run
from .joint import Joint
from .log import LogReader, logs_of

EVERY_S = 0.1
"""The logs are looked at so often: what is new then is joined in some 10 ms."""
LAST_S = 3.0
"""After the tow's end: so long the last lines are waited for."""


class Joining:
    """Joins what two cameras say of a tow that is being filmed.

    Parameters
    ----------
    run : with two ``[[camera]]``, whose logs are being written
    fits : of each camera's datum
    by_arrival : as of ``Joint``
    """

    def __init__(self, run: Run, fits: Sequence[DatumFit], by_arrival: bool) -> None:
        from multiprocessing import get_context

        for name in THREADS:
            os.environ.setdefault(name, "1")
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe(duplex=False)
        self._ended = context.Event()
        arguments = (run, list(fits), by_arrival, theirs, self._ended, os.getpid())
        self._process = context.Process(target=_join, args=arguments, name="joining", daemon=True)
        with undisturbed():
            self._process.start()
        theirs.close()

    def told(self) -> Iterator[dict[str, Any]]:
        """Lines for ``live.jsonl`` since it was asked last: of the joint course, and of the cameras' clocks."""
        try:
            while self._pipe.poll():
                yield from self._pipe.recv()
        except (EOFError, OSError):
            return

    def rest(self) -> Iterator[dict[str, Any]]:
        """The logs are whole: what it still has to say."""
        self._ended.set()
        end_s = time.monotonic() + LAST_S
        try:
            while self._pipe.poll(max(end_s - time.monotonic(), 0.0)):
                yield from self._pipe.recv()
        except (EOFError, OSError):
            return

    def end(self) -> None:
        """Nobody asks any more."""
        self._process.terminate()
        self._process.join()
        self._pipe.close()


def _join(run: Run, fits: list[DatumFit], by_arrival: bool, pipe: Any, ended: Any, parent: int) -> None:
    """In the process."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)
    joint, readers = Joint(run, fits, by_arrival), [LogReader(path) for path in logs_of(run)]
    last = False
    while not last:
        began = time.monotonic()
        last = ended.is_set()
        for place, reader in enumerate(readers):
            joint.add(place, reader.records())
        said = joint.match()
        lines = ([] if said is None else [said]) + joint.rows(last)
        if lines:
            pipe.send(lines)
        time.sleep(max(EVERY_S - (time.monotonic() - began), 0.0))


__all__ = ["Joining"]
