"""The library of effects (formats.md): what reality has and the tow on a line of one length does not know."""

from __future__ import annotations

from .base import STAGES, Effect, Parameter, Seen, Situation, installed_effects, load_effects
from .camera import DECK, DELAY, DRIFT, LENS, POST, RATE, ROLL, ROLLING, SCALE, SHIFT, SHUTTER
from .hull import ASYMMETRY, BANK, COUPLING, CROSSFLOW, CUBIC, CURRENT, MEMORY
from .line import ELASTIC, FRICTION, KEPT, LAW, OFFSET, TENSION, slack

LIBRARY: tuple[Effect, ...] = (
    CROSSFLOW,
    CUBIC,
    ASYMMETRY,
    COUPLING,
    *MEMORY,
    BANK,
    CURRENT,
    DRIFT,
    KEPT,
    TENSION,
    LAW,
    ELASTIC,
    OFFSET,
    FRICTION,
    LENS,
    DECK,
    SHIFT,
    SCALE,
    POST,
    ROLL,
    *ROLLING,
    RATE,
    DELAY,
    SHUTTER,
)
"""All but ``slack_line``, whose window is found in the runs (``slack``)."""

__all__ = [
    "LIBRARY",
    "STAGES",
    "Effect",
    "Parameter",
    "Seen",
    "Situation",
    "installed_effects",
    "load_effects",
    "slack",
]
