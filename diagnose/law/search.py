"""The search for a missing law: the grammar's terms against the library's effects, by whole-path fits.

The diagnosis's engine decides (inference.engine): every term is an effect with a price for what it takes to write it, alone or with
a second one, and competes with the library, faults of camera, clock and line among it, with free forms, and with noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from ..effects import Effect
from ..gap import Diagnosis, diagnosed
from ..inference.engine import Progress
from ..inference.ranking import Candidate
from ..inference.spread import Spread, one_by_one
from ..tow.towed import TowSimulator
from .terms import ACTS, NAME, Range, State, effect_of, grammar, term, values_of, written

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
    terms : (text, where it acts) each, with the numbers that were fitted
    numbers : of each term's effect
    covariance : (k, k) of them in turn
    probability : of it and of what is the same over the range seen
    shrink : share of the gap that it takes on runs kept aside, NaN where not worked out
    same : other texts of the same force
    effects : as the engine knows them
    """

    terms: tuple[tuple[str, str], ...]
    numbers: tuple[Array, ...]
    covariance: Array
    probability: float
    shrink: float
    same: tuple[str, ...]
    effects: tuple[Effect, ...]

    @property
    def sd(self) -> list[Array]:
        """Standard deviations of ``numbers``."""
        sizes = np.cumsum([len(n) for n in self.numbers])[:-1]
        return np.split(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), sizes)

    @property
    def text(self) -> str:
        """In words a page can show."""
        return " + ".join(f"{where}: {text}" for text, where in self.terms)


@dataclass(frozen=True)
class Searched:
    """What the search found.

    Attributes
    ----------
    laws : the most probable first
    p_law : of all laws together
    verdict : "law", "no_gap", "other" (effects of the library explain it better) or "unknown"
    other : the effects that do, where they do
    seen : of the runs
    diagnosis : of the engine, behind it
    """

    laws: tuple[Law, ...]
    p_law: float
    verdict: str
    other: tuple[str, ...]
    seen: Range
    diagnosis: Diagnosis


def seen_by(simulator: TowSimulator) -> tuple[State, Range]:
    """The dimensionless state at every mean of the runs, by the measured motion; and its range.

    Parameters
    ----------
    simulator : of the runs
    """
    columns: dict[str, list[Array]] = {name: [] for name in ("v", "r", "y", "beta", "turn", "time")}
    for run in simulator.runs:
        good = np.isfinite(run.values[:, :2]).all(axis=1)
        t_s, (y, beta) = run.centre_s[good], run.values[good, :2].T
        tow = run.data.tow
        rate, turning = np.gradient(y, t_s), np.gradient(beta, t_s)
        alpha = np.arcsin(np.clip((y + tow.tow_point_m * np.sin(beta)) / tow.line_length_m, -1.0, 1.0))
        by_turn = run.length_pp_m / tow.speed_m_s
        columns["v"].append(rate / tow.speed_m_s - beta)
        columns["r"].append(turning * by_turn)
        columns["y"].append(y / (run.half_width_m if np.isfinite(run.half_width_m) else run.length_pp_m))
        columns["beta"].append(beta)
        columns["turn"].append((np.gradient(alpha, t_s) + turning) * by_turn)
        columns["time"].append(t_s / max(float(t_s[-1]), 1e-9))
    every = {name: np.concatenate(parts) for name, parts in columns.items()}
    seen = Range(
        {n: float(x.min()) for n, x in every.items()},
        {n: float(x.max()) for n, x in every.items()},
        {n: float(np.sqrt(np.mean(x**2))) for n, x in every.items()},
    )
    return State(v_late=every["v"], r_late=every["r"], **every), seen


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
    simulator: TowSimulator,
    library: Sequence[Effect],
    tool: str,
    inputs: dict[str, str],
    held: Sequence[int] | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    spread: Spread = one_by_one,
) -> Searched:
    """Search for the law that these runs miss.

    Parameters
    ----------
    simulator : of the runs
    library : effects that compete
    tool, inputs, held, rng, progress, spread : as of ``gap.diagnosed``

    Raises
    ------
    EstimationError : the simulator as it is cannot be fitted at all
    """
    states, seen = seen_by(simulator)
    terms = law_effects(simulator, states, seen)
    found = diagnosed(simulator, [*terms, *library], tool, inputs, held, rng, progress, spread)
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
        count = sum(len(n) for n in fitted.hypothesis.numbers)
        told.append(
            Law(
                _terms(simplest),
                tuple(fitted.hypothesis.numbers),
                fitted.solved.covariance[at : at + count, at : at + count],
                sum(p for _, p in members),
                shrinks.get(simplest.names, float("nan")),
                tuple(_written(m) for m, _ in members if m is not simplest),
                simplest.effects,
            )
        )
    return told


def _terms(candidate: Candidate) -> tuple[tuple[str, str], ...]:
    """With the numbers that were fitted."""
    found = []
    for effect, numbers in zip(candidate.effects, candidate.fitted.hypothesis.numbers, strict=True):
        text = effect.name[len(NAME) + 1 :]
        found.append((written(text, numbers[len(numbers) - len(term(text).shapes) :]), effect.variant))
    return tuple(found)


def _written(candidate: Candidate) -> str:
    return " + ".join(f"{where}: {text}" for text, where in _terms(candidate))


def force_of(effects: Sequence[Effect], numbers: Sequence[Array], states: State) -> Array:
    """(2, n) coefficients of side force and moment in states.

    Parameters
    ----------
    effects, numbers : of a law
    states : where
    """
    return np.sum(
        [values_of(e.name[len(NAME) + 1 :], e.variant, n, states) for e, n in zip(effects, numbers, strict=True)],
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
