"""A hypothesis and its variations as columns: as it stands, and with each of its numbers moved a little."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..simulate.model import Array
from .effects import Effect
from .hypothesis import EFFECT_STEP, Hypothesis
from .tow_rates import OWN, Active, Numbers

STEPS = {"alpha": 1e-5, "beta": 1e-5, "v": 1e-5, "r": 1e-5, "y_b": 1e-4, "beta_b": 1e-4}
RELATIVE_STEP = 1e-4
FIXED = 6 + len(OWN)
IN_RATES = (*range(6), *(6 + OWN.index(name) for name in ("tension", "tow_point", "line", "speed")))
SEEN = tuple(6 + OWN.index(name) for name in ("y_b", "beta_b", "tension", "tow_point", "line", "speed"))
"""Where among the numbers those stand that change the rates, and those that show beside the motion itself."""
PROBE_N = 1e-3
_PROBE = Effect("probe", "sway", (), "", "", force=lambda s, side, moment: (side + 0.0 * s.v_m_s, moment))
"""A force and a moment of PROBE_N (m) each."""


@dataclass(frozen=True)
class Block:
    """Columns of one hypothesis.

    Attributes
    ----------
    six, own, active : as Numbers, with columns from 0
    """

    six: Array
    own: Array
    active: tuple[Active, ...]

    @property
    def width(self) -> int:
        """Columns."""
        return self.six.shape[1]


class Variations:
    """The numbers of a hypothesis (the six derivatives, own, effects) and how far each is moved.

    Parameters
    ----------
    h : the hypothesis
    runs : of the campaign

    Attributes
    ----------
    size : numbers
    steps : (runs, size)
    """

    def __init__(self, h: Hypothesis, runs: int) -> None:
        self._h = h
        self.size = FIXED + h.size
        self.steps = np.ones((runs, self.size))
        self.steps[:, :6] = RELATIVE_STEP * np.maximum(np.abs(h.shared), 1.0)
        for k, name in enumerate(OWN):
            self.steps[:, 6 + k] = STEPS[name] if name in STEPS else RELATIVE_STEP * np.abs(h.own[:, k])
        for effect, _, at in self.each():
            self.steps[:, at : at + len(effect.parameters)] = [EFFECT_STEP * p.sd for p in effect.parameters]

    def each(self) -> Iterator[tuple[Effect, Array, int]]:
        """Effects, their numbers, and where those stand."""
        at = FIXED
        for effect, numbers in zip(self._h.effects, self._h.numbers, strict=True):
            yield effect, numbers, at
            at += len(numbers)

    def pushing(self) -> tuple[int, ...]:
        """Numbers that change the rates otherwise than by a force that can be added."""
        found = list(IN_RATES)
        for effect, numbers, at in self.each():
            works = (effect.coupling, effect.speed, effect.length, effect.offset)
            if any(work is not None for work in works):
                found += range(at, at + len(numbers))
        return tuple(found)

    def seen(self) -> tuple[int, ...]:
        """Numbers that show in what is measured beside the motion they make."""
        found = list(SEEN)
        for effect, numbers, at in self.each():
            works = (effect.length, effect.offset, effect.stretch, effect.observe, effect.clock)
            if any(work is not None for work in works):
                found += range(at, at + len(numbers))
        return tuple(found)

    @property
    def remembers(self) -> bool:
        """Whether what is seen at one time depends on the motion before it."""
        return any(e.remembers and not _absent(e, n) for e, n, _ in self.each())

    def columns(self, moved: Sequence[int], still: int, probed: bool = False) -> Block:
        """As it stands, ``still`` times more the same, each number of ``moved`` moved, and the two probes."""
        first = 1 + still
        width = first + len(moved) + (2 if probed else 0)
        six, own = np.tile(self._h.shared[:, None], (1, width)), np.tile(self._h.own[:, :, None], (1, 1, width))
        for column, k in enumerate(moved, start=first):
            if k < 6:
                six[k, column] += self.steps[0, k]
            elif k < FIXED:
                own[:, k - 6, column] += self.steps[:, k]
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
            active.append(Active(_PROBE, slice(width - 2, width), PROBE_N * np.eye(2)))
        return Block(six, own, tuple(active))

    def start(self, lags_s: tuple[float, ...]) -> tuple[Array, Array]:
        """State at the runs' beginning (states, runs), and its change with every number (states, runs, size)."""
        base = self._h.own[:, :4].T
        change = np.zeros((4, len(self.steps), self.size))
        for k in range(4):
            change[k, :, 6 + k] = 1.0
        rows = [0, 1, 2, 3] + [2, 3] * len(lags_s)
        return base[rows], change[rows]


def _absent(effect: Effect, numbers: Array) -> bool:
    return bool((numbers == [p.none for p in effect.parameters]).all())


def joined(blocks: Sequence[Block], lags_s: tuple[float, ...]) -> tuple[Numbers, list[int]]:
    """Blocks side by side; where each begins."""
    begins = [0, *np.cumsum([b.width for b in blocks])[:-1].tolist()]
    active = [
        replace(a, columns=slice(at + a.columns.start, at + a.columns.stop))
        for b, at in zip(blocks, begins, strict=True)
        for a in b.active
    ]
    six, own = np.concatenate([b.six for b in blocks], axis=1), np.concatenate([b.own for b in blocks], axis=2)
    return Numbers(six, own, tuple(active), lags_s), begins


__all__ = ["FIXED", "PROBE_N", "Block", "Variations", "joined"]
