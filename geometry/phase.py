"""How a pixel draws a mark to its middle, or pushes it off: errors that come again with every pixel, the same in runs of a camera.

A sensor sees a mark as sums over pixels. Where the fitted spot is not quite the mark's own picture (a disc of two pixels, a light
that saturates, a lens that blurs less than a pixel), the place found is off by an amount that depends on where in its pixel the
mark lies: none at the pixel's middle and at its edge, and of opposite sign before and behind. Across many pixels that averages
out. A mark that crawls over two or three in a whole tow is carried off slowly, and no scatter shows it. How much is a number for
nobody; that it goes with the place is known:

    shift = a sin(2 pi place),        a (2,) px, along u and v, of each mark

a are common modes, as a camera's errors are, and the fit of the derivatives finds what there is of them.
"""

from __future__ import annotations

import numpy as np

from .camera import Array
from .lag import smooth_path

PHASE_PX = 0.03
"""Usual size of a (standard deviation), px: discs of two to four pixels under a Gaussian fit are off by 0.01 to 0.05. A choice."""
PHASES_OF_A_MARK = 2
"""Modes of each mark: along u and along v."""


def phase_modes(t_s: Array, pixel_px: Array) -> Array:
    """Change of the marks' pixels (k, n, m, 2) with each mode of unit variance, k = 2 m: of each mark along u, along v.

    The places are means about each time: a place that held the noise of its own frame would explain that noise.

    Parameters
    ----------
    t_s : (n,) times, rising
    pixel_px : (n, m, 2), NaN where not measured; a pixel's middle is at a whole number

    Examples
    --------
    >>> crawling = np.linspace(10.0, 12.0, 201)[:, None, None] * np.ones((1, 1, 2))
    >>> modes = phase_modes(np.arange(201) / 25.0, crawling)
    >>> modes.shape, (modes[0, [100, 125], 0, 0] / PHASE_PX).round(3).tolist()
    ((2, 201, 1, 2), [0.0, 1.0])
    """
    n, m = pixel_px.shape[:2]
    modes = np.zeros((m, PHASES_OF_A_MARK, n, m, 2))
    for mark in range(m):
        seen = np.isfinite(pixel_px[:, mark]).all(axis=1)
        if not seen.any():
            continue
        for axis in (0, 1):
            place = smooth_path(t_s[seen], pixel_px[seen, mark, axis])
            modes[mark, axis, seen, mark, axis] = PHASE_PX * np.sin(2 * np.pi * place)
    return modes.reshape(-1, n, m, 2)


__all__ = ["PHASES_OF_A_MARK", "PHASE_PX", "phase_modes"]
