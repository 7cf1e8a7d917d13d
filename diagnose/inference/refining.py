"""Fits of many hypotheses, and their refinement until they converge: only then can they be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...record.errors import EstimationError
from ..effects import Effect
from .begun import ends_from
from .evidence import CONVERGED_GAIN, Fitted, Inference
from .hypothesis import Hypothesis, with_effects
from .noise import Forces
from .ranking import Candidate

REFIT_STEPS, GROSS_STEPS = 3, 5
"""Gauss-Newton steps: of a refinement, and of the first fit of an effect where scores are very large."""
SMALL_FORCES = 0.05
"""A refinement also starts from random forces of this share of those estimated."""
SHORT_STEPS = 10
"""Of a refinement whose steps only lose: each is three tenths of the last."""
GROSS = 200.0
"""Scores above this are very large: a choice."""
MOST_REFINEMENTS, BASE_REFINEMENTS = 5, 15
"""A fit is refined at most so often, and the base, which all others are held against."""
STILL_GOING = 2
"""So many fits that are not at their end are gone on with beside the best few."""
CLEAR = 3.0
"""The headline must beat no gap by this."""
WORTH_PAIRS_BELOW = 30.0
"""Pairs are tried on the second best effect only if it comes this near to the best."""


def settled(inference: Inference, base: Fitted) -> Fitted:
    """The same, refined until its next step promises nothing, or no step gains any more."""
    for _ in range(BASE_REFINEMENTS):
        better = refined(inference, [base])[0] if base.promised >= CONVERGED_GAIN else base
        if better is base:
            break
        base = better
    return base


def converged(inference: Inference, candidates: list[Candidate], base: Fitted) -> list[Candidate]:
    """The best few, and those that are still on their way to something better, refined until they converge: only then can they be
    compared with a pair, which starts from them.
    """
    few = [c for c in candidates[:3] if c.log_evidence > max(CLEAR, candidates[0].log_evidence - WORTH_PAIRS_BELOW)]
    best = max((c.log_evidence for c in few), default=CLEAR)
    going = sorted((c for c in candidates if all(c is not one for one in few)), key=lambda c: -hoped(c, base))
    few += [c for c in going[:STILL_GOING] if np.isfinite(hoped(c, base)) and hoped(c, base) > best]
    if not few:
        return candidates
    fitted, moving = [c.fitted for c in few], list(range(len(few)))
    for _ in range(MOST_REFINEMENTS):
        before = list(fitted)
        for k, better in zip(moving, refined(inference, [fitted[k] for k in moving]), strict=True):
            fitted[k] = better
        # a step that reaches what it promised raises what a fit is worth, though not its log evidence, and may promise more
        moving = [k for k in moving if fitted[k].worth - before[k].worth >= CONVERGED_GAIN]
        if not moving:
            break
    better = [replace(c, fitted=f, log_evidence=f.worth - base.log_evidence) for c, f in zip(few, fitted, strict=True)]
    rest = [c for c in candidates if all(c is not one for one in few)]
    return sorted((*better, *rest), key=lambda c: -c.log_evidence)


def hoped(c: Candidate, base: Fitted) -> float:
    """Log evidence with what the next step promises."""
    return c.fitted.log_evidence - base.log_evidence


def refined(inference: Inference, fitted: Sequence[Fitted]) -> list[Fitted]:
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
    """At most so many steps from each fit, as ``refined`` does them."""
    shares = (1.0, SMALL_FORCES)
    starts = [(f, share) for f in fitted for share in shares]
    forces = [f.forces.scaled(share) for f, share in starts]
    ends = inference.fit([f.hypothesis for f, _ in starts], forces, steps, (), begun=[f for f, _ in starts])
    answers = []
    for k, old in enumerate(fitted):
        both = [old, *ends[k * len(shares) : (k + 1) * len(shares)]]
        answers.append(max(both, key=lambda f: f.worth))
    return answers


def fit_all(
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
    again = _each_fit(inference, [hypotheses[k] for k in astray], base.forces, REFIT_STEPS, (1,))
    for k, end in zip(astray, again, strict=True):
        found[k] = found[k] if end is None else max(found[k], end, key=lambda f: f.worth)
    # a base that does not follow its runs has numbers that make up for what is missing: no place to begin from
    best = max([ahead, *(f.log_evidence for f in found)])
    for k, end in enumerate(ends_from(inference, starts, sets, best) if starts else ()):
        found[k] = found[k] if end is None else max(found[k], end, key=lambda f: f.worth)
    return list(zip(sets, found, strict=True))


def fit_on(inference: Inference, starts: Sequence[Hypothesis], forces: Forces, count: int) -> list[Fitted]:
    """Fits that begin at hypotheses as they are: the best of them by one step, without those that get nowhere.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    starts : with numbers of their own
    forces : random forces that each begins with
    count : how many are fitted in full
    """
    begun = [_each_fit(inference, [h], forces, 0, None)[0] for h in starts]
    best = sorted((f for f in begun if f is not None), key=lambda f: -f.log_evidence)[:count]
    ends = [_each_fit(inference, [f.hypothesis], forces, REFIT_STEPS, (1,), [f])[0] for f in best]
    return [end for end in ends if end is not None and np.isfinite(end.worth)]


def _each_fit(
    inference: Inference,
    hypotheses: Sequence[Hypothesis],
    forces: Forces,
    steps: int,
    turns: Sequence[int] | None,
    begun: Sequence[Fitted] = (),
) -> list[Fitted | None]:
    """Fits side by side; where one cannot even begin, each by itself, and None for such a one: it ends no diagnosis."""
    try:
        return list(inference.fit(hypotheses, [forces] * len(hypotheses), steps, turns, begun=begun))
    except EstimationError:
        if len(hypotheses) == 1:
            return [None]
    return [_each_fit(inference, [h], forces, steps, turns, begun[k : k + 1])[0] for k, h in enumerate(hypotheses)]


__all__ = [
    "CLEAR",
    "GROSS",
    "REFIT_STEPS",
    "WORTH_PAIRS_BELOW",
    "converged",
    "fit_all",
    "fit_on",
    "hoped",
    "refined",
    "settled",
]
