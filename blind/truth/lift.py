"""What pulls a hull to one side, and damping that comes late: hull asymmetry and fluid memory, in several forms.

Functions as in ``damping``.
"""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lanes
from .now import Now


def fin(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A crooked fin: lift of constant incidence, grown by the flow at its own place."""
    at = q["hull_asymmetry.place"] * q["length_pp"]
    flow = now.speed**2 + (now.v + at * now.r) ** 2
    side = q["hull_asymmetry.lift_n_s2_m2"] * flow
    return side, side * at + q["hull_asymmetry.twist_n_m_s2_m2"] * now.speed**2


def stalling_fin(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A fin whose lift falls as the water comes at it from aside."""
    at = q["hull_asymmetry.place"] * q["length_pp"]
    across = now.v + at * now.r
    local = np.arctan2(across, np.maximum(now.speed, 0.05))
    side = q["hull_asymmetry.stall_n_s2_m2"] * (now.speed**2 + across**2)
    side = side / (1 + (local / np.maximum(q["hull_asymmetry.stall_rad"], 0.02)) ** 2)
    return side, side * at


def wire(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A cable to the carriage pulls aside, whatever the speed."""
    return q["hull_asymmetry.wire_n"], q["hull_asymmetry.wire_n_m"]


def growing_side(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A side force at one place that grows with the speed to a power of its own; its number is the force at the hull's speed."""
    ratio = np.maximum(now.speed, 0.0) / q["speed_ref"]
    side = q["hull_asymmetry.grows_n"] * ratio ** q["hull_asymmetry.power"]
    return side, side * q["hull_asymmetry.place"] * q["length_pp"]


def convolved(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Damping through a kernel of two exponentials: a share of it answers to the velocity as it was."""
    quick = q["fluid_memory.quick"]
    v = quick * now.lag[0] + (1 - quick) * now.lag[1] - now.v
    r = quick * now.lag[2] + (1 - quick) * now.lag[3] - now.r
    return _late(q, now, q["fluid_memory.sway"] * v, q["fluid_memory.yaw"] * r)


def ringing(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Damping through a kernel that swings as it dies away, as that of waves at the free surface."""
    v, r = now.lag[0] - now.v, now.lag[2] - now.r
    return _late(q, now, q["fluid_memory.ring_sway"] * v, q["fluid_memory.ring_yaw"] * r)


def _late(q: Lanes, now: Now, sway: Array, yaw: Array) -> tuple[Array, Array]:
    scale = now.speed / q["speed_ref"]
    return scale * q["y_v"] * sway, scale * (q["n_v"] * sway * q["fluid_memory.arm"] + q["n_r"] * yaw)


def memory_rates(q: Lanes, lag: Array, v: Array, r: Array) -> Array:
    """Time derivatives of the memory's states ``(4, n)``.

    Parameters
    ----------
    q : numbers
    lag : the states; of two lags v fast, v slow, r fast, r slow; of a ringing kernel v, its rate, r, its rate
    v, r : sway velocity and yaw rate
    """
    fast, slow = (np.maximum(q[f"fluid_memory.{name}_s"], 0.1) for name in ("fast", "slow"))
    rates = np.stack([(v - lag[0]) / fast, (v - lag[1]) / slow, (r - lag[2]) / fast, (r - lag[3]) / slow])
    if q.has("fluid_memory.ring_s"):
        w = 2 * np.pi / np.maximum(q["fluid_memory.ring_s"], 0.3)
        held = 2 * q["fluid_memory.ring_damping"] * w
        swings = np.stack([lag[1], w**2 * (v - lag[0]) - held * lag[1], lag[3], w**2 * (r - lag[2]) - held * lag[3]])
        rates = np.where(q["fluid_memory.ring_s"] > 0, swings, rates)
    return rates
