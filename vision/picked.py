"""Points that a person digitised in a few frames: what lies between them, only where asked, and marked as predicted.

A cubic spline through the digitised places. It is linear in them, so their own sigma passes through it exactly; what the spline
misses of the motion is read by leaving each place out in turn.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..record.errors import EstimationError
from ..record.tables import seen_rows

LEAST_POINTS = 5
"""Fewer points do not carry a path between them: a choice, one more than a cubic's four coefficients."""
SMOOTHER = 4.0
"""Leaving a place out doubles the gap; the error of a cubic spline grows by at least this factor with it (16 for a smooth path)."""


def interpolated(tracks: pd.DataFrame, rate_hz: float, largest_gap_s: float) -> pd.DataFrame:
    """Rows at ``rate_hz`` between digitised points.

    Parameters
    ----------
    tracks : as ``record.read_tracks`` gives; digitised rows are ``measured``
    rate_hz : of the rows to add; frames are counted on at this rate from each marker's first row
    largest_gap_s : wider gaps stay empty: their rows are ``lost``

    Returns
    -------
    tracks : the rows given, unchanged, and new ones with status ``predicted`` (sigma: the points' own through the spline,
        and what the spline misses) or ``lost``, by time

    Raises
    ------
    EstimationError : rate or gap not positive, or fewer than 5 digitised points of a marker
    """
    if not (rate_hz > 0 and largest_gap_s > 0):
        raise EstimationError(f"rate_hz = {rate_hz:g}, largest_gap_s = {largest_gap_s:g}; both must be positive")
    parts = [tracks]
    for name, rows in tracks.groupby("marker", sort=False):
        good = rows[seen_rows(rows)]
        if len(good) < LEAST_POINTS:
            raise EstimationError(f"marker {name!r}: {len(good)} digitised points, at least {LEAST_POINTS} are needed")
        parts.append(_between(str(name), good, rate_hz, largest_gap_s))
    return pd.concat(parts, ignore_index=True).sort_values(["t_s", "marker"], kind="stable").reset_index(drop=True)


def _between(name: str, good: pd.DataFrame, rate_hz: float, largest_gap_s: float) -> pd.DataFrame:
    """New rows of one marker."""
    t_s = good["t_s"].to_numpy(dtype=float)
    count = int(np.floor((t_s[-1] - t_s[0]) * rate_hz + 1e-9))
    steps = np.arange(count + 1)
    new_s = t_s[0] + steps / rate_hz
    apart = np.abs(new_s[:, None] - t_s[None, :]).min(axis=1)
    keep = apart > 0.5 / rate_hz
    new_s, frames = new_s[keep], good["frame"].iloc[0] + steps[keep]
    gap_s = np.diff(t_s)[np.clip(np.searchsorted(t_s, new_s) - 1, 0, len(t_s) - 2)]
    known = gap_s <= largest_gap_s
    weight = _spline(t_s, new_s)
    rows = {"frame": frames, "t_s": new_s, "marker": name}
    for place, sigma in (("u_px", "sigma_u_px"), ("v_px", "sigma_v_px")):
        value, spread = _predicted(t_s, good[place].to_numpy(dtype=float), good[sigma].to_numpy(dtype=float), weight)
        rows[place], rows[sigma] = np.where(known, value, np.nan), np.where(known, spread, np.nan)
    rows["status"] = np.where(known, "predicted", "lost")
    return pd.DataFrame(rows)


def _spline(t_s: NDArray[np.float64], at_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights ``(m, n)`` of the places at ``t_s`` in the spline's value at ``at_s``."""
    from scipy.interpolate import make_interp_spline

    return np.asarray(make_interp_spline(t_s, np.eye(len(t_s)), k=3)(at_s))


def _predicted(t_s, value, sigma, weight) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values and standard deviations at the new times; a missing sigma is read from what leaving points out shows."""
    inner = np.arange(1, len(t_s) - 1)
    gap, gain = np.empty(len(inner)), np.empty(len(inner))
    for row, left_out in enumerate(inner):
        others = np.delete(np.arange(len(t_s)), left_out)
        each = _spline(t_s[others], t_s[left_out : left_out + 1])[0]
        gap[row] = value[left_out] - each @ value[others]
        gain[row] = 1 + (each**2).sum()
    stated = np.isfinite(sigma).all()
    noise = sigma**2 if stated else np.full(len(t_s), np.mean(gap**2 / gain))
    missed = max(0.0, float(np.mean(gap**2) - np.mean(gain) * noise.mean())) / SMOOTHER**2
    return weight @ value, np.sqrt((weight**2) @ noise + missed)
