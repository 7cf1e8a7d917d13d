"""Planned runs on lines that keep their length: the full form's motions and sensitivities, many runs side by side.

Nothing scales here as in the linear form: a release of its own is a motion of its own (theory.md 10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from ..data import RunData
from ..joint.full import full_paths
from ..joint.guess import Guess
from ..joint.parameters import COUNT, LINE_LENGTH, SPEED, STEEPEST_RAD, TENSION, TOW_POINT
from .information import Course, Grid, Towed, commons, grid_of, planned_record, unit_tow
from .setting import Setting, TowPlan

BATCH = 24
"""Runs integrated side by side: more save no time and take memory."""


@dataclass(frozen=True)
class KeptTow:
    """One planned release; NaN throughout where the motion goes past 90 degrees or the release is out of reach.

    Attributes
    ----------
    times_s, weights : (n,), ``Grid``
    matrix : (4, 4), of the linear form: small swings
    y_m, beta_rad, alpha_rad : (n,)
    tension_n : (n,), T; not above 0: the line is slack there and the motion another
    slopes : (n, 2, ``COUNT``), change of (y, beta); columns that nobody asks for are 0
    """

    times_s: Array
    weights: Array
    matrix: Array
    y_m: Array
    beta_rad: Array
    alpha_rad: Array
    tension_n: Array
    slopes: Array

    def slopes_of(self, plan: TowPlan) -> Array:
        """``slopes``; ``plan`` is the one they were made for."""
        return self.slopes

    def course(self, setting: Setting, plan: TowPlan) -> Course:
        """Where it goes."""
        reach = plan.line_length_m * np.sin(self.alpha_rad)
        share = self.tension_n / setting.tow(plan).resistance
        return Course(self.y_m, self.beta_rad, self.alpha_rad + self.beta_rad, reach, share)


def tows(setting: Setting, plans: Sequence[TowPlan], durations_s: Sequence[float] | None = None) -> list[Towed]:
    """Each plan's tow as the setting's line makes it; ``durations_s`` instead of the tank's.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    durations_s : of each record instead of the tank's, s
    """
    spans = [None] * len(plans) if durations_s is None else list(durations_s)
    if setting.line == "constant":
        return [unit_tow(setting, p, s) for p, s in zip(plans, spans, strict=True)]
    return list(kept_tows(setting, plans, spans))


def kept_tows(
    setting: Setting, plans: Sequence[TowPlan], durations_s: Sequence[float | None] | None = None
) -> list[KeptTow]:
    """The planned releases, in the order of ``plans``.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the releases
    durations_s : of each record instead of the tank's
    """
    spans = [None] * len(plans) if durations_s is None else durations_s
    grids = [grid_of(setting, p, s) for p, s in zip(plans, spans, strict=True)]
    made = [_nowhere(g) for g in grids]
    can = [i for i, p in enumerate(plans) if np.isfinite(release_alpha(p))]
    can.sort(key=lambda i: grids[i].times_s[-1])
    for first in range(0, len(can), BATCH):
        batch = can[first : first + BATCH]
        for i, tow in zip(
            batch, _side_by_side(setting, [plans[i] for i in batch], [grids[i] for i in batch]), strict=True
        ):
            made[i] = tow
    return made


def release_alpha(plan: TowPlan) -> float:
    """Angle of the line at the release, rad; NaN where it is out of the line's reach, or nearly across."""
    share = (plan.release_y_m + plan.tow_point_m * np.sin(plan.release_beta_rad)) / plan.line_length_m
    if abs(share) >= np.sin(STEEPEST_RAD):
        return float("nan")
    alpha = float(np.arcsin(share))
    return alpha if abs(alpha + plan.release_beta_rad) < STEEPEST_RAD else float("nan")


def _side_by_side(setting: Setting, plans: Sequence[TowPlan], grids: Sequence[Grid]) -> list[KeptTow]:
    """Halved and halved again where one run leaves the equations' range, which would spoil the others."""
    runs = [planned_record(setting, p, g.times_s) for p, g in zip(plans, grids, strict=True)]
    values = np.array([_values(setting, p) for p in plans])
    shared = commons(setting)
    for common in shared:
        common.put(values, 0.0)
    places = {*range(10), TENSION, *(c.place for c in shared)} | (
        {TOW_POINT} if setting.priors.tow_point_sd_m else set()
    )
    wanted = tuple(sorted(places))
    paths, guess = full_paths(runs, values, setting.hull.speed_m_s, wanted, rough=True)
    if not guess.wanted:
        if len(plans) == 1:
            return [_nowhere(grids[0])]
        half = len(plans) // 2
        return _side_by_side(setting, plans[:half], grids[:half]) + _side_by_side(setting, plans[half:], grids[half:])
    return [_kept(i, grids[i], runs[i], plans[i], paths[i], guess, wanted) for i in range(len(plans))]


def _values(setting: Setting, plan: TowPlan) -> Array:
    """(``COUNT``,), ``RUN_PARAMETERS`` of the release at rest, without what all runs share."""
    values = np.zeros(COUNT)
    values[:6] = setting.values
    values[6:10] = release_alpha(plan), plan.release_beta_rad, -plan.speed_m_s * np.sin(plan.release_beta_rad), 0.0
    values[TENSION], values[TOW_POINT] = setting.tow(plan).resistance, plan.tow_point_m
    values[LINE_LENGTH], values[SPEED] = plan.line_length_m, plan.speed_m_s
    return values


def _kept(
    run: int, grid: Grid, data: RunData, plan: TowPlan, path: tuple[Array, Array], guess: Guess, wanted: tuple[int, ...]
) -> KeptTow:
    (y, beta), moved = path
    slopes = np.zeros((len(grid.times_s), 2, COUNT))
    slopes[:, :, list(wanted)] = moved.transpose(2, 0, 1)
    tension, _ = guess.tension_at(run, data.t_s)
    alpha = np.arcsin(np.clip((y + plan.tow_point_m * np.sin(beta)) / plan.line_length_m, -1.0, 1.0))
    return KeptTow(grid.times_s, grid.weights, grid.matrix, y, beta, alpha, tension, slopes)


def _nowhere(grid: Grid) -> KeptTow:
    nothing = np.full(len(grid.times_s), np.nan)
    slopes = np.full((len(nothing), 2, COUNT), np.nan)
    return KeptTow(grid.times_s, grid.weights, grid.matrix, nothing, nothing, nothing, nothing, slopes)


__all__ = ["KeptTow", "kept_tows", "release_alpha", "tows"]
