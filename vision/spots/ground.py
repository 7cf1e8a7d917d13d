"""How far an uneven ground may pull a mark, where a fit takes it for even.

A plank's grain, gravel, print or a glow is no noise: neighbouring pixels share it, and it goes with the deck, so that every frame
is pulled alike and no average takes it away. Its size is read where it can be seen, beside the mark, as a covariance of grey values
against their distance; a fit is linear in small changes of grey values, and so says what such a ground does to its centre. A mark
covers the ground below it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from .candidates import Array
from .fit import pull_of
from .model import GROUND, HEIGHT, HEIGHT_2, SLOPE_U, SLOPE_V, Model, U, expected, width_of

CLEAR_OF_SPOTS = 0.05
"""Pixels that hold less than this share of a spot's height, and less than the picture's noise, show the ground (what a shape that
is not quite the mark's leaves of its flank is no ground): a choice."""
NEAR_WIDTHS = 4.2
"""... and are nearer to its centre than so many widths: a mark may stand on a plate that ends 1.5 of its diameters (4.5 widths)
away."""
LEAST_PAIRS = 30
"""A distance that fewer pairs of pixels have tells no covariance: a choice."""


def ground_pull(values: Array, ground: NDArray[np.bool_], cover: Array, pull: Array) -> Array:
    """Variance of a mark's centre by the ground about it: its noise and its unevenness.

    Parameters
    ----------
    values : (b, s, s) grey values about a mark without the mark's own, in windows wider than the fitted one
    ground : (b, s, s), pixels that show the ground and nothing else
    cover : (b, s, s), share of a pixel that the mark covers, 0-1
    pull : (b, 2, s, s), px of the centre's u and v per grey value of each pixel; 0 outside the fitted window

    Returns
    -------
    variance : (2,), of u and v, px2; 0 where no ground is seen
    """
    count = ground.sum(axis=(1, 2))
    if not count.any():
        return np.zeros(2)
    seen = np.where(ground, values, 0.0)
    rest = np.where(ground, seen - (seen.sum(axis=(1, 2)) / np.maximum(count, 1))[:, None, None], 0.0)
    # so that no pixel meets another around the edge
    side: int = next_fast_len(2 * values.shape[1], real=True)  # pyright: ignore[reportAssignmentType]
    pairs, product = (
        np.fft.irfft2((np.abs(np.fft.rfft2(part, (side, side))) ** 2).sum(axis=0), (side, side))
        for part in (ground.astype(float), rest)
    )
    covariance = np.where(pairs > LEAST_PAIRS - 0.5, product / np.maximum(pairs, 1.0), 0.0)
    # noise is what not even a neighbour shares: the rest of a pixel's variance follows from its neighbours, by a parabola
    near, next_but_one = ((covariance[[k, -k], 0].sum() + covariance[0, [k, -k]].sum()) / 4 for k in (1, 2))
    shared = float(np.clip((4 * near - next_but_one) / 3, 0.0, covariance[0, 0]))
    noise, covariance[0, 0] = covariance[0, 0] - shared, shared
    open_to_it = np.abs(np.fft.fft2(pull * (1 - cover)[:, None], (side, side))) ** 2
    uneven = (open_to_it * np.fft.fft2(covariance).real).sum(axis=(2, 3)) / side**2
    return np.maximum(uneven + noise * (pull**2).sum(axis=(2, 3)), 0.0).mean(axis=0)


def pull_about(
    wide: tuple[Array, Array], fitted: tuple[Array, Array], theta: Array, model: Model, noise: tuple[float, float]
) -> Array:
    """The same of fitted spots, over what the pixels' own noise does by itself.

    A ratio, so that it holds of a fit whose own numbers are hardly told apart, too, where the linear response is no measure.

    Parameters
    ----------
    wide : (b, s, s) grey values about the spots, NaN where they are not the ground's or the spot's; (b, 2) corners
    fitted : (b, n, n) and (b, 2), the windows that were fitted, n <= s
    theta : (b, 16), what was found
    model : that was fitted
    noise : variance against grey value, of ``fit_spots``

    Returns
    -------
    share : (2,), of u and v; 1 where the ground is even
    """
    (values, corner), (inner, inner_corner) = wide, fitted
    size, rim = values.shape[1], (values.shape[1] - inner.shape[1]) // 2
    pull = np.zeros((len(values), 2, size, size))
    end = rim + inner.shape[1]
    pull[:, :, rim:end, rim:end] = pull_of(inner, inner_corner, theta, model, noise)
    bare = theta.copy()
    bare[:, [GROUND, SLOPE_U, SLOPE_V]] = 0.0
    mark, beside = bare.copy(), bare.copy()
    mark[:, HEIGHT], mark[:, HEIGHT_2] = 1.0, 0.0
    beside[:, HEIGHT], beside[:, HEIGHT_2] = 0.0, theta[:, HEIGHT_2] != 0
    cover = expected(mark, corner, size)[0]
    sd = np.sqrt(noise[0] + noise[1] * np.abs(theta[:, GROUND]))
    clear_of = np.minimum(CLEAR_OF_SPOTS, sd / np.maximum(np.abs(theta[:, HEIGHT]), 1e-9))[:, None, None]
    clear = np.maximum(cover, expected(beside, corner, size)[0]) < clear_of
    axis = np.arange(size)
    du, dv = (axis[None] + corner[:, k, None] - theta[:, U + k, None] for k in (0, 1))
    clear &= np.hypot(du[:, None, :], dv[:, :, None]) < (NEAR_WIDTHS * width_of(theta))[:, None, None]
    rest = values - expected(bare, corner, size)[0]  # a mark's tail is no unevenness
    white = (np.square(sd)[:, None] * (pull**2).sum(axis=(2, 3))).mean(axis=0)
    return ground_pull(rest, np.isfinite(values) & clear, np.clip(cover, 0.0, 1.0), pull) / np.maximum(white, 1e-12)
