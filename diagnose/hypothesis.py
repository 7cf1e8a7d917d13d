"""A hypothesis: the simulator's numbers, each run's own, and the effects it has beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..simulate.model import Array
from .effects import Effect


@dataclass(frozen=True)
class Path:
    """The motion of all runs at all nodes, as a start for the next one.

    Attributes
    ----------
    lags_s : time constants of the lagged velocities behind the four states
    states : (4 + 2 lags, nodes, runs)
    """

    lags_s: tuple[float, ...]
    states: Array


@dataclass(frozen=True)
class Hypothesis:
    """The simulator with some effects.

    Attributes
    ----------
    six : (6,) linear derivatives at the reference speed (shared numbers of another simulator)
    own : (runs, k), each run's own numbers
    effects : which
    numbers : per effect (p,)
    path : a motion near its own, or None
    """

    six: Array
    own: Array
    effects: tuple[Effect, ...] = ()
    numbers: tuple[Array, ...] = ()
    path: Path | None = None

    @property
    def size(self) -> int:
        """Numbers of all its effects together."""
        return sum(len(n) for n in self.numbers)


def with_effects(h: Hypothesis, effects: Sequence[Effect]) -> Hypothesis:
    """The hypothesis with more effects, absent at first."""
    numbers = tuple(np.array([q.none for q in e.parameters]) for e in effects)
    return replace(h, effects=(*h.effects, *effects), numbers=(*h.numbers, *numbers))


__all__ = ["Hypothesis", "Path", "with_effects"]
