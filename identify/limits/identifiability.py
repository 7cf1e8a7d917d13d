"""What a set of runs fixes and what not, judged so that a runaway fit cannot pass for a sure one.

Along a direction that the record leaves open, the optimum lies anywhere, and its linearised standard deviation there may
be small. So a fit that looks weak is done again with a weak anchor on m' and I' (the phase analysis (8.9) with a guessed
radius of gyration, 25 % wide), and its Fisher information, the anchor taken out again, is read at that point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array, Hull, linear_system
from ..analytic import phase_analysis
from ..data import RunData
from ..fit import Fit
from .combinations import Determined, determined

WEAK_SHARE = 0.08
"""From this relative standard deviation of any derivative on, the fit is examined."""
ANCHOR_SHARE = 0.25
"""How well the masses are said to be known for a try, as shares: wide, so that only a runaway fit is held."""
RADIUS_SHARE = 0.4
"""Radius of gyration over X_T, for the anchor: 0.25 of a length of 1.6 X_T."""
OPEN_VARIANCE = 1e4
"""Relative variance that stands for no knowledge at all."""
Extra = tuple[tuple[int, float, float], ...]
Refit = Callable[[Array, Extra], Fit]
"""(six) to start from, knowledge (index, value, sd) to add -> the same fit with it."""


@dataclass(frozen=True)
class Identifiability:
    """Result of ``examine``.

    Attributes
    ----------
    fit : to report: the given one, or the anchored one where something is not determined
    covariance : (6, 6) at ``fit.six``, without the anchor
    parts : single derivatives, refused ones, combinations
    """

    fit: Fit
    covariance: Array
    parts: Determined


def examine(fit: Fit, runs: list[RunData], refit: Refit | None = None) -> Identifiability:
    """Judge a fit.

    Parameters
    ----------
    fit : of ``runs``
    runs : as fitted
    refit : does the same fit from another start and with more knowledge; None = judge ``fit`` as it stands
    """
    plain = Identifiability(fit, fit.covariance, determined(fit.six, fit.covariance))
    share = np.sqrt(np.maximum(np.diag(fit.covariance), 0)) / np.abs(fit.six)
    if refit is None or (fit.converged and np.isfinite(share).all() and share.max() < WEAK_SHARE):
        return plain
    anchor = anchors(fit, runs)
    try:
        held = refit(anchor, tuple((i, float(anchor[i]), ANCHOR_SHARE * float(anchor[i])) for i in range(2)))
    except EstimationError:
        return plain
    covariance = without_anchors(held.covariance, held.six, anchor)
    parts = determined(held.six, covariance)
    return Identifiability(held, covariance, parts) if parts.refused else plain


def anchors(fit: Fit, runs: list[RunData]) -> Array:
    """Six derivatives from the oscillation that the fit shows, by the phase analysis (8.4, 8.8, 8.9) with a guessed K^2.

    Frequency and amplitude ratio are the fitted motion's, sure even where the derivatives are not.

    Parameters
    ----------
    fit : of ``runs``
    runs : as fitted
    """
    guesses = []
    for run in runs:
        tow = run.tow
        hull = Hull(*(float(x) for x in fit.six), speed_m_s=fit.speed_m_s).at_speed(tow.speed_m_s)
        roots, shapes = np.linalg.eig(linear_system(hull, tow)[0])
        swing = np.flatnonzero(np.imag(roots) > 1e-3 * np.abs(roots))
        assert tow.tension_n is not None
        if not len(swing):
            continue
        slow = swing[np.argmin(np.abs(np.real(roots[swing])))]
        # y = -y0 cos(wt), beta = b0 sin(wt): y0/b0 = -Im(Y/B) of amplitudes of e^(iwt) (theory.md 9.11)
        ratio = -float(np.imag(shapes[0, slow] / shapes[1, slow]))
        six = phase_analysis(
            float(np.imag(roots[slow])),
            abs(ratio),
            tow.tension_n,
            tow.tow_point_m,
            tow.line_length_m,
            tow.speed_m_s,
            (RADIUS_SHARE * tow.tow_point_m) ** 2,
        )
        six[2:] *= fit.speed_m_s / tow.speed_m_s
        guesses.append(six)
    return np.mean(guesses, axis=0) if guesses else np.array([*np.abs(fit.six[:2]), *fit.six[2:]])


def without_anchors(covariance: Array, six: Array, anchor: Array) -> Array:
    """Take the anchors' information on m' and I' out of a covariance.

    Parameters
    ----------
    covariance : (6, 6) of a fit that knew m' and I' to ANCHOR_SHARE of ``anchor`` beforehand
    six : (6,) derivatives of that fit
    anchor : (6,) of ``anchors``

    Returns
    -------
    covariance : (6, 6) by the records alone; along a direction on which they say nothing the variance is OPEN_VARIANCE, relative
    """
    size = np.abs(six)
    precision = np.linalg.inv(covariance / size[:, None] / size[None, :])
    for i in range(2):
        precision[i, i] -= (size[i] / (ANCHOR_SHARE * anchor[i])) ** 2
    values, vectors = np.linalg.eigh((precision + precision.T) / 2)
    values = np.maximum(values, 1 / OPEN_VARIANCE)
    return (vectors / values) @ vectors.T * size[:, None] * size[None, :]
