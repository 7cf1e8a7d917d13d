"""One-off pushes: what random forces must do once, and far harder than they ever do elsewhere.

Random forces follow any push, and what they leave has nothing of it (``inference.scan`` looks there). Here it is asked whether
pushes at some times, with smaller random forces beside them, explain the runs better; the hypothesis itself is fitted afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import logsumexp

from ...simulate.model import Array
from ..effects.base import SIZES
from ..inference.evidence import Fitted, Inference, Solved
from ..inference.noise import TIMES_S, Forces, force_colour

LASTS = (2, 5, 12)
"""Blocks that a push may last: a shorter one moves a model by its impulse alone, a longer one is a force of some course."""
SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)
"""Of the fit's random forces that may be left beside pushes: those that were estimated have taken up what the pushes did."""
MOST_N = 0.5
"""Prior standard deviation of a push, in N and N m: a hand on the deck. A choice; small ones are as likely (``SIZES``)."""
NOTABLE = 3.0
"""Pushes count if they promise more log evidence than this, what looking everywhere costs taken off."""


@dataclass(frozen=True)
class Push:
    """One push in one run.

    Attributes
    ----------
    run : index
    begin_s, end_s : in the run's own time
    cost : log of how many stretches were looked at
    """

    run: int
    begin_s: float
    end_s: float
    cost: float


@dataclass(frozen=True)
class _Found:
    """A push with what the fit says of its side force and moment, the run's own numbers eliminated.

    Attributes
    ----------
    push : where
    gain : log evidence of it alone
    matrix, pull : (2, 2) information and (2,) gradient
    through : (2, m), how much of it the shared numbers can take up, in units of their standard deviations
    """

    push: Push
    gain: float
    matrix: Array
    pull: Array
    through: Array


def pushes(inference: Inference, fitted: Fitted) -> list[Push]:
    """The pushes, at most one of a run, beside which smaller random forces explain the runs better; none where they do not.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    best, chosen = NOTABLE, list[Push]()
    alone = inference.solve(fitted.grams, fitted.hypothesis, fitted.forces).log_evidence
    for share in SHARES:
        forces = fitted.forces.scaled(share)
        solved = inference.solve(fitted.grams, fitted.hypothesis, forces)
        every = [_best_of(inference, fitted, forces, solved, run) for run in range(len(inference.simulator.runs))]
        order = sorted((found for found in every if found is not None), key=lambda found: -found.gain)
        for count in range(1, len(order) + 1):
            gain = _together(order[:count]) + solved.log_evidence - alone
            if gain > best:
                best, chosen = gain, [found.push for found in order[:count]]
    return sorted(chosen, key=lambda push: push.run)


def _together(found: Sequence[_Found]) -> float:
    """Log evidence of some pushes against none, what looking costs taken off."""
    through = np.concatenate([one.through for one in found])
    matrix = block_diag(*(one.matrix for one in found)) - through @ through.T
    gain = gains(matrix[None], np.concatenate([one.pull for one in found])[None])
    return float(gain[0]) - sum(one.push.cost for one in found)


def _best_of(inference: Inference, fitted: Fitted, forces: Forces, solved: Solved, run: int) -> _Found | None:
    """The best push of a run, if it gains more than looking everywhere costs."""
    noise, count, step_s = inference.noise, len(inference.simulator.runs[run].centre_s), inference.simulator.step_s
    moving, channels = noise.measured[run].moving, noise.runs[run].good.shape[1]
    rest = inference.left(fitted.linear, forces, solved.shared, solved.own[run], run)
    slopes = noise.whitened(run, forces, [fitted.linear.columns.tables[run][:, :, 1:]])[0]
    lag_s = step_s * np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    colour, roots = force_colour(TIMES_S[forces.time], lag_s), noise.measured[run].roots(forces.time)
    lasts = [blocks for blocks in LASTS if blocks < count]
    cost, best = float(np.log(sum(count - blocks + 1 for blocks in lasts))) if lasts else 0.0, None
    for blocks in lasts:
        courses = _courses(count, blocks)
        # a root is what a unit push does, block by block, times the colour
        even = solve_triangular(colour, courses, lower=True)
        values = np.zeros((count, channels, 2, courses.shape[1]))
        for kind, root in enumerate(roots):
            values[:, :moving, kind] = (root @ even).reshape(moving, count, -1).swapaxes(0, 1)
        white = noise.whitened(run, forces, [values])[0].transpose(2, 1, 0)  # (tiles, 2, N)
        pull, through, matrix = white @ rest, *left_to_it(solved, run, white, slopes)
        gain = gains(matrix - through @ through.swapaxes(1, 2), pull)
        at = int(np.argmax(gain))
        if gain[at] > (cost if best is None else best.gain):
            push = Push(run, at * step_s, (at + blocks) * step_s, cost)
            best = _Found(push, float(gain[at]), matrix[at], pull[at], through[at])
    return best


def _courses(count: int, blocks: int) -> Array:
    """(count, tiles): a push that rises and falls, over every stretch of so many blocks, of mean 1 there."""
    one = np.sin(np.pi * (np.arange(blocks) + 0.5) / blocks) ** 2
    courses = np.zeros((count, count - blocks + 1))
    for k, value in enumerate(2 * one):
        courses[np.arange(courses.shape[1]) + k, np.arange(courses.shape[1])] = value
    return courses


def left_to_it(solved: Solved, run: int, white: Array, slopes: Array) -> tuple[Array, Array]:
    """How much of what a run shows of forces the fit's own numbers leave to them.

    Parameters
    ----------
    solved : the fit
    run : index
    white : (tiles, k, N) what the forces do, whitened
    slopes : (N, shared + own) of the fit's numbers, whitened

    Returns
    -------
    through (tiles, k, m), how much the shared numbers can take up, in units of their standard deviations, and (tiles, k, k)
    information beside the run's own numbers
    """
    shared, part = len(solved.shared), solved.reduced
    cross = white @ slopes
    own = cross[..., shared:]
    followed = own @ part.inverse[run]
    matrix = white @ white.swapaxes(1, 2) - followed @ own.swapaxes(1, 2)
    return (cross[..., :shared] - followed @ part.cross[run]) @ np.linalg.cholesky(solved.covariance), matrix


def gains(matrix: Array, pull: Array) -> Array:
    """Log evidence of forces of any usual size against nothing.

    Parameters
    ----------
    matrix : (tiles, k, k) information, in 1/N^2 and 1/(N m)^2
    pull : (tiles, k) gradient

    Returns
    -------
    (tiles,)
    """
    logs = []
    for share in SIZES:
        sd = share * MOST_N
        whole = matrix * sd**2 + np.eye(matrix.shape[-1])
        answer = np.linalg.solve(whole, sd * pull[..., None])[..., 0]
        logs.append(0.5 * (sd * pull * answer).sum(axis=-1) - 0.5 * np.linalg.slogdet(whole)[1])
    return np.asarray(logsumexp(logs, axis=0)) - np.log(len(SIZES))


__all__ = ["Push", "gains", "left_to_it", "pushes"]
