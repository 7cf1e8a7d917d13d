"""Simple ways to the same answer, from the same folders: what the diagnosis has to beat.

- always null: there is never a gap.
- evidence alone: the best single effect or pair of the diagnosis's own fits by evidence, without priors and ``unknown``.
- BIC on forces: sway and yaw forces by differentiating the motion twice; the one candidate term whose regression has the least BIC.
- sparse regression: the same forces, all terms at once, small ones struck out in turn (STLSQ, as in SINDy).

The last two see forces only; faults of camera and clock are beyond them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import savgol_filter

from ..record.errors import InputError
from ..record.run import Run, read_run
from ..record.tables import read_motion
from .judge import NO_GAP, Call
from .truth.lanes import Array

if TYPE_CHECKING:
    import pandas as pd

WINDOW_S = 2.0
"""Of the Savitzky-Golay filter that differentiates the motion: a choice."""
EVERY_S = 0.4
"""Samples of a smoothed derivative are kept this far apart, so that their errors are nearly independent."""
STRUCK = 0.08
"""A term whose share in the force's standard deviation is below this is struck out."""
METHODS = ("always null", "evidence alone", "BIC on forces", "sparse regression")


def baseline_calls(folders: Sequence[Path], answer: Mapping[str, Any]) -> dict[str, Call]:
    """The baselines' calls for a campaign (its motions as the diagnosis left them in RUN/out).

    Parameters
    ----------
    folders : of the case's runs
    answer : gap.json
    """
    calls: dict[str, Call] = {"always null": NO_GAP}
    if "gap" in answer:
        calls["evidence alone"] = _by_evidence(answer["gap"])
    system = _stacked(folders)
    if system is not None:
        target, base, terms = system
        calls["BIC on forces"] = _by_bic(target, base, terms)
        calls["sparse regression"] = _sparse(target, base, terms)
    return calls


def _by_evidence(gap: Mapping[str, Any]) -> Call:
    best = max(gap["ranking"], key=lambda row: row["log_evidence"], default=None)
    return NO_GAP if best is None or best["log_evidence"] <= 0 else frozenset(best["effects"])


def _stacked(folders: Sequence[Path]) -> tuple[Array, Array, dict[str, Array]] | None:
    """Sway forces above yaw moments of all runs: target, the linear model's columns, candidates' columns."""
    parts = []
    for folder in folders:
        motion = folder / "out" / "motion.csv"
        if not motion.is_file():
            continue
        try:
            run = read_run(folder)
        except InputError:  # its film was thrown away after the diagnosis
            continue
        parts.append(_forces(run, read_motion(motion)))
    if not parts:
        return None
    target = np.concatenate([p[0] for p in parts])
    base = np.vstack([p[1] for p in parts])
    terms = {name: np.vstack([p[2][name] for p in parts]) for name in parts[0][2]}
    return target, base, terms


def _forces(run: Run, motion: pd.DataFrame) -> tuple[Array, Array, dict[str, Array]]:
    tow = run.file.tow
    assert tow is not None
    t = motion["t_s"].to_numpy(float)
    step = float(np.median(np.diff(t)))
    wide = max(int(WINDOW_S / step) // 2 * 2 + 1, 7)
    y, b = (motion[name].interpolate(limit_direction="both").to_numpy(float) for name in ("y_cg_m", "beta_rad"))

    def smooth(values: Array, order: int) -> Array:
        return np.asarray(savgol_filter(values, wide, 4, deriv=order, delta=step), float)

    y0, y1, y2 = (smooth(y, k) for k in range(3))
    b0, b1, b2 = (smooth(b, k) for k in range(3))
    keep = slice(wide // 2, -(wide // 2), max(int(EVERY_S / step), 1))
    y0, y1, y2, b0, b1, b2, t = (x[keep] for x in (y0, y1, y2, b0, b1, b2, t))
    u, line, x_t = float(tow.speed_m_s), float(tow.line_length_m or 1.0), float(tow.tow_point_m or 0.0)
    v, r = y1 - u * b0, b1
    v_rate, r_rate = y2 - u * b1, b2
    alpha = np.arcsin(np.clip((y0 + x_t * np.sin(b0)) / line, -0.95, 0.95))
    pull = float(tow.tension_n) if tow.tension_n is not None else 1.0
    s = np.sin(alpha + b0)
    zero, one = np.zeros_like(v), np.ones_like(v)
    turning = np.gradient(alpha, t) + r
    rows = len(t)

    def both(side: Array, moment: Array) -> Array:
        return np.concatenate([side / pull, moment / (pull * x_t)])

    base = np.column_stack(
        [
            both(u * v, zero),
            both(u * r, zero),
            both(-v_rate, zero),
            both(zero, u * v),
            both(zero, u * r),
            both(zero, -r_rate),
        ]
    )
    target = both(pull * s, pull * x_t * s)
    more = 1 / np.cos(alpha) - 1
    candidates = {
        "crossflow_drag": [both(v * abs(v), zero), both(zero, r * abs(r))],
        "cubic_damping": [both(v**3, zero), both(zero, v**3), both(zero, r**3)],
        "hull_asymmetry": [both(u**2 * one, zero), both(zero, u**2 * one)],
        "added_mass_coupling": [both(r_rate, zero), both(zero, v_rate)],
        "cross_current": [both(u * one, 0.9 * u * one)],
        "bank_suction": [both(u**2 * y0, zero)],
        "tension_variation": [both(-pull * s * more, -pull * x_t * s * more)],
        "tow_point_offset": [both(zero, pull * np.cos(alpha + b0))],
        "swivel_friction": [both(zero, np.tanh(turning / 0.004))],
        "speed_drift": [both(u * v * (t / t[-1] - 0.5), u * v * (t / t[-1] - 0.5))],
    }
    assert len(target) == 2 * rows
    return target, base, {name: np.column_stack(columns) for name, columns in candidates.items()}


def _by_bic(target: Array, base: Array, terms: Mapping[str, Array]) -> Call:
    n = len(target)

    def bic(columns: Array) -> float:
        rest = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0]
        return n * np.log(float(rest @ rest) / n) + columns.shape[1] * np.log(n)

    least, found = bic(base), NO_GAP
    for name, columns in terms.items():
        value = bic(np.column_stack([base, columns]))
        if value < least:
            least, found = value, frozenset({name})
    return found


def _sparse(target: Array, base: Array, terms: Mapping[str, Array]) -> Call:
    names = [name for name, columns in terms.items() for _ in range(columns.shape[1])]
    extra = np.column_stack(list(terms.values()))
    kept = np.ones(len(names), bool)
    share = np.zeros(len(names))
    for _ in range(len(names)):
        columns = np.column_stack([base, extra[:, kept]])
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        solved = np.linalg.lstsq(columns / scale, target, rcond=1e-8)[0] / scale
        share[:] = 0.0
        share[kept] = np.abs(solved[base.shape[1] :]) * extra[:, kept].std(axis=0) / target.std()
        small = kept & (share < STRUCK)
        if not small.any():
            break
        kept &= ~small
    if not kept.any():
        return NO_GAP
    by_name: dict[str, float] = {}
    for name, value in zip(names, share, strict=True):
        by_name[name] = max(by_name.get(name, 0.0), value)
    ranked = sorted((name for name, v in by_name.items() if v > 0), key=lambda name: -by_name[name])
    return frozenset(ranked[:2]) if len(ranked) == 2 else frozenset(ranked[:1])
