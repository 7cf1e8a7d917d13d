"""Which of its numbers an effect may do without: a family holds its simple members.

A carriage that drifts evenly is one that settles, with nothing that settles. With every number at its usual size the simple member
would pay for all of them, and lose to another effect that has fewer; as a member it is as likely as the full one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, combinations

Members = tuple[tuple[str, ...], ...]
"""Names of the numbers that each member has; the others are at their ``none``."""


def with_some(always: Sequence[str], others: Sequence[str | tuple[str, ...]], least: int = 0) -> Members:
    """Every member that has some of the other numbers beside those that it always has.

    Parameters
    ----------
    always : names
    others : names, or groups of names that come together
    least : so many of the others at least

    Examples
    --------
    >>> with_some(["share"], ["level"])
    (('share',), ('share', 'level'))
    >>> with_some([], ["ahead_m", "aside_m"], 1)
    (('ahead_m',), ('aside_m',), ('ahead_m', 'aside_m'))
    >>> with_some(["y_vvv"], [("y_vvr", "n_vvr")])
    (('y_vvv',), ('y_vvv', 'y_vvr', 'n_vvr'))
    """
    groups = [(other,) if isinstance(other, str) else other for other in others]
    some = (
        tuple(chain.from_iterable(chosen))
        for count in range(least, len(groups) + 1)
        for chosen in combinations(groups, count)
    )
    return tuple((*always, *chosen) for chosen in some)


def any_of(*names: str) -> Members:
    """Every member that has one of these numbers at least.

    Parameters
    ----------
    names : of the numbers
    """
    return with_some((), names, 1)


__all__ = ["Members", "any_of", "with_some"]
