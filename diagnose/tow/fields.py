"""What effects may ask of the runs, and what is stated of the tows, once for all columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from ...simulate.model import Answering, Array, Hull, Tow, side_by_side
from .columns import OWN, Numbers
from .numbers import SIX, rudder_history, rudder_is_over
from .tow_run import TowRun


class OtherHull(Protocol):
    """The hull of another simulator, in place of towline's own equations of it."""

    def __call__(self, hull: Hull, tow: Tow, runs: int, columns: int) -> Answering:
        """With these derivatives and R of these tows, both at the hull's speed; fields that broadcast to (runs, columns)."""
        ...


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


__all__ = ["Fields", "OtherHull", "tow_of"]
