"""A hypothesis and its variations as columns: as it stands, and with each of its numbers moved a little."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array
from ..effects import Effect, Late
from ..inference.hypothesis import EFFECT_STEP, Hypothesis
from .columns import AHEAD, LONGER, OWN, SPEED, Active, Numbers, held_from
from .numbers import COMPLIANCE

STEPS = {"alpha": 1e-5, "beta": 1e-5, "v": 1e-5, "r": 1e-5, "y_b": 1e-4, "beta_b": 1e-4, "longer": 1e-5, "ahead": 1e-5}
"""Of the one-sided differences by a run's own numbers: start in m, rad, m/s, rad/s; biases in m and rad."""
RELATIVE_STEP = 1e-4
"""The same of the others, as a share of the number."""
IN_RATES = tuple(OWN.index(name) for name in ("tension", "tow_point", "line", "speed"))
SEEN = tuple(OWN.index(name) for name in ("y_b", "beta_b", "tension", "tow_point", "line", "speed"))
"""Which of the runs' own numbers change the rates, and which show beside the motion itself."""
PROBE_N = 1e-3
"""Of the one-sided differences by a force, N, a moment, N m, and a tension, N."""
_PROBE = Effect("probe", "sway", (), "", "", force=lambda s, side, moment: (side + 0.0 * s.v_m_s, moment))
"""The force and the moment ..."""
_PULL = Effect("pull", "line", (), "", "", tension=lambda s, change: change + 0.0 * s.v_m_s)
"""... the tension ..."""
_AHEAD = Effect("ahead", "line", (), "", "", ahead=lambda s, push: push + 0.0 * s.v_m_s)
"""... and the push ahead, as effects."""
PROBES = 4
"""A force and a moment of PROBE_N (m) each, as much more tension, and as much push ahead."""


@dataclass(frozen=True)
class Block:
    """Columns of one hypothesis.

    Attributes
    ----------
    shared, own, active : as Numbers, with columns from 0
    """

    shared: Array
    own: Array
    active: tuple[Active, ...]

    @property
    def width(self) -> int:
        """Columns."""
        return self.shared.shape[1]


class Variations:
    """The numbers of a hypothesis (shared, own, effects) and how far each is moved.

    Parameters
    ----------
    h : the hypothesis
    runs : of the campaign
    names : of the shared numbers
    celled : whether a load cell says what lines pull with

    Attributes
    ----------
    shared : how many all runs share
    fixed : shared and own ones: what stands before the effects'
    size : numbers
    steps : (runs, size)
    """

    def __init__(self, h: Hypothesis, runs: int, names: Sequence[str], celled: bool = False) -> None:
        self._h, self._celled = h, celled
        self._seen_only = tuple(k for k, name in enumerate(names) if name == COMPLIANCE)
        self.shared = len(h.shared)
        self.fixed = self.shared + len(OWN)
        self.size = self.fixed + h.size
        self.steps = np.ones((runs, self.size))
        self.steps[:, : self.shared] = RELATIVE_STEP * np.maximum(np.abs(h.shared), 1.0)
        for k, name in enumerate(OWN):
            self.steps[:, self.shared + k] = STEPS[name] if name in STEPS else RELATIVE_STEP * np.abs(h.own[:, k])
        for effect, _, at in self.each():
            self.steps[:, at : at + len(effect.parameters)] = [EFFECT_STEP * p.sd for p in effect.parameters]

    def each(self) -> Iterator[tuple[Effect, Array, int]]:
        """Effects, their numbers, and where those stand."""
        at = self.fixed
        for effect, numbers in zip(self._h.effects, self._h.numbers, strict=True):
            yield effect, numbers, at
            at += len(numbers)

    def pushing(self) -> tuple[int, ...]:
        """Numbers that change the rates otherwise than by a force that can be added."""
        found = [k for k in range(self.shared) if k not in self._seen_only]
        found += [self.shared + k for k in IN_RATES]
        for effect, numbers, at in self.each():
            if not only_pushes(effect):
                found += range(at, at + len(numbers))
        return tuple(found)

    def seen(self) -> tuple[int, ...]:
        """Numbers that show in what is measured beside the motion they make."""
        alone = self._seen_only
        if self._celled or any(
            (effect.stretch is not None or effect.observe is not None) and not _absent(effect, numbers)
            for effect, numbers, _ in self.each()
        ):
            # a line that gives does so by its tension, which a load cell and a rolling model show: what changes that shows at once
            alone = tuple(range(self.shared))
        found = [*alone, *(self.shared + k for k in SEEN)]
        for effect, numbers, at in self.each():
            works = (effect.length, effect.offset, effect.stretch, effect.observe, effect.clock, effect.cell)
            if self._celled:
                # a load cell shows at once what pulls, and what pushes a model that the line holds
                works += (effect.force, effect.ahead, effect.tension, effect.keeps, effect.law)
                works += (effect.coupling, effect.speed)
            if any(work is not None for work in works):
                found += range(at, at + len(numbers))
        return tuple(found)

    @property
    def remembers(self) -> bool:
        """Whether what is seen at one time depends on the motion before it."""
        return any(e.remembers and not _absent(e, n) for e, n, _ in self.each())

    def columns(self, moved: Sequence[int], still: int, probed: bool = False) -> Block:
        """As it stands, ``still`` times more the same, each number of ``moved`` moved, and the probes."""
        first = 1 + still
        width = first + len(moved) + (PROBES if probed else 0)
        shared, own = np.tile(self._h.shared[:, None], (1, width)), np.tile(self._h.own[:, :, None], (1, 1, width))
        for column, k in enumerate(moved, start=first):
            if k < self.shared:
                shared[k, column] += self.steps[0, k]
            elif k < self.fixed:
                own[:, k - self.shared, column] += self.steps[:, k]
        active = []
        for effect, numbers, at in self.each():
            if effect.correct is not None:
                continue
            own_columns = {k - at: first + c for c, k in enumerate(moved) if at <= k < at + len(numbers)}
            absent = _absent(effect, numbers)
            # an effect that is absent works only where it is moved
            begin, end = (
                (min(own_columns.values(), default=0), max(own_columns.values(), default=-1) + 1)
                if absent
                else (0, width)
            )
            table = np.tile(numbers[:, None], (1, end - begin))
            for k, column in own_columns.items():
                table[k, column - begin] += self.steps[0, at + k]
            if end > begin:
                active.append(Active(effect, slice(begin, end), table))
        if probed:
            active.append(Active(_PROBE, slice(width - 4, width - 2), PROBE_N * np.eye(2)))
            active.append(Active(_PULL, slice(width - 2, width - 1), np.full((1, 1), PROBE_N)))
            active.append(Active(_AHEAD, slice(width - 1, width), np.full((1, 1), PROBE_N)))
        return Block(shared, own, tuple(active))

    def start(self, lates: tuple[Late, ...]) -> tuple[Array, Array]:
        """State at the runs' beginning (states, runs), and its change with every number (states, runs, size)."""
        own = self._h.own
        base = [own[:, k] for k in range(4)]
        from_own = [(k,) for k in range(4)]
        if self._h.lawful:
            base += [own[:, LONGER], own[:, SPEED] + own[:, AHEAD]]
            from_own += [(LONGER,), (SPEED, AHEAD)]
        held = held_from(lates)
        rows = [*range(len(base)), *held]
        change = np.zeros((len(base), len(self.steps), self.size))
        for state, numbers in enumerate(from_own):
            change[state][:, [self.shared + k for k in numbers]] = 1.0
        first, slope = np.array(base)[rows], change[rows]
        nothing = [len(base) + k for k, one in enumerate(held) if not one]
        first[nothing], slope[nothing] = 0.0, 0.0
        return first, slope


def only_pushes(effect: Effect) -> bool:
    """Whether all that it does to the rates is a force that can be added.

    Parameters
    ----------
    effect : of a hypothesis
    """
    works = (effect.coupling, effect.keeps, effect.law, effect.speed, effect.length, effect.offset)
    return all(work is None for work in works) and not effect.lagging


def _absent(effect: Effect, numbers: Array) -> bool:
    return effect.law is None and bool((numbers == [p.none for p in effect.parameters]).all())


def joined(blocks: Sequence[Block], lates: tuple[Late, ...]) -> tuple[Numbers, list[int]]:
    """Blocks side by side; where each begins.

    Parameters
    ----------
    blocks : columns of the hypotheses
    lates : how velocities are held back
    """
    begins = [0, *np.cumsum([b.width for b in blocks])[:-1].tolist()]
    active = [
        replace(a, columns=slice(at + a.columns.start, at + a.columns.stop))
        for b, at in zip(blocks, begins, strict=True)
        for a in b.active
    ]
    shared, own = np.concatenate([b.shared for b in blocks], axis=1), np.concatenate([b.own for b in blocks], axis=2)
    return Numbers(shared, own, tuple(active), lates), begins


__all__ = ["PROBES", "PROBE_N", "Block", "Variations", "joined", "only_pushes"]
