"""What one integration of the full equations needs: hull and tows of all runs side by side, step length, histories."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array, Hull, Tow
from ..data import RunData
from .linear import system_matrices
from .parameters import LINE_LENGTH, SPEED, TENSION, TOW_POINT, hull_from
from .partials import Force, Linearised, linearise

FULL_STEP_S = 0.05
"""Largest Runge-Kutta step; smaller ones are halves of it."""
FULL_STEP_SHARE = 0.12
"""Runge-Kutta step: this share of the fastest root's time."""
ROUGH = 2
"""Steps in one where a path is only to lead near the optimum: its error is 16 times as large, some micrometres."""
SAMPLING_SHARE = 0.25
"""Nor need the step be shorter than this share of the sampling."""


@dataclass(frozen=True)
class Setting:
    """Hull, tows and step of one integration.

    Attributes
    ----------
    hull, tow : fields are arrays over the runs
    tension, speed : histories at every half step, (2 count + 2, runs), relative to their means; None where constant
    speed_rate : slope of ``speed``, 1/s
    rudder : rudder angles at every half step, rad; None where they stand still
    missing : a force beside the hull's, or None
    reference : speed at which the derivatives are quoted
    step, count : length s and number of the steps
    """

    hull: Hull
    tow: Tow
    tension: Array | None
    speed: Array | None
    reference: float
    step: float
    count: int
    speed_rate: Array | None = None
    rudder: Array | None = None
    missing: Force | None = None

    def at(self, part: int, select: slice) -> tuple[Array, Hull, Tow]:
        """Times, hull and tow at the steps ``select``, ``part`` half steps later."""
        index = np.arange(self.count + 1)[select]
        t = (index + part / 2)[:, None] * self.step
        hull, tow = self.hull, self.tow
        half = np.minimum(2 * index + part, 2 * self.count + 1)
        if self.tension is not None:
            tow = replace(tow, tension_n=tow.tension_n * self.tension[half])
        if self.rudder is not None:
            tow = replace(tow, rudder_rad=self.rudder[half])  # pyright: ignore[reportArgumentType]
        if self.speed is not None:
            assert self.speed_rate is not None
            nominal = tow.speed_m_s
            tow = replace(tow, speed_m_s=nominal * self.speed[half], speed_rate_m_s2=nominal * self.speed_rate[half])
            if tow.line == "constant":
                hull = hull.at_speed(tow.speed_m_s)
        return t, hull, tow

    def linearised(
        self, part: int, state: Array, wanted: tuple[int, ...], select: slice, pulled: bool = False
    ) -> Linearised:
        """Rates with their partial derivatives at ``state`` (4, steps, runs), and T, with its own where ``pulled``."""
        t, hull, tow = self.at(part, select)
        found = linearise(t, state, hull, tow, wanted, self.reference, pulled, self.missing)
        if self.tow.line == "constant" and not (self.tension is None and self.speed is None):
            index = np.minimum(2 * np.arange(self.count + 1)[select] + part, 2 * self.count + 1)
            for name, history in ((TENSION, self.tension), (SPEED, self.speed)):
                if history is not None and name in found.parameters:
                    found.parameters[name] = {r: by * history[index] for r, by in found.parameters[name].items()}
        return found


def setting_of(runs: list[RunData], values: Array, reference: float, rough: bool = False) -> Setting:
    """The setting for parameter values (runs, ``COUNT``); the runs' lines keep the same.

    Parameters
    ----------
    runs : the runs, in their order
    values : (runs, COUNT)
    reference : at which the derivatives are quoted, m/s
    rough : larger steps, for a path that is only to lead near the optimum
    """
    span = max(float(d.t_s[-1] - d.t_s[0]) for d in runs)
    step = _step(runs, values, reference) * (ROUGH if rough else 1)
    count = max(2, int(np.ceil(span / step)))

    def field(name: str) -> Array:
        return np.array([getattr(d.tow, name) for d in runs], dtype=float)

    post = [d.tow.post_phase_rad + 2 * np.pi * d.tow.post_frequency_hz * d.t_s[0] for d in runs]
    moving = any(d.tow.post_amplitude_m for d in runs)
    tow = Tow(
        values[:, SPEED],  # pyright: ignore[reportArgumentType]
        values[:, LINE_LENGTH],  # pyright: ignore[reportArgumentType]
        values[:, TOW_POINT],  # pyright: ignore[reportArgumentType]
        values[:, TENSION],  # pyright: ignore[reportArgumentType]
        tow_point_offset_m=field("tow_point_offset_m"),  # pyright: ignore[reportArgumentType]
        post_amplitude_m=field("post_amplitude_m") if moving else 0.0,  # pyright: ignore[reportArgumentType]
        post_frequency_hz=field("post_frequency_hz"),  # pyright: ignore[reportArgumentType]
        post_phase_rad=np.array(post),  # pyright: ignore[reportArgumentType]
        rudder_rad=field("rudder_rad"),  # pyright: ignore[reportArgumentType]
        line=runs[0].tow.line,
    )
    mass = None if tow.line == "constant" else np.array([d.mass_kg for d in runs], dtype=float)
    hull = hull_from(values.T, reference, mass)
    half = np.arange(2 * count + 2) * step / 2
    tension = _history(runs, half, [_relative(d.tension, d.tow.tension_n) for d in runs])
    speed = _history(runs, half, [_relative(d.speed, d.tow.speed_m_s) for d in runs])
    rudder = _history(runs, half, [d.rudder for d in runs], [d.tow.rudder_rad for d in runs])
    if speed is None or tow.line == "surge":
        hull = hull.at_speed(tow.speed_m_s)
    rate = None if speed is None else np.gradient(speed, step / 2, axis=0)
    return Setting(hull, tow, tension, speed, reference, step, count, rate, rudder, _missing(runs))


def _missing(runs: list[RunData]) -> Force | None:
    """The force that all runs miss, side by side."""
    known = [d.missing for d in runs if d.missing is not None]
    if not known:
        return None
    force = known[0].force
    if len(known) < len(runs) or any(m.force is not force for m in known):
        raise EstimationError("the runs of one fit miss one force, or none")
    duration_s = np.array([d.t_s[-1] - d.t_s[0] for d in runs])
    half_width_m = np.array([m.half_width_m for m in known])
    return lambda t_s, state, tow: force(t_s, state, tow, duration_s, half_width_m)


def _step(runs: list[RunData], values: Array, reference: float) -> float:
    fastest = max(1e-9, *(2 * np.pi * d.tow.post_frequency_hz for d in runs))
    matrix, _ = system_matrices(runs, values, reference, [])
    good = np.isfinite(matrix).all(axis=(1, 2))
    if good.any():
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(matrix[good])).max()))
    # a root far above the sampling rate is a trial of the fit gone astray; the samples cannot tell it from a faster one
    sampling = min(float(np.median(np.diff(d.t_s))) for d in runs)
    # steps of few sizes only, so that a guess of an earlier call fits
    step = max(FULL_STEP_SHARE / fastest, SAMPLING_SHARE * min(sampling, FULL_STEP_S))
    return FULL_STEP_S / 2.0 ** max(0, int(np.ceil(np.log2(FULL_STEP_S / step) - 1e-9)))


def _relative(history: tuple[Array, Array] | None, mean: float | None) -> tuple[Array, Array] | None:
    return None if history is None else (history[0], history[1] / (mean or 1.0))


def _history(
    runs: list[RunData],
    half: Array,
    histories: list[tuple[Array, Array] | None],
    still: list[float] | None = None,
) -> Array | None:
    """Histories at every half step, (2 count + 2, runs); ``still`` (1 if absent) where a run has none; None where no run has."""
    if all(h is None for h in histories):
        return None
    found = np.tile(np.ones(len(runs)) if still is None else np.array(still), (len(half), 1))
    for i, (data, history) in enumerate(zip(runs, histories, strict=True)):
        if history is not None:
            found[:, i] = np.interp(half + data.t_s[0], *history)
    return found
