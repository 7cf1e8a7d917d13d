"""A file that somebody else is still writing: who reads it waits at its end for more."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from pathlib import Path

WAIT_S = 0.02
"""Between two looks for more: less than a frame of usual film."""


class Growing(io.RawIOBase):
    """Read from its beginning to its end, wherever that will be; it cannot be gone back in.

    Parameters
    ----------
    path : of the file
    ended : whether it is whole; asked at its present end
    """

    def __init__(self, path: str | Path, ended: Callable[[], bool]) -> None:
        super().__init__()
        self._file = Path(path).open("rb")  # noqa: SIM115 - closed by close()
        self._ended = ended

    def readable(self) -> bool:
        """It is read."""
        return True

    def seekable(self) -> bool:
        """It is not gone back in."""
        return False

    def read(self, size: int = -1) -> bytes:
        """Some of the next bytes; none: it has ended."""
        while True:
            whole = self._ended()  # asked before it is read: what came before the end is not missed
            found = self._file.read(size)
            if found or whole:
                return found
            time.sleep(WAIT_S)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


__all__ = ["Growing"]
