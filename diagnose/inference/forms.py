"""Other forms of what was found, and less of it: what fits best tells an effect, not what happened to be fitted first."""

from __future__ import annotations

from collections.abc import Sequence

from ..effects import Effect
from .diagnosable import Diagnosable
from .evidence import Fitted, Inference
from .hypothesis import in_form, only
from .ranking import Candidate
from .refining import CLEAR, GROSS, WORTH_PAIRS_BELOW, converged, fit_all, fit_on
from .screen import Screened

SIBLINGS, RIVALS = 3, 2
"""So many further forms, the best by their scores, of each of so many best effects are fitted in full. Choices, for time."""


def siblings(
    inference: Inference,
    base: Fitted,
    candidates: Sequence[Candidate],
    usable: Sequence[Effect],
    scores: Screened,
    gross: bool,
) -> list[Candidate]:
    """Other forms of the best effects, fitted from the base: a score is one step's, and they are near to one another; where two
    effects are near to one another, neither is told by the form that happened to be fitted.

    Parameters
    ----------
    inference, base : the simulator with its runs and noise, and its fit without effects
    candidates : single effects
    usable, scores : all that are tried, and their scores on the base
    gross : scores are very large
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
    fitted = fit_all(inference, base, [(e,) for e, _ in others.values()], gross) if others else []
    return [Candidate(effects, f, f.worth - base.log_evidence, others[effects[0].label][1]) for effects, f in fitted]


def from_the_best(
    inference: Inference,
    simulator: Diagnosable,
    base: Fitted,
    candidates: Sequence[Candidate],
    usable: Sequence[Effect],
) -> list[Candidate]:
    """Other forms of the best effect, fitted from its numbers: beside a gross gap the base's scores say little of what tells forms
    apart.

    Parameters
    ----------
    inference, base : the simulator with its runs and noise, and its fit without effects
    simulator : knows forms that are not among ``usable``
    candidates : single effects
    usable : all that are tried
    """
    best = max(candidates, key=lambda c: c.log_evidence, default=None)
    if best is None or best.log_evidence < GROSS:
        return []
    (told,) = best.effects
    alike = _forms_like(told, [*usable, *simulator.forms(told)])
    starts = [in_form(best.fitted.hypothesis, form) for form in alike]
    return [
        Candidate(one.hypothesis.effects, one, one.worth - base.log_evidence, best.log_prior)
        for one in fit_on(inference, starts, best.fitted.forces, SIBLINGS)
    ]


def _forms_like(told: Effect, every: Sequence[Effect]) -> list[Effect]:
    """Other forms of an effect that share numbers with it, and its states: a line with a law of its own has more. Numbers of what
    was read off these runs (when an event came) are about that very event.
    """
    known = set[str]() if told.bound else {p.name for p in told.parameters}
    alike = [e for e in every if e.name == told.name and e.label != told.label]
    alike = [e for e in alike if e.rules_line == told.rules_line and (e.law is None) == (told.law is None)]
    return [e for e in alike if not e.bound and known.intersection(p.name for p in e.parameters)]


def alone_after_all(
    inference: Inference,
    base: Fitted,
    singles: Sequence[Candidate],
    pairs: Sequence[Candidate],
    single_prior: float,
    forms: dict[str, float],
) -> list[Candidate]:
    """Each effect of the best pair by itself, from the pair's numbers: a fit that another effect helped past a bend of its way may
    do without it.

    Parameters
    ----------
    inference, base : the simulator with its runs and noise, and its fit without effects
    singles, pairs : what was found
    single_prior, forms : log of a single effect's prior, and of what its best form has of it (``of_forms``)
    """
    best = max(pairs, key=lambda c: c.weight, default=None)
    if best is None or best.log_evidence < max(c.log_evidence for c in singles) + CLEAR:
        return []
    both = best.fitted.hypothesis
    # without its law of the line a motion has fewer states
    alone = [only(both, e) for e in best.effects if e.law is not None or not both.lawful]
    found = []
    for one in fit_on(inference, alone, best.fitted.forces, len(alone)):
        own = single_prior + forms.get(one.hypothesis.effects[0].name, 0.0)
        found.append(Candidate(one.hypothesis.effects, one, one.worth - base.log_evidence, own))
    return converged(inference, sorted(found, key=lambda c: -c.log_evidence), base) if found else []


__all__ = ["alone_after_all", "from_the_best", "siblings"]
