"""Many towed models at once: each lane is a dictionary of numbers, stacked into arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

Array = np.ndarray
Lane = Mapping[str, float]


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

    def __getitem__(self, name: str) -> Array:
        """``(n,)``, zero where the name is unknown."""
        found = self.values.get(name)
        return np.zeros(self.n) if found is None else found

    def has(self, name: str) -> bool:
        """Some lane's number is not zero."""
        return name in self._on
