"""Cubics between the integrator's steps, from the values and rates at their ends."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from ...simulate.model import Array


def between_steps(values: Array, rates: Array, step_s: float, times_s: Array) -> Array:
    """Values (..., n) at times from the first step's begin; behind the last step its cubic goes on.

    Parameters
    ----------
    values, rates : (..., steps + 1), at the ends of the steps
    step_s : of the grid
    times_s : (n,)
    """
    ends = values.shape[-1]
    node = np.minimum((times_s / step_s).astype(int), ends - 2)
    share = times_s / step_s - node
    square, third = share**2, share**3
    begin, end = 2 * third - 3 * square + 1, 3 * square - 2 * third
    slopes = (third - 2 * square + share) * step_s, (third - square) * step_s
    weights = np.column_stack([begin, end, *slopes]).ravel()
    places = np.column_stack([node, node + 1, node + ends, node + 1 + ends]).ravel()
    matrix = csr_array((weights, places, np.arange(0, len(weights) + 1, 4)), shape=(len(times_s), 2 * ends))
    both = np.concatenate([np.moveaxis(values, -1, 0), np.moveaxis(rates, -1, 0)]).reshape(2 * ends, -1)
    return np.ascontiguousarray((matrix @ both).T).reshape(*values.shape[:-1], len(times_s))


__all__ = ["between_steps"]
