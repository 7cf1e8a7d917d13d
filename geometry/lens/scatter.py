"""Are the corners' errors independent? What the views tell about it, and what it does to the covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera import Array
from .fit import JointFit


@dataclass(frozen=True)
class ViewScatter:
    """How the views' pulls on the lens scatter, against what independent corners let expect.

    Attributes
    ----------
    ratio, chance : their variance over the expected one, mean over the lens's directions; its standard deviation by chance
    covariance : (9, 9) of the lens from the pulls alone (infinitesimal jackknife, each variance freed of the views' leverage)
    own_chance : (9,), relative standard deviations by chance of the variances in it
    """

    ratio: float
    chance: float
    covariance: Array
    own_chance: Array


def view_scatter(fit: JointFit) -> ViewScatter:
    """Compare the views' pulls with their expectation.

    With g_i the score of view i at the joint optimum, cov(g_i) = s^2 (H_i - H_i H^-1 H_i). Its pull on the lens is the lens's part
    of H^-1 g_i. Measured in units of S, the lens's part of H^-1, the sum of the pulls' squares over its expectation is by how much
    the variances of the lens are larger, their mean; measured along one parameter, by how much that one's is. Where a few views
    fix a parameter alone, chance makes that number scatter more, which the expectations tell too (normal errors: variance 2 e^2).
    """
    size = fit.basis.shape[1]
    inverse = np.linalg.inv(fit.total)
    pulls = inverse[:size]
    root = np.linalg.cholesky(pulls[:, :size])
    whiten = np.linalg.solve(root, pulls)
    white = fit.score @ whiten.T
    expected, spread = 0.0, 0.0
    own = np.zeros((len(fit.score), size))
    for i, information in enumerate(fit.information):
        reach = whiten @ information
        white_covariance = (reach @ whiten.T - reach @ inverse @ reach.T) * fit.variance_px2
        expected += float(np.trace(white_covariance))
        spread += 2 * float((white_covariance**2).sum())
        own[i] = np.diag(root @ white_covariance @ root.T)
    plain = white @ root.T
    freed = np.sqrt(np.diag(pulls[:, :size]) * fit.variance_px2 / own.sum(0))
    moved = plain * freed
    absolute = np.abs(fit.basis)
    return ViewScatter(
        float((white**2).sum() / expected),
        float(np.sqrt(spread) / expected),
        fit.basis @ (moved.T @ moved) @ fit.basis.T,
        absolute @ (np.sqrt(2 * (own**2).sum(0)) / own.sum(0)),
    )


def widened(covariance: Array, scatter: ViewScatter) -> Array:
    """``covariance`` (9, 9) times the ratio, and wider still for a parameter whose own scatter is larger by twice its chance.

    Parameters
    ----------
    covariance : (9, 9) of the lens
    scatter : from ``view_scatter``
    """
    wide = covariance * max(1.0, scatter.ratio)
    own = np.diag(wide)
    ratio = np.divide(np.diag(scatter.covariance), own, out=np.ones(9), where=own > 0)
    grown = np.where(ratio > 1 + 2 * scatter.own_chance, np.sqrt(ratio), 1.0)
    return wide * np.outer(grown, grown)
