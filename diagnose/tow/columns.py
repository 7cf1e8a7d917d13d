"""What columns hold: a column is a hypothesis, or a variation of one; the numbers of each, and what an effect in some is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ...simulate.model import Array
from ..effects import Effect, Late, Seen, Situation

OWN = ("alpha", "beta", "v", "r", "y_b", "beta_b", "tension", "tow_point", "line", "speed", "longer", "ahead")
"""Each run's own numbers; tension: T of a line that keeps it, R of one that keeps its length; longer, ahead: by how much a line
with a law of its own is longer at the start, and the model faster than the carriage."""
SPEED, LONGER, AHEAD = (OWN.index(name) for name in ("speed", "longer", "ahead"))
"""Where these stand."""
STATES, PAID_STATES = 4, 6
"""alpha, beta, v, r; with a law of the line's own its length beyond the stated one and u as well. Lagged velocities follow."""
Asked = TypeVar("Asked", Situation, Seen)
"""What an effect is given."""


@dataclass(frozen=True)
class Active:
    """An effect in the columns where it is not absent.

    Attributes
    ----------
    effect : which
    columns : of all
    numbers : (p, columns)
    """

    effect: Effect
    columns: slice
    numbers: Array


@dataclass(frozen=True)
class Numbers:
    """What the columns hold.

    Attributes
    ----------
    shared : (s, columns), of all runs
    own : (runs, len(OWN), columns)
    active : effects
    lates : how velocities are held back, sorted
    """

    shared: Array
    own: Array
    active: tuple[Active, ...]
    lates: tuple[Late, ...] = ()

    @property
    def width(self) -> int:
        """Columns."""
        return self.shared.shape[1]

    @property
    def lawful(self) -> bool:
        """Whether the line has a law of its own, in every column."""
        return any(a.effect.law is not None for a in self.active)

    def start(self) -> Array:
        """(states, runs, columns) at the runs' beginning; lagged velocities begin as the velocities."""
        first = [self.own[:, k] for k in range(STATES)]
        if self.lawful:
            first += [self.own[:, LONGER], self.own[:, SPEED] + self.own[:, AHEAD]]
        held = [self.own[:, k] if k else np.zeros_like(self.own[:, 0]) for k in held_from(self.lates)]
        return np.stack(first + held)


def held_from(lates: Sequence[Late]) -> list[int]:
    """Of each state that is held back the number of OWN that it begins as; 0: it begins at nothing."""
    return [k for late in lates for k in (2, 3, 0, 0)[: late.size]]


def held_before(lates: Sequence[Late], late: Late) -> int:
    """How many states that are held back stand before those of one."""
    return sum(one.size for one in lates[: lates.index(late)])


def own_numbers(**named: float) -> Array:
    """One run's own numbers (len(OWN),), those not named 0."""
    row = np.zeros(len(OWN))
    for name, value in named.items():
        row[OWN.index(name)] = value
    return row


def columns_of(whole: Asked, columns: slice) -> Asked:
    """What an effect is given, in its own columns: every array of it that has columns, and tuples of such arrays.

    Parameters
    ----------
    whole : what the effect is asked with
    columns : its own
    """
    changes = {}
    for name in whole.columns:
        value = getattr(whole, name)
        if isinstance(value, tuple):
            changes[name] = tuple(_in_columns(part, columns) for part in value)
        elif (own := _in_columns(value, columns)) is not value:
            changes[name] = own
    return replace(whole, **changes) if changes else whole


def _in_columns(value: Any, columns: slice) -> Any:
    """Restricted to some columns, where it has others too, and more than one: what has one is the same in all."""
    several = isinstance(value, np.ndarray) and value.ndim > 1 and value.shape[-1] > 1
    return value[..., columns] if several and columns != slice(0, value.shape[-1]) else value


__all__ = [
    "AHEAD",
    "LONGER",
    "OWN",
    "PAID_STATES",
    "SPEED",
    "STATES",
    "Active",
    "Numbers",
    "columns_of",
    "held_before",
    "held_from",
    "own_numbers",
]
