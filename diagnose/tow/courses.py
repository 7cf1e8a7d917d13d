"""Functions of time, one for each run, as effects ask for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...simulate.model import Array


def by_run(functions: Sequence[Callable[[Array], Array]]) -> Callable[[Any], Array]:
    """Time, which broadcasts to (..., runs, 1), -> the values of each run's own function, (..., runs, 1).

    Parameters
    ----------
    functions : of each run
    """
    count = len(functions)

    def found(t_s: Any) -> Array:
        times = np.broadcast_to(np.asarray(t_s, dtype=float), np.broadcast_shapes(np.shape(t_s), (count, 1)))
        values = np.empty(times.shape)
        for k, function in enumerate(functions):
            values[..., k, :] = function(times[..., k, :])
        return values

    return found


@dataclass(frozen=True)
class Drawn:
    """Functions of time drawn at even steps, m of each run: straight lines between, nothing before and after.

    Attributes
    ----------
    begin_s : (m, runs) where they begin
    step_s : between their values
    values : (m, runs, n), the last two of each zero
    """

    begin_s: Array
    step_s: float
    values: Array

    def __call__(self, t_s: Any) -> Array:
        """All of them at times that broadcast to (..., runs, columns): (m, ..., runs, columns)."""
        kinds, runs, count = self.values.shape
        wide = (kinds, *(1,) * (np.ndim(t_s) - 2), runs, 1)
        # in place: this is asked thousands of times
        place = np.asarray(t_s) - self.begin_s.reshape(wide)
        place /= self.step_s
        np.minimum(np.maximum(place, 0.0, out=place), count - 2.0, out=place)
        before = place.astype(np.intp)
        place -= before
        before += (count * np.arange(kinds * runs)).reshape(wide)
        flat = self.values.reshape(-1)
        found = flat.take(before)
        before += 1
        after = flat.take(before)
        after -= found
        place *= after
        found += place
        return found


__all__ = ["Drawn", "by_run"]
