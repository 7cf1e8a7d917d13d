"""Rates of a towed model with effects, for arrays of runs, columns and (if wished) times at once.

The equations are ``simulate.model``'s; effects add to them. Columns are hypotheses, or variations of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline

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
from ..effects import SMALLEST_COSINE, Effect, Late, Seen, Situation, on_line
from .numbers import COMPLIANCE, SIX, rudder_history, rudder_is_over
from .tow_run import TowRun

OWN = ("alpha", "beta", "v", "r", "y_b", "beta_b", "tension", "tow_point", "line", "speed", "longer", "ahead")
"""Each run's own numbers; tension: T of a line that keeps it, R of one that keeps its length; longer, ahead: by how much a line
with a law of its own is longer at the start, and the model faster than the carriage."""
SPEED, LONGER, AHEAD = (OWN.index(name) for name in ("speed", "longer", "ahead"))
"""Where these stand."""
STATES, PAID_STATES = 4, 6
"""alpha, beta, v, r; with a law of the line's own its length beyond the stated one and u as well. Lagged velocities follow."""
LARGEST_ANGLE = 1.4
"""Line angle and alpha + beta are held within this, rad (80 degrees): beyond, the equations have no answer."""
SHORTEST = 0.05
"""A line with a law of its own is never shorter than this share of what is stated."""
SOON_S = 0.05
"""An effect on the carriage's speed is differentiated over so long to either side."""


class OtherHull(Protocol):
    """The hull of another simulator, in place of towline's own equations of it."""

    def __call__(self, hull: Hull, tow: Tow, runs: int, columns: int) -> Answering:
        """With these derivatives and R of these tows, both at the hull's speed; fields that broadcast to (runs, columns)."""
        ...


@dataclass(frozen=True)
class Active:
    """An effect in the columns where it is not absent.

    Attributes
    ----------
    effect : which
    columns : of all
    numbers : (p, columns)
    """

    effect: Effect
    columns: slice
    numbers: Array


@dataclass(frozen=True)
class Numbers:
    """What the columns hold.

    Attributes
    ----------
    shared : (s, columns), of all runs
    own : (runs, len(OWN), columns)
    active : effects
    lates : how velocities are held back, sorted
    """

    shared: Array
    own: Array
    active: tuple[Active, ...]
    lates: tuple[Late, ...] = ()

    @property
    def width(self) -> int:
        """Columns."""
        return self.shared.shape[1]

    @property
    def lawful(self) -> bool:
        """Whether the line has a law of its own, in every column."""
        return any(a.effect.law is not None for a in self.active)

    def start(self) -> Array:
        """(states, runs, columns) at the runs' beginning; lagged velocities begin as the velocities."""
        first = [self.own[:, k] for k in range(STATES)]
        if self.lawful:
            first += [self.own[:, LONGER], self.own[:, SPEED] + self.own[:, AHEAD]]
        held = [self.own[:, k] if k else np.zeros_like(self.own[:, 0]) for k in held_from(self.lates)]
        return np.stack(first + held)


class Fields:
    """What effects may ask of the runs, and what is stated of them, once for all.

    Parameters
    ----------
    runs : of the campaign
    duration_s : of the runs, (runs, 1)
    speed_m_s : of the quoted derivatives
    names : of the shared numbers
    other : the hull's equations, where they are another simulator's

    Attributes
    ----------
    surge : (runs, 1), whether the line keeps its length
    lines : which lines there are
    loaded, steered, driven : whether any run has a history of T that moves it, of the rudder, of the carriage's speed
    """

    def __init__(
        self,
        runs: Sequence[TowRun],
        duration_s: Array,
        speed_m_s: float,
        names: tuple[str, ...] = SIX,
        other: OtherHull | None = None,
    ) -> None:
        self.speed_m_s, self.names, self.other = speed_m_s, names, other
        tows = [run.data.tow for run in runs]
        self.surge = np.array([[t.line == "surge"] for t in tows])
        self.lines = tuple(dict.fromkeys(t.line for t in tows))
        self.offset_m = np.array([[t.tow_point_offset_m] for t in tows], dtype=float)
        self.post_x_m = np.array([[t.post_m[0]] for t in tows], dtype=float)
        self.mass_kg = np.array([[r.run.model.mass_kg] for r in runs], dtype=float) if self.surge.any() else None
        self.post = _posts(runs)
        self.rudder_rad: Any = 0.0
        if any(rudder_is_over(run) for run in runs):
            self.rudder_rad = np.array([[t.rudder_rad] for t in tows], dtype=float)
        fixed = ("length_pp_m", "density_kg_m3", "half_width_m")
        self.fixed = {n: np.array([[getattr(r, n)] for r in runs], dtype=float) for n in fixed}
        self.fixed["duration_s"] = duration_s
        self._start_s = [r.start_s for r in runs]
        moved = [r.data.tension if r.data.tow.line == "constant" else None for r in runs]
        self._tensions = [
            None if h is None else (h[0], h[1] / float(t.tension_n or 1.0)) for h, t in zip(moved, tows, strict=True)
        ]
        self._rudders = [rudder_history(run) for run in runs]
        self._speeds = [_smooth(run) for run in runs]
        self.loaded, self.steered, self.driven = (
            any(h is not None for h in histories) for histories in (self._tensions, self._rudders, self._speeds)
        )

    def history(self, t_s: Any) -> Array:
        """Tension over its mean, (..., runs, columns), at times that broadcast to that."""
        return self._interpolated(self._tensions, t_s) if self.loaded else np.ones((len(self._start_s), 1))

    def rudder(self, t_s: Any) -> Any:
        """Rudder angle, rad, (..., runs, 1)."""
        if not self.steered:
            return self.rudder_rad
        still = np.array([[h is None] for h in self._rudders])
        return np.where(still, self.rudder_rad, self._interpolated(self._rudders, t_s))

    def pace(self, t_s: Any) -> tuple[Any, Any]:
        """The carriage's speed over its mean and the rate of that, 1/s, (..., runs, 1)."""
        times = self._times(t_s)
        pace, rate = np.ones(times.shape), np.zeros(times.shape)
        for i, spline in enumerate(self._speeds):
            if spline is not None:
                at = np.clip(times[..., i, :], spline.x[0], spline.x[-1])
                pace[..., i, :], rate[..., i, :] = spline(at), spline(at, 1)
        return pace, rate

    def _times(self, t_s: Any) -> Array:
        return np.broadcast_arrays(np.asarray(t_s, dtype=float), np.zeros((len(self._start_s), 1)))[0]

    def _interpolated(self, histories: Sequence[tuple[Array, Array] | None], t_s: Any) -> Array:
        times = self._times(t_s)
        rows = [
            np.interp(times[..., i, :] + start, *history) if history is not None else np.ones_like(times[..., i, :])
            for i, (start, history) in enumerate(zip(self._start_s, histories, strict=True))
        ]
        return np.stack(rows, axis=-2)


def _posts(runs: Sequence[TowRun]) -> dict[str, Any]:
    """How the posts swing: fields of Tow, (runs, 1), on the runs' own clocks."""
    tows = [run.data.tow for run in runs]
    if not any(t.post_amplitude_m for t in tows):
        return {}
    early = [2 * np.pi * t.post_frequency_hz * run.start_s for t, run in zip(tows, runs, strict=True)]
    return {
        "post_amplitude_m": np.array([[t.post_amplitude_m] for t in tows]),
        "post_frequency_hz": np.array([[t.post_frequency_hz] for t in tows]),
        "post_phase_rad": np.array([[t.post_phase_rad + e] for t, e in zip(tows, early, strict=True)]),
    }


def _smooth(run: TowRun) -> CubicSpline | None:
    """A carriage's speed over its mean, by a run's own clock: through the means over blocks, so that its rate is no noise's."""
    if run.data.speed is None:
        return None
    t_s, values = run.data.speed[0] - run.start_s, run.data.speed[1]
    block = np.floor((t_s - t_s[0]) / run.step_s).astype(int)
    count = np.bincount(block)
    there = count > 0
    centre, mean = (np.bincount(block, x)[there] / count[there] for x in (t_s, values))
    if len(centre) < 2:
        return None
    return CubicSpline(centre, mean / run.data.tow.speed_m_s)


def tow_of(fields: Fields, numbers: Numbers) -> Tow:
    """The tow of every run and column; its fields are arrays that broadcast to (runs, columns).

    Parameters
    ----------
    fields : of the runs
    numbers : of the hypothesis, by name
    """
    column = {name: numbers.own[:, k] for k, name in enumerate(OWN)}
    line, offset = column["line"].copy(), np.tile(fields.offset_m, (1, numbers.width))
    for a in numbers.active:
        if a.effect.length is not None:
            line[:, a.columns] += a.effect.length(
                column["tension"][:, a.columns], column["line"][:, a.columns], *a.numbers
            )
        if a.effect.offset is not None:
            offset[:, a.columns] += a.effect.offset(*a.numbers)
    return side_by_side(
        Tow,
        speed_m_s=column["speed"],
        line_length_m=line,
        tow_point_m=column["tow_point"],
        tension_n=column["tension"],
        tow_point_offset_m=offset,
        post_m=(fields.post_x_m, 0.0),
        rudder_rad=fields.rudder_rad,
        line=fields.lines[0],
        **fields.post,
    )


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
        for late in self._lates:
            held = slice(at, at + late.size)
            for k, rate in enumerate(late.rates(state[held], state[2], state[3]), at):
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
            early, late = replace(base, t_s=t - SOON_S), replace(base, t_s=t + SOON_S)
            for a in self._speeding:
                assert a.effect.speed is not None
                one, two, three = (a.effect.speed(columns_of(s, a.columns), *a.numbers) for s in (early, base, late))
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


def held_from(lates: Sequence[Late]) -> list[int]:
    """Of each state that is held back the number of OWN that it begins as; 0: it begins at nothing."""
    return [k for late in lates for k in (2, 3, 0, 0)[: late.size]]


def held_before(lates: Sequence[Late], late: Late) -> int:
    """How many states that are held back stand before those of one."""
    return sum(one.size for one in lates[: lates.index(late)])


def own_numbers(**named: float) -> Array:
    """One run's own numbers (len(OWN),), those not named 0."""
    row = np.zeros(len(OWN))
    for name, value in named.items():
        row[OWN.index(name)] = value
    return row


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


Asked = TypeVar("Asked", Situation, Seen)
"""What an effect is given."""


def columns_of(whole: Asked, columns: slice) -> Asked:
    """What an effect is given, in its own columns: every array of it that has columns, and tuples of such arrays.

    Parameters
    ----------
    whole : what the effect is asked with
    columns : its own
    """
    changes = {}
    for name in whole.columns:
        value = getattr(whole, name)
        if isinstance(value, tuple):
            changes[name] = tuple(_in_columns(part, columns) for part in value)
        else:
            changes[name] = _in_columns(value, columns)
    return replace(whole, **changes)


def _in_columns(value: Any, columns: slice) -> Any:
    """Restricted to some columns, where it has more than one: the others are the same in all."""
    several = isinstance(value, np.ndarray) and value.ndim > 1 and value.shape[-1] > 1
    return value[..., columns] if several else value


__all__ = [
    "AHEAD",
    "LONGER",
    "OWN",
    "PAID_STATES",
    "SPEED",
    "STATES",
    "Active",
    "Fields",
    "Numbers",
    "OtherHull",
    "TowRates",
    "columns_of",
    "held_before",
    "held_from",
    "line_rates",
    "own_numbers",
    "tow_of",
]
