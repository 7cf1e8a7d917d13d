"""What the diagnosis asks of a simulator beyond what a fit does: what else may be missing, and what cannot be told apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, Self

from ..effects import Effect
from .evidence import Fitted, Inference
from .hypothesis import Hypothesis
from .simulator import Simulator


class Diagnosable(Simulator, Protocol):
    """A simulator whose gap can be diagnosed."""

    def as_quiet_as(self, inference: Inference, base: Fitted) -> Self:
        """The same simulator, its runs' measurement granted no more error than they show beside the base."""
        ...

    def unlike(self, base: Fitted, best: Effect | None = None) -> Sequence[Hypothesis]:
        """Starts of hypotheses that no step from the base leads to (a line that pays out), where its residual asks for them, or
        where the best effect that was found does.
        """
        ...

    def forms(self, effect: Effect) -> Sequence[Effect]:
        """Of an effect that ``unlike`` has begun, other forms, which can begin from its numbers."""
        ...

    def suggested(self, base: Fitted) -> list[Effect]:
        """Effects that what the base, or a fit with an effect, leaves suggests itself (windows of a slack line)."""
        ...

    def free_forms(self, shaken_hz: Sequence[float]) -> Sequence[Effect]:
        """What stands for an effect in no library; ``shaken_hz`` stand out of what the base leaves."""
        ...

    def one_off(self, inference: Inference, base: Fitted) -> Sequence[Effect]:
        """What stands for something that acted once, where what the base's random forces do asks for it."""
        ...

    def free_beside(self) -> Sequence[Effect]:
        """What stands, beside the best effects, for something in no library that they leave; none: it is told by random forces
        and by what stands out alone.
        """
        ...

    def symmetries(self, inference: Inference, base: Fitted) -> Sequence[tuple[str, Sequence[str]]]:
        """What no motion like these can tell apart, each with the effect that raises the question ("": always said)."""
        ...

    def reached(self, fitted: Fitted) -> str:
        """In words: how large the motion was in which an effect showed."""
        ...


__all__ = ["Diagnosable"]
