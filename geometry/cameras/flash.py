"""A flash that two cameras saw: the second one's clock by its light, and that against the clock by the motion.

A flash is light between two moments, as bright all the while. A frame gets of it what falls into its exposure: its share tells
where in the exposure the light began or ended. What cannot be told, as within a frame that got all of it or between two exposures,
is as likely here as there: offset and standard deviation are those of the whole posterior, on a grid, of begin and the length's
logarithm flat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..camera import Array
from .clock import Clock
from .match import Known

GAIN_SHARE = 0.05
"""A frame's rise is right to this share of itself: a camera's curve is not straight. A choice; linear cameras do better."""
FINE = 96
"""Steps of the grid in a frame, of begins and lengths. Two cameras tell a flash's length together to less than a millisecond: where
its steps were wider than that (24 in a frame) the posterior stood on one of them, and was too narrow by a third."""
EXPOSURES = (0.05, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
"""Of a frame's time that an exposure which nobody states may take, each as likely."""
ROUNDING = 1e-12
"""Of a square that is a difference of squares: less is nothing."""
NEAR_S = 0.25
"""Flashes of both cameras that lie closer by the motion's clock, and by what it leaves open, are taken for one: no two follow one
another so soon by hand."""
AGREE_SD = 3.0
"""Standard deviations by which flash and motion may differ."""


@dataclass(frozen=True)
class Lit:
    """A flash as one camera saw it.

    Attributes
    ----------
    t_s : (k,) its frames and one dark one on either side, on the camera's clock, the middles of their exposures
    rise : (k,) how much brighter than before and after each is, in any unit
    noise : standard deviation of that where it is dark
    step_s : from frame to frame
    exposure_s : of a frame; 0: not known
    """

    t_s: Array
    rise: Array
    noise: float
    step_s: float
    exposure_s: float

    @property
    def middle_s(self) -> float:
        """About when it was: the rises' centre."""
        return float(np.average(self.t_s, weights=np.maximum(self.rise, 0.0)))


@dataclass(frozen=True)
class Tie:
    """What flashes say of the second camera's clock.

    Attributes
    ----------
    known : its offset at a moment of its clock
    flashes : so many that both saw
    by_motion : offset and standard deviation at that moment by the motion alone; None: the motion does not tell it
    """

    known: Known
    flashes: int
    by_motion: tuple[float, float] | None

    @property
    def apart_sd(self) -> float:
        """Difference of the two over its standard deviation; 0 without the motion's."""
        if self.by_motion is None:
            return 0.0
        return abs(self.known.offset_s - self.by_motion[0]) / float(np.hypot(self.known.sd_s, self.by_motion[1]))

    @property
    def agrees(self) -> bool:
        """It does not contradict the motion; where it does, it is not used."""
        return self.apart_sd <= AGREE_SD


def flash_offset(first: Lit, second: Lit) -> tuple[float, float]:
    """What the first clock shows when the second one shows 0, by one flash, and its standard deviation, s.

    Parameters
    ----------
    first, second : of the two cameras
    """
    fine = min(first.step_s, second.step_s) / FINE
    spans = [lit.t_s[-1] - lit.t_s[0] + lit.step_s for lit in (first, second)]
    steps = np.arange(1, max(int(min(spans) / fine), 2))
    (first_s, one), (second_s, other) = (_likely(lit, steps, fine) for lit in (first, second))
    # entry j is begin_first - begin_second = (j - (n_second - 1)) steps, from the grids' own beginnings, summed over all lengths:
    # a tube's millisecond is as likely as a hand's tenth of a second, lengths are flat in their logarithm
    count = one.shape[1] + other.shape[1] - 1
    waves = np.fft.rfft(one / steps[:, None], count, axis=1) * np.fft.rfft(other[:, ::-1], count, axis=1)
    total = np.maximum(np.fft.irfft(waves.sum(axis=0), count), 0.0)
    total /= total.sum()
    shift = first_s - second_s + (np.arange(count) - (other.shape[1] - 1)) * fine
    mean = float(total @ shift)
    return mean, float(np.sqrt(total @ (shift - mean) ** 2 + fine**2 / 12))


def _likely(lit: Lit, steps: Array, fine: float) -> tuple[float, Array]:
    """(first begin on the grid, likelihood (lengths, begins)) of lengths of so many ``steps`` of the grid; how bright it was is
    whatever fits best."""
    begin_s = float(lit.t_s[0] - lit.step_s / 2)
    many = round((lit.t_s[-1] - lit.t_s[0] + lit.step_s) / fine)
    grid = begin_s + np.arange(many + int(steps[-1])) * fine
    begins = np.arange(many)
    ends = begins[None, :] + steps[:, None]
    weight = 1 / (lit.noise**2 + (GAIN_SHARE * lit.rise) ** 2)
    exposures = (lit.exposure_s,) if lit.exposure_s > 0 else tuple(lit.step_s * share for share in EXPOSURES)
    misfits = []
    for exposure_s in exposures:
        # what of each exposure is over at a moment: of a flash it gets the difference between its end and its begin
        over = np.clip(grid[None, :] - lit.t_s[:, None] + exposure_s / 2, 0.0, exposure_s)
        seen = (weight * lit.rise) @ over
        square = weight @ over**2
        norm = square[ends] + square[begins] - 2 * ((over * weight[:, None]).T @ over)[ends, begins]
        along = seen[ends] - seen[begins]
        # light between two exposures is seen by none; what rounding leaves of its square is no norm
        some = norm > ROUNDING * square[-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            explained = np.where(some, np.maximum(along, 0) ** 2 / norm, 0.0)
        misfits.append(float((weight * lit.rise**2).sum()) - explained)
    least = min(misfit.min() for misfit in misfits)
    return begin_s, np.mean([np.exp(-(misfit - least) / 2) for misfit in misfits], axis=0)


def tie_of(first: Sequence[Lit], second: Sequence[Lit], clock: Clock | None) -> Tie | None:
    """The second camera's clock by the flashes that both saw; None: there is none that is surely one and the same.

    Parameters
    ----------
    first, second : flashes of each camera, in their order
    clock : by the motion; None: it does not tell it, and only one flash each is surely the same
    """
    if clock is None:
        pairs = [(first[0], second[0])] if len(first) == len(second) == 1 else []
    else:
        pairs = []
        for one in second:
            there = float(clock.first(np.array(one.middle_s)))
            reach_s = NEAR_S + AGREE_SD * float(clock.sd_at(np.array(one.middle_s)))
            near = [lit for lit in first if abs(lit.middle_s - there) < reach_s + lit.step_s]
            pairs += [(near[0], one)] if len(near) == 1 else []
    if not pairs:
        return None
    told = np.array([flash_offset(*pair) for pair in pairs])
    at = np.array([pair[1].middle_s for pair in pairs])
    rate = 0.0 if clock is None else clock.rate
    weight = 1 / told[:, 1] ** 2
    at_s = float(np.average(at, weights=weight))
    # each is the difference of the clocks at its own moment; by the rate they are brought to one
    offset_s = float(np.average(told[:, 0] - rate * (at - at_s), weights=weight))
    known = Known(offset_s, float(weight.sum() ** -0.5), at_s)
    motion = None
    if clock is not None:
        motion = clock.offset_s + clock.rate * at_s, float(clock.sd_at(np.array(at_s)))
    return Tie(known, len(pairs), motion)


__all__ = ["AGREE_SD", "Lit", "Tie", "flash_offset", "tie_of"]
