"""Partial derivatives of ``simulate.model.full_rates`` by hand, in the arrangement that the integrator wants.

The rates themselves come from ``full_rates``; a test compares these derivatives with its complex step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array, Hull, Tow
from .parameters import LINE_LENGTH, SPEED, TENSION, TOW_POINT


@dataclass(frozen=True)
class Linearised:
    """The rates (alpha', beta', v', r') at one or many places, and how they change.

    Attributes
    ----------
    rates : (4, ...)
    alpha_row : (4, ...), of alpha' with alpha, beta, v, r
    turn : (2, ...), of v', r' with alpha; the same with beta
    damping : (2, 2, ...), of v', r' with v, r
    parameters : {index in RUN_PARAMETERS: ((row of the rates, (...)), ...)}
    """

    rates: Array
    alpha_row: Array
    turn: Array
    damping: Array
    parameters: dict[int, tuple[tuple[int, Array], ...]]

    def along(self, moved: Array, first_parameter: int, wanted: tuple[int, ...]) -> Array:
        """Change of the rates, (4, c, ...), with changes ``moved`` (4, c, ...) of the state.

        Column ``first_parameter`` + i belongs to parameter ``wanted[i]`` and gets its own part on top.
        """
        found = np.empty_like(moved)
        a, b, v, r = moved
        row = self.alpha_row
        found[0] = row[0] * a + row[1] * b + row[2] * v + row[3] * r
        found[1] = r
        both = a + b
        for i in range(2):
            found[2 + i] = self.turn[i] * both + self.damping[i, 0] * v + self.damping[i, 1] * r
        for at, index in enumerate(wanted, start=first_parameter):
            for line, part in self.parameters.get(index, ()):
                found[line, at] += part
        return found


def linearise(
    rates: Callable[..., Array], t_s, state: Array, hull: Hull, tow: Tow, wanted: tuple[int, ...], reference: float
) -> Linearised:
    """Rates and their partial derivatives at ``state`` (4, ...).

    Parameters
    ----------
    rates : ``full_rates``
    hull : at the tow's speed; cross added masses, rudder and bias are not known here
    tow : fields broadcast against the state; tension_n as it acts now
    wanted : parameters (indices of ``RUN_PARAMETERS``) whose partials are asked for
    reference : speed at which the derivatives are quoted; d/dU counts the damping's growth with U
    """
    alpha, beta, v, r = state
    value = rates(t_s, state, hull, tow)
    _, post_rate = tow.post_motion(t_s)
    sine, cosine = np.sin(alpha + beta), np.cos(alpha + beta)
    sin_b, cos_b = np.sin(beta), np.cos(beta)
    length, point, tension = tow.line_length_m, tow.tow_point_m, tow.tension_n
    assert tension is not None
    mass, inertia = hull.m_minus_y_vdot, hull.i_minus_n_rdot
    across = 1.0 / (length * cosine)
    shape = v.shape
    swing = value[0] * sine / cosine
    alpha_row = np.empty((4, *shape))
    alpha_row[0] = swing
    alpha_row[1] = swing + (tow.speed_m_s * cos_b + post_rate * sin_b) * across
    alpha_row[2], alpha_row[3] = across, point * across
    turn = np.empty((2, *shape))
    turn[0] = -tension * cosine / mass
    turn[1] = -tension * (point * cosine - tow.tow_point_offset_m * sine) / inertia
    damping = np.empty((2, 2, *shape))
    damping[0, 0], damping[0, 1] = hull.y_v / mass, hull.y_r_minus_mu / mass
    damping[1, 0], damping[1, 1] = hull.n_v / inertia, hull.n_r / inertia
    ratio = hull.speed_m_s / reference
    found: dict[int, tuple[tuple[int, Array], ...]] = {}
    for index in wanted:
        if index == 0:
            found[index] = ((2, -value[2] / mass),)
        elif index == 1:
            found[index] = ((3, -value[3] / inertia),)
        elif index < 6:
            line, by = ((2, v / mass), (2, r / mass), (3, v / inertia), (3, r / inertia))[index - 2]
            found[index] = ((line, by * ratio),)
        elif index == TENSION:
            arm = point * sine + tow.tow_point_offset_m * cosine
            found[index] = ((2, -sine / mass), (3, -arm / inertia))
        elif index == TOW_POINT:
            found[index] = ((0, r * across), (3, -tension * sine / inertia))
        elif index == LINE_LENGTH:
            found[index] = ((0, -value[0] / length),)
        elif index == SPEED:
            sway = (hull.y_v * v + hull.y_r_minus_mu * r) / hull.speed_m_s / mass
            yaw = (hull.n_v * v + hull.n_r * r) / hull.speed_m_s / inertia
            found[index] = ((0, sin_b * across), (2, sway), (3, yaw))
    return Linearised(value, alpha_row, turn, damping, found)
