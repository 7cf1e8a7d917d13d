"""The thesis's rules for such tows, with a hull's own numbers (chapters 3, 8, 9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...simulate.model import DERIVATIVE_UNITS, Array, linear_system
from .information import prior_information, relative_covariance, run_information
from .kept import tows
from .setting import Setting, TowPlan

CYCLES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
"""Lengths of record that are compared, in swings: a choice."""
DROPPED_S = (0.0, 5.0, 10.0, 20.0)
"""Beginnings of the record that are left out in comparison: a choice."""
COMPLEX_STEP = 1e-30
"""Step of the complex derivative: so small that it is exact to rounding, as nothing is subtracted."""


def swing_sensitivity(setting: Setting, plan: TowPlan) -> dict[str, float]:
    """Frequency and decay of the swing and how L, X_T and U move the frequency; {} where it does not swing.

    Exact: d lambda = w'dA v/(w'v) of the pair's eigenvectors, dA by the complex step; T goes with U^2.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow

    Returns
    -------
    name -> number
    """
    matrix = _matrix(setting, plan.line_length_m, plan.tow_point_m, plan.speed_m_s)
    roots, right = np.linalg.eig(matrix)
    rates, decays = np.imag(roots), -np.real(roots)
    pairs = np.flatnonzero(rates > 1e-9 * np.abs(roots).max())
    if not len(pairs):
        return {}
    at = pairs[np.argmin(decays[pairs])]
    left = np.linalg.inv(right)[at]
    here = [plan.line_length_m, plan.tow_point_m, plan.speed_m_s]
    found = {"omega_rad_s": float(rates[at]), "damping_per_s": float(decays[at])}
    for index, name in enumerate(("line_length_rad_s_m", "tow_point_rad_s_m", "speed_rad_m")):
        moved: list[complex] = list(here)
        moved[index] += 1j * COMPLEX_STEP
        slope = np.imag(_matrix(setting, *moved)) / COMPLEX_STEP
        found[f"d_omega_d_{name}"] = float((left @ slope @ right[:, at]).imag)
    return found


def _matrix(setting: Setting, length, x_t, speed) -> Array:
    plan = TowPlan(x_t, length, speed, 0.0)
    return linear_system(setting.hull_at(speed), setting.tow(plan))[0]


def campaign_sd(setting: Setting, plans: Sequence[TowPlan], durations_s: Sequence[float], from_s: float = 0.0) -> Array:
    """Relative standard deviations (6,) of a campaign whose records last ``durations_s`` and begin ``from_s`` after the release.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    durations_s : of each record, s
    from_s : samples before are dropped, s from the release
    """
    total = prior_information(setting)
    for plan, tow in zip(plans, tows(setting, plans, durations_s), strict=True):
        total = total + run_information(setting, plan, tow, from_s)
    return np.sqrt(np.diag(relative_covariance(total)))


def cycles_rule(setting: Setting, plans: Sequence[TowPlan], cycles: Sequence[float] = CYCLES) -> list[dict[str, float]]:
    """Standard deviation in % of each derivative when every run's record holds so many cycles, whatever the tank.

    ``seconds`` are the first run's; [] where a run does not swing.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    cycles : lengths of record, in swings
    """
    swings = [swing_sensitivity(setting, p) for p in plans]
    if not all(swings):
        return []
    periods = [2 * np.pi / s["omega_rad_s"] for s in swings]
    return [
        {"cycles": c, "seconds": c * periods[0], **_percents(campaign_sd(setting, plans, [c * p for p in periods]))}
        for c in cycles
    ]


def transient_rule(
    setting: Setting, plans: Sequence[TowPlan], dropped: Sequence[float] = DROPPED_S
) -> list[dict[str, float]]:
    """Standard deviation in % of each derivative when the first seconds after the release are not recorded.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    dropped : seconds that are left out, one row each
    """
    spans = [setting.duration_s(p.speed_m_s) for p in plans]
    return [
        {"dropped_s": d, **_percents(campaign_sd(setting, plans, spans, d))} for d in dropped if d < 0.8 * min(spans)
    ]


def _percents(sd: Array) -> dict[str, float]:
    return {name: float(100 * s) for name, s in zip(DERIVATIVE_UNITS, sd, strict=True)}
