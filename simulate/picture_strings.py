"""The reference strings across the tank top, their marks every 0.30 m, and the datum marks: above everything else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Camera
from ..record.scenario import FilmDatum
from .picture_hull import width_on_picture
from .picture_tools import Picture, paint_bar, paint_disc
from .scene import STRING_MARK_M, Stage

# Colours of the strings and the datum's marks, blue green red, DN at exposure 1: choices, for looks only.
_STRING = np.array([150.0, 158.0, 160.0])
_BEAD = np.array([46.0, 62.0, 172.0])
_MARK = np.array([222.0, 224.0, 224.0])
_RING = np.array([14.0, 14.0, 14.0])
_WIRE = np.array([104.0, 106.0, 106.0])
# Thickness of a string; a mark's diameter and its least radius on the picture: choices.
_STRING_M = 0.004
_MARK_M = 0.030
_MARK_MIN_PX = 2.2
_PIECES = 24
"""Of a string: the lens bends it, each piece is straight."""


@dataclass(frozen=True)
class Strings:
    """Strings and datum marks as a layer: ``colour`` (h, w, 3) already weighted by ``cover`` (h, w, 1)."""

    colour: Picture
    cover: NDArray[np.float32]

    def over(self, picture: Picture, box: tuple[slice, slice]) -> None:
        """Lay them over a part of a picture."""
        part = picture[box]
        part *= 1 - self.cover[box]
        part += self.colour[box]


def paint_strings(
    camera: Camera, stage: Stage, datum: tuple[FilmDatum, ...], size: tuple[int, int], exposure: float
) -> Strings:
    """Paint the layer once.

    Parameters
    ----------
    camera : of the scenario
    stage : walls, strings, girder and deck
    datum : points of the scenario
    size : width and height, px
    exposure : factor on all brightness
    """
    colour = np.zeros((size[1], size[0], 3), dtype=np.float32)
    cover = np.zeros_like(colour)
    for picture, tint in ((colour, lambda c: c * exposure), (cover, lambda c: np.ones(3))):
        for x_m in stage.string_x_m:
            _string(picture, camera, stage, x_m, tint)
        for point in datum:
            _mark(picture, camera, point, tint)
    return Strings(colour, cover[..., :1])


def _string(picture: Picture, camera: Camera, stage: Stage, x_m: float, tint) -> None:
    half = stage.width_m / 2
    y = np.linspace(-half, half, _PIECES + 1)
    places = np.column_stack([np.full_like(y, x_m), y, np.zeros_like(y)])
    pixel = camera.project(places)
    for i in range(_PIECES):
        if np.isfinite(pixel[i : i + 2]).all():
            width = [width_on_picture(camera, place, _STRING_M) for place in places[i : i + 2]]
            paint_bar(picture, pixel[i : i + 2], width, tint(_STRING))
    count = int((half - 1e-6) // STRING_MARK_M)
    beads = STRING_MARK_M * np.arange(-count, count + 1, dtype=float)
    places = np.column_stack([np.full_like(beads, x_m), beads, np.zeros_like(beads)])
    for place, at in zip(places, camera.project(places), strict=True):
        if np.isfinite(at).all():
            paint_disc(picture, at, max(0.5 * width_on_picture(camera, place, 0.016), 1.0), tint(_BEAD))


def _mark(picture: Picture, camera: Camera, point: FilmDatum, tint) -> None:
    """A white disc in a dark ring; below the tank top it hangs on a wire."""
    place = np.array(point.tank_m)
    pixel = camera.project(place)[0]
    if not np.isfinite(pixel).all():
        return
    if place[2] > 0:
        top = camera.project(place * [1.0, 1.0, 0.0])[0]
        if np.isfinite(top).all():
            paint_bar(picture, np.stack([top, pixel]), width_on_picture(camera, place, 0.003), tint(_WIRE))
    radius = max(0.5 * width_on_picture(camera, place, _MARK_M), _MARK_MIN_PX)
    paint_disc(picture, pixel, 1.65 * radius, tint(_RING))
    paint_disc(picture, pixel, radius, tint(_MARK))
