"""Records that leave their path at once, which no hull does: recordings joined, or marks taken for one another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..record.errors import EstimationError
from ..simulate.model import Array
from .data import RunData

STEP_SD, AROUND = 10.0, 5
"""Neighbours stand a step apart that is so many of their standard deviations, and keeps for so many samples on both sides."""
USUAL_SD = 5.0
"""Nor is it one of the record's own fluctuations: so many of their standard deviations, read robustly (6e-7 a sample)."""
CLEAR = 0.5
"""And the two sides lie apart by at least this share of the step: one sample that is off makes no step. A choice."""
LOST = 2.0
"""Where samples about a place take longer than so many times the usual, too many are lost for their slope to bridge the gap."""
FOLLOWED = 0.5
"""A stepping record is still one tow's where what is left of it is less than this share of the step, in standard deviations."""


@dataclass(frozen=True)
class Step:
    """Where a record leaves its path at once.

    Attributes
    ----------
    t_s : of the largest step
    y_m, beta_rad : its size
    size_sd : the larger of the two in standard deviations
    count : of all such places
    """

    t_s: float
    y_m: float
    beta_rad: float
    size_sd: float
    count: int


def step_of(data: RunData) -> Step | None:
    """The largest step of a record; None: there is none, or too few samples to tell."""
    n, usual = len(data.t_s), np.median(_sd(data), axis=1)
    t, z = data.t_s, np.stack([data.y_m, data.beta_rad]) / usual[:, None]
    between, apart = np.diff(z), np.diff(t)
    if n < 4 * AROUND or not np.ptp(between, axis=1).max() > STEP_SD:
        return None
    slope = np.median(np.lib.stride_tricks.sliding_window_view(between / apart, 2 * AROUND + 1, axis=1), axis=2)
    at = np.arange(AROUND, AROUND + slope.shape[1])  # the step is from sample ``at`` to the next
    after = np.array([z[:, at + 1 + k] - (t[at + 1 + k] - t[at]) * slope for k in range(AROUND)])
    before = np.array([z[:, at - k] + (t[at] - t[at - k]) * slope for k in range(AROUND)])
    apart_by = np.maximum(after.min(axis=0) - before.max(axis=0), before.min(axis=0) - after.max(axis=0))
    whole = t[at + AROUND] - t[at - AROUND + 1] <= LOST * (2 * AROUND - 1) * np.median(apart)
    size = np.where(whole, np.median(after, axis=0) - np.median(before, axis=0), 0.0)
    once = np.where(whole, between[:, at] - apart[at] * slope, 0.0)
    clear = apart_by > CLEAR * np.abs(size)  # every sample of one side lies beyond every one of the other
    found = (_standing_out(size) & _standing_out(once) & clear).any(axis=0)
    if not found.any():
        return None
    largest = int(np.argmax(np.where(found, np.abs(size).max(axis=0), 0.0)))
    step = size[:, largest]
    y_m, beta_rad = (float(s) for s in step * usual)
    return Step(float(data.t_s[at[largest] + 1]), y_m, beta_rad, float(np.abs(step).max()), int(found.sum()))


def refuse_stepping(runs: list[RunData], left: Callable[[], list[Array]]) -> None:
    """Raise for a record that steps and that the motion does not follow.

    Parameters
    ----------
    runs : the runs, in their order
    left : gives the residuals (2, n) of every run; asked for only where a record steps. A knocked camera leaves half of its
        step, two tows in one record all of it

    Raises
    ------
    EstimationError : names the run, the step and its time
    """
    found = [step_of(d) for d in runs]
    if not any(found):
        return
    for data, step, residual in zip(runs, found, left(), strict=True):
        if step is not None and not np.sqrt(np.mean((residual / _sd(data)) ** 2)) < FOLLOWED * step.size_sd:
            raise _error(data, step)


def why_not_followed(runs: list[RunData], error: EstimationError) -> EstimationError:
    """What a record that no motion follows may be: one that steps; else ``error``.

    Parameters
    ----------
    runs : the runs, in their order
    error : why the fit failed
    """
    return next((_error(d, step) for d in runs if (step := step_of(d)) is not None), error)


def _standing_out(z: Array) -> NDArray[np.bool_]:
    """What is far larger than stated noise, and than what the record itself shows nearly everywhere: sigmas may be understated."""
    from scipy.stats import median_abs_deviation  # half a second

    usual = median_abs_deviation(z, axis=1, scale="normal")[:, None]  # pyright: ignore[reportArgumentType]
    return np.abs(z) > np.maximum(STEP_SD, USUAL_SD * usual)


def _sd(data: RunData) -> Array:
    """(2, n), of y and beta."""
    return np.sqrt(np.einsum("nii->in", data.covariance))


def _error(data: RunData, step: Step) -> EstimationError:
    many = f", and at {step.count - 1} more places" if step.count > 1 else ""
    return EstimationError(
        f"run {data.name!r}: y_CG steps by {1000 * step.y_m:+.1f} mm and the heading by {np.degrees(step.beta_rad):+.2f} "
        f"deg at t = {step.t_s:.2f} s{many}: no hull moves so. Were recordings joined there, or marks taken for one "
        "another? [source] span_s takes one part"
    )


__all__ = ["Step", "refuse_stepping", "step_of", "why_not_followed"]
