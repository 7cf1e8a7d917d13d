"""Records prepared for drawing: gaps kept open, residuals of the fit, their autocorrelation. No pictures here."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
GAP_STEPS = 2.5  # a time step longer than this many usual steps is a gap
MAX_GRID_RATIO = 20  # residuals on a grid with more holes than this are taken one after another


def column(table: pd.DataFrame | None, name: str, rows: int | None = None) -> Array:
    """A column as floats; NaN where the table or the column is absent, ``(rows,)`` then.

    Parameters
    ----------
    table : a table, or None
    name : of the column
    rows : length where there is no table
    """
    if table is not None and name in table:
        return np.asarray(pd.to_numeric(table[name], errors="coerce"), dtype=float)
    return np.full(len(table) if table is not None else rows or 0, np.nan)


def status_is(table: pd.DataFrame, status: str) -> Mask:
    """Rows of that status, ``(n,)``; none where the table has no status.

    Parameters
    ----------
    table : a table, or None
    status : that is asked for
    """
    if "status" not in table:
        return np.zeros(len(table), dtype=bool)
    return (table["status"] == status).to_numpy(dtype=bool)


def measured_rows(motion: pd.DataFrame) -> Mask:
    """Rows of a motion table that were measured: a finite pose that is neither predicted nor lost, ``(n,)``."""
    finite = np.isfinite(column(motion, "y_cg_m")) & np.isfinite(column(motion, "beta_rad"))
    return finite & ~status_is(motion, "lost") & ~status_is(motion, "predicted")


def usual_step(t_s: Array) -> float:
    """The median time step, s; 0 for fewer than two times."""
    return float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0


def spans(mask: Mask) -> list[slice]:
    """The runs of True in ``mask`` as slices."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def pieces(t_s: Array, good: Mask) -> list[slice]:
    """Slices that may be joined by a line: consecutive good samples without a hole in time between them.

    Parameters
    ----------
    t_s : (n,) times, s
    good : (n,) of bool
    """
    jumps = np.flatnonzero(np.diff(t_s) > GAP_STEPS * usual_step(t_s)) + 1
    parts: list[slice] = []
    for span in spans(good):
        cuts = [span.start, *(int(j) for j in jumps if span.start < j < span.stop), span.stop]
        parts += [slice(a, b) for a, b in pairwise(cuts)]
    return parts


def with_gaps(t_s: Array, values: Array, good: Mask | None = None) -> tuple[Array, Array]:
    """Times and values with a NaN between the pieces, so that no line bridges what was not measured.

    Parameters
    ----------
    t_s, values : (n,)
    good : (n,) samples that count; those with finite values when absent

    Returns
    -------
    t, x : (k,), the good samples in order, NaN in x between two pieces
    """
    finite = np.isfinite(values)
    parts = pieces(t_s, finite if good is None else good & finite)
    times: list[Array] = []
    levels: list[Array] = []
    for part in parts:
        if times:
            times.append(np.array([t_s[part.start]]))
            levels.append(np.array([np.nan]))
        times.append(t_s[part])
        levels.append(values[part])
    if not times:
        return np.empty(0), np.empty(0)
    return np.concatenate(times), np.concatenate(levels)


def lost_spans(t_s: Array, good: Mask) -> list[tuple[float, float]]:
    """Time spans without a measurement, s: samples that are not good and holes in time, each widened by half a step.

    Parameters
    ----------
    t_s : (n,) times, s
    good : (n,) of bool
    """
    half = usual_step(t_s) / 2
    found = [(float(t_s[s.start]) - half, float(t_s[s.stop - 1]) + half) for s in spans(~good)]
    jumps = np.flatnonzero(np.diff(t_s) > GAP_STEPS * 2 * half)
    found += [(float(t_s[j]) + half, float(t_s[j + 1]) - half) for j in jumps]
    merged: list[tuple[float, float]] = []
    for start, stop in sorted(found):
        if merged and start <= merged[-1][1] + 1e-9:
            merged[-1] = (merged[-1][0], max(stop, merged[-1][1]))
        else:
            merged.append((start, stop))
    return merged


@dataclass(frozen=True)
class Residuals:
    """Measured minus fitted, ``(n,)`` each, NaN where there is none.

    Attributes
    ----------
    t_s : times
    y_m, beta_rad : residuals
    sigma_y_m, sigma_beta_rad : stated measurement noise; the residual's own root mean square where none is stated
    stated : whether the sigmas are the measurement's own
    """

    t_s: Array
    y_m: Array
    beta_rad: Array
    sigma_y_m: Array
    sigma_beta_rad: Array
    stated: bool

    @property
    def samples(self) -> int:
        """Samples that have a residual."""
        return int(np.isfinite(self.y_m).sum())


def residuals(motion: pd.DataFrame, fitted: pd.DataFrame | None) -> Residuals | None:
    """Measured minus fitted at the measured times; None where they share no sample.

    Parameters
    ----------
    motion : motion table
    fitted : the fit's motion, or None
    """
    if fitted is None or not len(fitted) or not len(motion):
        return None
    t_s = column(motion, "t_s")
    good = measured_rows(motion)
    fit_t = column(fitted, "t_s")
    nearest = np.clip(np.searchsorted(fit_t, t_s), 1, max(1, len(fit_t) - 1))
    nearest = np.where(
        t_s - fit_t[nearest - 1] <= fit_t[np.minimum(nearest, len(fit_t) - 1)] - t_s, nearest - 1, nearest
    )
    nearest = np.minimum(nearest, len(fit_t) - 1)
    shared = good & (np.abs(fit_t[nearest] - t_s) <= 1e-3 * usual_step(t_s) + 1e-9)
    y = np.where(shared, column(motion, "y_cg_m") - column(fitted, "y_cg_m")[nearest], np.nan)
    beta = np.where(shared, column(motion, "beta_rad") - column(fitted, "beta_rad")[nearest], np.nan)
    if not np.isfinite(y).any() or not np.isfinite(beta).any():
        return None
    sigma_y, sigma_beta = column(motion, "sigma_y_cg_m"), column(motion, "sigma_beta_rad")
    stated = bool(np.isfinite(sigma_y[shared]).any() and np.isfinite(sigma_beta[shared]).any())
    if not stated:
        sigma_y, sigma_beta = np.full_like(y, rms(y)), np.full_like(beta, rms(beta))
    return Residuals(t_s, y, beta, sigma_y, sigma_beta, stated)


def rms(values: Array) -> float:
    """Root mean square of the finite values; 0 without any."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else 0.0


def outside(values: Array, sigma: Array, times: float = 2.0) -> float:
    """Share of the finite values beyond ``times`` sigma, 0..1 (normal noise at 2 sigma: 0.046).

    Parameters
    ----------
    values : (n,)
    sigma : (n,) standard deviations
    times : how many of them
    """
    known = np.isfinite(values) & np.isfinite(sigma)
    return float(np.mean(np.abs(values[known]) > times * sigma[known])) if known.any() else 0.0


def autocorrelation(t_s: Array, values: Array, lags: int) -> tuple[Array, float]:
    """Autocorrelation at lags 0..lags and the 95 % bound of white noise, 1.96/sqrt(n).

    Lost samples stay holes on the grid of the usual time step: only pairs that were both measured count.

    Parameters
    ----------
    t_s, values : (n,), NaN where lost
    lags : how many

    Returns
    -------
    rho : (lags + 1,), NaN where no pair is that far apart
    bound : of |rho| for white noise
    """
    grid, _ = _on_grid(t_s, values)
    if not len(grid):
        return np.full(lags + 1, np.nan), np.nan
    known = int(np.isfinite(grid).sum())
    power = np.nanmean(grid**2)
    rho = np.full(lags + 1, np.nan)
    for lag in range(min(lags, len(grid) - 1) + 1):
        products = grid[: len(grid) - lag] * grid[lag:]
        if np.isfinite(products).any() and power > 0:
            rho[lag] = np.nanmean(products) / power
    return rho, 1.96 / np.sqrt(known)


def _on_grid(t_s: Array, values: Array) -> tuple[Array, float]:
    """Finite values about their mean on the grid of the usual time step, holes NaN, and the step in s; empty for fewer than two."""
    known = np.isfinite(values)
    times, x = t_s[known], values[known]
    if len(x) < 2:
        return np.empty(0), 0.0
    step = usual_step(times)
    place = np.round((times - times[0]) / step).astype(int) if step > 0 else np.arange(len(x))
    if place[-1] > MAX_GRID_RATIO * len(x) or len(np.unique(place)) < len(place):
        place = np.arange(len(x))
    grid = np.full(place[-1] + 1, np.nan)
    grid[place] = x - x.mean()
    return grid, step


def spectrum(t_s: Array, values: Array, points: int = 40) -> tuple[Array, Array, float]:
    """One-sided spectral density, averaged over ``points`` stretches of equal width in log frequency.

    Parameters
    ----------
    t_s, values : (n,), NaN where lost; lost samples count as the mean, and the density is scaled to those that are there
    points : frequencies to give

    Returns
    -------
    frequency_hz : (k,) mean frequency of each stretch that holds any
    density : (k,) unit of the values squared per Hz; its integral is their variance
    level : of white noise of the same variance, 2 variance/rate
    """
    grid, step = _on_grid(t_s, values)
    known = int(np.isfinite(grid).sum())
    if known < 8 or step <= 0:
        return np.empty(0), np.empty(0), np.nan
    power = 2 * step / known * np.abs(np.fft.rfft(np.nan_to_num(grid))) ** 2
    frequency = np.fft.rfftfreq(len(grid), step)
    last = len(frequency) - (len(grid) % 2 == 0)  # the highest of an even record counts once, not twice
    power, frequency = power[1:last], frequency[1:last]
    edges = np.geomspace(frequency[0], frequency[-1], points + 1)
    stretch = np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, points - 1)
    count = np.bincount(stretch, minlength=points)
    held = count > 0
    means = [np.bincount(stretch, weights=part, minlength=points)[held] / count[held] for part in (frequency, power)]
    return means[0], means[1], 2 * step * float(np.nanmean(grid**2))


def cross_correlation(values: Array, force: Array, lags: NDArray[np.int_]) -> tuple[Array, float]:
    """Correlation of ``values[k]`` with ``force[k - lag]``, (len(lags),), and the 95 % bound were they independent.

    The bound takes the values as white: 1.96/sqrt(n), whatever the colour of the force (Bartlett).

    Parameters
    ----------
    values : (n,)
    force : (n,) what the line pulls, N
    lags : (k,) in samples
    """
    x, u = values - values.mean(), force - force.mean()
    size = float(np.sqrt((x @ x) * (u @ u)))
    n = len(x)
    if n < 2 or size == 0:
        return np.full(len(lags), np.nan), np.nan
    found = [float(x[lag:] @ u[: n - lag]) if lag >= 0 else float(x[:lag] @ u[-lag:]) for lag in lags if abs(lag) < n]
    whole = np.full(len(lags), np.nan)
    whole[np.abs(lags) < n] = np.array(found) / size
    return whole, 1.96 / np.sqrt(n)
