"""The centre of a mark that looks the same turned by half a turn: a dot, a cross, a ring, the corner of a chessboard.

Nothing else is known of the mark. The picture is compared with itself turned about a point, and the point is moved until both
agree (Gauss-Newton). A foreshortened mark stays symmetric. A shift of the centre changes every pixel's difference by twice its
gradient while the difference holds the noise of two pixels, so that the variance comes to the Cramer-Rao bound of a known
template, sigma^2 / sum(g g'), but for the pixels' weights: they are the gradients of the smoothed picture (those of the bare one
hold noise of their own). What is left need not be noise: texture of the ground and a codec's error go together from pixel to pixel,
and their covariance over a few pixels is read from what is left itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

STEPS = 20
"""Of the search at most; what has not settled by then is no symmetric mark."""
SETTLED_PX = 1e-3
"""A step below this ends the search: well below any sigma of a mark."""
SOFT_PX = 2.0
"""The window's weight falls to 0 over this width, so that pixels come and go smoothly."""
MARGIN_PX = 4
"""The cut-out goes so much beyond the window, for the spline's own edge."""
LEAST_RADIUS_PX = 2.0
"""Of the window: a smaller one holds too few pixels to tell a symmetry."""
SLOPE_STEP_PX = 0.25
"""Of the central differences on the spline: a choice, well within a pixel."""
SMOOTH_PX = 0.8
"""Of the picture whose gradients are the weights."""
LEAST_ENERGY = 1e-3
"""Directions of less gradient than this share of the other one's tell nothing (an edge has no centre)."""
LAG_PX = 6
"""What is left goes together over less than this (texture of the ground, a codec's blocks): its covariance is tapered to here."""
TOGETHER = 1.5
"""What is left goes together where that makes the centre's variance larger by this: read from a few hundred pixels it scatters by
some tenths, and what seems to go apart is no reason to be surer. A choice."""
LARGEST_ASYMMETRY = 0.5
"""Of what is left over the window's own scatter: 1 = nothing is symmetric."""


@dataclass(frozen=True)
class Symmetry:
    """A centre of symmetry.

    Attributes
    ----------
    centre_px : (2,)
    sigma_px : (2,), standard deviations from what is left: its scatter, and how far it goes together from pixel to pixel
    noise_dn : of a pixel
    asymmetry : what is left over the window's own scatter
    """

    centre_px: Array
    sigma_px: Array
    noise_dn: float
    asymmetry: float


def centre_of_symmetry(luma: Array, start_px: Array, radius_px: float) -> Symmetry | None:
    """Find the centre near ``start_px`` (off by less than about the mark's own width).

    Parameters
    ----------
    luma : (h, w)
    start_px : (2,)
    radius_px : of the round window; it should hold the mark and nothing else

    Returns
    -------
    Symmetry; None where the window leaves the picture, the search does not settle, or nothing symmetric is there
    """
    from scipy.ndimage import gaussian_filter, spline_filter

    start = np.asarray(start_px, dtype=float)
    radius = max(radius_px, LEAST_RADIUS_PX)
    half = int(np.ceil(2 * radius + SOFT_PX)) + MARGIN_PX
    low = np.rint(start).astype(int) - half
    height, width = luma.shape
    inner = np.ceil(radius + SOFT_PX)
    if (start - inner < 0).any() or (start + inner > [width - 1, height - 1]).any():
        return None
    u, v = (np.clip(np.arange(first, first + 2 * half + 1), 0, size - 1) for first, size in zip(low, (width, height)))
    picture = luma[np.ix_(v, u)].astype(float)
    splines = np.asarray(spline_filter(picture, 3)), np.asarray(spline_filter(gaussian_filter(picture, SMOOTH_PX), 3))
    centre = start - low
    moved = np.inf
    for _ in range(STEPS):
        part = _Window.about(picture, splines, centre, radius)
        normal, right = part.normal(), part.right()
        values = np.linalg.eigvalsh((normal + normal.T) / 2)
        if not values[0] > LEAST_ENERGY * values[1]:
            return None
        step = -0.5 * np.linalg.solve(normal, right)
        moved = float(np.hypot(*step))
        centre = centre + step * min(1.0, 0.5 * radius / max(moved, 1e-12))
        if np.hypot(*(centre + low - start)) > radius:
            return None
        if moved < SETTLED_PX:
            break
    if moved >= SETTLED_PX:
        return None
    return _Window.about(picture, splines, centre, radius).answer(centre + low)


@dataclass(frozen=True)
class _Window:
    """The pixels about a centre (n,): places (2, n), weights, values, what is left against the turned picture; symmetric gradients
    (n, 2) of the picture and of the smoothed one."""

    place: Array
    weight: Array
    value_dn: Array
    left_dn: Array
    slope: Array
    smooth: Array
    turned_noise: float

    @classmethod
    def about(cls, picture: Array, splines: tuple[Array, Array], centre: Array, radius: float) -> _Window:
        rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
        away = np.hypot(columns - centre[0], rows - centre[1])
        chosen = away < radius + SOFT_PX / 2
        here = np.stack([columns[chosen], rows[chosen]]).astype(float)
        there = 2 * centre[:, None] - here
        weight = np.clip((radius + SOFT_PX / 2 - away[chosen]) / SOFT_PX, 0, 1)
        value = picture[chosen]
        slope, smooth = ((_slope(spline, here) - _slope(spline, there)) / 2 for spline in splines)
        return cls(
            here.astype(int), weight, value, value - _at(splines[0], there), slope, smooth, _kernel_energy(there[:, 0])
        )

    def normal(self) -> Array:
        return (self.smooth * self.weight[:, None]).T @ self.slope

    def right(self) -> Array:
        return self.smooth.T @ (self.weight * self.left_dn)

    def answer(self, place_px: Array) -> Symmetry | None:
        total = self.weight.sum()
        pairs = total / 2
        left = float((self.weight * self.left_dn**2).sum() / total) * pairs / max(pairs - 2, 1)
        variance = left / (1 + self.turned_noise)
        inverse = np.linalg.inv(self.normal())
        covariance = inverse @ self._spread(variance) @ inverse.T
        mean = (self.weight * self.value_dn).sum() / total
        scatter = float((self.weight * (self.value_dn - mean) ** 2).sum() / total)
        asymmetry = float(np.sqrt(left / max(2 * scatter, 1e-9)))
        if asymmetry > LARGEST_ASYMMETRY:
            return None
        return Symmetry(place_px, np.sqrt(np.diag(covariance)), float(np.sqrt(variance)), asymmetry)

    def _spread(self, variance: float) -> Array:
        """Covariance (2, 2) of what pulls the centre: of independent pixels of a variance, or more where neighbours go together."""
        pull = self.smooth * self.weight[:, None]
        independent = pull.T @ pull
        row, column = self.place[1] - self.place[1].min(), self.place[0] - self.place[0].min()
        shape = (int(row.max()) + LAG_PX + 1, int(column.max()) + LAG_PX + 1)

        def spectrum(values: Array) -> Array:
            field = np.zeros(shape)
            field[row, column] = values
            return np.fft.rfft2(field)

        def product(one: Array, two: Array) -> Array:
            """By lag: sums of the products of two fields, one moved against the other."""
            return np.fft.irfft2(one * np.conj(two), s=shape)

        seen, left = spectrum(self.weight), spectrum(self.weight * self.left_dn)
        pairs = product(seen, seen)
        lag = [np.minimum(np.arange(n), n - np.arange(n)) for n in shape]
        taper = np.clip(1 - lag[0] / LAG_PX, 0, None)[:, None] * np.clip(1 - lag[1] / LAG_PX, 0, None)[None, :]
        share = taper * product(left, left) / np.maximum(pairs, 1e-9)
        if not share[0, 0] > 0:  # a picture without noise
            return variance * independent
        share /= share[0, 0]
        u, v = (spectrum(column) for column in pull.T)
        together = np.array([[(share * product(a, b)).sum() for b in (u, v)] for a in (u, v)])
        more = np.trace(together) > TOGETHER * np.trace(independent)
        return variance * (together if more else independent)


def _at(spline: Array, places: Array) -> Array:
    """The splined picture at places (2, n), u and v."""
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(spline, places[::-1], order=3, mode="nearest", prefilter=False))


def _slope(spline: Array, places: Array) -> Array:
    """Its gradient, (n, 2) DN/px."""
    steps = SLOPE_STEP_PX * np.eye(2)[:, :, None]
    return np.stack([_at(spline, places + s) - _at(spline, places - s) for s in steps], axis=1) / (2 * SLOPE_STEP_PX)


def _kernel_energy(place: Array) -> float:
    """Variance of the splined picture at ``place`` (2,) where every pixel has variance 1: the interpolation averages noise."""
    from scipy.ndimage import spline_filter1d

    impulse = np.zeros(33)
    impulse[16] = 1.0
    kernel = np.asarray(spline_filter1d(impulse, 3))
    energy = 1.0
    for fraction in place - np.floor(place):
        at = np.arange(2, 30) + fraction
        distance = np.abs(at[:, None] - np.arange(33)[None])
        near, far = 2 / 3 - distance**2 + distance**3 / 2, np.clip(2 - distance, 0, None) ** 3 / 6
        energy *= float(((np.where(distance < 1, near, far) @ kernel) ** 2).sum())
    return energy
