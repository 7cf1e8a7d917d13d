"""Windows in which a line may have gone slack, from the taut-line residual alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from ...geometry.checks.bundle import half_sine
from ...simulate.model import Array
from ..effects import Effect, slack
from .data import TowRun

SLACK_Z = 8.0
"""A window counts as slack when the radius falls short by so many standard deviations: many are tried. A choice."""
LIKE_THE_MOST = 0.3
"""Windows below this share of the clearest one's significance are left out: a fit that lacks the slack line errs a little in all
runs."""
LEAST_BLOCKS = 10
"""Means that a run must have for it: a choice."""
SLACK_LENGTHS_S = (1.0, 2.0, 3.0, 4.5, 7.0)
"""Windows whose fit begins the search; it then finds the length itself ..."""
LONGEST_S = 10.0
"""... up to this ..."""
AS_LONG = 0.95
"""... and a line that is short for this share of it is not slack."""


def slack_effects(runs: Sequence[TowRun], residuals: Sequence[Array]) -> list[Effect]:
    """The most likely slack windows, from the taut line's residual alone: in the run that shows most, in the two, ... in all that
    show any.

    Parameters
    ----------
    runs : as the diagnosis sees them
    residuals : per run (n, 4), measured minus simulated by the fit without effects
    """
    found: list[Effect] = []
    for wave in (False, True):
        windows: list[tuple[float, float] | None] = []
        sure: list[float] = []
        for index, run in enumerate(runs):
            radius = residuals[index][:, 2]
            good = np.isfinite(radius)
            best = (0.0, 0.0, 0.0)
            if good.sum() >= LEAST_BLOCKS:
                rest = np.where(good, radius - np.nanmedian(radius), 0.0) / run.usual_sd(2)
                best = _slackest(run.centre_s, rest, 2 if wave else 1)
            sure.append(best[0])
            windows.append((best[1], best[2]))
        clear = max(SLACK_Z, LIKE_THE_MOST * max(sure))
        windows = [w if z > clear else None for w, z in zip(windows, sure, strict=True)]
        if not any(windows):
            continue
        order = sorted((i for i, w in enumerate(windows) if w is not None), key=lambda i: -sure[i])
        for count in range(1, len(order) + 1):
            found.append(slack([w if i in order[:count] else None for i, w in enumerate(windows)], wave))
    return found


def _slackest(t_s: Array, rest: Array, power: int) -> tuple[float, float, float]:
    """Significance, begin and end of the (squared) half sine by which ``rest`` falls short most."""

    def short(begin: float, length: float) -> float:
        shape = half_sine(t_s, begin, begin + max(length, 1e-3)) ** power
        size = np.linalg.norm(shape)
        return float(-(shape @ rest) / size) if size > 0 else 0.0

    grid = [(short(b, n), b, n) for n in SLACK_LENGTHS_S for b in np.arange(t_s[0], t_s[-1] - n, n / 5)]
    z, begin, length = max(grid, default=(0.0, 0.0, 1.0))
    if z > SLACK_Z:
        finer = minimize(
            lambda x: -short(x[0], x[1]),
            [begin, length],
            method="Nelder-Mead",
            bounds=[(t_s[0] - LONGEST_S, t_s[-1]), (SLACK_LENGTHS_S[0] / 2, LONGEST_S)],
            options={"xatol": 0.02, "fatol": 0.02},
        )
        z, (begin, length) = -float(finer.fun), finer.x
        if length > AS_LONG * LONGEST_S:
            return 0.0, 0.0, 0.0  # a radius that drifts
    return z, float(begin), float(begin + length)
