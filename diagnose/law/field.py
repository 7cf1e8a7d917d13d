"""A missing force without a form: a smooth function of one or two variables of the state, as an effect with many numbers.

A Gaussian process by its first basis functions (Solin and Särkkä, Stat. Comput. 30, 2020): sines over a box somewhat wider than
what the runs have seen, the faster ones the smaller. Side force and moment have a function each; so have, apart from them, a
resistance beyond the straight tow's, and a heel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from typing import Any

import numpy as np

from ...simulate.model import Array
from ..effects import Effect, Parameter, Seen, Situation
from .functions import Range, State
from .terms import ACTING, AHEAD, APART, HEEL, NAME, ROLLS, STAGE, heeled, state_of, state_seen, whole

FIELD = f"{NAME} without a form, of"
"""First words of a field's name; its variables follow."""
WIDER = 1.3
"""The box's half width, over half of what the runs have seen: at its edges the function is nothing."""
SMOOTH = 0.35
"""Length over which a force changes, of the box's half width."""
ALONE, TOGETHER = 8, 5
"""Functions of one variable, and of either of two."""
GROUPS = (
    ("v",), ("r",), ("y",), ("beta",), ("turn",), ("time",),
    ("v", "r"), ("v", "y"), ("r", "y"), ("v", "beta"), ("y", "beta"), ("r", "beta"),
)  # fmt: skip
"""What a force may go with."""
HEELING = (("v",), ("r",), ("beta",), ("turn",), ("v", "r"), ("v", "beta"), ("r", "beta"))
"""What a heel may go with: no place, as ``grammar.HEELS`` says."""


@dataclass(frozen=True)
class Basis:
    """Functions of a group of variables.

    Attributes
    ----------
    variables : one or two
    orders : of the sines, one tuple for each function
    middle, half : the box, by variable
    sd : (k,) prior standard deviations, for a function whose standard deviation in the box's middle is 1
    """

    variables: tuple[str, ...]
    orders: tuple[tuple[int, ...], ...]
    middle: tuple[float, ...]
    half: tuple[float, ...]
    sd: tuple[float, ...]

    def values(self, s: State) -> list[Any]:
        """Of its functions.

        Parameters
        ----------
        s : where
        """
        waves = []
        for name, middle, half in zip(self.variables, self.middle, self.half, strict=True):
            angle = np.pi * np.clip((attrgetter(name)(s) - middle + half) / (2 * half), 0.0, 1.0)
            waves.append({k: np.sin(k * angle) for k in range(1, max(max(o) for o in self.orders) + 1)})
        found = []
        for orders in self.orders:
            one = waves[0][orders[0]]
            for wave, k in zip(waves[1:], orders[1:], strict=True):
                one = one * wave[k]
            found.append(one)
        return found


def basis_of(variables: Sequence[str], seen: Range) -> Basis:
    """Functions of a group of variables.

    Parameters
    ----------
    variables : one or two
    seen : of the runs
    """
    count = ALONE if len(variables) == 1 else TOGETHER
    orders = tuple(product(range(1, count + 1), repeat=len(variables)))
    middle = tuple((seen.low[v] + seen.high[v]) / 2 for v in variables)
    half = tuple(max(WIDER * (seen.high[v] - seen.low[v]) / 2, 1e-9) for v in variables)
    # spectral density of a squared exponential covariance at each sine's frequency
    power = np.array([np.exp(-0.5 * sum((k * np.pi / 2 * SMOOTH) ** 2 for k in o)) for o in orders])
    there = np.array([all(k % 2 for k in o) for o in orders])
    sd = np.sqrt(power / power[there].sum())
    return Basis(tuple(variables), orders, middle, half, tuple(map(float, sd)))


def field_effect(
    groups: Sequence[Sequence[str]], seen: Range, size: float, arm: float, acts: str = "Y and N"
) -> Effect:
    """A force that is a smooth function of each group of variables, added up.

    Parameters
    ----------
    groups : of one or two variables each
    seen : of the runs
    size, arm : usual force by rho/2 U^2 L^2, and usual moment over it, by the length
    acts : a side force and a moment, or one of APART; of a heel ``size`` is the marks' place aside by U^2/g

    Examples
    --------
    >>> span = Range({"y": -0.1}, {"y": 0.1}, {"y": 0.05})
    >>> len(field_effect([("y",)], span, 1e-3, 0.25).parameters)
    16
    """
    bases = [basis_of(group, seen) for group in groups]
    sd = np.concatenate([b.sd for b in bases])
    name = " and ".join(" with ".join(group) for group in groups)
    sizes = {"y": size, "n": size * arm} if acts not in APART else {acts.lower(): size}
    roll = [shape.value for shape in ROLLS]

    def parts(s: Situation, numbers: Sequence[Any]) -> list[Any]:
        return [whole(s) * part for part in field_force(bases, numbers, state_of(s))]

    def force(s: Situation, *numbers: Any) -> tuple[Any, Any]:
        side, moment = parts(s, numbers)
        return side, moment * s.length_pp_m

    def observe(seen: Seen, *numbers: Any) -> tuple[Any, Any, Any, Any]:
        return heeled(seen, field_force(bases, numbers, state_seen(seen))[0], *roll)

    every = dict.fromkeys(v for group in groups for v in group)
    what = ACTING[acts]
    return Effect(
        f"{FIELD} {name}",
        STAGE.get(acts, "sway"),
        tuple(
            Parameter(f"{channel}{k}", "", float(by * one)) for channel, by in sizes.items() for k, one in enumerate(sd)
        ),
        f"A {what} that goes with {name}; as which function the runs say.",
        f"Look for what makes a {what} that goes with it.",
        "towline diagnose --law",
        force=force if acts not in APART else None,
        ahead=(lambda s, *numbers: parts(s, numbers)[0]) if acts == AHEAD else None,
        observe=observe if acts == HEEL else None,
        remembers=acts == HEEL,
        variant=acts if acts in APART else "",
        form=0.0,
        title=f"a {what} that goes with {name}, of no equation",
        reach=tuple((v, seen.low[v], seen.high[v]) for v in every),
    )


def is_field(effect: Effect) -> bool:
    """Whether an effect is a force without a form.

    Parameters
    ----------
    effect : any
    """
    return effect.name.startswith(FIELD)


def is_term(effect: Effect) -> bool:
    """Whether an effect is a term of the grammar.

    Parameters
    ----------
    effect : any
    """
    return effect.name.startswith(f"{NAME} ") and not is_field(effect)


def groups_of(effect: Effect) -> tuple[tuple[str, ...], ...]:
    """What a field goes with.

    Parameters
    ----------
    effect : of ``field_effect``
    """
    return tuple(tuple(name.split(" with ")) for name in effect.name.removeprefix(f"{FIELD} ").split(" and "))


def field_force(bases: Sequence[Basis], numbers: Sequence[Any] | Array, states: State) -> list[Any]:
    """Side force and moment of a field over rho/2 U^2 L^2 (L^3), or a push ahead alone, or a heel's place aside by U^2/g.

    Parameters
    ----------
    bases : of its groups
    numbers : of the first in turn, then of the second
    states : where
    """
    values = [one for basis in bases for one in basis.values(states)]
    found = []
    for first in range(0, len(numbers), len(values)):
        part = 0.0 * states.v
        for number, value in zip(numbers[first : first + len(values)], values, strict=True):
            part = part + number * value
        found.append(part)
    return found


__all__ = [
    "FIELD",
    "GROUPS",
    "HEELING",
    "Basis",
    "basis_of",
    "field_effect",
    "field_force",
    "groups_of",
    "is_field",
    "is_term",
]
