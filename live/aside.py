"""The tow's tracks, made in a process of their own while the recording grows: when it ends, they are nearly there.

They are made of the recording by what ``towline track`` does, not of what was seen live.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from ..pipeline.executor.processes import THREADS, end_with, undisturbed
from ..record.errors import TowlineError
from ..record.run import Run

PATIENCE_S = 60.0
"""After the recording's end: who has not caught up by then is given up; the tracks are then made as for any other run. A choice."""


class TrackingAside:
    """Tracks a recording that is being written.

    Parameters
    ----------
    run : its recording has begun, with some frames of it on the disk
    place : of the camera among the run's
    """

    def __init__(self, run: Run, place: int = 0) -> None:
        from multiprocessing import get_context

        for name in THREADS:
            os.environ.setdefault(name, "1")
        context = get_context("spawn")
        self._ended = context.Event()
        self._process = context.Process(
            target=_track, args=(str(run.folder), place, self._ended, os.getpid()), name="tracking", daemon=True
        )
        with undisturbed():
            self._process.start()

    def end(self) -> None:
        """The recording is whole: wait for its tracks."""
        self._ended.set()
        self._process.join(PATIENCE_S)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()

    def drop(self) -> None:
        """Nobody wants them any more."""
        self._process.terminate()
        self._process.join()


def _track(folder: str, place: int, ended: Any, parent: int) -> None:
    """In the process."""
    import signal

    from ..pipeline.stages.tracks import track_growing
    from ..record.run import cameras_of, read_run

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)
    try:
        track_growing(cameras_of(read_run(Path(folder)))[place], ended.is_set)
    except TowlineError:  # said when the tracks are made again, from the whole recording
        sys.exit(1)


__all__ = ["TrackingAside"]
