"""What a search for a missing law found: the laws with their probabilities, the verdict, and what the force goes with.

The best of bad laws is none. It must be more likely than everything else, and follow runs that took no part in its fit at least as
well as a smooth force that knows no form, whose many numbers the other runs had to find: one that is wrong leaves there what its
form cannot follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from ...simulate.model import Array
from ..effects import Effect
from ..gap import Diagnosis
from ..inference.evidence import Fitted
from ..inference.held_out import worse_aside
from ..inference.ranking import Candidate
from .around import force_of
from .choose import Groups
from .field import groups_of, is_field, is_term
from .functions import Range, State, term
from .terms import text_of, written_of

TOLD = 0.5
"""A law is told from this probability on: it is then rather right than wrong."""
CLEARLY = 2.0
"""Kept-aside runs are followed worse if they are by more than so many standard errors."""
SAME_FORCE = 0.03
"""Terms whose forces over the range seen differ by less than this share of them, whatever is linear in v and r left out, are one
law."""
AS_WELL = 0.1
"""A force on the hull of the library's, and a law of at least this share of its probability, are told beside one another."""
WORTH_TELLING = 3.0
"""A form with its power fixed is told beside the free one unless it is so much log evidence behind."""
LISTED = 5
"""Laws that are told."""
Shrinks = dict[tuple[tuple[str, ...], str], float]
"""Names and variant of a row of the ranking -> share of the gap that it takes on runs kept aside."""


@dataclass(frozen=True)
class Law:
    """One or two terms with their coefficients.

    Attributes
    ----------
    fitted : the hypothesis that has it
    covariance : (k, k) of its effects' numbers in turn
    probability : of it and of what is the same over the range seen
    shrink : share of the gap that it takes on runs kept aside, NaN where not worked out
    same : other texts of the same force
    """

    fitted: Fitted
    covariance: Array
    probability: float
    shrink: float
    same: tuple[str, ...]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """As the engine knows its terms."""
        return self.fitted.hypothesis.effects

    @property
    def numbers(self) -> tuple[Array, ...]:
        """Of each term's effect."""
        return self.fitted.hypothesis.numbers

    @property
    def sd(self) -> list[Array]:
        """Standard deviations of ``numbers``."""
        return self.apart(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def terms(self) -> tuple[tuple[str, str], ...]:
        """(text, where it acts) each, with the numbers that were fitted."""
        return _terms(self.fitted)

    @property
    def text(self) -> str:
        """In words a page can show."""
        return _written(self.fitted)

    def apart(self, numbers: Array) -> list[Array]:
        """Numbers of all effects in turn (k,) -> of each.

        Parameters
        ----------
        numbers : (k,)
        """
        return np.split(numbers, np.cumsum([len(n) for n in self.numbers])[:-1])


@dataclass(frozen=True)
class Field:
    """A force without a form.

    Attributes
    ----------
    fitted : the hypothesis that has it
    covariance : (k, k) of its numbers
    groups : of variables, what it goes with; their forces are added up
    probability : of it, among laws, effects of the library and noise
    shrink : share of the gap that it takes on runs kept aside, NaN where not worked out
    """

    fitted: Fitted
    covariance: Array
    groups: Groups
    probability: float
    shrink: float

    @property
    def acts(self) -> str:
        """Where: a side force and a moment, or one of APART."""
        return self.fitted.hypothesis.effects[0].variant or "Y and N"


@dataclass(frozen=True)
class Searched:
    """What the search found.

    Attributes
    ----------
    laws : the most probable first
    p_law : of all laws together
    verdict : "law", "form_open" (laws, none of which is likely enough or follows the runs kept aside), "field" (no equation: a
        force without a form), "no_gap", "other" (effects of the library explain it better) or "unknown"
    other : effects of the library that do, or that explain these runs about as well as a law
    states, seen : of ``seen_by``
    diagnosis : of the engine, behind it
    field : the best force without a form; None where none is missing
    goes_with : groups of variables and their share of the evidence, of forces without a form
    worse_aside : by how many standard errors the best law leaves more of the runs kept aside than the force without a form; NaN
        where neither is there
    """

    laws: tuple[Law, ...]
    p_law: float
    verdict: str
    other: tuple[str, ...]
    states: State
    seen: Range
    diagnosis: Diagnosis
    field: Field | None
    goes_with: tuple[tuple[Groups, float], ...]
    worse_aside: float = float("nan")

    @property
    def acts_with(self) -> tuple[tuple[str, ...], float]:
        """What the missing force goes with, whatever its form, and the probability of that, of laws and forces without a form."""
        found: dict[tuple[str, ...], float] = {}
        for law in self.laws:
            names = {v for effect in law.effects for v in term(text_of(effect)).variables}
            found[tuple(sorted(names))] = found.get(tuple(sorted(names)), 0.0) + law.probability
        if self.field is not None:
            names = tuple(sorted({v for group in self.field.groups for v in group}))
            found[names] = found.get(names, 0.0) + self.field.probability
        return max(found.items(), key=lambda one: one[1]) if found else ((), 0.0)


def answered(
    answer: Diagnosis,
    forms: Sequence[tuple[Candidate, Sequence[Candidate]]],
    held: Sequence[int] | None,
    states: State,
    seen: Range,
    goes_with: tuple[tuple[Groups, float], ...],
) -> Searched:
    """What follows from laws and forces without a form beside what the library explains.

    Parameters
    ----------
    answer : of the ranking that has them all
    forms : of ``around.distinct``
    held : runs kept aside; None: each in turn
    states, seen, goes_with : as of Searched
    """
    inference, ranking = answer.inference, answer.ranking
    every = [one for one, _ in forms]
    laws: list[tuple[Candidate, float]] = []
    fields: list[tuple[Candidate, float]] = []
    others: list[tuple[Candidate, float]] = []
    for candidate, probability in zip(ranking.candidates, ranking.named, strict=True):
        kind = (
            laws
            if all(map(is_term, candidate.effects))
            else fields
            if all(map(is_field, candidate.effects))
            else others
        )
        kind += _by_place(candidate, float(probability), every) if kind is laws else [(candidate, float(probability))]
    laws.sort(key=lambda one: -one[1])
    shares = {"law": laws, "field": fields, "other": others}
    p_of = {kind: sum(p for _, p in part) for kind, part in shares.items()}
    verdict = "no_gap" if answer.file.verdict == "no_gap" else "unknown"
    if verdict == "unknown":
        surest = max(p_of, key=lambda kind: p_of[kind])
        if surest == "other" and _pushes(others[0][0]) and p_of["law"] > AS_WELL * p_of["other"]:
            surest = "law"  # a force of the library's is an equation, too: both are told
        verdict = surest if p_of["law"] + p_of["field"] + p_of["other"] > ranking.p_unknown else "unknown"
    shrinks = {(tuple(row.effects), row.form): row.shrink for row in answer.file.ranking}
    told = _merged(answer, laws, states, shrinks, forms) if verdict in ("law", "field") else []
    worse = float("nan")
    if verdict == "law":
        if fields:
            worse = worse_aside(inference, told[0].fitted, max(fields, key=_evidence_of)[0].fitted, held)
        if told[0].probability < TOLD or worse > CLEARLY:
            verdict = "form_open"
    return Searched(
        tuple(told),
        p_of["law"],
        verdict,
        others[0][0].names if others and (verdict == "other" or others[0][1] > AS_WELL) else (),
        states,
        seen,
        answer,
        _field_of(answer, fields, shrinks) if verdict in ("law", "form_open", "field", "unknown") else None,
        goes_with,
        worse,
    )


def _pushes(candidate: Candidate) -> bool:
    """Whether all its effects are forces on the hull."""
    return all(effect.stage in ("sway", "yaw") and effect.force is not None for effect in candidate.effects)


def _by_place(candidate: Candidate, probability: float, every: Sequence[Candidate]) -> list[tuple[Candidate, float]]:
    """A law with its probability shared with the same terms that act elsewhere: a ranking has one of each name."""
    alike = [c for c in every if c.names == candidate.names]
    return [(c, probability * float(s)) for c, s in zip(alike, softmax([c.weight for c in alike]), strict=True)]


def _evidence_of(one: tuple[Candidate, float]) -> float:
    return one[0].log_evidence


def _field_of(found: Diagnosis, fields: Sequence[tuple[Candidate, float]], shrinks: Shrinks) -> Field | None:
    if not fields:
        return None
    candidate, probability = max(fields, key=_evidence_of)
    fitted, at = candidate.fitted, found.inference.fixed(candidate.fitted.hypothesis)
    own = slice(at, at + fitted.hypothesis.size)
    groups = tuple(group for effect in candidate.effects for group in groups_of(effect))
    shrink = shrinks.get((candidate.names, candidate.variant), float("nan"))
    return Field(fitted, fitted.solved.covariance[own, own], groups, probability, shrink)


def _merged(
    found: Diagnosis,
    laws: Sequence[tuple[Candidate, float]],
    states: State,
    shrinks: Shrinks,
    forms: Sequence[tuple[Candidate, Sequence[Candidate]]],
) -> list[Law]:
    """The laws, those that are one force over the range seen told as one, by the simplest of them."""
    groups: list[tuple[Array, list[tuple[Candidate, float]]]] = []
    for candidate, probability in laws:
        if probability < 1e-3 and groups:
            continue
        force = without_linear(force_of(candidate.effects, candidate.fitted.hypothesis.numbers, states), states)
        for old, members in groups:
            if np.linalg.norm(force - old) < SAME_FORCE * np.linalg.norm(old):
                members.append((candidate, probability))
                break
        else:
            groups.append((force, [(candidate, probability)]))
    alike = {(one.names, one.variant): others for one, others in forms}
    told = []
    for _, members in groups[:LISTED]:
        simplest = min(members, key=lambda m: (sum(e.cost for e in m[0].effects), -m[1]))[0]
        fitted, at = simplest.fitted, found.inference.fixed(simplest.fitted.hypothesis)
        count = fitted.hypothesis.size
        same = [m for m, _ in members if m is not simplest]
        for member, _ in members:
            same += [
                c for c in alike.get((member.names, member.variant), ()) if c.weight > member.weight - WORTH_TELLING
            ]
        told.append(
            Law(
                fitted,
                fitted.solved.covariance[at : at + count, at : at + count],
                sum(p for _, p in members),
                shrinks.get((simplest.names, simplest.variant), float("nan")),
                tuple(_written(m.fitted) for m in same),
            )
        )
    return told


def _terms(fitted: Fitted) -> tuple[tuple[str, str], ...]:
    """(text, where it acts) of each effect, with the numbers that were fitted."""
    h = fitted.hypothesis
    return tuple(
        (written_of(effect, numbers), effect.variant) for effect, numbers in zip(h.effects, h.numbers, strict=True)
    )


def _written(fitted: Fitted) -> str:
    return " + ".join(f"{where}: {text}" for text, where in _terms(fitted))


def without_linear(force: Array, states: State) -> Array:
    """(3, n) the same without what is linear in v and r: the derivatives hold it, but for what a heel has of it.

    Parameters
    ----------
    force : (3, n) of ``force_of``
    states : (n,) where
    """
    plain = np.column_stack([states.v, states.r])
    rest = force[:2] - (plain @ np.linalg.lstsq(plain, force[:2].T, rcond=None)[0]).T
    return np.concatenate([rest, force[2:]])


__all__ = ["Field", "Law", "Searched", "answered", "without_linear"]
