"""What one integration of the full equations needs: hull and tows of all runs side by side, step length, histories."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array, Hull, Tow, full_rates
from ..data import RunData
from .linear import system_matrices
from .parameters import LINE_LENGTH, SPEED, TENSION, TOW_POINT, hull_from
from .partials import Linearised, linearise

FULL_STEP_S = 0.05
FULL_STEP_SHARE = 0.06
"""Runge-Kutta step: this share of the fastest root's time."""
SAMPLING_SHARE = 0.25


@dataclass(frozen=True)
class Setting:
    """Hull, tows and step of one integration.

    Attributes
    ----------
    hull, tow : fields are arrays over the runs
    tension, speed : histories at every half step, (2 count + 2, runs), relative to their means; None where constant
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

    def at(self, part: int, select: slice) -> tuple[Array, Hull, Tow]:
        """Times, hull and tow at the steps ``select``, ``part`` half steps later."""
        index = np.arange(self.count + 1)[select]
        t = (index + part / 2)[:, None] * self.step
        hull, tow = self.hull, self.tow
        half = np.minimum(2 * index + part, 2 * self.count + 1)
        if self.tension is not None:
            tow = replace(tow, tension_n=tow.tension_n * self.tension[half])
        if self.speed is not None:
            tow = replace(tow, speed_m_s=tow.speed_m_s * self.speed[half])
            hull = hull.at_speed(tow.speed_m_s)
        return t, hull, tow

    def linearised(self, part: int, state: Array, wanted: tuple[int, ...], select: slice) -> Linearised:
        """Rates with their partial derivatives at ``state`` (4, steps, runs)."""
        t, hull, tow = self.at(part, select)
        found = linearise(full_rates, t, state, hull, tow, wanted, self.reference)
        if not (self.tension is None and self.speed is None):
            index = 2 * np.arange(self.count + 1)[select] + part
            for name, history in ((TENSION, self.tension), (SPEED, self.speed)):
                if history is not None and name in found.parameters:
                    found.parameters[name] = tuple((row, by * history[index]) for row, by in found.parameters[name])
        return found


def setting_of(runs: list[RunData], values: Array, reference: float) -> Setting:
    """The setting for parameter values (runs, 14)."""
    span = max(float(d.t_s[-1] - d.t_s[0]) for d in runs)
    step = _step(runs, values, reference)
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
    )
    hull = hull_from(values.T, reference)
    tension, speed = _histories(runs, step, count)
    if speed is None:
        hull = hull.at_speed(tow.speed_m_s)
    return Setting(hull, tow, tension, speed, reference, step, count)


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


def _histories(runs: list[RunData], step: float, count: int) -> tuple[Array | None, Array | None]:
    """Tension and speed relative to their means at every half step, (2 count + 2, runs); None where constant."""
    half = np.arange(2 * count + 2) * step / 2
    tension = speed = None
    if any(d.tension is not None for d in runs):
        tension = np.ones((len(half), len(runs)))
        for i, d in enumerate(runs):
            if d.tension is not None:
                assert d.tow.tension_n is not None
                tension[:, i] = np.interp(half + d.t_s[0], *d.tension) / d.tow.tension_n
    if any(d.speed is not None for d in runs):
        speed = np.ones((len(half), len(runs)))
        for i, d in enumerate(runs):
            if d.speed is not None:
                speed[:, i] = np.interp(half + d.t_s[0], *d.speed) / d.tow.speed_m_s
    return tension, speed
