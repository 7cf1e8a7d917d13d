"""The diagnosis: which effect explains the gap, how sure, and what cannot be told apart (gap.md).

Base fit, screening of every effect by its score, full fits of the best, pairs on top of the best, free forms for what is in no
library; probabilities from evidence with half of the prior on no gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...record.errors import EstimationError
from ..effects import Effect
from .begun import FAR_BEHIND, End, ends_from, ends_unlike, first_fit
from .diagnosable import Diagnosable
from .evidence import CONVERGED_GAIN, Fitted, Inference
from .forms import alone_after_all, from_the_best, siblings
from .hypothesis import Hypothesis
from .inexact import shared_out
from .pairs import WORTH_PAIRS, pairs_on
from .ranking import P_NO_GAP, P_SINGLE, P_UNKNOWN, Candidate, Ranking
from .refining import CLEAR, GROSS, REFIT_STEPS, converged, fit_all, hoped, refined, settled
from .scan import Leftover, leftover, standing_out
from .screen import best_variants, of_forms, screened
from .simulator import Simulator
from .spread import Spread, one_by_one

TRIED_SINGLE, TRIED_PAID = 6, 4
"""How many single effects are fitted in full, the best by their scores, as seen and as paid. Choices, for time."""
AT_MOST = 0.9
"""A fit whose random forces exceed this share of the largest that counts as noise explains nothing."""
SCANNED, SCANNED_BELOW = 4, 12.0
"""So many effects have their residuals searched for something left over, if log evidence and prior are within this of the best."""
LEFT_OVER_BY, TRIED_FREE = 2, 2
"""So many of the best candidates have what they leave searched by free forms, so many of these fitted. Choices, for time."""
ALIKE_IN_ALL = 0.3
"""Of what an effect's own form may leave over, so much may be numbers that differ from run to run: what a form leaves is much the
same in all tows. Of 26 effects and pairs of the blind check (seed 271133) that were fitted as they are, many of them in no form of
the library, 22 showed nothing of it; a heavy line in a form of a user's own 0.9 % of what it explains; with the effect that is
there taken out of the library it was up to a twentieth.
"""
RUNS_AWAY = "no motion with it follows these runs"
"""Of an effect that was begun from the measured motion and is far behind, or whose motion runs off where it is begun."""
WORTH_REFINING = 0.3
"""A free form is refined only if its log evidence is at least this share of the best effect's."""
WORTH_UNLIKE = 50.0
"""An effect with more log evidence than this may ask for what no step from the base leads to: a choice, for time."""
TWINS = 3.0
"""Effects within this log evidence of the best are not told from it."""
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
    base = settled(inference, refined(inference, inference.fit([first.hypothesis], [first.forces], 2, (0,)))[0])
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
    # beside random forces most of what stands out is noise: what does not, may lie behind six that do
    singles = best_variants(usable, (scores.seen, TRIED_SINGLE), (scores.paid, TRIED_PAID))
    best_free = best_variants(free, (scores.seen, 2))
    say("fitting " + ", ".join(dict.fromkeys(e.name for e in singles)))
    gross = max(scores.seen.values(), default=0.0) > GROSS
    starts = [] if base.forces.follow(simulator.most_force) else simulator.starts()
    ahead = unlike[0].log_evidence if unlike else -np.inf
    fitted = fit_all(inference, base, [(e,) for e in (*singles, *best_free)], gross, starts, ahead)
    single_prior, forms = np.log(P_SINGLE / max(len(names), 1)), of_forms(scores.paid, usable)
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
    candidates += siblings(inference, base, candidates, usable, scores, gross)
    candidates += from_the_best(inference, simulator, base, candidates, usable)
    candidates.sort(key=lambda c: -c.log_evidence)
    if not unlike and candidates and candidates[0].log_evidence > WORTH_UNLIKE:
        asked = ends_unlike(simulator, base, spread, candidates[0].effects[0])
        candidates += _as_candidates(inference, base, asked, single_prior)
        candidates.sort(key=lambda c: -c.log_evidence)
    candidates = converged(inference, candidates, base)
    pairs = pairs_on(inference, candidates, base, usable, simulator.suggested, len(names), say, gross, forms)
    candidates += alone_after_all(inference, base, candidates, pairs, single_prior, forms)
    candidates += pairs
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
        if np.isfinite(hoped(c, base)) and hoped(c, base) > max(CLEAR, WORTH_REFINING * best):
            c = converged(inference, [c], base)[0]
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
    return inference, settled(inference, inference.fit([base.hypothesis], [base.forces], 2, (0,))[0])


def _begun_anew(inference: Inference, base: Fitted) -> tuple[Inference, Fitted]:
    """The base from where fits begin, by the noise that is known now: what stands where no step gains though the next one promises
    much has scores that mean nothing.
    """
    simulator = inference.simulator
    end = ends_from(inference, simulator.starts(), [()], base.log_evidence - base.promised)[0]
    if end is None or end.worth < base.worth + CONVERGED_GAIN:
        return inference, base
    return _based_anew(simulator, end.hypothesis, end, inference.spread)


def _at_their_limit(inference: Inference, fitted: Fitted) -> bool:
    """Whether a fit's random forces, of those that move anything, are as large as noise is never."""
    most, forces = AT_MOST * inference.simulator.most_force, fitted.forces
    side, moment = inference.noise.by_force(0, forces.time)
    return bool((forces.side_n >= most and side.any()) or (forces.moment_n_m >= most and moment.any()))


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
        best = best_variants(free, (scores, TRIED_FREE), least=WORTH_PAIRS)
        if best:
            say(f"what {' and '.join(c.names)} leaves")
        gross = max((scores[e.label] for e in best), default=0.0) > GROSS
        for effects, fitted in fit_all(inference, c.fitted, [(e,) for e in best], gross) if best else ():
            found.append(Candidate((*c.effects, *effects), fitted, fitted.worth - base.log_evidence, c.log_prior))
    if not found:
        return None
    return converged(inference, [max(found, key=lambda c: c.weight)], base)[0]


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


__all__ = ["RUNS_AWAY", "extended", "ranked"]
