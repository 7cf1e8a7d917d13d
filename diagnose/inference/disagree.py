"""Whether the runs agree about the numbers that they share: derivatives and effects.

A simulator that misses something, or an effect in the wrong place, follows every run with other numbers: what it lacks differs from
tow to tow. Random forces may be as large as to swallow what is left over in each of them; numbers that the runs do not share they
cannot make alike. Of a fit that says what there is, every run's own wish to move the shared numbers is noise of known covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from ...simulate.model import Array
from .evidence import Fitted, Inference

SPREADS = np.geomspace(0.1, 1e3, 80)
"""Spreads that are held for equally likely (their logarithms are), in standard deviations with which an average run alone tells the
numbers: from where next to nothing shows to where nothing is shared.
"""
LEAST_TOLD = 1e-4
"""A number of which the runs together know less than this share of what is known of it beside them takes no part."""
TOLD = 1e-8
"""Directions of which the runs together know less than this share of what they know of the best one are left out: rounding."""


@dataclass(frozen=True)
class Disagreement:
    """What the runs say apart.

    Attributes
    ----------
    log_evidence : that each run has numbers of its own, normally spread about the shared ones, against one set for all
    by_run : (runs,) squared distance of each run's numbers from the others', as many as ``count`` expected of noise
    count : of numbers; 0: it cannot be asked
    """

    log_evidence: float
    by_run: Array
    count: int


def disagreement(inference: Inference, fitted: Fitted) -> Disagreement:
    """How far the runs' own values of the shared numbers scatter beyond noise.

    With M_i the information of run i about the shared numbers (its own eliminated), g_i = b_i - M_i s the slope that it has at
    what all runs together say, s, and C the covariance of s, slopes of a right hypothesis have the covariance A = [M_i if i = j] -
    M_i C M_j. Numbers that scatter by tau^2 D (D: inverse of the mean M_i) add tau^2 A D A to it. An effect that is larger than it
    usually is contradicts no run: its numbers may be as large as they were found. Camera modes are of one camera: they stay shared.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    h, runs = fitted.hypothesis, len(inference.simulator.runs)
    none = Disagreement(0.0, np.zeros(runs), 0)
    if runs < 2 or not inference.simulator.noise_known:
        return none
    parts = [inference.reduced(fitted.grams, h, fitted.forces, [run]) for run in range(runs)]
    whole, rights = np.stack([part.matrix for part in parts]), np.stack([part.right for part in parts])
    held, pull = _beside_the_runs(inference, fitted)
    modes = slice(len(h.shared), inference.fixed(h))
    # of a number that is known far better beside the runs (an effect that never acted in them) they say nothing but rounding
    told = np.diagonal(whole.sum(axis=0)) > LEAST_TOLD * held
    told[modes] = False
    moved = np.flatnonzero(told)
    if not len(moved):
        return none
    units = _units(whole.mean(axis=0)[np.ix_(moved, moved)])
    count = units.shape[1]
    known = np.zeros((len(held), count + inference.mode_count))
    known[moved, :count] = units
    known[modes, count:] = np.eye(inference.mode_count)
    matrices, rights = known.T @ whole @ known, rights @ known
    common = np.linalg.inv(matrices.sum(axis=0) + known.T @ (held[:, None] * known))
    slopes = (rights - matrices @ (common @ (rights.sum(axis=0) + known.T @ pull)))[:, :count]
    rows = matrices[:, :count]
    covariance = -np.einsum("iak,kl,jbl->iajb", rows, common, rows)
    for run in range(runs):
        covariance[run, :, run] += matrices[run, :count, :count]
    by_run = [_squared(slopes[run], covariance[run, :, run]) for run in range(runs)]
    value, vectors = np.linalg.eigh(covariance.reshape(runs * count, -1))
    value, along = np.maximum(value, 0.0), np.square(vectors.T @ slopes.ravel())
    square = SPREADS[:, None] ** 2
    logs = 0.5 * (square * along / (1 + square * value) - np.log1p(square * value)).sum(axis=1)
    return Disagreement(float(logsumexp(logs) - np.log(len(SPREADS))), np.array(by_run), count)


def _beside_the_runs(inference: Inference, fitted: Fitted) -> tuple[Array, Array]:
    """Inverse variances of what is known of shared numbers, modes and effects beside the runs, and its pull; those of an effect's
    numbers as wide as these were found.
    """
    h, prior = fitted.hypothesis, inference.priors(fitted.hypothesis)
    if not h.size:
        return prior.precision, prior.pull
    step = fitted.solved.shared if fitted.solved.free is None else fitted.solved.free
    found = np.concatenate(h.numbers) - [q.none for e in h.effects for q in e.parameters] + step[inference.fixed(h) :]
    narrower = np.ones(len(prior.precision))
    own = slice(inference.fixed(h), None)
    narrower[own] = 1 / np.maximum(1.0, prior.precision[own] * found**2)
    return prior.precision * narrower, prior.pull * narrower


def _units(information: Array) -> Array:
    """(n, k) directions in each of which an average run knows a number to 1; k: those of which the runs know anything."""
    scale = 1 / np.sqrt(np.diag(information))
    value, vectors = _known(information * np.outer(scale, scale))
    return scale[:, None] * vectors / np.sqrt(value)


def _squared(slope: Array, covariance: Array) -> float:
    """Squared length of a slope, by its covariance, in the directions that this has."""
    value, vectors = _known(covariance)
    return float(((vectors.T @ slope) ** 2 / value).sum())


def _known(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues and vectors of a symmetric matrix without those that are rounding."""
    value, vectors = np.linalg.eigh(matrix)
    known = value > TOLD * max(float(value[-1]), np.finfo(float).tiny)
    return value[known], vectors[:, known]


__all__ = ["Disagreement", "disagreement"]
