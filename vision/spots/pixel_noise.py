"""The noise of a mark's pixels, variance against grey value, from what its fits leave over: of its ground and of itself, two means
each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .candidates import Array
from .model import HEIGHT, expected

LEAST_NOISE_DN2 = 0.05
"""Variance of a level's rounding is 1/12 DN2; a codec smooths some of it away. A floor, so that no weight runs
off."""
MOST_SLOPE_DN = 0.5
"""Largest variance per grey value: 2 electrons a DN."""
ON_GROUND, ON_SPOT = 0.05, 0.2
"""Pixels below the first share of the spot's height are its ground, those above the second are the spot: choices."""
INSIDE_TAPER = 0.7
"""Pixels that the fit weighs less than this tell nothing of noise: a choice."""


def pixel_noise(
    values: Array, corner: Array, theta: Array, free: int, white_dn: float | None
) -> tuple[float, float] | None:
    """Variance at grey value 0, DN2, and its growth per grey value, DN; None where no window shows both ground and spot.

    Parameters
    ----------
    values, corner : windows (b, n, n), NaN where nothing was seen, and their corners (b, 2)
    theta : what was fitted to each
    free : how many parameters were
    white_dn : the picture's white, which pixels do not exceed; None: none
    """
    mean, taper = expected(theta, corner, values.shape[2])
    square = (values - mean) ** 2
    rise = np.abs(mean - theta[:, :1, None]) / np.abs(theta[:, HEIGHT, None, None])
    usable = np.isfinite(values) & (taper > INSIDE_TAPER)
    if white_dn is not None:
        usable &= values < white_dn - 2
    # the fit's parameters lie in the spot, all but the ground's: its few pixels are left that much closer to the model
    low, high = usable & (rise < ON_GROUND), usable & (rise > ON_SPOT)
    spot = np.maximum(high.sum(axis=(1, 2)), 1)
    spent = spot / np.maximum(spot - free + 1, 0.3 * spot)
    sound = low.any(axis=(1, 2)) & high.any(axis=(1, 2))
    if not sound.any():
        return None
    # medians over the frames: a lamp or a rail in some windows is not noise
    (var_low, at_low), (var_high, at_high) = (
        (np.median(_mean(square, part)[sound]), np.median(_mean(mean, part)[sound])) for part in (low, high)
    )
    var_high *= float(np.median(spent[sound]))
    slope = float(np.clip((var_high - var_low) / (at_high - at_low), 0.0, MOST_SLOPE_DN)) if at_high != at_low else 0.0
    if at_high < at_low:
        # where there is no light noise is not negative: the ground's pixels tell more than a dark mark's few
        slope = min(slope, max(float(var_low) - LEAST_NOISE_DN2, 0.0) / at_low)
    return max(float(var_low - slope * max(at_low, 0.0)), LEAST_NOISE_DN2), slope


def _mean(values: Array, where: NDArray[np.bool_]) -> Array:
    """Mean over some pixels of each window ``(b, n, n)``; 0 where there is none."""
    return np.where(where, values, 0.0).sum(axis=(1, 2)) / np.maximum(where.sum(axis=(1, 2)), 1)
