"""A model's course: Runge-Kutta's fourth order, many simulations side by side; what effects do to inputs, equations, outputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from .model import Missing, System

FAR = 1e30
"""A state beyond this has grown beyond bounds: it stays there, so that no number overflows in what follows."""


@dataclass(frozen=True)
class Put:
    """Something missing, put in.

    Attributes
    ----------
    missing : what
    numbers : its numbers (k,) each
    """

    missing: Missing
    numbers: tuple[Array, ...]


@dataclass(frozen=True)
class Grid:
    """Where a course is taken.

    Attributes
    ----------
    step_s : between samples
    count : of samples
    inner : steps of integration between two samples
    stays : of each input, whether it stays until the next sample; empty: none does
    """

    step_s: float
    count: int
    inner: int
    stays: tuple[bool, ...] = ()

    @property
    def times_s(self) -> Array:
        """(count,) of the samples."""
        return np.arange(self.count) * self.step_s

    @property
    def half_s(self) -> Array:
        """(2 inner (count - 1) + 1,) beginnings, middles and ends of the steps."""
        return np.linspace(0.0, (self.count - 1) * self.step_s, 2 * self.inner * (self.count - 1) + 1)


def held(values: Array, grid: Grid) -> Array:
    """Inputs between their samples: straight from one to the next, or staying until the next.

    At the instant at which one that stays jumps it has the mean of both sides.

    Parameters
    ----------
    values : (count, m, ...) at the samples
    grid : of the course

    Returns
    -------
    halves : (2 inner (count - 1) + 1, m, ...)
    """
    pieces = 2 * grid.inner
    at = np.arange(pieces * (grid.count - 1) + 1)
    before, share = at // pieces, (at % pieces) / pieces
    after = np.minimum(before + 1, grid.count - 1)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    found = (1 - share) * values[before] + share * values[after]
    steps = values[before].copy()
    jumps = at[(at % pieces == 0) & (at > 0)]
    steps[jumps] = 0.5 * (values[before[jumps]] + values[before[jumps] - 1])
    for index, stay in enumerate(grid.stays):
        if stay:
            found[:, index] = steps[:, index]
    return found


def simulated(
    system: System,
    grid: Grid,
    start: Array,
    inputs: Array,
    p: Array,
    puts: Sequence[Put] = (),
    push: Callable[[int], Array] | None = None,
) -> Array:
    """Outputs of k simulations.

    Parameters
    ----------
    system : the model
    grid : of the course
    start : (s, k)
    inputs : (2 inner (count - 1) + 1, m, k), as of ``held``
    p : (q, k)
    puts : what is missing, put in
    push : index of a sample -> (s, k) that is added to the rates until the next; None: nothing

    Returns
    -------
    outputs : (count, c, k)
    """
    own = [Put(m, tuple(np.full(start.shape[1], v) for v in numbers)) for m, numbers in system.built_in]
    puts = [*own, *puts]
    with np.errstate(all="ignore"):
        u = changed_inputs(system, grid, inputs, puts)
        if system.whole:
            # between two samples an input is what it is in the middle
            seen = system.course(grid.times_s, start, np.moveaxis(u[grid.inner :: 2 * grid.inner], 0, 1), p)
        else:
            x = _integrated(system, grid, start, u, p, [q for q in puts if q.missing.equation], push)
            at = np.moveaxis(u[:: 2 * grid.inner], 0, 1)
            seen = system.seen(grid.times_s[:, None], x, at, p[:, None])
        return changed_outputs(system, grid, np.moveaxis(seen, 0, 1), puts)


def changed_inputs(system: System, grid: Grid, inputs: Array, puts: Sequence[Put]) -> Array:
    """What comes of inputs (halves, m, k), as of ``held``, by what is put in.

    Parameters
    ----------
    system, grid, inputs, puts : as of ``simulated``
    """
    names = [one.name for one in system.inputs]
    found = inputs
    for put in puts:
        if put.missing.input:
            found = found.copy() if found is inputs else found
            index = names.index(put.missing.input)
            found[:, index] = put.missing.changes(grid.half_s, found[:, index], *put.numbers)
    return found


def _integrated(
    system: System,
    grid: Grid,
    start: Array,
    u: Array,
    p: Array,
    puts: Sequence[Put],
    push: Callable[[int], Array] | None,
) -> Array:
    """(s, count, k)."""
    steps = Steps(system, grid, start, p, puts)
    path = np.empty((len(start), grid.count, start.shape[1]))
    path[:, 0] = steps.x
    for sample in range(1, grid.count):
        path[:, sample] = steps.to_next(u, 0.0 if push is None else push(sample - 1))
    return path


class Steps:
    """A model on its way from sample to sample.

    Parameters
    ----------
    system : the model
    grid : of the course; its count is not looked at
    start : (s, k)
    p : (q, k)
    puts : what is missing in its equations, put in

    Attributes
    ----------
    x : (s, k) states where it is
    """

    def __init__(self, system: System, grid: Grid, start: Array, p: Array, puts: Sequence[Put]) -> None:
        names = [one.name for one in system.states]
        self._system, self._p, self._inner = system, p, grid.inner
        self._h = grid.step_s / grid.inner
        self._stays = np.flatnonzero(grid.stays)
        self._added = [(names.index(put.missing.equation), put) for put in puts]
        self._memory = [np.zeros(start.shape[1]) for put in puts if put.missing.memory is not None]
        self._at, self.x = 0, np.array(start, dtype=float)

    def _rates(self, t: float, x: Array, u: Array, memory: Sequence[Array]) -> tuple[Array, list[Linear]]:
        """Rates of the states, and (drive, decay) of each memory."""
        found = self._system.derivatives(t, x, u, self._p)
        linear: list[Linear] = []
        if self._added:
            arguments = self._system.arguments(x, u, self._p)
            for index, put in self._added:
                own: tuple[Array, ...] = ()
                if put.missing.memory is not None:
                    m = memory[len(linear)]
                    drive, decay = put.missing.memory(t, *arguments, *put.numbers)
                    linear.append((drive, decay))
                    own = (m, drive - decay * m)
                found[index] += put.missing.changes(t, *arguments, *own, *put.numbers)
        return found, linear

    def to_next(self, u: Array, pushed: Array | float = 0.0) -> Array:
        """States (s, k) at the next sample.

        Parameters
        ----------
        u : (halves, m, k) inputs, as of ``held``, at least to the next sample
        pushed : (s, k), added to the rates until there
        """
        # stated, as a type checker takes long to find what a loop does to each
        x: Array
        k1: Array
        k2: Array
        k3: Array
        k4: Array
        h, x, memory = self._h, self.x, self._memory
        for _ in range(self._inner):
            t, (before, middle, after) = 0.5 * h * self._at, u[self._at : self._at + 3]
            if len(self._stays):
                # what stays jumps between two steps, never in one
                before, after = before.copy(), after.copy()
                before[self._stays] = after[self._stays] = middle[self._stays]
            k1, m1 = self._rates(t, x, before, memory)
            k1 = k1 + pushed
            k2, m2 = self._rates(t + 0.5 * h, x + 0.5 * h * k1, middle, _ahead(memory, m1, 0.5 * h))
            k2 = k2 + pushed
            k3, m3 = self._rates(t + 0.5 * h, x + 0.5 * h * k2, middle, _ahead(memory, m2, 0.5 * h))
            k3 = k3 + pushed
            k4, m4 = self._rates(t + h, x + h * k3, after, _ahead(memory, m3, h))
            x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4 + pushed)
            memory = [over_step(h, *those) for those in zip(memory, m1, m2, m3, m4, strict=True)]
            self._at += 2
        self._memory = memory
        self.x = np.clip(np.nan_to_num(x, nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR)
        return self.x


def _ahead(memory: Sequence[Array], linear: Sequence[Linear], length: float) -> list[Array]:
    return [relaxed(m, length * drive, length * decay) for m, (drive, decay) in zip(memory, linear, strict=True)]


Linear = tuple[Array, Array]
"""Drive and decay of m' = drive - decay m."""


def relaxed(m: Array, drive: Array, decay: Array) -> Array:
    """Where m' = drive - decay m is after a unit of time, exactly: no decay, however fast, grows beyond bounds.

    Parameters
    ----------
    m, drive, decay : (k,)

    Examples
    --------
    >>> relaxed(np.array([1.0, 1.0]), np.array([0.5, 3e9]), np.array([0.0, 1e9]))
    array([1.5, 3. ])
    """
    small = np.abs(decay) < 1e-9
    share = np.where(small, 1.0 - 0.5 * decay, -np.expm1(-decay) / np.where(small, 1.0, decay))
    return m * np.exp(-decay) + share * drive


def over_step(h: float, m: Array, *stages: Linear) -> Array:
    """Where m' = drive - decay m is after a step, of fourth order (Magnus): the stages are those of Runge and Kutta.

    Parameters
    ----------
    h : length of the step
    m : (k,)
    stages : (drive, decay) at its beginning, twice in its middle, at its end
    """
    (a1, b1), (a2, b2), (a3, b3), (a4, b4) = stages
    drive = h / 6 * (a1 + 2 * (a2 + a3) + a4) + h**2 / 12 * (b1 * a4 - b4 * a1)
    return relaxed(m, drive, h / 6 * (b1 + 2 * (b2 + b3) + b4))


def changed_outputs(system: System, grid: Grid, seen: Array, puts: Sequence[Put]) -> Array:
    """What is measured (count, c, k) by what is put in: the sensors first, then the clock that reads them.

    Parameters
    ----------
    system, grid, puts : as of ``simulated``
    seen : (count, c, k) of the model
    """
    names = [one.name for one in system.outputs]
    found = seen
    for put in puts:
        m = put.missing
        if m.output:
            found = np.array(found, dtype=float) if found is seen else found
            index = names.index(m.output)
            found[:, index] = m.changes(grid.times_s, found[:, index], *put.numbers)
    for put in puts:
        m = put.missing
        if not (m.output or m.input or m.equation):
            change = np.asarray(m.changes(grid.times_s[:, None], *put.numbers), dtype=float)
            found = read_at(found, np.broadcast_to(change, (grid.count, found.shape[2])) / grid.step_s)
    return found


def read_at(values: Array, shift: Array) -> Array:
    """Values at other times: a cubic through the four nearest samples (Catmull and Rom), straight beyond both ends.

    Parameters
    ----------
    values : (n, c, k) at even steps
    shift : (n, k), in steps

    Returns
    -------
    moved : (n, c, k)
    """
    n = len(values)
    at = np.arange(n)[:, None] + shift
    first = np.clip(np.floor(at), 0, n - 2).astype(int)
    s = (at - first)[:, None]

    def take(index: Array) -> Array:
        return np.take_along_axis(values, np.clip(index, 0, n - 1)[:, None], axis=0)

    b, c = take(first), take(first + 1)
    a = np.where((first > 0)[:, None], take(first - 1), 2 * b - c)
    d = np.where((first < n - 2)[:, None], take(first + 2), 2 * c - b)
    inside = b + 0.5 * s * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))
    straight = b + s * (c - b)
    return np.where((s >= 0) & (s <= 1), inside, straight)


__all__ = [
    "FAR",
    "Grid",
    "Put",
    "Steps",
    "changed_inputs",
    "changed_outputs",
    "held",
    "over_step",
    "read_at",
    "relaxed",
    "simulated",
]
