"""What the diagnosis finds: hypotheses with their evidence and probabilities."""

from __future__ import annotations

from dataclasses import dataclass, field

from ...simulate.model import Array
from ..effects import Effect
from .evidence import Fitted
from .scan import Leftover

P_NO_GAP, P_SINGLE, P_PAIR, P_UNKNOWN = 0.5, 0.36, 0.07, 0.07
"""Prior shares: of no gap, all single effects, all pairs, and what is in no library."""


@dataclass(frozen=True)
class Candidate:
    """One or two effects, fitted.

    Attributes
    ----------
    effects : of the library (or a free form)
    fitted : the optimum
    log_evidence : over the base's
    log_prior : share of the prior
    """

    effects: tuple[Effect, ...]
    fitted: Fitted
    log_evidence: float
    log_prior: float

    @property
    def form(self) -> float:
        """Log evidence that its own form may have left over: below, there is nothing unknown."""
        return max(e.form for e in self.effects) * max(self.log_evidence, 0.0)

    @property
    def second(self) -> float:
        """As much of it as another effect may take: above, that is there, too."""
        shares = (e.form if e.second is None else e.second for e in self.effects)
        return max(shares) * max(self.log_evidence, 0.0)

    @property
    def weight(self) -> float:
        """Log of its evidence and prior together."""
        return self.log_evidence + self.log_prior

    @property
    def names(self) -> tuple[str, ...]:
        """Effect names, without variants."""
        return tuple(e.name for e in self.effects)

    @property
    def variant(self) -> str:
        """Which form of its effects; empty where they have one each."""
        return "; ".join(e.variant for e in self.effects if e.variant)


@dataclass(frozen=True)
class Ranking:
    """All hypotheses with probabilities.

    Attributes
    ----------
    base : no effect
    candidates : best first, one per set of names
    probabilities : of the candidates as they are
    p_no_gap, p_unknown : of the rest
    free : the best free form, or None
    beside : one of the best candidates with a free form for what it leaves, or None
    follows : whether the simulator as it is follows its runs with random forces that count as noise; else it explains nothing
    rest : what the best hypothesis leaves over
    excluded : effect -> why it could not be judged
    forms : names of a candidate -> log evidence of each form of its effects that was fitted, the best first
    inexact : probabilities of the candidates, in another form than the library's; None: of none
    """

    base: Fitted
    candidates: tuple[Candidate, ...]
    probabilities: Array
    p_no_gap: float
    p_unknown: float
    free: Candidate | None
    rest: Leftover
    excluded: dict[str, str]
    forms: dict[tuple[str, ...], dict[str, float]] = field(default_factory=dict)
    inexact: Array | None = None
    beside: Candidate | None = None
    follows: bool = True

    @property
    def named(self) -> Array:
        """Probabilities that the candidates' effects are there, whatever their form."""
        return self.probabilities if self.inexact is None else self.probabilities + self.inexact

    @property
    def for_unknown(self) -> Candidate | None:
        """What stands for something unknown: a free form alone, or beside a candidate (then its last effect)."""
        found = [c for c in (self.free, self.beside) if c is not None]
        return max(found, key=lambda c: c.log_evidence, default=None)

    @property
    def set95(self) -> list[tuple[str, ...]]:
        """The fewest hypotheses that hold 95 % of the probability; () is no gap, ("unknown",) unknown."""
        every = [((), self.p_no_gap), (("unknown",), self.p_unknown)]
        every += [(c.names, float(p)) for c, p in zip(self.candidates, self.named, strict=True)]
        every.sort(key=lambda pair: -pair[1])
        total, kept = 0.0, []
        for names, p in every:
            kept.append(names)
            total += p
            if total >= 0.95:
                break
        return kept


__all__ = ["P_NO_GAP", "P_PAIR", "P_SINGLE", "P_UNKNOWN", "Candidate", "Ranking"]
