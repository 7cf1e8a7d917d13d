"""How slow random forces on the hull move a towed model: the noise of its runs about a hypothesis's motion."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ...simulate.model import Array
from ..inference.noise import TIMES_S, Measured, Noise, RunNoise, force_colour, run_noise
from .channels import PULL
from .tow_run import TowRun

MOVING = (0, 1)
"""Channels that forces move: y and heading, and what a line pulls with where a load cell says it. Something left over is searched
in the first two alone: a line that rings after the release shows in the third."""


def moved_channels(run: TowRun) -> tuple[int, ...]:
    """Those of a run."""
    return (*MOVING, PULL) if run.celled else MOVING


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
            found[key] = run_noise(good, run.covariance, moved_channels(run), run.cross)
        answer.append(found[key])
    return answer


def tow_noise(runs: Sequence[TowRun], pushed: Sequence[Array], measured: Sequence[RunNoise] | None = None) -> Noise:
    """Measurement noise of the runs, and random side forces and moments.

    Parameters
    ----------
    runs : as the diagnosis sees them
    pushed : how they answer forces, of ``TowModel.pushed``
    measured : of ``measured_noise``, where it is known already
    """
    return Noise(
        [
            Measured(
                np.isfinite(run.values),
                run.covariance,
                moved_channels(run),
                partial(_roots, run, answer),
                run.cross,
                len(MOVING),
            )
            for run, answer in zip(runs, pushed, strict=True)
        ],
        measured_noise(runs) if measured is None else measured,
    )


def _roots(run: TowRun, pushed: Array, time: int) -> list[Array]:
    good = np.isfinite(run.values)
    n, moved = len(good), moved_channels(run)
    keep = np.concatenate([good[:, c] for c in moved])[:, None]
    lag = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :]) * run.step_s
    colour = force_colour(TIMES_S[time], lag)
    # an answer that grows beyond bounds is a motion's that is refused anyway
    answers = np.nan_to_num(pushed).transpose(2, 1, 0, 3).reshape(2, len(moved) * n, n)
    return [keep * (answer @ colour) for answer in answers]


__all__ = ["measured_noise", "moved_channels", "tow_noise"]
