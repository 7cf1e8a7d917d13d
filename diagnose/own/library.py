"""What any model may miss, written for a model's own inputs, equations and outputs: nothing has to be written by its author."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...simulate.model import Array
from ..effects import Parameter
from .friction import DAMPING, frictions
from .model import Missing, System

SHARE = 0.1
"""What is missing is usually this share of what is there; ``Effect.sizes`` lets it be a thirtieth of that."""
LAG_STEPS, DELAY_STEPS = 5.0, 3.0
"""How many samples a missing lag and a missing delay usually are."""
CLOCK_RATE = 0.01
"""A clock goes usually so much too fast where it does."""


@dataclass(frozen=True)
class Scales:
    """How large things usually are in these records.

    Attributes
    ----------
    state, rate, term : state -> size of it, of its rate, and of the largest term of its rate
    turns : states that are above and below zero
    input, output : name -> largest absolute value
    moves : input or output -> standard deviation
    step_s, length_s : of the records
    """

    state: Mapping[str, float]
    rate: Mapping[str, float]
    term: Mapping[str, float]
    turns: Sequence[str]
    input: Mapping[str, float]
    output: Mapping[str, float]
    moves: Mapping[str, float]
    step_s: float
    length_s: float


def library_for(system: System, kinematic: Mapping[str, str], scales: Scales) -> list[Missing]:
    """Everything that can be offered to a model.

    Parameters
    ----------
    system : the model
    kinematic : of ``model.rate_of``
    scales : of the records

    Examples
    --------
    >>> from .model import Model, Number, Output, State
    >>> tank = Model([State("h", "m")], [], [Number("a", "1/s", 1.0)], [Output("h", "m")], lambda t, x, u, p: [-p.a * x.h])
    >>> sizes = Scales({"h": 1.0}, {"h": 1.0}, {"h": 1.0}, [], {}, {"h": 1.0}, {"h": 0.3}, 0.1, 10.0)
    >>> [m.name for m in library_for(tank, {}, sizes)][:3]
    ['h_constant', 'h_quadratic_damping', 'h_cubic_damping']
    """
    found: list[Missing] = []
    if not system.whole:
        for state in system.states:
            if state.name not in kinematic and scales.rate[state.name] > 0:
                places = [name for name, rate in kinematic.items() if rate == state.name]
                found += _in_equation(state.name, places, scales)
    for one in system.inputs:
        if scales.input[one.name] > 0:
            found += _of_input(one.name, scales, len(system.inputs) > 1)
    for output in system.outputs:
        found += _of_output(output.name, scales, bool(system.inputs) or len(system.outputs) > 1)
    found += _of_clock(scales, len(system.inputs) > 1)
    return found


# in an equation ------------------------------------------------------------------------------------------------------


def _in_equation(v: str, places: Sequence[str], scales: Scales) -> list[Missing]:
    size, rate = scales.state[v], scales.rate[v]
    usual = SHARE * scales.term[v]

    def one(
        name: str,
        what: str,
        physics: str,
        changes: Any,
        code: str,
        scale: float = 1.0,
        cure: str = DAMPING,
        sided: bool = True,
    ) -> Missing:
        number = Parameter("size", "", usual / scale, one_sided=sided)
        return Missing(f"{v}_{name}", (number,), physics, cure, changes, equation=v, title=f"{what} in {v}", code=code)

    def square(t: Any, x: Any, u: Any, p: Any, q: Array) -> Array:
        return -q * getattr(x, v) * np.abs(getattr(x, v))

    def cube(t: Any, x: Any, u: Any, p: Any, q: Array) -> Array:
        return -q * getattr(x, v) ** 3

    def constant(t: Any, x: Any, u: Any, p: Any, b: Array) -> Array:
        return b + 0.0 * getattr(x, v)

    found = [
        one("constant", "a constant", "Something pushes all the time.", constant, "size", sided=False, cure="Add the constant."),
        *(frictions(v, usual, size, rate) if v in scales.turns else ()),  # what always goes one way rubs with a constant
        one("quadratic_damping", "quadratic damping", "It drags with the square of the speed.", square,
            f"-size * x.{v} * np.abs(x.{v})", size**2),
        one("cubic_damping", "cubic damping", "It drags with the cube of the speed.", cube, f"-size * x.{v} ** 3", size**3),
    ]  # fmt: skip
    for place in places:
        found += _stiffness(v, place, usual, scales.state[place], place in scales.turns)
    return found


def _stiffness(v: str, place: str, usual: float, size: float, turns: bool) -> list[Missing]:
    cure = "Add the term to the equation, or find what pulls back."
    one_sided = (
        ("above", "above zero", 1.0),
        ("below", "below zero", -1.0),
    )
    found = [
        Missing(
            f"{v}_cubic_stiffness",
            (Parameter("size", "", usual / size**3),),
            "It pulls back with the cube of the place.",
            cure,
            lambda t, x, u, p, k: -k * getattr(x, place) ** 3,
            equation=v,
            title=f"a cubic stiffness of {place}",
            code=f"-size * x.{place} ** 3",
        )
    ]
    for name, words, side in one_sided if turns else ():
        found.append(
            Missing(
                f"{v}_stiffness_{name}",
                (Parameter("size", "", usual / size),),
                f"It pulls back differently {words}: a stop, a slack part.",
                cure,
                lambda t, x, u, p, k, side=side: -k * side * np.maximum(side * getattr(x, place), 0.0),
                equation=v,
                title=f"a stiffness of {place} {words} only",
                code=f"-size * {side!r} * np.maximum({side!r} * x.{place}, 0.0)",
            )
        )
    return found


# inputs --------------------------------------------------------------------------------------------------------------


def _of_input(name: str, scales: Scales, several: bool) -> list[Missing]:
    largest, moves = scales.input[name], scales.moves[name]
    late = f"a delay of {name}" + ("" if several else ", or an offset between the clocks")
    lag = LAG_STEPS * scales.step_s

    def one(
        what: str, parameter: Parameter, title: str, physics: str, cure: str, changes: Any, code: str, begins: Any = ()
    ) -> Missing:
        return Missing(
            f"{name}_{what}", (parameter,), physics, cure, changes, input=name, title=title, code=code, begins=begins
        )

    return [
        one("scale", Parameter("share", "", SHARE), f"a wrong scale of {name}", "What is asked for is not what comes.",
            "Calibrate it.", lambda t, u, a: u * (1 + a), "u * (1 + share)"),
        one("offset", Parameter("size", "", SHARE * moves), f"a wrong zero of {name}", "Its zero is off.",
            "Read it where it should be nothing.", lambda t, u, b: u + b, "u + size"),
        one("saturation", Parameter("cut", "", 0.3 * largest, one_sided=True), f"a limit of {name}", "It cannot do more.",
            "Limit it in the model, or stay below.", lambda t, u, c: limited(u, largest - c), f"limited(u, {largest!r} - cut)",
            ((0.3 * largest,),)),
        one("backlash", Parameter("width", "", SHARE * largest, one_sided=True), f"play in {name}",
            "It has play: after each turn it stands still for a while.", "Take the play out, or put it into the model.",
            lambda t, u, w: played(u, w), "played(u, width)", ((SHARE * largest,),)),
        one("lag", Parameter("time_s", "s", lag, one_sided=True), f"a first-order lag of {name}", "It follows with a lag.",
            "Put the lag into the model.", lambda t, u, s: lagged(t, u, s), "lagged(t, u, time_s)"),
        one("delay", Parameter("time_s", "s", DELAY_STEPS * scales.step_s), late, "It comes later than it is written down.",
            "Put the delay into the model.", lambda t, u, s: delayed(t, u, s), "delayed(t, u, time_s)"),
    ]  # fmt: skip


def limited(values: Array, most: Any) -> Array:
    """Values cut at both sides.

    Parameters
    ----------
    values : (n, k)
    most : (k,); what is below 0 counts as 0
    """
    top = np.maximum(most, 0.0)
    return np.clip(values, -top, top)


def played(values: Array, width: Any) -> Array:
    """Behind a play: it stands still until what drives it has come to the other side; at first in the middle.

    Parameters
    ----------
    values : (n, k)
    width : (k,) of the play
    """
    half = 0.5 * np.maximum(width, 0.0) + 0.0 * values[0]
    found = np.empty(np.broadcast_shapes(values.shape, (len(values), *half.shape)))
    now = found[0] = values[0] + 0.0 * half
    for index in range(1, len(values)):
        now = np.clip(now, values[index] - half, values[index] + half)
        found[index] = now
    return found


def lagged(t_s: Array, values: Array, time_s: Any) -> Array:
    """Behind a first-order lag, exact for values that go straight from one to the next; at rest at first.

    Parameters
    ----------
    t_s : (n,) even
    values : (n, k)
    time_s : (k,)
    """
    step = t_s[1] - t_s[0]
    share = np.maximum(time_s, 1e-9 * step) / step
    stays = np.exp(-1 / share)
    found = np.empty(np.broadcast_shapes(values.shape, (len(values), *np.shape(share))))
    now = found[0] = values[0] + 0.0 * share
    change = np.diff(values, axis=0)
    for index in range(1, len(values)):
        now = stays * now + (1 - stays) * values[index - 1] + change[index - 1] * (1 - share * (1 - stays))
        found[index] = now
    return found


def delayed(t_s: Array, values: Array, time_s: Any) -> Array:
    """Later, straight between values.

    Parameters
    ----------
    t_s : (n,) even
    values : (n, k)
    time_s : (k,)
    """
    step, n = t_s[1] - t_s[0], len(values)
    at = np.clip(np.arange(n)[:, None] - np.asarray(time_s) / step, 0, n - 1)
    first = np.minimum(at.astype(int), n - 2)
    wide = np.broadcast_to(values, np.broadcast_shapes(values.shape, at.shape))
    before, after = np.take_along_axis(wide, first, 0), np.take_along_axis(wide, first + 1, 0)
    return before + (at - first) * (after - before)


# outputs and clock ---------------------------------------------------------------------------------------------------


def _of_output(name: str, scales: Scales, scaled: bool) -> list[Missing]:
    largest, moves, length = scales.output[name], scales.moves[name], scales.length_s

    def one(
        what: str, parameter: Parameter, title: str, physics: str, cure: str, changes: Any, code: str, begins: Any = ()
    ) -> Missing:
        return Missing(
            f"{name}_{what}", (parameter,), physics, cure, changes, output=name, title=title, code=code, begins=begins
        )

    found = [
        one("offset", Parameter("size", "", SHARE * moves), f"a wrong zero of {name}", "The sensor's zero is off.",
            "Read the sensor at a known value.", lambda t, y, b: y + b, "y + size"),
        one("drift", Parameter("size", "", SHARE * moves), f"a drift of {name}",
            "The sensor's zero moves (by the size over a run).", "Read the sensor at a known value before and after.",
            lambda t, y, b: y + b * (t / length)[:, None],
            f"y + size * (t / {length!r})[:, None]"),
        one("lag", Parameter("time_s", "s", LAG_STEPS * scales.step_s, one_sided=True), f"a first-order lag of {name}",
            "The sensor follows with a lag.", "Put the lag into the model.",
            lambda t, y, s: lagged(t, y, s), "lagged(t, y, time_s)"),
        one("saturation", Parameter("cut", "", 0.3 * largest, one_sided=True), f"a limit of {name}", "The sensor shows no more.",
            "Take a sensor of a wider range.", lambda t, y, c: limited(y, largest - c), f"limited(y, {largest!r} - cut)",
            ((0.3 * largest,),)),
    ]  # fmt: skip
    if scaled:
        found.append(
            one("scale", Parameter("share", "", SHARE), f"a wrong scale of {name}", "The sensor's scale is off.",
                "Calibrate the sensor.", lambda t, y, a: y * (1 + a), "y * (1 + share)")
        )  # fmt: skip
    return found


def _of_clock(scales: Scales, driven: bool) -> list[Missing]:
    rate = Missing(
        "clock_rate",
        (Parameter("share", "", CLOCK_RATE),),
        "The samples come at another rate than stated.",
        "Record a clock.",
        lambda t, r: r * t,
        title="a clock of another rate",
        code="share * t",
    )
    offset = Missing(
        "clock_offset",
        (Parameter("time_s", "s", DELAY_STEPS * scales.step_s),),
        "What is measured is read at another time than the inputs.",
        "Record both by one clock.",
        lambda t, d: d + 0.0 * t,
        title="an offset between the clocks of inputs and outputs",
        code="time_s + 0.0 * t",
    )
    return [rate, *([offset] if driven else [])]


__all__ = ["Scales", "delayed", "lagged", "library_for", "limited", "played"]
