"""How far a blind check's long work has come."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Progress = Callable[[str, int, int | None], None]
"""(what, done, of how many)"""
Made = TypeVar("Made")


def counted(made: Iterable[Made], what: str, total: int, progress: Progress | None, done: int = 0) -> Iterator[Made]:
    """The same, each told as it comes.

    Parameters
    ----------
    made : results
    what : is done
    total : how many there are in the end
    progress : is told; None: nobody
    done : of them before these

    Examples
    --------
    >>> said = []
    >>> list(counted("ab", "writing", 3, lambda *told: said.append(told), 1)), said
    (['a', 'b'], [('writing', 2, 3), ('writing', 3, 3)])
    """
    for k, one in enumerate(made, done + 1):
        if progress is not None:
            progress(what, k, total)
        yield one


__all__ = ["Progress", "counted"]
