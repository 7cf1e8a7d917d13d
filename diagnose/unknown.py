"""What stands for "something that is in no library": forces of free form, and faults of free form in what is seen.

If one of these explains the runs far better than every named effect, the gap is real and its cause unknown.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .effects import Effect, Parameter, Seen, Situation

V_M_S, R_RAD_S, Y_M, BETA_RAD = 0.1, 0.05, 0.2, 0.15
"""Usual sizes of a tow's motion."""
WAVES_M, WAVE_RAD = (0.3, 0.15, 0.075), 0.12
SHARP = 0.3
SHAPES = 24
SIZES_N = (0.01, 0.07)
SIZES_M = (0.0005, 0.003)


def _shapes(s: Situation):
    v, r, y, b = s.v_m_s / V_M_S, s.r_rad_s / R_RAD_S, s.y_m / Y_M, s.beta_rad / BETA_RAD
    time = 2 * s.t_s / s.duration_s - 1 + 0.0 * v
    waves = [f(2 * np.pi * s.y_m / length) for length in WAVES_M for f in (np.sin, np.cos)]
    waves += [f(2 * np.pi * s.beta_rad / WAVE_RAD) for f in (np.sin, np.cos)]
    waves += [np.tanh(b / SHARP), np.tanh(v / SHARP), np.tanh(r / SHARP)]
    plain = (
        1 + 0.0 * v,
        time,
        y,
        y * np.abs(y),
        y**3,
        v * np.abs(v),
        v**3,
        r * np.abs(r),
        r**3,
        v * v * r,
        v * r * r,
        b * b,
        time * v,
    )
    return (*plain, *waves)


def _force(s: Situation, *numbers):
    shapes = _shapes(s)
    half = len(shapes)
    side = sum(a * f for a, f in zip(numbers[:half], shapes, strict=True))
    moment = sum(a * f for a, f in zip(numbers[half:], shapes, strict=True))
    return side, moment


def _forms(seen: Seen):
    y, b = seen.pose[1] / Y_M, seen.pose[2] / BETA_RAD
    time = seen.t_s / np.maximum(seen.t_s.max(), 1.0) * 2 - 1 + 0.0 * y
    return (1 + 0.0 * y, time, y, y * y, b, b * b, y * b)


def _seen(seen: Seen, *numbers) -> tuple[Any, Any, Any, Any]:
    forms = _forms(seen)
    each = len(forms)
    x, y, beta, apart = (
        sum(a * f for a, f in zip(numbers[k * each : (k + 1) * each], forms, strict=True)) for k in range(4)
    )
    return x, y, beta, apart


def free_forms() -> tuple[Effect, ...]:
    """Free forms at several sizes."""
    forces = tuple(
        Effect(
            "unknown force",
            "sway",
            tuple(
                Parameter(f"{what}{k}", "N" if what == "y" else "N m", size)
                for what in ("y", "n")
                for k in range(SHAPES)
            ),
            "A force on the hull that no effect of the library has.",
            "Look at when and where it shows.",
            force=_force,
            sizes=(1.0,),
            variant=f"{size:g} N",
        )
        for size in SIZES_N
    )
    sights = tuple(
        Effect(
            "unknown fault of what is seen",
            "camera",
            tuple(
                Parameter(f"{what}{k}", "rad" if what == "b" else "m", size * (0.5 if what == "b" else 1.0))
                for what in ("x", "y", "b", "d")
                for k in range(7)
            ),
            "Something in camera or clock that no effect of the library has.",
            "Run towline check; look where the invariants depart.",
            observe=_seen,
            sizes=(1.0,),
            variant=f"{1e3 * size:g} mm",
        )
        for size in SIZES_M
    )
    return (*forces, *sights)
