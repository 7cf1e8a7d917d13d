"""Pairs of effects: a second one on top of the best single ones, and what it must gain to be believed beside the first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..effects import Effect
from .disagree import disagreement
from .evidence import Fitted, Inference
from .inexact import could_gain, told_apart
from .ranking import P_PAIR, Candidate
from .refining import CLEAR, GROSS, WORTH_PAIRS_BELOW, converged, fit_all
from .screen import best_variants, of_forms, screened

TRIED_PAIR = 3
"""Second effects that are fitted in full, the best by their scores: a choice, for time."""
TRIED_BENEATH = 2
"""So many more, the best by their scores over smaller random forces: beside those of a line that goes slack (three times what a
quiet run has, over 6 s) a carriage that drifted by 3 % promised nothing, and gained 180."""
WORTH_PAIRS = 3.0
"""A second effect is fitted only if its score promises more log evidence than this."""
FORCES_ALIKE = 0.15
"""Of what a force on the hull explains, so much another one may take beside it without being there: what a force's form leaves over
is a force. Of 22 campaigns of the blind check (seeds 271129 to 271131) with one effect and a wrong second one that gained more than
4, seven had two forces, of which the wrong one took 3 to 13 %; with two forces that were there the second took 67 %.
"""


def pairs_on(
    inference: Inference,
    singles: Sequence[Candidate],
    base: Fitted,
    usable: Sequence[Effect],
    suggested: Callable[[Fitted], list[Effect]],
    names: int,
    say: Callable[[str], None],
    gross: bool,
    forms: dict[str, float],
) -> list[Candidate]:
    """A second effect on top of the best single ones, where its score promises something; where the first explains very much, what
    it leaves suggests other ones than what the base leaves.

    Parameters
    ----------
    inference, base : the simulator with its runs and noise, and its fit without effects
    singles : the best first
    usable : effects to try
    suggested : those that are read off what a fit leaves
    names : how many effects there are
    say : is told what is done
    gross : scores are very large
    forms : of ``of_forms``
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
        scores = screened(inference, first.fitted, rest)
        forms = of_forms(scores.beside, rest) | forms
        # the first one's random forces have taken up part of what the second does
        asked = (scores.beside, TRIED_PAIR), (scores.seen, TRIED_BENEATH)
        second = best_variants(rest, *asked, least=WORTH_PAIRS)
        second = [e for e in second if frozenset((*first.names, e.name)) not in done]
        if not second:
            continue
        done |= {frozenset((*first.names, e.name)) for e in second}
        say(f"{first.names[0]} with " + ", ".join(e.name for e in second))
        for (effect,), fitted in fit_all(inference, first.fitted, [(e,) for e in second], gross):
            pair = (*first.effects, effect)
            own = prior + sum(forms[name] for name in (*first.names, effect.name))
            found.append(Candidate(pair, fitted, fitted.worth - base.log_evidence, own))
    found = converged(inference, sorted(found, key=lambda c: -c.log_evidence), base)
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


__all__ = ["WORTH_PAIRS", "pairs_on"]
