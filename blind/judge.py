"""One case, one answer: what was said, and was it right?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .truth.cases import Case
from .truth.forms import form_of

Call = frozenset[str]
NO_GAP: Call = frozenset()
UNKNOWN: Call = frozenset({"unknown"})
NONE: Call = frozenset({"no answer"})
INEXACT = "form not exact"
"""Stands in a call beside the effects that it names where their form is said to leave something over."""
TOLD_APART = 20.0
"""D at which two effects can be told apart in 98.7 % of draws: the bar's stratum."""
SHOWS = 1.05
"""A gap (without the effect, in the oracle's hands) below this is so near to noise that its shrink is no number."""


@dataclass(frozen=True)
class Judged:
    """A case beside its answer.

    Attributes
    ----------
    name, kind, held, truth, coloured, hull : of the case; ``truth`` is the call that would be right, ``held`` the effects by name
    told : run.toml tells an input beside the usual ones
    nearest, rivals : D to the nearest rival and to each
    said : the diagnosis's call
    probability : of what was said
    set95 : calls that hold 95 %
    own_class : effects that the diagnosis itself cannot tell from what it said
    shrink, interval, oracle : of the headline; None where the truth is no effect or the gap is too small
    gap : without the effect, in the oracle's hands; 0: not known
    seconds : to the answer
    calls : method -> call, of the baselines
    forms : effect -> the form that it has in reality
    kept : one of these forms was kept out while the diagnosis was worked on
    """

    name: str
    kind: str
    held: tuple[str, ...]
    truth: Call
    coloured: bool
    hull: str
    told: bool
    nearest: float | None
    rivals: Mapping[str, float]
    said: Call
    probability: float
    set95: tuple[Call, ...]
    own_class: Call
    shrink: float | None
    interval: tuple[float, float] | None
    oracle: float | None
    gap: float
    seconds: float
    calls: Mapping[str, Call]
    forms: Mapping[str, str] = field(default_factory=dict)
    kept: bool = False

    @property
    def clear(self) -> bool:
        """The truth can be told from its nearest rival."""
        return self.nearest is not None and self.nearest > TOLD_APART

    def right(self, said: Call) -> bool:
        """Exactly the truth, and nothing said against its form."""
        return said == self.truth

    def named_right(self, said: Call) -> bool:
        """The truth by its names, their form called exact or not; that anything is inexact where there is no effect is wrong."""
        if INEXACT in said:
            return self.kind in ("effect", "pair") and names_of(said) == self.truth
        return said == self.truth

    def in_class(self, said: Call) -> bool:
        """The truth, or one effect instead of it that the data cannot tell from it (D of at most 20); its form exact or not."""
        if self.named_right(said):
            return True
        names = names_of(said)
        if self.kind != "effect" or len(names) != 1:
            return False
        return self.rivals.get(next(iter(names)), float("inf")) <= TOLD_APART


def names_of(said: Call) -> Call:
    """A call without what it says of forms."""
    return said - {INEXACT}


def truth_of(case: Case) -> Call:
    """The call that would be right."""
    if case.kind == "null":
        return NO_GAP
    return UNKNOWN if case.kind == "unknown" else frozenset(case.effects)


def judged(
    case: Case, answer: Mapping[str, Any], measure: Mapping[str, Any], calls: Mapping[str, Call] | None = None
) -> Judged:
    """Put a case beside its answer.

    Parameters
    ----------
    case : as drawn
    answer : of ``run.answers``
    measure : of ``measure.measured`` (empty for a null)
    calls : baselines
    """
    gap = answer.get("gap")
    said, probability, own = NONE, 0.0, frozenset()
    sets: tuple[Call, ...] = ()
    shrink = interval = None
    if gap is not None:
        said, probability = call_of(gap)
        sets = tuple(frozenset(names) for names in gap["set95"])
        names = names_of(said)
        group = next((g for g in gap["indistinguishable"] if names and g[0] in names), [])
        own = frozenset(group) - names
        row = next((r for r in gap["ranking"] if frozenset(r["effects"]) == names), None)
        if row is not None and case.kind in ("effect", "pair"):
            shrink, interval = float(row["shrink"]), tuple(row["shrink_interval"])
    return Judged(
        case.name,
        case.kind,
        tuple(case.effects),
        truth_of(case),
        bool(case.noise["coloured"]),
        case.hull_name,
        bool(case.told),
        measure.get("nearest"),
        measure.get("rivals", {}),
        said,
        probability,
        sets,
        own,
        shrink,
        interval,
        measure.get("oracle_shrink") if measure.get("oracle_before", 0.0) > SHOWS else None,
        float(measure.get("oracle_before", 0.0)),
        float(answer.get("seconds", float("nan"))),
        dict(calls or {}),
        {effect: form_of(case, effect) for effect in case.effects},
        bool(case.kept),
    )


def call_of(gap: Mapping[str, Any]) -> tuple[Call, float]:
    """The verdict of a gap.json, and its probability: of an effect, that it is there, its form exact or not."""
    if gap["verdict"] == "no_gap":
        return NO_GAP, float(gap["p_no_gap"])
    if gap["verdict"] == "unknown":
        return UNKNOWN, float(gap["p_unknown"])
    if gap["verdict"] == "not_converged":
        return NONE, 0.0
    first = gap["ranking"][0]
    names = frozenset(first["effects"]) | ({INEXACT} if gap["verdict"] == "form_not_exact" else frozenset())
    return names, float(first["probability"]) + float(first.get("probability_inexact", 0.0))
