"""Friction at the line's ends, in several laws. Functions as in ``damping``."""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lanes
from .now import Now

TURNS = 0.05
"""rad/s at which the number of an oil or a grease is its moment: that of a tow's swing."""
DRY_RAD_S, CREEPS = 0.0015, 0.002
"""Dry friction has turned over at the first; a grease is like oil below the second, rad/s."""


def stribeck(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The swivel sticks more than it slides, and rubs a little like oil."""
    w = now.turning
    grip = 1 + q["swivel_friction.stick"] * np.exp(-((w / 0.02) ** 2))
    moment = q["swivel_friction.moment_n_m"] * (grip * np.tanh(w / 0.005) + 2.0 * w)
    return np.zeros(q.n), -moment


def dry_and_oil(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Dry friction of one size (Coulomb), and oil that grows with the rate: each alone or both."""
    w = now.turning
    moment = q["swivel_friction.dry_n_m"] * np.tanh(w / DRY_RAD_S) + q["swivel_friction.oil_n_m"] * w / TURNS
    return np.zeros(q.n), -moment


def grease(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A grease that thins as it is sheared: a power of the rate below one."""
    w = now.turning
    law = w * (w**2 + CREEPS**2) ** ((q["swivel_friction.thins"] - 1) / 2) / TURNS ** q["swivel_friction.thins"]
    return np.zeros(q.n), -q["swivel_friction.grease_n_m"] * law


def at_the_post(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The line's other end rubs on the post: a moment on the line, and by its length a force across it at the tow point."""
    side = -q["swivel_friction.post_n_m"] * np.tanh(now.post_turn / DRY_RAD_S) * now.across_1_m
    return side, side * q["x_t"]
