"""What follows a drive as an oscillator does: a model that rolls."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...simulate.model import Array
from .base import Seen

SHORTEST_S = 0.3
"""No period is shorter: it would be over between two frames."""
DAMPED = (0.01, 0.9)
"""Between these shares of the critical one the damping is held."""


def swung(drive: Array, step_s: float, period_s: Any, damping: Any) -> Array:
    """What follows a drive with a period and damping of its own, from nothing and at rest at first.

    Exact for a drive that is straight from node to node: a free swing about the forced course.

    Parameters
    ----------
    drive : (nodes, ...) where it would stand if it had time
    step_s : between nodes
    period_s, damping : without damping, and of the critical one; they broadcast to a node's values

    Examples
    --------
    >>> float(swung(np.ones((200, 1)), 0.1, 1.0, 0.2)[-1, 0].round(3))
    1.0
    """
    w, zeta = 2 * np.pi / np.maximum(period_s, SHORTEST_S), np.clip(damping, *DAMPED)
    decay, own = zeta * w, w * np.sqrt(1 - zeta**2)
    left, cosine, sine = np.exp(-decay * step_s), np.cos(own * step_s), np.sin(own * step_s) / own
    found = np.zeros(np.broadcast_shapes(drive.shape, np.shape(w)))
    rate = np.zeros(found.shape[1:])
    for k in range(len(found) - 1):
        slope = (drive[k + 1] - drive[k]) / step_s
        behind = 2 * zeta / w * slope
        off, off_rate = found[k] - drive[k] + behind, rate - slope
        found[k + 1] = left * (off * (cosine + decay * sine) + off_rate * sine) + drive[k + 1] - behind
        rate = left * (off_rate * (cosine - decay * sine) - off * w**2 * sine) + slope
    return found


def rolled(
    seen: Seen, drive_m: Any, period_s: Any, damping: Any, turn_rad_m: Any = 0.0
) -> tuple[Array, Array, Array, Array]:
    """What is seen of a model that rolls, from upright at first: its marks stand aside, and turn the heading if of unlike height.

    Parameters
    ----------
    seen : of the run
    drive_m : (samples, runs, columns) where the marks would stand if the model had time to follow
    period_s, damping : of the roll, as of ``swung``
    turn_rad_m : of the heading, for each metre that the marks stand aside

    Returns
    -------
    change of measured x, y, beta and marker distance
    """
    nothing = 0.0 * seen.side
    away = swung(drive_m + nothing, seen.step_s, period_s, damping)
    return nothing, away, turn_rad_m * away, nothing


__all__ = ["rolled", "swung"]
