"""Two cameras joined while they film, by a process of its own, so that no frame's values wait for it.

It reads what ``live.jsonl`` of each says, and asks ``joint``.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

from ..geometry import DatumFit
from ..record.run import Run
from .beside import Beside, event
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
        self._ended = event()
        self._process = Beside(_join, "joining", run, list(fits), by_arrival, self._ended)

    def told(self) -> Iterator[dict[str, Any]]:
        """Lines for ``live.jsonl`` since it was asked last: of the joint course, and of the cameras' clocks."""
        for lines in self._process.told():
            yield from lines

    def rest(self) -> Iterator[dict[str, Any]]:
        """The logs are whole: what it still has to say."""
        self._ended.set()
        for lines in self._process.told(LAST_S):
            yield from lines

    def end(self) -> None:
        """Nobody asks any more."""
        self._process.end()


def _join(run: Run, fits: list[DatumFit], by_arrival: bool, ended: Any, pipe: Any) -> None:
    """In the process."""
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
