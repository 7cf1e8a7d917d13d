"""Rates of a towed model with effects, for arrays of runs, columns and (if wished) times at once.

The equations are ``simulate.model``'s; effects add to them. Columns are hypotheses, or variations of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...simulate.model import (
    Answering,
    Array,
    Hull,
    Taut,
    Tow,
    accelerated,
    full_state,
    full_y_cg,
    line_angle_rate,
    line_force,
    line_speeds,
    paid_state,
    side_by_side,
)
from ..effects import SMALLEST_COSINE, Effect, Late, Situation, on_line
from .columns import PAID_STATES, STATES, Active, Numbers, columns_of, held_before
from .fields import Fields
from .numbers import COMPLIANCE

LARGEST_ANGLE = 1.4
"""Line angle and alpha + beta are held within this, rad (80 degrees): beyond, the equations have no answer."""
SHORTEST = 0.05
"""A line with a law of its own is never shorter than this share of what is stated."""
SOON_S = 0.05
"""An effect on the carriage's speed is differentiated over so long to either side."""


@dataclass(frozen=True)
class _Moment:
    """A tow at one time.

    Attributes
    ----------
    hull, tow : hull at the carriage's speed of this time, tow with its histories
    core : alpha, beta, v, r, within the angles at which a tow is a tow
    paid : line's length beyond the stated one and u, where these are states
    """

    hull: Hull
    tow: Tow
    core: tuple[Array, ...]
    paid: tuple[Array, ...] = ()


class TowRates:
    """Rates of the states, callable with t (a number or (times, 1, 1)) and state (states, ..., runs, columns).

    Parameters
    ----------
    fields, numbers : of the runs and the columns
    tow : of ``tow_of``
    """

    def __init__(self, fields: Fields, numbers: Numbers, tow: Tow) -> None:
        self._fields, self._lates, self._tow = fields, numbers.lates, tow
        self._width, self._reference = numbers.width, _hull_of(fields, numbers)
        self._hull = self._reference.at_speed(tow.speed_m_s)
        self._other: Answering | None = None
        if fields.other is not None:
            self._other = fields.other(self._hull, tow, len(fields.surge), numbers.width)
        self._lawful = [a for a in numbers.active if a.effect.law is not None]
        self._first = PAID_STATES if self._lawful else STATES
        pushing = [a for a in numbers.active if a.effect.force is not None]
        self._pushing = [a for a in pushing if not a.effect.by_pull]
        self._by_pull = [a for a in pushing if a.effect.by_pull]
        self._surging = [a for a in numbers.active if a.effect.ahead is not None]
        self._pulling = [a for a in numbers.active if a.effect.tension is not None]
        # a line that is stated to keep its tension does so already
        self._keeping = [a for a in numbers.active if a.effect.keeps is not None and fields.surge.any()]
        self._speeding = [a for a in numbers.active if a.effect.speed is not None]
        self._paces = [_pace(late, numbers) for late in self._lates]

    def __call__(self, t: Any, state: Array) -> Array:
        now = self._now(t, state)
        taut = self._taut(t, state, now)
        core = taut.rates
        if self._pulling and not self._lawful:
            core = self._pulled(t, state, now, taut)
        if not self._lates:
            return core
        rates = np.empty((len(state), *core.shape[1:]))
        at = self._first
        rates[:at] = core
        for late, pace in zip(self._lates, self._paces, strict=True):
            held = slice(at, at + late.size)
            for k, rate in enumerate(late.rates(state[held], state[2], state[3], *pace), at):
                rates[k] = rate
            at = held.stop
        return rates

    def _zeros(self, state: Array) -> Array:
        """One number for each column, whether or not the state is the same in all."""
        return np.zeros((*state.shape[:-1], self._width))

    def pulls(self, t: Any, state: Array) -> tuple[Array, Array]:
        """T beyond the straight tow's that the line has without effects on it, and all that it pulls with, N."""
        now = self._now(t, state)
        taut = self._taut(t, state, now)
        whole = taut.tension_n
        if self._pulling and not self._lawful:
            whole = whole + self._change(t, state, now, taut)
        return taut.tension_n - now.tow.tension_n, whole

    def taut(self, t: Any, state: Array) -> Taut:
        """The tow without what effects change of T."""
        return self._taut(t, state, self._now(t, state))

    def pushes(self, t: Any, state: Array, effect: Effect, numbers: Array) -> tuple[Array, Array, Array, Array]:
        """Side force, moment, change of T and push ahead of an effect along one column's motion (states, times, runs, 1).

        Parameters
        ----------
        numbers : (p, k): k sets of its numbers

        Returns
        -------
        (times, runs, k) each
        """
        now = self._now(t, state)
        shape = (*state.shape[1:-1], numbers.shape[1])
        side, moment, change, ahead = 0.0, 0.0, 0.0, 0.0
        base = self._lagging(self._situation(t, now), effect, state)
        held = base
        if effect.tension is not None or effect.by_pull:
            held = self._on_line(base, self._taut(t, state, now))
        if effect.force is not None:
            side, moment = effect.force(held if effect.by_pull else base, *numbers)
        if effect.tension is not None:
            change = effect.tension(held, *numbers)
        if effect.ahead is not None:
            ahead = effect.ahead(base, *numbers)
        return tuple(np.broadcast_to(one, shape) for one in (side, moment, change, ahead))  # pyright: ignore

    def _now(self, t: Any, state: Array) -> _Moment:
        hull, tow, fields = self._hull, self._tow, self._fields
        if fields.loaded:
            tow = replace(tow, tension_n=tow.tension_n * fields.history(t))
        if fields.steered:
            tow = replace(tow, rudder_rad=fields.rudder(t))
        alpha, beta = (np.clip(state[k], -LARGEST_ANGLE, LARGEST_ANGLE) for k in (0, 1))
        beta = np.clip(beta, -LARGEST_ANGLE - alpha, LARGEST_ANGLE - alpha)
        core = alpha, beta, state[2], state[3]
        if self._speeding or fields.driven:
            speed, rate = self._speed(t, _Moment(hull, tow, core))
            # on a line that keeps its length the forces take u, and the speed they are quoted at stays the run's own
            if "constant" in fields.lines or self._keeping:
                hull = self._reference.at_speed(speed)
            tow = replace(tow, speed_m_s=speed, speed_rate_m_s2=rate)
        if not self._lawful:
            return _Moment(hull, tow, core)
        paid = state[4], state[5]
        length = np.maximum(tow.line_length_m + paid[0], SHORTEST * tow.line_length_m)
        return _Moment(hull, replace(tow, line_length_m=length), core, paid)

    def _speed(self, t: Any, now: _Moment) -> tuple[Array, Array]:
        """The carriage's speed at this time, and its rate."""
        own, nothing = now.tow.speed_m_s, self._zeros(now.core[0])
        pace, gain = self._fields.pace(t) if self._fields.driven else (1.0, 0.0)
        speed, rate = own * pace + nothing, own * gain + nothing
        if self._speeding:
            base = self._situation(t, now)
            for a in self._speeding:
                assert a.effect.speed is not None
                here = columns_of(base, a.columns)
                early, late = replace(here, t_s=t - SOON_S), replace(here, t_s=t + SOON_S)
                one, two, three = (a.effect.speed(s, *a.numbers) for s in (early, here, late))
                speed[..., a.columns] += two
                rate[..., a.columns] += (three - one) / (2 * SOON_S)
        return speed, rate

    def _taut(self, t: Any, state: Array, now: _Moment) -> Taut:
        """``full_state`` with the effects' forces, by each run's own line; with a law of its own ``paid_state``."""
        taut = self._held(t, state, now)
        return self._held(t, state, now, taut) if self._by_pull else taut

    def _held(self, t: Any, state: Array, now: _Moment, taut: Taut | None = None) -> Taut:
        """With the effects' forces; those that go with the pull by what the line has without them, ``taut``; None: without."""
        by_pull = [] if taut is None else self._by_pull

        def extra(t, y, beta, v, r, alpha):
            side, moment = self._zeros(v), self._zeros(v)
            base = self._situation(t, now, y)
            held = base if taut is None else self._on_line(base, taut)
            for active, asked in ((self._pushing, base), (by_pull, held)):
                for a, part in self._parts(active, asked, state):
                    assert a.effect.force is not None
                    one, two = a.effect.force(part, *a.numbers)
                    side[..., a.columns] += one
                    moment[..., a.columns] += two
            if not self._surging:
                return side, moment
            ahead = self._zeros(v)
            for a, part in self._parts(self._surging, base, state):
                assert a.effect.ahead is not None
                ahead[..., a.columns] += a.effect.ahead(part, *a.numbers)
            return side, moment, ahead

        pushed = extra if self._pushing or by_pull or self._surging else None
        if self._lawful:
            hull = self._other or self._hull
            return paid_state(t, (*now.core, now.paid[1]), self._law(t, state, now), hull, now.tow, pushed)
        lines = ("surge", "constant") if self._keeping else self._fields.lines
        found = {}
        for line in lines:
            hull = self._other or (self._hull if line == "surge" else now.hull)
            tow = now.tow if now.tow.line == line else replace(now.tow, line=line)
            found[line] = full_state(t, now.core, hull, tow, pushed)
        if len(found) == 1:
            return found[lines[0]]
        # how far each run, in each column, keeps its tension
        share = np.where(self._fields.surge, 0.0, 1.0) + self._zeros(now.core[2])
        for a in self._keeping:
            assert a.effect.keeps is not None
            share[..., a.columns] += np.where(self._fields.surge, a.effect.keeps(*a.numbers), 0.0)
        one, two = (found[line] for line in ("surge", "constant"))
        pairs = ((one.rates, two.rates), (one.tension_n, two.tension_n), (one.u_m_s, two.u_m_s))
        rates, tension_n, u_m_s = (length + share * (pull - length) for length, pull in pairs)
        return Taut(rates, tension_n, u_m_s, one.gain)

    def _law(self, t: Any, state: Array, now: _Moment) -> Array:
        """What the lines pull with, by their laws and the effects on it; no line pushes."""
        tension = self._zeros(now.core[2])
        base = self._situation(t, now)
        for a, part in self._parts(self._lawful, base, state):
            assert a.effect.law is not None
            tension[..., a.columns] = a.effect.law(part, *a.numbers)
        if self._pulling:
            held = replace(base, tension_n=tension, beyond_n=tension - now.tow.tension_n)
            for a, part in self._parts(self._pulling, held, state):
                assert a.effect.tension is not None
                tension[..., a.columns] += a.effect.tension(part, *a.numbers)
        return np.maximum(tension, 0.0)

    def _pulled(self, t: Any, state: Array, now: _Moment, taut: Taut) -> Array:
        """The rates where effects change T: beyond what keeps the line's length, which they do not ask."""
        change = self._change(t, state, now, taut)
        angle = now.core[0] + now.core[1]
        force = line_force(now.tow, change, np.sin(angle), np.cos(angle))
        v_pull, r_pull = accelerated(now.hull, *force) if self._other is None else self._other.pulled(0.0, *force)[1:]
        rates = taut.rates.copy()
        rates[2] += v_pull
        rates[3] += r_pull
        return rates

    def _change(self, t: Any, state: Array, now: _Moment, taut: Taut) -> Array:
        """By how much effects change what the line pulls with."""
        change = self._zeros(now.core[2])
        base = self._on_line(self._situation(t, now), taut)
        for a, part in self._parts(self._pulling, base, state):
            assert a.effect.tension is not None
            change[..., a.columns] += a.effect.tension(part, *a.numbers)
        return change

    def _parts(self, active: Sequence[Active], base: Situation, state: Array):
        """Effects with the situation in their columns."""
        parts: dict[tuple[int, int, Late | None], Situation] = {}
        for a in active:
            key = (a.columns.start, a.columns.stop, a.effect.late)
            if key not in parts:
                part = self._lagging(base, a.effect, state)
                whole = a.columns == slice(0, self._width)
                parts[key] = part if whole else columns_of(part, a.columns)
            yield a, parts[key]

    def _situation(self, t: Any, now: _Moment, y: Array | None = None) -> Situation:
        """``tension_n`` as of a straight tow."""
        (alpha, beta, v, r), tow, hull = now.core, now.tow, now.hull
        turn, along = line_rates(t, (*now.core, *now.paid), tow)
        longer = {"longer_m": now.paid[0], "longer_rate_m_s": along} if now.paid else {}
        return Situation(
            t, full_y_cg(t, alpha, beta, tow) if y is None else y, beta, v, r, alpha,
            tow.speed_m_s, tow.line_length_m, tow.tow_point_m, tow.tension_n, turn,
            v_lag=v, r_lag=r, y_v=hull.y_v, n_v=hull.n_v, n_r=hull.n_r, history=self._fields.history,
            **self._fields.fixed, **longer,
        )  # fmt: skip

    def _on_line(self, base: Situation, taut: Taut) -> Situation:
        """The same with the tension that the line has."""
        if not self._fields.surge.any():
            return base
        return on_line(base, taut)

    def _lagging(self, base: Situation, effect: Effect, state: Array) -> Situation:
        if effect.late is None:
            return base
        k = self._first + held_before(self._lates, effect.late)
        return replace(base, v_lag=state[k], r_lag=state[k + 1])


def line_rates(t_s: Any, state: Sequence[Array], tow: Tow) -> tuple[Array, Any]:
    """How fast the line turns and lengthens, rad/s and m/s; a line without a law of its own does not lengthen.

    Parameters
    ----------
    t_s : time
    state : (4, ...) or, with a law of the line's own, (6, ...)
    tow : as long as its line is now
    """
    if len(state) >= PAID_STATES:
        across, along = line_speeds(t_s, (*state[:STATES], state[PAID_STATES - 1]), tow)
        return across / tow.line_length_m, along
    alpha, beta, v, r = state
    cosine = np.clip(np.cos(alpha + beta), SMALLEST_COSINE, None)
    return line_angle_rate(tow, beta, v, r, cosine, tow.post_motion(t_s)[1]), 0.0


def _pace(late: Late, numbers: Numbers) -> Array:
    """By how much faster and more damped velocities follow, (2, columns), where that is fitted; (0,) where it is not."""
    if not late.fitted:
        return np.empty(0)
    pace = np.zeros((2, numbers.width))
    for a in numbers.active:
        if a.effect.late == late:
            own = a.numbers[len(a.numbers) - a.effect.lagging :]
            pace[: len(own), a.columns] = own
    return pace


def _hull_of(fields: Fields, numbers: Numbers) -> Hull:
    """The hull of every column, with the cross added masses that effects give it."""
    coupled = [a for a in numbers.active if a.effect.coupling is not None]
    crossed = np.zeros((2, 1, numbers.width))
    for a in coupled:
        assert a.effect.coupling is not None
        for row, kg_m in zip(crossed, a.effect.coupling(*a.numbers), strict=True):
            row[0, a.columns] += kg_m
    y_rdot, n_vdot = crossed if coupled else (0.0, 0.0)  # absent: equations without them
    shared = {n: row[None] for n, row in zip(fields.names, numbers.shared, strict=True) if n != COMPLIANCE}
    return side_by_side(
        Hull, **shared, speed_m_s=fields.speed_m_s, y_rdot=y_rdot, n_vdot=n_vdot, mass_kg=fields.mass_kg
    )


__all__ = ["TowRates", "line_rates"]
