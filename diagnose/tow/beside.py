"""What forces of a given course would do beside smaller random forces: the score of many at once, about a fit.

Random forces follow anything, and what they leave has nothing of it. Whether a push or a force that repeats is there is asked by
what it would gain beside random forces that are smaller than those the fit needs without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from ...geometry.normal import root_of_covariance
from ...simulate.model import Array
from ..effects.base import SIZES
from ..inference.evidence import Fitted, Inference, Solved
from ..inference.noise import TIMES_S, Forces, force_colour

SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)
"""Of the fit's random forces that may be left: those that were estimated have taken up what is asked for."""
MOST_N = 0.5
"""Prior standard deviation of such a force, in N and N m: a hand on the deck. A choice; small ones are as likely (``SIZES``)."""
NOTABLE = 3.0
"""Forces count if they promise more log evidence than this, what looking everywhere costs taken off."""


@dataclass(frozen=True)
class Beside:
    """A fit beside random forces of another size.

    Attributes
    ----------
    inference, fitted : the fit
    forces, solved : its random forces made smaller, and its linear problem beside them
    loss : log evidence by which these explain the runs worse than the fit's own; below zero
    """

    inference: Inference
    fitted: Fitted
    forces: Forces
    solved: Solved
    loss: float

    def run(self, run: int) -> Asked:
        """What one run can be asked."""
        noise, step_s = self.inference.noise, self.inference.simulator.step_s
        rest = self.inference.left(self.fitted.linear, self.forces, self.solved.shared, self.solved.own[run], run)
        slopes = noise.whitened(run, self.forces, [self.fitted.linear.columns.tables[run][:, :, 1:]])[0]
        at = np.arange(len(self.inference.simulator.runs[run].centre_s))
        colour = force_colour(TIMES_S[self.forces.time], step_s * np.abs(np.subtract.outer(at, at)))
        return Asked(self, run, rest, slopes, colour, noise.measured[run].roots(self.forces.time))


@dataclass(frozen=True)
class Asked:
    """One run, to be asked.

    Attributes
    ----------
    beside : the fit
    run : index
    rest : (N,) what the fit leaves, whitened
    slopes : (N, shared + own) of its numbers, whitened
    colour, roots : of the random forces (``inference.noise``)
    """

    beside: Beside
    run: int
    rest: Array
    slopes: Array
    colour: Array
    roots: list[Array]

    def scores(self, courses: Array) -> tuple[Array, Array, Array]:
        """What the run says of side forces and moments of these courses, its own numbers eliminated.

        Parameters
        ----------
        courses : (n, c, tiles), c of a tile together

        Returns
        -------
        pull (tiles, 2 c) gradient, matrix (tiles, 2 c, 2 c) information and through (tiles, 2 c, m), how much of it the shared
        numbers can take up, in units of their standard deviations; side forces first
        """
        count, together, tiles = courses.shape
        noise, forces = self.beside.inference.noise, self.beside.forces
        moving, channels = noise.measured[self.run].moving, noise.runs[self.run].good.shape[1]
        # a root is what a unit push does, block by block, times the colour
        even = solve_triangular(self.colour, courses.reshape(count, -1), lower=True)
        values = np.zeros((count, channels, 2, together * tiles))
        for kind, root in enumerate(self.roots):
            values[:, list(moving), kind] = (root @ even).reshape(len(moving), count, -1).swapaxes(0, 1)
        white = noise.whitened(self.run, forces, [values])[0].reshape(-1, 2 * together, tiles).transpose(2, 1, 0)
        solved, part = self.beside.solved, self.beside.solved.reduced
        shared, cross = len(solved.shared), white @ self.slopes
        own = cross[..., shared:]
        followed = own @ part.inverse[self.run]
        matrix = white @ white.swapaxes(1, 2) - followed @ own.swapaxes(1, 2)
        through = (cross[..., :shared] - followed @ part.cross[self.run]) @ root_of_covariance(solved.covariance)
        return white @ self.rest, matrix, through


def beside_smaller(inference: Inference, fitted: Fitted) -> Iterator[Beside]:
    """The fit beside each of SHARES of its random forces; none that has run off, so that nothing is known of its numbers.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    alone = inference.solve(fitted.grams, fitted.hypothesis, fitted.forces).log_evidence
    for share in SHARES:
        forces = fitted.forces.scaled(share)
        try:
            solved = inference.solve(fitted.grams, fitted.hypothesis, forces)
        except np.linalg.LinAlgError:
            continue
        if not (np.diag(solved.covariance) > 0).all():
            continue
        yield Beside(inference, fitted, forces, solved, solved.log_evidence - alone)


def gains(pull: Array, matrix: Array, through: Array) -> Array:
    """Log evidence of forces of any usual size against nothing.

    Parameters
    ----------
    pull, matrix, through : as ``Asked.scores`` has them

    Returns
    -------
    (tiles,)
    """
    left, logs = matrix - through @ through.swapaxes(-1, -2), []
    for share in SIZES:
        sd = share * MOST_N
        whole = left * sd**2 + np.eye(left.shape[-1])
        answer = np.linalg.solve(whole, sd * pull[..., None])[..., 0]
        logs.append(0.5 * (sd * pull * answer).sum(axis=-1) - 0.5 * np.linalg.slogdet(whole)[1])
    return np.asarray(logsumexp(logs, axis=0)) - np.log(len(SIZES))


__all__ = ["MOST_N", "NOTABLE", "Asked", "Beside", "beside_smaller", "gains"]
