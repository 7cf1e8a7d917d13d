"""Everything in a frame that could be a mark: threshold and contours over the whole frame, shape by region properties."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.robust import MAD_TO_SD

Array = NDArray[Any]

MOST = 60
"""The strongest candidates that identity is tried on."""
THRESHOLD_MAD = 6.0
"""A spot stands out of the ground by this many robust standard deviations: a choice."""
MIN_CONTRAST_DN = 8.0
"""And by so many levels at least, in a picture without noise too: a choice."""
GROUND_WIDTHS = 9.0
"""Side of the median's window in widths of the spot: a Gaussian spot fills a quarter of it, so the median passes it by."""
SAME_SIZE = 1.6
"""Two spots at one place whose widths differ by less than this factor are one: a choice."""
LARGEST_SHARE = 0.02
"""A spot is smaller than this share of the picture's shorter side squared."""


@dataclass(frozen=True)
class Candidates:
    """Possible marks.

    Attributes
    ----------
    centre_px : (n, 2), intensity-weighted centroid
    contrast_dn : (n,), largest difference of 3 x 3 pixels from the local ground, always positive
    width_px : (n,), radius of the area's equal disc over 1.5 (near a Gaussian's standard deviation)
    stretch : (n,), ratio of the axes
    dark : (n,), darker than its surroundings
    tint : (n, 3), unit vector of (blue, green, red) above the local ground; NaN where colour was not looked at
    """

    centre_px: Array
    contrast_dn: Array
    width_px: Array
    stretch: Array
    dark: NDArray[np.bool_]
    tint: Array

    def __len__(self) -> int:
        return len(self.centre_px)

    def brightest(self, dark: bool) -> float:
        """Largest contrast of the bright ones, or of the dark; 1 where there is none."""
        return float(self.contrast_dn[self.dark == dark].max(initial=1.0))

    def rows(self, index) -> Candidates:
        """Some of them."""
        return Candidates(*(getattr(self, f.name)[index] for f in fields(self)))

    def narrower(self, width_px: float) -> Candidates:
        """Those below a width."""
        return self.rows(self.width_px < width_px)

    def apart_from(self, other: Candidates) -> Candidates:
        """Those that are none of the other's: elsewhere, or of another size."""
        if not len(other) or not len(self):
            return self
        away = np.linalg.norm(self.centre_px[:, None] - other.centre_px[None], axis=2)
        ratio = np.abs(np.log(self.width_px[:, None] / other.width_px[None]))
        same = (away < np.maximum(1.0, 0.5 * self.width_px)[:, None]) & (ratio < np.log(SAME_SIZE))
        return self.rows(~same.any(axis=1))

    def and_also(self, other: Candidates) -> Candidates:
        """These and the others."""
        return Candidates(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


def find_candidates(luma: NDArray[np.uint8], dark: bool = False, expected_width_px: float = 2.0) -> Candidates:
    """Find bright (or ``dark``) spots.

    The ground is the median of the surroundings (edges of larger things stay in it and do not stand out); what stands
    out of it by more than ``THRESHOLD_MAD`` robust standard deviations is
    outlined, and each outline is measured again at half of its own height, so that a bright spot's halo and a dim
    spot's noise are treated alike.

    Parameters
    ----------
    luma : (h, w) uint8
    dark : dark spots on light ground
    expected_width_px : usual width of a mark, standard deviation
    """
    import cv2
    from skimage.measure import regionprops

    picture = luma.astype(np.float32)
    small = cv2.GaussianBlur(picture, (0, 0), max(0.6, 0.5 * expected_width_px))
    reach = min(2 * round(GROUND_WIDTHS * expected_width_px / 2) + 1, 255)
    ground = cv2.medianBlur(np.ascontiguousarray(luma), reach).astype(np.float32)
    difference = ground - small if dark else small - ground
    near = cv2.blur(picture, (3, 3))
    sharp = ground - near if dark else near - ground
    sample = difference[::2, ::2]
    middle = float(np.median(sample))
    spread = MAD_TO_SD * float(np.median(np.abs(sample - middle)))
    threshold = middle + max(THRESHOLD_MAD * spread, MIN_CONTRAST_DN)
    mask = (difference > threshold).astype(np.uint8)
    contours, nesting = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outlines = [c for c, place in zip(contours, nesting[0], strict=True) if place[3] < 0] if len(contours) else []
    limit = LARGEST_SHARE * min(luma.shape) ** 2
    boxes = []
    for contour in outlines:
        u, v, w, h = cv2.boundingRect(contour)
        if w * h > limit:
            continue
        boxes.append((float(difference[v : v + h, u : u + w].max()), u, v, w, h))
    boxes.sort(reverse=True)
    centres, contrasts, widths, stretches = [], [], [], []
    for contrast, u, v, w, h in boxes[:MOST]:
        part = difference[v : v + h, u : u + w]
        labels = _islands(part > 0.5 * contrast)
        for region in regionprops(labels):
            rows, columns = region.coords[:, 0] + v, region.coords[:, 1] + u
            # not region.centroid_weighted and its axes: they take all moments to the third order, a third of a frame's time
            weight = difference[rows, columns]
            centres.append((columns @ weight / weight.sum(), rows @ weight / weight.sum()))
            contrasts.append(max(1.0, float(sharp[rows, columns].max())))
            widths.append(max(0.7, float(np.sqrt(region.area / np.pi)) / 1.18))
            stretches.append(stretch_of(rows, columns))
    order = np.argsort(contrasts)[::-1][:MOST]
    return Candidates(
        np.array(centres, dtype=float).reshape(-1, 2)[order],
        np.array(contrasts, dtype=float)[order],
        np.array(widths, dtype=float)[order],
        np.array(stretches, dtype=float)[order],
        np.full(len(order), dark),
        np.full((len(order), 3), np.nan),
    )


def with_tint(candidates: Candidates, bgr: NDArray[np.uint8]) -> Candidates:
    """Look at the candidates' colour in ``bgr (h, w, 3)``: where it is strongest, since a bright light's core is white.

    Parameters
    ----------
    candidates : spots of the frame
    bgr : (h, w, 3) uint8
    """
    tint = np.full((len(candidates), 3), np.nan)
    for index, (place, width) in enumerate(zip(candidates.centre_px, candidates.width_px, strict=True)):
        reach = round(2.5 * width) + 1
        u, v = (int(x) for x in np.rint(place))
        part = bgr[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1].astype(float)
        rim = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
        above = np.maximum(part - np.median(rim, axis=0), 0.0)
        total = above.sum(axis=2)
        if not total.size or total.max() < MIN_CONTRAST_DN:
            continue
        lit = above[total > 0.3 * total.max()]
        chroma = lit.max(axis=1) - lit.min(axis=1)
        strongest = np.sort(chroma)[int(np.ceil(0.6 * (len(chroma) - 1)))]
        strong = lit[chroma >= strongest].sum(axis=0)
        tint[index] = strong / np.linalg.norm(strong)
    return replace(candidates, tint=tint)


def middle(values: Array) -> Array:
    """Medians along the last axis; of a few dozen values a sort costs less than ``np.median``.

    Parameters
    ----------
    values : (..., n), without NaN
    """
    inorder = np.sort(values, axis=-1)
    count = inorder.shape[-1]
    return 0.5 * (inorder[..., (count - 1) // 2] + inorder[..., count // 2])


def stretch_of(rows: Array, columns: Array) -> float:
    """Ratio of the axes of the ellipse with a region's second moments, 4 sqrt(eigenvalue) each; the minor at least 1 px."""
    v, u = rows - rows.mean(), columns - columns.mean()
    uu, vv, uv = u @ u / len(u), v @ v / len(v), u @ v / len(u)
    middle, apart = 0.5 * (uu + vv), np.hypot(0.5 * (uu - vv), uv)
    return float(4 * np.sqrt(middle + apart) / max(4 * np.sqrt(max(middle - apart, 0.0)), 1.0))


def _islands(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    from skimage.measure import label

    return np.asarray(label(mask, connectivity=2), dtype=np.int64)
