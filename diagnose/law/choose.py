"""What of the grammar is fitted in full: the best of all terms and pairs of the table, and forces without a form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..effects import Effect
from ..inference.evidence import Fitted, Inference
from ..inference.hypothesis import Hypothesis, with_effects
from ..inference.noise import Forces
from ..inference.ranking import P_PAIR, P_SINGLE, P_UNKNOWN
from .field import GROUPS, HEELING, field_effect, groups_of
from .functions import Range, term
from .table import Choice, Table
from .terms import AHEAD, APART, HEEL, effect_like, family_of, shapes_from, text_of

Groups = tuple[tuple[str, ...], ...]
"""Of variables."""
FIRST = 30
"""Terms to which every other one is tried as a second: a choice, for time."""
ALONE, FITTED, FIELDS = 4, 9, 2
"""Hypotheses that are fitted in full: laws of one term at least, all laws, and forces without a form. Choices, for time."""
ACTING, NEAR = 2, 12.0
"""Of one form so many are fitted, acting differently or from other starts; none that is further below the best: for time."""
FIELD_STEPS, FIELD_TURN, FIELD_FORCES = 6, 3, 0.1
"""Of the first fit of a force without a form: steps, after which the random forces are estimated anew, and the share of the base's
that they begin with."""
ARM = 0.25
"""Usual moment over side force, by the length."""
PATH = (("v",), ("r",), ("y",), ("beta",), ("turn",))
"""What the force goes with, all at once, that makes the path."""


@dataclass(frozen=True)
class Start:
    """A hypothesis to be fitted.

    Attributes
    ----------
    effects, hypothesis, forces : where the fit begins
    log_prior : of it
    score : log evidence of one step
    """

    effects: tuple[Effect, ...]
    hypothesis: Hypothesis
    forces: Forces
    log_prior: float
    score: float

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Of its effects, with where they act."""
        return tuple((e.name, e.variant) for e in self.effects)

    @property
    def text(self) -> str:
        """In a word or two."""
        return " + ".join(f"{text_of(e)}" for e in self.effects)


def free_path(inference: Inference, base: Fitted, seen: Range, size: float) -> Fitted:
    """The runs with a force without a form in all variables: its path is near to the truth's, whatever the law. The base where a
    simulation of such a force grows beyond bounds.

    Parameters
    ----------
    inference, base : of the diagnosis
    seen, size : of the runs, and a usual side force
    """
    effect = field_effect(PATH, seen, size, ARM)
    start = with_effects(base.hypothesis, [effect])
    try:
        return inference.fit([start], [base.forces.scaled(FIELD_FORCES)], FIELD_STEPS, (FIELD_TURN,))[0]
    except (EstimationError, np.linalg.LinAlgError):
        return base


class LawTable:
    """Terms and forces without a form, beside one another in one table.

    Parameters
    ----------
    inference, base : of the diagnosis
    along : whose path is looked along
    terms : effects of the grammar, acting in side force and moment, or apart from these
    fields : of ``fields_of``
    roll : period, damping and turning of what heels the model; None: usual ones
    """

    def __init__(
        self,
        inference: Inference,
        along: Fitted,
        base: Fitted,
        terms: Sequence[Effect],
        fields: Sequence[Effect],
        roll: Array | None = None,
    ) -> None:
        start = replace(along.hypothesis, effects=(), numbers=())
        self.terms, self.fields = list(terms), list(fields)
        self.shapes = [shapes_from(effect, roll) for effect in terms]
        begin = [*self.shapes, *(np.zeros(0) for _ in fields)]
        self.table = Table(inference, start, [*terms, *fields], base.forces, begin)
        self.singles: list[tuple[int, str, Choice]] = []
        for k, effect in enumerate(self.terms):
            count, columns = term(text_of(effect)).functions, self.table.columns(k)
            if effect.variant in APART:
                self.singles.append((k, effect.variant, Choice((k,), tuple(columns[:count]), effect.cost)))
                continue
            for acts, part in (
                ("Y", columns[:count]),
                ("N", columns[count : 2 * count]),
                ("Y and N", columns[: 2 * count]),
            ):
                self.singles.append((k, acts, Choice((k,), tuple(part), effect.cost)))
        self.scores, self.forces = self.table.scores([choice for _, _, choice in self.singles])
        first = len(self.terms)
        self.sets = _sets(self.fields)
        self.field_choices = [
            Choice((first + members[0],), tuple(c for k in members for c in self.table.columns(first + k)), 0.0)
            for members in self.sets
        ]
        self.field_scores, self.field_forces = self.table.scores(self.field_choices)

    @property
    def promises(self) -> float:
        """The most log evidence that one step gives one of them."""
        return float(max(self.scores.max(), self.field_scores.max(initial=-np.inf)))

    def goes_with(self) -> tuple[tuple[Groups, float], ...]:
        """Groups of variables and their share of the evidence, wherever the force acts, each set taken as likely beforehand."""
        share = np.exp(self.field_scores - self.field_scores.max())
        found: dict[Groups, float] = {}
        for members, one in zip(self.sets, share / share.sum(), strict=True):
            groups = tuple(group for member in members for group in groups_of(self.fields[member]))
            found[groups] = found.get(groups, 0.0) + float(one)
        return tuple(sorted(found.items(), key=lambda row: -row[1]))

    def pairs(self) -> list[tuple[int, int, Choice]]:
        """The best terms with every other one, as positions in ``singles``; what lags stays alone."""
        families = [family_of(self.terms[k]) for k, _, _ in self.singles]
        alone = [term(text_of(self.terms[k])).lag_s > 0 for k, _, _ in self.singles]
        done: set[tuple[int, int]] = set()
        found = []
        for one in np.argsort(-self.scores)[:FIRST].tolist():
            for two in range(len(self.singles)):
                key = (min(one, two), max(one, two))
                if families[one] == families[two] or alone[one] or alone[two] or key in done:
                    continue
                done.add(key)
                a, b = self.singles[one][2], self.singles[two][2]
                both = Choice(a.effects + b.effects, a.columns + b.columns, a.cost + b.cost)
                found.append((one, two, both))
        return found


def _sets(fields: Sequence[Effect]) -> list[tuple[int, ...]]:
    """Positions of fields: each alone, and two of side force and moment that have no variable in common, added up."""
    aside = [k for k, field in enumerate(fields) if field.variant not in APART]
    of = {k: {variable for group in groups_of(fields[k]) for variable in group} for k in aside}
    return [
        *((k,) for k in range(len(fields))),
        *(pair for pair in combinations(aside, 2) if not of[pair[0]] & of[pair[1]]),
    ]


def fields_of(seen: Range, size: float, ahead: float = 0.0, heel: float = 0.0) -> list[Effect]:
    """A force without a form for each of GROUPS, and what stands beside it.

    Parameters
    ----------
    seen, size : of the runs, and a usual side force
    ahead : a usual resistance beyond the straight tow's: one without a form for each group follows; 0: none does
    heel : a usual place aside of a heeling model's marks, by U^2/g: one without a form for each of HEELING follows; 0: none
    """
    found = [field_effect([group], seen, size, ARM) for group in GROUPS]
    found += [field_effect([group], seen, ahead, ARM, AHEAD) for group in GROUPS if ahead]
    return found + [field_effect([group], seen, heel, ARM, HEEL) for group in HEELING if heel]


def priors(terms: Sequence[Effect], names: int) -> tuple[float, float]:
    """Log priors of a term, whatever the numbers inside it, and of two.

    Parameters
    ----------
    terms : effects of the grammar
    names : how many effects of the library compete
    """
    n = names + len({family_of(e) for e in terms})
    return float(np.log(P_SINGLE / n)), float(np.log(P_PAIR / (n * (n - 1) / 2)))


def chosen(laws: LawTable, single: float, pair: float) -> list[Start]:
    """The best of the table, no two of one form and place, as starts of full fits.

    Parameters
    ----------
    laws : the table
    single, pair : of ``priors``
    """
    pairs = laws.pairs()
    scores, forces = laws.table.scores([choice for _, _, choice in pairs])
    rows = [
        (score + single, single, (k,), choice, f)
        for k, ((_, _, choice), score, f) in enumerate(zip(laws.singles, laws.scores, laws.forces, strict=True))
    ]
    rows += [(score + pair, pair, (a, b), c, f) for (a, b, c), score, f in zip(pairs, scores, forces, strict=True)]
    rows.sort(key=lambda row: -row[0])
    singles = [row for row in rows if len(row[2]) == 1]
    found: list[Start] = []
    done: dict[frozenset[str], int] = {}
    for group, most in ((singles, ALONE), (rows, FITTED)):
        for value, prior, members, choice, force in group:
            form = frozenset(family_of(laws.terms[laws.singles[m][0]]) for m in members)
            start = _start(laws, members, choice, force, prior, value - prior)
            if any(start.names == one.names for one in found):
                continue
            if done.get(form, 0) >= (ACTING if len(members) == 1 else 1):
                continue
            if len(found) == most or value < group[0][0] - NEAR:
                break
            done[form] = done.get(form, 0) + 1
            found.append(start)
    best = np.argsort(-laws.field_scores)[:FIELDS].tolist()
    for k in best:
        h, numbers = laws.table.solved(laws.field_choices[k], laws.field_forces[k])
        effects = [laws.fields[member] for member in laws.sets[k]]
        prior, score = float(np.log(P_UNKNOWN / len(laws.sets))), float(laws.field_scores[k])
        found.append(begun(h, effects, numbers, [np.zeros(0)] * len(effects), laws.field_forces[k], prior, score))
    return found


def _start(laws: LawTable, members: Sequence[int], choice: Choice, forces: Forces, prior: float, score: float) -> Start:
    h, numbers = laws.table.solved(choice, forces)
    parts = [(laws.terms[k], acts, laws.shapes[k]) for k, acts, _ in (laws.singles[member] for member in members)]
    effects = [effect_like(wide, text_of(wide), acts) for wide, acts, _ in parts]
    return begun(h, effects, numbers, [shapes for *_, shapes in parts], forces, prior, score)


def begun(
    h: Hypothesis,
    effects: Sequence[Effect],
    coefficients: Array,
    shapes: Sequence[Array],
    forces: Forces,
    log_prior: float,
    score: float,
) -> Start:
    """A start after a step of a table.

    Parameters
    ----------
    h, coefficients : of ``Table.solved``
    effects, shapes : of the table, and where the numbers of each begin that are no coefficients
    forces, log_prior, score : as of Start
    """
    counts = [len(effect.parameters) - len(own) for effect, own in zip(effects, shapes, strict=True)]
    parts = np.split(coefficients, np.cumsum(counts)[:-1])
    numbers = tuple(np.concatenate([part, own]) for part, own in zip(parts, shapes, strict=True))
    return Start(tuple(effects), replace(h, effects=tuple(effects), numbers=numbers), forces, log_prior, score)


__all__ = ["Groups", "LawTable", "Start", "begun", "chosen", "fields_of", "free_path", "priors"]
