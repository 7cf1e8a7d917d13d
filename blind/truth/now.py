"""What a force on the hull may depend on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .lanes import Array


def _none() -> Array:
    return np.zeros(1)


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
    lag : memory states ``(4, n)``: v fast, v slow, r fast, r slow; or v, its rate, r, its rate, as a ringing memory has them
    slosh : displacement of the tank's sideways wave
    post_turn : rate of the line against the carriage, rad/s
    across_1_m : side force on the hull by a moment of 1 N m that turns the line about the post
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
    post_turn: Array = field(default_factory=_none)
    across_1_m: Array = field(default_factory=_none)

    def part(self, here: Array) -> Now:
        """These lanes alone.

        Parameters
        ----------
        here : their places ``(m,)``
        """
        return Now(
            self.t_s,
            self.y_m[here],
            self.beta[here],
            self.v[here],
            self.r[here],
            self.speed[here],
            self.side_n[here],
            self.turning[here],
            self.lag[:, here],
            self.slosh[here],
            self.post_turn[here],
            self.across_1_m[here],
        )
