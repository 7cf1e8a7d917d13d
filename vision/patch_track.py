"""What is known of a followed patch between frames, and what a registration must show to be believed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .patch import Array, Patch, axes_of, texture
from .patch_fit import Registration
from .patch_pixels import Pose

NO_MATCH, AMBIGUOUS, OUTSIDE, COVERED, DRIFTED = "no match", "ambiguous", "outside the picture", "covered", "drifted"
REACH_PX, REACH_GROWTH_PX, REACH_LIMIT_PX, FIRST_REACH_PX = 6, 2, 40, 16
"""Search radius: usual, its growth with every lost frame, its limit; and while the point's rate is not known."""
RATE_SHARE = 0.7
"""The rate follows by this share a frame."""
STAND_FRAMES = 10
"""After this many lost frames the point is looked for about its last place, and every so often in the whole frame."""
SHAPE_RETURN = 0.02
"""What the texture does not show of the shape (a round spot's turn) goes back by this share a frame."""
SURE_FRAMES = 3
"""Losses up to this long leave the prediction good enough to tell the mark from a look-alike."""
LEAST_VISIBLE = 0.6
"""Share of the patch that must lie inside the picture: a choice."""
LEAST_INLIERS, FIRST_INLIERS = 0.55, 0.3
"""Share of the patch that must fit, less is `covered`; and until the background's pixels are known."""
CORRELATION, STRICT_CORRELATION = (0.35, 0.92), (0.2, 0.95)
"""A correlation may fall by this share of the way from the expected to chance, and to this share of the expected; the strict
pair holds after a loss, when only the look says what is the mark."""
NOISE, STRICT_NOISE, FIRST_NOISE = (1.6, 0.05), (1.3, 0.03), (2.0, 0.3)
"""Residuals may grow to this multiple of their usual size, and by this share of the texture."""
NOISE_RISE, NOISE_MEMORY = 2.0, 0.1
"""Their usual size follows them, up to this multiple of what it was when the template was learnt."""
GAIN_LIMITS, GAIN_STEP = (0.3, 3.0), 2.2
"""Contrast against the picked frame's, and from frame to frame."""
SHEAR_LIMIT, SCALE_LIMITS = 1.7, (0.5, 1.6)
"""Ratio of the shape's axes; their geometric mean."""
TELLING_CHANCE = 0.88
"""A patch that chance imitates better than this (a corner of plain areas) is believed only where it must be."""


@dataclass(frozen=True)
class Track:
    """What is known of the point after a frame.

    Attributes
    ----------
    pose : where it was seen last
    t_s : when
    rate_px_s : (2,)
    steps : places the rate rests on
    lost : frames lost since
    noise_dn : usual residual
    """

    pose: Pose
    t_s: float
    rate_px_s: Array
    steps: int
    lost: int
    noise_dn: float

    @staticmethod
    def starting(pose: Pose, t_s: float, noise_dn: float) -> Track:
        """Seen once."""
        return Track(pose, t_s, np.zeros(2), 0, 0, noise_dn)

    def predict(self, t_s: float) -> Array:
        """Expected place (2,), px."""
        standing = self.lost >= STAND_FRAMES
        return self.pose.centre_px + (0.0 if standing else t_s - self.t_s) * self.rate_px_s

    def shape(self) -> Array:
        """Expected shape (2, 2)."""
        return self.pose.shape + SHAPE_RETURN * (np.eye(2) - self.pose.shape)

    def reach(self) -> int:
        """How far to search, px."""
        if self.steps < 2:
            return FIRST_REACH_PX
        return min(REACH_PX + REACH_GROWTH_PX * self.lost, REACH_LIMIT_PX)

    def missed(self, frames: int = 1) -> Track:
        """After frames without it."""
        return replace(self, lost=self.lost + frames)

    def after(self, found: Registration, t_s: float) -> Track:
        """After a frame that shows it."""
        rate, steps = self.rate_px_s, self.steps + 1
        if self.lost >= STAND_FRAMES:
            rate, steps = np.zeros(2), 1
        elif t_s != self.t_s:
            seen = (found.pose.centre_px - self.pose.centre_px) / (t_s - self.t_s)
            rate = seen if self.steps < 2 else rate + RATE_SHARE * (seen - rate)
        noise = self.noise_dn + NOISE_MEMORY * (found.noise_dn - self.noise_dn)
        return Track(found.pose, t_s, rate, steps, 0, noise)

    def moved(self, by_px: Array) -> Track:
        """Seen from another corner of the picture."""
        return replace(self, pose=replace(self.pose, centre_px=self.pose.centre_px + by_px))


class Judge:
    """Decides whether a registration is the mark, from the template's texture and the residuals' usual size."""

    def __init__(self, patch: Patch) -> None:
        self.final = False
        self.usual_dn = np.inf
        self.patch = patch
        self.texture_dn, self.chance = texture(patch)

    def learnt(self, patch: Patch, usual_dn: float, final: bool) -> None:
        """The template has changed."""
        self.patch, self.usual_dn, self.final = patch, usual_dn, final
        self.texture_dn, self.chance = texture(patch)

    @property
    def telling(self) -> bool:
        """Its look alone tells the mark from other places."""
        return self.chance < TELLING_CHANCE

    def why_not(self, found: Registration | None, track: Track) -> str:
        """Why a registration is not the mark; "" = it is."""
        if found is None or self.patch.blank:
            return NO_MATCH
        if found.visible_share < LEAST_VISIBLE:
            return OUTSIDE
        long, short = axes_of(found.pose.shape)
        gain = found.pose.gain
        strict = track.lost > SURE_FRAMES
        step = GAIN_STEP * (2.0 if strict else 1.0)
        if (
            long > SHEAR_LIMIT * short
            or not SCALE_LIMITS[0] < np.sqrt(long * short) < SCALE_LIMITS[1]
            or not GAIN_LIMITS[0] < gain < GAIN_LIMITS[1]
            or not 1 / step < gain / track.pose.gain < step
            or found.correlation < self._least_correlation(gain, track.noise_dn, strict)
            or found.noise_dn > self._largest_noise(gain, track.noise_dn, strict)
        ):
            return NO_MATCH
        return COVERED if found.inlier_share < (LEAST_INLIERS if self.final else FIRST_INLIERS) else ""

    def _least_correlation(self, gain: float, noise_dn: float, strict: bool) -> float:
        """Between what noise leaves of the template's own correlation and what chance reaches, nearer the first."""
        seen = gain * self.texture_dn
        expected = seen / np.hypot(seen, noise_dn) * self.texture_dn / np.hypot(self.texture_dn, self.patch.noise_dn)
        share, most = STRICT_CORRELATION if strict else CORRELATION
        return min(expected - share * (expected - self.chance), most * expected)

    def _largest_noise(self, gain: float, noise_dn: float, strict: bool) -> float:
        """The residual's usual size, and a share of the texture (sampling and compression leave more where it is steep)."""
        growth, share = STRICT_NOISE if strict else NOISE if self.final else FIRST_NOISE
        return growth * min(noise_dn, NOISE_RISE * self.usual_dn) * max(gain, 1.0) + share * gain * self.texture_dn
