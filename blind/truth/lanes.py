"""Many towed models at once: each lane is a dictionary of numbers, stacked into arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar, cast

import numpy as np

Array = np.ndarray
Lane = Mapping[str, float]
Made = TypeVar("Made")


class Lanes:
    """Numbers of ``n`` lanes by name; a name that no lane has is zero.

    Attributes
    ----------
    n : how many
    values : name -> ``(n,)``
    """

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.n = len(lanes)
        names = sorted({name for lane in lanes for name in lane})
        self.values = {name: np.array([float(lane.get(name, 0.0)) for lane in lanes]) for name in names}
        self._on = {name for name, value in self.values.items() if np.any(value)}
        self._nothing = np.zeros(self.n)
        self._nothing.flags.writeable = False  # one for all that is asked for: a step asks for a hundred
        self._made: dict[Callable[[Lanes], object], object] = {}

    def __getitem__(self, name: str) -> Array:
        """``(n,)``, zero where the name is unknown."""
        return self.values.get(name, self._nothing)

    def once(self, make: Callable[[Lanes], Made]) -> Made:
        """``make`` of these numbers, worked out the first time that it is asked for.

        Parameters
        ----------
        make : of nothing but the numbers
        """
        if make not in self._made:
            self._made[make] = make(self)
        return cast(Made, self._made[make])

    def part(self, here: Array) -> Lanes:
        """These lanes alone.

        Parameters
        ----------
        here : their places ``(m,)``
        """
        return Lanes([{name: float(value[k]) for name, value in self.values.items()} for k in here])

    def has(self, name: str) -> bool:
        """Some lane's number is not zero."""
        return name in self._on
