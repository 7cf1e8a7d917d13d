"""What a patch looks like: cut from the frame where it was picked, then learnt from the first frames that confirm it.

Averaging those frames along their poses lowers the template's noise. It does not move the picked point: the frames are laid
on the first one, whose own noise shifts them all alike (``Learner.reference_sigma_px``), an offset that stays with the body.
Pixels that scatter beyond the noise although the patch is in place do not move with it (background behind an edge): they
lose their weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .patch import PAD_PX, Array, Patch, inverse, make_patch, slope_energy
from .patch_pixels import Pose

RADII_PX = (12, 15, 18, 20)
"""Radii that are tried for a picked patch, the smallest first."""
BLURS_PX = (1.0, 1.5, 2.0)
"""Tried on the picked frame's cut-out: where texture is weaker than noise, smoothing it places better."""
WANTED_SIGMA_PX = 0.03
"""The smallest radius that places the point this well is taken: a larger one holds more background."""
LEARN_FRAMES = 12
"""The template is final once it is the mean of this many frames."""
MEMORY_FRAMES = 96
"""The scatter of each pixel is remembered over about this many samples."""
FREE_SCATTER = 1.6
"""A pixel keeps its full weight up to this ratio of its variance to plain noise (32 samples scatter by 1.25)."""
QUIET_QUANTILE = 0.3
"""Of the pixels' variances: at this share lies what a quiet pixel shows, so that background in motion does not count.
A choice."""
SMOOTH_PX = 1.0
"""Width of the Gaussian that smooths the pixels' variances (half of it: the template before its slopes): a choice."""
STEEP_QUANTILE, STEEP_MARGIN = 0.7, 2.0
"""Pixels steeper than this share of all count as the steepest; twice their median scatter is still allowed.
Choices."""
PLACE_SCATTER_PX = (0.03, 0.4)
"""The steepest pixels tell by their median how far the picture scatters in place, within these limits."""
SLOPE_SD, LEAST_SAMPLES = 2.0, 8
"""A slope counts by what it exceeds this many of its standard deviations (5 % by chance), once so many samples are
in."""
CENTRE_SHARE = 0.6
"""Until the first chunk is learnt the pixels near the picked point count most, by a Gaussian of this share of the radius."""
TRUST_POWER = 4
"""Weights by inverse variance would do for independent residuals; background pulls as one piece and loses more."""
LARGEST_SCATTER_SD = 12.0
"""A residual counts at most as this many standard deviations of the noise, so that one flash is not learnt for
long."""
HAAR_MAD = 0.6745
"""Median of the absolute value of a standard normal number: its quantile at 3/4, to four digits."""


def picture_noise_dn(luma: NDArray[np.uint8]) -> float:
    """Noise of a frame from the median diagonal difference of 2 x 2 pixels, DN (at least a rounded level's 0.3)."""
    height, width = (x // 2 * 2 for x in luma.shape)
    x = luma[:height, :width].astype(np.int16)
    detail = (x[::2, ::2] - x[1::2, ::2] - x[::2, 1::2] + x[1::2, 1::2]) / 2.0
    return max(float(np.median(np.abs(detail))) / HAAR_MAD, 0.3)


def first_patch(luma: NDArray[np.uint8], picked_px: Array, radius_px: int | None, noise_dn: float) -> Patch:
    """Cut the template about ``picked_px``; without a radius, the smallest that places it well enough in every direction.

    Parameters
    ----------
    luma : (h, w) uint8
    picked_px : (2,)
    radius_px : of the patch; None: the smallest of ``RADII_PX`` that will do
    noise_dn : standard deviation of a pixel's noise, DN
    """
    for radius in RADII_PX if radius_px is None else ():
        patch = _cut_patch(luma, picked_px, radius, noise_dn)
        if expected_sigma_px(patch, noise_dn)[1] < WANTED_SIGMA_PX:
            return patch
    return _cut_patch(luma, picked_px, radius_px or RADII_PX[-1], noise_dn)


def expected_sigma_px(patch: Patch, noise_dn: float) -> Array:
    """Standard deviation (2,) of a frame's place along the patch's best and its worst axis, from its gradients alone.

    Parameters
    ----------
    patch : the template
    noise_dn : standard deviation of a pixel's noise, DN
    """
    ratio, _, _ = slope_energy(patch.table, patch.slope_noise)
    area = np.pi * patch.radius_px**2 * float(patch.trust.mean())
    energy = np.maximum(ratio - 1.0, 1e-6) * patch.slope_noise * area
    return np.minimum(noise_dn / np.sqrt(energy), patch.radius_px)[::-1]


def _cut_patch(luma: NDArray[np.uint8], picked_px: Array, radius_px: int, noise_dn: float) -> Patch:
    from scipy.ndimage import gaussian_filter

    middle = np.rint(picked_px).astype(int)
    half = radius_px + PAD_PX
    height, width = luma.shape
    u, v = (np.arange(m - half, m + half + 1) for m in middle)
    there = ((v >= 0) & (v < height))[:, None] & ((u >= 0) & (u < width))[None, :]
    values = luma[np.clip(v, 0, height - 1)[:, None], np.clip(u, 0, width - 1)[None, :]].astype(float)
    made = []
    for blur in BLURS_PX:
        # white noise blurred by a Gaussian: variance s^2 / (4 pi b^2), of its slope s^2 / (8 pi b^4)
        noise, slope = noise_dn / np.sqrt(4 * np.pi) / blur, noise_dn**2 / (8 * np.pi * blur**4)
        smooth = gaussian_filter(values, blur)
        made.append(make_patch(smooth, there.astype(float), middle - half - picked_px, radius_px, noise, slope))
    made.append(make_patch(values, there.astype(float), middle - half - picked_px, radius_px, noise_dn))
    return min(made, key=_first_variance)


def _first_variance(patch: Patch) -> float:
    """What the variance of a place goes by when the slopes hold noise: all energy over the square of the true one."""
    energy = patch.slope_noise * slope_energy(patch.table, patch.slope_noise)[0].sum()
    return float(energy / max(energy - 2.0 * patch.slope_noise, 1e-3 * energy) ** 2)


class Learner:
    """Mean and scatter of a patch at its nodes, gathered over frames.

    Parameters
    ----------
    patch : first template
    """

    def __init__(self, patch: Patch) -> None:
        self.patch = patch
        self.recent = patch.mean_dn.copy()
        self._variance: Array | None = None
        self._samples = 0.0
        self._sums: _Sums | None = None
        n = len(patch.mean_dn)
        v, u = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        self._xi = np.stack([u.ravel(), v.ravel()]) + patch.origin_px[:, None]
        self._inside = (np.hypot(*self._xi) <= patch.radius_px).reshape(n, n)
        self._seen = patch.trust > 0.5

    def at_nodes(self, luma: Array, pose: Pose) -> Array:
        """A frame at the template's nodes under ``pose``, brightness taken back: (n, n); NaN outside the picture."""
        from scipy.ndimage import map_coordinates

        n = len(self.patch.mean_dn)
        place = pose.shape @ self._xi + pose.centre_px[:, None]
        low = np.maximum(np.floor(place.min(axis=1)).astype(int) - 8, 0)
        high = np.ceil(place.max(axis=1)).astype(int) + 9
        part = luma[low[1] : high[1], low[0] : high[0]].astype(float)
        if min(part.shape, default=0) < 4:
            return np.full((n, n), np.nan)
        found = map_coordinates(part, (place - low[:, None])[::-1], order=3, mode="nearest")
        height, width = luma.shape
        outside = (place[0] < 0) | (place[0] > width - 1) | (place[1] < 0) | (place[1] > height - 1)
        found[outside] = np.nan
        return ((found - pose.offset_dn) / pose.gain).reshape(n, n)

    def glance(self, luma: Array, pose: Pose) -> None:
        """Weigh the pixels by what one more frame shows while the template is still the picked frame's cut-out."""
        gap = self.at_nodes(luma, pose) - self.patch.mean_dn
        seen = np.isfinite(gap)
        before = self._variance if self._variance is not None else np.zeros_like(gap)
        self._variance = before + (np.where(seen, gap**2, before / max(self._samples, 1.0)) - before) / (
            self._samples + 1.0
        )
        self._samples += 1.0
        near = np.exp(-0.5 * (np.hypot(*self._xi) / (CENTRE_SHARE * self.patch.radius_px)) ** 2)
        self.patch = self.patch.with_trust(self._trust() * near.reshape(gap.shape))

    def anchor(self, first: Pose, picked_px: Array) -> Array:
        """Let the point that lay at ``picked_px`` when the patch lay at ``first`` be the picked one: where it was, xi (2,)."""
        xi = inverse(first.shape) @ (picked_px - first.centre_px)
        self.patch = self.patch.seen_from(xi)
        self._xi = self._xi - xi[:, None]
        return xi

    def learn(self, seen: list[Array], noise_dn: float, last: bool) -> None:
        """Take the mean of the frames ``seen`` (as ``at_nodes`` gives) and of those learnt earlier as the template.

        Parameters
        ----------
        last : remember these frames (the same are not given again)
        """
        sums = _Sums.of(seen) + self._sums
        mean = np.where(sums.count > 0, sums.mean, self.patch.mean_dn)
        self._seen = sums.count > 0
        self._variance, self._samples = sums.variance, sums.frames
        self.recent = mean
        noise = noise_dn / np.sqrt(sums.frames)
        self.patch = make_patch(mean, self._trust(), self.patch.origin_px, self.patch.radius_px, noise)
        if last:
            self._sums = sums

    def watch(self, seen: list[Array], noise_dn: float) -> None:
        """Weigh the pixels anew after more frames; the template's mean stays."""
        if not seen or self._variance is None:
            return
        stack = np.stack(seen)
        gap = np.clip(stack - self.patch.mean_dn, -LARGEST_SCATTER_SD * noise_dn, LARGEST_SCATTER_SD * noise_dn)
        there = np.isfinite(gap)
        scatter = np.where(there, gap**2, 0.0).sum(axis=0)
        count = there.sum(axis=0)
        kept = min(self._samples, MEMORY_FRAMES)
        self._variance = (kept * self._variance + scatter) / np.maximum(kept + count, 1.0)
        self._samples = kept + len(seen)
        last = np.where(np.isfinite(stack[-1]), stack[-1], self.recent)
        self.recent = 0.5 * (self.recent + last)
        self.patch = self.patch.with_trust(self._trust())

    def place_variance_px2(self) -> float:
        """By how much pieces of the picture scatter in place against each other: variance, px2, of one coordinate.

        The pixels' scatter is regressed on their squared slope (jagged edges, compression, parts at another depth); only what
        is significant counts. White noise scatters steep and flat pixels alike and leaves 0.
        """
        if self._variance is None or self._samples < LEAST_SAMPLES:
            return 0.0
        down, right = np.gradient(self.patch.mean_dn)
        steep = np.asarray(down**2 + right**2)
        used = self._inside & self._seen & (self.patch.trust > 0.5)
        if used.sum() < 30:
            return 0.0
        x, y = steep[used] - steep[used].mean(), self._variance[used] - self._variance[used].mean()
        total = max(float(x @ x), 1e-9)
        slope = float(x @ y) / total
        error = float(np.sqrt(((y - slope * x) ** 2 * x**2).sum())) / total
        return float(np.clip(slope - SLOPE_SD * error, 0.0, PLACE_SCATTER_PX[1] ** 2))

    def _trust(self) -> Array:
        """Full weight up to FREE_SCATTER of the scatter expected of a pixel that moves with the mark, falling fast beyond.

        Expected: the quiet pixels' noise, and the slope times the scatter in place that most steep pixels show (sampling,
        compression, a registration still poor): judged without it, an edge would lose its weight for being steep.
        """
        from scipy.ndimage import gaussian_filter

        assert self._variance is not None
        smooth = np.asarray(gaussian_filter(self._variance, SMOOTH_PX))
        inside = self._inside & self._seen
        quiet = max(float(np.quantile(smooth[inside], QUIET_QUANTILE)), 0.09)
        down, right = np.gradient(gaussian_filter(self.patch.mean_dn, SMOOTH_PX / 2))
        steep = np.asarray(down**2 + right**2)
        steepest = inside & (steep > np.quantile(steep[inside], STEEP_QUANTILE))
        excess = (smooth[steepest] - quiet) / np.maximum(steep[steepest], 1e-6)
        least, most = (x**2 for x in PLACE_SCATTER_PX)
        place = min(max(STEEP_MARGIN * float(np.median(excess)), least), most)
        allowed = FREE_SCATTER * (quiet + place * steep)
        return np.minimum(1.0, allowed / np.maximum(smooth, 1e-9)) ** TRUST_POWER * self._seen


@dataclass(frozen=True)
class _Sums:
    """Frames at the nodes: how many at each (n, n), mean, sum of squares about it, and how many in all."""

    count: Array
    mean: Array
    squares: Array
    frames: float

    @staticmethod
    def of(seen: list[Array]) -> _Sums:
        stack = np.stack(seen)
        there = np.isfinite(stack)
        count = there.sum(axis=0)
        mean = np.where(there, stack, 0.0).sum(axis=0) / np.maximum(count, 1)
        return _Sums(count, mean, np.where(there, (stack - mean) ** 2, 0.0).sum(axis=0), float(len(seen)))

    def __add__(self, other: _Sums | None) -> _Sums:
        if other is None:
            return self
        count = self.count + other.count
        safe = np.maximum(count, 1)
        gap = self.mean - other.mean
        mean = (self.count * self.mean + other.count * other.mean) / safe
        squares = self.squares + other.squares + self.count * other.count / safe * gap**2
        return _Sums(count, mean, squares, self.frames + other.frames)

    @property
    def variance(self) -> Array:
        return self.squares / np.maximum(self.count - 1, 1)
