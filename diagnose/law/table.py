"""Every term beside every other one, by one step about a path that a force without a form has made near to the true one.

Terms are linear in their coefficients, and along the right motion one step finds them: all pairs of terms, each at several sizes
and beside several sizes of the random forces, then cost little algebra. What comes out best is fitted in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ...geometry.normal import inverse_of_normal
from ...simulate.model import Array
from ..effects import Effect
from ..inference.evidence import Fitted, Inference, Linear
from ..inference.grams import Grams
from ..inference.hypothesis import Hypothesis, with_effects
from ..inference.noise import Forces

SHARES = (1.0, 0.25, 0.06, 0.015)
"""Of the random forces' sizes, side force and moment apart: the true law leaves small ones."""


@dataclass(frozen=True)
class Choice:
    """Columns that stand for one hypothesis.

    Attributes
    ----------
    effects : positions of its effects in the table
    columns : positions of its numbers among all numbers of the table's effects
    cost : log evidence that it costs
    """

    effects: tuple[int, ...]
    columns: tuple[int, ...]
    cost: float


@dataclass(frozen=True)
class _Reduced:
    """At one noise: information (k, k) and gradient (k,) of all columns, by their prior standard deviations; and no effect's log
    evidence."""

    forces: Forces
    left: Array
    pull: Array
    none: float


class Table:
    """One step of the whole-path fit with all effects at once.

    Parameters
    ----------
    inference : of the runs
    start : a hypothesis without effects, along a path near to the truth's
    effects : whose numbers are nothing at first and the force is linear in
    forces : random forces of the fit without effects
    begin : where the numbers of each begin that are no coefficients; None: at their priors' means
    """

    def __init__(
        self,
        inference: Inference,
        start: Hypothesis,
        effects: Sequence[Effect],
        forces: Forces,
        begin: Sequence[Array] | None = None,
    ) -> None:
        self.effects, self._inference = list(effects), inference
        self._h = with_effects(start, self.effects)
        if begin is not None:
            every = zip(self._h.numbers, begin, strict=True)
            self._h = replace(self._h, numbers=tuple(np.concatenate([n[: len(n) - len(b)], b]) for n, b in every))
        self._linear: Linear = inference.linear([self._h], 0)[0]
        self._grams = Grams(self._linear.columns, inference.noise)
        self._fixed = inference.fixed(start)
        self._begin = np.cumsum([0, *(len(e.parameters) for e in self.effects)])
        self.sd = np.array([p.sd for e in self.effects for p in e.parameters])
        self._at = list(inference.spread(self._reduced, _grid(forces)))

    def columns(self, effect: int) -> range:
        """Of an effect's numbers.

        Parameters
        ----------
        effect : its position
        """
        return range(self._begin[effect], self._begin[effect + 1])

    def _reduced(self, forces: Forces) -> _Reduced:
        inference, fixed = self._inference, self._fixed
        part = inference.reduced(self._grams, self._h, forces)
        prior = inference.priors(replace(self._h, effects=(), numbers=()))
        matrix, right = part.matrix, part.right.copy()
        right[:fixed] += prior.pull
        inner = matrix[:fixed, :fixed] + np.diag(prior.precision)
        inverse = inverse_of_normal(inner)
        cross = matrix[fixed:, :fixed] @ inverse
        left = matrix[fixed:, fixed:] - cross @ matrix[:fixed, fixed:]
        pull = right[fixed:] - cross @ right[:fixed]
        chi_square = part.chi_square + prior.chi_square - float(right[:fixed] @ inverse @ right[:fixed])
        none = -0.5 * (chi_square + part.log + prior.spread + np.linalg.slogdet(inner)[1])
        none += forces.log_prior(inference.simulator.most_force)
        return _Reduced(forces, self.sd[:, None] * left * self.sd, self.sd * pull, none)

    def scores(self, choices: Sequence[Choice]) -> tuple[Array, list[Forces]]:
        """Log evidence of each choice, at its best random forces, and these.

        Parameters
        ----------
        choices : to look at
        """
        best, which = np.full(len(choices), -np.inf), np.zeros(len(choices), dtype=int)
        by_width: dict[int, list[int]] = {}
        for k, choice in enumerate(choices):
            by_width.setdefault(len(choice.columns), []).append(k)
        for at, here in enumerate(self._at):
            for members in by_width.values():
                index = np.array([choices[k].columns for k in members])
                found = here.none + _evidence(
                    here.left[index[:, :, None], index[:, None, :]], here.pull[index], self.sizes(choices[members[0]])
                )
                better = found > best[members]
                where = np.array(members)[better]
                best[where], which[where] = found[better], at
        return best - [c.cost for c in choices], [self._at[k].forces for k in which]

    def sizes(self, choice: Choice) -> tuple[float, ...]:
        """Shares of the priors' sizes that a choice may have."""
        return self.effects[choice.effects[0]].sizes

    @property
    def none(self) -> float:
        """Log evidence of no effect."""
        return max(here.none for here in self._at)

    def solved(self, choice: Choice, forces: Forces) -> tuple[Hypothesis, Array]:
        """The hypothesis after the step with a choice's effects alone, and their numbers (k,).

        Parameters
        ----------
        choice : of ``scores``
        forces : its random forces
        """
        inference, fixed = self._inference, self._fixed
        part = inference.reduced(self._grams, self._h, forces)
        prior = inference.priors(replace(self._h, effects=(), numbers=()))
        kept = np.concatenate([np.arange(fixed), fixed + np.array(choice.columns, dtype=int)])
        matrix, right = part.matrix[np.ix_(kept, kept)].copy(), part.right[kept].copy()
        right[:fixed] += prior.pull
        matrix[np.diag_indices(len(kept))] += np.concatenate([prior.precision, self.sd[list(choice.columns)] ** -2.0])
        found = inverse_of_normal(matrix) @ right
        step = np.zeros(fixed + len(self.sd))
        step[kept] = found
        own = part.own_step(step)
        h = self._h
        path = self._linear.slopes.moved(step[: len(h.shared)], own, step[fixed:])
        moved = replace(h, shared=h.shared + step[: len(h.shared)], own=h.own + own, effects=(), numbers=(), path=path)
        return moved, step[fixed:][list(choice.columns)]


def _grid(forces: Forces) -> list[Forces]:
    return [
        replace(forces, side_n=one * forces.side_n, moment_n_m=two * forces.moment_n_m)
        for one, two in product(SHARES, SHARES)
    ]


def _evidence(left: Array, pull: Array, sizes: Sequence[float]) -> Array:
    """(b,) log evidence of numbers with information (b, k, k) and gradient (b, k) in units of their priors, of any of the sizes."""
    values, vectors = np.linalg.eigh(left)
    values = np.maximum(values, 0.0)
    along = np.einsum("bji,bj->bi", vectors, pull) ** 2
    logs = [
        0.5 * ((share**2 * along / (1 + share**2 * values)) - np.log1p(share**2 * values)).sum(axis=1)
        for share in sizes
    ]
    return np.logaddexp.reduce(logs) - np.log(len(sizes))


__all__ = ["Choice", "Fitted", "Table"]
