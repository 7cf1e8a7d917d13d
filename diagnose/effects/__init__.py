"""The library of effects (formats.md): what reality has and the tow on a line of one length does not know."""

from __future__ import annotations

from .base import STAGES, Effect, Parameter, Seen, Situation, installed_effects, load_effects
from .camera import (
    DECK,
    DELAY,
    DELAY_FORMS,
    DRIFT,
    DRIFT_RAMPS,
    LENS,
    POST,
    RATE,
    RATE_FORMS,
    ROLL,
    ROLLING,
    ROLLING_FREELY,
    SCALE,
    SHIFT,
    SHUTTER,
    delayed_each,
    delayed_since,
)
from .hull import ASYMMETRY, BANK, CABLE, COUPLING, CROSSFLOW, CROSSFLOW_ENDS, CUBIC, CUBIC_FORMS, CURRENT, MEMORY
from .line import ELASTIC, FRICTION, FRICTION_FORMS, KEPT, LAW, LAWS, OFFSET, TENSION, jerked, slack

LIBRARY: tuple[Effect, ...] = (
    CROSSFLOW,
    CROSSFLOW_ENDS,
    CUBIC,
    *CUBIC_FORMS,
    ASYMMETRY,
    CABLE,
    COUPLING,
    *MEMORY,
    *BANK,
    CURRENT,
    DRIFT,
    *DRIFT_RAMPS,
    KEPT,
    TENSION,
    LAW,
    ELASTIC,
    OFFSET,
    FRICTION,
    *FRICTION_FORMS,
    LENS,
    DECK,
    SHIFT,
    SCALE,
    POST,
    ROLL,
    *ROLLING,
    *ROLLING_FREELY,
    RATE,
    *RATE_FORMS,
    DELAY,
    *DELAY_FORMS,
    SHUTTER,
)
"""All but ``slack_line``, whose window or course is found in the runs (``slack``, ``jerked``)."""

__all__ = [
    "DELAY_FORMS",
    "ELASTIC",
    "LAWS",
    "LIBRARY",
    "STAGES",
    "Effect",
    "Parameter",
    "Seen",
    "Situation",
    "delayed_each",
    "delayed_since",
    "installed_effects",
    "jerked",
    "load_effects",
    "slack",
]
