"""The same search for a simulator of one's own: terms of its states, to put into one of its equations.

The user's equation adds ``added(effects, **states)``; the engine then decides which of ``user_terms`` is there, by whole-path fits
(``gap.diagnosed``), as it does for tows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np

from ..effects import Effect, Parameter
from .terms import DRY, NAME, beyond

SHARE = 0.1
"""A missing term is usually this share of what the equation has; a thirtieth of that is as likely (``Effect.sizes``)."""


@dataclass(frozen=True)
class UserTerm:
    """One term.

    Attributes
    ----------
    text : as it is written
    parts : how many pieces it is made of
    value : of the states, each by its usual size
    """

    text: str
    parts: int
    value: Callable[[Mapping[str, Any]], Any]


def _of(name: str) -> list[UserTerm]:
    return [
        UserTerm(f"|{name}|", 2, lambda s: np.abs(s[name])),
        UserTerm(f"{name}^2", 2, lambda s: s[name] ** 2),
        UserTerm(f"{name}|{name}|", 2, lambda s: s[name] * np.abs(s[name])),
        UserTerm(f"{name}^3", 2, lambda s: s[name] ** 3),
        UserTerm(f"{name}^5", 3, lambda s: s[name] ** 5),
        UserTerm(f"sign {name}", 2, lambda s: np.tanh(s[name] / DRY)),
        UserTerm(f"sin {name} - {name}", 2, lambda s: np.sin(s[name]) - s[name]),
        UserTerm(f"tanh {name}", 3, lambda s: np.tanh(s[name])),
        UserTerm(f"beyond {name}", 3, lambda s: beyond(s[name])),
    ]


def _both(one: str, other: str) -> list[UserTerm]:
    return [
        UserTerm(f"{one} {other}^2", 3, lambda s: s[one] * s[other] ** 2),
        UserTerm(f"{one}|{other}|", 3, lambda s: s[one] * np.abs(s[other])),
    ]


def _all(names: Sequence[str]) -> list[UserTerm]:
    found = [UserTerm("1", 1, lambda s: 1.0 + 0.0 * next(iter(s.values())))]
    for name in names:
        found += _of(name)
    for one, other in permutations(names, 2):
        found += _both(one, other)
    return found


def user_terms(usual: Mapping[str, float], size: float, stage: str) -> list[Effect]:
    """The grammar as effects.

    Parameters
    ----------
    usual : state -> its usual size, in its own unit
    size : usual size of what stands in the equation already, in its unit
    stage : what the equation is called

    Returns
    -------
    effects : each with one number, what the term adds where every state has its usual size

    Examples
    --------
    >>> [e.name for e in user_terms({"a": 1.0}, 60.0, "pendulum")][:3]
    ['law 1', 'law |a|', 'law a^2']
    """
    return [
        Effect(
            f"{NAME} {one.text}",
            stage,
            (Parameter("size", "", SHARE * size),),
            f"Something that goes with {one.text}.",
            "Put the term into the equation, or find what makes it.",
            form=0.0,
            cost=float(np.log(2.0)) * one.parts,
            title=f"something that goes with {one.text}",
        )
        for one in _all(list(usual))
    ]


def added(effects: Mapping[str, Sequence[Any]], usual: Mapping[str, float], **states: Any) -> Any:
    """What the terms that a hypothesis holds add to the equation.

    Parameters
    ----------
    effects : effect -> its numbers, as the engine hands them to the user's function
    usual : as of ``user_terms``
    states : of the equation now, arrays that broadcast

    Examples
    --------
    >>> float(added({"law a^2": (3.0,)}, {"a": 2.0}, a=np.array(1.0)))
    0.75
    """
    scaled = {name: states[name] / usual[name] for name in usual}
    total = 0.0
    for one in _all(list(usual)):
        numbers = effects.get(f"{NAME} {one.text}")
        if numbers is not None:
            total = total + numbers[0] * one.value(scaled)
    return total


__all__ = ["UserTerm", "added", "user_terms"]
