"""A law for a model of one's own: terms of its states, as they are written in an equation, each an effect like any other.

What the library has no name for (a sine instead of an angle, a fifth power, a product of two states) is offered here; which of them
is there the engine decides by whole-path fits, as it does for everything else. Each piece of a term costs a factor of two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np

from ...simulate.model import Array
from ..effects import Parameter
from .library import SHARE, Scales
from .model import Missing, System

NAME = "law"
"""First word of the name of such an effect; the equation and the term follow."""
RADIAN = "rad"
"""Sines are offered of angles alone."""
SHARP = 0.3
"""A hyperbolic tangent is smooth over this share of the usual size."""


@dataclass(frozen=True)
class Term:
    """One term.

    Attributes
    ----------
    text : as it is read
    code : as it is written in Python, of ``x``
    value : (states by name) -> (k,)
    usual : how large it usually is
    parts : how many pieces it is made of
    """

    text: str
    code: str
    value: Callable[[Any], Array]
    usual: float
    parts: int


def laws_for(system: System, kinematic: Mapping[str, str], scales: Scales) -> list[Missing]:
    """Terms for every equation that has physics; none for a model that shows no equation.

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
    >>> [m.name for m in laws_for(tank, {}, sizes)][:3]
    ['law h: |h|', 'law h: h^2', 'law h: h^4']
    """
    if system.whole:
        return []
    units = {state.name: state.unit for state in system.states}
    found = []
    for equation in units:
        if equation in kinematic or scales.rate[equation] <= 0:
            continue
        places = [name for name, rate in kinematic.items() if rate == equation]
        for term in _terms(list(units), units, scales, [equation], places):
            found.append(_missing(equation, term, scales))
    return found


def _missing(equation: str, term: Term, scales: Scales) -> Missing:
    def changes(t: Any, x: Any, u: Any, p: Any, size: Array) -> Array:
        return size * term.value(x)

    words = f"something that goes with {term.text} in {equation}"
    return Missing(
        f"{NAME} {equation}: {term.text}",
        (Parameter("size", "", SHARE * scales.term[equation] / term.usual),),
        f"The equation of {equation} lacks a term with {term.text}.",
        "Put the term into the equation, or find what makes it.",
        changes,
        equation=equation,
        title=words,
        cost=float(np.log(2.0)) * term.parts,
        code=f"size * ({term.code})",
    )


def _terms(
    names: Sequence[str], units: Mapping[str, str], scales: Scales, own: Sequence[str], places: Sequence[str]
) -> list[Term]:
    """What the library has not: a constant, v|v|, v^3 and dry friction of the equation's own state, the cube of a place."""
    found: list[Term] = []
    for name in names:
        size = scales.state[name]
        if not size:
            continue
        found += _of_one(name, size, units[name] == RADIAN, name in own, name in places)
    for one, other in permutations(names, 2):
        if scales.state[one] and scales.state[other]:
            found += _of_two(one, scales.state[one], other, scales.state[other])
    return found


def _of_one(name: str, size: float, angle: bool, own: bool, place: bool) -> list[Term]:
    state = f"x.{name}"

    def power(n: int, text: str) -> Term:
        return Term(text, f"{state} ** {n}", lambda x: getattr(x, name) ** n, size**n, 2 + (n > 3))

    def odd(n: int) -> Term:
        words = f"{name}^{n}" if n > 1 else name
        code = f"{state} ** {n} * np.abs({state})" if n > 1 else f"{state} * np.abs({state})"
        return Term(
            f"{words}|{name}|", code, lambda x: getattr(x, name) ** n * np.abs(getattr(x, name)), size ** (n + 1), 2
        )

    even = Term(f"|{name}|", f"np.abs({state})", lambda x: np.abs(getattr(x, name)), size, 2)
    wide = SHARP * size
    flat = Term(
        f"tanh({name}/{wide:.3g})", f"np.tanh({state} / {wide!r})", lambda x: np.tanh(getattr(x, name) / wide), 1.0, 3
    )
    found = [even, power(2, f"{name}^2"), power(4, f"{name}^4"), power(5, f"{name}^5"), flat]
    if not own:
        found.append(odd(1))
    if not (own or place):
        found.append(power(3, f"{name}^3"))
    if angle:
        text, code = f"sin({name}) - {name}", f"np.sin({state}) - {state}"
        found.append(
            Term(text, code, lambda x: np.sin(getattr(x, name)) - getattr(x, name), abs(np.sin(size) - size), 2)
        )
    return found


def _of_two(one: str, size: float, other: str, far: float) -> list[Term]:
    first, second = f"x.{one}", f"x.{other}"
    squared = Term(
        f"{one} {other}^2",
        f"{first} * {second} ** 2",
        lambda x: getattr(x, one) * getattr(x, other) ** 2,
        size * far**2,
        3,
    )
    moduli = Term(
        f"{one}|{other}|",
        f"{first} * np.abs({second})",
        lambda x: getattr(x, one) * np.abs(getattr(x, other)),
        size * far,
        3,
    )
    found = [squared, moduli]
    if one < other:
        found.append(
            Term(f"{one} {other}", f"{first} * {second}", lambda x: getattr(x, one) * getattr(x, other), size * far, 3)
        )
    return found


__all__ = ["laws_for"]
