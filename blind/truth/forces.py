"""Forces on the hull that the linear model does not hold, in forms of their own.

Every function takes lanes and situation and returns side force, N to starboard, and moment, N m bow to starboard: ``(n,)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .lanes import Array, Lanes

STRIPS = 24
"""Of a hull over its length, for the crossflow's integral: a choice."""
WALLS = 4
"""Images of the hull behind each wall."""
_MIDDLES = (np.arange(STRIPS) + 0.5) / STRIPS - 0.5
"""Of the strips, in Lpp ahead of midship."""


@dataclass(frozen=True)
class Now:
    """What the hull does at this moment; all ``(n,)``, SI.

    Attributes
    ----------
    t_s : float
    y_m, beta, v, r : place of the LCG, heading, sway velocity, yaw rate
    speed : forward speed through the water
    side_n : the line's pull to starboard
    turning : rate of the line against the hull, rad/s
    lag : memory states ``(4, n)``: v fast, v slow, r fast, r slow
    slosh : displacement of the tank's sideways wave
    """

    t_s: float
    y_m: Array
    beta: Array
    v: Array
    r: Array
    speed: Array
    side_n: Array
    turning: Array
    lag: Array
    slosh: Array


def strip_drag(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Cross-flow drag by strips, its coefficient varying along the hull (fuller at the ends or amidships, heavier aft)."""
    place = _MIDDLES[:, None] * q["length_pp"]
    across = now.v + place * now.r
    along = 2 * _MIDDLES[:, None]
    depth = q["crossflow_drag.drag_m"] * (
        1 + q["crossflow_drag.tilt"] * along + q["crossflow_drag.ends"] * (along**2 - 1 / 3)
    )
    each = -0.5 * q["density"] * depth * across * np.abs(across) * (q["length_pp"] / STRIPS)
    return each.sum(axis=0), (each * place).sum(axis=0)


def drift_cubic(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Third-order polynomial in drift angle and turning rate, the forces growing with the speed squared."""
    speed = np.maximum(now.speed, 0.05)
    drift = np.arctan2(now.v, speed)
    turn = now.r * q["length_pp"] / speed
    pressure = 0.5 * q["density"] * speed**2 * q["length_pp"] ** 2
    side = -pressure * q["cubic_damping.side"] * drift**3
    arm = q["cubic_damping.arm"] * q["length_pp"]
    return side, side * arm - pressure * q["length_pp"] * q["cubic_damping.turn"] * turn**3


def fin(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A crooked fin: lift of constant incidence, grown by the flow at its own place."""
    at = q["hull_asymmetry.place"] * q["length_pp"]
    flow = now.speed**2 + (now.v + at * now.r) ** 2
    side = q["hull_asymmetry.lift_n_s2_m2"] * flow
    return side, side * at + q["hull_asymmetry.twist_n_m_s2_m2"] * now.speed**2


def convolved(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Damping through a kernel of two exponentials: a share of it answers to the velocity as it was."""
    scale = now.speed / q["speed_ref"]
    quick = q["fluid_memory.quick"]
    v = quick * now.lag[0] + (1 - quick) * now.lag[1] - now.v
    r = quick * now.lag[2] + (1 - quick) * now.lag[3] - now.r
    sway, yaw = q["fluid_memory.sway"] * v, q["fluid_memory.yaw"] * r
    return scale * q["y_v"] * sway, scale * (q["n_v"] * sway * q["fluid_memory.arm"] + q["n_r"] * yaw)


def wall_images(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Images of the hull's sections behind both walls attract it: three sections, inverse cube of the distance."""
    width = q["tank_width"]
    total, moment = np.zeros(q.n), np.zeros(q.n)
    lead = q["bank_suction.lead"]
    for share, weight in ((-0.3, 1 - lead), (0.0, 1.0), (0.3, 1 + lead)):
        at = share * q["length_pp"]
        y = now.y_m + at * np.sin(now.beta)
        pull = np.zeros(q.n)
        for k in range(WALLS):
            # mirrored an odd number of times: the image's own place depends on y, the even ones' does not
            near, far = (2 * k + 1) * width - 2 * y, (2 * k + 1) * width + 2 * y
            pull += 1 / (near * near * near) - 1 / (far * far * far)
        force = q["bank_suction.strength_m5"] * q["density"] * now.speed**2 * pull * weight / 3
        total += force
        moment += force * at
    return total, moment


def sheared_current(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Sideways flow of the water, stronger on one side of the tank."""
    scale = now.speed / q["speed_ref"]
    flow = q["cross_current.flow_m_s"] * (1 + q["cross_current.shear"] * now.y_m / (q["tank_width"] / 2))
    across = flow * np.cos(now.beta)
    return -scale * q["y_v"] * across, -scale * q["n_v"] * across


def stribeck(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The swivel sticks more than it slides, and rubs a little like oil."""
    w = now.turning
    grip = 1 + q["swivel_friction.stick"] * np.exp(-((w / 0.02) ** 2))
    moment = q["swivel_friction.moment_n_m"] * (grip * np.tanh(w / 0.005) + 2.0 * w)
    return np.zeros(q.n), -moment


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
    ("cubic_damping.side", drift_cubic),
    ("cubic_damping.turn", drift_cubic),
    ("hull_asymmetry.lift_n_s2_m2", fin),
    ("hull_asymmetry.twist_n_m_s2_m2", fin),
    ("fluid_memory.sway", convolved),
    ("fluid_memory.yaw", convolved),
    ("bank_suction.strength_m5", wall_images),
    ("cross_current.flow_m_s", sheared_current),
    ("swivel_friction.moment_n_m", stribeck),
    ("washboard.side_n", washboard),
    ("washboard.moment_n_m", washboard),
    ("kick.side_n", kick),
    ("kick.moment_n_m", kick),
    ("sloshing.side_n", sloshing),
    ("magnet.side_n", magnet),
    ("magnet.moment_n_m", magnet),
)
"""A number that switches a force on, and the force."""


def forces_of(q: Lanes):
    """The functions that some lane needs."""
    return tuple(dict.fromkeys(term for name, term in TERMS if q.has(name)))
