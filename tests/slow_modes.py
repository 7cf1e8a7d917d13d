"""Campaigns whose marks are off by what is drawn of some modes: whether the fit takes it out and says how well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np

from towline.identify import RunData, fit_runs

CAMPAIGNS = 20
"""Of two tows each: chi-square of six derivatives each, 120 +- 15.5 together."""


def chi_squares(
    campaigns: ModuleType, with_modes: Callable[[RunData], RunData], seed: int, drawn: bool
) -> tuple[float, float, float]:
    """Chi-square of all derivatives with the modes in the fit and without, and the largest mode found, in standard deviations.

    Parameters
    ----------
    campaigns : benchmarks/identify_cases.py
    with_modes : a run with its modes, of the motion that it has
    seed : of all campaigns
    drawn : of each mode as much is there as its prior says; else nothing
    """
    t_s = campaigns.times(16.0, 40.0)
    still = [campaigns.still_run(x, t_s, "modal") for x in campaigns.POINTS_M[::3]]
    known = unknown = largest = 0.0
    for number in range(CAMPAIGNS):
        rng = np.random.default_rng([seed, number])
        truly = [with_modes(run).lag for run in still]
        size = rng.normal(size=len(truly[0])) * drawn
        moved = [
            replace(r, y_m=r.y_m + size @ lag[:, :, 0], beta_rad=r.beta_rad + size @ lag[:, :, 1])
            for r, lag in zip(still, truly, strict=True)
        ]
        runs = [with_modes(run) for run in campaigns.campaign(moved, rng)]
        fit = fit_runs(runs, "linear")
        largest = max(largest, float(np.abs(fit.modes["camera"]).max()))
        known += _chi_square(fit, campaigns.SIX)
        if drawn:
            unknown += _chi_square(fit_runs([replace(r, lag=r.lag[:0]) for r in runs], "linear"), campaigns.SIX)
    return known, unknown, largest


def _chi_square(fit, truth: np.ndarray) -> float:
    gap = fit.six - truth
    return float(gap @ np.linalg.solve(fit.covariance, gap))
