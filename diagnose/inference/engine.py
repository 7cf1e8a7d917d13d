"""The diagnosis: which effect explains the gap, how sure, and what cannot be told apart (gap.md).

Base fit, screening of every effect by its score, full fits of the best, pairs on top of the best, free forms for what is in no
library; probabilities from evidence with half of the prior on no gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from ...record.errors import EstimationError
from ..effects import Effect
from .begun import FAR_BEHIND, End, ends_from, ends_unlike, first_fit
from .diagnosable import Diagnosable
from .disagree import disagreement
from .evidence import CONVERGED_GAIN, Fitted, Inference
from .hypothesis import Hypothesis, with_effects
from .inexact import could_gain, shared_out, told_apart
from .noise import Forces
from .ranking import Candidate, Ranking
from .scan import Leftover, leftover, standing_out
from .screen import Screened, screened
from .simulator import Simulator
from .spread import Spread, one_by_one

P_NO_GAP, P_SINGLE, P_PAIR, P_UNKNOWN = 0.5, 0.36, 0.07, 0.07
"""Prior shares."""
TRIED_SINGLE, TRIED_PAID, TRIED_PAIR, SIBLINGS, RIVALS = 6, 4, 3, 3, 2
"""How many are fitted in full, the best by their scores: single effects, as they are seen and as they are paid, second effects of a
pair, and further variants of each of so many best effects. Choices, for time."""
REFIT_STEPS, GROSS_STEPS = 3, 5
"""Gauss-Newton steps: of a refinement, and of the first fit of an effect where scores are very large."""
AT_MOST = 0.9
"""A fit whose random forces exceed this share of the largest that counts as noise explains nothing."""
SMALL_FORCES = 0.05
"""A refinement also starts from random forces of this share of those estimated."""
SCANNED, SCANNED_BELOW = 4, 12.0
"""So many effects have their residuals searched for something left over, if log evidence and prior are within this of the best."""
SHORT_STEPS = 10
"""Of a refinement whose steps only lose: each is three tenths of the last."""
GROSS = 200.0
"""Scores above this are very large: a choice."""
LEFT_OVER_BY, TRIED_FREE = 2, 2
"""So many of the best candidates have what they leave searched by free forms, so many of these fitted. Choices, for time."""
WORTH_PAIRS = 3.0
"""A second effect is fitted only if its score promises more log evidence than this."""
WORTH_PAIRS_BELOW = 30.0
"""Pairs are tried on the second best effect only if it comes this near to the best."""
FORCES_ALIKE = 0.15
"""Of what a force on the hull explains, so much another one may take beside it without being there: what a force's form leaves over
is a force. Of 22 campaigns of the blind check (seeds 271129 to 271131) with one effect and a wrong second one that gained more than
4, seven had two forces, of which the wrong one took 3 to 13 %; with two forces that were there the second took 67 %.
"""
ALIKE_IN_ALL = 0.3
"""Of what an effect's own form may leave over, so much may be numbers that differ from run to run: what a form leaves is much the
same in all tows. Of 26 effects and pairs of the blind check (seed 271133) that were fitted as they are, many of them in no form of
the library, 22 showed nothing of it; a heavy line in a form of a user's own 0.9 % of what it explains; with the effect that is
there taken out of the library it was up to a twentieth.
"""
MOST_REFINEMENTS, BASE_REFINEMENTS = 5, 15
"""A fit is refined at most so often, and the base, which all others are held against."""
RUNS_AWAY = "no motion with it follows these runs"
"""Of an effect that was begun from the measured motion and is far behind, or whose motion runs off where it is begun."""
STILL_GOING = 2
"""So many fits that are not at their end are gone on with beside the best few."""
WORTH_REFINING = 0.3
"""A free form is refined only if its log evidence is at least this share of the best effect's."""
TWINS = 3.0
"""Effects within this log evidence of the best are not told from it."""
CLEAR = 3.0
"""The headline must beat no gap by this."""
Progress = Callable[[str], None]


def ranked(
    simulator: Diagnosable, library: Sequence[Effect], progress: Progress | None = None, spread: Spread = one_by_one
) -> tuple[Diagnosable, Inference, Ranking]:
    """Rank every effect and pair.

    Parameters
    ----------
    simulator : with its runs
    library : effects to try
    progress : is told in a sentence what is done
    spread : does what is independent

    Returns
    -------
    simulator : with the noise that its runs show
    inference, ranking : of it

    Raises
    ------
    EstimationError : the base cannot be fitted
    """
    say = progress or (lambda _: None)
    say("the simulator as it is")
    first = first_fit(simulator, spread)
    inference = Inference(simulator, simulator.noise(first.hypothesis), spread)
    base = _settled(inference, _refined(inference, inference.fit([first.hypothesis], [first.forces], 2, (0,)))[0])
    if base.promised >= CONVERGED_GAIN and not base.forces.follow(simulator.most_force):
        inference, base = _begun_anew(inference, base)
    unlike = ends_unlike(simulator, base, spread)
    if unlike and unlike[0].log_evidence > base.log_evidence:
        # the base cannot follow these runs: what random forces do is about a hull that can
        inference, base = _based_anew(simulator, unlike[0].hypothesis, base, spread)
    # beside lines with a law of their own, held against the noise as it was granted, it stays so
    quiet = simulator if unlike else simulator.as_quiet_as(inference, base)
    if quiet is not simulator:
        simulator = quiet
        inference, base = _based_anew(quiet, base.hypothesis, base, spread)
    usable, excluded = simulator.usable(library)
    usable = [*usable, *simulator.suggested(base)]
    say(f"{len(usable)} effects by their scores")
    names = {e.name for e in usable}
    free = [*simulator.free_forms(standing_out(inference, base)), *simulator.one_off(inference, base)]
    scores = screened(inference, base, [*usable, *free])
    singles = _best_variants(scores.seen, usable, TRIED_SINGLE)
    # beside random forces most of what stands out is noise: what does not, may lie behind six that do
    singles += [e for e in _best_variants(scores.paid, usable, TRIED_PAID) if all(e is not one for one in singles)]
    best_free = _best_variants(scores.seen, free, 2)
    say("fitting " + ", ".join(dict.fromkeys(e.name for e in singles)))
    gross = max(scores.seen.values(), default=0.0) > GROSS
    starts = [] if base.forces.follow(simulator.most_force) else simulator.starts()
    ahead = unlike[0].log_evidence if unlike else -np.inf
    fitted = _fit_all(inference, base, [(e,) for e in (*singles, *best_free)], gross, starts, ahead)
    single_prior, forms = np.log(P_SINGLE / max(len(names), 1)), _of_forms(scores.paid, usable)
    candidates = [
        Candidate(effects, f, f.worth - base.log_evidence, single_prior + forms[effects[0].name])
        for effects, f in fitted
        if effects[0] not in free
    ]
    candidates += _as_candidates(inference, base, unlike, single_prior)
    free_found = [
        Candidate(effects, f, f.worth - base.log_evidence, np.log(P_UNKNOWN))
        for effects, f in fitted
        if effects[0] in free
    ]
    candidates += _siblings(inference, base, candidates, usable, scores, gross)
    candidates.sort(key=lambda c: -c.log_evidence)
    candidates = _converged(inference, candidates, base)
    candidates += _pairs(inference, candidates, base, usable, simulator.suggested, len(names), say, gross, forms)
    free_form = _best_free(inference, base, free_found, candidates[0].log_evidence if candidates else 0.0)
    beside = _beside(inference, candidates, base, simulator.free_beside(), say)
    followed = {name for c in candidates for name in c.names}
    begun = [*(end.hypothesis.effects[0].name for end in unlike), *(e.name for e in singles)]
    excluded |= {name: RUNS_AWAY for name in begun if name not in followed}
    return (
        simulator,
        inference,
        shared_out(inference, _ranking(inference, base, candidates, free_form, beside, excluded)),
    )


def _best_free(inference: Inference, base: Fitted, found: Sequence[Candidate], best: float) -> Candidate | None:
    """The best free form; those that may come near to the ``best`` log evidence are refined: many shapes take many steps."""
    ends = []
    for c in found:
        if np.isfinite(_hoped(c, base)) and _hoped(c, base) > max(CLEAR, WORTH_REFINING * best):
            c = _converged(inference, [c], base)[0]
        ends.append(c)
    return max(ends, key=lambda c: c.log_evidence, default=None)


def extended(inference: Inference, ranking: Ranking, candidates: Sequence[Candidate]) -> Ranking:
    """The ranking with candidates of one's own beside those that it has, fitted with the same noise.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    ranking : of ``ranked``
    candidates : more of them; log evidence over the same base's
    """
    every = [*ranking.candidates, *candidates]
    return shared_out(
        inference, _ranking(inference, ranking.base, every, ranking.free, ranking.beside, ranking.excluded)
    )


def _as_candidates(inference: Inference, base: Fitted, unlike: Sequence[End], single_prior: float) -> list[Candidate]:
    """These with the noise of all others, without those that are far behind, and behind the base."""
    found, behind = [], max([base.log_evidence, *(end.log_evidence for end in unlike)]) - FAR_BEHIND
    for end in unlike:
        if end.log_evidence < min(behind, base.log_evidence):
            continue
        try:
            fitted = inference.fit([end.hypothesis], [end.forces], REFIT_STEPS, (1,))[0]
        except EstimationError:
            continue
        # one that has run off beyond all numbers is none
        if np.isfinite(fitted.worth):
            found.append(Candidate(end.hypothesis.effects, fitted, fitted.worth - base.log_evidence, single_prior))
    return found


def _based_anew(simulator: Simulator, about: Hypothesis, base: Fitted, spread: Spread) -> tuple[Inference, Fitted]:
    """The base fitted beside the simulator's noise about another hypothesis, or beside another simulator's."""
    inference = Inference(simulator, simulator.noise(about), spread)
    return inference, _settled(inference, inference.fit([base.hypothesis], [base.forces], 2, (0,))[0])


def _begun_anew(inference: Inference, base: Fitted) -> tuple[Inference, Fitted]:
    """The base from where fits begin, by the noise that is known now: what stands where no step gains though the next one promises
    much has scores that mean nothing.
    """
    simulator = inference.simulator
    end = ends_from(inference, simulator.starts(), [()], base.log_evidence - base.promised)[0]
    if end is None or end.worth < base.worth + CONVERGED_GAIN:
        return inference, base
    return _based_anew(simulator, end.hypothesis, end, inference.spread)


def _settled(inference: Inference, base: Fitted) -> Fitted:
    """The same, refined until its next step promises nothing, or no step gains any more."""
    for _ in range(BASE_REFINEMENTS):
        better = _refined(inference, [base])[0] if base.promised >= CONVERGED_GAIN else base
        if better is base:
            break
        base = better
    return base


def _siblings(
    inference: Inference,
    base: Fitted,
    candidates: Sequence[Candidate],
    usable: Sequence[Effect],
    scores: Screened,
    gross: bool,
) -> list[Candidate]:
    """Other variants of the best effects: a score is one step's, and they are near to one another; where two effects are near to
    one another, neither is told by the form that happened to be fitted.
    """
    order = sorted(candidates, key=lambda c: -c.log_evidence)
    near = [c for c in order[:RIVALS] if c.log_evidence > max(CLEAR, order[0].log_evidence - WORTH_PAIRS_BELOW)]
    others: dict[str, tuple[Effect, float]] = {}
    done = {c.effects[0].label for c in candidates}
    for best in near:
        alike = [e for e in usable if e.name == best.names[0] and e.label not in done]
        for by_label in (scores.seen, scores.paid):
            for effect in sorted(alike, key=lambda e: -by_label[e.label])[:SIBLINGS]:
                others[effect.label] = effect, best.log_prior
    fitted = _fit_all(inference, base, [(e,) for e, _ in others.values()], gross) if others else []
    return [Candidate(effects, f, f.worth - base.log_evidence, others[effects[0].label][1]) for effects, f in fitted]


def _converged(inference: Inference, candidates: list[Candidate], base: Fitted) -> list[Candidate]:
    """The best few, and those that are still on their way to something better, refined until they converge: only then can they be
    compared with a pair, which starts from them.
    """
    few = [c for c in candidates[:3] if c.log_evidence > max(CLEAR, candidates[0].log_evidence - WORTH_PAIRS_BELOW)]
    best = max((c.log_evidence for c in few), default=CLEAR)
    going = sorted((c for c in candidates if all(c is not one for one in few)), key=lambda c: -_hoped(c, base))
    few += [c for c in going[:STILL_GOING] if np.isfinite(_hoped(c, base)) and _hoped(c, base) > best]
    if not few:
        return candidates
    fitted, moving = [c.fitted for c in few], list(range(len(few)))
    for _ in range(MOST_REFINEMENTS):
        before = list(fitted)
        for k, better in zip(moving, _refined(inference, [fitted[k] for k in moving]), strict=True):
            fitted[k] = better
        moving = [k for k in moving if fitted[k].log_evidence - before[k].log_evidence >= CONVERGED_GAIN]
        if not moving:
            break
    better = [replace(c, fitted=f, log_evidence=f.worth - base.log_evidence) for c, f in zip(few, fitted, strict=True)]
    rest = [c for c in candidates if all(c is not one for one in few)]
    return sorted((*better, *rest), key=lambda c: -c.log_evidence)


def _hoped(c: Candidate, base: Fitted) -> float:
    """Log evidence with what the next step promises."""
    return c.fitted.log_evidence - base.log_evidence


def _refined(inference: Inference, fitted: Sequence[Fitted]) -> list[Fitted]:
    """A few more steps from each fit, once with its random forces and once with far smaller ones; the best of the three.

    Large random forces explain what the numbers could explain as well, and wrong numbers ask for large forces: a local optimum that
    only a start with small forces leaves. A fit whose steps only lose, though they promise much, takes far shorter ones.
    """
    answers = _further(inference, fitted, REFIT_STEPS)
    stuck = [k for k, f in enumerate(fitted) if answers[k] is f and f.promised >= CONVERGED_GAIN]
    for k, better in zip(stuck, _further(inference, [fitted[k] for k in stuck], SHORT_STEPS), strict=True):
        answers[k] = better
    return answers


def _further(inference: Inference, fitted: Sequence[Fitted], steps: int) -> list[Fitted]:
    """At most so many steps from each fit, as ``_refined`` does them."""
    shares = (1.0, SMALL_FORCES)
    starts = [(f, share) for f in fitted for share in shares]
    forces = [f.forces.scaled(share) for f, share in starts]
    ends = inference.fit([f.hypothesis for f, _ in starts], forces, steps, (), begun=[f for f, _ in starts])
    answers = []
    for k, old in enumerate(fitted):
        both = [old, *ends[k * len(shares) : (k + 1) * len(shares)]]
        answers.append(max(both, key=lambda f: f.worth))
    return answers


def _at_their_limit(inference: Inference, fitted: Fitted) -> bool:
    """Whether a fit's random forces, of those that move anything, are as large as noise is never."""
    most, forces = AT_MOST * inference.simulator.most_force, fitted.forces
    side, moment = inference.noise.by_force(0, forces.time)
    return bool((forces.side_n >= most and side.any()) or (forces.moment_n_m >= most and moment.any()))


def _of_forms(scores: dict[str, float], effects: Sequence[Effect]) -> dict[str, float]:
    """Name -> log of what its best form has of the name's prior, spread over its forms, by their scores: all of it where all forms
    say the same, 1/n where one of n does.
    """
    by_name: dict[str, list[float]] = {}
    for effect in effects:
        by_name.setdefault(effect.name, []).append(scores[effect.label])
    return {
        n: float(logsumexp(found) - np.log(len(found)) - max(found)) if np.isfinite(max(found)) else 0.0
        for n, found in by_name.items()
    }


def _best_variants(scores: dict[str, float], effects: Sequence[Effect], count: int) -> list[Effect]:
    """The best variant of each name, the best ``count`` names."""
    best: dict[str, Effect] = {}
    for effect in effects:
        old = best.get(effect.name)
        if old is None or scores[effect.label] > scores[old.label]:
            best[effect.name] = effect
    return sorted(best.values(), key=lambda e: -scores[e.label])[:count]


def _fit_all(
    inference: Inference,
    base: Fitted,
    sets: Sequence[tuple[Effect, ...]],
    gross: bool,
    starts: Sequence[Hypothesis] = (),
    ahead: float = -np.inf,
) -> list[tuple[tuple[Effect, ...], Fitted]]:
    """Fits of ``sets`` of effects from the base, and from ``starts`` if they may come near to the log evidence ``ahead``.

    Without those whose motion runs off from the base on: no step leads anywhere.
    """
    hypotheses = [with_effects(base.hypothesis, list(effects)) for effects in sets]
    share, steps, turns = (SMALL_FORCES, GROSS_STEPS, (GROSS_STEPS - 1,)) if gross else (1.0, REFIT_STEPS, (1,))
    ends = _each_fit(inference, hypotheses, base.forces.scaled(share), steps, turns)
    begun = [k for k, end in enumerate(ends) if end is not None]
    sets, hypotheses = [sets[k] for k in begun], [hypotheses[k] for k in begun]
    found = [end for end in ends if end is not None]
    # an effect can be as good as none: a fit that ends far below the base has lost its way beside forces that are too small
    astray = [k for k, f in enumerate(found) if gross and f.worth < base.log_evidence - CONVERGED_GAIN]
    again = inference.fit([hypotheses[k] for k in astray], [base.forces] * len(astray), REFIT_STEPS, (1,))
    for k, end in zip(astray, again, strict=True):
        found[k] = max(found[k], end, key=lambda f: f.worth)
    # a base that does not follow its runs has numbers that make up for what is missing: no place to begin from
    best = max([ahead, *(f.log_evidence for f in found)])
    for k, end in enumerate(ends_from(inference, starts, sets, best) if starts else ()):
        found[k] = found[k] if end is None else max(found[k], end, key=lambda f: f.worth)
    return list(zip(sets, found, strict=True))


def _each_fit(
    inference: Inference, hypotheses: Sequence[Hypothesis], forces: Forces, steps: int, turns: Sequence[int]
) -> list[Fitted | None]:
    """Fits side by side; where one cannot even begin, each by itself, and None for such a one: it ends no diagnosis."""
    try:
        return list(inference.fit(hypotheses, [forces] * len(hypotheses), steps, turns))
    except EstimationError:
        if len(hypotheses) == 1:
            return [None]
    return [_each_fit(inference, [h], forces, steps, turns)[0] for h in hypotheses]


def _pairs(
    inference: Inference,
    singles: Sequence[Candidate],
    base: Fitted,
    usable: Sequence[Effect],
    suggested: Callable[[Fitted], list[Effect]],
    names: int,
    say: Progress,
    gross: bool,
    forms: dict[str, float],
) -> list[Candidate]:
    """A second effect on top of the best single ones, where its score promises something; where the first explains very much, what
    it leaves suggests other ones than what the base leaves.
    """
    found: list[Candidate] = []
    prior = np.log(P_PAIR / max(names * (names - 1) / 2, 1))
    done: set[frozenset[str]] = set()
    for first in singles[:2]:
        if first.log_evidence < max(CLEAR, singles[0].log_evidence - WORTH_PAIRS_BELOW):
            continue
        ruled = any(e.rules_line for e in first.effects)
        # what is read off where the first one is at work itself is what its form leaves
        stages = {e.stage for e in first.effects}
        anew = suggested(first.fitted) if first.log_evidence > GROSS else []
        seen = {e.label: e for e in (*usable, *(e for e in anew if e.stage not in stages))}
        rest = [e for e in seen.values() if e.name not in first.names and not (ruled and e.rules_line)]
        scores = screened(inference, first.fitted, rest, (1.0,)).seen
        forms = _of_forms(scores, rest) | forms
        second = [e for e in _best_variants(scores, rest, TRIED_PAIR) if scores[e.label] > WORTH_PAIRS]
        second = [e for e in second if frozenset((*first.names, e.name)) not in done]
        if not second:
            continue
        done |= {frozenset((*first.names, e.name)) for e in second}
        say(f"{first.names[0]} with " + ", ".join(e.name for e in second))
        for (effect,), fitted in _fit_all(inference, first.fitted, [(e,) for e in second], gross):
            pair = (*first.effects, effect)
            own = prior + sum(forms[name] for name in (*first.names, effect.name))
            found.append(Candidate(pair, fitted, fitted.worth - base.log_evidence, own))
    found = _converged(inference, sorted(found, key=lambda c: -c.log_evidence), base)
    found = _borne_out(inference, found, singles)
    firsts = [_first_of(pair, singles) for pair in found]
    # where a force takes most of what a force leaves, what takes less of it is no likelier to be there than its form's fault
    forced = [(f, pair) for f, pair in zip(firsts, found, strict=True) if _two_forces(pair)]
    return [
        _priced(inference, f, pair, max((p.log_evidence for g, p in forced if g is f), default=-np.inf))
        for f, pair in zip(firsts, found, strict=True)
    ]


def _two_forces(pair: Candidate) -> bool:
    return all(e.force is not None for e in pair.effects)


def _first_of(pair: Candidate, singles: Sequence[Candidate]) -> Candidate:
    return next(c for c in singles if c.effects == pair.effects[:-1])


def _borne_out(inference: Inference, pairs: Sequence[Candidate], singles: Sequence[Candidate]) -> list[Candidate]:
    """Those that all runs bear out: a second effect that makes the runs disagree, and more so than the first alone did, has taken
    up what is some runs' only.
    """
    kept = []
    for pair in pairs:
        apart = disagreement(inference, pair.fitted).log_evidence
        if apart <= 0 or apart <= disagreement(inference, _first_of(pair, singles).fitted).log_evidence:
            kept.append(pair)
    return kept


def _priced(inference: Inference, first: Candidate, pair: Candidate, by_force: float) -> Candidate:
    """The pair without what the first one's form may have left over for the second to take; where beside both next to nothing is
    left, it was no form's, nor is what shows in runs in which the first is not at work. Of two forces on the hull one bends itself
    into what the other leaves, and what takes less than such a one (``by_force``, log evidence with it) may be that as well. A
    second one that was read off residuals follows whatever the first leaves: neither tells anything of it.
    """
    price = first.second
    if not pair.effects[-1].bound:
        gain = pair.log_evidence - first.log_evidence - told_apart(inference, first.fitted, pair.fitted)
        if pair.log_evidence <= by_force:
            price = max(price, FORCES_ALIKE * first.log_evidence)
        else:
            price = min(price, could_gain(inference, pair.fitted))
        price = min(price, max(gain, 0.0))
    return replace(pair, log_prior=pair.log_prior - price)


def _beside(
    inference: Inference, candidates: Sequence[Candidate], base: Fitted, free: Sequence[Effect], say: Progress
) -> Candidate | None:
    """The best free form for what one of the best candidates leaves, with the prior of that candidate."""
    found: list[Candidate] = []
    order = sorted(candidates, key=lambda c: -c.weight)
    for c in order[:LEFT_OVER_BY] if free else ():
        if c.log_evidence < max(CLEAR, order[0].log_evidence - SCANNED_BELOW):
            continue
        scores = screened(inference, c.fitted, free).seen
        best = [e for e in _best_variants(scores, free, TRIED_FREE) if scores[e.label] > WORTH_PAIRS]
        if best:
            say(f"what {' and '.join(c.names)} leaves")
        gross = max((scores[e.label] for e in best), default=0.0) > GROSS
        for effects, fitted in _fit_all(inference, c.fitted, [(e,) for e in best], gross) if best else ():
            found.append(Candidate((*c.effects, *effects), fitted, fitted.worth - base.log_evidence, c.log_prior))
    if not found:
        return None
    return _converged(inference, [max(found, key=lambda c: c.weight)], base)[0]


def _ranking(
    inference: Inference,
    base: Fitted,
    candidates: Sequence[Candidate],
    free: Candidate | None,
    beside: Candidate | None,
    excluded: dict[str, str],
) -> Ranking:
    """Probabilities; what leaves large random forces explains nothing: its share is the unknown's.

    The unknown is a free form, alone or ``beside`` one of the best effects, or something left over by no gap or by one of those.
    """
    best: dict[frozenset[str], Candidate] = {}
    forms: dict[tuple[str, ...], dict[str, float]] = {}
    for c in sorted(candidates, key=lambda c: -c.log_evidence):
        forms.setdefault(c.names, {}).setdefault(c.variant, c.log_evidence)
    for c in candidates:
        key = frozenset(c.names)
        if key not in best or c.log_evidence > best[key].log_evidence:
            best[key] = c
    kept = sorted(best.values(), key=lambda c: -c.weight)
    known = [np.log(P_NO_GAP), *(c.weight for c in kept)]
    scanned = [(base, known[0]), *((c.fitted, k) for c, k in zip(kept[:SCANNED], known[1:], strict=False))]
    rests = [(leftover(inference, fitted), log) for fitted, log in scanned if log > max(known) - SCANNED_BELOW]
    form = max(kept, key=lambda c: c.log_evidence).form if kept else 0.0

    def beyond_form(found: tuple[Leftover, float]) -> float:
        return found[0].log_evidence + found[1] - form * (ALIKE_IN_ALL if found[0].disagree else 1.0)

    rest = max(rests, key=beyond_form)
    unknown = [beyond_form(rest), *([free.weight - np.log(P_UNKNOWN) - form] if free is not None else [])]
    unknown += [beside.weight - form] if beside is not None else []
    logs = [known[0], np.log(P_UNKNOWN) + max(unknown), *known[1:]]
    logs = np.array(logs)
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    explains = np.array([not _at_their_limit(inference, f) for f in (base, *(c.fitted for c in kept))])
    explains = np.concatenate([explains[:1], [False], explains[1:]])
    p_unknown = float(shares[~explains].sum())
    shares = np.where(explains, shares, 0.0)
    order = np.lexsort((-logs[2:], -shares[2:]))
    return Ranking(
        base,
        tuple(kept[i] for i in order),
        shares[2:][order],
        float(shares[0]),
        p_unknown,
        free,
        rest[0],
        excluded,
        forms,
        beside=beside,
        follows=bool(explains[0]),
    )


__all__ = ["extended", "ranked"]
