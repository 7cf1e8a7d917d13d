"""A template: what a patch looks like, as a cubic spline with a table to look it up in, and how far each pixel is trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

PAD_PX = 5
"""The template is kept this far beyond the patch, so that its spline and a patch that has grown stay inside."""
FINE = 4
"""Nodes of the looked-up table per pixel: with its slope, the nearest node is exact to a few tenths of a level."""
SOFT_PX = 2.0
"""The patch's weight falls to 0 over this width at its rim, so that pixels come and go smoothly."""
SLOPE_NOISE = 2.14
"""Variance of a cubic spline's slope through unit white noise at its nodes, 1/px2 (mean over the cell, Monte Carlo)."""
TRUSTED_SD = 5.0
"""A direction whose gradient energy exceeds what noise alone would give by fewer standard deviations tells nothing."""
LEAST_SHARE = 0.04
"""... as does one with less than this share of the other direction's energy: a sampled edge has steps that feign texture."""
CLEAR_RATIO = 40.0
"""Gradient energy along the weaker axis over that of the template's noise, from which the look is called clear: a
choice."""
CHANCE_SD = 4.0
"""Correlations that chance reaches, in standard deviations of a chance correlation."""


@dataclass(frozen=True)
class Patch:
    """A template.

    Attributes
    ----------
    mean_dn : (n, n), at nodes one pixel apart
    trust : (n, n), 0 .. 1, how much of a pixel's scatter is plain noise (background behind an edge: near 0)
    origin_px : (2,), place of the first node seen from the picked point
    radius_px : of the round patch
    noise_dn : standard deviation of one node's mean
    slope_noise : variance of the slopes from that noise, DN2/px2
    table : (m, m, 4), mean, its slopes along u and v, and the weight, FINE nodes a pixel
    blind : (2,), unit direction along which the patch tells nothing (a straight edge); zeros where there is none
    clear : its gradients are CLEAR_RATIO times those of its own noise along both axes
    blank : along neither axis do its gradients exceed those of noise
    """

    mean_dn: Array
    trust: Array
    origin_px: Array
    radius_px: int
    noise_dn: float
    slope_noise: float
    table: Array
    blind: Array
    clear: bool
    blank: bool

    def seen_from(self, xi: Array) -> Patch:
        """The same template, ``xi (2,)`` its new picked point."""
        return make_patch(
            self.mean_dn, self.trust, self.origin_px - xi, self.radius_px, self.noise_dn, self.slope_noise
        )

    def with_trust(self, trust: Array) -> Patch:
        """The same template, its pixels weighed anew."""
        table = self.table.copy()
        table[:, :, 3] = _weights(trust, self.origin_px, self.radius_px)
        blind, clear, blank = _told(table, self.slope_noise)
        return replace(self, trust=trust, table=table, blind=blind, clear=clear, blank=blank)


def make_patch(
    mean_dn: Array, trust: Array, origin_px: Array, radius_px: int, noise_dn: float, slope_noise: float | None = None
) -> Patch:
    """Build a template and its table from node values ``(n, n)``; without ``slope_noise`` their noise is white.

    Parameters
    ----------
    mean_dn : (n, n) node values, DN
    trust : (n, n), 0 .. 1
    origin_px : (2,) place of the picked point among the nodes
    radius_px : of the patch
    noise_dn : standard deviation of a pixel's noise, DN
    slope_noise : variance of the template's slope by noise of variance 1, 1/px2; None: as of white noise
    """
    from scipy.ndimage import spline_filter

    value, slope = _splines(len(mean_dn))
    nodes = spline_filter(mean_dn, order=3, mode="mirror")
    # einsum on purpose: at this size BLAS would wake all cores, which costs more than the product
    across = [np.einsum("ij,kj->ik", nodes, along) for along in (value, slope, value)]
    channels = [np.einsum("ij,jk->ik", down, part) for down, part in zip((value, value, slope), across, strict=True)]
    table = np.stack([*channels, _weights(trust, origin_px, radius_px)], axis=2)
    slope_noise = max(SLOPE_NOISE * noise_dn**2 if slope_noise is None else slope_noise, 1e-6)
    return Patch(mean_dn, trust, origin_px, radius_px, noise_dn, slope_noise, table, *_told(table, slope_noise))


@lru_cache(maxsize=8)
def _splines(n: int) -> tuple[Array, Array]:
    """Cubic B-splines of ``n`` nodes and their slopes at the fine nodes, mirrored at the ends: ((n-1) FINE + 1, n) each."""
    place = np.arange((n - 1) * FINE + 1) / FINE
    value, slope = np.zeros((len(place), n)), np.zeros((len(place), n))
    for node in range(-2, n + 2):
        x = place - node
        a = np.abs(x)
        at = abs(node) if node < n else 2 * (n - 1) - node
        value[:, at] += np.where(a < 1, 2 / 3 - a**2 + a**3 / 2, np.maximum(2 - a, 0.0) ** 3 / 6)
        slope[:, at] += np.where(a < 1, -2 * x + 1.5 * x * a, -np.sign(x) * np.maximum(2 - a, 0.0) ** 2 / 2)
    return value, slope


def _weights(trust: Array, origin_px: Array, radius_px: int) -> Array:
    """Soft round rim times ``trust``, at the fine nodes."""
    fine = np.arange((len(trust) - 1) * FINE + 1) / FINE
    apart = np.hypot(fine[None, :] + origin_px[0], fine[:, None] + origin_px[1])
    return np.clip((radius_px + 0.5 * SOFT_PX - apart) / SOFT_PX, 0.0, 1.0) * _finer(_finer(trust).T).T


def _finer(rows: Array) -> Array:
    """Rows (n, k) at FINE steps, linearly: ((n-1) FINE + 1, k)."""
    step = (np.arange(FINE) / FINE)[None, :, None]
    between = rows[:-1, None] + step * (rows[1:] - rows[:-1])[:, None]
    return np.concatenate([between.reshape(-1, rows.shape[1]), rows[-1:]])


def slope_energy(table: Array, slope_noise: float) -> tuple[Array, Array, float]:
    """Gradient energy of a patch along its two axes over what noise alone would give.

    Parameters
    ----------
    table : of the template and its slopes, as ``Patch`` holds it
    slope_noise : variance of the template's slope by noise of variance 1, 1/px2

    Returns
    -------
    ratios : (2,), rising
    axes : (2, 2), columns
    trusted : least ratio that noise alone does not reach (its slopes are related over about two pixels)
    """
    along_u, along_v, weight = table[:, :, 1], table[:, :, 2], table[:, :, 3]
    weighted = along_u * weight
    off = float((weighted * along_v).sum())
    tensor = np.array([[(weighted * along_u).sum(), off], [off, (along_v**2 * weight).sum()]])
    total = max(float(weight.sum()), 1e-9)
    ratios, axes = np.linalg.eigh(tensor / total / slope_noise)
    return ratios, axes, least_ratio(total / FINE**2)


def least_ratio(pixels: float) -> float:
    """What a ratio of gradient energies must exceed to be more than noise, over so many pixels."""
    return 1.0 + TRUSTED_SD * 2.0 / float(np.sqrt(max(pixels, 1.0)))


def _told(table: Array, slope_noise: float) -> tuple[Array, bool, bool]:
    """``Patch.blind``, ``Patch.clear`` and ``Patch.blank``."""
    ratios, axes, trusted = slope_energy(table, slope_noise)
    blind = axes[:, 0] * (ratios[0] < max(trusted, LEAST_SHARE * ratios[1]))
    return blind, bool(ratios[0] > CLEAR_RATIO), bool(ratios[1] < trusted)


def look_up(patch: Patch, xi: Array) -> Array:
    """Template, its slopes along u and v, and its weight at ``xi (2, m)``: (4, m).

    Parameters
    ----------
    patch : the template
    xi : (2, m) places in the template
    """
    size = patch.table.shape[0]
    fine = (xi - patch.origin_px[:, None]) * FINE
    node = np.rint(fine)
    fine -= node
    column, row = np.clip(node, 0, size - 1, out=node)
    index = (row * size + column).astype(np.intp)
    found = np.ascontiguousarray(patch.table.reshape(-1, 4).take(index, axis=0).T)
    fine *= found[1:3]
    fine *= 1.0 / FINE
    found[0] += fine[0]
    found[0] += fine[1]
    return found


def inverse(shape: Array) -> Array:
    """Inverse of a (2, 2); numpy's own spends most of its time on getting started."""
    (a, b), (c, d) = shape.tolist()
    scale = 1.0 / (a * d - b * c)
    return np.array([[d * scale, -b * scale], [-c * scale, a * scale]])


def determinant(shape: Array) -> float:
    """Determinant of a (2, 2)."""
    (a, b), (c, d) = shape.tolist()
    return a * d - b * c


def axes_of(shape: Array) -> tuple[float, float]:
    """Singular values of a (2, 2), larger first."""
    total, area = float((shape**2).sum()), abs(determinant(shape))
    root = np.sqrt(max(total**2 - 4 * area**2, 0.0))
    large = float(np.sqrt((total + root) / 2))
    return large, area / max(large, 1e-12)


def texture(patch: Patch) -> tuple[float, float]:
    """Standard deviation of a template, DN, and the correlation that chance reaches with it.

    Two unrelated pictures of n independent cells correlate by 1/sqrt(n) (Bartlett; Fisher's z for few of them); a cell is the
    sum of the template's squared autocorrelation.
    """
    n = len(patch.mean_dn)
    u, v = np.meshgrid(np.arange(n) + patch.origin_px[0], np.arange(n) + patch.origin_px[1])
    weight = patch.trust * (np.hypot(u, v) <= patch.radius_px)
    total = max(float(weight.sum()), 1e-9)
    values = weight * (patch.mean_dn - (weight * patch.mean_dn).sum() / total)
    square = float((values**2).sum()) / max(float((weight**2).sum()), 1e-9)
    related = np.fft.irfft2(np.abs(np.fft.rfft2(values, (2 * n, 2 * n))) ** 2)
    cells = total / max(float(((related / max(related[0, 0], 1e-12)) ** 2).sum()), 1.0)
    chance = float(np.tanh(CHANCE_SD / np.sqrt(max(cells - 3.0, 1.0))))
    return float(np.sqrt(max(square - patch.noise_dn**2, 1e-6))), chance
