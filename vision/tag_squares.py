"""Dark squares in a picture, and which of them are a given tag. Families of tags and their cells, from OpenCV.

OpenCV finds the squares; of small or blurred ones it reads few codes (28 % of 7x7 tags of 20 px, where all squares are found), so
that is left to the correlation of a square's cells with the tag's, and in the end to the fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .tag_fit import Tag, TagFit
from .tag_view import SQUARE, Array, homography

LEAST_LIKENESS = 0.6
"""Correlation of a square's cells with a tag's from which on the fit decides. Their border alone gives any two tags about 0.4."""
LEAST_SCATTER_DN = 3.0
"""A square whose cells scatter by less counts as blank: a choice."""
LEAST_PERIMETER_PX = 40.0
"""Of a square that OpenCV looks for: 10 px a side, a choice."""
SAME_PLACE = 0.5
"""Two places closer than this share of the tag's side are one."""


class Squares:
    """The dark squares of a picture (h, w), or of its part from ``low`` to ``high`` (2,): ``corners`` (n, 4, 2), clockwise, px."""

    def __init__(self, luma: NDArray[np.uint8], low: Array | None = None, high: Array | None = None) -> None:
        self.luma = luma
        self._columns: dict[int, Array] = {}
        size = np.array(luma.shape[::-1])
        first = np.clip(np.zeros(2) if low is None else low, 0, size).astype(int)
        last = np.clip(size if high is None else high, 0, size).astype(int)
        part = np.ascontiguousarray(luma[first[1] : last[1], first[0] : last[0]])
        self.corners = np.zeros((0, 4, 2))
        if min(part.shape) >= LEAST_PERIMETER_PX / 4:
            taken, _, rejected = _detector("4X4_50", part.shape).detectMarkers(part)
            self.corners = np.array([*taken, *rejected], dtype=float).reshape(-1, 4, 2) + first

    def tags(self, tag: Tag, worn: bool = False) -> list[TagFit]:
        """All places where the whole tag lies, the likeliest first; ``tag`` takes up how it looks there.

        Parameters
        ----------
        tag : looked for
        worn : it need not be whole, only readable
        """
        likeness = _codes(tag.cells) @ self._cells(len(tag.cells)).T
        found: list[TagFit] = []
        for square in np.argsort(-likeness.max(axis=0)):
            turn = int(np.argmax(likeness[:, square]))
            if likeness[turn, square] < LEAST_LIKENESS:
                break
            corners = np.roll(self.corners[square], turn, axis=0)
            if any(_same(fit, corners) for fit in found):
                continue
            fit = tag.fit(self.luma, homography(corners))
            if fit is None or not (fit.readable if worn else fit.whole):
                continue
            if not any(_same(other, fit.corners_px) for other in found):
                found.append(fit)
        return found

    def _cells(self, side: int) -> Array:
        """The squares' cells, if they have ``side`` of them a side, as rows of mean 0 and length 1 (n, side^2)."""
        import cv2

        if side not in self._columns:
            # four samples across a cell, of which the middle two count
            raster = (2 * side * (SQUARE + 1) - 0.5).astype(np.float32)
            size, how = (4 * side, 4 * side), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            rows = np.empty((len(self.corners), side**2), np.float32)
            for row, corners in zip(rows, self.corners.astype(np.float32), strict=True):
                fine = cv2.warpPerspective(self.luma, cv2.getPerspectiveTransform(raster, corners), size, flags=how)
                row[:] = fine.reshape(side, 4, side, 4)[:, 1:3, :, 1:3].mean(axis=(1, 3), dtype=np.float32).ravel()
            rows -= rows.mean(axis=1, keepdims=True)
            # a blank square is like nothing
            self._columns[side] = rows / np.maximum(
                np.linalg.norm(rows, axis=1, keepdims=True), LEAST_SCATTER_DN * side
            )
        return self._columns[side]


def tag_cells(family: str, numbers: Sequence[int]) -> list[Array]:
    """Cells (m, m) of tags, 1 white, border included; empty where the family, or this OpenCV, has not all of them.

    Parameters
    ----------
    family : of tags, as OpenCV names it
    numbers : of the tags within the family
    """
    import cv2

    if not hasattr(cv2.aruco, f"DICT_{family}"):
        return []
    dictionary = _dictionary(family)
    if max(numbers) >= len(dictionary.bytesList):
        return []
    side = dictionary.markerSize + 2
    return [(dictionary.generateImageMarker(n, side) > 0).astype(np.float32) for n in numbers]


def count_tags(luma: NDArray[np.uint8], family: str) -> int:
    """How many tags of a family a picture shows, whatever their numbers.

    Parameters
    ----------
    luma : (h, w) uint8
    family : of tags, as OpenCV names it
    """
    ids = _detector(family, luma.shape).detectMarkers(luma)[1]
    return 0 if ids is None else len(ids)


def _dictionary(family: str):
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{family}"))


def _detector(family: str, shape: tuple[int, ...]):
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = LEAST_PERIMETER_PX / max(shape)
    # at OpenCV's 0.125 every third tag is dropped in favour of the edge of its own quiet zone
    parameters.minMarkerDistanceRate = 0.02
    return cv2.aruco.ArucoDetector(_dictionary(family), parameters)


def _codes(cells: Array) -> Array:
    """The cells as seen from each of four corners, rows of mean 0 and length 1 (4, m^2)."""
    turned = np.stack([np.rot90(cells, turn).ravel() for turn in range(4)])
    turned = turned - turned.mean(axis=1, keepdims=True)
    return turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-9)


def _same(fit: TagFit, corners_px: Array) -> bool:
    """These corners are the fitted tag's."""
    gap = np.hypot(*(fit.corners_px.mean(axis=0) - corners_px.mean(axis=0)))
    return bool(gap < SAME_PLACE * np.ptp(fit.corners_px, axis=0).min())
