"""Screening: what every effect would add to the evidence, by one step from a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from ...geometry.normal import inverse_of_normal
from ...simulate.model import Array
from ..effects import Effect
from .evidence import Fitted, Inference
from .grams import Grams
from .hypothesis import form_of, with_effects
from .members import log_evidence, mixed, shares_of


@dataclass(frozen=True)
class Screened:
    """Log evidence that effects would add, by their labels, each at its best share of the base's random forces.

    Attributes
    ----------
    beside : over the base with the first share of them: all of its random forces, if not said otherwise
    seen : over the base with the same share: what is large stands out, noise taken for an effect, too
    paid : over the base as it is: what a smaller share costs the base is taken off
    """

    beside: dict[str, float]
    seen: dict[str, float]
    paid: dict[str, float]


def screened(
    inference: Inference, base: Fitted, effects: Sequence[Effect], shares: Sequence[float] = (1.0, 0.2)
) -> Screened:
    """Log evidence of every effect by one step from ``base``, the best over these shares of its random forces.

    The base's random forces have taken up part of what an effect does: seen with smaller ones it stands out.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    base : the fit without effects
    effects : to look at
    shares : of the base's random forces
    """
    alike: dict[tuple[object, ...], list[Effect]] = {}
    for effect in effects:
        alike.setdefault(form_of(effect), []).append(effect)
    groups = list(alike.values())
    halves = [groups[k::2] for k in range(min(2, len(groups)))]
    answer = Screened({}, {}, {})
    for part in inference.spread(lambda half: _scores(inference, base, half, shares), halves):
        answer.beside.update(part.beside)
        answer.seen.update(part.seen)
        answer.paid.update(part.paid)
    return answer


def _scores(
    inference: Inference, base: Fitted, groups: Sequence[Sequence[Effect]], shares: Sequence[float]
) -> Screened:
    """Of groups of effects that differ by how large they usually are alone: one slope stands for all."""
    here, firsts = base.hypothesis, [group[0] for group in groups]
    linear = inference.linear([with_effects(here, firsts)])[0]
    grams = Grams(linear.columns, inference.noise)
    fixed = inference.fixed(here) + here.size
    beside: dict[str, float] = {}
    seen: dict[str, float] = {}
    paid: dict[str, float] = {}
    # an effect's own prior stands in its score; what was measured of it is data
    prior = inference.priors(linear.hypothesis)
    in_score = np.concatenate([np.zeros(fixed), *([q.sd**-2.0 for q in e.parameters] for e in firsts)])
    as_it_is = _alone(inference, base, 1.0)
    for share in shares:
        part = inference.reduced(grams, linear.hypothesis, base.forces.scaled(share))
        cost = min(_alone(inference, base, share) - as_it_is, 0.0)
        matrix, right = part.matrix + np.diag(prior.precision - in_score), part.right + prior.pull
        inverse = inverse_of_normal(matrix[:fixed, :fixed])
        at = fixed
        for group in groups:
            own = slice(at, at + len(group[0].parameters))
            at = own.stop
            cross = matrix[own, :fixed] @ inverse
            left = matrix[own, own] - cross @ matrix[:fixed, own]
            pull = right[own] - cross @ right[:fixed]
            for effect in group:
                value = _score(effect, left, pull)
                beside.setdefault(effect.label, value)
                seen[effect.label] = max(seen.get(effect.label, -np.inf), value)
                paid[effect.label] = max(paid.get(effect.label, -np.inf), value + cost)
    return Screened(beside, seen, paid)


def _alone(inference: Inference, base: Fitted, share: float) -> float:
    """Log evidence of the base with this share of its random forces."""
    forces = base.forces.scaled(share)
    solved = inference.solve(base.grams, base.hypothesis, forces)
    return solved.log_evidence + forces.log_prior(inference.simulator.most_force)


def _score(effect: Effect, left: Array, pull: Array) -> float:
    """Log evidence that an effect would add, by its information ``left`` (p, p) and its gradient ``pull`` (p,)."""
    sd = np.array([p.sd for p in effect.parameters])
    sided = np.flatnonzero([p.one_sided for p in effect.parameters])
    try:
        logs = log_evidence(sd[:, None] * left * sd, sd * pull, shares_of([effect]), sided)
    except np.linalg.LinAlgError:  # slopes of a motion that has run off cancel beyond all digits
        return -np.inf
    value = mixed(logs) - effect.cost
    return value if np.isfinite(value) else -np.inf


def of_forms(scores: dict[str, float], effects: Sequence[Effect]) -> dict[str, float]:
    """Name -> log of what its best form has of the name's prior, spread over its forms, by their scores: all of it where all forms
    say the same, 1/n where one of n does.

    Parameters
    ----------
    scores : by the forms' labels
    effects : all forms
    """
    by_name: dict[str, list[float]] = {}
    for effect in effects:
        by_name.setdefault(effect.name, []).append(scores[effect.label])
    return {
        n: float(logsumexp(found) - np.log(len(found)) - max(found)) if np.isfinite(max(found)) else 0.0
        for n, found in by_name.items()
    }


def best_variants(
    effects: Sequence[Effect], *asked: tuple[dict[str, float], int], least: float = -np.inf
) -> list[Effect]:
    """The best variant of each name, the best names of each that is ``asked``, none twice.

    Parameters
    ----------
    effects : all variants
    asked : scores, by the variants' labels, and how many names
    least : score that a variant must have
    """
    found: list[Effect] = []
    for scores, count in asked:
        best: dict[str, Effect] = {}
        for effect in effects:
            old = best.get(effect.name)
            if old is None or scores[effect.label] > scores[old.label]:
                best[effect.name] = effect
        first = sorted(best.values(), key=lambda e: -scores[e.label])[:count]
        found += [e for e in first if scores[e.label] >= least and all(e is not one for one in found)]
    return found


__all__ = ["Screened", "best_variants", "of_forms", "screened"]
