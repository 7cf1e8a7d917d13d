"""What slow modes of the marks promise: in the motion they do what they tell, and the fit takes out what there is of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd

from towline.geometry import Motion, motion_from_tracks, run_datum
from towline.identify import RunData, fit_runs
from towline.record import Run, read_run, read_tracks

MOTION = ["y_cg_m", "beta_rad", "alpha_rad"]
CAMPAIGNS = 20
"""Of two tows each: chi-square of six derivatives each, 120 +- 15.5 together."""


def exact_tow(samples: Path) -> tuple[Run, pd.DataFrame, Motion]:
    """Eight seconds of a rendered tow's true tracks, and the motion that they give.

    Parameters
    ----------
    samples : sample_videos/
    """
    run = read_run(samples / "mariner" / "x1446")
    tracks = read_tracks(run.folder / "truth" / "tracks.csv")
    tracks = tracks[tracks["frame"] < 200].reset_index(drop=True).assign(sigma_u_px=0.05, sigma_v_px=0.05)
    return run, tracks, motion_from_tracks(run, tracks, run_datum(run, (960, 720)))


def assert_told(run: Run, tracks: pd.DataFrame, made: Motion, modes: np.ndarray, told: np.ndarray) -> None:
    """Marks that are moved as each mode (k, n, m, 2) px says change the motion as it is told (k, n, 3).

    Parameters
    ----------
    run, tracks, made : of ``exact_tow``
    modes, told : as above
    """
    fit = run_datum(run, (960, 720))
    for mode, expected in zip(modes, told, strict=True):
        moved = tracks.copy()
        for k, marker in enumerate(run.file.marker):
            moved.loc[moved["marker"] == marker.name, ["u_px", "v_px"]] += mode[:, k]
        change = motion_from_tracks(run, moved, fit).motion[MOTION].to_numpy() - made.motion[MOTION].to_numpy()
        # the projection's curvature over 0.1 px of 1000, and weights that turn with the rays
        np.testing.assert_allclose(change, expected, atol=5e-3 * np.abs(expected).max() + 1e-12)


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
