"""A camera that was turned between two runs, or during one: when, from the residuals of what holds no dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...simulate.model import Array
from ..effects import Effect
from ..effects.camera import SHIFT
from .data import TowRun

STEP_Z = 8.0
"""A step is looked at as a turned camera when it stands this many standard deviations out: many times are tried. A
choice."""
EDGE = 4
"""Blocks before or after a step."""
NEAR = 6
"""Blocks about a step that say when it was."""


def shift_effects(runs: Sequence[TowRun], residuals: Sequence[Array]) -> list[Effect]:
    """Turned before each run but the first, and where one run's line and marker distance show the clearest step.

    Parameters
    ----------
    runs : as the diagnosis sees them
    residuals : per run (n, 4), measured minus simulated by the fit without effects
    """
    if any(run.marks is None or SHIFT.needs(run.marks.run) for run in runs):
        return []
    names = [run.name for run in runs]
    found = [_since(names, k, 0.0) for k in range(1, len(runs))]
    steps = [(*_step(run, residuals[k]), k) for k, run in enumerate(runs)]
    clearest, time, where = max(steps)
    if clearest > STEP_Z:
        found.append(_since(names, where, time, runs[where].step_s))
    return found


def _since(names: Sequence[str], first: int, time_s: float, step_s: float = 1.0) -> Effect:
    def when(name: str, t_s: Array) -> Array:
        place = names.index(name)
        return _share(t_s, time_s, step_s) if time_s and place == first else np.full(len(t_s), float(place >= first))

    at = f", {time_s:.1f} s" if time_s else ""
    return replace(SHIFT, variant=f"from {names[first]}{at} on", when=when)


def _share(centre_s: Array, time_s: float, step_s: float) -> Array:
    """Share of each block that lies after a time."""
    return np.clip((centre_s + step_s / 2 - time_s) / step_s, 0.0, 1.0)


def _step(run: TowRun, residual: Array) -> tuple[float, float]:
    """Significance and time of the clearest step in line and marker distance together."""
    rests = []
    for channel in (2, 3):
        good = np.isfinite(residual[:, channel])
        if good.sum() >= 4 * EDGE:
            sd = run.usual_sd(channel)
            rests.append(np.where(good, residual[:, channel] - residual[good, channel].mean(), 0.0) / sd)
    if not rests:
        return 0.0, 0.0
    n, both, t_s = len(run.centre_s), np.array(rests), run.centre_s

    def shown(time_s: float, some: slice) -> float:
        share = _share(t_s[some], time_s, run.step_s)
        share, rest = share - share.mean(), both[:, some] - both[:, some].mean(axis=1, keepdims=True)
        return float(((rest @ share) ** 2).sum() / max(share @ share, 1e-9))

    squares = [shown(t_s[k] + run.step_s / 2, slice(None)) for k in range(EDGE, n - EDGE)]
    at = EDGE + int(np.argmax(squares))
    # what a turned camera does changes as the model moves: close by, it is a step, and within its block
    near = slice(max(at - NEAR, 0), at + NEAR + 1)
    times = [float(t_s[at]) + run.step_s * k / 20 for k in range(-10, 31)]
    return float(np.sqrt(max(squares))), max(times, key=lambda t: shown(t, near))


__all__ = ["shift_effects"]
