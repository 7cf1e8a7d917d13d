"""What a campaign on lines that keep their length tells at each release: the scale of all forces, and the six (theory.md 10).

The model's mass pulls at its line by as much as the square of its swing; what the motion shows of that tells T/(m - X_udot).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...record.plan_file import ReleaseRow
from ...simulate.model import DERIVATIVE_UNITS, Array
from ..joint.common import SCALE
from ..tension import WEIGHED_LOG_SD
from .checks import conduct
from .information import Towed, commons, prior_information, relative_covariance, run_information, whole_covariance
from .kept import tows
from .setting import Setting, TowPlan

RELEASES_DEG = (3.0, 6.0, 9.5, 13.0, 19.0)
"""Line angles that are compared: a choice, from a few degrees to where few tanks have room."""


def release_rows(
    setting: Setting, plans: Sequence[TowPlan], releases_deg: Sequence[float] = RELEASES_DEG
) -> list[ReleaseRow]:
    """The campaign as planned, then with all its tows released at one line angle, heading 0.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    releases_deg : line angles, degrees

    Example
    -------
    ``release_rows(setting, [TowPlan(1.548, 0.91, 1.28, 0.15)])[0].scale_sd_percent``
    """
    campaigns: list[tuple[float | None, Sequence[TowPlan]]] = [(None, plans)]
    campaigns += [(angle, [released_at(p, angle) for p in plans]) for angle in releases_deg]
    every = iter(tows(setting, [p for _, c in campaigns for p in c]))
    return [_row(setting, angle, c, [next(every) for _ in c]) for angle, c in campaigns]


def released_at(plan: TowPlan, angle_deg: float) -> TowPlan:
    """The tow released with its line at an angle and heading 0, on the plan's own side.

    Parameters
    ----------
    plan : of the tow
    angle_deg : of the line, degrees
    """
    side = plan.release_y_m + plan.tow_point_m * np.sin(plan.release_beta_rad)
    lateral = float(np.copysign(plan.line_length_m * np.sin(np.radians(angle_deg)), side))
    return replace(plan, release_y_m=lateral, release_beta_rad=0.0)


def scale_sd(setting: Setting, plans: Sequence[TowPlan], towed: Sequence[Towed]) -> tuple[float, float]:
    """Standard deviation of the logarithm of the scale: from the motion alone, and with the gauge's readings beside it.

    A gauge tells the scale of n runs to sqrt(common^2 + scatter^2/n), as ``identify.tension`` takes it.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    towed : the motion of each
    """
    alone = without_gauge(setting, plans)
    at = 6 + [c.name for c in commons(alone)].index(SCALE)
    motion = float(np.sqrt(whole_covariance(_information(alone, plans, towed))[at, at]))
    gauged = replace(setting, gauge=True)
    scatter = np.array([gauged.tension_scatter(p) for p in plans])
    own = 0.0 if (scatter == 0).any() else float((scatter**-2.0).sum() ** -0.5)
    reads = float(np.hypot(setting.priors.tension_common_sd_rel, own))
    return motion, motion * reads / float(np.hypot(motion, reads))


def without_gauge(setting: Setting, plans: Sequence[TowPlan]) -> Setting:
    """The same where nobody measures the tension.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    """
    return replace(setting, gauge=False, unlike_speeds=len({p.speed_m_s for p in plans}) > 1)


def release_rule(setting: Setting, rows: Sequence[ReleaseRow]) -> str:
    """From which release on the model's mass tells T, in words, and how far the limits let it go.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    rows : from ``release_rows``
    """
    angles = [r for r in rows if r.release_deg is not None and r.scale_sd_percent is not None]
    told = [r for r in angles if r.scale_sd_percent is not None and r.scale_sd_percent < 100 * WEIGHED_LOG_SD]
    if not told:
        best = min((r.scale_sd_percent for r in angles if r.scale_sd_percent is not None), default=np.inf)
        return f"without a gauge none of these releases tells the tension to better than {best:.2g} %: measure it"
    first = told[0]
    words = (
        f"without a gauge, release at {first.release_deg:g} degrees or more: the model's mass tells T to "
        f"{first.scale_sd_percent:.2g} % there"
    )
    before = angles[: angles.index(first)]
    if before:
        words += f", at {before[-1].release_deg:g} degrees to {before[-1].scale_sd_percent:.2g} % only"
    if told[-1] is not first:
        words += f", at {told[-1].release_deg:g} degrees to {told[-1].scale_sd_percent:.2g} %"
    allowed = [r.release_deg for r in angles if not r.limits]
    if allowed:
        words += f"; [limits] allow {max(a for a in allowed if a is not None):g} degrees in all of these runs"
    else:
        words += f"; [limits] forbid {angles[0].release_deg:g} degrees already in some of these runs"
    return words


def _information(setting: Setting, plans: Sequence[TowPlan], towed: Sequence[Towed]) -> Array:
    runs = [run_information(setting, p, t) for p, t in zip(plans, towed, strict=True)]
    return prior_information(setting) + np.sum(runs, axis=0)


def _row(setting: Setting, angle: float | None, plans: Sequence[TowPlan], towed: Sequence[Towed]) -> ReleaseRow:
    found = [conduct(setting, p, t) for p, t in zip(plans, towed, strict=True)]
    limits = [f"run {i}: {c.warnings[c.reason]}" for i, c in enumerate(found, 1) if c.reason is not None]
    least = min(c.line_share for c in found)
    if least <= 0:
        return ReleaseRow(
            release_deg=angle,
            scale_sd_percent=None,
            gauged_scale_sd_percent=None,
            sd_percent=None,
            ungauged_sd_percent=None,
            least_line_share=least,
            limits=limits,
        )
    motion, gauged = scale_sd(setting, plans, towed)
    return ReleaseRow(
        release_deg=angle,
        scale_sd_percent=100 * motion,
        gauged_scale_sd_percent=100 * gauged,
        sd_percent=_percents(_information(replace(setting, gauge=True), plans, towed)),
        ungauged_sd_percent=_percents(_information(without_gauge(setting, plans), plans, towed)),
        least_line_share=least,
        limits=limits,
    )


def _percents(information: Array) -> dict[str, float]:
    sd = np.sqrt(np.diag(relative_covariance(information)))
    return {name: float(100 * s) for name, s in zip(DERIVATIVE_UNITS, sd, strict=True)}


__all__ = ["RELEASES_DEG", "release_rows", "release_rule", "released_at", "scale_sd", "without_gauge"]
