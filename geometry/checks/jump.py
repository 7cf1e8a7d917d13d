"""A sudden turn of the camera shows as a jump of all marks between two frames that no towed model can make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera import Array
from .bundle import Film

HALF = 7
"""Frames on either side; cubic motion and a step are fitted to both sides together."""
LEAST_FRAMES = 4 * HALF
"""Twice the window of 2 HALF: a shorter film leaves too few places to compare a jump with. A choice."""
LONGEST_GAP = 3.0
"""Frames further apart than this many usual steps are not looked at together."""


@dataclass(frozen=True)
class Jump:
    """The most likely jump of a film.

    Attributes
    ----------
    t_s : first time after it
    before_s : last time before it
    turn_rad : (3,), right, down, ahead
    gain : drop of chi-square by the turn (3 numbers), the largest over all frames; where paths are no cubics from frame to
        frame (too few frames a second), in units of what the fit to these frames leaves
    rest : chi-square that the turn leaves of the jump, of ``rest_degrees``, in the same units
    frames : places looked at
    """

    t_s: float
    before_s: float
    turn_rad: Array
    gain: float
    rest: float
    rest_degrees: int
    frames: int


def find_jump(film: Film, per_turn: Array, inflation: float) -> Jump | None:
    """Look for a jump that a turn of the camera explains.

    Parameters
    ----------
    film : frames with every mark seen are used
    per_turn : (n, m, 2, 3) px/rad, d(pixel)/d(turn) of the marks
    inflation : factor on the pixels' variances
    """
    seen = np.isfinite(film.pixel_px).all(axis=(1, 2)) & np.isfinite(per_turn).all(axis=(1, 2, 3))
    t, pixel, slope = film.t_s[seen], film.pixel_px[seen], per_turn[seen]
    n, m = pixel.shape[:2]
    if n < LEAST_FRAMES:
        return None
    sigma = np.sqrt(np.median(film.sigma_px[seen] ** 2, axis=0) * inflation)
    places = np.arange(HALF, n - HALF + 1)
    index = places[:, None] + np.arange(-HALF, HALF)
    times = t[index]
    scaled = (times - times[:, :1]) / (times[:, -1:] - times[:, :1]) - 0.5
    design = np.stack([np.ones_like(scaled), scaled, scaled**2, scaled**3, np.zeros_like(scaled)], axis=2)
    design[:, HALF:, 4] = 1.0
    whole = np.diff(times, axis=1).max(axis=1) < LONGEST_GAP * np.median(np.diff(t))
    places, index, design = places[whole], index[whole], design[whole]
    if not len(places):
        return None
    inverse = np.linalg.inv(design.transpose(0, 2, 1) @ design)
    fitted = np.einsum("kcf,kfmi->kcmi", inverse @ design.transpose(0, 2, 1), pixel[index])
    step = fitted[:, 4].reshape(len(places), -1)
    left = (pixel[index] - np.einsum("kfc,kcmi->kfmi", design, fitted)) / sigma
    unit = np.maximum((left**2).sum(axis=(1, 2, 3)) / ((2 * HALF - 5) * 2 * m), 1.0)
    spread = np.sqrt(inverse[:, 4, 4])[:, None] * sigma.ravel()
    white = step / spread
    turning = slope[places].reshape(len(places), -1, 3) / spread[:, :, None]
    normal = turning.transpose(0, 2, 1) @ turning
    right = np.einsum("kia,ki->ka", turning, white)
    turn = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    drop = np.einsum("ka,ka->k", right, turn)
    gain = drop / unit
    best = int(np.argmax(gain))
    rest = float((white[best] ** 2).sum() - drop[best]) / unit[best]
    at = int(places[best])
    return Jump(float(t[at]), float(t[at - 1]), turn[best], float(gain[best]), rest, 2 * m - 3, len(places))
