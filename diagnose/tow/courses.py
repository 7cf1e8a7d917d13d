"""Functions of time, one for each run, as effects ask for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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


__all__ = ["by_run"]
