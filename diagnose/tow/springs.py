"""A bounce on a soft line, from the taut-line residual alone: one that dies away, or whatever course it takes.

The taut line's radius holds no hydrodynamics: what it does faster than the swing is the line's own. One ring a run says it with
four numbers; a line that is plucked again and again, or goes slack at times, needs its whole course within a band of frequencies.
Numbers found so are paid for: half the logarithm of what the residual holds over its noise for each size, and for a ring's rate and
decay how many of them could be told apart in what was searched (in noise, too, one of them fits best).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from ...simulate.model import Array
from ..effects import Effect
from ..effects.line import ELASTIC
from ..effects.slack_line import springing
from .courses import by_run
from .tow_run import TowRun

LINE = 2
"""The channel."""
LEAST_BLOCKS = 20
"""Means that a run must have for it: a choice."""
RATES_HZ = (0.12, 0.45)
"""Of the blocks' own rate: slower is the swing itself, faster is not seen."""
BAND_HZ = (0.25, 0.45)
"""Of a whole course: from this frequency to this share of the blocks' rate."""
DECAYS_S = (0.02, 0.08, 0.3)
"""Decay rates, 1/s, that are tried."""
CLEAR = 30.0
"""What a bounce in all runs must explain of the whitened square, beside two numbers a run."""
COURSE_FORM = 0.003
"""Of a whole course: what its own freedom did not take was not its form's fault."""
LIKE = 1.25
"""Within this factor of the campaign's rate a run may have its own: other tow points and lines."""
FINER = 8
"""Samples of a course to a block."""


@dataclass(frozen=True)
class Ring:
    """A bounce that dies away in one run; its beginning is the run's.

    Attributes
    ----------
    size_m : half of its height, complex for its phase
    decay_s : 1/s
    rate_rad_s : of the bounce
    """

    size_m: complex
    decay_s: float
    rate_rad_s: float


def springing_effects(runs: Sequence[TowRun], residuals: Sequence[Array]) -> list[Effect]:
    """The ring and the course that explain most of the taut line's residual; none where there is only noise.

    Parameters
    ----------
    runs : as the diagnosis sees them
    residuals : per run (n, 4), measured minus simulated by the fit without effects
    """
    rests = [run.off_middle(residuals[i][:, LINE], LEAST_BLOCKS) for i, run in enumerate(runs)]
    whole = [rest for rest in rests if rest is not None]
    if len(whole) < len(runs):
        return []
    return [*_rings(runs, whole), *_courses(runs, whole)]


def _rings(runs: Sequence[TowRun], rests: Sequence[Array]) -> list[Effect]:
    step = runs[0].step_s
    longest = max(len(r) * step for r in rests)
    rates = 2 * np.pi * np.arange(RATES_HZ[0], RATES_HZ[1], step / (2 * longest)) / step
    grid = [
        (sum(ring_fit(run.centre_s, rest, decay, rate)[0] for run, rest in zip(runs, rests, strict=True)), decay, rate)
        for decay in DECAYS_S
        for rate in rates
    ]
    gain, decay, rate = max(grid)
    if gain < CLEAR + 2 * len(runs):
        return []
    rings, cost = [], float(np.log(np.log(RATES_HZ[1] / RATES_HZ[0]) / (2 * np.log(LIKE))))
    for run, rest in zip(runs, rests, strict=True):
        end = minimize(
            lambda x, t=run.centre_s, rest=rest: -ring_fit(t, rest, abs(x[0]), x[1])[0],
            [decay, rate],
            method="Nelder-Mead",
            options={
                "xatol": 1e-4,
                "fatol": 0.01,
                "initial_simplex": [[decay, rate], [2 * decay, rate], [decay, 1.02 * rate]],
            },
        )
        own_decay, own_rate = abs(float(end.x[0])), float(end.x[1])
        if not rate / LIKE <= own_rate <= LIKE * rate:
            own_decay, own_rate = decay, rate  # one line and one model: where a run shows little, the others say
        explained, size = ring_fit(run.centre_s, rest, own_decay, own_rate)
        # a mean over a block flattens what comes and goes within it
        flat = float(np.sinc(own_rate * step / (2 * np.pi)))
        rings.append(Ring(size * run.usual_sd(LINE) / flat, own_decay, own_rate))
        cost += _searched(run.centre_s, max(explained, 0.0), own_decay, (LIKE - 1 / LIKE) * rate)
    sizes, decays, angular = (np.array([[getattr(r, k)] for r in rings]) for k in ("size_m", "decay_s", "rate_rad_s"))

    def bounce(t_s: Any) -> Array:
        return np.exp(-decays * t_s) * np.real(sizes * np.exp(1j * angular * t_s))

    heard = ", ".join(f"{r.rate_rad_s / (2 * np.pi):.2f}" for r in rings)
    return [springing(bounce, f"springs at {heard} Hz", cost, ELASTIC.form)]


def _searched(t_s: Array, explained: float, decay_s: float, rates_rad_s: float) -> float:
    """What a ring's four numbers cost: its size and phase, and how many rates and decays of those searched can be told apart."""
    weight = np.exp(-2 * decay_s * t_s)
    middle = np.average(t_s, weights=weight)
    # one over what rate and decay are known to (Cramer and Rao), and over the width of a normal density
    told_s = np.sqrt(explained * np.average((t_s - middle) ** 2, weights=weight) / (2 * np.pi))
    return float(np.log1p(explained / 2) + np.log1p(rates_rad_s * told_s) + np.log1p(DECAYS_S[-1] * told_s))


def _courses(runs: Sequence[TowRun], rests: Sequence[Array]) -> list[Effect]:
    step, high = runs[0].step_s, BAND_HZ[1] / runs[0].step_s
    splines, cost, explained, numbers = [], 0.0, 0.0, 0.0
    for run, rest in zip(runs, rests, strict=True):
        n = len(rest)
        # mirrored at both ends, so that the course does not begin or end with a jump
        turned = np.concatenate([rest, rest[::-1]])
        hertz = np.fft.rfftfreq(2 * n, step)
        inside = (hertz > BAND_HZ[0]) & (hertz < high)
        waves = np.where(inside, np.fft.rfft(turned), 0.0)
        own = float((np.fft.irfft(waves, 2 * n)[:n] ** 2).sum())
        free = max(2 * n * step * (high - BAND_HZ[0]), 1.0)
        cost += 0.5 * free * float(np.log1p(own / free))
        explained, numbers = explained + own, numbers + free
        finer = np.zeros(n * FINER + 1, dtype=complex)
        finer[: len(waves)] = waves / np.where(inside, np.sinc(hertz * step), 1.0)
        # the finer samples begin half a block before the first block's middle, less half of their own step
        values = run.usual_sd(LINE) * FINER * np.fft.irfft(finer, 2 * n * FINER)[: n * FINER]
        splines.append(CubicSpline(run.centre_s[0] + step * np.arange(n * FINER) / FINER, values))
    if explained < CLEAR + 3 * numbers:
        return []
    bounce = by_run([partial(_within, spline) for spline in splines])
    return [springing(bounce, "bounces as its radius shows", cost, COURSE_FORM)]


def _within(spline: CubicSpline, t_s: Array) -> Array:
    return spline(np.clip(t_s, spline.x[0], spline.x[-1]))


def ring_fit(t_s: Array, rest: Array, decay_s: float, rate_rad_s: float) -> tuple[float, complex]:
    """Fit a decaying oscillation beside a constant and a trend.

    Parameters
    ----------
    t_s, rest : (n,) times and what is fitted
    decay_s, rate_rad_s : decay rate, 1/s, and angular frequency of the oscillation

    Returns
    -------
    explained : sum of squares that the oscillation removes beyond constant and trend
    size : complex amplitude; the oscillation is the real part of size exp((-decay_s + i rate_rad_s) t_s)
    """
    left, angle = np.exp(-decay_s * t_s), rate_rad_s * t_s
    waves = left * np.array([np.cos(angle), np.sin(angle)])
    # what constant and trend, which are at right angles, do not hold
    plain = np.array([np.ones_like(t_s), t_s - t_s.mean()])
    plain /= np.linalg.norm(plain, axis=1)[:, None]
    waves = waves - (waves @ plain.T) @ plain
    right = waves @ rest
    numbers = np.linalg.lstsq(waves @ waves.T, right, rcond=None)[0]
    return float(right @ numbers), complex(float(numbers[0]), -float(numbers[1]))


__all__ = ["springing_effects"]
