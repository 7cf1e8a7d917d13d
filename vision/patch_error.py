"""The error of a registered patch's centre: noise, noise related over pixels, pieces that scatter, and what an edge hides."""

from __future__ import annotations

import numpy as np

from .patch import Array, Patch, inverse, least_ratio
from .patch_pixels import PARAMETERS, Cut, Linear, Pose

PIECE_PX = 6
"""Side of the squares that are taken to be displaced each by itself: a choice, about a codec's smallest blocks (4 to
8 px)."""
NEAR_PX = 6
"""Residuals count as related over this many pixels (triangle)."""


def centre_covariance(patch: Patch, pose: Pose, white: Array, solved: Array, total: float) -> Array:
    """Covariance (2, 2) of the centre, where the template's own noise feigns a gradient along an edge.

    The information S about the centre is compared with that of a patch of noise alone, N. Errors in variables: the score
    keeps its noise, the true slope is smaller, so the variance is white (S / (S - N))^2; of S near N nothing is known: the
    patch's radius then stands for the standard deviation, as along its blind direction.

    Parameters
    ----------
    patch : the template
    pose : where it lies
    white : (2, 2), covariance by white noise alone
    solved : (8, 8), inverse of the normal matrix
    total : sum of the weights
    """
    if patch.clear:
        return white
    along = pose.shape @ patch.blind
    length = float(np.hypot(*along))
    if length > 0:
        across = np.eye(2) - np.outer(along, along) / length**2
        return across @ white @ across + (patch.radius_px / length) ** 2 * np.outer(along, along)
    turn = inverse(pose.shape)
    feigned = pose.gain**2 * patch.slope_noise * total * (turn.T @ turn)
    root = np.linalg.cholesky(feigned + 1e-12 * np.eye(2))
    back = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(back @ np.linalg.inv(solved[:2, :2]) @ back.T)
    growth = ratio / np.where(ratio > least_ratio(total), ratio - 1.0, 1e-3)
    mixing = back.T @ (axes * growth) @ axes.T @ root.T
    values, vectors = np.linalg.eigh(mixing @ white @ mixing.T)
    return (vectors * np.clip(values, 0.0, patch.radius_px**2)) @ vectors.T


def related_spread(
    cut: Cut, linear: Linear, influence: Array, weighted: Array, solved: Array, noise_dn: float
) -> Array:
    """Variance (2,) of the centre by sums over pairs of near residuals, beside what white noise would give: (2, 2).

    The fit takes from the residuals what it can explain, I - J (J'WJ)^-1 J'W, so that white noise leaves related residuals;
    that share is taken off the second column too.

    Parameters
    ----------
    cut : the frame's pixels about it
    linear : the model about a pose
    influence : (2, m), change of the centre with each pixel
    weighted : (8, m), slopes times weights
    solved : (8, 8), inverse of the normal matrix
    noise_dn : standard deviation of a pixel's noise, DN
    """
    found = np.empty((2, 2))
    for row in range(2):
        own = influence[row]
        sums = _box_sums(cut, np.vstack([own * linear.residual, own * linear.jacobian, own * weighted]))
        explained = (solved * (sums[1 : 1 + PARAMETERS] @ sums[1 + PARAMETERS :].T)).sum()
        found[row] = sums[0] @ sums[0], noise_dn**2 * (NEAR_PX**2 * float(own @ own) - explained)
    return found / NEAR_PX**2


def pieces_spread(cut: Cut, linear: Linear, influence: Array) -> Array:
    """Variance (2,) of the centre if every square of PIECE_PX were displaced by itself, 1 px along u and along v.

    Parameters
    ----------
    cut : the frame's pixels about it
    linear : the model about a pose
    influence : (2, m), change of the centre with each pixel
    """
    reach = int(np.abs(cut.place).max()) + PIECE_PX
    column, row = ((cut.place + reach) // PIECE_PX).astype(np.intp)
    cell = row * (int(column.max()) + 1) + column
    moved = [np.bincount(cell, own * slope) for own in influence for slope in linear.jacobian[:2]]
    return np.array([(moved[2 * k] ** 2).sum() + (moved[2 * k + 1] ** 2).sum() for k in (0, 1)])


def _box_sums(cut: Cut, fields: Array) -> Array:
    """Sums of ``fields (k, m)`` over all boxes of NEAR_PX pixels: (k, b). Their products make Bartlett's triangle."""
    import cv2

    reach = int(np.abs(cut.place).max()) + NEAR_PX
    size = 2 * reach + 1
    plane = np.zeros((len(fields), size * size))
    plane[:, ((cut.place[1] + reach) * size + cut.place[0] + reach).astype(np.intp)] = fields
    box = (NEAR_PX, NEAR_PX)
    return np.stack([cv2.boxFilter(p.reshape(size, size), -1, box, normalize=False).ravel() for p in plane])
