"""What of the grammar is fitted in full: the best of all terms and pairs of the table, and forces without a form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..effects import Effect
from ..inference.engine import P_PAIR, P_SINGLE, P_UNKNOWN
from ..inference.evidence import Fitted, Inference
from ..inference.hypothesis import Hypothesis, with_effects
from ..inference.noise import Forces
from ..inference.ranking import Candidate
from .field import FIELD, GROUPS, HEELING, field_effect, groups_of
from .functions import AT, Range, State, family, term, written
from .table import Choice, Table
from .terms import ACTS, AHEAD, APART, HEEL, coefficients_of, effect_of, inside_of, shapes_of, text_of, values_of

Groups = tuple[tuple[str, ...], ...]
"""Of variables."""
FIRST = 30
"""Terms to which every other one is tried as a second: a choice, for time."""
ALONE, FITTED, FIELDS = 4, 9, 2
"""Hypotheses that are fitted in full: laws of one term at least, all laws, and forces without a form. Choices, for time."""
SIMPLER = 2
"""Of so many of the best laws everything simpler is fitted, too."""
ELSEWHERE = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.7, 3.0)
"""Where a term may saturate or begin, in usual sizes of its variable: looked at anew along a fitted law's own path."""
MOVED, RESTARTED = 1.4, 2
"""A place counts as another one from this factor on; so many of them are fitted for each term. Choices."""
ACTING, NEAR = 2, 12.0
"""Of one form so many are fitted, acting differently or from other starts; none that is further below the best: for time."""
FIELD_STEPS, FIELD_TURN, FIELD_FORCES = 6, 3, 0.1
"""Of the first fit of a force without a form: steps, after which the random forces are estimated anew, and the share of the base's
that they begin with."""
STEPS, TURN = 5, 2
"""The same of a law's."""
AGAIN, REST = 3, 1.0
"""A fit is taken up again at most so often, while its next step promises more log evidence than this."""
ARM = 0.25
"""Usual moment over side force, by the length."""
OTHER = {"Y": "N", "N": "Y"}
"""Where a term acts instead."""
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
    """The runs with a force without a form in all variables: its path is near to the truth's, whatever the law.

    Parameters
    ----------
    inference, base : of the diagnosis
    seen, size : of the runs, and a usual side force
    """
    effect = field_effect(PATH, seen, size, ARM)
    start = with_effects(base.hypothesis, [effect])
    return inference.fit([start], [base.forces.scaled(FIELD_FORCES)], FIELD_STEPS, (FIELD_TURN,))[0]


class LawTable:
    """Terms and forces without a form, beside one another in one table.

    Parameters
    ----------
    inference, base : of the diagnosis
    free : of ``free_path``
    terms : effects of the grammar, acting in side force and moment, or apart from these
    fields : of ``fields_of``
    """

    def __init__(
        self, inference: Inference, free: Fitted, base: Fitted, terms: Sequence[Effect], fields: Sequence[Effect]
    ) -> None:
        start = replace(free.hypothesis, effects=(), numbers=())
        self.terms, self.fields = list(terms), list(fields)
        self.table = Table(inference, start, [*terms, *fields], base.forces)
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
        families = [_family(self.terms[k]) for k, _, _ in self.singles]
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


def priors(laws: LawTable, names: int) -> tuple[float, float]:
    """Log priors of a term, whatever the numbers inside it, and of two.

    Parameters
    ----------
    laws : the table
    names : how many effects of the library compete
    """
    n = names + len({_family(e) for e in laws.terms})
    return float(np.log(P_SINGLE / n)), float(np.log(P_PAIR / (n * (n - 1) / 2)))


def chosen(laws: LawTable, names: int) -> list[Start]:
    """The best of the table, no two of one form and place, as starts of full fits.

    Parameters
    ----------
    laws : the table
    names : how many effects of the library compete
    """
    single, pair = priors(laws, names)
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
            form = frozenset(_family(laws.terms[laws.singles[m][0]]) for m in members)
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
        effects = tuple(laws.fields[member] for member in laws.sets[k])
        cuts = np.cumsum([len(e.parameters) for e in effects])[:-1]
        start = replace(h, effects=effects, numbers=tuple(np.split(numbers, cuts)))
        prior = float(np.log(P_UNKNOWN / len(laws.sets)))
        found.append(Start(effects, start, laws.field_forces[k], prior, float(laws.field_scores[k])))
    return found


def _start(laws: LawTable, members: Sequence[int], choice: Choice, forces: Forces, prior: float, score: float) -> Start:
    h, numbers = laws.table.solved(choice, forces)
    effects, values, at = [], [], 0
    for member in members:
        k, acts, own = laws.singles[member]
        wide = laws.terms[k]
        effects.append(effect_of(text_of(wide), acts, _sizes(wide), _reach(wide)))
        shapes = [shape.value for shape in shapes_of(effects[-1])]
        values.append(np.concatenate([numbers[at : at + len(own.columns)], shapes]))
        at += len(own.columns)
    return Start(tuple(effects), replace(h, effects=tuple(effects), numbers=tuple(values)), forces, prior, score)


def fits(inference: Inference, starts: Sequence[Start]) -> tuple[list[Start], list[Fitted]]:
    """These in full, taken up again while a step promises anything; those whose motion runs off are left out.

    Parameters
    ----------
    inference : of the diagnosis
    starts : of ``chosen``
    """
    begun = _begun(inference, starts)
    starts, found = [start for start, _ in begun], [end for _, end in begun]
    for _ in range(AGAIN):
        moving = [k for k, f in enumerate(found) if f.promised > REST]
        if not moving:
            break
        again = [found[k] for k in moving]
        ends = inference.fit([f.hypothesis for f in again], [f.forces for f in again], STEPS, (TURN,), begun=again)
        for k, end in zip(moving, ends, strict=True):
            if end.log_evidence - end.promised >= found[k].log_evidence - found[k].promised:
                found[k] = end
    return starts, found


def _begun(inference: Inference, starts: Sequence[Start]) -> list[tuple[Start, Fitted]]:
    """First fits, all together; where one runs off, of each alone."""
    try:
        ends = inference.fit([s.hypothesis for s in starts], [s.forces for s in starts], STEPS, (TURN,))
    except EstimationError:
        return [] if len(starts) == 1 else [kept for start in starts for kept in _begun(inference, [start])]
    return list(zip(starts, ends, strict=True))


def _best(starts: Sequence[Start], fitted: Sequence[Fitted]) -> list[tuple[Start, Fitted]]:
    """The best laws with their fits."""
    laws = [(s, f) for s, f in zip(starts, fitted, strict=True) if not s.effects[0].name.startswith(FIELD)]
    return sorted(laws, key=lambda one: -(one[1].log_evidence + one[0].log_prior))[:SIMPLER]


def elsewhere(inference: Inference, starts: Sequence[Start], fitted: Sequence[Fitted], seen: Range) -> list[Start]:
    """The best laws with what saturates or begins at another place: a fit ends at the optimum nearest to its start.

    Along a law's own path all places are one table, its other term beside them; the best of them are starts.

    Parameters
    ----------
    inference, starts, fitted : of ``fits``
    seen : of the runs
    """
    found: list[Start] = []
    for start, end in _best(starts, fitted):
        parts = list(zip(end.hypothesis.effects, end.hypothesis.numbers, strict=True))
        for k, (effect, numbers) in enumerate(parts):
            own = term(text_of(effect))
            if [shape.name for shape in own.shapes] != [AT]:
                continue
            usual, here = seen.usual[own.variables[0]], abs(inside_of(effect, numbers)[0])
            places = [x for share in ELSEWHERE if not 1 / MOVED < (x := share * usual) / here < MOVED]
            moved = [_at(effect, [place]) for place in places]
            beside = [_at(e, inside_of(e, n)) for j, (e, n) in enumerate(parts) if j != k]
            along = replace(end.hypothesis, effects=(), numbers=())
            table = Table(inference, along, [*moved, *beside], end.forces)
            rest = [len(moved) + j for j in range(len(beside))]
            choices = [_chosen(table, [j, *rest]) for j in range(len(moved))]
            scores, forces = table.scores(choices)
            for j in np.argsort(-scores)[:RESTARTED].tolist():
                h, solved = table.solved(choices[j], forces[j])
                effects, values, at = [moved[j], *beside], [], 0
                for one in effects:
                    shapes = [shape.value for shape in shapes_of(one)]
                    count = len(coefficients_of(one))
                    values.append(np.concatenate([solved[at : at + count], shapes]))
                    at += count
                begun = replace(h, effects=tuple(effects), numbers=tuple(values))
                found.append(Start(tuple(effects), begun, forces[j], start.log_prior, float(scores[j])))
    return found


def _chosen(table: Table, members: Sequence[int]) -> Choice:
    """The coefficients of these effects; the numbers inside stay."""
    columns: list[int] = []
    for member in members:
        effect = table.effects[member]
        columns += list(table.columns(member))[: len(coefficients_of(effect))]
    return Choice(tuple(members), tuple(columns), sum(table.effects[m].cost for m in members))


def _at(effect: Effect, shapes: Sequence[float] | Array) -> Effect:
    """A term's effect that begins with other numbers inside."""
    return effect_of(written(text_of(effect), shapes), effect.variant, _sizes(effect), _reach(effect))


def _family(effect: Effect) -> str:
    """Of its text; what acts ahead is another force than what acts aside, and a heel is none."""
    return f"{effect.variant} {family(text_of(effect))}" if effect.variant in APART else family(text_of(effect))


def _sizes(effect: Effect) -> tuple[float, ...]:
    """Usual sizes of a term's coefficients; where it does not act, those of where it does."""
    by = {p.name[0]: p.sd for p in coefficients_of(effect)}
    some = next(iter(by.values()))
    return tuple(by.get(channel, some) for channel in "ynxk")


def _reach(effect: Effect) -> dict[str, tuple[float, float]]:
    return {name: (low, high) for name, low, high in effect.reach}


def simpler(starts: Sequence[Start], fitted: Sequence[Fitted], single: float) -> list[Start]:
    """What the best laws are without one of their terms, with a term in side force or moment alone, or in the other of the two.

    One step about a path that is not quite the law's own makes more of a second term than there is; and side force and moment at
    one place of the tank resemble each other more than one step can tell.

    Parameters
    ----------
    starts, fitted : of ``fits``
    single : log prior of one term
    """
    known = {_form(s.effects) for s in starts}
    found: list[Start] = []
    for start, end in _best(starts, fitted):
        parts = list(zip(end.hypothesis.effects, end.hypothesis.numbers, strict=True))
        ways = [[part for k, part in enumerate(parts) if k != gone] for gone in range(len(parts)) if len(parts) > 1]
        for k, (effect, numbers) in enumerate(parts):
            if len(ACTS[effect.variant]) > 1:
                ways += [[*parts[:k], _acting(effect, numbers, acts), *parts[k + 1 :]] for acts in ("Y", "N")]
            elif effect.variant in OTHER:
                ways.append([*parts[:k], _instead(effect, numbers), *parts[k + 1 :]])
        for way in ways:
            effects, numbers = tuple(e for e, _ in way), tuple(n for _, n in way)
            if (form := _form(effects)) not in known:
                known.add(form)
                h = replace(end.hypothesis, effects=effects, numbers=numbers)
                prior = start.log_prior if len(way) == len(parts) else single
                found.append(Start(effects, h, end.forces, prior, end.log_evidence))
    return found


def _acting(effect: Effect, numbers: Array, acts: str) -> tuple[Effect, Array]:
    """A term that acts in both, in one of them alone."""
    count = term(text_of(effect)).functions
    first = 0 if acts == "Y" else count
    own = np.concatenate([numbers[first : first + count], numbers[2 * count :]])
    return effect_of(text_of(effect), acts, _sizes(effect), _reach(effect)), own


def _instead(effect: Effect, numbers: Array) -> tuple[Effect, Array]:
    """A side force as a moment, or the other way round, none at first."""
    other = effect_of(text_of(effect), OTHER[effect.variant], _sizes(effect), _reach(effect))
    count = term(text_of(effect)).functions
    return other, np.concatenate([np.zeros(count), numbers[count:]])


def _form(effects: Sequence[Effect]) -> frozenset[tuple[str, str]]:
    """What fits from several starts have in common."""
    return frozenset((e.name if e.name.startswith(FIELD) else family(text_of(e)), e.variant) for e in effects)


def distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those whose numbers are numbers, the best of each form: several starts of one end at one."""
    best: dict[frozenset[tuple[str, str]], Candidate] = {}
    for one in sorted(candidates, key=lambda c: -c.log_evidence):
        if np.isfinite(one.log_evidence):
            best.setdefault(_form(one.effects), one)
    return list(best.values())


def force_of(effects: Sequence[Effect], numbers: Sequence[Array], states: State) -> Array:
    """(3, n) coefficients of side force and moment in states, and a heeling model's marks aside.

    Parameters
    ----------
    effects, numbers : of a law
    states : where
    """
    parts = [values_of(text_of(e), e.variant, n, states) for e, n in zip(effects, numbers, strict=True)]
    return np.sum(parts, axis=0)


__all__ = [
    "Groups",
    "LawTable",
    "Start",
    "chosen",
    "distinct",
    "elsewhere",
    "fields_of",
    "fits",
    "force_of",
    "free_path",
    "priors",
    "simpler",
]
