"""What stands for something that is in no list: any function, by bumps, of a state or of time in an equation, of an input or an
output by its size or by time; any memory of an input or output.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...simulate.model import Array
from ..effects import Parameter
from .library import SHARE, Scales, delayed
from .model import Missing, System

CENTRES = np.linspace(-1.0, 1.0, 5)
"""Of the bumps, in the variable's usual sizes."""
WIDTH = 0.5
"""Of a bump."""
AGO_STEPS = (1.0, 4.0, 16.0)
"""How long ago an input or output may work on, in samples: a choice."""
WORDS = "Something that is in no list."


def bumps(z: Any, numbers: Any) -> Any:
    """Sum of bumps.

    Parameters
    ----------
    z : any shape (..., k)
    numbers : height of each bump, (k,) each
    """
    return sum(n * np.exp(-0.5 * ((z - c) / WIDTH) ** 2) for n, c in zip(numbers, CENTRES, strict=True))


def odd_bumps(z: Any, numbers: Any) -> Any:
    """The same of a function that changes its sign with its variable, as what drags and what pulls back mostly do.

    Parameters
    ----------
    z : any shape (..., k)
    numbers : height of each bump right of zero, (k,) each
    """
    right = CENTRES[CENTRES > 0]
    return sum(
        n * (np.exp(-0.5 * ((z - c) / WIDTH) ** 2) - np.exp(-0.5 * ((z + c) / WIDTH) ** 2))
        for n, c in zip(numbers, right, strict=True)
    )


def free_forms(system: System, kinematic: Mapping[str, str], scales: Scales) -> list[Missing]:
    """For each equation one of each state (two of one above and below zero), input and of time; three for each input and output.

    Parameters
    ----------
    system : the model
    kinematic : of ``model.rate_of``
    scales : of the records
    """
    found = []
    if not system.whole:
        for state in system.states:
            if state.name in kinematic or not scales.rate[state.name]:
                continue
            for other in system.states:
                found.append(_added(state.name, other.name, scales))
                if other.name in scales.turns:
                    found.append(_odd(state.name, other.name, scales))
            for one in system.inputs:
                if scales.input[one.name]:
                    found.append(_driven(state.name, one.name, scales))
            found.append(_pushed(state.name, scales))
    for name, size in scales.input.items():
        if size:
            found.append(_changed(name, size, SHARE * scales.moves[name], name, ""))
            found.append(_remembered(name, scales.step_s, name, ""))
            found.append(_wandered(name, SHARE * scales.moves[name], scales.length_s, name, ""))
    for name, size in scales.output.items():
        found.append(_changed(name, size, SHARE * scales.moves[name], "", name))
        found.append(_remembered(name, scales.step_s, "", name))
        found.append(_wandered(name, SHARE * scales.moves[name], scales.length_s, "", name))
    return found


def _parameters(size: float, count: int = len(CENTRES)) -> tuple[Parameter, ...]:
    return tuple(Parameter(f"bump_{k + 1}", "", size) for k in range(count))


def _added(equation: str, state: str, scales: Scales) -> Missing:
    size = scales.state[state]

    def changes(t: Any, x: Any, u: Any, p: Any, *numbers: Array) -> Array:
        return bumps(getattr(x, state) / size, numbers)

    name = f"free_{equation}_by_{state}"
    return Missing(name, _parameters(SHARE * scales.term[equation]), WORDS, WORDS, changes, equation=equation)


def _odd(equation: str, state: str, scales: Scales) -> Missing:
    size = scales.state[state]

    def changes(t: Any, x: Any, u: Any, p: Any, *numbers: Array) -> Array:
        return odd_bumps(getattr(x, state) / size, numbers)

    numbers = _parameters(SHARE * scales.term[equation], int((CENTRES > 0).sum()))
    return Missing(f"free_{equation}_odd_in_{state}", numbers, WORDS, WORDS, changes, equation=equation)


def _driven(equation: str, name: str, scales: Scales) -> Missing:
    """What an input does beside what it should, times the state."""
    size, own = scales.input[name], scales.state[equation]

    def changes(t: Any, x: Any, u: Any, p: Any, *numbers: Array) -> Array:
        return bumps(getattr(u, name) / size, numbers) * getattr(x, equation) / own

    form = f"free_{equation}_with_{name}"
    return Missing(form, _parameters(SHARE * scales.term[equation]), WORDS, WORDS, changes, equation=equation)


def _pushed(equation: str, scales: Scales) -> Missing:
    """A push that comes and goes with the time from a record's beginning."""

    def changes(t: Any, x: Any, u: Any, p: Any, *numbers: Array) -> Array:
        return bumps(2 * t / scales.length_s - 1, numbers) + 0.0 * getattr(x, equation)

    name = f"free_{equation}_by_time"
    return Missing(name, _parameters(SHARE * scales.term[equation]), WORDS, WORDS, changes, equation=equation)


def _wandered(name: str, height: float, length_s: float, given: str, seen: str) -> Missing:
    """A zero that wanders with the time from a record's beginning."""

    def changes(t: Any, values: Array, *numbers: Array) -> Array:
        return values + bumps(2 * np.asarray(t)[:, None] / length_s - 1, numbers)

    return Missing(f"free_{name}_by_time", _parameters(height), WORDS, WORDS, changes, "", given, seen)


def _changed(name: str, size: float, height: float, given: str, seen: str) -> Missing:
    def changes(t: Any, values: Array, *numbers: Array) -> Array:
        return values + bumps(values / size, numbers)

    return Missing(f"free_{name}", _parameters(height), WORDS, WORDS, changes, "", given, seen)


def _remembered(name: str, step_s: float, given: str, seen: str) -> Missing:
    """What was a while ago, by any weights: whatever follows late."""

    def changes(t: Any, values: Array, *numbers: Array) -> Array:
        late = [n * (delayed(t, values, steps * step_s) - values) for n, steps in zip(numbers, AGO_STEPS, strict=True)]
        return values + sum(late)

    numbers = tuple(Parameter(f"ago_{k + 1}", "", 1.0) for k in range(len(AGO_STEPS)))
    return Missing(f"free_{name}_memory", numbers, WORDS, WORDS, changes, "", given, seen)


__all__ = ["bumps", "free_forms", "odd_bumps"]
