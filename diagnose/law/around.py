"""Full fits of laws, and what stands around the best of them: at other places, with other powers, simpler."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..effects import Effect
from ..inference.evidence import Fitted, Inference
from ..inference.ranking import Candidate
from .choose import Start, begun
from .field import is_field
from .functions import AT, NUMBER, POWER, ROUND, WIDE, Range, State, family, freed_text, term, written
from .grammar import ELSEWHERE, forms_alone, waves_and_bumps
from .table import Choice, Table
from .terms import (
    ACTS,
    APART,
    HEEL,
    coefficients_of,
    effect_like,
    inside_of,
    roll_of,
    shapes_from,
    text_of,
    values_of,
)

Form = frozenset[tuple[str, str]]
"""Terms without the numbers inside, each with where it acts."""
SIMPLER = 2
"""Of so many of the best laws everything simpler is fitted, too."""
POWERS, SAME_POWER = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0, 3.5, 4.0, 5.0), 0.12
"""Of a variable, looked at as well; within so much of a fitted one they are the same."""
POWER_COSTS = 3.0
"""A free power is told unless it is so much log evidence behind the fixed one: more than a number costs, it has not been found."""
ALONG, AS_WIDE = (-1.6, -1.2, -0.8, -0.4, 0.0, 0.4, 0.8, 1.2, 1.6), (0.3, 0.5, 0.8)
"""Where a bump may be, and how wide, in usual sizes of its variable: looked at as well."""
OTHER_NUMBERS = (0.5, 0.6, 0.72, 0.85, 1.18, 1.4, 1.65, 2.0)
"""Of waves, by what was fitted."""
OTHERWISE_NEAR = 25.0
"""Other forms are fitted unless the best of them promises so much more log evidence: one step along the path of another form says
little of what begins somewhere."""
MOVED, RESTARTED = 1.4, 2
"""A place counts as another one from this factor on; so many of them are fitted for each term. Choices."""
ENDED_NEAR = 9.0
"""Forms that are further below the best one are not fitted from where they ended: the way is seldom worth more."""
STEPS, TURN = 5, 2
"""Of a law's fit: steps, and after how many of them the random forces are estimated anew."""
AGAIN, REST = 3, 1.0
"""A fit is taken up again at most so often, while its next step promises more log evidence than this."""
OTHER = {"Y": "N", "N": "Y"}
"""Where a term acts instead."""


def fits(inference: Inference, starts: Sequence[Start]) -> tuple[list[Start], list[Fitted]]:
    """These in full, taken up again while a step promises anything; those whose motion runs off are left out.

    Parameters
    ----------
    inference : of the diagnosis
    starts : of ``chosen``
    """
    first = _begun(inference, starts)
    starts, found = [start for start, _ in first], [end for _, end in first]
    for _ in range(AGAIN):
        moving = [k for k, f in enumerate(found) if f.promised > REST]
        if not moving:
            break
        again = [found[k] for k in moving]
        ends = inference.fit([f.hypothesis for f in again], [f.forces for f in again], STEPS, (), begun=again)
        for k, end in zip(moving, ends, strict=True):
            if end.log_evidence - end.promised >= found[k].log_evidence - found[k].promised:
                found[k] = end
    return starts, found


def _begun(inference: Inference, starts: Sequence[Start]) -> list[tuple[Start, Fitted]]:
    """First fits, all together; where one runs off, of each alone.

    Random forces are estimated along the best path of the first steps: about one that a bad step has made they would be as large
    as its error, and hold the fit there.
    """
    try:
        first = inference.fit([s.hypothesis for s in starts], [s.forces for s in starts], TURN, None)
        ends = inference.fit([f.hypothesis for f in first], [f.forces for f in first], STEPS - TURN, (0,), begun=first)
    except EstimationError:
        return [] if len(starts) == 1 else [kept for start in starts for kept in _begun(inference, [start])]
    return list(zip(starts, ends, strict=True))


def _best(starts: Sequence[Start], fitted: Sequence[Fitted]) -> list[tuple[Start, Fitted]]:
    """The best laws with their fits."""
    laws = [(s, f) for s, f in zip(starts, fitted, strict=True) if not is_field(s.effects[0])]
    return sorted(laws, key=lambda one: -(one[1].log_evidence + one[0].log_prior))[:SIMPLER]


def elsewhere(inference: Inference, starts: Sequence[Start], fitted: Sequence[Fitted], seen: Range) -> list[Start]:
    """The best laws with what saturates, begins or stands somewhere at another place, with other waves and other powers: a fit ends
    at the optimum nearest to its start, and a power takes its coefficient along by orders of magnitude.

    Along a law's own path all places (powers) are one table, its other term beside them; the best of them are starts. A fixed power
    becomes a free one: v|v|, v^3 and what lies between are one form, whose power the runs tell. What goes with the place or the
    heading alone may be waves, or a bump, and is looked at as the other, too: where a path is far off each resembles the other.

    Parameters
    ----------
    inference, starts, fitted : of ``fits``
    seen : of the runs
    """
    found: list[Start] = []
    for start, end in _best(starts, fitted):
        parts = list(zip(end.hypothesis.effects, end.hypothesis.numbers, strict=True))
        for k, (effect, numbers) in enumerate(parts):
            own_form, other_form = _moved(effect, numbers, seen), _in_another_form(effect, seen)
            if not (moved := own_form + other_form):
                continue
            others = [*parts[:k], *parts[k + 1 :]]
            roll = roll_of(effect, numbers)
            scores, begin = _looked_at(inference, end, moved, roll, others, start.log_prior, seen)
            order, first = np.argsort(-scores), len(own_form)
            found += [begin(j) for j in [*order[order < first][:RESTARTED], *order[order >= first][:1]]]
    return found


def otherwise(
    inference: Inference, starts: Sequence[Start], fitted: Sequence[Fitted], seen: Range, single: float
) -> list[Start]:
    """The best laws with what goes with drift or yaw rate alone in its other forms, and one term instead of two of one variable.

    A threshold that begins far out is like a high power, and two powers together are like what is one term of another form: where a
    fit has one of them, all the others are looked at along its path, at many places and with many powers.

    Parameters
    ----------
    inference, starts, fitted : of ``fits``
    seen : of the runs
    single : log prior of one term
    """
    found: list[Start] = []
    known = {_form_of(s.effects) for s in starts}
    for start, end in _best(starts, fitted):
        parts = list(zip(end.hypothesis.effects, end.hypothesis.numbers, strict=True))
        variables = [term(text_of(e)).variables for e, _ in parts]
        ways = [(parts[k], [*parts[:k], *parts[k + 1 :]], start.log_prior) for k in range(len(parts))]
        if len(parts) > 1 and variables[0] == variables[1] and (acts := _together([e for e, _ in parts])) is not None:
            ways.append(((effect_like(parts[0][0], text_of(parts[0][0]), acts), parts[0][1]), [], single))
        for (effect, numbers), others, prior in ways:
            one = term(text_of(effect))
            if one.variables not in (("v",), ("r",)) or one.lag_s:
                continue
            forms = [effect_like(effect, text, effect.variant, seen) for text in forms_alone(seen, one.variables[0])]
            scores, begin = _looked_at(inference, end, forms, roll_of(effect, numbers), others, prior, seen)
            for j in np.argsort(-scores):
                form = _form_of([forms[j], *(e for e, _ in others)])
                if scores[j] >= scores.max() - OTHERWISE_NEAR and form not in known:
                    known.add(form)
                    found.append(begin(j))
    return found


def _together(effects: Sequence[Effect]) -> str | None:
    """Where one term would act instead of these; None: one of them acts apart from the other."""
    acts = {effect.variant for effect in effects}
    if len(acts) == 1:
        return acts.pop()
    return None if acts & set(APART) else "Y and N"


def _looked_at(
    inference: Inference,
    end: Fitted,
    moved: Sequence[Effect],
    roll: Array,
    others: Sequence[tuple[Effect, Array]],
    prior: float,
    seen: Range,
) -> tuple[Array, Callable[[int], Start]]:
    """Each of these terms instead of one, beside a law's others, after one step along the law's own path: log evidence of each, and
    where a fit of it begins.

    Parameters
    ----------
    inference : of the diagnosis
    end : the law's fit
    moved : terms
    roll : of what they heel
    others : the law's other terms with their numbers
    prior : log prior of the new laws
    seen : of the runs
    """
    beside = [_at(e, inside_of(e, n), seen) for e, n in others]
    rolls = [*[roll] * len(moved), *(roll_of(e, n) for e, n in others)]
    shapes = [shapes_from(e, one) for e, one in zip((*moved, *beside), rolls, strict=True)]
    along = replace(end.hypothesis, effects=(), numbers=())
    table = Table(inference, along, [*moved, *beside], end.forces, shapes)
    rest = [len(moved) + j for j in range(len(beside))]
    choices = [_chosen(table, [j, *rest]) for j in range(len(moved))]
    scores, forces = table.scores(choices)

    def begin(j: int) -> Start:
        h, solved = table.solved(choices[j], forces[j])
        own = [shapes[j], *shapes[len(moved) :]]
        return begun(h, [moved[j], *beside], solved, own, forces[j], prior, float(scores[j]))

    return scores, begin


def _moved(effect: Effect, numbers: Array, seen: Range) -> list[Effect]:
    """A term that begins at other places, or with other powers, than it has; none where it has neither."""
    inside = inside_of(effect, numbers)
    text = written(text_of(effect), inside)
    free = term(freed_text(text) or text)
    names = [shape.name for shape in free.shapes]
    here = np.array([shape.value for shape in free.shapes]) if free.text != text_of(effect) else inside
    if names in ([AT], [AT, ROUND]):
        places = (share * seen.usual[free.variables[0]] for share in ELSEWHERE)
        return [_at(effect, [x, *here[1:]], seen) for x in places if not 1 / MOVED < x / abs(here[0]) < MOVED]
    if names == [AT, WIDE]:
        usual = seen.usual[free.variables[0]]
        return [_at(effect, [x * usual, wide * usual], seen) for x in ALONG for wide in AS_WIDE]
    if names == [NUMBER]:
        return [_at(effect, [x * here[0]], seen) for x in OTHER_NUMBERS]
    if POWER not in names:
        return []
    at = names.index(POWER)
    powers = [p for p in POWERS if free.text != text or abs(p - here[at]) > SAME_POWER]
    texts = [written(free.text, [*here[:at], p, *here[at + 1 :]]) for p in powers]
    return [effect_like(effect, one, effect.variant, seen) for one in texts]


def _in_another_form(effect: Effect, seen: Range) -> list[Effect]:
    """What goes with the place or the heading alone as waves or bumps, that it is not."""
    one = term(text_of(effect))
    if one.variables not in (("y",), ("beta",)) or one.lag_s or effect.variant == HEEL:
        return []
    own = family(one.text)
    texts = [text for text in waves_and_bumps(seen, one.variables[0]) if family(text) != own]
    return [effect_like(effect, text, effect.variant, seen) for text in texts]


def _chosen(table: Table, members: Sequence[int]) -> Choice:
    """The coefficients of these effects; the numbers inside stay."""
    columns: list[int] = []
    for member in members:
        effect = table.effects[member]
        columns += list(table.columns(member))[: len(coefficients_of(effect))]
    return Choice(tuple(members), tuple(columns), sum(table.effects[m].cost for m in members))


def _at(effect: Effect, shapes: Sequence[float] | Array, seen: Range) -> Effect:
    """A term's effect that begins with other numbers inside."""
    return effect_like(effect, written(text_of(effect), shapes), effect.variant, seen)


def simpler(starts: Sequence[Start], fitted: Sequence[Fitted], single: float) -> list[Start]:
    """What the best laws are without one of their terms, with a term in side force or moment alone, or in the other of the two.

    One step about a path that is not quite the law's own makes more of a second term than there is; and side force and moment at
    one place of the tank resemble each other more than one step can tell.

    Parameters
    ----------
    starts, fitted : of ``fits``
    single : log prior of one term
    """
    known = {_form_of(s.effects) for s in starts}
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
            if (form := _form_of(effects)) not in known:
                known.add(form)
                h = replace(end.hypothesis, effects=effects, numbers=numbers)
                prior = start.log_prior if len(way) == len(parts) else single
                found.append(Start(effects, h, end.forces, prior, end.log_evidence))
    return found


def ended(starts: Sequence[Start], fitted: Sequence[Fitted], seen: Range) -> list[Start]:
    """The best of each form near the best of all, from where its fit has ended.

    What is usual for a number inside a term is told by where its fit began, and so is a usual coefficient. A law that began at its
    own optimum would be held against others that pay for the way to theirs.

    Parameters
    ----------
    starts, fitted : of ``fits``
    seen : of the runs
    """
    weights = [end.worth + start.log_prior for start, end in zip(starts, fitted, strict=True)]
    best: dict[Form, int] = {}
    for k in sorted(range(len(starts)), key=lambda k: -weights[k]):
        if weights[k] >= max(weights) - ENDED_NEAR:
            best.setdefault(_form_of(starts[k].effects), k)
    found = []
    for k in best.values():
        end = fitted[k]
        parts = list(zip(end.hypothesis.effects, end.hypothesis.numbers, strict=True))
        if any(is_field(e) for e, _ in parts) or not any(len(inside_of(e, n)) for e, n in parts):
            continue
        effects = tuple(_at(e, inside_of(e, n), seen) for e, n in parts)
        h = replace(end.hypothesis, effects=effects)
        found.append(Start(effects, h, end.forces, starts[k].log_prior, end.log_evidence))
    return found


def _acting(effect: Effect, numbers: Array, acts: str) -> tuple[Effect, Array]:
    """A term that acts in both, in one of them alone."""
    count = term(text_of(effect)).functions
    first = 0 if acts == "Y" else count
    own = np.concatenate([numbers[first : first + count], numbers[2 * count :]])
    return effect_like(effect, text_of(effect), acts), own


def _instead(effect: Effect, numbers: Array) -> tuple[Effect, Array]:
    """A side force as a moment, or the other way round, none at first."""
    other = effect_like(effect, text_of(effect), OTHER[effect.variant])
    count = term(text_of(effect)).functions
    return other, np.concatenate([np.zeros(count), numbers[count:]])


def _form_of(effects: Sequence[Effect]) -> Form:
    """What fits of laws from several starts have in common."""
    return _named(effects, family)


def _powers_free(effects: Sequence[Effect]) -> Form:
    """What laws have in common that differ by the numbers inside, powers among them."""
    return _named(effects, lambda text: family(freed_text(text) or text))


def _named(effects: Sequence[Effect], form: Callable[[str], str]) -> Form:
    return frozenset((e.name if is_field(e) else form(text_of(e)), e.variant) for e in effects)


def distinct(candidates: Sequence[Candidate]) -> list[tuple[Candidate, list[Candidate]]]:
    """Those whose numbers are numbers, one of each form with what else of that form was fitted.

    Several starts of one form end at one optimum: the best stands for it. A form of a fixed power and the same of a free one are
    one, too, and its weight is that of both together; it is told with the power that the runs tell.

    Parameters
    ----------
    candidates : laws and forces without a form, fitted
    """
    best: dict[Form, Candidate] = {}
    for one in sorted(candidates, key=lambda c: -c.log_evidence):
        if np.isfinite(one.log_evidence):
            best.setdefault(_form_of(one.effects), one)
    alike: dict[Form, list[Candidate]] = {}
    for one in best.values():
        alike.setdefault(_powers_free(one.effects), []).append(one)
    found = []
    for form, members in alike.items():
        surest = max(members, key=lambda c: c.weight)
        free = next(
            (c for c in members if _form_of(c.effects) == form and c.weight > surest.weight - POWER_COSTS), surest
        )
        together = float(np.logaddexp.reduce([c.weight for c in members]))
        one = replace(free, log_prior=together - free.log_evidence)
        found.append((one, [c for c in members if c is not free]))
    return found


def force_of(effects: Sequence[Effect], numbers: Sequence[Array], states: State) -> Array:
    """(3, n) coefficients of side force and moment in states, and a heeling model's marks aside.

    Parameters
    ----------
    effects, numbers : of a law
    states : where
    """
    parts = [values_of(text_of(e), e.variant, n, states) for e, n in zip(effects, numbers, strict=True)]
    return np.sum(parts, axis=0)


__all__ = ["distinct", "elsewhere", "ended", "fits", "force_of", "otherwise", "simpler"]
