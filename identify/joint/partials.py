"""Partial derivatives of ``simulate.model.full_state`` by hand, in the arrangement that the integrator wants.

Rates, tension and forward speed themselves come from ``full_state``; a test compares these derivatives with its complex step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...simulate.model import Array, Hull, Taut, Tow, full_state
from .parameters import (
    EXPONENT,
    LINE_LENGTH,
    SPEED,
    TENSION,
    TOW_POINT,
    X_RR,
    X_UDOT,
    X_VR,
    X_VV,
    Y_BIAS,
    Y_DELTA,
)

TURN, SWAY, YAW, PULL = range(4)
"""Rows of the slopes: alpha', v', r' and T."""
TURNING = (TOW_POINT, LINE_LENGTH, SPEED)
"""Parameters that move alpha' at a state that stands; the others move it with the state only."""
MOVED = 1e-5
"""A missing force is differentiated over so much of rad, m/s and rad/s, and of a parameter, to either side."""
Force = Callable[[Any, Array, Tow], tuple[Any, Any, Any]]
"""A force that is known beforehand: (t_s, state, tow) -> Y, N, X."""
Column = dict[int, Any]
"""How the rows change with one thing; rows that do not change are left out."""


@dataclass(frozen=True)
class Linearised:
    """The rates (alpha', beta', v', r') and T at one or many places, and how they change.

    Attributes
    ----------
    rates : (4, ...)
    tension_n : (...), T
    by_state : for alpha, beta, v, r: ``Column``
    parameters : {index in RUN_PARAMETERS: ``Column``}
    """

    rates: Array
    tension_n: Any
    by_state: tuple[Column, Column, Column, Column]
    parameters: dict[int, Column]

    def along(self, moved: Array, first_parameter: int, wanted: tuple[int, ...]) -> Array:
        """Change of the rates, (4, c, ...), with changes ``moved`` (4, c, ...) of the state.

        Column ``first_parameter`` + i belongs to parameter ``wanted[i]`` and gets its own part on top.
        """
        found = np.empty_like(moved)
        found[1] = moved[3]
        for row, at in ((TURN, 0), (SWAY, 2), (YAW, 3)):
            self._row(row, moved, first_parameter, wanted, found[at])
        return found

    def alone(self, wanted: tuple[int, ...]) -> Array:
        """``along`` where each of the first four columns moves one state by one, and the parameters have moved none yet."""
        found = np.zeros((4, 4 + len(wanted), *np.shape(self.rates)[1:]))
        found[1, 3] = 1.0
        for row, at in ((TURN, 0), (SWAY, 2), (YAW, 3)):
            for place, column in enumerate((*self.by_state, *(self.parameters.get(i, {}) for i in wanted))):
                if row in column:
                    found[at, place] = column[row]
        return found

    def turn_along(self, moved: Array, wanted: tuple[int, ...]) -> Array:
        """Change of alpha', (c, ...), with the parameters ``wanted`` that move the state by ``moved`` (4, c, ...)."""
        return self._row(TURN, moved, 0, wanted, np.empty_like(moved[0]))

    def tension_along(self, moved: Array, wanted: tuple[int, ...]) -> Array:
        """Change of T, (c, ...), with the parameters ``wanted`` that move the state by ``moved`` (4, c, ...)."""
        return self._row(PULL, moved, 0, wanted, np.empty_like(moved[0]))

    def _row(self, row: int, moved: Array, first_parameter: int, wanted: tuple[int, ...], total: Array) -> Array:
        part = None
        for i, column in enumerate(self.by_state):
            if row not in column:
                continue
            if part is None:
                np.multiply(column[row], moved[i], out=total)
                part = np.empty_like(total)
            else:
                np.multiply(column[row], moved[i], out=part)
                total += part
        if part is None:
            total[:] = 0.0
        for at, index in enumerate(wanted, start=first_parameter):
            column = self.parameters.get(index, {})
            if row in column:
                total[at] += column[row]
        return total


def linearise(
    t_s,
    state: Array,
    hull: Hull,
    tow: Tow,
    wanted: tuple[int, ...],
    reference: float,
    pulled: bool = True,
    missing: Force | None = None,
) -> Linearised:
    """``full_state`` and its partial derivatives at ``state`` (4, ...).

    Parameters
    ----------
    t_s : time, s
    state : (4, ...), alpha, beta, v, r
    hull : at the tow's speed ("constant" line) or at its nominal speed ("surge"); cross added masses are not known here
    tow : fields broadcast against the state; tension_n as it acts now
    wanted : parameters (indices of ``RUN_PARAMETERS``) whose partials are asked for
    reference : speed at which the derivatives are quoted; d/dU counts the damping's growth with U
    pulled : T's own derivatives are asked for as well (of a line that keeps its length)
    missing : a force beside the hull's; its slopes are differences
    """
    more = (0.0, 0.0, 0.0) if missing is None else missing(t_s, state, tow)
    taut = full_state(t_s, state, hull, tow, None if missing is None else lambda *_: more)
    if tow.line == "surge":
        line = _Kept(t_s, state, hull, tow, taut, more, pulled)
    else:
        line = _Pulled(t_s, state, hull, tow, taut, more)
    found = line.linearised(wanted, reference)
    return found if missing is None else line.beside(found, missing, t_s, wanted)


class _Pulled:
    """A line of given tension: u = U(t)."""

    def __init__(self, t_s, state: Array, hull: Hull, tow: Tow, taut: Taut, more: tuple[Any, Any, Any]) -> None:
        alpha, beta, v, r = state
        self.state, self.hull, self.tow, self.taut = state, hull, tow, taut
        self.post_rate = tow.post_motion(t_s)[1]
        self.sine, self.cosine = np.sin(alpha + beta), np.cos(alpha + beta)
        self.sin_b, self.cos_b = np.sin(beta), np.cos(beta)
        self.arm = tow.tow_point_m * self.sine + tow.tow_point_offset_m * self.cosine
        self.arm_slope = tow.tow_point_m * self.cosine - tow.tow_point_offset_m * self.sine
        self.turn, self.tension = taut.rates[0], taut.tension_n
        self.by_v, self.per_cosine = self.sine / self.cosine, 1.0 / self.cosine
        self.reach = tow.line_length_m * self.turn  # L alpha'
        self.linear = (hull.y_v * v + hull.y_r_minus_mu * r, hull.n_v * v + hull.n_r * r)
        delta = tow.rudder_rad
        self.steady = (hull.y_delta * delta + hull.y_bias_n, hull.n_delta * delta + hull.n_bias_n_m)
        self.ratio: Any = 1.0  # of the speed in the forces to the hull's own
        self.more = more  # what is missing: Y, N, X

    def linearised(self, wanted: tuple[int, ...], reference: float) -> Linearised:
        columns = {index: self._column(index, reference) for index in wanted if not 6 <= index < 10}
        states = self._by_alpha(), self._by_beta(), self._by_v(), self._by_r()
        return Linearised(self.taut.rates, self.tension, states, columns)

    def beside(self, found: Linearised, missing: Force, t_s: Any, wanted: tuple[int, ...]) -> Linearised:
        """The same with what a missing force adds as the state moves, and the parameters that it goes with."""

        def slope(ends: list[tuple[Array, Tow]], size: Any) -> Column:
            up, down = (missing(t_s, *end) for end in ends)
            side, moment, ahead = ((a - b) / (2 * size) for a, b in zip(up, down, strict=True))
            return self._forced(side, moment, -ahead)

        def added(column: Column, more: Column) -> Column:
            return {row: column.get(row, 0.0) + more.get(row, 0.0) for row in {*column, *more}}

        states = []
        for i, column in enumerate(found.by_state):
            ends = [self.state.copy(), self.state.copy()]
            for end, sign in zip(ends, (1, -1), strict=True):
                end[i] += sign * MOVED
            states.append(added(column, slope([(end, self.tow) for end in ends], MOVED)))
        parameters = dict(found.parameters)
        named = {TOW_POINT: "tow_point_m", LINE_LENGTH: "line_length_m", SPEED: "speed_m_s"}
        for index in named.keys() & set(wanted):
            here = getattr(self.tow, named[index])
            tows = [replace(self.tow, **{named[index]: here + sign * MOVED}) for sign in (1, -1)]
            more = slope([(self.state, tow) for tow in tows], MOVED)
            if index == SPEED:
                more = {row: by * self._of_nominal() for row, by in more.items()}
            parameters[index] = added(parameters.get(index, {}), more)
        return Linearised(found.rates, found.tension_n, tuple(states), parameters)

    def _of_nominal(self) -> Any:
        """By how much the carriage is faster now where it is so by its nominal speed; a history is counted elsewhere."""
        return 1.0

    def _forced(self, side: Any, moment: Any, push: Any = 0.0, stiffer: Any = 0.0, faster: Any = None) -> Column:
        """Rows of a change that adds a side force and a moment; the rest matters to a line that keeps its length."""
        mass, inertia = self.hull.m_minus_y_vdot, self.hull.i_minus_n_rdot
        return {SWAY: side / mass, YAW: moment / inertia}

    def _by_alpha(self) -> Column:
        slope = self.by_v * self.turn
        pull = self._forced(-self.tension * self.cosine, -self.tension * self.arm_slope)
        return {TURN: slope} | pull

    def _by_beta(self) -> Column:
        gain = self.tow.speed_m_s * self.cos_b + self.post_rate * self.sin_b
        column = self._by_alpha()
        return column | {TURN: column[TURN] + gain * self.per_cosine / self.tow.line_length_m}

    def _by_v(self) -> Column:
        return {TURN: self.per_cosine / self.tow.line_length_m} | self._forced(self.hull.y_v, self.hull.n_v)

    def _by_r(self) -> Column:
        turn = self.tow.tow_point_m * self.per_cosine / self.tow.line_length_m
        return {TURN: turn} | self._forced(self.hull.y_r_minus_mu, self.hull.n_r)

    def _column(self, index: int, reference: float) -> Column:
        """Rows by one parameter."""
        _, _, v, r = self.state
        if index == 0:
            return {SWAY: -self.taut.rates[2] / self.hull.m_minus_y_vdot}
        if index == 1:
            return {YAW: -self.taut.rates[3] / self.hull.i_minus_n_rdot}
        if index < 6:
            gain = (v, r, v, r)[index - 2] * self.ratio * (self.hull.speed_m_s / reference)
            return self._forced(gain, 0.0) if index < 4 else self._forced(0.0, gain)
        if index >= Y_DELTA:
            gain = (self.tow.rudder_rad if index < Y_BIAS else 1.0) * (
                self.ratio * self.hull.speed_m_s / reference
            ) ** 2
            gain = gain + 0.0 * v
            return self._forced(gain, 0.0) if index in (Y_DELTA, Y_BIAS) else self._forced(0.0, gain)
        if index == TENSION:
            return self._forced(-self.sine, -self.arm)
        if index == TOW_POINT:
            arm = {YAW: -self.tension * self.sine / self.hull.i_minus_n_rdot}
            return {TURN: r * self.per_cosine / self.tow.line_length_m} | arm
        if index == LINE_LENGTH:
            return {TURN: -self.turn / self.tow.line_length_m}
        if index == SPEED:
            across = self.sin_b * self.per_cosine / self.tow.line_length_m
            more = [(a + 2 * b) / self.hull.speed_m_s for a, b in zip(self.linear, self.steady, strict=True)]
            return {TURN: across} | self._forced(*more)
        return {}


class _Kept(_Pulled):
    """A line that keeps its length: T follows, and with it every change of the forces and of the forward speed (theory.md 10).

    T = (M K - m v r - X)/D with M = m - X_udot, K = K_0 + K_v v_0 + K_r r_0: each change is one of K_0 or of the push (``push``, in
    newtons of the numerator), of D (``stiffer``), of u (``faster``) or of Y and N at T = 0.
    """

    def __init__(
        self, t_s, state: Array, hull: Hull, tow: Tow, taut: Taut, more: tuple[Any, Any, Any], pulled: bool
    ) -> None:
        super().__init__(t_s, state, hull, tow, taut, more)
        r = state[3]
        assert hull.mass_kg is not None
        self.mass = hull.mass_kg - hull.x_udot_kg
        self.u, self.ratio = taut.u_m_s, taut.u_m_s / hull.speed_m_s
        self.by_r = tow.tow_point_m * self.by_v + tow.tow_point_offset_m
        sway_mass, inertia = hull.m_minus_y_vdot, hull.i_minus_n_rdot
        parts = zip(self.linear, self.steady, more[:2], strict=True)
        self.free = tuple(self.ratio * (a + self.ratio * b) + c for a, b, c in parts)
        self.yields = self.sine**2 / sway_mass + self.arm**2 / inertia
        self.stiffness = self.cosine + self.mass * self.per_cosine * self.yields
        size = np.abs(self.ratio) ** (hull.resistance_exponent - 1)
        self.drag = tow.resistance * hull.resistance_exponent * size / hull.speed_m_s  # -dX/du
        self.drag_shape = self.ratio * size
        gains = [(a + 2 * self.ratio * b) / hull.speed_m_s for a, b in zip(self.linear, self.steady, strict=True)]
        self.faster_side, self.faster_moment = gains
        self.post_gust = tow.post_acceleration(t_s)
        self.speed_rate = tow.speed_rate_m_s2
        self.turns = self.turn + r
        self._units(pulled)
        self.turned_k_0, self.turned = self._turned()

    def _units(self, pulled: bool) -> None:
        """Rows of one newton of push, of side force, one newton metre of moment, one m/s of forward speed."""
        mass, inertia = self.hull.m_minus_y_vdot, self.hull.i_minus_n_rdot
        push = 1.0 / self.stiffness
        side, moment = (self.mass / mass) * self.by_v * push, (self.mass / inertia) * self.by_r * push
        sway, yaw = -self.sine / mass, -self.arm / inertia
        self.of_push = {SWAY: sway * push, YAW: yaw * push}
        self.of_side = {SWAY: sway * side + 1.0 / mass, YAW: yaw * side}
        self.of_moment = {SWAY: sway * moment, YAW: yaw * moment + 1.0 / inertia}
        if pulled:
            self.of_push[PULL], self.of_side[PULL], self.of_moment[PULL] = push, side, moment
        self.of_speed = {
            row: by * self.drag + self.faster_side * self.of_side[row] + self.faster_moment * self.of_moment[row]
            for row, by in self.of_push.items()
        }

    def _forced(self, side: Any, moment: Any, push: Any = 0.0, stiffer: Any = 0.0, faster: Any = None) -> Column:
        if not _nothing(stiffer):
            push = push - self.tension * stiffer
        given = [(side, self.of_side), (moment, self.of_moment), (push, self.of_push), (faster, self.of_speed)]
        given = [(gain, unit) for gain, unit in given if not _nothing(gain)]
        if not given:
            return dict.fromkeys(self.of_push, 0.0)
        (gain, unit), *more = given
        column: Column = {row: gain * by for row, by in unit.items()}
        for gain, unit in more:
            for row, by in unit.items():
                column[row] += gain * by
        return column

    def _turned(self) -> tuple[Any, Column]:
        """What alpha and beta have in common: a turn of alpha + beta by one radian at the L alpha' that is, K_0 and rows."""
        hull = self.hull
        speed, r = self.tow.speed_m_s, self.state[3]
        square = self.per_cosine**2
        lead = speed * r * self.cos_b + self.speed_rate * self.sin_b - self.post_gust * self.cos_b
        lead = lead + self.post_rate * r * self.sin_b
        # K_v, K_r turn too; the line's own direction turns at the tension that acts
        lead = lead + self.reach * self.turns * self.sine
        lead = lead + self.free[0] / hull.m_minus_y_vdot + self.tow.tow_point_m * self.free[1] / hull.i_minus_n_rdot
        slope = 2 * (self.sine * self.cosine / hull.m_minus_y_vdot + self.arm * self.arm_slope / hull.i_minus_n_rdot)
        stiffer = -self.sine + self.mass * (self.sine * square * self.yields + self.per_cosine * slope)
        column = self._forced(0.0, 0.0, 0.0, stiffer)
        column[SWAY] = column[SWAY] - self.tension * self.cosine / hull.m_minus_y_vdot
        column[YAW] = column[YAW] - self.tension * self.arm_slope / hull.i_minus_n_rdot
        return square * lead, column

    def _swung(self, reach: Any, k_0: Any, faster: Any) -> Column:
        """Rows of a turn of alpha + beta by one radian; ``reach``: the change of L alpha' with it."""
        moved = self._forced(0.0, 0.0, self.mass * (self.turned_k_0 + self._moving(reach) + k_0), 0.0,
                             reach * self.sine + self.reach * self.cosine + faster)  # fmt: skip
        return {TURN: reach / self.tow.line_length_m} | {row: by + self.turned[row] for row, by in moved.items()}

    def _by_alpha(self) -> Column:
        return self._swung(self.reach * self.by_v, 0.0, 0.0)

    def _by_beta(self) -> Column:
        speed, r, sin_b, cos_b = self.tow.speed_m_s, self.state[3], self.sin_b, self.cos_b
        reach = self.reach * self.by_v + (speed * cos_b + self.post_rate * sin_b) * self.per_cosine
        more = self.by_v * (self.speed_rate * cos_b - speed * r * sin_b) - self.speed_rate * sin_b - speed * r * cos_b
        more = more + self.post_gust * (cos_b + self.by_v * sin_b) + self.post_rate * r * (self.by_v * cos_b - sin_b)
        return self._swung(reach, more, self.post_rate * cos_b - speed * sin_b)

    def _moving(self, reach: Any) -> Any:
        """Change of K_0 as L alpha' changes by ``reach``."""
        return (reach * self.turns + self.reach * reach / self.tow.line_length_m) * self.per_cosine

    def _by_v(self) -> Column:
        hull, (_, _, v, r) = self.hull, self.state
        reach = self.per_cosine
        push = self.mass * self._moving(reach) - hull.mass_kg * r - (2 * hull.x_vv_kg_m * v + hull.x_vr_kg * r)
        column = self._forced(self.ratio * hull.y_v, self.ratio * hull.n_v, push, 0.0, self.by_v)
        return {TURN: reach / self.tow.line_length_m} | column

    def _by_r(self) -> Column:
        hull, (_, _, v, r), speed = self.hull, self.state, self.tow.speed_m_s
        reach = self.tow.tow_point_m * self.per_cosine
        k_0 = self._moving(reach) + self.reach * self.per_cosine + speed * (self.by_v * self.cos_b - self.sin_b)
        k_0 = k_0 + self.post_rate * (self.cos_b + self.by_v * self.sin_b)
        push = self.mass * k_0 - hull.mass_kg * v - (hull.x_vr_kg * v + 2 * hull.x_rr_kg_m * r)
        column = self._forced(self.ratio * hull.y_r_minus_mu, self.ratio * hull.n_r, push, 0.0, self.by_r)
        return {TURN: reach / self.tow.line_length_m} | column

    def _column(self, index: int, reference: float) -> Column:
        hull, tow, (_, _, v, r) = self.hull, self.tow, self.state
        if index == 0:
            mass = hull.m_minus_y_vdot
            less = self._forced(-self.free[0] / mass, 0.0, 0.0, -self.mass * self.per_cosine * (self.sine / mass) ** 2)
            return less | {SWAY: less[SWAY] + self.tension * self.sine / mass**2}
        if index == 1:
            inertia = hull.i_minus_n_rdot
            less = self._forced(
                0.0, -self.free[1] / inertia, 0.0, -self.mass * self.per_cosine * (self.arm / inertia) ** 2
            )
            return less | {YAW: less[YAW] + self.tension * self.arm / inertia**2}
        if index == TENSION:
            return self._forced(0.0, 0.0, self.drag_shape)
        if index == X_UDOT:
            needed = (self.tension * self.stiffness + hull.mass_kg * v * r + self._push()) / self.mass
            return self._forced(0.0, 0.0, -needed, -self.per_cosine * self.yields)
        if index in (X_VR, X_VV, X_RR):
            first, second = {X_VR: (v, r), X_VV: (v, v), X_RR: (r, r)}[index]
            return self._forced(0.0, 0.0, -first * second)
        if index == EXPONENT:
            return self._forced(0.0, 0.0, tow.resistance * self.drag_shape * np.log(np.abs(self.ratio)))
        if index == TOW_POINT:
            reach = r * self.per_cosine
            k_0 = self._moving(reach) + self.by_v * self.free[1] / hull.i_minus_n_rdot
            stiffer = 2 * self.mass * self.per_cosine * self.arm * self.sine / hull.i_minus_n_rdot
            column = self._forced(0.0, 0.0, self.mass * k_0, stiffer, reach * self.sine)
            arm = column[YAW] - self.tension * self.sine / hull.i_minus_n_rdot
            return {TURN: reach / tow.line_length_m} | column | {YAW: arm}
        if index == LINE_LENGTH:
            less = -self.turn / tow.line_length_m
            return {TURN: less} | self._forced(0.0, 0.0, self.mass * self.reach * less * self.per_cosine)
        if index == SPEED:
            return self._by_speed()
        return super()._column(index, reference)

    def _push(self) -> Any:
        """X of ``surge_force``, and what is missing."""
        hull, (_, _, v, r) = self.hull, self.state
        side = v * (hull.x_vv_kg_m * v + hull.x_vr_kg * r) + hull.x_rr_kg_m * r * r
        return side - self.tow.resistance * self.drag_shape + self.more[2]

    def _of_nominal(self) -> Any:
        return self.tow.speed_m_s / self.hull.speed_m_s

    def _by_speed(self) -> Column:
        """U moves the carriage's whole history; R and the hull stay what they are at that U: u/U_0 falls as u stands still."""
        hull, tow, r = self.hull, self.tow, self.state[3]
        share, late = tow.speed_m_s / hull.speed_m_s, self.speed_rate / hull.speed_m_s
        reach = share * self.sin_b * self.per_cosine
        k_0 = self._moving(reach) + share * r * (self.by_v * self.cos_b - self.sin_b)
        k_0 = k_0 + late * (self.cos_b + self.by_v * self.sin_b)
        faster = share * self.cos_b + reach * self.sine
        push = self.mass * k_0 - self.drag * self.u / hull.speed_m_s
        column = self._forced(0.0, 0.0, push, 0.0, faster)
        return {TURN: reach / tow.line_length_m} | column


def _nothing(gain: Any) -> bool:
    """A part of a change that is not there: None or the number 0."""
    return gain is None or (isinstance(gain, float) and gain == 0.0)


__all__ = ["TURNING", "Linearised", "linearise"]
