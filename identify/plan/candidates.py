"""The runs to choose from: every tow point, line, speed and release, with its information and its conduct."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...record.plan_file import ChoicesTable
from ...simulate.model import Array
from .checks import Conduct, conduct
from .information import UnitTow, run_information, unit_tow
from .kept import BATCH, tows
from .setting import Setting, TowPlan

TOW_POINTS_LBP = (0.05, 0.35, 8)
"""Ahead of X_v, from, to, how many: MARINER's bar reaches 0.31."""
LINES_LBP = (0.2, 0.35, 0.5, 0.75, 1.0)
"""Lengths of line that are tried where the plan names none: a choice."""
RELEASE_STEP_M = 0.01
"""Releases are planned to the centimetre: no better can be set by hand."""
HALVINGS = 12
"""Of the interval of releases: a few metres are halved to a millimetre."""
RETREATS = 4
"""Times that a release is drawn in on a line that keeps its length, where the linear form's farthest passes a limit."""
DRAWN_IN = 0.995
"""Of the release that would just touch the limit, if the swing went with it."""
SURELY = 1.5
"""Times the angle that [limits] allow: what swings so far by the linear form is left out without its own motion."""
NEARER = (0.8, 0.6)
"""Of the farthest release: what a chosen tow is tried at beside."""


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
    """Tow points from a little ahead of X_v to well ahead of it, m, to the centimetre.

    Parameters
    ----------
    x_v_m : X_v, m
    length_pp_m : LBP, m
    """
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
    Lines that keep their length: each release is a motion of its own, of the full form, many side by side.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    choices : tow points, lines, speeds and releases to combine
    speeds_m_s : of the carriage, m/s
    length_pp_m : LBP, m
    show : is told (what, done, of how many)
    """
    points = choices.tow_points_m or default_tow_points(setting.hull.x_v_m, length_pp_m)
    lines = choices.line_lengths_m or tuple(round(share * length_pp_m, 2) for share in LINES_LBP)
    every = [TowPlan(x, length, u, 0.0) for u in speeds_m_s for length in lines for x in points]
    judging = _Judged(setting)
    kept = setting.line == "surge"
    given: list[TowPlan] = []
    farthest: list[TowPlan] = []
    for done, tow in enumerate(every):
        if show is not None:
            show("judging tows", done, len(every))
        unit = unit_tow(setting, tow)
        plans = [
            replace(tow, release_y_m=side, release_beta_rad=beta)
            for beta in choices.releases_beta_rad
            for side in choices.releases_y_m or (farthest_release(setting, replace(tow, release_beta_rad=beta), unit),)
        ]
        for plan in plans:
            found = conduct(setting, plan, unit)
            if (
                kept
                and tow.tow_point_m > setting.hull.x_v_m
                and found.largest_angle_rad < SURELY * setting.limits.angle_rad
            ):
                (given if choices.releases_y_m else farthest).append(plan)
            else:
                judging.take(plan, found, lambda plan=plan, unit=unit: run_information(setting, plan, unit))
    judging.towed(given, 0, show)
    judging.towed(farthest, RETREATS, show)
    return judging.all()


def nearer(setting: Setting, found: Candidates, chosen: Sequence[int]) -> Candidates:
    """``found`` and, behind them, its tows ``chosen`` released less far aside (``NEARER``); other motions, where T swings.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    found : all candidates
    chosen : indices of those that are to be released nearer
    """
    judging = _Judged(setting)
    tried = [
        replace(p, release_y_m=round(p.release_y_m * share, 3))
        for p in (found.plans[i] for i in sorted(set(chosen)))
        for share in NEARER
        if p.release_y_m
    ]
    judging.towed(tried, 0, None)
    more = judging.all()
    if not more.plans:
        return found
    return replace(
        found,
        plans=found.plans + more.plans,
        information=np.concatenate([found.information, more.information]),
        conducts=found.conducts + more.conducts,
    )


class _Judged:
    """Candidates so far: those that may be chosen and, by reason, those that may not."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.kept: list[tuple[TowPlan, Conduct, Array]] = []
        self.excluded: dict[str, int] = {}
        self.example: dict[str, str] = {}

    def take(self, plan: TowPlan, found: Conduct, information: Callable[[], Array]) -> None:
        if found.reason is not None:
            self._left_out(found.reason, plan, found)
        elif plan.release_y_m or plan.release_beta_rad:
            self.kept.append((plan, found, information()))

    def towed(
        self, plans: Sequence[TowPlan], retreats: int, show: Callable[[str, int, int | None], None] | None
    ) -> None:
        """Runs on lines that keep their length, side by side; what passes a limit is drawn in, ``retreats`` times."""
        todo, done, whole = list(plans), 0, len(plans)
        for turn in range(retreats + 1):
            again: list[TowPlan] = []
            for first in range(0, len(todo), 4 * BATCH):
                if show is not None:
                    show("weighing tows", done, whole)
                batch = todo[first : first + 4 * BATCH]
                for plan, tow in zip(batch, tows(self.setting, batch), strict=True):
                    found = conduct(self.setting, plan, tow)
                    closer = None if found.possible or turn == retreats else drawn_in(self.setting, plan, found)
                    if closer is None:
                        self.take(plan, found, lambda plan=plan, tow=tow: run_information(self.setting, plan, tow))
                        done += 1
                    else:
                        again.append(closer)
            todo = again

    def all(self) -> Candidates:
        """Those of too few cycles are left out where others remain."""
        kept = self.kept
        long = [k for k in kept if "cycles" not in k[1].warnings]
        if long and len(long) < len(kept):
            short = next(k for k in kept if "cycles" in k[1].warnings)
            self.excluded["cycles"] = len(kept) - len(long)
            self.example["cycles"] = f"{plan_text(short[0])}: {short[1].warnings['cycles']}"
            kept = long
        stacked = np.array([k[2] for k in kept]) if kept else np.zeros((0, 6, 6))
        return Candidates(
            tuple(k[0] for k in kept), stacked, tuple(k[1] for k in kept), dict(self.excluded), dict(self.example)
        )

    def _left_out(self, reason: str, plan: TowPlan, found: Conduct) -> None:
        self.excluded[reason] = self.excluded.get(reason, 0) + 1
        self.example.setdefault(reason, f"{plan_text(plan)}: {found.warnings[reason]}")


def drawn_in(setting: Setting, plan: TowPlan, found: Conduct) -> TowPlan | None:
    """The plan released nearer to the centre line, by what it passes a limit; None where that helps nothing.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow
    found : how the plan would go
    """
    limits = setting.limits
    if found.reason not in ("wall", "line", "angle") or plan.release_y_m <= RELEASE_STEP_M:
        return None
    half, wide = setting.width_m / 2, setting.breadth_m / 2
    if half - wide <= limits.wall_m:
        return None
    share = min(
        limits.angle_rad / found.largest_angle_rad,
        np.sqrt((1 - limits.line_share) / max(1 - found.line_share, 1e-9)),
        (half - wide - limits.wall_m) / max(half - wide - found.wall_room_m, 1e-9),
    )
    side = np.floor(plan.release_y_m * max(min(DRAWN_IN * share, 1.0), 0.3) / RELEASE_STEP_M) * RELEASE_STEP_M
    side = min(float(side), plan.release_y_m - RELEASE_STEP_M)
    return replace(plan, release_y_m=round(max(side, RELEASE_STEP_M), 4))


def farthest_release(setting: Setting, plan: TowPlan, unit: UnitTow) -> float:
    """Largest y_CG of a release with the plan's heading that no limit forbids, to the centimetre below; at least 0.01 m.

    By the linear form; a line that keeps its length begins there and draws in (``drawn_in``).

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow
    unit : the linear form's motion for releases of 1 m and 1 rad
    """
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
