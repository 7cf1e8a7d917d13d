"""A click becomes a place: the mark near it found to a small part of a pixel, by the code that ``towline datum`` uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..record.schema import DatumPoint
from ..vision.datum_find import CODEC_FACTOR, LEAST_SIGMA_PX, find_datum
from ..vision.recording import Frame
from ..vision.symmetry import centre_of_symmetry

CLICK_SIGMA_PX = 0.5
"""Of a click that nothing was found at, at a zoom of 1 or more: half a pixel of the recording."""
REACH_PX = 8.0
"""What was found farther from the click than this is something else."""
RADII_PX = (5.0, 7.0, 10.0)
"""Windows tried on what is no dot: corners of a chessboard, crosses, rings."""


@dataclass(frozen=True)
class Snapped:
    """Where a click landed.

    Attributes
    ----------
    pixel_px : u, v
    sigma_px : standard deviation along u and along v
    found : a mark was found there; else it is the click itself
    words : what happened, for the user
    """

    pixel_px: tuple[float, float]
    sigma_px: float
    found: bool
    words: str


def snapped(frame: Frame, click_px: tuple[float, float], lossy: bool, zoom: float = 1.0) -> Snapped:
    """The dot, cross or chessboard corner next to a click; the click itself where there is none.

    Parameters
    ----------
    frame : of the recording
    click_px : (u, v) in the picture
    lossy : the recording was compressed with loss; a point that stands still keeps the codec's error in all frames
    zoom : screen pixels per pixel of the recording at the click
    """
    near = np.asarray(click_px, dtype=float)
    point = DatumPoint(name="click", pixel_px=(float(near[0]), float(near[1])), tank_m=(0.0, 0.0, 0.0), look="mark")
    found = find_datum([point], [frame.luma], None, float(frame.white_dn), lossy).points[0]
    if found is not None and not found.reason and _near(found.pixel_px, near):
        return _of(found.pixel_px, found.sigma_px, near, "mark")
    best = None
    for radius in RADII_PX:
        corner = centre_of_symmetry(frame.luma, near, radius)
        if corner is not None and _near(corner.centre_px, near) and (best is None or corner.asymmetry < best.asymmetry):
            best = corner
    if best is not None:
        sigma = float(np.sqrt(np.mean(best.sigma_px**2))) * (CODEC_FACTOR if lossy else 1.0)
        return _of(best.centre_px, sigma, near, "symmetric point")
    sigma = CLICK_SIGMA_PX / min(max(zoom, 0.25), 1.0)
    return Snapped((float(near[0]), float(near[1])), sigma, False, "no mark found at the click; taken as clicked")


def _near(place: NDArray[Any], click: NDArray[Any]) -> bool:
    return bool(np.hypot(*(place - click)) <= REACH_PX)


def _of(place: Sequence[float] | NDArray[Any], sigma: float, click: NDArray[Any], what: str) -> Snapped:
    u, v = float(place[0]), float(place[1])
    moved = float(np.hypot(u - click[0], v - click[1]))
    sigma = max(float(sigma), LEAST_SIGMA_PX)
    return Snapped((u, v), sigma, True, f"{what} found {moved:.1f} px from the click, to {sigma:.3f} px")


def as_clicked(click_px: tuple[float, float], zoom: float = 1.0) -> Snapped:
    """The click as it is, where snapping is switched off.

    Parameters
    ----------
    click_px : (u, v) in the picture
    zoom : of the picture on the screen
    """
    return Snapped(
        (float(click_px[0]), float(click_px[1])), CLICK_SIGMA_PX / min(max(zoom, 0.25), 1.0), False, "taken as clicked"
    )


__all__ = ["Snapped", "as_clicked", "snapped"]
