"""The marks' light, their mirror images in the water, and the sensor's noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..record.scenario import FilmMarker, FilmTable
from .picture_tools import Picture, box_of, disc_mask, paint

LIGHT_BGR = {
    "red": (0.74, 0.78, 1.00),
    "green": (0.80, 1.00, 0.74),
    "blue": (1.00, 0.84, 0.74),
    "yellow": (0.66, 1.00, 1.00),
    "white": (1.00, 1.00, 1.00),
    "bright": (1.00, 1.00, 1.00),
}
"""Blue green red of a light, the strongest channel 1. Near white: 4:2:0 video keeps colour at half the resolution."""
_REACH_SIGMA = 5.5
"""A light is drawn out to so many of its widths: there it has fallen below 1e-6 of its peak."""
# A dark mark is painted on a light disc: its least level, DN, and its radius in widths of the mark (choices).
_DARK_DISC_DN = 150.0
_DARK_DISC_SIGMA = 4.5
_NOISE_MARGIN_PX = 64
"""One field of noise, larger than the picture by this, is drawn once and shifted at random from frame to frame."""


def add_light(picture: Picture, centre_px: NDArray[np.float64], marker: FilmMarker, exposure: float) -> None:
    """Add a mark's image: a Gaussian sampled at pixel centres, its peak ``peak_dn`` x exposure, its centre exact.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    centre_px : (2,)
    marker : of the scenario
    exposure : factor on all brightness
    """
    if marker.colour == "dark":
        _dark_mark(picture, centre_px, marker, exposure)
        return
    colour = np.array(LIGHT_BGR[marker.colour]) * marker.peak_dn * exposure
    _add_gaussian(picture, centre_px, (marker.width_px, marker.width_px), colour)


def add_reflection(
    picture: Picture, centre_px: NDArray[np.float64], marker: FilmMarker, strength: float, stretch: float
) -> None:
    """Add a mark's mirror image, ``stretch`` times as high as wide.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    centre_px : (2,)
    marker : of the scenario
    strength : factor on the light
    stretch : height over width
    """
    if marker.colour == "dark" or strength <= 0:
        return
    width = 1.15 * marker.width_px
    _add_gaussian(picture, centre_px, (width, stretch * width), np.array(LIGHT_BGR[marker.colour]) * strength)


def _add_gaussian(picture: Picture, centre_px, width_px: tuple[float, float], colour: NDArray[np.float64]) -> None:
    centre = np.asarray(centre_px, dtype=float)
    reach = _REACH_SIGMA * np.array(width_px)
    box = box_of(np.stack([centre - reach, centre + reach]), picture.shape, margin_px=0)
    if box is None:
        return
    rows, columns = box
    across = np.exp(-0.5 * ((np.arange(columns.start, columns.stop) - centre[0]) / width_px[0]) ** 2)
    down = np.exp(-0.5 * ((np.arange(rows.start, rows.stop) - centre[1]) / width_px[1]) ** 2)
    picture[box] += (down[:, None, None] * across[None, :, None] * colour).astype(np.float32)


def _dark_mark(picture: Picture, centre_px, marker: FilmMarker, exposure: float) -> None:
    """A dark dot on a light disc; both round about the same centre."""
    radius = _DARK_DISC_SIGMA * marker.width_px
    centre = np.asarray(centre_px, dtype=float)
    box = box_of(np.stack([centre - radius - 2, centre + radius + 2]), picture.shape)
    if box is None:
        return
    level = max(_DARK_DISC_DN, marker.peak_dn + 15.0) * exposure
    paint(picture, box, disc_mask(centre, radius, 1.5, box), (level, level, level))
    drop = -min(marker.peak_dn * exposure, level - 8.0)
    _add_gaussian(picture, centre, (marker.width_px, marker.width_px), np.full(3, drop))


@dataclass(frozen=True)
class Sensor:
    """Read noise and shot noise, drawn from one bank of unit normal numbers that every frame shifts and flips anew.

    Attributes
    ----------
    bank : (h + margin, w + margin, 3) float32
    read_dn : standard deviation of the read noise
    electrons_per_dn : shot noise variance = signal/electrons_per_dn
    rng : draws the shifts
    """

    bank: NDArray[np.float32]
    read_dn: float
    electrons_per_dn: float
    rng: np.random.Generator

    @classmethod
    def of(cls, film: FilmTable, rng: np.random.Generator) -> Sensor:
        """The sensor of [film]."""
        width, height = film.camera.image_size_px
        shape = (height + _NOISE_MARGIN_PX, width + _NOISE_MARGIN_PX, 3)
        return cls(rng.standard_normal(shape, dtype=np.float32), film.read_noise_dn, film.electrons_per_dn, rng)

    def expose(self, picture: Picture) -> NDArray[np.uint8]:
        """Read a picture out: noise added, rounded and clipped to 8 bit."""
        import cv2

        height, width = picture.shape[:2]
        top, left = self.rng.integers(0, _NOISE_MARGIN_PX, 2)
        noise = self.bank[top : top + height, left : left + width]
        level = cv2.addWeighted(picture, 1 / self.electrons_per_dn, picture, 0.0, self.read_dn**2)
        deviation = cv2.sqrt(np.maximum(level, 0.0, out=level))
        return np.asarray(cv2.add(picture, cv2.multiply(noise, deviation), dtype=cv2.CV_8U), dtype=np.uint8)
