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
from .tow_data import TowRun
from .tow_model import OWN, Hypothesis

TIMES_S = (0.6, 2.0, 6.0)
FORCE_SD_N, MOMENT_SD_N_M = 0.01, 0.01
"""Usual sizes; their logarithms have the prior standard deviation LOG_SD about these."""
LOG_SD = 2.0
SMALLEST = 1e-5
KEPT = 12
"""Factors kept for each run."""


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
class RunNoise:
    """What does not change while the sizes are estimated.

    Attributes
    ----------
    measured : (2n, 2n) of y and beta
    by_force : per time constant, (2, 2n, 2n): covariance of y and beta by a unit side force and a unit moment
    still : per channel without hydrodynamics (line, distance), the inverse Cholesky factor (n, n), or None
    still_log : log determinant of those
    good : (n, 4)
    """

    measured: Array
    by_force: list[Array]
    still: list[Array | None]
    still_log: float
    good: Array


class Noise:
    """Noise of all runs about one hypothesis (its linear dynamics carry the forces).

    Parameters
    ----------
    runs, hypothesis : of the model
    speed_m_s : of the hypothesis's derivatives
    """

    def __init__(self, runs: Sequence[TowRun], hypothesis: Hypothesis, speed_m_s: float) -> None:
        self._roots: dict[tuple[int, Forces], tuple[Array, float]] = {}
        self._lock = Lock()
        self.runs = [
            _run_noise(run, hypothesis.six, own, speed_m_s) for run, own in zip(runs, hypothesis.own, strict=True)
        ]

    def _root(self, index: int, forces: Forces) -> tuple[Array, float]:
        """Cholesky factor of y and beta, and the log determinant of all channels; the last few are kept."""
        key = (index, forces)
        known = self._roots.get(key)
        if known is not None:
            return known
        noise = self.runs[index]
        total = noise.measured + forces.side_n**2 * noise.by_force[forces.time][0]
        total = total + forces.moment_n_m**2 * noise.by_force[forces.time][1]
        lower = np.linalg.cholesky(total)
        made = lower, 2 * float(np.log(np.diag(lower)).sum()) + noise.still_log
        with self._lock:
            while len(self._roots) >= KEPT * len(self.runs):
                self._roots.pop(next(iter(self._roots)))
            self._roots[key] = made
        return made

    def whitened(self, index: int, forces: Forces, values: Sequence[Array]) -> tuple[list[Array], float]:
        """Arrays (n, 4) or (n, 4, k) of a run as white numbers (N,) or (N, k), and the log determinant of the covariance."""
        noise = self.runs[index]
        n = len(noise.good)
        lower, log = self._root(index, forces)
        answers = []
        for value in values:
            flat = np.where(noise.good[..., None], value.reshape(n, 4, -1), 0.0)
            parts = [solve_triangular(lower, np.concatenate([flat[:, 0], flat[:, 1]]), lower=True, check_finite=False)]
            for channel, root in zip((2, 3), noise.still, strict=True):
                if root is not None:
                    parts.append(root @ flat[:, channel])
            answers.append(np.concatenate(parts).reshape(-1, *value.shape[2:]))
        return answers, log


def _run_noise(run: TowRun, six: Array, own: Array, speed_m_s: float) -> RunNoise:
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
    still: list[Array | None] = []
    log = 0.0
    for channel in (2, 3):
        if not good[:, channel].any():
            still.append(None)
            continue
        lower = np.linalg.cholesky(covariance[channel])
        log += 2 * float(np.log(np.diag(lower)).sum())
        still.append(solve_triangular(lower, np.eye(n), lower=True))
    return RunNoise(measured, _by_force(run, six, own, speed_m_s, good), still, log, good)


def _by_force(run: TowRun, six: Array, own: Array, speed_m_s: float, good: Array) -> list[Array]:
    """Covariance of y and beta by unit forces, for every time constant."""
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
    answers = []
    lowers = [[toeplitz(response[:, o, i], np.zeros(n)) for i in range(2)] for o in range(2)]
    keep = np.concatenate([good[:, 0], good[:, 1]]).astype(float)
    for time in TIMES_S:
        colour = np.linalg.cholesky(np.exp(-lag / time) + 1e-9 * np.eye(n))
        pair = []
        for i in range(2):
            root = np.concatenate([lowers[0][i] @ colour, lowers[1][i] @ colour]) * keep[:, None]
            pair.append(root @ root.T)
        answers.append(np.array(pair))
    return answers
