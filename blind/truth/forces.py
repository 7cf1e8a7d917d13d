"""Which forces act beside the linear model's: those of no library, a rudder's, and the table of all.

Every function takes lanes and situation and returns side force, N to starboard, and moment, N m bow to starboard: ``(n,)``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .damping import drift_cubic, mixed_cubes, moduli, plain_cubes, skeg_drag, steep_drift, strip_drag, whole_drag
from .lanes import Array, Lanes
from .laws import TERMS as LAW_TERMS
from .laws import law_force
from .lift import convolved, fin, growing_side, ringing, stalling_fin, wire
from .now import Now
from .surroundings import (
    even_current,
    gap_power,
    growing_current,
    near_wall,
    sheared_current,
    swirls,
    wall_images,
)
from .swivel import at_the_post, dry_and_oil, grease, stribeck

Force = Callable[[Lanes, Now], tuple[Array, Array]]


def washboard(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A force that comes and goes with the place across the tank."""
    phase = 2 * np.pi * now.y_m / np.maximum(q["washboard.length_m"], 1e-3) + q["washboard.phase"]
    return q["washboard.side_n"] * np.sin(phase), q["washboard.moment_n_m"] * np.cos(phase)


def kick(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Someone hits the model once."""
    shape = np.exp(-0.5 * ((now.t_s - q["kick.time_s"]) / np.maximum(q["kick.width_s"], 1e-3)) ** 2)
    return q["kick.side_n"] * shape, q["kick.moment_n_m"] * shape


def sloshing(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The tank's lowest sideways wave, rung by the release and by the hull, pushes back."""
    return q["sloshing.side_n"] * now.slosh, q["sloshing.side_n"] * q["sloshing.arm_m"] * now.slosh


def magnet(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A force that depends on the heading alone, quickly."""
    phase = now.beta / np.maximum(q["magnet.angle_rad"], 1e-3) + q["magnet.phase"]
    return q["magnet.side_n"] * np.sin(phase), q["magnet.moment_n_m"] * np.sin(phase)


def rudder_rad(q: Lanes, t_s: Array | float) -> Array:
    """Held, or to and fro by the clock as a servo of limited rate follows: rad, positive to port."""
    wave = np.sin(2 * np.pi * (t_s / np.maximum(q["rudder.period_s"], 1.0) + q["rudder.phase"]))
    return q["rudder.angle_rad"] * np.where(q["rudder.period_s"] > 0, np.clip(2.0 * wave, -1.0, 1.0), 1.0)


def rudder(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The rudder, by the square of the speed through the water."""
    pressed = (now.speed / q["speed_ref"]) ** 2 * rudder_rad(q, now.t_s)
    return q["rudder.y_delta"] * pressed, q["rudder.n_delta"] * pressed


TERMS = (
    ("rudder.angle_rad", rudder),
    ("crossflow_drag.drag_m", strip_drag),
    ("crossflow_drag.skeg_m", skeg_drag),
    ("crossflow_drag.whole_m", whole_drag),
    ("crossflow_drag.moduli_m", moduli),
    ("cubic_damping.side", drift_cubic),
    ("cubic_damping.turn", drift_cubic),
    ("cubic_damping.plain_side", plain_cubes),
    ("cubic_damping.plain_turn", plain_cubes),
    ("cubic_damping.mix_side", mixed_cubes),
    ("cubic_damping.mix_turn", mixed_cubes),
    ("cubic_damping.steep_side", steep_drift),
    ("hull_asymmetry.lift_n_s2_m2", fin),
    ("hull_asymmetry.twist_n_m_s2_m2", fin),
    ("hull_asymmetry.stall_n_s2_m2", stalling_fin),
    ("hull_asymmetry.wire_n", wire),
    ("hull_asymmetry.wire_n_m", wire),
    ("hull_asymmetry.grows_n", growing_side),
    ("fluid_memory.sway", convolved),
    ("fluid_memory.yaw", convolved),
    ("fluid_memory.ring_sway", ringing),
    ("fluid_memory.ring_yaw", ringing),
    ("bank_suction.strength_m5", wall_images),
    ("bank_suction.gap_n_s2_m2", gap_power),
    ("bank_suction.near_n_s2_m2", near_wall),
    ("cross_current.flow_m_s", sheared_current),
    ("cross_current.even_m_s", even_current),
    ("cross_current.grows_m_s", growing_current),
    ("cross_current.swirl_m_s", swirls),
    ("swivel_friction.moment_n_m", stribeck),
    ("swivel_friction.dry_n_m", dry_and_oil),
    ("swivel_friction.oil_n_m", dry_and_oil),
    ("swivel_friction.grease_n_m", grease),
    ("swivel_friction.post_n_m", at_the_post),
    ("washboard.side_n", washboard),
    ("washboard.moment_n_m", washboard),
    ("kick.side_n", kick),
    ("kick.moment_n_m", kick),
    ("sloshing.side_n", sloshing),
    ("magnet.side_n", magnet),
    ("magnet.moment_n_m", magnet),
    *((f"law.{name}{k}", law_force) for k in range(LAW_TERMS) for name in ("side", "turn")),
)
"""A number that switches a force on, and the force."""


FEW = 0.5
"""Below this share of the lanes a force is worked out for those alone that have it: it is nothing in all others."""


def forces_of(q: Lanes) -> tuple[tuple[Force, Lanes, Array | None], ...]:
    """Every function that some lane needs, the numbers of its lanes, and which they are (None: all).

    Parameters
    ----------
    q : numbers
    """
    acts: dict[Force, Array] = {}
    for name, term in TERMS:
        if q.has(name):
            acts[term] = acts.get(term, np.zeros(q.n, dtype=bool)) | (q[name] != 0)
    found = []
    for term, on in acts.items():
        here = np.flatnonzero(on)
        found.append((term, q, None) if len(here) > FEW * q.n else (term, q.part(here), here))
    return tuple(found)
