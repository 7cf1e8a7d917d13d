"""Where the base fit begins: derivatives of the linear fit, and the measured motion as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import UnivariateSpline

from ..identify import fit_runs
from ..simulate.model import Array
from .hypothesis import Hypothesis, Path
from .tow_data import TowRun
from .tow_model import BEYOND

SAMPLES = 250
LARGEST_SINE = 0.95


def base_hypothesis(runs: Sequence[TowRun], speed_m_s: float) -> Hypothesis:
    """The linear fit of all runs, along the measured motion."""
    few = []
    for run in runs:
        data = run.data
        thin = slice(None, None, max(1, len(data.t_s) // SAMPLES))
        few.append(
            replace(
                data,
                t_s=data.t_s[thin],
                y_m=data.y_m[thin],
                beta_rad=data.beta_rad[thin],
                covariance=data.covariance[thin],
                common=data.common[:0, thin],
                tension=None,
                speed=None,
            )
        )
    fit = fit_runs(few, "linear", speed_m_s)
    nodes = 2 * (max(len(r.centre_s) for r in runs) + BEYOND) + 1
    states = np.stack([measured_path(run, nodes) for run in runs], axis=-1)
    own = []
    for start, run in zip(states[:, 0].T, runs, strict=True):
        tow = run.data.tow
        own.append([*start, 0.0, 0.0, tow.tension_n, tow.tow_point_m, tow.line_length_m, tow.speed_m_s])
    return Hypothesis(fit.six, np.array(own, dtype=float), path=Path((), states))


def measured_path(run: TowRun, nodes: int) -> Array:
    """(4, nodes) alpha, beta, v, r every half block, from smoothing splines of y and beta; beyond the run its last values."""
    tow = run.data.tow
    good = np.isfinite(run.values[:, :2]).all(axis=1)
    t_s = run.centre_s[good]
    at = np.clip(np.arange(nodes) * run.step_s / 2, 0.0, len(run.centre_s) * run.step_s)
    sds = [np.sqrt(np.diag(run.covariance[k])[good]) for k in (0, 1)]
    y, beta = (UnivariateSpline(t_s, run.values[good, k], 1 / sd, s=len(t_s)) for k, sd in enumerate(sds))
    sine = (y(at) + tow.tow_point_m * np.sin(beta(at)) + tow.tow_point_offset_m * np.cos(beta(at))) / tow.line_length_m
    alpha = np.arcsin(np.clip(sine, -LARGEST_SINE, LARGEST_SINE))
    sway = (y.derivative()(at) - tow.speed_m_s * np.sin(beta(at))) / np.cos(beta(at))
    return np.stack([alpha, beta(at), sway, beta.derivative()(at)])


__all__ = ["base_hypothesis", "measured_path"]
