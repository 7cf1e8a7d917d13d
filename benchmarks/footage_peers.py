"""What people use instead, on the same pictures: OpenCV's SimpleBlobDetector and trackpy, linked from frame to frame.

Peers are helped: they are told how large a mark is, whether it is dark, and where each stands in the first frame; they get the
part of the picture in which the marks move. A spot is linked by nearness to where a mark would be at the velocity of its last two
places.
"""

from __future__ import annotations

import importlib.util
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Peer = Callable[[NDArray[np.uint8], float, bool], Array]
"""A picture, the size of a mark's picture (px) and whether it is dark: places (k, 2)."""

MARGIN_PX = 40
"""Peers see the marks' whole path and this much around it."""
GATE_PX, FIRST_GATE_PX = 6.0, 14.0
"""A spot farther than this from where a mark should be, for every frame since it was seen, is not linked; the second frame knows
no velocity."""
BLOB_AREA = (0.15, 5.0)
"""Of a mark's, what the blob detector takes."""
BLOB_STEP_DN = 5
TRACKPY_MOST = 150
"""Of its strongest spots, as many as towline looks at."""


def blob(luma: NDArray[np.uint8], size_px: float, dark: bool) -> Array:
    """OpenCV's SimpleBlobDetector: a threshold every 5 DN, no filter but the area."""
    import cv2

    area = np.pi / 4 * max(size_px, 2.0) ** 2
    settings = cv2.SimpleBlobDetector.Params()
    settings.filterByColor, settings.blobColor = True, 0 if dark else 255
    settings.filterByArea, settings.minArea, settings.maxArea = True, max(1.0, BLOB_AREA[0] * area), BLOB_AREA[1] * area
    settings.filterByCircularity = settings.filterByConvexity = settings.filterByInertia = False
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = 5, 250, BLOB_STEP_DN
    settings.minDistBetweenBlobs = 2
    points = cv2.SimpleBlobDetector.create(settings).detect(np.ascontiguousarray(luma))
    return np.array([p.pt for p in points], dtype=float).reshape(-1, 2)


def trackpy(luma: NDArray[np.uint8], size_px: float, dark: bool) -> Array:
    """trackpy.locate at the odd diameter that is nearest to the mark's."""
    import trackpy as tp

    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = tp.locate(luma, max(2 * int(size_px / 2) + 1, 3), invert=dark, topn=TRACKPY_MOST)
    return found[["x", "y"]].to_numpy(dtype=float)


PEERS: dict[str, Peer] = {"OpenCV blob": blob, "trackpy": trackpy}


def present() -> dict[str, Peer]:
    """The peers that are installed."""
    return {name: peer for name, peer in PEERS.items() if name != "trackpy" or importlib.util.find_spec("trackpy")}


def why_absent() -> str:
    """What to say of peers that are not installed; empty where all are."""
    missing = sorted(set(PEERS) - set(present()))
    return f"not installed here: {', '.join(missing)} (pip install trackpy)" if missing else ""


def followed(
    peer: Peer, pictures: Sequence[NDArray[np.uint8]], path_px: Array, size_px: float, dark: bool
) -> tuple[Array, float]:
    """Places ``(frames, marks, 2)`` that a peer gives, NaN where it gives none, and its seconds.

    Parameters
    ----------
    peer : one of ``PEERS``
    pictures : grey values of each frame
    path_px : (frames, marks, 2): the first frame's are told, the others only bound the part of the picture that is looked at
    size_px : diameter of a mark's picture
    dark : darker than its ground
    """
    h, w = pictures[0].shape
    low = np.maximum(np.floor(np.nanmin(path_px, axis=(0, 1))).astype(int) - MARGIN_PX, 0)
    high = np.minimum(np.ceil(np.nanmax(path_px, axis=(0, 1))).astype(int) + MARGIN_PX, [w, h])
    marks = path_px.shape[1]
    place = np.full((len(pictures), marks, 2), np.nan)
    last, rate = path_px[0].astype(float), np.zeros((marks, 2))
    since, spent = np.zeros(marks), 0.0
    for row, luma in enumerate(pictures):
        began = time.process_time()
        spots = peer(np.ascontiguousarray(luma[low[1] : high[1], low[0] : high[0]]), size_px, dark) + low
        spent += time.process_time() - began
        for mark in range(marks):
            since[mark] += row > 0
            expected = last[mark] + rate[mark] * since[mark]
            away = np.hypot(*(spots - expected).T) if len(spots) else np.array([np.inf])
            best = int(np.argmin(away))
            if away[best] < max(FIRST_GATE_PX if row == 1 else GATE_PX * max(since[mark], 1), 0.5 * size_px):
                if since[mark]:
                    rate[mark] = (spots[best] - last[mark]) / since[mark]
                last[mark], since[mark] = spots[best], 0.0
                place[row, mark] = spots[best]
    return place, spent
