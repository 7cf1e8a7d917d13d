"""How a model surges on a taut line while something carries it ahead or the carriage slows, until the line is straight again.

Surge alone, on a stiff spring that cannot push.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...simulate.model import Array

STEP_S = 0.01
"""A stiff line springs at 10 to 30 rad/s."""
TAIL = 3.0
"""After the push has ended a model may drift and bounce for this many times its length ..."""
LEAST_TAIL_S, LONGEST_S = 10.0, 24.0
"""... but not less than this, and no event is followed longer than the second."""
NUMBERS = ("begin_s", "length", "hard", "skew", "spring", "damping", "gain")
"""Of an event, all but the first as logarithms."""


@dataclass(frozen=True)
class Push:
    """What carries a model ahead of its post: a shove, a wave or a train of them, or the carriage that slows and comes back.

    Attributes
    ----------
    waves : how many; 0: a shove
    carriage : it is the carriage; the model is pushed by nothing
    """

    waves: int
    carriage: bool = False

    def __call__(self, share: Array, skew: Array | float = 1.0) -> Array:
        """At a share of its length (0..1; 0 beyond), at most about 1 without skew. Of a carriage: how fast it slows.

        Parameters
        ----------
        share : of its length
        skew : above 1 its first half takes the longer
        """
        inside = (share > 0) & (share < 1)
        if self.carriage:
            turned, rate = _turned(np.clip(share, 0.0, 1.0), skew)
            return np.where(inside, np.sin(2 * np.pi * turned) * rate, 0.0)
        share = np.clip(share, 0.0, 1.0) ** skew
        if self.waves == 0:
            return np.where(inside, np.sin(np.pi * share) ** 2, 0.0)
        course = np.sin(2 * np.pi * self.waves * share)
        return np.where(inside, course if self.waves == 1 else np.sin(np.pi * share) ** 2 * course, 0.0)

    def slowed(self, share: Array, skew: Array | float = 1.0) -> Array:
        """How much slower the carriage goes for it, over what slows it at most times the length: the sum of what it slows by."""
        if not self.carriage:
            return np.zeros_like(share)
        return np.sin(np.pi * _turned(np.clip(share, 0.0, 1.0), skew)[0]) ** 2 / np.pi

    @property
    def words(self) -> str:
        """What it is called."""
        if self.carriage:
            return "a stop of the carriage"
        return ("a shove", "a wave")[self.waves] if self.waves < 2 else f"{self.waves} waves"


def _turned(share: Array, skew: Array | float) -> tuple[Array, Array]:
    """How much of its turn a carriage has made that slows in another time than it comes back in, and the rate of that."""
    late = np.asarray(skew, dtype=float) ** 2
    below = share + late * (1 - share)
    return share / below, late / below**2


PUSHES = (Push(0), Push(1), Push(1, carriage=True), *(Push(k) for k in range(2, 6)))
"""A shove, a wave, a stop, and two to five waves: longer trains slacken a line again and again, and look alike. A choice."""


@dataclass(frozen=True)
class Swinging:
    """How a tow swings, as far as surge on its line asks.

    Attributes
    ----------
    t_s : (n,) times from the run's start, s
    beyond : (n,) what a taut line pulls with beyond the resistance, over it
    lighter : (n,) how much the faster the line shortens for a newton less than on a straight tow
    cosine : (n,) of its angle to the hull
    """

    t_s: Array
    beyond: Array
    lighter: Array
    cosine: Array

    def at(self, t_s: Array) -> tuple[Array, Array, Array]:
        """The three at other times."""
        return tuple(np.interp(t_s, self.t_s, values) for values in (self.beyond, self.lighter, self.cosine))  # pyright: ignore


NOT_AT_ALL = Swinging(np.zeros(1), np.zeros(1), np.ones(1), np.ones(1))
"""Of a straight tow."""


@dataclass(frozen=True)
class Straight:
    """A tow, as far as surge asks.

    Attributes
    ----------
    speed_m_s : of the carriage
    pull_m_s2 : resistance over the surging mass
    exponent : of the resistance's growth with speed
    swinging : how it swings about a straight tow
    """

    speed_m_s: float
    pull_m_s2: float
    exponent: float
    swinging: Swinging = NOT_AT_ALL


class Surged(NamedTuple):
    """How models surge, (n, k) or (n,), every STEP_S from an event's begin.

    Attributes
    ----------
    ahead_m : how far ahead of where its taut line would hold it
    faster_m_s : by how much it goes faster through the water than the tow's own speed
    pushed : what pushes it, over the resistance; a carriage pushes nothing
    pull : what its line pulls with, over the resistance
    """

    ahead_m: Array
    faster_m_s: Array
    pushed: Array
    pull: Array


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

    @property
    def end_s(self) -> float:
        """When what carries the model has ended."""
        return self.begin_s + self.length_s


def courses(found: Sequence[Event]) -> list[tuple[Array, Surged]]:
    """Of each event times from the run's start, s, (n,), and how its model surges then.

    Parameters
    ----------
    found : the events
    """
    if not found:
        return []
    every = surged([e.push for e in found], np.array([e.numbers for e in found]), [e.tow for e in found])
    answers = []
    for k, event in enumerate(found):
        one = Surged(*(rows[: _steps(np.array(event.length_s)), k] for rows in every))
        answers.append((event.begin_s + STEP_S * np.arange(len(one.ahead_m)), one))
    return answers


def surged(pushes: Sequence[Push], numbers: Array, tows: Sequence[Straight]) -> Surged:
    """How models surge, (n, k), every STEP_S from the event's begin, each for as many steps as it is followed.

    Parameters
    ----------
    pushes : k of them
    numbers : (k, 7) NUMBERS
    tows : k of them
    """
    order, forces = _forces(pushes, numbers, tows)
    far, faster, pull = _followed(forces, 3)
    back = np.argsort(order)
    faster -= np.where(np.arange(len(far))[:, None] < forces.steps, forces.slower, 0.0)
    return Surged(*(rows[:, back] for rows in (far, faster, forces.pushed, pull / forces.rate)))


def ahead_of(pushes: Sequence[Push], numbers: Array, tows: Sequence[Straight]) -> Array:
    """How far ahead models are, m, (k, n): of ``surged`` this alone, a row for each."""
    order, forces = _forces(pushes, numbers, tows)
    (far,) = _followed(forces, 1)
    return far.T[np.argsort(order)]


class _Forces(NamedTuple):
    """What moves k models, the one that is followed longest first.

    Attributes
    ----------
    steps : (k,) how many each is followed
    taut : (n, k) what its line pulls with where it is taut, m/s2
    push : (n, k) what carries it, the resistance and what swings
    lighter, pushed : (n, k) of ``Swinging`` and of ``Surged``
    slower : (n, k) by how much the carriage goes slower, m/s
    rate, carriage, exponent : (k,) of its resistance
    stiff, grip : (k,) of its line
    """

    steps: Array
    taut: Array
    push: Array
    lighter: Array
    pushed: Array
    slower: Array
    rate: Array
    carriage: Array
    exponent: Array
    stiff: Array
    grip: Array


def _forces(pushes: Sequence[Push], numbers: Array, tows: Sequence[Straight]) -> tuple[Array, _Forces]:
    """Which is followed longest, and so on: indices, and what moves them."""
    own = _steps(np.exp(numbers[:, 1]))
    order = np.argsort(-own, kind="stable")
    own, pushes, tows = own[order], [pushes[k] for k in order], [tows[k] for k in order]
    begin, (length, hard, skew, spring, damping, gain) = numbers[order, 0], np.exp(numbers[order, 1:].T)
    usual, carriage, exponent = np.array([(t.pull_m_s2, t.speed_m_s, t.exponent) for t in tows]).T
    rate, count = usual * gain, int(own[0])
    pushed, slows, slower = (np.zeros((count, len(own))) for _ in range(3))
    for push in set(pushes):
        at = [k for k, kind in enumerate(pushes) if kind == push]
        carrying = min(int(length[at].max() / STEP_S) + 1, count)
        share = STEP_S * (np.arange(carrying) + 0.5)[:, None] / length[at]
        carried = slows if push.carriage else pushed
        carried[:carrying, at] = hard[at] * push(share, skew[at])
        if push.carriage:
            slower[:carrying, at] = hard[at] * rate[at] * length[at] * push.slowed(share, skew[at])
    beyond, lighter, cosine = _swung(tows, begin, STEP_S * np.arange(count))
    # what swings pulls the line the harder, or less hard, and it falls slack the later, or sooner
    taut = rate * (1 + beyond)
    push = rate * (cosine * pushed + slows) - lighter * taut + rate
    steady = rate, carriage, exponent, spring**2, 2 * damping * spring
    return order, _Forces(own, taut, push, lighter, pushed, slower, *steady)


def _swung(tows: Sequence[Straight], begin_s: Array, clock_s: Array) -> tuple[Array, Array, Array]:
    """How each tow swings (n, k) from a begin on: ``Swinging.at``."""
    # most of them begin as others do
    first: dict[tuple[int, float], int] = {}
    at = [first.setdefault((id(t.swinging), begin), len(first)) for t, begin in zip(tows, begin_s, strict=True)]
    every = {id(t.swinging): t.swinging for t in tows}
    found = [every[one].at(begin + clock_s) for one, begin in first]
    return tuple(np.array(rows).T[:, at] for rows in zip(*found, strict=True))  # pyright: ignore


def _followed(forces: _Forces, kinds: int) -> Array:
    """How far ahead models are, how fast, and what their lines pull with, as many of these ``kinds`` as asked: (kinds, n, k)."""
    rows = np.zeros((kinds, *forces.taut.shape))
    ahead, speed = np.zeros(len(forces.rate)), np.zeros(len(forces.rate))
    # in place: the arrays are short, and there are thousands of steps
    held, drag, more = np.empty_like(ahead), np.empty_like(ahead), np.empty_like(ahead)
    begin = 0
    for end in np.unique(forces.steps):
        going = int((forces.steps >= end).sum())
        now = _Forces(*(x[..., :going] for x in forces))
        ahead, speed, held, drag, more = (x[:going] for x in (ahead, speed, held, drag, more))
        moved = ahead, speed, held
        for k in range(begin, end):
            np.subtract(now.taut[k], np.multiply(now.stiff, ahead, out=held), out=held)
            np.maximum(held, 0.0, out=held)
            # strands grip as they tighten, and a line never pushes
            np.minimum(np.divide(held, now.rate, out=more), 1.0, out=more)
            more *= now.grip
            more *= speed
            np.maximum(np.subtract(held, more, out=held), 0.0, out=held)
            np.subtract(speed, now.slower[k], out=drag)
            np.add(np.divide(drag, now.carriage, out=drag), 1.0, out=drag)
            np.power(np.maximum(drag, 0.0, out=drag), now.exponent, out=drag)
            np.add(now.push[k], np.multiply(now.lighter[k], held, out=more), out=more)
            more -= np.multiply(now.rate, drag, out=drag)
            more *= STEP_S
            speed += more
            ahead += np.multiply(STEP_S, speed, out=more)
            for at in range(kinds):
                rows[at, k, :going] = moved[at]
        begin = end
    return rows


def _steps(length_s: Array) -> Array:
    """How many steps events of such lengths are followed."""
    after = np.maximum(TAIL * length_s, LEAST_TAIL_S)
    return (np.minimum(length_s + after, LONGEST_S) / STEP_S).astype(int) + 1


__all__ = [
    "NOT_AT_ALL",
    "NUMBERS",
    "PUSHES",
    "STEP_S",
    "Event",
    "Push",
    "Straight",
    "Surged",
    "Swinging",
    "ahead_of",
    "courses",
    "surged",
]
