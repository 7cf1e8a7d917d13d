"""Work done ahead in a background thread, a bounded way."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from threading import Condition, Thread, current_thread
from typing import Generic, TypeVar

T = TypeVar("T")

JOIN_S = 10.0
"""A thread that does not come back from a read within this is left to end by itself."""


class Ahead(Generic[T]):
    """Iterate over ``make()`` in a daemon thread that is ahead by a bounded number of items.

    All waiting items are taken at once, so that a fast consumer pays one change of threads for several items. Everything that
    ``make`` opens is opened and closed in that thread; what it raises is raised to the consumer, after the items before it.

    Parameters
    ----------
    make : called in the thread, gives the items
    most_items, most_bytes : bounds of what waits (one item always may)
    size_bytes : size of an item
    """

    def __init__(
        self, make: Callable[[], Iterator[T]], most_items: int, most_bytes: int, size_bytes: Callable[[T], int]
    ) -> None:
        self._most_items, self._most_bytes, self._size_bytes = most_items, most_bytes, size_bytes
        self._changed = Condition()
        self._waiting: deque[T] = deque()
        self._bytes = 0
        self._stopped = self._ended = False
        self._error: BaseException | None = None
        self._thread = Thread(target=self._work, args=(make,), name="towline-decode", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[T]:
        while True:
            with self._changed:
                while not self._waiting and not self._ended:
                    self._changed.wait()
                batch, self._waiting, self._bytes = self._waiting, deque(), 0
                self._changed.notify()
            if not batch:
                if self._error is not None:
                    raise self._error
                return
            while batch:
                yield batch.popleft()  # handed on without keeping it: a frame's memory goes with its user

    def close(self) -> None:
        """Stop the thread and wait until it has closed what it opened."""
        with self._changed:
            self._stopped = True
            self._waiting.clear()
            self._changed.notify()
        if self._thread is not current_thread():  # a forgotten iterator may be collected in any thread
            self._thread.join(JOIN_S)

    def _work(self, make: Callable[[], Iterator[T]]) -> None:
        items = None
        try:
            items = make()
            for item in items:
                if not self._put(item):
                    break
        except BaseException as error:
            self._error = error
        finally:
            close = getattr(items, "close", None)
            if close is not None:
                close()
            with self._changed:
                self._ended = True
                self._changed.notify()

    def _put(self, item: T) -> bool:
        size = self._size_bytes(item)
        with self._changed:
            while self._waiting and not self._stopped and self._full(size):
                self._changed.wait()
            if self._stopped:
                return False
            self._waiting.append(item)
            self._bytes += size
            self._changed.notify()
        return True

    def _full(self, more_bytes: int) -> bool:
        return len(self._waiting) >= self._most_items or self._bytes + more_bytes > self._most_bytes
