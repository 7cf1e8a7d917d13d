"""Independent pieces of a diagnosis: one after the other, or as an executor that is handed in has them (``pipeline.executor``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Spread(Protocol):
    """``work`` of every item, in their order; what is answered does not depend on how many go at once."""

    def __call__(
        self, work: Callable[[Item], Answer], items: Sequence[Item], known: Sequence[object] = ()
    ) -> list[Answer]:
        """``known``: objects that answers may hold and that stand for themselves."""
        ...


def one_by_one(work: Callable[[Item], Answer], items: Sequence[Item], known: Sequence[object] = ()) -> list[Answer]:
    """``Spread`` without any executor.

    Parameters
    ----------
    work : what is done of an item
    items : in their order
    known : objects that stand for themselves
    """
    return [work(item) for item in items]


__all__ = ["Spread", "one_by_one"]
