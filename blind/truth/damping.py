"""Forces of a hull that moves sideways or turns, beyond the linear ones: cross-flow drag and cubic damping, in several forms.

Every function takes lanes and situation and returns side force, N to starboard, and moment, N m bow to starboard: ``(n,)``.
"""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lanes
from .now import Now

STRIPS = 24
"""Of a hull over its length, for the crossflow's integral: a choice."""
_MIDDLES = (np.arange(STRIPS) + 0.5) / STRIPS - 0.5
"""Of the strips, in Lpp ahead of midship."""
STEEP_RAD = 0.2
"""Drift at which a steep law and a cubic one of the same number are equal."""


def strip_drag(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Cross-flow drag by strips, its coefficient varying along the hull (fuller at the ends or amidships, heavier aft)."""
    along = 2 * _MIDDLES[:, None]
    depth = q["crossflow_drag.drag_m"] * (
        1 + q["crossflow_drag.tilt"] * along + q["crossflow_drag.ends"] * (along**2 - 1 / 3)
    )
    return _by_strips(q, now, depth)


def skeg_drag(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Cross-flow drag of one part of the hull alone (a skeg, a deep forefoot): a bell about its place."""
    wide = np.maximum(q["crossflow_drag.wide"], 0.02)
    bell = np.exp(-0.5 * ((_MIDDLES[:, None] - q["crossflow_drag.at"]) / wide) ** 2)
    return _by_strips(q, now, q["crossflow_drag.skeg_m"] * bell)


def _by_strips(q: Lanes, now: Now, depth: Array) -> tuple[Array, Array]:
    """Drag of strips of a depth times coefficient ``(strips, n)``, m."""
    place = _MIDDLES[:, None] * q["length_pp"]
    across = now.v + place * now.r
    each = -0.5 * q["density"] * depth * across * np.abs(across) * (q["length_pp"] / STRIPS)
    return each.sum(axis=0), (each * place).sum(axis=0)


def whole_drag(q: Lanes, now: Now) -> tuple[Array, Array]:
    """v|v| of the whole hull at a place of its own (trim), and a drag of turning, r|r|."""
    length = q["length_pp"]
    size = 0.5 * q["density"] * q["crossflow_drag.whole_m"] * length
    side = -size * now.v * np.abs(now.v)
    turning = q["crossflow_drag.turning"] * size * length**3 / 32 * now.r * np.abs(now.r)
    return side, side * q["crossflow_drag.lever"] * length - turning


def moduli(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The manoeuvring books' second-order moduli: v|v|, v|r| aside, v|r| and r|r| in the moment."""
    length = q["length_pp"]
    size = -0.5 * q["density"] * q["crossflow_drag.moduli_m"] * length
    turn, rate = now.r * length, np.abs(now.r) * length
    side = size * now.v * (np.abs(now.v) + q["crossflow_drag.v_by_r"] * rate)
    moment = size * length * (q["crossflow_drag.moment_v_by_r"] * now.v * rate + q["crossflow_drag.r_r"] * turn * rate)
    return side, moment


def drift_cubic(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Third-order polynomial in drift angle and turning rate, the forces growing with the speed squared."""
    speed, drift, turn = _angles(q, now)
    pressure = 0.5 * q["density"] * speed**2 * q["length_pp"] ** 2
    side = -pressure * q["cubic_damping.side"] * drift**3
    arm = q["cubic_damping.arm"] * q["length_pp"]
    return side, side * arm - pressure * q["length_pp"] * q["cubic_damping.turn"] * turn**3


def plain_cubes(q: Lanes, now: Now) -> tuple[Array, Array]:
    """v^3 and r^3, whatever the speed ahead is."""
    length = q["length_pp"]
    size = 0.5 * q["density"] * length**2 / q["speed_ref"]
    side = -size * q["cubic_damping.plain_side"] * now.v**3
    moment = side * q["cubic_damping.arm"] * length
    return side, moment - size * length * q["cubic_damping.plain_turn"] * (now.r * length) ** 3


def mixed_cubes(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Cubes of drift and turning with their products, v r^2 and r v^2, growing with the speed to a power of its own."""
    speed, drift, turn = _angles(q, now)
    length, growth = q["length_pp"], q["cubic_damping.growth"]
    pressure = 0.5 * q["density"] * length**2 * q["speed_ref"] ** (2 - growth) * speed**growth
    side = -pressure * q["cubic_damping.mix_side"] * (drift**3 + q["cubic_damping.cross"] * drift * turn**2)
    own = q["cubic_damping.mix_turn"] * (turn**3 + q["cubic_damping.yaw_cross"] * turn * drift**2)
    return side, side * q["cubic_damping.arm"] * length - pressure * length * own


def steep_drift(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A side force that grows with another power of the drift angle than the third."""
    speed, drift, _ = _angles(q, now)
    power = q["cubic_damping.power"]
    pressure = 0.5 * q["density"] * speed**2 * q["length_pp"] ** 2 * STEEP_RAD**3
    law = np.sign(drift) * (np.abs(drift) / STEEP_RAD) ** power
    side = -pressure * q["cubic_damping.steep_side"] * law
    return side, side * q["cubic_damping.arm"] * q["length_pp"]


def _angles(q: Lanes, now: Now) -> tuple[Array, Array, Array]:
    """Speed ahead m/s, drift angle rad, turning rate by length and speed."""
    speed = np.maximum(now.speed, 0.05)
    return speed, np.arctan2(now.v, speed), now.r * q["length_pp"] / speed
