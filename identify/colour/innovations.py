"""Prediction-error fit of tows that a coloured force pushes about: maximum likelihood of the Kalman filter's innovations.

Beside the parameters of ``fit_runs`` it estimates the disturbance's spectrum (sd of force and moment, one time constant) and
the measurement's scatter per channel. The full form takes its mean from the full equations and its filter from the linear
ones. Samples are block means of about a tenth of a second: colour of the measurement shorter than that is not seen, longer
colour is known from static records only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...record.each import Each, in_turn
from ...record.errors import EstimationError
from ...simulate.model import Array
from ..data import RunData
from ..joint.arrow import Arrow, Inverse, Shares, inverse_of, shares_of
from ..joint.problem import Answer, Problem
from ..joint.solve import damped_step
from ..joint.thin import thinned
from ..static_records import slow_parts
from ..still import Slow
from .disturbance import Disturbance
from .kalman import MOVING, NOISE_NAMES, Filtered, Innovations, innovations

NOISE = len(NOISE_NAMES)
MAX_STEPS = 40
"""Of the search for the largest likelihood; it ends earlier when it has settled."""
CONVERGED = 1e-4
"""Steps end when the next is expected to lower -2 log L by less than this (0.01 of a standard deviation squared)."""
SLIGHT = 1.0
"""A step that is expected to lower -2 log L by less than this changes nothing where ``SHORT`` more is asked for."""
SHORT = 20.0
"""Of -2 log L: a search that stands so far above what was asked for, and sees no step but slight ones, ends there."""
TOGETHER = 8
"""So many runs are filtered side by side, a third of the time of one after the other; workers are handed these."""
NEAR_SD = 5.0
"""Weak knowledge of the noise's logarithms, about the start: keeps one that the record does not show from running away."""
ARM_SHARE, ARM_SD = 0.6, 1.0
"""The moment's sd over the force's is an arm on the hull: 0.6 X_T to within a factor of 2.7 (one sd of its logarithm).
Where a record does not show one of the two, it would else be estimated as nothing and counted as known."""


@dataclass(frozen=True)
class LikelihoodFit:
    """Result of ``maximise``.

    Attributes
    ----------
    theta : parameter vector of ``problem``, whose runs are block means
    noise : (5,), logarithms of ``NOISE_NAMES``
    inverse : covariance over theta and noise, from the innovations' Fisher information
    shares : what each run says of the shared parameters, the noise among them
    deviance : -2 log L
    runs : the innovations of each run
    answers : mean responses
    steps, converged : of the search
    """

    problem: Problem
    theta: Array
    noise: Array
    inverse: Inverse
    shares: Shares
    deviance: float
    runs: list[Innovations]
    answers: list[Answer]
    steps: int
    converged: bool

    @property
    def covariance(self) -> Array:
        """Of the shared parameters: the six first, the noise last."""
        return self.inverse.shared

    @property
    def disturbance(self) -> Disturbance:
        """The noise parameters with their units."""
        force, moment, time_s, *scale = np.exp(self.noise)
        sd = np.sqrt(np.maximum(np.diag(self.covariance)[-NOISE:], 0.0))
        return Disturbance(float(force), float(moment), float(time_s), np.array(scale), sd)


def noise_start(problem: Problem, theta: Array) -> Array:
    """Noise parameters to begin with: a force that moves the hull about as much as the output error's residuals scatter.

    Parameters
    ----------
    problem : runs and what is free
    theta : parameter vector of ``problem``
    """
    answers = problem.evaluate(theta)
    scatter = np.sqrt(np.mean([np.mean(a.residual**2, axis=1) for a in answers], axis=0))
    length = np.mean([d.tow.line_length_m for d in problem.runs])
    tension = np.mean([d.tow.tension_n for d in problem.runs if d.tow.tension_n is not None])
    point = np.mean([d.tow.tow_point_m for d in problem.runs])
    force = 0.3 * tension * (scatter[0] / length + scatter[1])
    time_s = 0.3 * float(np.mean([(d.tow.line_length_m + d.tow.tow_point_m) / d.tow.speed_m_s for d in problem.runs]))
    return np.log([force, ARM_SHARE * force * point, time_s, 1.0, 1.0])


def maximise(
    runs: list[RunData],
    form: str,
    speed_m_s: float,
    theta: Array,
    noise: Array | None = None,
    progress: Callable[[str], None] | None = None,
    extra: tuple[tuple[int, float, float], ...] = (),
    each: Each = in_turn,
    asked: Callable[[list[RunData], list[Answer]], float] | None = None,
) -> LikelihoodFit:
    """Fit by Fisher scoring with Marquardt's damping.

    Parameters
    ----------
    runs : every sample; they are thinned here; common modes along a smooth path
    form : "full" or "linear"
    speed_m_s : at which the derivatives are quoted
    theta : start, of ``Problem(runs, form, speed_m_s)``, e.g. the output error's optimum
    noise : (5,) start of the noise parameters
    progress : is told in a sentence what is done
    extra : knowledge of derivatives beside the priors: (index, value, sd)
    each : runs the filter over each run, here or by workers
    asked : (block means, mean responses) -> the -2 log L below which the answer is of use: a search that is clearly not on its
        way there ends early, not converged; None: it goes to its end. Where no force is seen, its size and time constant slide
        along a flat valley.

    Raises
    ------
    EstimationError : the likelihood has no value at the start
    """
    few = [thinned(d, keep_first=True, keep_modes=True) for d in runs]
    problem = Problem(few, form, speed_m_s, extra=extra)
    slow = slow_parts(few)
    first = noise_start(problem, theta) if noise is None else noise.copy()
    noise = first
    with np.errstate(all="ignore"):
        here = _evaluate(problem, theta, noise, first, slow, each)
    if not np.isfinite(here.deviance):
        raise EstimationError("the innovations have no likelihood at the output error's optimum")
    free = np.concatenate([problem.free, np.ones(NOISE, dtype=bool)])
    damping, growth, converged, step_number = 1e-3, 2.0, False, 0
    for step_number in range(1, MAX_STEPS + 1):
        step, expected = damped_step(here.information, -here.score, free, damping)
        if expected < CONVERGED:
            converged = True
            break
        slight = damping <= 1 and expected < SLIGHT
        if slight and asked is not None and here.deviance > asked(few, here.answers) + SHORT:
            break
        whole = np.concatenate([theta, noise]) + step
        trial, trial_noise = whole[: problem.size], whole[problem.size :]
        there = None
        if trial[0] > 0 and trial[1] > 0 and np.abs(trial_noise - noise).max() < 5:
            with np.errstate(all="ignore"):
                there = _evaluate(problem, trial, trial_noise, first, slow, each)
        if there is not None and np.isfinite(there.deviance) and there.deviance <= here.deviance:
            gain = (here.deviance - there.deviance) / max(expected, 1e-300)
            theta, noise, here = trial, trial_noise, there
            damping, growth = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-10), 2.0
            if progress is not None:
                progress(f"innovations: step {step_number}, -2 log L {here.deviance:.6g}")
        else:
            damping, growth = damping * growth, growth * 2
            if damping > 1e8:
                break
    inverse = inverse_of(here.information, free)
    nothing = [(columns, block, slope, np.zeros_like(block)) for columns, block, slope in here.parts]
    shares = shares_of(here.known, here.pull, inverse, free, nothing)
    return LikelihoodFit(
        problem, theta, noise, inverse, shares, here.deviance, here.runs, here.answers, step_number, converged
    )


@dataclass(frozen=True)
class _Here:
    """-2 log L with half its gradient, and what it is made of: ``known`` and ``pull`` beside the runs, ``parts`` of each run
    (columns, information, score with its sign turned)."""

    deviance: float
    score: Array
    information: Arrow
    runs: list[Innovations]
    answers: list[Answer]
    known: Arrow
    pull: Array
    parts: list[tuple[NDArray[np.int_], Array, Array]]


def _evaluate(problem: Problem, theta: Array, noise: Array, first: Array, slow: list[Slow | None], each: Each) -> _Here:
    """-2 log L, half its gradient, and the Fisher information, over theta and noise."""
    layout = replace(problem.layout, size=problem.size + NOISE)
    prior, slope, deviance = problem.prior(theta)
    shared = np.zeros((len(layout.shared), len(layout.shared)))
    shared[:-NOISE, :-NOISE] = prior.shared
    border = np.concatenate([prior.border, np.zeros((layout.runs, layout.own, NOISE))], axis=2)
    known, pull = Arrow(layout, shared, border, prior.own), np.concatenate([slope, np.zeros(NOISE)])
    weak = (noise - first) / NEAR_SD
    deviance += float(weak @ weak)
    place = np.arange(problem.size, layout.size)
    known.add_diagonal(place, np.full(NOISE, 1 / NEAR_SD**2))
    pull[place] -= weak / NEAR_SD
    arm = ARM_SHARE * float(np.mean([d.tow.tow_point_m for d in problem.runs]))
    tie, row = (noise[1] - noise[0] - np.log(arm)) / ARM_SD, np.array([-1.0, 1.0]) / ARM_SD
    deviance += float(tie**2)
    known.add(place[:2], np.outer(row, row))
    pull[place[:2]] -= tie * row
    answers = problem.evaluate(theta)
    given = [
        Filtered(data, answer.residual, answer.slope, part)
        for data, answer, part in zip(problem.runs, answers, slow, strict=True)
    ]
    groups = _groups(given)
    told = each(_some, [([given[k] for k in group], theta[:6], noise, problem.speed) for group in groups])
    by_run = {k: run for group, some in zip(groups, told, strict=True) for k, run in zip(group, some, strict=True)}
    found: list[_Run] = [by_run[k] for k in range(len(given))]
    runs = [run.innovations for run in found]
    matrix, score, parts = known.copy(), -pull, []
    for run, answer in zip(found, answers, strict=True):
        deviance += run.deviance
        if not np.isfinite(deviance):
            return _Here(np.inf, score, matrix, runs, answers, known, pull, parts)
        # the six move the mean and the filter: their two columns become one
        columns, of = np.unique(np.concatenate([answer.columns, np.arange(6), place]), return_inverse=True)
        fold = (np.arange(len(columns))[:, None] == of).astype(float)
        parts.append((columns, fold @ run.information @ fold.T, -fold @ run.score))
        matrix.add(*parts[-1][:2])
        score[columns] -= parts[-1][2]
    return _Here(deviance, score, matrix, runs, answers, known, pull, parts)


@dataclass(frozen=True)
class _Run:
    innovations: Innovations
    deviance: float
    score: Array
    information: Array


def _groups(runs: list[Filtered]) -> list[list[int]]:
    """Those that are filtered side by side: of equally many states, ``TOGETHER`` at most."""
    alike = [[k for k, run in enumerate(runs) if run.states == size] for size in sorted({run.states for run in runs})]
    return [some[at : at + TOGETHER] for some in alike for at in range(0, len(some), TOGETHER)]


def _some(runs: list[Filtered], six: Array, noise: Array, speed_m_s: float) -> list[_Run]:
    """Some runs' shares."""
    with np.errstate(all="ignore"):
        found = innovations(runs, six, noise, speed_m_s)
    return [_run(run, one) for run, one in zip(runs, found, strict=True)]


def _run(run: Filtered, found: Innovations) -> _Run:
    """One run's share, over the columns of its answer, the six, and the noise parameters."""
    with np.errstate(all="ignore"):
        sign, log_determinant = np.linalg.slogdet(found.spread)
        if not ((sign > 0) & (found.spread[:, 0, 0] > 0)).all():  # a step that leaves no noise at all
            return _Run(found, np.inf, np.zeros(0), np.zeros((0, 0)))
        inverse = np.linalg.inv(found.spread)
        weighed = np.einsum("nij,nj->ni", inverse, found.error)
        deviance = float((found.error * weighed).sum() + log_determinant.sum())
        slopes = found.d_error
        weighed_slopes = slopes @ inverse
        score = np.einsum("nki,ni->k", slopes, weighed)
        fisher = np.tensordot(weighed_slopes, slopes, axes=([0, 2], [0, 2]))
        turned = inverse[:, None] @ found.d_spread  # (n, 11, 2, 2)
        pushed = 0.5 * np.trace(turned, axis1=2, axis2=3).sum(axis=0)
        pushed -= 0.5 * np.einsum("ni,nkij,nj->k", weighed, found.d_spread, weighed)
        flat = turned.reshape(len(turned), MOVING, 4)
        crossed = turned.transpose(0, 1, 3, 2).reshape(len(turned), MOVING, 4)
        score[-MOVING:] += pushed
        fisher[-MOVING:, -MOVING:] += 0.5 * np.tensordot(flat, crossed, axes=([0, 2], [0, 2]))
    return _Run(found, deviance, score, fisher)
