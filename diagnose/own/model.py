"""A model of one's own as equations: states, inputs, numbers with units, a right-hand side. Nothing is integrated by hand.

What the engine asks of any model is ``System``; ``Model`` is one of Python, ``fmu.FmuModel`` one of an FMU.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ...record.errors import InputError
from ...simulate.model import Array
from ..effects import Effect, Parameter

PROBES, PROBED_SD = 6, 0.3
"""States at which it is looked which equation only says that one state is the rate of another, and how far from their starts they
are, in their sizes."""


@dataclass(frozen=True)
class State:
    """A state.

    Attributes
    ----------
    name, unit : of it
    start : value at a run's first row, where no output of that name is measured
    size : how large it usually is; None: of ``start``, else 1
    known : its start is known exactly; else each run's is fitted
    equation : what its equation is called in the answer; empty: the name
    random : random changes of its rate (unit/s) that are usual when nothing is missing; None: a thousandth of its rate
    """

    name: str
    unit: str = ""
    start: float = 0.0
    size: float | None = None
    known: bool = False
    equation: str = ""
    random: float | None = None


@dataclass(frozen=True)
class Input:
    """A measured or commanded input.

    Attributes
    ----------
    name, unit : of it
    stage : what brings it in, in the answer
    """

    name: str
    unit: str = ""
    stage: str = "actuator"


@dataclass(frozen=True)
class Output:
    """What is measured.

    Attributes
    ----------
    name, unit : of it
    stage : what measures it, in the answer
    """

    name: str
    unit: str = ""
    stage: str = "sensor"


@dataclass(frozen=True)
class Number:
    """A number of the model.

    Attributes
    ----------
    name, unit : of it
    start : where its fit begins; a factor of three off is near enough
    size : how large it usually is; None: of ``start``, else 1
    least, most : bounds
    sd : prior standard deviation about ``start``; None: the data alone decide
    known : it is not fitted
    """

    name: str
    unit: str = ""
    start: float = 0.0
    size: float | None = None
    least: float = -np.inf
    most: float = np.inf
    sd: float | None = None
    known: bool = False

    @property
    def usual(self) -> float:
        """Its size."""
        return usual_size(self.start, self.size)


def usual_size(start: float, size: float | None) -> float:
    """How large something usually is.

    Parameters
    ----------
    start : a value of it, which counts where it is not 0
    size : as stated, or None

    Examples
    --------
    >>> usual_size(-3.0, None), usual_size(0.0, None), usual_size(0.0, 0.2)
    (3.0, 1.0, 0.2)
    """
    return float(size) if size else abs(start) or 1.0


@dataclass(frozen=True)
class Missing:
    """Something that the model may miss: in one equation, one input, one output, or the clock.

    Attributes
    ----------
    name : in the answer
    parameters : its numbers (``towline.diagnose.effects.Parameter``), at ``none`` when it is absent
    physics, cure : a sentence each
    changes : what it does, a function of arrays that broadcast, its numbers last. With ``equation``: (t, x, u, p, *numbers) -> what
        it adds to that state's rate. With ``input`` or ``output``: (t, values, *numbers) -> values, t (n,) and values (n, k).
        With neither: (t, *numbers) -> change of the time at which the outputs were read
    equation, input, output : name of the state, input or output that it changes
    title : in words; empty: the name
    form : share of what it explains that its own form may leave over
    cost : log evidence that is taken off
    begins : its numbers where it is looked for, too, as it has hardly a slope where it is absent; empty: there alone
    code : of ``changes`` as Python, for the corrected model; empty: its own file's
    memory : (t, x, u, p, *numbers) -> drive, decay of a state m of its own that the model does not have, m' = drive - decay m with
        decay >= 0, begun at 0; with ``equation`` only. ``changes`` is given m and m' then: (t, x, u, p, m, m', *numbers)
    memory_code : of ``memory`` as Python
    """

    name: str
    parameters: tuple[Parameter, ...]
    physics: str
    cure: str
    changes: Callable[..., Any]
    equation: str = ""
    input: str = ""
    output: str = ""
    title: str = ""
    form: float = 0.03
    cost: float = 0.0
    begins: tuple[tuple[float, ...], ...] = ()
    code: str = ""
    memory: Callable[..., Any] | None = None
    memory_code: str = ""

    def effect(self, stage: str) -> Effect:
        """As the engine knows it; ``stage``: where it acts."""
        return Effect(
            self.name,
            stage,
            self.parameters,
            self.physics,
            self.cure,
            form=self.form,
            cost=self.cost,
            title=self.title,
        )


class System(Protocol):
    """What a model is to the engine: equations of any make, many columns k side by side."""

    @property
    def name(self) -> str:
        """Of its file."""
        ...

    @property
    def states(self) -> Sequence[State]:
        """What they are, as are the next three."""
        ...

    @property
    def inputs(self) -> Sequence[Input]:
        """What it is given."""
        ...

    @property
    def numbers(self) -> Sequence[Number]:
        """What is fitted or known."""
        ...

    @property
    def outputs(self) -> Sequence[Output]:
        """What is measured."""
        ...

    @property
    def missing(self) -> Sequence[Missing]:
        """What its author thinks it may miss."""
        ...

    @property
    def built_in(self) -> Sequence[tuple[Missing, tuple[float, ...]]]:
        """What was missing and is put in, with its numbers: part of the model."""
        ...

    @property
    def whole(self) -> bool:
        """Its states are not to be had: it runs by itself, and nothing can be added to its equations."""
        ...

    def derivatives(self, t: float, x: Array, u: Array, p: Array) -> Array:
        """Rates (s, k) of states (s, k) with inputs (m, k) and numbers (q, k), t s after the first row."""
        ...

    def seen(self, t: Array, x: Array, u: Array, p: Array) -> Array:
        """Outputs (c, n, k) of states (s, n, k), inputs (m, n, k) and numbers (q, 1, k) at times (n, 1)."""
        ...

    def course(self, t: Array, start: Array, u: Array, p: Array) -> Array:
        """Outputs (c, n, k) of a model that runs by itself: at times (n,), of starts (s, k), numbers (q, k), inputs (m, n - 1, k)
        from each time to the next.
        """
        ...

    def arguments(self, x: Array, u: Array, p: Array) -> tuple[Any, Any, Any]:
        """The same with names, for what its author adds."""
        ...


class Named:
    """A model's states, inputs and numbers by their names, for what its author writes."""

    def arguments(self, x: Array, u: Array, p: Array) -> tuple[Any, Any, Any]:
        """Of ``System``."""
        of_x, of_u, of_p = self._kinds
        return of_x(*x), of_u(*u), of_p(*p)

    @cached_property
    def _kinds(self) -> tuple[Any, Any, Any]:
        return kinds(self)  # pyright: ignore[reportArgumentType]


Rates = Callable[[Any, Any, Any, Any], Sequence[Any]]
"""(t, x, u, p) -> the rates of the states, or the outputs; x, u and p are tuples with names."""


@dataclass(frozen=True)
class Model(Named):
    """A model in Python.

    Attributes
    ----------
    states, inputs, numbers, outputs : what they are
    rates : (t, x, u, p) -> the states' rates, in their order. x.NAME, u.NAME, p.NAME are arrays: numpy's functions, without ``if``,
        are fast; plain Python of one number at a time works as well
    observe : (t, x, u, p) -> the outputs; None: the states of their names
    missing : what it may miss beside the library's effects
    name : of its file, set when it is read
    whole : never
    built_in : what was missing and is put in, with its numbers (``back.put_in``)

    Examples
    --------
    >>> fall = Model([State("v", "m/s")], [], [Number("g", "m/s2", 9.81)], [Output("v", "m/s")], lambda t, x, u, p: [p.g])
    >>> fall.derivatives(0.0, np.zeros((1, 2)), np.zeros((0, 2)), np.array([[9.81, 1.6]]))
    array([[9.81, 1.6 ]])
    """

    states: Sequence[State]
    inputs: Sequence[Input]
    numbers: Sequence[Number]
    outputs: Sequence[Output]
    rates: Rates
    observe: Rates | None = None
    missing: Sequence[Missing] = ()
    name: str = "model"
    whole: bool = False
    built_in: Sequence[tuple[Missing, tuple[float, ...]]] = ()
    _pointwise: list[bool] = field(default_factory=lambda: [False], repr=False)

    def derivatives(self, t: float, x: Array, u: Array, p: Array) -> Array:
        """Of ``System``."""
        return self._called(self.rates, "rates", len(self.states), t, x, u, p)

    def seen(self, t: Array, x: Array, u: Array, p: Array) -> Array:
        """Of ``System``."""
        if self.observe is None:
            at = {s.name: k for k, s in enumerate(self.states)}
            return np.array([x[at[o.name]] for o in self.outputs])
        return self._called(self.observe, "observe", len(self.outputs), t, x, u, p)

    def course(self, t: Array, start: Array, u: Array, p: Array) -> Array:
        """Of ``System``: never asked."""
        raise NotImplementedError

    def _called(self, function: Rates, what: str, count: int, t: Any, x: Array, u: Array, p: Array) -> Array:
        if not self._pointwise[0]:
            try:
                return self._shaped(function(t, *self.arguments(x, u, p)), what, count, x.shape[1:])
            except (TypeError, ValueError):  # an ``if``, or math's functions: one number at a time then
                self._pointwise[0] = True
            except InputError:
                raise
            except Exception as error:
                raise InputError(self.name, what, f"{type(error).__name__}: {error}") from None
        shape = np.broadcast_shapes(x.shape[1:], u.shape[1:], p.shape[1:])
        flat = [np.broadcast_to(a, (len(a), *shape)).reshape(len(a), int(np.prod(shape))) for a in (x, u, p)]
        times = np.broadcast_to(t, shape).ravel()
        found = np.empty((count, flat[0].shape[1]))
        for k in range(found.shape[1]):
            try:
                answer = function(float(times[k]), *self.arguments(*(a[:, k] for a in flat)))
            except ArithmeticError:  # math's functions raise where numpy's give no number
                answer = np.full(count, np.nan)
            except Exception as error:
                raise InputError(self.name, what, f"{type(error).__name__}: {error}") from None
            found[:, k : k + 1] = self._shaped(answer, what, count, ())[:, None]
        return found.reshape(count, *shape)

    def _shaped(self, answer: Any, what: str, count: int, shape: tuple[int, ...]) -> Array:
        if len(answer) != count:
            raise InputError(self.name, what, f"gave {len(answer)} values, expected {count}")
        found = np.empty((count, *shape))
        for row, part in enumerate(answer):
            found[row] = part
        return found


def kinds(system: System) -> tuple[Any, Any, Any]:
    """Tuples with the names of states, inputs and numbers.

    Parameters
    ----------
    system : the model
    """
    those = (("x", system.states), ("u", system.inputs), ("p", system.numbers))
    return tuple(namedtuple(kind, [one.name for one in of]) for kind, of in those)  # pyright: ignore


def check_model(system: System) -> None:
    """Say what is wrong in the lists of a model.

    Parameters
    ----------
    system : the model

    Raises
    ------
    InputError : no output, one that is no state where nothing says how it is seen, a name that is no Python name or there twice, a
        start beyond its bounds
    """
    states = [s.name for s in system.states]
    for output in system.outputs:
        if isinstance(system, Model) and system.observe is None and output.name not in states:
            raise InputError(
                system.name, f"output {output.name}", f"is no state ({', '.join(states)}); give the model an observe"
            )
    if not system.outputs:
        raise InputError(system.name, "outputs", "none; something must be measured")
    for what, those in (("states", system.states), ("inputs", system.inputs), ("numbers", system.numbers)):
        names = [one.name for one in those]
        for name in names:
            if not name.isidentifier() or name.startswith("_"):
                raise InputError(system.name, what, f"{name!r} is no name that Python takes")
            if names.count(name) > 1:
                raise InputError(system.name, what, f"{name!r} stands there twice")
    for number in system.numbers:
        check_bounds(system.name, number)


def check_bounds(path: str, number: Number) -> None:
    """Say that a number begins beyond its bounds.

    Parameters
    ----------
    path : of its file
    number : it

    Raises
    ------
    InputError : it does
    """
    if not number.least <= number.start <= number.most:
        raise InputError(
            path, f"number {number.name}", f"starts at {number.start:g}, outside {number.least:g} to {number.most:g}"
        )


def rate_of(system: System) -> dict[str, str]:
    """State -> the state that is its rate, of equations that say nothing else: they have no physics that could be missing.

    Parameters
    ----------
    system : the model
    """
    if system.whole or not system.states:
        return {}
    # places of no pattern, the same each time
    count = len(system.states) + len(system.inputs) + len(system.numbers)
    spread = np.sin(np.arange(1, count * PROBES + 1) ** 2.0).reshape(count, PROBES) * PROBED_SD
    parts = np.split(spread, [len(system.states), len(system.states) + len(system.inputs)])
    x = np.array([s.start + usual_size(s.start, s.size) * row for s, row in zip(system.states, parts[0], strict=True)])
    p = np.array([np.clip(n.start * (1 + r), n.least, n.most) for n, r in zip(system.numbers, parts[2], strict=True)])
    with np.errstate(all="ignore"):
        rates = system.derivatives(0.0, x, parts[1], p.reshape(len(system.numbers), PROBES))
    found = {}
    for state, rate in zip(system.states, rates, strict=True):
        for other, values in zip(system.states, x, strict=True):
            if np.array_equal(rate, values):
                found[state.name] = other.name
    return found


__all__ = [
    "Input",
    "Missing",
    "Model",
    "Named",
    "Number",
    "Output",
    "State",
    "System",
    "check_bounds",
    "check_model",
    "kinds",
    "rate_of",
    "usual_size",
]
