"""The noise of a campaign: what the measurement adds, and slow forces on the hull that no simulator knows.

The measurement's part comes from static records and stated sigmas (``tow_data``). The forces are first-order
(Ornstein-Uhlenbeck) processes in sway and yaw; their sizes and time constant are estimated with each hypothesis, by
restricted likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, solve_triangular, toeplitz

from ...simulate.model import Array

TIMES_S = (0.6, 2.0, 6.0)
"""Correlation times that random forces may have: a decade. Choices."""
FORCE_SD_N, MOMENT_SD_N_M = 0.01, 0.01
"""Usual sizes; their logarithms have the prior standard deviation LOG_SD about these."""
LOG_SD = 2.0
"""A factor of e^2, 7.4, up and down: little is known beforehand."""
EDGE = 0.02
"""Width (logarithm) of the edge above which no random force goes."""
SMALLEST = 1e-5
"""Force, N, and moment, N m, as good as none: their logarithms need a floor."""
UNSEEN = 1e-3
"""Of the measurement's variance: where forces show less, they are left out."""


FOLLOWED = 0.2
"""A fit whose random forces stay below this share of the largest that counts as noise has followed its runs. Of 14 first fits nine
stayed below, and no other start ended better by more than 0.3. A choice, for time."""


@dataclass(frozen=True)
class Forces:
    """Slow random forces.

    Attributes
    ----------
    side_n, moment_n_m : standard deviations
    time : index into TIMES_S
    """

    side_n: float = FORCE_SD_N
    moment_n_m: float = MOMENT_SD_N_M
    time: int = 1

    def scaled(self, share: float) -> Forces:
        """Forces of this share of the size."""
        return replace(self, side_n=share * self.side_n, moment_n_m=share * self.moment_n_m)

    def follow(self, most: float) -> bool:
        """Whether they are so small (FOLLOWED of ``most``, which is known) that the fit follows its runs."""
        return bool(np.isfinite(most)) and max(self.side_n, self.moment_n_m) <= FOLLOWED * most

    def log_prior(self, most: float) -> float:
        """Log density of the sizes; above ``most`` a force is no noise any more, and the density falls off at once."""
        sizes = np.array([self.side_n, self.moment_n_m])
        logs = np.log(sizes / [FORCE_SD_N, MOMENT_SD_N_M])
        above = np.log(np.maximum(sizes / most, 1.0)) / EDGE
        return float(-0.5 * (logs @ logs) / LOG_SD**2 - 0.5 * above @ above)


@dataclass(frozen=True)
class Space:
    """Where forces of one time constant show beside a run's measurement noise.

    Attributes
    ----------
    base : (m n, m n), orthonormal, in what moves, whitened; the directions that forces move most come first
    by_force : (2, m n, m n), covariance there by a unit side force and a unit moment
    shown : (m n,), variance by both, falling
    """

    base: Array
    by_force: Array
    shown: Array

    def wide(self, forces: Forces) -> int:
        """How many directions are needed for forces of this size (up to the next power of 2)."""
        level = np.ceil(np.log2(max(forces.side_n, forces.moment_n_m)))
        return max(1, int(np.searchsorted(-self.shown, -UNSEEN / 4.0**level)))

    def covariance(self, forces: Forces) -> Array:
        """(k, k) of all that shows there, the measurement's own part (1) with it."""
        k = self.wide(forces)
        return shown_covariance(self.by_force[:, :k, :k], forces)


@dataclass(frozen=True)
class RunNoise:
    """What does not change while the sizes are estimated.

    Attributes
    ----------
    measured : (m n, m n) of what moves
    white : inverse Cholesky factor of it
    still : per channel without dynamics (line, distance), in their order, the inverse Cholesky factor (n, n), or None
    log : log determinant of all that is measured
    good : (n, c)
    """

    measured: Array
    white: Array
    still: list[Array | None]
    log: float
    good: Array


Roots = Callable[[int], list[Array]]
"""Time constant -> (m n, n) roots of the covariance of what moves by a unit force of either kind."""


@dataclass(frozen=True)
class Measured:
    """The noise of a run's measurement.

    Attributes
    ----------
    good : (n, c)
    covariance : (c, n, n)
    moving : channels that forces move, m of them; the others (line, marker distance) hold no dynamics
    roots : how forces move those
    cross : (n, n), covariance of the first channel, which moves, with the second; None: they err apart
    scanned : how many of those that move, the first ones, are searched for something left over; None: all
    """

    good: Array
    covariance: Array
    moving: tuple[int, ...]
    roots: Roots
    cross: Array | None = None
    scanned: int | None = None


class Noise:
    """Noise of all runs.

    Forces move a model slowly: beside the measurement's noise small ones show in a part of the 260 directions, and trying other
    sizes costs that much only.

    Parameters
    ----------
    measured : of each run
    runs : ``run_noise`` of each, where it is known already
    """

    def __init__(self, measured: Sequence[Measured], runs: Sequence[RunNoise] | None = None) -> None:
        self.measured = list(measured)
        self.runs = (
            [run_noise(run.good, run.covariance, run.moving, run.cross) for run in measured]
            if runs is None
            else list(runs)
        )
        self._spaces: dict[tuple[int, int], Space] = {}

    def by_force(self, index: int, time: int) -> Array:
        """(2, m n, m n): covariance of what moves by a unit side force and a unit moment."""
        return np.array([r @ r.T for r in self.measured[index].roots(time)])

    def space(self, index: int, time: int) -> Space:
        """Where forces of TIMES_S[time] show in a run."""
        if (index, time) not in self._spaces:
            self._spaces[index, time] = _space(self.runs[index].white, self.measured[index].roots(time))
        return self._spaces[index, time]

    def white(self, index: int, values: Array) -> tuple[Array, Array]:
        """(n, c, k) beside the measurement's noise alone: what moves (m n, k), and the other channels."""
        noise, moved = self.runs[index], self.measured[index].moving
        flat = np.where(noise.good[..., None], values, 0.0)
        others = [c for c in range(values.shape[1]) if c not in moved]
        still = [root @ flat[:, c] for c, root in zip(others, noise.still, strict=True) if root is not None]
        moving = noise.white @ np.concatenate([flat[:, c] for c in moved])
        return moving, np.concatenate(still) if still else np.zeros((0, values.shape[2]))

    def whitened(self, index: int, forces: Forces, values: Sequence[Array]) -> list[Array]:
        """Arrays (n, c) or (n, c, k) of a run as white numbers (N,) or (N, k)."""
        space = self.space(index, forces.time)
        size, turn = np.linalg.eigh(space.covariance(forces))
        shrink, base = (turn * (size**-0.5 - 1)) @ turn.T, space.base[:, : len(size)]
        answers = []
        for value in values:
            moving, still = self.white(index, value.reshape(*value.shape[:2], -1))
            moving = moving + base @ (shrink @ (base.T @ moving))
            answers.append(np.concatenate([moving, still]).reshape(-1, *value.shape[2:]))
        return answers


def shown_covariance(by_force: Array, forces: Forces) -> Array:
    """(k, k) of what shows in k directions, the measurement's own part (1) with it.

    Parameters
    ----------
    by_force : (2, k, k), of a unit side force and a unit moment
    forces : their sizes
    """
    total = forces.side_n**2 * by_force[0]
    total += forces.moment_n_m**2 * by_force[1]
    total.flat[:: len(total) + 1] += 1.0
    return total


def _space(white: Array, roots: Sequence[Array]) -> Space:
    shown = [white @ root for root in roots]
    both = np.concatenate(shown, axis=1)
    size, turn = np.linalg.eigh(both @ both.T)
    base = np.ascontiguousarray(turn[:, ::-1])
    return Space(base, np.array([part @ part.T for part in (base.T @ root for root in shown)]), size[::-1])


def run_noise(good: Array, covariance: Array, moving: Sequence[int], cross: Array | None = None) -> RunNoise:
    """What forces do not change of a run's noise.

    Parameters
    ----------
    good, covariance, moving, cross : as ``Measured`` has them
    """
    n, channels = good.shape
    covariance = covariance.copy()
    for channel in range(channels):
        lost = ~good[:, channel]
        covariance[channel][np.ix_(lost, np.arange(n))] = 0.0
        covariance[channel][np.ix_(np.arange(n), lost)] = 0.0
        usual = float(np.diag(covariance[channel]).max()) or 1.0
        covariance[channel][lost, lost] = usual
    measured: Array = np.asarray(block_diag(*covariance[list(moving)]))
    if cross is not None:
        both = np.where(np.outer(good[:, 0], good[:, 1]), cross, 0.0)
        measured[:n, n : 2 * n], measured[n : 2 * n, :n] = both, both.T
    white, log = _inverse_root(measured)
    still: list[Array | None] = []
    for channel in (c for c in range(channels) if c not in moving):
        if not good[:, channel].any():
            still.append(None)
            continue
        root, own = _inverse_root(covariance[channel])
        log += own
        still.append(root)
    return RunNoise(measured, white, still, log, good)


def _inverse_root(covariance: Array) -> tuple[Array, float]:
    lower = np.linalg.cholesky(covariance)
    root = solve_triangular(lower, np.eye(len(lower)), lower=True)
    return root, 2 * float(np.log(np.diag(lower)).sum())


def forced(response: Array, colour_s: float, lag_s: Array) -> Array:
    """(m n, n) root of the covariance of m outputs under a force of unit size and a time constant.

    Parameters
    ----------
    response : (n, m) of the outputs to a unit force that lasts one step
    colour_s : time constant of the force, s
    lag_s : (n, n) between the steps
    """
    n = len(response)
    colour = force_colour(colour_s, lag_s)
    return np.concatenate([toeplitz(column, np.zeros(n)) @ colour for column in response.T])


def force_colour(colour_s: float, lag_s: Array) -> Array:
    """(n, n) root of the covariance of a force of unit size and a time constant.

    Parameters
    ----------
    colour_s : the time constant, s
    lag_s : (n, n) between the steps
    """
    return np.linalg.cholesky(np.exp(-lag_s / colour_s) + 1e-9 * np.eye(len(lag_s)))


__all__ = [
    "SMALLEST",
    "TIMES_S",
    "Forces",
    "Measured",
    "Noise",
    "RunNoise",
    "force_colour",
    "forced",
    "run_noise",
    "shown_covariance",
]
