"""A record of fewer samples for the first, rough fit: means over short blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...simulate.model import Array
from ..data import RunData

BLOCK_SHARE = 1 / 16
"""Length of a block in units of (L + X_T)/U, 0.12 s for MARINER at 1.28 m/s: the mean of a swing over it is low by 1e-4."""
FEWEST = 100
"""Blocks that a record keeps at least: a choice."""


def block_length_s(data: RunData) -> float:
    """How long a block may be for this tow."""
    return BLOCK_SHARE * (data.tow.line_length_m + abs(data.tow.tow_point_m)) / data.tow.speed_m_s


def thinned(data: RunData, block_s: float | None = None, keep_first: bool = False, keep_modes: bool = False) -> RunData:
    """Block means of time, y and beta, with the covariance of a mean. No block lies over a gap.

    Parameters
    ----------
    data : one run
    block_s : length of a block; default: ``block_length_s``
    keep_first : the first sample stays alone, so that the start's parameters mean the same
    keep_modes : common modes are averaged too; else they are left out
    """
    length = block_length_s(data) if block_s is None else block_s
    times = data.t_s - data.t_s[0]
    usual = float(np.median(np.diff(times)))
    size = int(min(length, times[-1] / FEWEST) / usual + 1e-6)
    if size < 2:
        return data if keep_modes else without_modes(data)
    # whole numbers of samples, so that even records stay even
    cell = (np.rint(times / usual).astype(int) - int(keep_first)) // size
    first = np.flatnonzero(np.concatenate([[True], np.diff(cell) > 0]))
    counts = np.diff(np.append(first, len(times)))

    def mean(values: Array) -> Array:
        return np.add.reduceat(values, first, axis=0) / counts.reshape(-1, *[1] * (values.ndim - 1))

    def means(modes: Array) -> Array:
        return np.stack([mean(m) for m in modes]) if keep_modes and len(modes) else np.zeros((0, len(first), 2))

    return replace(
        data,
        t_s=mean(data.t_s),
        y_m=mean(data.y_m),
        beta_rad=mean(data.beta_rad),
        covariance=mean(data.covariance) / counts[:, None, None],
        common=means(data.common),
        lag=means(data.lag),
    )


def without_modes(data: RunData) -> RunData:
    """The run as if camera and codec had no error of their own."""
    return replace(data, common=data.common[:0], lag=data.lag[:0])
