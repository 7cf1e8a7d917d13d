"""Antialiased painting on a float picture. Pictures are ``(h, w, 3)`` float32, blue green red, in DN (0..255)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]
_SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates: sixteenths of a pixel."""
_FAR_PX = 4000.0
"""Corners are held this near to the picture: OpenCV's fixed-point coordinates would overflow."""


def box_of(pixel_px: NDArray[np.float64], shape: tuple[int, ...], margin_px: int = 2) -> tuple[slice, slice] | None:
    """Rows and columns that hold the points ``(n, 2)``, clipped to the picture; None outside it.

    Parameters
    ----------
    pixel_px : (n, 2)
    shape : of the picture
    margin_px : room about the points
    """
    if not np.isfinite(pixel_px).all():
        return None
    low = np.floor(pixel_px.min(axis=0)).astype(int) - margin_px
    high = np.ceil(pixel_px.max(axis=0)).astype(int) + margin_px + 1
    left, top = max(low[0], 0), max(low[1], 0)
    right, bottom = min(high[0], shape[1]), min(high[1], shape[0])
    if left >= right or top >= bottom:
        return None
    return slice(top, bottom), slice(left, right)


def polygon_mask(pixel_px: NDArray[np.float64], box: tuple[slice, slice]) -> NDArray[np.float32]:
    """Coverage 0..1 of a filled polygon ``(n, 2)`` px within ``box``.

    Parameters
    ----------
    pixel_px : (n, 2)
    box : rows and columns of the picture
    """
    import cv2

    rows, columns = box
    mask = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.uint8)
    here = np.clip(pixel_px - [columns.start, rows.start], -_FAR_PX, _FAR_PX)
    cv2.fillPoly(mask, [np.round(here * 2**_SHIFT).astype(np.int32)], 255, cv2.LINE_AA, _SHIFT)
    return mask.astype(np.float32) * np.float32(1 / 255)


def paint(picture: Picture, box: tuple[slice, slice], mask: NDArray[np.float32], colour) -> None:
    """Blend ``colour`` ((3,) or a picture of the box) over ``picture`` by ``mask``.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    box : rows and columns of the picture
    mask : share of the colour, of the box
    colour : BGR, DN
    """
    part = picture[box]
    part += (np.asarray(colour, dtype=np.float32) - part) * mask[..., None]


def paint_polygon(picture: Picture, pixel_px: NDArray[np.float64], colour, alpha: float = 1.0) -> None:
    """Fill a polygon ``(n, 2)`` px.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    pixel_px : (n, 2)
    colour : BGR, DN
    alpha : share of the colour, 0 .. 1
    """
    box = box_of(pixel_px, picture.shape)
    if box is not None:
        paint(picture, box, polygon_mask(pixel_px, box) * np.float32(alpha), colour)


def paint_bar(picture: Picture, ends_px: NDArray[np.float64], width_px, colour, alpha: float = 1.0) -> None:
    """A straight bar between two points ``(2, 2)`` px; ``width_px`` at each end; below 1 px it fades.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    ends_px : (2, 2)
    width_px : of the bar
    colour : BGR, DN
    alpha : share of the colour, 0 .. 1
    """
    quad, strength = bar_outline(ends_px, width_px)
    paint_polygon(picture, quad, colour, alpha * strength)


def bar_outline(ends_px: NDArray[np.float64], width_px) -> tuple[NDArray[np.float64], float]:
    """The bar's four corners ``(4, 2)`` px and the alpha that stands for a width below 1 px.

    Parameters
    ----------
    ends_px : (2, 2)
    width_px : of the bar
    """
    ends_px = np.asarray(ends_px, dtype=float)
    along = ends_px[1] - ends_px[0]
    length = np.hypot(*along)
    normal = np.array([-along[1], along[0]]) / max(length, 1e-9)
    width = np.broadcast_to(np.asarray(width_px, dtype=float), 2)
    strength = float(min(1.0, width.mean()))
    half = np.maximum(width, 1.0)[:, None] / 2 * normal
    return np.concatenate([ends_px - half, (ends_px + half)[::-1]]), strength


def paint_disc(
    picture: Picture, centre_px: NDArray[np.float64], radius_px: float, colour, edge_px: float = 1.0
) -> None:
    """A round mark, exact at sub-pixel places, its edge ``edge_px`` wide.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    centre_px : (2,)
    radius_px : of the disc
    colour : BGR, DN
    edge_px : over which it fades
    """
    reach = radius_px + edge_px
    centre = np.asarray(centre_px, dtype=float)
    box = box_of(np.stack([centre - reach, centre + reach]), picture.shape)
    if box is not None:
        paint(picture, box, disc_mask(centre, radius_px, edge_px, box), colour)


def disc_mask(centre_px, radius_px: float, edge_px: float, box: tuple[slice, slice]) -> NDArray[np.float32]:
    """Coverage 0..1 of a disc within ``box``.

    Parameters
    ----------
    centre_px : (2,)
    radius_px : of the disc
    edge_px : over which it fades
    box : rows and columns of the picture
    """
    rows, columns = box
    v = np.arange(rows.start, rows.stop)[:, None] - centre_px[1]
    u = np.arange(columns.start, columns.stop)[None, :] - centre_px[0]
    return np.clip((radius_px - np.hypot(u, v)) / edge_px + 0.5, 0.0, 1.0).astype(np.float32)
