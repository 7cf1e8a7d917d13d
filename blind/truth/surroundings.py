"""What the tank does to the hull: suction of its walls and water that moves across it, in several forms.

Functions as in ``damping``.
"""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lanes
from .now import Now

WALLS = 4
"""Images of the hull behind each wall."""
_MIRRORED = (2 * np.arange(WALLS) + 1)[:, None]
"""At how many widths they stand."""
_SECTIONS = np.array([[-0.3], [0.0], [0.3]])
"""Of the hull, in Lpp ahead of midship."""
NEAREST = 0.95
"""A gap is no smaller than 5 % of the half width."""


def wall_images(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Images of the hull's sections behind both walls attract it: three sections, inverse cube of the distance."""
    lead, width = q["bank_suction.lead"], _MIRRORED * q["tank_width"]
    at = _SECTIONS * q["length_pp"]
    twice = 2 * (now.y_m + at * np.sin(now.beta))[:, None]
    # mirrored an odd number of times: the image's own place depends on y, the even ones' does not
    near, far = width - twice, width + twice
    pull = (1 / (near * near * near) - 1 / (far * far * far)).sum(axis=1)
    weight = np.stack([1 - lead, np.ones(q.n), 1 + lead])
    force = q["bank_suction.strength_m5"] * q["density"] * now.speed**2 * pull * weight / 3
    return force.sum(axis=0), (force * at).sum(axis=0)


def gap_power(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Both walls by a power of the gap, a lever of its own; and sway damping that rises near a wall (``by_sway``)."""
    share, power = _share(q, now), np.maximum(q["bank_suction.power"], 0.5)
    near, far = (1 - share) ** -power, (1 + share) ** -power
    size = q["bank_suction.gap_n_s2_m2"] * now.speed / (2 * power)
    side = size * (now.speed * (near - far) - q["bank_suction.by_sway"] * now.v * (near + far - 2))
    return side, side * q["bank_suction.lever"] * q["length_pp"]


def near_wall(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The nearer wall alone, by a power of the gap; nothing in the tank's middle."""
    share, power = _share(q, now), np.maximum(q["bank_suction.power"], 0.5)
    size = q["bank_suction.near_n_s2_m2"] * now.speed**2 / power
    side = size * np.sign(share) * ((1 - np.abs(share)) ** -power - 1)
    return side, side * q["bank_suction.lever"] * q["length_pp"]


def _share(q: Lanes, now: Now) -> Array:
    """Place across the tank as a share of the half width."""
    return np.clip(now.y_m / (q["tank_width"] / 2), -NEAREST, NEAREST)


def sheared_current(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Sideways flow of the water, stronger on one side of the tank."""
    flow = q["cross_current.flow_m_s"] * (1 + q["cross_current.shear"] * now.y_m / (q["tank_width"] / 2))
    return _carried(q, now, flow)


def even_current(q: Lanes, now: Now) -> tuple[Array, Array]:
    """The same flow everywhere: the hull's whole motion is relative to it, its speed ahead too."""
    flow = q["cross_current.even_m_s"]
    ahead, across = flow * np.sin(now.beta), flow * np.cos(now.beta)
    slower, here = (now.speed - ahead) / q["speed_ref"], now.speed / q["speed_ref"]
    y_r = q["y_r"] + q["mass"] * q["speed_ref"]
    side = q["y_v"] * (slower * (now.v - across) - here * now.v) + (slower - here) * y_r * now.r
    moment = q["n_v"] * (slower * (now.v - across) - here * now.v) + (slower - here) * q["n_r"] * now.r
    return side, moment


def growing_current(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A flow that grows along the tank, from a share of its full strength at the release."""
    first = q["cross_current.first"]
    way = np.clip(now.t_s / np.maximum(q["duration"], 1.0), 0.0, 1.2)
    return _carried(q, now, q["cross_current.grows_m_s"] * (first + (1 - first) * way))


def swirls(q: Lanes, now: Now) -> tuple[Array, Array]:
    """A flow that goes to and fro along the tank, as eddies do that an earlier tow has left."""
    phase = 2 * np.pi * q["speed"] * now.t_s / np.maximum(q["cross_current.eddy_m"], 1.0)
    return _carried(q, now, q["cross_current.swirl_m_s"] * np.cos(phase + q["cross_current.phase"]))


def _carried(q: Lanes, now: Now, flow: Array) -> tuple[Array, Array]:
    scale = now.speed / q["speed_ref"]
    across = flow * np.cos(now.beta)
    return -scale * q["y_v"] * across, -scale * q["n_v"] * across
