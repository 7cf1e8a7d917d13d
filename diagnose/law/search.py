"""The search for a missing law: the grammar's terms against the library's effects, by whole-path fits.

The diagnosis's engine decides (inference.engine): every term is an effect with a price for what it takes to write it, alone or with
a second one, and competes with the library, faults of camera, clock and line among it, with free forms, and with noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ...simulate.model import Array
from ..effects import Effect
from ..gap import Diagnosis
from ..inference.evidence import Fitted
from ..inference.ranking import Candidate
from ..tow.towed import TowSimulator
from .terms import ACTS, NAME, Range, State, dimensionless, effect_of, grammar, term, text_of, values_of, written

SIDE_SHARE, ARM_SHARE = 0.1, 0.25
"""Usual force of a missing term: this share of the line's pull, its moment at this share of the length; sizes down to a
thirtieth are as likely (``Effect.sizes``)."""
SAME_FORCE = 0.03
"""Terms whose forces over the range seen differ by less than this share of them, whatever is linear in v and r left out, are one
law."""
LISTED = 5
"""Laws that are told."""


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
class Searched:
    """What the search found.

    Attributes
    ----------
    laws : the most probable first
    p_law : of all laws together
    verdict : "law", "no_gap", "other" (effects of the library explain it better) or "unknown"
    other : the effects that do, where they do
    states, seen : of ``seen_by``
    diagnosis : of the engine, behind it
    """

    laws: tuple[Law, ...]
    p_law: float
    verdict: str
    other: tuple[str, ...]
    states: State
    seen: Range
    diagnosis: Diagnosis


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
        parts.append(dimensionless(*own, v, r, y, beta, turn_rad_s=turn, time=time))
    every = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(State)}
    moved = {name: x for name, x in every.items() if not name.endswith("_late")}
    seen = Range(
        {n: float(x.min()) for n, x in moved.items()},
        {n: float(x.max()) for n, x in moved.items()},
        {n: float(np.sqrt(np.mean(x**2))) for n, x in moved.items()},
    )
    return State(**every), seen


def law_effects(simulator: TowSimulator, states: State, seen: Range) -> list[Effect]:
    """The grammar's terms as effects, each for a side force, a moment and both.

    Parameters
    ----------
    simulator : of the runs
    states, seen : of ``seen_by``
    """
    first = simulator.runs[0]
    terms = grammar(seen, bool(np.isfinite(first.half_width_m)))
    size = 0.5 * first.density_kg_m3 * simulator.speed_m_s**2 * first.length_pp_m**2
    usual = SIDE_SHARE * float(np.mean([run.data.tow.tension_n or 0.0 for run in simulator.runs])) / size
    found = []
    for one in terms:
        numbers = [1.0] * one.functions + [shape.value for shape in one.shapes]
        height = float(np.sqrt(np.mean(values_of(one.text, "Y", numbers, states)[0] ** 2)))
        # a lag's term is as large as a part of the velocity
        height = height if height > 0 else 0.3 * seen.usual[one.variables[0]]
        sd = usual / max(height, 1e-9)
        found += [effect_of(one.text, acts, (sd, ARM_SHARE * sd), seen.ends) for acts in ACTS]
    return found


def searched(
    simulator: TowSimulator, library: Sequence[Effect], diagnose: Callable[[list[Effect]], Diagnosis]
) -> Searched:
    """Search for the law that these runs miss.

    Parameters
    ----------
    simulator : of the runs
    library : effects that compete
    diagnose : effects to try -> what comes of these runs with them (``gap.diagnosed``)

    Raises
    ------
    EstimationError : the simulator as it is cannot be fitted at all
    """
    states, seen = seen_by(simulator)
    found = diagnose([*law_effects(simulator, states, seen), *library])
    ranking = found.ranking
    laws, others = [], []
    for candidate, probability in zip(ranking.candidates, ranking.probabilities, strict=True):
        (laws if is_law(candidate) else others).append((candidate, float(probability)))
    shrinks = {tuple(row.effects): row.shrink for row in found.file.ranking}
    p_law, p_other = (sum(p for _, p in part) for part in (laws, others))
    verdict = "no_gap" if found.file.verdict == "no_gap" else "unknown"
    if verdict == "unknown" and max(p_law, p_other) > ranking.p_unknown:
        verdict = "law" if p_law >= p_other else "other"
    best_other = others[0][0].names if others and verdict == "other" else ()
    return Searched(
        tuple(_merged(found, laws, states, shrinks)) if verdict == "law" else (),
        p_law,
        verdict,
        best_other,
        states,
        seen,
        found,
    )


def is_law(candidate: Candidate) -> bool:
    """Whether all its effects are terms of the grammar."""
    return all(effect.name.startswith(f"{NAME} ") for effect in candidate.effects)


def _merged(
    found: Diagnosis,
    laws: Sequence[tuple[Candidate, float]],
    states: State,
    shrinks: dict[tuple[str, ...], float],
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
    told = []
    for _, members in groups[:LISTED]:
        simplest = min(members, key=lambda m: (sum(e.cost for e in m[0].effects), -m[1]))[0]
        fitted, at = simplest.fitted, found.inference.fixed(simplest.fitted.hypothesis)
        count = fitted.hypothesis.size
        told.append(
            Law(
                fitted,
                fitted.solved.covariance[at : at + count, at : at + count],
                sum(p for _, p in members),
                shrinks.get(simplest.names, float("nan")),
                tuple(_written(m.fitted) for m, _ in members if m is not simplest),
            )
        )
    return told


def _terms(fitted: Fitted) -> tuple[tuple[str, str], ...]:
    """(text, where it acts) of each effect, with the numbers that were fitted."""
    found = []
    for effect, numbers in zip(fitted.hypothesis.effects, fitted.hypothesis.numbers, strict=True):
        text = text_of(effect)
        found.append((written(text, numbers[len(numbers) - len(term(text).shapes) :]), effect.variant))
    return tuple(found)


def _written(fitted: Fitted) -> str:
    return " + ".join(f"{where}: {text}" for text, where in _terms(fitted))


def force_of(effects: Sequence[Effect], numbers: Sequence[Array], states: State) -> Array:
    """(2, n) coefficients of side force and moment in states.

    Parameters
    ----------
    effects, numbers : of a law
    states : where
    """
    return np.sum(
        [values_of(text_of(e), e.variant, n, states) for e, n in zip(effects, numbers, strict=True)],
        axis=0,
    )


def without_linear(force: Array, states: State) -> Array:
    """(2, n) the same without what is linear in v and r, which the derivatives hold.

    Parameters
    ----------
    force : (2, n)
    states : (n,) where
    """
    plain = np.column_stack([states.v, states.r])
    return force - (plain @ np.linalg.lstsq(plain, force.T, rcond=None)[0]).T


__all__ = ["Law", "Searched", "force_of", "is_law", "law_effects", "searched", "seen_by", "without_linear"]
