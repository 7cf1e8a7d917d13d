"""How slow random forces on the hull move a towed model: the noise of its runs about a hypothesis's linear dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from ...simulate.model import Array, Hull, linear_system
from ..inference.hypothesis import Hypothesis
from ..inference.noise import TIMES_S, Measured, Noise, Roots, RunNoise, forced, run_noise
from .data import TowRun
from .numbers import SIX
from .rates import OWN

MOVING = 2
"""Channels that forces move: y and heading."""
SMALLEST_N = 1e-3
"""A tension below this is taken as this: the linear form of a tow needs one."""


def measured_noise(runs: Sequence[TowRun]) -> list[RunNoise]:
    """What no hypothesis changes of the runs' noise; of runs that were measured alike (designs of one pattern) it is made once.

    Parameters
    ----------
    runs : as the diagnosis sees them
    """
    found: dict[tuple[int, bytes], RunNoise] = {}
    answer = []
    for run in runs:
        good = np.isfinite(run.values)
        key = (id(run.covariance), good.tobytes())
        if key not in found:
            found[key] = run_noise(good, run.covariance, MOVING)
        answer.append(found[key])
    return answer


def tow_noise(
    runs: Sequence[TowRun], hypothesis: Hypothesis, speed_m_s: float, measured: Sequence[RunNoise] | None = None
) -> Noise:
    """Measurement noise of the runs, and random side forces and moments.

    Parameters
    ----------
    runs : as the diagnosis sees them
    hypothesis : with its numbers
    speed_m_s : of the hypothesis's derivatives
    measured : of ``measured_noise``, where it is known already
    """
    six = hypothesis.shared[: len(SIX)]
    return Noise(
        [
            Measured(np.isfinite(run.values), run.covariance, MOVING, _roots(run, six, own, speed_m_s))
            for run, own in zip(runs, hypothesis.own, strict=True)
        ],
        measured_noise(runs) if measured is None else measured,
    )


def _roots(run: TowRun, six: Array, own: Array, speed_m_s: float) -> Roots:
    def roots(time: int) -> list[Array]:
        lag = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :]) * run.step_s
        good = np.isfinite(run.values)
        keep = np.concatenate([good[:, 0], good[:, 1]]).astype(float)
        answer = response()
        return [forced(answer[:, :, i], TIMES_S[time], lag) * keep[:, None] for i in range(2)]

    n = len(run.values)

    def response() -> Array:
        """(n, 2 outputs, 2 inputs): means of y and beta over the blocks after a unit force that lasts one block."""
        numbers, tow = dict(zip(OWN, own, strict=True)), run.data.tow
        tow = type(tow)(numbers["speed"], numbers["line"], numbers["tow_point"], max(numbers["tension"], SMALLEST_N))
        matrix, _ = linear_system(Hull(*six, speed_m_s=speed_m_s).at_speed(tow.speed_m_s), tow)
        inputs = np.zeros((4, 2))
        inputs[2, 0], inputs[3, 1] = 1 / six[0], 1 / six[1]
        whole = expm(np.block([[matrix, inputs], [np.zeros((2, 6))]]) * run.step_s)
        go, state = whole[:4, :4], whole[:4, 4:]
        before, means = np.zeros_like(state), []
        for _ in range(n):
            means.append((before + state)[:2] / 2)
            before, state = state, go @ state
        return np.array(means)

    return roots


__all__ = ["measured_noise", "tow_noise"]
