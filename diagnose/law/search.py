"""The search for a missing law: the grammar's terms beside one another, by whole-path fits.

The diagnosis's engine decides (inference): every term is an effect with a price for what it takes to write it, alone or with a
second one, and competes with what the diagnosis's library explains, faults of camera, clock and line among it, with free forms,
and with noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ...simulate.model import GRAVITY_M_S2, Array
from ..effects import Effect
from ..gap import Diagnosis
from ..inference.engine import CONVERGED_GAIN, extended
from ..inference.evidence import Fitted, Inference
from ..inference.hypothesis import Hypothesis
from ..inference.ranking import Candidate, Ranking
from ..tow.towed import TowSimulator
from .around import distinct, elsewhere, fits, force_of, simpler
from .bar import CLEARLY, TOLD, worse_aside
from .choose import ARM, Groups, LawTable, Start, chosen, fields_of, free_path, priors
from .field import FIELD, groups_of
from .functions import Range, State, Term, dimensionless, term, written
from .grammar import grammar, heels, resistances
from .terms import AHEAD, HEEL, NAME, ROLLS, effect_of, inside_of, text_of, values_of

SIDE_SHARE = 0.1
"""Usual force of a missing term: this share of the line's pull; sizes down to a thirtieth are as likely (``Effect.sizes``)."""
AHEAD_SHARE = 0.3
"""Usual resistance beyond a straight tow's, by that: a choice."""
HEEL_M = 0.01
"""Usual sway of a heeling model's marks; sizes down to a thirtieth are as likely (``Effect.sizes``)."""
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


def seen_by(simulator: TowSimulator) -> tuple[State, Range]:
    """The dimensionless state at every mean of the runs, by the measured motion; and its range.

    Parameters
    ----------
    simulator : of the runs
    """
    parts = []
    for run in simulator.runs:
        good = np.isfinite(run.values[:, :2]).all(axis=1)
        t_s, (y, beta) = run.centre_s[good], run.values[good, :2].T
        tow = run.data.tow
        alpha = np.arcsin(np.clip((y + tow.tow_point_m * np.sin(beta)) / tow.line_length_m, -1.0, 1.0))
        v, r = np.gradient(y, t_s) - tow.speed_m_s * beta, np.gradient(beta, t_s)
        turn, time = np.gradient(alpha, t_s) + r, t_s / max(float(t_s[-1]), 1e-9)
        own = (tow.speed_m_s, run.length_pp_m, run.half_width_m)
        state = dimensionless(
            *own, v, r, y, beta, turn_rad_s=turn, time=time, alpha_rad=alpha, tow_point_m=tow.tow_point_m
        )
        parts.append(replace(state, arm=state.arm + 0.0 * t_s))
    every = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(State)}
    moved = {name: x for name, x in every.items() if not name.endswith("_late") and name != "arm"}
    seen = Range(
        {n: float(x.min()) for n, x in moved.items()},
        {n: float(x.max()) for n, x in moved.items()},
        {n: float(np.sqrt(np.mean(x**2))) for n, x in moved.items()},
    )
    return State(**every), seen


def usual_size(simulator: TowSimulator) -> float:
    """Usual side force of a missing term by rho/2 U^2 L^2.

    Parameters
    ----------
    simulator : of the runs
    """
    first = simulator.runs[0]
    size = 0.5 * first.density_kg_m3 * simulator.speed_m_s**2 * first.length_pp_m**2
    return SIDE_SHARE * float(np.mean([run.data.tow.tension_n or 0.0 for run in simulator.runs])) / size


def law_effects(size: float, states: State, seen: Range, terms: Sequence[Term], acts: str = "Y and N") -> list[Effect]:
    """The grammar's terms as effects, each for a side force and a moment, or ahead.

    Parameters
    ----------
    size : a usual side force by rho/2 U^2 L^2; of a heel the marks' usual sway by U^2/g
    states, seen : of ``seen_by``
    terms : of the grammar
    acts : where: "Y and N" or one of APART
    """
    found = []
    for one in terms:
        numbers = [1.0] * one.functions + [shape.value for shape in one.shapes]
        # what a resistance always has is the straight tow's
        spread = np.std if acts == AHEAD else _root_mean_square
        height = float(spread(values_of(one.text, "Y", numbers, states)[0]))
        # a lag's term is as large as a part of the velocity
        height = height if height > 0 else 0.3 * seen.usual[one.variables[0]]
        sd = size / max(height, 1e-9)
        found.append(effect_of(one.text, acts, (sd, ARM * sd, AHEAD_SHARE / SIDE_SHARE * sd, sd), seen.ends))
    return found


def _root_mean_square(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def searched(
    found: Diagnosis,
    names: int,
    conclude: Callable[[Ranking], Diagnosis],
    say: Callable[[str], None] = lambda _: None,
    held: Sequence[int] | None = None,
) -> Searched:
    """Search for the law that diagnosed runs miss.

    Parameters
    ----------
    found : the diagnosis: its fit without effects, its noise and what its library explains are taken over
    names : how many effects compete in it
    conclude : a ranking -> what follows from it (``gap.concluded``)
    say : is told in a sentence what is done
    held : runs kept aside; None: each in turn
    """
    inference, base = found.inference, found.ranking.base
    simulator = inference.simulator
    assert isinstance(simulator, TowSimulator)
    states, seen = seen_by(simulator)
    say("a force without a form")
    size = usual_size(simulator)
    free = free_path(inference, base, seen, size)
    terms = grammar(seen, bool(np.isfinite(simulator.runs[0].half_width_m)))
    effects = law_effects(size, states, seen, terms)
    ahead = 0.0
    if any(run.data.tow.line == "surge" for run in simulator.runs):
        effects += law_effects(size, states, seen, resistances(seen), AHEAD)
        ahead = AHEAD_SHARE / SIDE_SHARE * size
    sway = HEEL_M * GRAVITY_M_S2 / simulator.speed_m_s**2
    effects += law_effects(sway, states, seen, heels(seen), HEEL)
    say(f"{len(effects)} terms and their pairs")
    fields = fields_of(seen, size, ahead, sway)
    single, pair = priors(effects, names)
    fit = _Fits(inference, say)
    table = LawTable(inference, _nearest(base, free, found.ranking), base, effects, fields)
    reached = fit.all("fitting", chosen(table, single, pair))
    if table.promises < base.log_evidence:
        # what made that path gains little, and moved it by much to gain it: no term goes on from there
        other = LawTable(inference, base, base, effects, fields)
        if fit.all("fitting", fit.new(chosen(other, single, pair))) > reached:
            table = other
    if (best := fit.best_law) is not None and (roll := _roll_of(best.hypothesis)) is not None:
        # a table of heels holds for one roll: of the best
        heeling = [effect for effect in effects if effect.variant == HEEL]
        fit.all("rolling as the best", chosen(LawTable(inference, best, base, heeling, [], roll), single, pair))
    fit.all("at another place, with another power", elsewhere(inference, fit.starts, fit.fitted, seen))
    fit.all("simpler", simpler(fit.starts, fit.fitted, single))
    candidates = [
        Candidate(s.effects, f, _worth(f) - base.log_evidence, s.log_prior)
        for s, f in zip(fit.starts, fit.fitted, strict=True)
    ]
    forms = distinct(candidates)
    every = [one for one, _ in forms]
    ranking = extended(inference, _shared(found.ranking, len(table.sets)), every)
    answer = conclude(ranking)
    laws: list[tuple[Candidate, float]] = []
    fields: list[tuple[Candidate, float]] = []
    others: list[tuple[Candidate, float]] = []
    for candidate, probability in zip(ranking.candidates, ranking.named, strict=True):
        kind = laws if is_law(candidate) else fields if is_field(candidate) else others
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
        table.goes_with(),
        worse,
    )


def _shared(ranking: Ranking, fields: int) -> Ranking:
    """The ranking whose free force, where it has one, shares the prior of what is unknown with forces without a form: it is one.

    Parameters
    ----------
    ranking : of the diagnosis
    fields : how many forces without a form there are
    """
    free = ranking.free
    if free is None or not all(effect.force is not None and not effect.bound for effect in free.effects):
        return ranking
    return replace(ranking, free=replace(free, log_prior=free.log_prior - float(np.log(fields))))


class _Fits:
    """Laws and forces without a form that were fitted in full, in turn.

    Parameters
    ----------
    inference : of the diagnosis
    say : is told what is fitted
    """

    def __init__(self, inference: Inference, say: Callable[[str], None]) -> None:
        self._inference, self._say = inference, say
        self.starts: list[Start] = []
        self.fitted: list[Fitted] = []

    def new(self, starts: Sequence[Start]) -> list[Start]:
        """Those of which none of the same terms and numbers inside was fitted.

        Parameters
        ----------
        starts : where fits begin
        """
        done = {start.names for start in self.starts}
        return [start for start in starts if start.names not in done]

    def all(self, why: str, starts: Sequence[Start]) -> float:
        """Fit these, too; the most evidence and prior that one has.

        Parameters
        ----------
        why : in words
        starts : where fits begin
        """
        if not starts:
            return -np.inf
        self._say(f"{why}: " + "; ".join(start.text for start in starts))
        starts, ends = fits(self._inference, starts)
        self.starts += starts
        self.fitted += ends
        return max((_worth(f) + s.log_prior for s, f in zip(starts, ends, strict=True)), default=-np.inf)

    @property
    def best_law(self) -> Fitted | None:
        """The equation with the most evidence and prior; None: none was fitted."""
        laws = [(f, s) for s, f in zip(self.starts, self.fitted, strict=True) if all(map(is_term, s.effects))]
        laws = [(f, s) for f, s in laws if _has_path(f)]
        return max(laws, key=lambda one: _worth(one[0]) + one[1].log_prior)[0] if laws else None


def _nearest(base: Fitted, free: Fitted, ranking: Ranking) -> Fitted:
    """Whose path through the runs is nearest to the true one: of the fit with the most evidence.

    A force without a form follows marks that a rolling model moves, too; what the library explains better has the better path.
    """
    return max((f for f in (base, free, *(c.fitted for c in ranking.candidates)) if _has_path(f)), key=_worth)


def _roll_of(h: Hypothesis) -> Array | None:
    """Period, damping and turning of the model where a law heels it; None: none does.

    Parameters
    ----------
    h : of a law
    """
    return next(
        (n[-len(ROLLS) :] for e, n in zip(h.effects, h.numbers, strict=True) if is_term(e) and e.variant == HEEL), None
    )


def _has_path(fitted: Fitted) -> bool:
    """Whether a table can begin along its path: that of a lawful line, or of a lag, has other states."""
    return not fitted.hypothesis.lawful and not any(e.lag_s for e in fitted.hypothesis.effects)


def is_field(candidate: Candidate) -> bool:
    """Whether it is a force without a form."""
    return all(effect.name.startswith(FIELD) for effect in candidate.effects)


def is_law(candidate: Candidate) -> bool:
    """Whether all its effects are terms of the grammar."""
    return all(is_term(effect) for effect in candidate.effects)


def is_term(effect: Effect) -> bool:
    """Whether it is a term of the grammar."""
    return effect.name.startswith(f"{NAME} ") and not effect.name.startswith(FIELD)


def _pushes(candidate: Candidate) -> bool:
    """Whether all its effects are forces on the hull."""
    return all(effect.stage in ("sway", "yaw") and effect.force is not None for effect in candidate.effects)


def _worth(fitted: Fitted) -> float:
    """Its log evidence, without what a step promises that is not taken yet."""
    return fitted.log_evidence - max(fitted.promised - CONVERGED_GAIN, 0.0)


def _by_place(candidate: Candidate, probability: float, every: Sequence[Candidate]) -> list[tuple[Candidate, float]]:
    """A law with its probability shared with the same terms that act elsewhere: a ranking has one of each name."""
    alike = [c for c in every if c.names == candidate.names]
    log = np.array([c.log_evidence + c.log_prior for c in alike])
    share = np.exp(log - log.max())
    return [(c, probability * float(s)) for c, s in zip(alike, share / share.sum(), strict=True)]


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
    alike = {id(one): others for one, others in forms}
    told = []
    for _, members in groups[:LISTED]:
        simplest = min(members, key=lambda m: (sum(e.cost for e in m[0].effects), -m[1]))[0]
        fitted, at = simplest.fitted, found.inference.fixed(simplest.fitted.hypothesis)
        count = fitted.hypothesis.size
        same = [m for m, _ in members if m is not simplest]
        for member, _ in members:
            same += [c for c in alike.get(id(member), ()) if c.weight > member.weight - WORTH_TELLING]
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
    found = []
    for effect, numbers in zip(fitted.hypothesis.effects, fitted.hypothesis.numbers, strict=True):
        found.append((written(text_of(effect), inside_of(effect, numbers)), effect.variant))
    return tuple(found)


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


__all__ = [
    "Field", "Law", "Searched", "force_of", "is_field", "is_law", "is_term", "law_effects", "searched", "seen_by", "usual_size",
    "without_linear",
]  # fmt: skip
