"""How a square tag is seen: the homography that carries it into the picture, the lens, its pixels, its blurred pattern.

Tag units: the black square is [-1, 1]^2, its middle the origin. Pixels: u right, v down, integers at pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Lens

Array = NDArray[Any]

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""The tag's corners, clockwise from the one at the code's first bit."""
PAD_CELLS = 2
"""White cells around the pattern, so that its blur and the rim's pixels stay inside the template."""
SAMPLES_PER_PX, LEAST_SAMPLES, MOST_SAMPLES = 2.0, 4, 24
"""Of the template; the limits are per cell."""
MOST_PIXELS = 6000
"""Of a tag, in one fit: of larger ones every second or third pixel is taken. A choice, for its cost."""


@dataclass(frozen=True)
class Template:
    """A blurred pattern on a fine grid.

    Attributes
    ----------
    layers : (s, s, 4), value (black cell 0, white cell 1), its slopes along both tag axes per tag unit, its slope by spread_px2
    outside : (s, s), 1 around the tag, 0 in it
    blur : (2, 2), covariance, samples^2
    per_unit, origin : sample = (tag coordinate + 1) * per_unit + origin
    spread_px2 : variance of blur and pixel together
    around : value around the tag
    """

    layers: Array
    outside: Array
    blur: Array
    per_unit: float
    origin: float
    spread_px2: float
    around: float


@dataclass(frozen=True)
class Pixels:
    """The pixels that take part (n,): places from the tag's middle in units of ``scale_px``, values, tag coordinates and slopes."""

    x: Array
    y: Array
    value_dn: Array
    tag: tuple[Array, Array]
    slopes: tuple[tuple[Array, Array], tuple[Array, Array]]
    centre_px: Array
    scale_px: float


def samples_per_unit(cells: int, cell_px: float) -> float:
    """How fine the template of a tag of so many cells a side is, when a cell spans ``cell_px`` in the picture.

    Parameters
    ----------
    cells : a side, or (m, m), 1 white
    cell_px : side of a cell in the picture
    """
    return float(np.clip(np.ceil(SAMPLES_PER_PX * cell_px), LEAST_SAMPLES, MOST_SAMPLES)) * cells / 2


def blur_samples(to_px: Array, spread_px2: float, per_unit: float) -> Array:
    """A round blur in the picture, seen on the tag: covariance in samples^2 (2, 2).

    Parameters
    ----------
    to_px : (3, 3) homography, tag -> picture
    spread_px2 : variance of blur and pixel together, px^2
    per_unit : samples of the template to a unit of the tag
    """
    shape = np.linalg.inv(local_shape(to_px)) * per_unit
    # a sample is the mean of its square already
    return spread_px2 * shape @ shape.T - np.eye(2) / 12


def rendered(cells: Array, blur: Array, per_unit: float, spread_px2: float, around: float) -> Template:
    """Blur a tag's cells (m, m); see ``Template``. The blur is exact for the tag's middle; over a tag it hardly changes.

    Parameters
    ----------
    cells : a side, or (m, m), 1 white
    blur : (2, 2), samples^2
    per_unit : samples of the template to a unit of the tag
    spread_px2 : variance of blur and pixel together, px^2
    around : brightness around the tag, black 0, white 1
    """
    from scipy import fft

    samples = round(2 * per_unit / len(cells))
    outside = np.pad(np.zeros_like(cells), PAD_CELLS, constant_values=1.0)
    sharp = np.stack([np.pad(cells, PAD_CELLS) + around * outside, outside])
    side = samples * sharp.shape[1]
    pattern, ground = np.asarray(fft.rfft2(np.kron(sharp, np.ones((samples, samples), np.float32))))
    k_y, k_x = 2 * np.pi * np.fft.fftfreq(side)[:, None], 2 * np.pi * np.fft.rfftfreq(side)[None, :]
    power = blur[0, 0] * k_x**2 + 2 * blur[0, 1] * k_x * k_y + blur[1, 1] * k_y**2
    low_pass = np.exp(-0.5 * power)
    wider = -0.5 * (power + (k_x**2 + k_y**2) / 12) / spread_px2
    factors = (1.0, 1j * k_x * per_unit, 1j * k_y * per_unit, wider)
    spectra = np.stack([pattern * low_pass * factor for factor in factors] + [ground * low_pass])
    value = np.asarray(fft.irfft2(spectra.astype(np.complex64), s=(side, side)))
    layers, flat = np.ascontiguousarray(np.moveaxis(value[:4], 0, -1)), np.ascontiguousarray(value[4])
    return Template(layers, flat, blur, per_unit, PAD_CELLS * samples - 0.5, spread_px2, around)


def project(to_px: Array, points: Array) -> Array:
    """Points (n, 2) through a homography (3, 3).

    Parameters
    ----------
    to_px : (3, 3) homography, tag -> picture
    points : (n, 2)
    """
    image = points @ to_px[:, :2].T + to_px[:, 2]
    return image[:, :2] / image[:, 2:]


def middle_px(to_px: Array) -> Array:
    """Image of the tag's middle (2,)."""
    return to_px[:2, 2] / to_px[2, 2]


def homography(corners_px: Array) -> Array:
    """The tag's square -> four corners (4, 2) in the order of ``SQUARE``: (3, 3)."""
    rows, right = [], []
    for (x, y), (u, v) in zip(SQUARE, np.asarray(corners_px, dtype=float), strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right += [u, v]
    return np.append(np.linalg.solve(np.array(rows), np.array(right)), 1.0).reshape(3, 3)


def local_shape(to_px: Array) -> Array:
    """Pixels per tag unit at the tag's middle (2, 2)."""
    return (to_px[:2, :2] - np.outer(middle_px(to_px), to_px[2, :2])) / to_px[2, 2]


def narrow_px(to_px: Array) -> float:
    """The tag's side across its narrow direction, px."""
    return 2.0 * float(np.linalg.svd(local_shape(to_px), compute_uv=False)[1])


def half_side_px(to_px: Array) -> float:
    """Half of the side of a square of the tag's area, px."""
    return float(np.sqrt(abs(np.linalg.det(local_shape(to_px)))))


def inside(corners_px: Array, shape: tuple[int, ...]) -> bool:
    """All corners (4, 2) lie in a picture of ``shape`` (h, w), a pixel from its rim.

    Parameters
    ----------
    corners_px : (4, 2)
    shape : height and width of the picture
    """
    return bool((corners_px >= 1).all() and (corners_px <= np.array([shape[1], shape[0]]) - 2).all())


def lens_curve(lens: Lens | None, to_px: Array) -> Array:
    """How the lens bends lines about the tag's middle (2, 3): straight = x + curve @ (x^2, x y, y^2), in units of half its side.

    To second order and with the slope taken off: pixels made straight so are the picture's own at the centre.

    Parameters
    ----------
    lens : of the camera, or None
    to_px : (3, 3) homography, tag -> picture
    """
    if lens is None:
        return np.zeros((2, 3))
    around = half_side_px(to_px) * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1.0]])
    seen = lens.normalise(middle_px(to_px) + around)[0]
    slope = np.stack([seen[1] - seen[2], seen[3] - seen[4]], axis=1) / 2
    straight = np.linalg.solve(slope, (seen - seen[0]).T)
    xx, yy, both = (straight[:, i] + straight[:, i + 1] for i in (1, 3, 5))
    return np.stack([xx, both - xx - yy, yy], axis=1) / 2


def bend(curve: Array, x: Array, y: Array) -> Array:
    """What ``curve`` adds to places (n,), (n,): (2, n).

    Parameters
    ----------
    curve : (2, 3), from ``lens_curve``
    x : (n,) in half sides of the tag
    y : (n,) in half sides of the tag
    """
    return curve.astype(x.dtype) @ np.stack([x * x, x * y, y * y])


def chosen_pixels(luma: NDArray[np.uint8], to_px: Array, rim: float) -> tuple[Array, Array, Array]:
    """Columns, rows and values (n,) of the tag's pixels and of a rim, in tag units, around it; a lattice where there are many.

    Parameters
    ----------
    luma : (h, w) uint8
    to_px : (3, 3) homography, tag -> picture
    rim : how far outside the tag pixels are taken, tag units
    """
    outer = project(to_px, SQUARE * (1 + rim))
    low = np.maximum(np.floor(outer.min(axis=0)).astype(int), 0)
    high = np.ceil(outer.max(axis=0)).astype(int) + 1
    stride = max(1, int(np.ceil(2 * half_side_px(to_px) / np.sqrt(MOST_PIXELS))))
    part = luma[low[1] : high[1] : stride, low[0] : high[0] : stride]
    x = low[0] + stride * np.arange(part.shape[1])[None, :]
    y = low[1] + stride * np.arange(part.shape[0])[:, None]
    within = np.ones(part.shape, dtype=bool)
    for (x_0, y_0), (x_1, y_1) in zip(outer, np.roll(outer, -1, axis=0), strict=True):
        within &= (x_1 - x_0) * (y - y_0) > (y_1 - y_0) * (x - x_0)
    row, column = np.nonzero(within)
    return x[0, column], y[row, 0], part[row, column].astype(np.float32)


def seen_pixels(chosen: tuple[Array, Array, Array], to_px: Array, curve: Array) -> Pixels:
    """The chosen pixels seen from the tag.

    Parameters
    ----------
    chosen : from ``chosen_pixels``
    to_px : (3, 3) homography, tag -> picture
    curve : (2, 3), from ``lens_curve``
    """
    centre, scale = middle_px(to_px), half_side_px(to_px)
    # single precision is enough once the origin is the tag's middle: 1e-7 of the tag's side
    x, y = (((t - c) / scale).astype(np.float32) for t, c in zip(chosen[:2], centre, strict=True))
    if curve.any():
        x, y = np.stack([x, y]) + bend(curve, x, y)
    g = np.linalg.inv(to_px) @ np.array([[scale, 0, centre[0]], [0, scale, centre[1]], [0, 0, 1.0]])
    g = (g / g[2, 2]).astype(np.float32)
    depth = 1 / (g[2, 0] * x + g[2, 1] * y + 1)
    p, q = ((g[i, 0] * x + g[i, 1] * y + g[i, 2]) * depth for i in (0, 1))
    depth /= scale
    p_slopes, q_slopes = (
        (depth * (g[i, 0] - t * g[2, 0]), depth * (g[i, 1] - t * g[2, 1])) for i, t in enumerate((p, q))
    )
    return Pixels(x, y, chosen[2], (p, q), (p_slopes, q_slopes), centre, scale)
