"""Something left over that the noise does not have: bursts in one run, lines and narrow bands in all, numbers each run's own.

Free forms (``unknown``) stand for forces and faults that follow the motion. A push at one time, a slosh at its own frequency, a
carriage that sticks for a second follow nothing. After whitening, noise has unit variance in every stretch of time and every band
of frequencies; a narrow one that has several times that holds something else. Narrow ones only: a noise model that is a little off
everywhere must not alarm. What follows the motion stands out in neither, but asks for other numbers in every run (``disagree``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array
from .disagree import disagreement
from .evidence import Fitted, Inference

LENGTHS = (3, 6, 12)
"""Blocks of a burst."""
BANDS = (1, 3)
"""Frequencies of a band."""
COST = 4.0
"""Of log evidence: a variance is not known before, but fitted where it stands out most, and no noise model is exact. In 300
simulated campaigns without any effect, half of them with coloured noise, what stands out most reaches 3.6 in one of a hundred, and
5.4 at most, before this is taken off.
"""
KINDS = 3
"""Something may be left over at a time, at a frequency, or in the numbers of each run: of its prior each has a share."""


@dataclass(frozen=True)
class Leftover:
    """The stretch of time or frequency that stands out most, or that the runs disagree.

    Attributes
    ----------
    log_evidence : that its variance is larger (at its best), against one everywhere; what looking everywhere and
        fitting costs is taken off. Or that the runs have numbers of their own
    run : name, or "" for all; where they disagree: the one that does most
    span_s, band_hz : where, the other one empty
    disagree : whether it is that
    """

    log_evidence: float
    run: str = ""
    span_s: tuple[float, ...] = ()
    band_hz: tuple[float, ...] = ()
    disagree: bool = False


def leftover(inference: Inference, fitted: Fitted) -> Leftover:
    """Look at what a hypothesis leaves.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    step, rest = inference.simulator.step_s, _rest(inference, fitted)
    names = [run.name for run in inference.simulator.runs]
    tiles = (*_bursts(rest, names, step), *_bands(rest, step))
    most = max(tiles, key=lambda found: found.log_evidence, default=Leftover(0.0))
    found = replace(most, log_evidence=most.log_evidence - COST)
    apart = disagreement(inference, fitted)
    if not apart.count:
        return found
    return max(
        found,
        Leftover(apart.log_evidence - np.log(KINDS), names[int(np.argmax(apart.by_run))], disagree=True),
        key=lambda one: one.log_evidence,
    )


def standing_out(inference: Inference, fitted: Fitted) -> list[float]:
    """Frequencies at which what a hypothesis leaves has its peaks, Hz, the highest first.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    frequency, power, _ = _spectrum(_rest(inference, fitted), inference.simulator.step_s)
    inside = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    return [float(frequency[k]) for k in sorted(inside, key=lambda k: -power[k])]


def _rest(inference: Inference, fitted: Fitted) -> list[Array]:
    """Per run (n, channels), whitened, of the moving channels that are searched."""
    solved, rest = fitted.solved, []
    for index, run in enumerate(inference.simulator.runs):
        left = inference.left(fitted.linear, fitted.forces, solved.shared, solved.own[index], index)
        measured = inference.noise.measured[index]
        moving = list(measured.moving[: measured.scanned])
        good = np.isfinite(run.values[:, moving])
        rest.append(np.where(good, left[: good.size].reshape(len(moving), -1).T, 0.0))
    return rest


def _bursts(rest: Sequence[Array], names: Sequence[str], step_s: float) -> list[Leftover]:
    tiles = sum(max(len(r) - length + 1, 0) for r in rest for length in LENGTHS)
    found = []
    for values, name in zip(rest, names, strict=True):
        power = np.concatenate([[0.0], np.cumsum((values**2).sum(axis=1))])
        for length in LENGTHS:
            if len(values) < length:
                continue
            sums = power[length:] - power[:-length]
            at = int(np.argmax(sums))
            evidence = _larger(float(sums[at]), length * values.shape[1]) - float(np.log(tiles))
            found.append(Leftover(evidence, name, (at * step_s, (at + length) * step_s)))
    return found


def _bands(rest: Sequence[Array], step_s: float) -> list[Leftover]:
    frequency, sums, numbers = _spectrum(rest, step_s)
    count, found = len(frequency), []
    for width in BANDS:
        if width > count:
            continue
        both = np.convolve(sums, np.ones(width), "valid")
        at = int(np.argmax(both))
        evidence = _larger(float(both[at]), width * numbers) - float(np.log(len(BANDS) * count))
        found.append(Leftover(evidence, "", (), (float(frequency[at]), float(frequency[at + width - 1]))))
    return found


def _spectrum(rest: Sequence[Array], step_s: float) -> tuple[Array, Array, int]:
    """Frequencies Hz, power of all runs and channels, and of how many squares each is the sum."""
    longest = max(len(r) for r in rest)
    count = max(longest // 2 - 1, 0)
    sums, numbers = np.zeros(count), 0
    frequency = np.arange(1, count + 1) / (longest * step_s)
    for values in rest:
        t_s = np.arange(len(values)) * step_s
        wave = np.exp(-2j * np.pi * frequency[:, None] * t_s)
        sums += (np.abs(wave @ values) ** 2).sum(axis=1) * 2 / len(values)
        numbers += 2 * values.shape[1]
    return frequency, sums, numbers


def _larger(total: float, count: int) -> float:
    """Log likelihood ratio of a larger variance at its best against 1, for a sum of ``count`` squares."""
    ratio = total / count
    return float(0.5 * count * (ratio - 1 - np.log(ratio))) if ratio > 1 else 0.0


__all__ = ["Leftover", "leftover", "standing_out"]
