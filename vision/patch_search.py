"""Where a patch could be, to about a pixel: normalised cross-correlation near a place, or over the whole frame.

Pixels are weighed as in the registration (round rim, trust), so that background behind a hull's edge does not vote.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .patch import Array, Patch, axes_of, inverse
from .patch_pixels import LARGEST_GROWTH, Pose

LOBE_SHARE = 0.5
"""Peaks nearer to each other than this share of the radius (at least LEAST_LOBE_PX) are one."""
LEAST_LOBE_PX = 3.0
"""The least that counts as one peak of the correlation, for the smallest patches: a choice."""
_EDGE = 1e-6
"""Keeps a division by an empty weight or a flat picture finite."""


@dataclass(frozen=True)
class Peak:
    """A place that looks like the patch.

    Attributes
    ----------
    centre_px : (2,)
    correlation : -1 .. 1
    """

    centre_px: Array
    correlation: float


def peaks_near(
    luma: NDArray[np.uint8], patch: Patch, nodes: Array, pose: Pose, reach_px: int, count: int = 3
) -> list[Peak]:
    """The ``count`` best peaks within ``reach_px`` of ``pose.centre_px``, best first.

    Parameters
    ----------
    luma : (h, w) uint8
    patch : the template
    nodes : (n, n), picture of the patch at its nodes, DN (the template, or a blend with its recent look)
    pose : where it lies
    reach_px : how far from there peaks may lie
    count : of peaks at most
    """
    import cv2

    half = _half(patch, pose)
    kernel, weight = _drawn(patch, nodes, pose.shape, np.arange(-half, half + 1.0))
    middle = np.rint(pose.centre_px).astype(int)
    margin = half + reach_px
    (u0, v0), (u1, v1) = middle - margin, middle + margin + 1
    height, width = luma.shape
    part = luma[max(v0, 0) : min(v1, height), max(u0, 0) : min(u1, width)]
    if part.size == 0:
        return []
    sides = (max(-v0, 0), max(v1 - height, 0), max(-u0, 0), max(u1 - width, 0))
    part = cv2.copyMakeBorder(part, *sides, cv2.BORDER_REPLICATE)
    surface = _correlation(part.astype(np.float32), kernel, weight)
    v, u = np.mgrid[-reach_px : reach_px + 1, -reach_px : reach_px + 1]
    surface[u**2 + v**2 > (reach_px + 1) ** 2] = -1.0
    found = _peaks(surface, pose.shape @ patch.blind, patch.radius_px, count, 1)
    return [Peak(middle - reach_px + place, value) for place, value in found]


def peaks_everywhere(luma: NDArray[np.uint8], patch: Patch, nodes: Array, shape: Array, count: int = 4) -> list[Peak]:
    """The ``count`` best peaks of the whole frame, at half resolution, best first.

    Parameters
    ----------
    luma : (h, w) uint8
    patch : the template
    nodes : (n, n), picture of the patch at its nodes, DN
    shape : (2, 2)
    count : of peaks at most
    """
    import cv2

    half = _half(patch, Pose(np.zeros(2), shape)) // 2
    axis = np.arange(-(2 * half + 0.5), 2 * half + 1.0)
    kernel, weight = _drawn(patch, nodes, shape, axis)
    kernel, weight = (_halved(x) for x in (kernel, weight))
    height, width = (x // 2 for x in luma.shape)
    if height < len(kernel) or width < len(kernel):
        return []
    small = cv2.resize(luma[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    surface = _correlation(small.astype(np.float32), kernel, weight)
    found = _peaks(surface, shape @ patch.blind, patch.radius_px / 2, count, 1)
    return [Peak(2.0 * (place + half) + 0.5, value) for place, value in found]


def _halved(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    import cv2

    return np.asarray(cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _half(patch: Patch, pose: Pose) -> int:
    grown = min(axes_of(pose.shape)[0], LARGEST_GROWTH)
    return int(np.ceil(patch.radius_px * grown))


def _drawn(patch: Patch, nodes: Array, shape: Array, axis: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The patch and its weight, turned by ``shape``, at pixels ``axis`` x ``axis`` from its centre."""
    import cv2

    turn = inverse(shape)
    v, u = np.meshgrid(axis, axis, indexing="ij")
    xi = [(turn[k, 0] * u + turn[k, 1] * v - patch.origin_px[k]).astype(np.float32) for k in (0, 1)]
    drawn = cv2.remap(nodes.astype(np.float32), xi[0], xi[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    apart = np.hypot(xi[0] + patch.origin_px[0], xi[1] + patch.origin_px[1])
    trust = cv2.remap(patch.trust.astype(np.float32), xi[0], xi[1], cv2.INTER_LINEAR, borderValue=0)
    weight = trust * np.clip(patch.radius_px + 0.5 - apart, 0.0, 1.0)
    return np.asarray(drawn, dtype=np.float32), weight.astype(np.float32)


def _correlation(picture: NDArray[np.float32], kernel: NDArray[np.float32], weight: NDArray[np.float32]) -> Array:
    """Weighted normalised cross-correlation of ``kernel`` with every place of ``picture`` that holds it whole."""
    import cv2

    picture = picture - picture.mean()
    total = max(float(weight.sum()), _EDGE)
    shifted = kernel - float((weight * kernel).sum()) / total
    weighed = np.asarray(weight * shifted, dtype=np.float32)
    energy = float((weighed * shifted).sum())
    product = cv2.matchTemplate(picture, weighed, cv2.TM_CCORR)
    mean = cv2.matchTemplate(picture, weight, cv2.TM_CCORR) / total
    square = cv2.matchTemplate(picture * picture, weight, cv2.TM_CCORR) / total
    scatter = np.maximum(square - mean**2, 0.25)  # half a level: flat ground correlates with nothing
    return product / np.sqrt(max(energy, _EDGE) * total * scatter)


def _peaks(surface: Array, blind: Array, radius_px: float, count: int, edge: int) -> list[tuple[Array, float]]:
    """Best peaks of ``surface``, as (u, v) to a fraction of a pixel; along ``blind`` all places are one."""
    left = surface.copy()
    v, u = np.mgrid[0 : surface.shape[0], 0 : surface.shape[1]]
    lobe = max(LEAST_LOBE_PX, LOBE_SHARE * radius_px)
    length = float(np.hypot(*blind))
    found: list[tuple[Array, float]] = []
    for _ in range(count):
        row, column = (int(x) for x in np.unravel_index(int(np.argmax(left)), left.shape))
        value = float(left[row, column])
        if value <= 0:
            break
        found.append(
            (np.array([column + _top(surface, row, column, 0, 1), row + _top(surface, row, column, 1, 0)]), value)
        )
        away_u, away_v = u - column, v - row
        if length > 0:
            apart = np.abs(away_u * blind[1] - away_v * blind[0]) / length
        else:
            apart = np.hypot(away_u, away_v)
        left[apart < lobe] = -1.0
    return found


def _top(surface: Array, row: int, column: int, down: int, right: int) -> float:
    """Place of the parabola's top through three neighbours, -0.5 .. 0.5; 0 at the rim."""
    rows, columns = surface.shape
    if not (down <= row < rows - down and right <= column < columns - right):
        return 0.0
    before, here, after = surface[row - down, column - right], surface[row, column], surface[row + down, column + right]
    bend = before - 2 * here + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
