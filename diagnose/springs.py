"""A bounce on a soft line, from the taut-line residual alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

from ..simulate.model import Array
from .effects import Effect
from .effects.line import Ring, springing
from .tow_data import TowRun

if TYPE_CHECKING:
    from .inference import Fitted

LEAST_BLOCKS = 20
RATES_HZ = (0.12, 0.45)
"""Of the blocks' own rate: slower is the swing itself, faster is not seen."""
DECAYS_S = (0.02, 0.08, 0.3)
CLEAR = 60.0
"""What a bounce in all runs must explain of the whitened square, beside two numbers a run."""


def springing_effects(runs: Sequence[TowRun], base: Fitted) -> list[Effect]:
    """The bounce that explains most of the taut line's residual, or none."""
    rests = [_rest(run, base.linear.rows[i][0][:, 2]) for i, run in enumerate(runs)]
    if any(rest is None for rest in rests):
        return []
    whole = [rest for rest in rests if rest is not None]
    step = runs[0].step_s
    rates = 2 * np.pi * np.arange(RATES_HZ[0], RATES_HZ[1], step / (2 * max(len(r) * step for r in whole))) / step
    grid = [
        (sum(_ring(run.centre_s, rest, decay, rate)[0] for run, rest in zip(runs, whole, strict=True)), decay, rate)
        for decay in DECAYS_S
        for rate in rates
    ]
    gain, decay, rate = max(grid)
    if gain < CLEAR + 2 * len(runs):
        return []
    rings = []
    for run, rest in zip(runs, whole, strict=True):
        end = minimize(
            lambda x, t=run.centre_s, rest=rest: -_ring(t, rest, abs(x[0]), x[1])[0],
            [decay, rate],
            method="Nelder-Mead",
            options={
                "xatol": 1e-4,
                "fatol": 0.01,
                "initial_simplex": [[decay, rate], [2 * decay, rate], [decay, 1.02 * rate]],
            },
        )
        own_decay, own_rate = abs(float(end.x[0])), float(end.x[1])
        size = _ring(run.centre_s, rest, own_decay, own_rate)[1] * _sd(run)
        # a mean over a block flattens what comes and goes within it
        flat = float(np.sinc(own_rate * step / (2 * np.pi)))
        rings.append(Ring(size / flat, own_decay, own_rate))
    return [springing(rings)]


def _sd(run: TowRun) -> float:
    return float(np.sqrt(np.median(np.diag(run.covariance[2]))))


def _rest(run: TowRun, radius: Array) -> Array | None:
    good = np.isfinite(radius)
    if good.sum() < LEAST_BLOCKS:
        return None
    return np.where(good, radius - np.nanmedian(radius), 0.0) / _sd(run)


def _ring(t_s: Array, rest: Array, decay_s: float, rate_rad_s: float) -> tuple[float, complex]:
    """Squares that a bounce explains beside a constant and a trend, and its size."""
    left, angle = np.exp(-decay_s * t_s), rate_rad_s * t_s
    columns = np.column_stack([np.ones_like(t_s), t_s - t_s.mean(), left * np.cos(angle), left * np.sin(angle)])
    plain = columns[:, :2]
    before = rest - plain @ np.linalg.lstsq(plain, rest, rcond=None)[0]
    numbers = np.linalg.lstsq(columns, rest, rcond=None)[0]
    after = rest - columns @ numbers
    return float(before @ before - after @ after), complex(float(numbers[2]), -float(numbers[3]))


__all__ = ["springing_effects"]
