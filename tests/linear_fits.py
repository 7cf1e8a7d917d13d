"""Fits of linear campaigns, for tests."""

from __future__ import annotations

from towline.diagnose.effects import Effect
from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.grams import Grams
from towline.diagnose.inference.hypothesis import with_effects
from towline.diagnose.inference.noise import Forces
from towline.diagnose.users import UsersSimulator

NONE = Forces(1e-9, 1e-9, 1)
"""No random forces: what is left is white."""


def fitted(simulator: UsersSimulator, *effects: Effect) -> tuple[Inference, Fitted]:
    """At the optimum, without random forces."""
    h = with_effects(simulator.starts()[0], list(effects))
    inference = Inference(simulator, simulator.noise(h))
    for _ in range(8):
        linear = inference.linear([h])[0]
        grams = Grams(linear.columns, inference.noise)
        found = Fitted(h, NONE, 0.0, inference.solve(grams, h, NONE), linear, grams)
        h = inference.stepped(found, 1.0)
    return inference, found
