"""The noise of a campaign: what the measurement adds, and slow forces on the hull that no simulator knows.

The measurement's part comes from static records and stated sigmas (``tow_data``). The forces are first-order
(Ornstein-Uhlenbeck) processes in sway and yaw; their sizes and time constant are estimated with each hypothesis, by
restricted likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np
from scipy.linalg import expm, solve_triangular, toeplitz

from ..simulate.model import Array, Hull, linear_system
from .hypothesis import Hypothesis
from .tow_data import TowRun
from .tow_rates import OWN

TIMES_S = (0.6, 2.0, 6.0)
FORCE_SD_N, MOMENT_SD_N_M = 0.01, 0.01
"""Usual sizes; their logarithms have the prior standard deviation LOG_SD about these."""
LOG_SD = 2.0
SMALLEST = 1e-5
UNSEEN = 1e-3
"""Of the measurement's variance: where forces show less, they are left out."""


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

    @property
    def log_prior(self) -> float:
        """Log density of the sizes."""
        logs = np.log([self.side_n / FORCE_SD_N, self.moment_n_m / MOMENT_SD_N_M])
        return float(-0.5 * (logs @ logs) / LOG_SD**2)


@dataclass(frozen=True)
class Space:
    """Where forces of one time constant show beside a run's measurement noise.

    Attributes
    ----------
    base : (2n, 2n), orthonormal, in whitened y and beta; the directions that forces move most come first
    by_force : (2, 2n, 2n), covariance there by a unit side force and a unit moment
    shown : (2n,), variance by both, falling
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
        total = forces.side_n**2 * self.by_force[0, :k, :k] + forces.moment_n_m**2 * self.by_force[1, :k, :k]
        total[np.diag_indices(k)] += 1.0
        return total


@dataclass(frozen=True)
class RunNoise:
    """What does not change while the sizes are estimated.

    Attributes
    ----------
    measured : (2n, 2n) of y and beta
    white : inverse Cholesky factor of it
    still : per channel without hydrodynamics (line, distance), the inverse Cholesky factor (n, n), or None
    log : log determinant of all that is measured
    good : (n, 4)
    """

    measured: Array
    white: Array
    still: list[Array | None]
    log: float
    good: Array


class Noise:
    """Noise of all runs about one hypothesis (its linear dynamics carry the forces).

    Forces move a model slowly: beside the measurement's noise small ones show in a part of the 260 directions, and trying other
    sizes costs that much only.

    Parameters
    ----------
    runs, hypothesis : of the model
    speed_m_s : of the hypothesis's derivatives
    """

    def __init__(self, runs: Sequence[TowRun], hypothesis: Hypothesis, speed_m_s: float) -> None:
        self.runs = [_run_noise(run) for run in runs]
        self._tows = list(zip(runs, hypothesis.own, strict=True))
        self._six, self._speed_m_s = hypothesis.six, speed_m_s
        self._spaces: dict[tuple[int, int], Space] = {}
        self._lock = Lock()

    def by_force(self, index: int, time: int) -> Array:
        """(2, 2n, 2n): covariance of a run's y and beta by a unit side force and a unit moment."""
        run, own = self._tows[index]
        return np.array([r @ r.T for r in _roots(run, self._six, own, self._speed_m_s, self.runs[index].good, time)])

    def space(self, index: int, time: int) -> Space:
        """Where forces of TIMES_S[time] show in a run."""
        with self._lock:
            if (index, time) not in self._spaces:
                run, own = self._tows[index]
                roots = _roots(run, self._six, own, self._speed_m_s, self.runs[index].good, time)
                self._spaces[index, time] = _space(self.runs[index].white, roots)
            return self._spaces[index, time]

    def white(self, index: int, values: Array) -> tuple[Array, Array]:
        """(n, 4, k) beside the measurement's noise alone: y and beta (2n, k), and the other channels (m, k)."""
        noise = self.runs[index]
        flat = np.where(noise.good[..., None], values, 0.0)
        still = [root @ flat[:, c] for c, root in zip((2, 3), noise.still, strict=True) if root is not None]
        moving = noise.white @ np.concatenate([flat[:, 0], flat[:, 1]])
        return moving, np.concatenate(still) if still else np.zeros((0, values.shape[2]))

    def whitened(self, index: int, forces: Forces, values: Sequence[Array]) -> list[Array]:
        """Arrays (n, 4) or (n, 4, k) of a run as white numbers (N,) or (N, k)."""
        space = self.space(index, forces.time)
        size, turn = np.linalg.eigh(space.covariance(forces))
        shrink, base = (turn * (size**-0.5 - 1)) @ turn.T, space.base[:, : len(size)]
        answers = []
        for value in values:
            moving, still = self.white(index, value.reshape(*value.shape[:2], -1))
            moving = moving + base @ (shrink @ (base.T @ moving))
            answers.append(np.concatenate([moving, still]).reshape(-1, *value.shape[2:]))
        return answers


def _space(white: Array, roots: Sequence[Array]) -> Space:
    shown = [white @ root for root in roots]
    both = np.concatenate(shown, axis=1)
    size, turn = np.linalg.eigh(both @ both.T)
    base = np.ascontiguousarray(turn[:, ::-1])
    return Space(base, np.array([part @ part.T for part in (base.T @ root for root in shown)]), size[::-1])


def _run_noise(run: TowRun) -> RunNoise:
    good = np.isfinite(run.values)
    n = len(good)
    covariance = run.covariance.copy()
    for channel in range(4):
        lost = ~good[:, channel]
        covariance[channel][np.ix_(lost, np.arange(n))] = 0.0
        covariance[channel][np.ix_(np.arange(n), lost)] = 0.0
        usual = float(np.diag(covariance[channel]).max()) or 1.0
        covariance[channel][lost, lost] = usual
    measured = np.zeros((2 * n, 2 * n))
    measured[:n, :n], measured[n:, n:] = covariance[0], covariance[1]
    white, log = _inverse_root(measured)
    still: list[Array | None] = []
    for channel in (2, 3):
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


def _roots(run: TowRun, six: Array, own: Array, speed_m_s: float, good: Array, time: int) -> list[Array]:
    """(2n, n) roots of the covariance of y and beta by a unit side force and a unit moment."""
    n, step = len(good), run.step_s
    numbers = dict(zip(OWN, own, strict=True))
    tow = run.data.tow
    tow = type(tow)(numbers["speed"], numbers["line"], numbers["tow_point"], max(numbers["tension"], 1e-3))
    matrix, _ = linear_system(Hull(*six, speed_m_s=speed_m_s).at_speed(tow.speed_m_s), tow)
    inputs = np.zeros((4, 2))
    inputs[2, 0], inputs[3, 1] = 1 / six[0], 1 / six[1]
    whole = expm(np.block([[matrix, inputs], [np.zeros((2, 6))]]) * step)
    go, push = whole[:4, :4], whole[:4, 4:]
    state, columns = push, []
    for k in range(n):
        before = np.zeros_like(push) if k == 0 else columns[-1][1]
        columns.append(((before + state)[:2] / 2, state))
        state = go @ state
    response = np.array([c[0] for c in columns])  # (n, 2 outputs, 2 inputs)
    lag = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :]) * step
    lowers = [[toeplitz(response[:, o, i], np.zeros(n)) for i in range(2)] for o in range(2)]
    keep = np.concatenate([good[:, 0], good[:, 1]]).astype(float)
    colour = np.linalg.cholesky(np.exp(-lag / TIMES_S[time]) + 1e-9 * np.eye(n))
    return [np.concatenate([lowers[0][i] @ colour, lowers[1][i] @ colour]) * keep[:, None] for i in range(2)]
