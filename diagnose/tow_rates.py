"""Rates of a towed model with effects, for arrays of runs, columns and (if wished) times at once.

The equations are ``simulate.model``'s; effects add to them. Columns are hypotheses, or variations of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..simulate.model import Array, Hull, Tow, full_rates, full_y_cg, line_angle_rate
from .effects import Effect, Situation
from .tow_data import TowRun

OWN = ("alpha", "beta", "v", "r", "y_b", "beta_b", "tension", "tow_point", "line", "speed")
"""Each run's own numbers."""
LARGEST_ANGLE = 1.4
SMALLEST_COSINE = 0.05


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
    six : (6, columns)
    own : (runs, 10, columns)
    active : effects
    lags_s : time constants of lagged velocities, sorted
    """

    six: Array
    own: Array
    active: tuple[Active, ...]
    lags_s: tuple[float, ...] = ()

    def start(self) -> Array:
        """(states, runs, columns) at the runs' beginning; lagged velocities begin as the velocities."""
        four = [self.own[:, k] for k in range(4)]
        return np.stack(four + [self.own[:, k] for _ in self.lags_s for k in (2, 3)])


class Fields:
    """What effects may ask of the runs, once for all.

    Parameters
    ----------
    runs : of the campaign
    duration_s : of the runs, (runs, 1)
    speed_m_s : of the quoted derivatives
    """

    def __init__(self, runs: Sequence[TowRun], duration_s: Array, speed_m_s: float) -> None:
        self.speed_m_s = speed_m_s
        tows = [run.data.tow for run in runs]
        self.offset_m = np.array([[t.tow_point_offset_m] for t in tows], dtype=float)
        self.post_x_m = np.array([[t.post_m[0]] for t in tows], dtype=float)
        names = ("length_pp_m", "density_kg_m3", "half_width_m")
        self.fixed = {n: np.array([[getattr(r, n)] for r in runs], dtype=float) for n in names}
        self.fixed["duration_s"] = duration_s
        self._histories = [(r.start_s, r.data.tension, float(r.data.tow.tension_n or 1.0)) for r in runs]
        self.loaded = any(h is not None for _, h, _ in self._histories)

    def history(self, t_s: Any) -> Array:
        """Tension over its mean, (..., runs, columns), at times that broadcast to that."""
        if not self.loaded:
            return np.ones((len(self._histories), 1))
        times = np.broadcast_arrays(np.asarray(t_s, dtype=float), np.zeros((len(self._histories), 1)))[0]
        rows = [
            np.interp(times[..., i, :] + start, *history) / mean
            if history is not None
            else np.ones_like(times[..., i, :])
            for i, (start, history, mean) in enumerate(self._histories)
        ]
        return np.stack(rows, axis=-2)


def tow_of(fields: Fields, numbers: Numbers) -> Any:
    """The tow of every run and column; its fields are arrays that broadcast to (runs, columns)."""
    column = {name: numbers.own[:, k] for k, name in enumerate(OWN)}
    line, offset = column["line"].copy(), np.tile(fields.offset_m, (1, numbers.six.shape[1]))
    for a in numbers.active:
        if a.effect.length is not None:
            line[:, a.columns] += a.effect.length(column["tension"][:, a.columns], *a.numbers)
        if a.effect.offset is not None:
            offset[:, a.columns] += a.effect.offset(*a.numbers)
    made: Any = Tow
    return made(
        column["speed"],
        line,
        column["tow_point"],
        column["tension"],
        tow_point_offset_m=offset,
        post_m=(fields.post_x_m, 0.0),
    )


class TowRates:
    """Rates of the states, callable with t (a number or (times, 1, 1)) and state (states, ..., runs, columns).

    Parameters
    ----------
    fields, numbers : of the runs and the columns
    tow : of ``tow_of``
    """

    def __init__(self, fields: Fields, numbers: Numbers, tow: Any) -> None:
        self._fields, self._lags, self._tow = fields, list(numbers.lags_s), tow
        self._reference = _hull_of(fields, numbers)
        self._hull = self._reference.at_speed(tow.speed_m_s)
        self._pushing = [a for a in numbers.active if a.effect.force is not None or a.effect.tension is not None]
        self._speeding = [a for a in numbers.active if a.effect.speed is not None]

    def __call__(self, t: Any, state: Array) -> Array:
        here, now, (alpha, beta, v, r) = self._now(t, state)

        def extra(t, y, beta, v, r, alpha):
            side, moment = np.zeros_like(v), np.zeros_like(v)
            base = self._situation(t, y, beta, v, r, alpha, here, now)
            parts: dict[tuple[int, int, float], Situation] = {}
            for a in self._pushing:
                key = (a.columns.start, a.columns.stop, a.effect.lag_s)
                if key not in parts:
                    parts[key] = columns_of(self._lagging(base, a.effect, state), a.columns)
                one, two = push(a.effect, parts[key], now.tow_point_offset_m[:, a.columns], a.numbers)
                side[..., a.columns] += one
                moment[..., a.columns] += two
            return side, moment

        core = full_rates(t, (alpha, beta, v, r), here, now, extra if self._pushing else None)
        if not self._lags:
            return core
        more = [
            (state[source] - state[4 + 2 * i + j]) / lag
            for i, lag in enumerate(self._lags)
            for j, source in ((0, 2), (1, 3))
        ]
        return np.concatenate([core, np.stack(more)])

    def pushes(self, t: Any, state: Array, effect: Effect, numbers: Array) -> tuple[Array, Array]:
        """Side force and moment of an effect along one column's motion (states, times, runs, 1).

        Parameters
        ----------
        numbers : (p, k): k sets of its numbers

        Returns
        -------
        (times, runs, k) each
        """
        here, now, (alpha, beta, v, r) = self._now(t, state)
        base = self._situation(t, full_y_cg(t, alpha, beta, now), beta, v, r, alpha, here, now)
        one, two = push(effect, self._lagging(base, effect, state), now.tow_point_offset_m, numbers)
        shape = (*v.shape[:-1], numbers.shape[1])
        return np.broadcast_to(one, shape), np.broadcast_to(two, shape)

    def _now(self, t: Any, state: Array) -> tuple[Any, Any, tuple[Array, ...]]:
        """Hull, tow and the four states, within the angles at which a tow is a tow."""
        here, now = self._hull, self._tow
        if self._fields.loaded:
            now = replace(now, tension_n=self._tow.tension_n * self._fields.history(t))
        alpha, beta = (np.clip(state[k], -LARGEST_ANGLE, LARGEST_ANGLE) for k in (0, 1))
        beta = np.clip(beta, -LARGEST_ANGLE - alpha, LARGEST_ANGLE - alpha)
        v, r = state[2], state[3]
        if self._speeding:
            base = self._situation(t, 0.0 * v, beta, v, r, alpha, here, now)
            speed = now.speed_m_s + 0.0 * v
            for a in self._speeding:
                assert a.effect.speed is not None
                speed[..., a.columns] += a.effect.speed(columns_of(base, a.columns), *a.numbers)
            here, now = self._reference.at_speed(speed), replace(now, speed_m_s=speed)
        return here, now, (alpha, beta, v, r)

    def _situation(self, t, y, beta, v, r, alpha, here: Any, now: Any) -> Situation:
        cosine = np.clip(np.cos(alpha + beta), SMALLEST_COSINE, None)
        return Situation(
            t, y, beta, v, r, alpha, now.speed_m_s, now.line_length_m, now.tow_point_m, now.tension_n,
            line_angle_rate(now, beta, v, r, cosine),
            v_lag=v, r_lag=r, y_v=here.y_v, n_v=here.n_v, n_r=here.n_r, history=self._fields.history,
            **self._fields.fixed,
        )  # fmt: skip

    def _lagging(self, base: Situation, effect: Effect, state: Array) -> Situation:
        if not effect.lag_s:
            return base
        k = 4 + 2 * self._lags.index(effect.lag_s)
        return replace(base, v_lag=state[k], r_lag=state[k + 1])


def push(effect: Effect, at: Situation, offset_m: Any, numbers: Array) -> tuple[Any, Any]:
    """Side force and moment of an effect, by its force and by what it does to the line's pull."""
    side, moment = effect.force(at, *numbers) if effect.force is not None else (0.0, 0.0)
    if effect.tension is not None:
        change = effect.tension(at, *numbers)
        angle = at.alpha_rad + at.beta_rad
        sine, cosine = np.sin(angle), np.cos(angle)
        side = side - change * sine
        moment = moment - change * (at.tow_point_m * sine + offset_m * cosine)
    return side, moment


def _hull_of(fields: Fields, numbers: Numbers) -> Any:
    coupled = [a for a in numbers.active if a.effect.coupling is not None]
    y_rdot: Any = np.zeros((1, numbers.six.shape[1])) if coupled else 0.0
    n_vdot: Any = np.zeros((1, numbers.six.shape[1])) if coupled else 0.0
    for a in coupled:
        assert a.effect.coupling is not None
        one, two = a.effect.coupling(*a.numbers)
        y_rdot[0, a.columns] += one
        n_vdot[0, a.columns] += two
    made: Any = Hull
    return made(*(s[None] for s in numbers.six), speed_m_s=fields.speed_m_s, y_rdot=y_rdot, n_vdot=n_vdot)


def columns_of(whole: Any, columns: slice) -> Any:
    """A dataclass of arrays that broadcast to (..., columns), restricted to some."""
    changes = {}
    for name, value in whole.__dict__.items():
        if isinstance(value, np.ndarray):
            if value.ndim > 1 and value.shape[-1] > 1 and name != "shutter":
                changes[name] = value[..., columns]
        elif isinstance(value, tuple) and all(isinstance(v, np.ndarray) and v.shape[-1] > 1 for v in value):
            changes[name] = tuple(v[..., columns] for v in value)
    part = object.__new__(type(whole))
    part.__dict__.update(whole.__dict__)
    part.__dict__.update(changes)
    return part


__all__ = ["OWN", "Active", "Fields", "Numbers", "TowRates", "columns_of", "tow_of"]
