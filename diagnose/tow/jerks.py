"""How a model surges on a taut line while something carries it ahead, until the line has come straight again.

Surge alone, on a stiff spring that cannot push: what the taut-line radius shows of a slack line says when, how long and how hard
the model was carried, and with that what the line pulled with, jerks included, which no camera sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array

STEP_S = 0.01
"""A stiff line springs at 10 to 30 rad/s."""
TAIL = 3.0
"""After the push has ended a model may drift and bounce for this many times its length ..."""
LEAST_TAIL_S, LONGEST_S = 3.0, 24.0
"""... but not less than this, and no event is followed longer than the second."""
SPRING_RAD_S, DAMPING = 15.0, 0.2
"""Usual frequency of a model on a stiff line, and its damping over the critical one."""
HARD = (1.1, 1.3, 1.6, 2.0, 2.6, 3.4)
"""How hard it may be carried, in the straight tow's resistance: the search's grid. Below 1 no line falls slack."""
LENGTHS_S = tuple(np.geomspace(0.8, 9.0, 18))
"""How long: the search's grid."""
QUIET_Z, STRETCHES = 4.0, (2, 4, 8, 16)
"""Where no stretch of so many blocks falls short by more than so many standard deviations nothing is sought: choices, for time."""
SHIFTS = 3
"""Begins tried to a block."""
NUMBERS = ("begin_s", "length", "hard", "skew", "spring", "damping", "gain")
"""Of an event, all but the first as logarithms."""
USUAL = np.log([1.0, 1.0, 1.0, 1.0, SPRING_RAD_S, DAMPING, 1.0])
"""About which they lie, the first three anywhere ..."""
SPREAD = np.array([np.inf, np.inf, np.inf, 0.5, 0.7, 0.7, 0.05])
"""... with these standard deviations."""
TURNS = 15
"""Steps of the fit."""
SMALL = np.array([0.01, 0.01, 0.01, 0.01, 0.02, 0.05, 0.01])
"""Steps of its slopes."""
AT_MOST = np.array([0.3, 0.2, 0.2, 0.3, 0.3, 0.5, 0.05])
"""No number changes by more in a step."""


@dataclass(frozen=True)
class Push:
    """What carries a model ahead: one wave or a stop of the carriage, a shove, or a train of waves.

    Attributes
    ----------
    waves : how many; 0: a shove
    """

    waves: int

    def __call__(self, share: Array) -> Array:
        """At a share of its length (0..1; 0 beyond), at most about 1."""
        inside = (share > 0) & (share < 1)
        if self.waves == 0:
            return np.where(inside, np.sin(np.pi * share) ** 2, 0.0)
        course = np.sin(2 * np.pi * self.waves * share)
        return np.where(inside, course if self.waves == 1 else np.sin(np.pi * share) ** 2 * course, 0.0)

    @property
    def words(self) -> str:
        """What it is called."""
        return ("a shove", "a stop or a wave")[self.waves] if self.waves < 2 else f"{self.waves} waves"


PUSHES = tuple(Push(k) for k in range(6))
"""A shove, and one to five waves: longer trains slacken a line again and again, and look alike. A choice."""


@dataclass(frozen=True)
class Straight:
    """A straight tow, as far as surge asks.

    Attributes
    ----------
    speed_m_s : of the carriage
    pull_m_s2 : resistance over the surging mass
    exponent : of the resistance's growth with speed
    """

    speed_m_s: float
    pull_m_s2: float
    exponent: float


@dataclass(frozen=True)
class Event:
    """One slackening of a run's line.

    Attributes
    ----------
    push : of which kind
    numbers : (7,) NUMBERS
    tow : that it befell
    gain : half the chi-square that it explains of the radius
    """

    push: Push
    numbers: Array
    tow: Straight
    gain: float

    @property
    def begin_s(self) -> float:
        """When it begins."""
        return float(self.numbers[0])

    @property
    def length_s(self) -> float:
        """How long the model is carried."""
        return float(np.exp(self.numbers[1]))

    def course(self) -> tuple[Array, Array, Array]:
        """Times from the run's start, s, by how much the model is ahead, m, and what the line pulls with over R, (n,) each."""
        ahead, pull = surged([self.push], self.numbers[None], self.tow)
        return self.begin_s + STEP_S * np.arange(len(ahead)), ahead[:, 0], pull[:, 0]


def surged(pushes: Sequence[Push], numbers: Array, tow: Straight) -> tuple[Array, Array]:
    """How far ahead a model comes and what its line pulls with, every STEP_S from the event's begin.

    Parameters
    ----------
    pushes : k of them
    numbers : (k, 7) NUMBERS
    tow : of all

    Returns
    -------
    ahead (n, k), m, and pull (n, k) over the resistance
    """
    length, hard, skew, spring, damping, gain = np.exp(numbers[:, 1:]).T
    rate = tow.pull_m_s2 * gain
    after = np.maximum(TAIL * length, LEAST_TAIL_S)
    count = int(min((length + after).max(), LONGEST_S) / STEP_S) + 1
    share = (STEP_S * (np.arange(count) + 0.5))[:, None] / length
    warped = np.clip(share, 0.0, 1.0) ** skew
    carried = np.empty_like(warped)
    for push in set(pushes):
        at = [k for k, own in enumerate(pushes) if own == push]
        carried[:, at] = push(warped[:, at])
    carried = rate * hard * carried
    stiff, grip = spring**2, 2 * damping * spring
    ahead, speed = np.zeros(len(numbers)), np.zeros(len(numbers))
    far, pulled = np.empty_like(warped), np.empty_like(warped)
    for k in range(count):
        held = np.maximum(rate - stiff * ahead, 0.0)
        # strands grip as they tighten, and a line never pushes
        held = np.maximum(held - np.minimum(held / rate, 1.0) * grip * speed, 0.0)
        drag = np.maximum(1 + speed / tow.speed_m_s, 0.0) ** tow.exponent
        speed = speed + STEP_S * (carried[k] + held - rate * drag)
        ahead = ahead + STEP_S * speed
        far[k], pulled[k] = ahead, held
    return far, pulled / rate


def events(t_s: Array, ahead_m: Array, sd_m: float, tow: Straight) -> list[Event]:
    """The likeliest event of every kind of push, the likeliest first; none where the radius is quiet.

    Parameters
    ----------
    t_s : (n,) mean times of the blocks, evenly spaced
    ahead_m : (n,) by how much the line's radius falls short
    sd_m : noise of those
    tow : that it befell
    """
    sums = np.concatenate([[0.0], np.cumsum(ahead_m / sd_m)])
    shown = [(sums[n:] - sums[:-n]).max() / np.sqrt(n) for n in STRETCHES if n < len(sums)]
    if max(shown, default=0.0) < QUIET_Z:
        return []
    step = float(np.median(np.diff(t_s)))
    starts = [
        (p, np.log([1.0, n, h, 1.0, SPRING_RAD_S, DAMPING, 1.0])) for p in PUSHES for n in LENGTHS_S for h in HARD
    ]
    pushes, numbers = [p for p, _ in starts], np.array([x for _, x in starts])
    far, _ = surged(pushes, numbers, tow)
    best: dict[Push, tuple[float, Array]] = {}
    for shift in range(SHIFTS):
        # an event that begins shortly before a block's begin
        early = step * shift / SHIFTS
        means = _block_means(far, early, step) / sd_m
        for k, push in enumerate(pushes):
            shape = means[:, k]
            over = np.correlate(np.pad(ahead_m / sd_m, (0, len(shape))), shape)[: len(t_s)]
            gain = over - 0.5 * float(shape @ shape)
            at = int(np.argmax(gain))
            if push not in best or gain[at] > best[push][0]:
                best[push] = float(gain[at]), np.concatenate([[t_s[at] - step / 2 - early], numbers[k, 1:]])
    found = _fitted(t_s, ahead_m, sd_m, tow, [(push, start) for push, (_, start) in best.items()])
    return sorted(found, key=lambda event: -event.gain)


def _block_means(far: Array, early_s: float, step_s: float) -> Array:
    """Means over blocks (q, k) of what begins ``early_s`` before the first of them."""
    first = round(early_s / STEP_S)
    edges = first + np.round(np.arange(0, (len(far) - first) * STEP_S / step_s) * step_s / STEP_S).astype(int)
    whole = np.concatenate([np.zeros_like(far[:1]), np.cumsum(far, axis=0)])
    return np.diff(whole[edges], axis=0) / np.diff(edges)[:, None]


def _fitted(
    t_s: Array, ahead_m: Array, sd_m: float, tow: Straight, starts: Sequence[tuple[Push, Array]]
) -> list[Event]:
    """Gauss-Newton from these starts, all side by side; steps that lose are halved."""
    step, pushes = float(np.median(np.diff(t_s))), [p for p, _ in starts]
    here = np.array([x for _, x in starts])

    def missed(numbers: Array) -> Array:
        """(k, n + 7) rows: blocks, then what is known of the numbers."""
        kinds = [p for p in pushes for _ in range(len(numbers) // len(pushes))]
        far, _ = surged(kinds, numbers, tow)
        whole = np.concatenate([np.zeros_like(far[:1]), np.cumsum(far, axis=0)]) * STEP_S
        fine = STEP_S * np.arange(len(whole))
        rows = [
            (np.interp(t_s + step / 2 - b, fine, w) - np.interp(t_s - step / 2 - b, fine, w)) / step
            for b, w in zip(numbers[:, 0], whole.T, strict=True)
        ]
        return np.column_stack([(ahead_m - np.array(rows)) / sd_m, -(numbers - USUAL) / SPREAD])

    count, left = len(NUMBERS), missed(here)
    damp = np.full(len(here), 1e-2)
    for _ in range(TURNS):
        moved = here[:, None] + np.concatenate([np.zeros((1, count)), np.diag(SMALL)])
        rows = missed(moved.reshape(-1, count)).reshape(len(here), count + 1, -1)
        slope = (rows[:, 1:] - rows[:, :1]) / SMALL[:, None]
        normal = slope @ slope.transpose(0, 2, 1)
        diagonal = np.einsum("kii->ki", normal)
        normal = normal + np.einsum("ki,ij->kij", damp[:, None] * diagonal + 1e-6, np.eye(count))
        change = -np.linalg.solve(normal, (slope @ left[..., None]))[..., 0]
        trial = here + np.clip(change, -AT_MOST, AT_MOST)
        after = missed(trial)
        better = (after**2).sum(axis=1) < (left**2).sum(axis=1)
        here, left = np.where(better[:, None], trial, here), np.where(better[:, None], after, left)
        damp = np.where(better, damp / 5, damp * 8)
    before = float(((ahead_m / sd_m) ** 2).sum())
    return [
        Event(push, x, tow, 0.5 * (before - float((rest**2).sum())))
        for push, x, rest in zip(pushes, here, left, strict=True)
    ]


__all__ = ["PUSHES", "STEP_S", "Event", "Push", "Straight", "events", "surged"]
