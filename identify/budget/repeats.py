"""Repeats: runs of the same set-up, each fitted alone, against what their lines say (a type A check of the whole).

What is common to the repeats (the gauge's scale, the line, a camera picked once) moves all of them alike and is not seen in
their scatter, so that the scatter is held against the lines that each run has for itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from ...record.errors import EstimationError
from ...record.priors import DERIVATIVE_NAMES
from ...simulate.model import Array
from ..data import RunData
from ..fit import Fit, Near, fit_runs
from ..limits.combinations import determined
from .combine import LEVEL, budget_of
from .components import CAMERA

SAME = 1e-3
"""Set-ups whose lengths (m), speeds (relative) and rudders (rad) differ by less are the same: a choice."""


@dataclass(frozen=True)
class Repeated:
    """One derivative over the repeats.

    Attributes
    ----------
    name : of it
    pooled : standard deviation of single runs about their set-up's mean, pooled
    stated : what their own lines say, root mean square
    degrees : runs less set-ups
    ratio : pooled over stated
    low, high : 95 % interval of the ratio
    p_value : chance of a larger scatter, were the lines right
    """

    name: str
    pooled: float
    stated: float
    degrees: int
    ratio: float
    low: float
    high: float
    p_value: float


@dataclass(frozen=True)
class Repeats:
    """Result of ``repeats_of``.

    Attributes
    ----------
    groups : names of runs that repeat each other
    derivatives : those that single runs determine
    why : why there is none, or what was left out; empty: nothing to say
    """

    groups: tuple[tuple[str, ...], ...]
    derivatives: tuple[Repeated, ...]
    why: str = ""


def repeats_of(fit: Fit, runs: Sequence[RunData]) -> Repeats:
    """Find repeats among the runs and pool their scatter.

    Parameters
    ----------
    fit : the joint fit by output error
    runs : as fitted
    """
    groups = [g for g in _groups(runs) if len(g) > 1]
    names = tuple(tuple(runs[k].name for k in g) for g in groups)
    if not groups:
        return Repeats((), (), "no two runs share tow point, line, speed and rudder")
    singles = {k: _alone(fit, runs, k, len({runs[i].common_key for i in g}) > 1) for g in groups for k in g}
    failed = [runs[k].name for k, one in singles.items() if one is None]
    found = []
    for i, name in enumerate(DERIVATIVE_NAMES):
        squares, lines, degrees = 0.0, [], 0
        for g in groups:
            told = [one for k in g if (one := singles[k]) is not None and one[2][i]]
            if len(told) < 2:
                continue
            values = np.array([one[0][i] for one in told])
            variances = np.array([one[1][i] for one in told])
            squares += float(((values - values.mean()) ** 2 / variances).sum())
            lines += variances.tolist()
            degrees += len(told) - 1
        if degrees:
            found.append(_repeated(name, squares, float(np.sqrt(np.mean(lines))), degrees))
    why = f"could not be fitted alone: {', '.join(failed)}" if failed else ""
    if not found and not why:
        why = "no single run determines a derivative by itself"
    return Repeats(names, tuple(found), why)


def _repeated(name: str, squares: float, stated: float, degrees: int) -> Repeated:
    ratio = float(np.sqrt(squares / degrees))
    low, high = (float(np.sqrt(squares / chdtri(degrees, p))) for p in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Repeated(name, ratio * stated, stated, degrees, ratio, low, high, float(chdtrc(degrees, squares)))


def _groups(runs: Sequence[RunData]) -> list[list[int]]:
    groups: list[list[int]] = []
    for k, run in enumerate(runs):
        for g in groups:
            if _alike(runs[g[0]], run):
                g.append(k)
                break
        else:
            groups.append([k])
    return groups


def _alike(one: RunData, other: RunData) -> bool:
    a, b = one.tow, other.tow
    apart = (
        a.tow_point_m - b.tow_point_m,
        a.line_length_m - b.line_length_m,
        (a.speed_m_s - b.speed_m_s) / a.speed_m_s,
        a.rudder_rad - b.rudder_rad,
        a.tow_point_offset_m - b.tow_point_offset_m,
    )
    histories = any(d.rudder is not None for d in (one, other))
    return not histories and bool(np.abs(apart).max() < SAME)


def _alone(fit: Fit, runs: Sequence[RunData], index: int, own_camera: bool) -> tuple[Array, Array, Array] | None:
    """Six of a run alone, the variance of its own lines, and which it determines; None where it cannot be fitted."""
    one = [runs[index]]
    try:
        alone = fit_runs(one, fit.form, fit.speed_m_s, start=fit.six, near=Near.of(fit, list(runs), (index,)))
        budget = budget_of(alone, one)
    except EstimationError:
        return None
    fixed = np.zeros(6, dtype=bool)
    fixed[list(determined(alone.six, alone.covariance).single)] = True
    mine = [
        c
        for c in budget.components
        if c.included and (c.run or c.evaluation == "A" or (own_camera and c.source == CAMERA))
    ]
    own = sum((np.diag(c.covariance)[:6] for c in mine), np.zeros(6))
    return alone.six, own, fixed


__all__ = ["Repeated", "Repeats", "repeats_of"]
