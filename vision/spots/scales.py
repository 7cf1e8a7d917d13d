"""Everything in a frame that could be a mark of whatever size, on whatever ground: what stands out of a ring about it.

``candidates`` knows the ground by the picture's median, which a mark on a small plate is not part of; here the ground is what lies
next to the spot. It costs more, and is asked where the other has not found the marks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.robust import MAD_TO_SD
from .candidates import Candidates, middle, stretch_of
from .ring import RING_WIDTHS, rise_of, smoothing_px, stands_out

Array = NDArray[Any]

WIDTHS_PX = tuple(0.7 * 2 ** (k / 2) for k in range(10))
"""Of the scales looked at, standard deviations, a factor sqrt(2) apart: discs of 1.6 to 37 px."""
COARSE_PX = 2.0
"""A scale of this width or more is looked for in a picture of half the size, and so on."""
LEAST_RISE_DN = 3.0
"""Nothing fainter is taken: a choice, a third of what ``candidates`` asks, since here it is above the ring and not the picture."""
LEAST_RISE_SD = 4.0
"""Nor what stands out by less than this many standard deviations of the picture's own noise at that scale."""
LEAST_NOISE_DN = 0.2
"""Noise of a picture that has none, or that a codec has wiped out: rounding alone leaves 0.29 before the smoothing."""
NEAR_RISE_SD = 3.5
"""The same about a place where a mark is known to be: there is little else there that noise could make."""
NOISE_TILE_PX, QUIET_SHARE = 32, 0.25
"""The picture's noise is that of the quietest quarter of its parts of this size: print, gravel or a net is none, and hides no mark
on a quiet plate. Choices."""
ON_A_SPOT_SD = 5.0
"""A narrow spot on a wide one is the wide one's noise, and no mark on a plate, where it rises by less than this many standard
deviations of the noise while the wide one rises by twice as many: chance raises none of a wide mark's thousand places so high."""
SMALL_TILE_PX, QUIETER = 8, 2
"""About a spot it may be less: a quiet plate of three parts of this size a side before gravel that fills the picture has four of
the nine about its mark to itself. The third smallest of the nine, which chance makes 7 % too small, not 17 % as the smallest."""
PER_SCALE, IN_ALL = 80, 150
"""The most significant candidates kept of a scale, and of all."""
SAME_WIDTHS, SAME_PX = 0.5, 0.7
"""Peaks of two scales nearer to each other than this many widths of the larger, and a pixel's share, are one spot."""
NESTED = 2.1
"""Unless one is wider than the other by more than this: a mark on a small plate that itself stands out."""
SAME_OUTLINE = 1.6
"""Outlines of one centre whose widths differ by less than this factor are one."""
GROWTHS, GROWTH = 3, 1.5
"""A spot whose outline reaches its ring is measured again with a wider one, by this factor, so many times in all."""
RISE_SHARE = 0.3
"""A spot stands out of the highest part of its ring by this share of its contrast with the ring's middle, or is a bump on the rim
of something larger. A Gaussian keeps 0.65 of its own after the smoothing, less in noise and beside a rim: a choice."""
HALF = 0.5
"""A spot's outline: where it has fallen to this share of its rise."""


def find_spots(
    luma: NDArray[np.uint8],
    dark: bool = False,
    near_px: Array | None = None,
    near_reach_px: float = 0.0,
    most: int = IN_ALL,
) -> Candidates:
    """Find bright (or ``dark``) spots of all sizes by what lies around each.

    Parameters
    ----------
    luma : (h, w) uint8
    dark : dark spots on light ground
    near_px : (m, 2), places about which weak spots are kept too
    near_reach_px : how far about them
    most : so many of the most significant are kept
    """
    picture = -luma.astype(np.float32) if dark else luma.astype(np.float32)
    peaks = _peaks(picture, near_px, near_reach_px, most)
    rows = [row for place, width, rise in peaks if (row := _measured(picture, place, width, rise)) is not None]
    if not rows:
        nothing = np.zeros(0)
        return Candidates(np.zeros((0, 2)), nothing, nothing, nothing, np.zeros(0, dtype=bool), np.zeros((0, 3)))
    centre, contrast, width, stretch = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    alone = _distinct(centre, width)
    count = len(alone)
    return Candidates(
        centre[alone], contrast[alone], width[alone], stretch[alone], np.full(count, dark), np.full((count, 3), np.nan)
    )


def free_of_rims(luma: NDArray[np.uint8], spots: Candidates) -> Candidates:
    """Those of a picture's spots that stand out of all of the ring about them, and not of most of it as a rim does.

    Parameters
    ----------
    luma : (h, w) uint8
    spots : found in it in another way
    """
    kept = [_rise_at(luma, *spot) for spot in zip(spots.centre_px, spots.width_px, spots.dark, strict=True)]
    return spots.rows(np.array(kept, dtype=float) >= RISE_SHARE * spots.contrast_dn)


def _rise_at(luma: NDArray[np.uint8], place: Array, width: float, dark: bool) -> float:
    """Largest rise over the ring at the pixels about a place; endless where the picture ends before the ring does."""
    reach = round(max(2.0, RING_WIDTHS * width)) + 2
    u, v = (round(float(c)) for c in place)
    part = luma[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1].astype(np.float32)
    if part.shape != (2 * reach + 1, 2 * reach + 1):
        return float("inf")
    return float(stands_out(-part if dark else part, width)[0].max())


def _peaks(picture: Array, near_px: Array | None, near_reach_px: float, most: int) -> list[tuple[Array, float, float]]:
    """(u, v), width and rise of what stands out, the most significant first."""
    import cv2
    from scipy.spatial import KDTree

    about = KDTree(near_px) if near_px is not None and len(near_px) else None
    noise = noise_of(picture)
    quiet = np.minimum(_noise_about(picture), noise)
    places, widths, rises, marks, clears = [], [], [], [], []
    part, factor = picture, 1
    for width in WIDTHS_PX:
        while width / factor >= COARSE_PX:
            part, factor = (
                cv2.resize(part, (part.shape[1] // 2, part.shape[0] // 2), interpolation=cv2.INTER_AREA),
                2 * factor,
            )
        here = width / factor
        blur = smoothing_px(here)
        smooth = cv2.GaussianBlur(part, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
        rim = int(np.ceil(RING_WIDTHS * here)) + 1
        smooth = cv2.copyMakeBorder(smooth, rim, rim, rim, rim, cv2.BORDER_REPLICATE)
        rise, edge = rise_of(smooth, here)
        cut = rim - edge
        rise = np.ascontiguousarray(rise[cut : rise.shape[0] - cut, cut : rise.shape[1] - cut])
        v, u = np.nonzero((rise >= cv2.dilate(rise, np.ones((3, 3), np.uint8))) & (rise > LEAST_RISE_DN))
        found = np.column_stack([u, v]) * float(factor) + 0.5 * (factor - 1)
        tile = np.minimum(found.astype(int) // SMALL_TILE_PX, np.array(quiet.shape[::-1]) - 1)
        own_noise = quiet[tile[:, 1], tile[:, 0]] / factor / max(1.0, 2 * np.sqrt(np.pi) * blur)
        least = np.maximum(LEAST_RISE_DN, LEAST_RISE_SD * own_noise)
        near = about.query(found)[0] < near_reach_px if about is not None else np.zeros(len(found), dtype=bool)
        least = np.where(near, np.maximum(LEAST_RISE_DN, NEAR_RISE_SD * own_noise), least)
        clear = rise[v, u] > least
        if not clear.any():
            continue
        u, v, found, own_noise, near = u[clear], v[clear], found[clear], own_noise[clear], near[clear]
        worth = rise[v, u] / np.hypot(_scatter(smooth, u + rim, v + rim, here), own_noise + 0.5)
        order = np.argsort(-worth)
        kept = order[:PER_SCALE]
        if near.any():
            kept = np.union1d(kept, np.flatnonzero(near))
            worth = np.where(near, worth + 1e3, worth)
        places.append(found[kept])
        widths.append(np.full(len(kept), width))
        rises.append(rise[v[kept], u[kept]])
        marks.append(worth[kept])
        clears.append(rise[v[kept], u[kept]] / np.maximum(own_noise[kept], LEAST_NOISE_DN))
    if not places:
        return []
    place, width, height, worth, clear = (np.concatenate(part) for part in (places, widths, rises, marks, clears))
    chosen: list[int] = []
    for index in np.argsort(-worth):
        apart = np.hypot(*(place[chosen] - place[index]).T) if chosen else np.zeros(0)
        ratio = np.maximum(width[chosen], width[index]) / np.minimum(width[chosen], width[index])
        if ((apart > SAME_PX + SAME_WIDTHS * np.maximum(width[chosen], width[index])) | (ratio > NESTED)).all():
            chosen.append(int(index))
            if len(chosen) >= most:
                break
    chosen = [i for i in chosen if not _noise_on(i, chosen, place, width, clear)]
    return [(place[i], float(width[i]), float(height[i])) for i in chosen]


def _noise_on(index: int, chosen: list[int], place: Array, width: Array, clear: Array) -> bool:
    """Whether a peak is no more than the noise of a wider one on which it lies."""
    if clear[index] >= ON_A_SPOT_SD:
        return False
    on = (width[chosen] > NESTED * width[index]) & (np.hypot(*(place[chosen] - place[index]).T) < width[chosen])
    return bool((on & (clear[chosen] > 2 * ON_A_SPOT_SD)).any())


def noise_of(picture: Array) -> float:
    """Standard deviation of a picture's pixel noise: of second differences along its rows, in the quieter of its parts.

    Parameters
    ----------
    picture : (h, w) grey values
    """
    return float(np.quantile(_noise_in_tiles(picture[::2], NOISE_TILE_PX), QUIET_SHARE))


def _noise_in_tiles(part: Array, side_px: int) -> Array:
    """(rows, columns) noise in each part of a picture, of ``side_px`` or a little more a side."""
    second = np.abs(part[:, 2:] - 2 * part[:, 1:-1] + part[:, :-2])
    down, across = (max(n // side_px, 1) for n in second.shape)
    high, wide = second.shape[0] // down, second.shape[1] // across
    tiles = second[: down * high, : across * wide].reshape(down, high, across, wide).transpose(0, 2, 1, 3)
    return MAD_TO_SD * np.median(tiles.reshape(down, across, -1), axis=2) / np.sqrt(6)


def _noise_about(picture: Array) -> Array:
    """(rows, columns) noise in the quieter parts next to each of a picture's small parts and in it."""
    tiles = np.pad(_noise_in_tiles(picture, SMALL_TILE_PX), 1, mode="edge")
    about = np.lib.stride_tricks.sliding_window_view(tiles, (3, 3)).reshape(tiles.shape[0] - 2, tiles.shape[1] - 2, 9)
    return np.partition(about, QUIETER, axis=2)[..., QUIETER]


def _scatter(smooth: Array, u: NDArray[Any], v: NDArray[Any], width: float) -> Array:
    """Standard deviation of the levels on the ring about some places of a smoothed picture."""
    angles = np.arange(16) * np.pi / 8
    reach = max(2.0, RING_WIDTHS * width)
    a = np.clip(np.rint(u[:, None] + reach * np.cos(angles)).astype(int), 0, smooth.shape[1] - 1)
    b = np.clip(np.rint(v[:, None] + reach * np.sin(angles)).astype(int), 0, smooth.shape[0] - 1)
    return smooth[b, a].std(axis=1)


def _measured(
    picture: Array, place: Array, width: float, rise: float
) -> tuple[tuple[float, float], float, float, float] | None:
    """Centroid, contrast, width and stretch of the spot at a place; None where it has no outline of its own, or is a rim."""
    found = None
    for _ in range(GROWTHS):
        now = _outlined(picture, place, width)
        if now is None:
            break
        found = now
        if found[-1]:
            break
        width *= GROWTH
    if found is None:
        return None
    rows, columns, weight, contrast, _ = found
    if rise < RISE_SHARE * contrast:
        return None
    total = weight.sum()
    spread = max(0.6, float(np.sqrt(len(rows) / np.pi)) / 1.18)
    return (columns @ weight / total, rows @ weight / total), contrast, spread, stretch_of(rows, columns)


def _outlined(picture: Array, place: Array, width: float) -> tuple[Array, Array, Array, float, bool] | None:
    """Rows, columns, levels within the outline; contrast with a ring for a spot of ``width``; whether it ends within that ring."""
    import cv2

    reach = int(np.ceil(RING_WIDTHS * width)) + 2
    u0, v0 = max(int(place[0]) - reach, 0), max(int(place[1]) - reach, 0)
    part = picture[v0 : int(place[1]) + reach + 1, u0 : int(place[0]) + reach + 1]
    du, dv = np.arange(part.shape[1]) + (u0 - place[0]), np.arange(part.shape[0]) + (v0 - place[1])
    away = np.sqrt(du * du + (dv * dv)[:, None])
    ring = part[(away > 1.7 * width + 0.5) & (away < RING_WIDTHS * width + 1.5)]
    if len(ring) < 8:
        return None
    ground = float(middle(ring))
    near = cv2.blur(part, (3, 3)) if width > 1.2 else part
    core = away <= max(1.0, 0.8 * width)
    contrast = float(near[core].max()) - ground
    if contrast < LEAST_RISE_DN:
        return None
    level = cv2.GaussianBlur(part, (0, 0), max(0.5, 0.3 * width), borderType=cv2.BORDER_REPLICATE) - np.float32(ground)
    highest = np.where(core, level, -np.inf).argmax()
    count, labels = cv2.connectedComponents((level > HALF * level.flat[highest]).astype(np.uint8))
    label = labels.flat[highest]
    if count < 2 or not label:
        return None
    rows, columns = np.nonzero(labels == label)
    complete = bool(away[rows, columns].max() < 1.9 * width + 1.0)
    weight = np.maximum(level[rows, columns], 1e-3).astype(float)
    return rows + v0, columns + u0, weight, contrast, complete


def _distinct(centre: Array, width: Array) -> list[int]:
    """Of spots whose outlines are one and the same, the first."""
    kept: list[int] = []
    for index in range(len(centre)):
        apart = np.hypot(*(centre[kept] - centre[index]).T) if kept else np.zeros(0)
        ratio = np.maximum(width[kept], width[index]) / np.minimum(width[kept], width[index])
        if ((apart > np.maximum(1.0, 0.5 * np.minimum(width[kept], width[index]))) | (ratio > SAME_OUTLINE)).all():
            kept.append(index)
    return kept
