"""A path of all runs near which the next is looked for: at other values, on another grid, or by a fit with other priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from .hermite import between_steps


@dataclass(frozen=True)
class Path:
    """The motion of all runs on the integrator's grid.

    Attributes
    ----------
    step_s : of the grid
    values : (runs, ``COUNT``), of the path
    states : (4, steps + 1, runs), (alpha, beta, v, r)
    rates : (4, steps + 1, runs), theirs
    """

    step_s: float
    values: Array
    states: Array
    rates: Array

    def of(self, chosen: Sequence[int]) -> Path:
        """Those of some runs."""
        some = list(chosen)
        return Path(self.step_s, self.values[some], self.states[:, :, some], self.rates[:, :, some])

    def on(self, step_s: float, count: int) -> Array | None:
        """The states at the ends of ``count`` other steps, by cubics; None where the path ends before."""
        last = self.states.shape[1] - 1
        if step_s * count > self.step_s * (last + 1):
            return None
        if step_s == self.step_s and count <= last:
            return self.states[:, : count + 1]
        times = np.arange(count + 1) * step_s
        states, rates = (np.moveaxis(x, 1, 2) for x in (self.states, self.rates))
        return np.moveaxis(between_steps(states, rates, self.step_s, times), 2, 1)


@dataclass(frozen=True)
class Guess(Path):
    """The same with what moves it.

    Attributes
    ----------
    moved : (4, wanted, steps + 1, runs), sensitivities of the states
    wanted : their parameters
    tension : (steps + 1, runs), T along it, N
    tension_moved : (wanted, steps + 1, runs), its sensitivities; None where no gauge asks for them
    """

    moved: Array
    wanted: tuple[int, ...]
    tension: Array | None = None
    tension_moved: Array | None = None

    @property
    def path(self) -> Path:
        """Without what moves it, to be kept."""
        return Path(self.step_s, self.values, self.states, self.rates)

    def tension_at(self, run: int, t_s: Array) -> tuple[Array, Array]:
        """T of a run, (n,), and its sensitivities (wanted, n), at times from the run's first sample; straight between steps."""
        assert self.tension is not None
        moved = np.zeros((0, *self.tension.shape)) if self.tension_moved is None else self.tension_moved
        place = np.clip(t_s / self.step_s, 0.0, len(self.tension) - 1 - 1e-9)
        node = place.astype(int)
        share = place - node
        both = np.concatenate([self.tension[None, :, run], moved[:, :, run]])
        found = both[:, node] * (1 - share) + both[:, node + 1] * share
        return found[0], found[1:]


__all__ = ["Guess", "Path"]
