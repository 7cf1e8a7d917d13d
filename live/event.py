"""What is named while a tow is filmed: one line, once, when it begins, and once when it is over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["good", "warning", "fault"]


@dataclass(frozen=True)
class Event:
    """Something that was named.

    Attributes
    ----------
    kind : "mark", "camera", "line", "wall", "clock", "missing", "source", "damaged"
    t_s : of the frame at which it was named (of a source that is silent: the last frame's, and the silence)
    words : one line
    level : fault: what is filmed now is lost; warning: to be looked at; good: it is over
    """

    kind: str
    t_s: float
    words: str
    level: Level


class Lasting:
    """A condition that is named when it has held for ``hold_s``, and again when it has been over for as long.

    Frames that do not tell leave it as it is.
    """

    def __init__(self, hold_s: float) -> None:
        self._hold_s = hold_s
        self._since: float | None = None
        self.named = False

    def step(self, t_s: float, holds: bool | None) -> bool | None:
        """True when it is to be named, False when it is over; None: nothing new.

        Parameters
        ----------
        t_s : now
        holds : what this frame says; None: nothing
        """
        if holds is None:
            return None
        if holds == self.named:
            self._since = None
            return None
        if self._since is None:
            self._since = t_s
        if t_s - self._since < self._hold_s:
            return None
        self.named, self._since = holds, None
        return holds

    def since(self, t_s: float) -> float:
        """How long the change that is not named yet has lasted, s."""
        return 0.0 if self._since is None else t_s - self._since


__all__ = ["Event", "Lasting", "Level"]
