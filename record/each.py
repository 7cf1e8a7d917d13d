"""One call time by time: here, or by an executor that is handed in (``pipeline.executor``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

Tell = Callable[[int], None]
"""How many are done."""


class Each(Protocol):
    """What to call, and its arguments time by time -> results in that order."""

    def __call__(
        self, call: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], tell: Tell | None = None
    ) -> list[Any]:
        """``tell`` hears after each how many are done."""
        ...


def in_turn(call: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], tell: Tell | None = None) -> list[Any]:
    """``Each`` in this process.

    Parameters
    ----------
    call : what is called
    arguments : of each call
    tell : is told how far it is
    """
    found: list[Any] = []
    for one in arguments:
        found.append(call(*one))
        if tell is not None:
            tell(len(found))
    return found


__all__ = ["Each", "Tell", "in_turn"]
