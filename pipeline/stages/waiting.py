"""The first frames of a recording are decoded while the rest is made ready."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from sys import getswitchinterval, setswitchinterval
from threading import Thread
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from ...vision import Frame

SWITCH_S = 3e-4
"""How long one thread may keep Python to itself while another waits: the decoder needs it for 0.3 ms in every frame's 3 ms, and
with Python's own 5 ms decoding beside tracking is half as fast."""
T = TypeVar("T")


class Aside(Generic[T]):
    """A call under way in a thread of its own."""

    def __init__(self, call: Callable[[], T]) -> None:
        self._call = call
        self._answer: list[T] = []
        self._error: BaseException | None = None
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            self._answer.append(self._call())
        except BaseException as error:
            self._error = error

    @property
    def done(self) -> bool:
        """It has ended, well or not."""
        return not self._thread.is_alive()

    def result(self) -> T:
        """Wait for it; hand over what it returned or raise what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._answer[0]


@contextmanager
def begun(frames: Iterator[Frame]) -> Iterator[Iterator[Frame]]:
    """Have the first frames decoded while the rest is made ready; decoding ends with the block.

    Parameters
    ----------
    frames : of the recording
    """
    first = Aside(lambda: next(frames, None))

    def coming() -> Iterator[Frame]:
        frame = first.result()
        while frame is not None:
            yield frame
            frame = next(frames, None)

    before_s = getswitchinterval()
    setswitchinterval(SWITCH_S)
    try:
        yield coming()
    finally:
        setswitchinterval(before_s)
        close: Callable[[], None] | None = getattr(frames, "close", None)
        if close is not None and first.done:  # else its thread is the last to hold it, and closes it by letting go
            close()


__all__ = ["Aside", "begun"]
