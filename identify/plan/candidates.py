"""The runs to choose from: every tow point, line, speed and release, with its information and its conduct."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...record.plan_file import ChoicesTable
from ...simulate.model import Array
from .checks import Conduct, conduct
from .information import UnitTow, run_information, unit_tow
from .setting import Setting, TowPlan

TOW_POINTS_LBP = (0.05, 0.35, 8)
"""Ahead of X_v, from, to, how many: MARINER's bar reaches 0.31."""
LINES_LBP = (0.2, 0.35, 0.5, 0.75, 1.0)
RELEASE_STEP_M = 0.01
HALVINGS = 12


@dataclass(frozen=True)
class Candidates:
    """Runs that may be chosen, and those that may not.

    Attributes
    ----------
    plans : (c)
    information : (c, k, k)
    conducts : (c)
    excluded : runs left out, by reason; those of too few cycles are left out where others remain
    example : one sentence of each reason
    """

    plans: tuple[TowPlan, ...]
    information: Array
    conducts: tuple[Conduct, ...]
    excluded: dict[str, int]
    example: dict[str, str]


def default_tow_points(x_v_m: float, length_pp_m: float) -> tuple[float, ...]:
    """Tow points from a little ahead of X_v to well ahead of it, m, to the centimetre."""
    first, last, count = TOW_POINTS_LBP
    return tuple(round(x_v_m + share * length_pp_m, 2) for share in np.linspace(first, last, count))


def gather(
    setting: Setting,
    choices: ChoicesTable,
    speeds_m_s: tuple[float, ...],
    length_pp_m: float,
    show: Callable[[str, int, int | None], None] | None = None,
) -> Candidates:
    """All combinations of ``choices``, each judged.

    Where no releases are given, each tow is released as far aside as walls, line and angle allow, to the centimetre.
    """
    points = choices.tow_points_m or default_tow_points(setting.hull.x_v_m, length_pp_m)
    lines = choices.line_lengths_m or tuple(round(share * length_pp_m, 2) for share in LINES_LBP)
    tows = [TowPlan(x, length, u, 0.0) for u in speeds_m_s for length in lines for x in points]
    kept: list[tuple[TowPlan, Conduct, Array]] = []
    excluded: dict[str, int] = {}
    example: dict[str, str] = {}
    for done, tow in enumerate(tows):
        if show is not None:
            show("judging tows", done, len(tows))
        unit = unit_tow(setting, tow)
        for beta in choices.releases_beta_rad:
            sides = choices.releases_y_m or (farthest_release(setting, replace(tow, release_beta_rad=beta), unit),)
            for side in sides:
                plan = replace(tow, release_y_m=side, release_beta_rad=beta)
                found = conduct(setting, plan, unit)
                if found.reason is not None:
                    excluded[found.reason] = excluded.get(found.reason, 0) + 1
                    example.setdefault(found.reason, f"{plan_text(plan)}: {found.warnings[found.reason]}")
                elif side or beta:
                    kept.append((plan, found, run_information(setting, plan, unit)))
    long = [k for k in kept if "cycles" not in k[1].warnings]
    if long and len(long) < len(kept):
        short = next(k for k in kept if "cycles" in k[1].warnings)
        excluded["cycles"] = len(kept) - len(long)
        example["cycles"] = f"{plan_text(short[0])}: {short[1].warnings['cycles']}"
        kept = long
    stacked = np.array([k[2] for k in kept]) if kept else np.zeros((0, 6, 6))
    return Candidates(tuple(k[0] for k in kept), stacked, tuple(k[1] for k in kept), excluded, example)


def farthest_release(setting: Setting, plan: TowPlan, unit: UnitTow) -> float:
    """Largest y_CG of a release with the plan's heading that no limit forbids, to the centimetre below; at least 0.01 m."""
    high = min(setting.width_m / 2, plan.line_length_m)
    low = 0.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if conduct(setting, replace(plan, release_y_m=middle), unit).possible:
            low = middle
        else:
            high = middle
    return max(round(np.floor(low / RELEASE_STEP_M) * RELEASE_STEP_M, 4), RELEASE_STEP_M)


def plan_text(plan: TowPlan) -> str:
    """A run in one short text."""
    return (
        f"X_T {plan.tow_point_m:.3f} m, L {plan.line_length_m:.2f} m, U {plan.speed_m_s:g} m/s, released at y "
        f"{plan.release_y_m:.2f} m, beta {plan.release_beta_rad:+.3f} rad"
    )
