"""Where the fit of a user's simulator begins: ends of ordinary least squares over longer and longer beginnings of the records.

A motion that swings for long says nothing of the way to its optimum: a frequency a tenth off is out of phase after five swings.
Over the first eighth of a record the way is open; from there the rest follows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import least_squares

from ..simulate.model import Array

BEGINNINGS = (0.125, 0.25, 0.5, 1.0)
"""Shares of the records, each fitted from the end of the one before."""
OTHERS = (0.5, 2.0)
"""Each shared number is tried at these times its start, too (at -1 and +1 of its size where it starts at 0). A choice."""
MOST_STEPS = 30
"""Of one least squares fit: a choice, for time; an end that is none is seen by what it leaves."""
KEPT = 2
"""So many of the ends, the best ones, go on."""
SAME = 0.01
"""Ends whose numbers differ by less, in units of their sizes, are one: a choice."""
Rows = Callable[[Array], tuple[Array, Array]]


def ends(rows: Sequence[Rows], start: Array, size: Array, tried: Sequence[int]) -> list[Array]:
    """The best distinct ends of all starts, the best first; the start itself where none has one.

    Parameters
    ----------
    rows : for each of BEGINNINGS: numbers (p,) -> whitened residuals (n,) and their slopes (n, p)
    start, size : (p,), of the numbers
    tried : indices of the numbers that are started elsewhere, too
    """
    begun = [start]
    for index in tried:
        for share in OTHERS:
            other = start.copy()
            other[index] = share * start[index] if start[index] else (size[index] if share > 1 else -size[index])
            begun.append(other)
    for part in rows:
        reached = [_end(part, one, size) for one in begun]
        left = [float(np.sum(part(one)[0] ** 2)) for one in reached]
        begun = _distinct([reached[k] for k in np.argsort(left) if np.isfinite(left[k])], size)
        if not begun:
            return [start]
    return begun


def _distinct(found: Sequence[Array], size: Array) -> list[Array]:
    """The first few that are not one another."""
    answer: list[Array] = []
    for here in found:
        if all(np.abs((here - other) / size).max() > SAME for other in answer):
            answer.append(here)
    return answer[:KEPT]


def _end(part: Rows, start: Array, size: Array) -> Array:
    """Least squares from a start; the start where the motion grows beyond bounds."""
    last: dict[bytes, tuple[Array, Array]] = {}

    def at(x: Array) -> tuple[Array, Array]:
        if x.tobytes() not in last:
            last.clear()
            last[x.tobytes()] = part(x)
        return last[x.tobytes()]

    if not np.isfinite(at(start)[0]).all():
        return start
    try:
        found = least_squares(
            lambda x: np.nan_to_num(at(x)[0], nan=1e6, posinf=1e6, neginf=-1e6),
            start,
            jac=lambda x: np.nan_to_num(at(x)[1], posinf=0.0, neginf=0.0),  # pyright: ignore[reportArgumentType]
            x_scale=size,
            max_nfev=MOST_STEPS,
        )
    except (ValueError, np.linalg.LinAlgError):
        return start
    return found.x


__all__ = ["BEGINNINGS", "ends"]
