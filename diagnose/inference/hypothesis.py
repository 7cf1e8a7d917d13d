"""A hypothesis: the simulator's numbers, each run's own, and the effects it has beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array
from ..effects import Effect, Late

FREE = 1e6
"""Prior standard deviation of a number that the data alone decide."""
EFFECT_STEP = 0.02
"""How far an effect's number is moved for a slope, of its prior standard deviation."""


@dataclass(frozen=True)
class Path:
    """The motion of all runs at all nodes, as a start for the next one.

    Attributes
    ----------
    lates : how the velocities are held back that stand behind the four states
    states : (4 and what is held back, nodes, runs), or 6 and that of a line with a law of its own
    """

    lates: tuple[Late, ...]
    states: Array


@dataclass(frozen=True)
class Hypothesis:
    """The simulator with some effects.

    Attributes
    ----------
    shared : (s,), of all runs: the six linear derivatives at the reference speed, or another simulator's numbers
    own : (runs, k), each run's own numbers
    effects : which
    numbers : per effect (p,)
    path : a motion near its own, or None
    """

    shared: Array
    own: Array
    effects: tuple[Effect, ...] = ()
    numbers: tuple[Array, ...] = ()
    path: Path | None = None

    @property
    def lawful(self) -> bool:
        """Whether an effect is a law of the line's own: its length and the model's surge are states then."""
        return any(e.law is not None for e in self.effects)

    @property
    def size(self) -> int:
        """Numbers of all its effects together."""
        return sum(len(n) for n in self.numbers)


@dataclass(frozen=True)
class Slopes:
    """A hypothesis beside the data.

    Attributes
    ----------
    rows : per run: residual (n, c), slopes (n, c, shared + own + p) of the simulation by shared numbers, own ones, effects
    path : the motion itself, where the simulator keeps one
    carried : (nodes, runs, states, shared + own + p): its change with every number
    """

    rows: list[tuple[Array, Array]]
    path: Path | None = None
    carried: Array | None = None

    def moved(self, shared: Array, own: Array, effects: Array) -> Path | None:
        """The path after a step of shared numbers, (runs, own) ones and the effects', to first order."""
        if self.path is None or self.carried is None:
            return None
        runs = len(own)
        step = np.concatenate([np.tile(shared, (runs, 1)), own, np.tile(effects, (runs, 1))], axis=1)
        return Path(self.path.lates, self.path.states + np.einsum("nrsp,rp->snr", self.carried, step))


def with_effects(h: Hypothesis, effects: Sequence[Effect]) -> Hypothesis:
    """The hypothesis with more effects, absent at first.

    Parameters
    ----------
    h : the hypothesis
    effects : to put in
    """
    numbers = tuple(np.array([q.none for q in e.parameters]) for e in effects)
    return replace(h, effects=(*h.effects, *effects), numbers=(*h.numbers, *numbers))


def in_form(h: Hypothesis, form: Effect) -> Hypothesis:
    """The hypothesis with its effect of the same name in another form: numbers that both forms have stay as they are.

    Parameters
    ----------
    h : with one effect of the form's name
    form : another one of it
    """
    at = [e.name for e in h.effects].index(form.name)
    known = dict(zip((p.name for p in h.effects[at].parameters), h.numbers[at], strict=True))
    numbers = np.array([known.get(p.name, p.none) for p in form.parameters])
    effects, tables = list(h.effects), list(h.numbers)
    effects[at], tables[at] = form, numbers
    return replace(h, effects=tuple(effects), numbers=tuple(tables))


def only(h: Hypothesis, effect: Effect) -> Hypothesis:
    """The hypothesis with one of its effects alone, all numbers as they are.

    Parameters
    ----------
    h : with several
    effect : one of them
    """
    at = h.effects.index(effect)
    return replace(h, effects=(effect,), numbers=(h.numbers[at],))


def form_of(effect: Effect) -> tuple[object, ...]:
    """What an effect changes and where its numbers begin: effects that share it have the same slopes.

    The name is part of it: a simulator of one's own knows its effects by that alone.

    Parameters
    ----------
    effect : of a library, or a free form
    """
    e = effect
    works = (e.force, e.by_pull, e.ahead, e.tension, e.keeps, e.law, e.coupling, e.speed, e.length, e.offset, e.stretch)
    return (
        e.name,
        *works,
        e.clock,
        e.observe,
        e.correct,
        e.when,
        e.late,
        e.remembers,
        *((q.name, q.none) for q in e.parameters),
    )


__all__ = ["EFFECT_STEP", "FREE", "Hypothesis", "Path", "Slopes", "form_of", "in_form", "only", "with_effects"]
