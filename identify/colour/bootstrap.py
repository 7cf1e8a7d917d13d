"""Intervals by parametric bootstrap: records drawn from the fitted model, fitted again in the same way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..data import RunData
from ..fit import Fit, Near, fit_runs, modes_along
from ..noise import stated
from ..static_records import colours
from ..still import Colour, reweighted
from .innovations import maximise
from .kalman import step_model

SETTLES = 1000
"""Samples that are drawn before a record and thrown away, so that its noise has forgotten its start: a choice."""
COVERED = (2.5, 97.5)
"""Percentiles of a two-sided 95 % interval."""


@dataclass(frozen=True)
class Bootstrap:
    """Result of ``bootstrap``.

    Attributes
    ----------
    six : (draws, 6), estimates of the drawn records
    covariance : (6, 6), of them
    interval : (6, 2), 95 %, basic: the fit's value minus the draws' quantiles about it
    """

    six: Array
    covariance: Array
    interval: Array


def bootstrap(
    fit: Fit,
    runs: list[RunData],
    rng: np.random.Generator,
    draws: int = 100,
    progress: Callable[[str], None] | None = None,
) -> Bootstrap:
    """Draw and refit.

    Parameters
    ----------
    fit : of ``runs``, either method; its noise model is the one drawn from
    runs : as fitted
    rng : that draws
    draws : records drawn; 100 give a standard deviation to 7 %
    progress : is told in a sentence what is done

    Raises
    ------
    EstimationError : fewer than ten of the drawn records can be fitted
    """
    found = []
    known = colours(runs)
    near = Near.of(fit, runs, range(len(runs))) if fit.disturbance is None else None
    for k in range(draws):
        drawn = [drawn_record(fit, d, i, known[i], rng) for i, d in enumerate(runs)]
        try:
            found.append(_refit(fit, drawn, near))
        except EstimationError:
            continue
        if progress is not None:
            progress(f"bootstrap {k + 1} of {draws}")
    if len(found) < 10:
        raise EstimationError(f"{len(found)} of {draws} drawn records could be fitted; ten are needed")
    six = np.array(found)
    low, high = np.percentile(six, COVERED, axis=0)
    return Bootstrap(six, np.cov(six.T), np.column_stack([2 * fit.six - high, 2 * fit.six - low]))


def _refit(fit: Fit, runs: list[RunData], near: Near | None) -> Array:
    """The derivatives of drawn records; their optimum is looked for from that of the fit on, which they were drawn from."""
    if fit.disturbance is None:
        return fit_runs(runs, fit.form, fit.speed_m_s, near=near).six
    d = fit.disturbance
    along = [modes_along(r, p) for r, p in zip(runs, fit.response, strict=True)]
    noise = np.log([d.force_n, d.moment_n_m, d.time_s, *d.scale])
    return maximise(along, fit.form, fit.speed_m_s, fit.theta, noise).theta[:6]


def drawn_record(fit: Fit, data: RunData, index: int, colour: Colour | None, rng: np.random.Generator) -> RunData:
    """Draw a record of the fitted model: its response, the motion by the random forces, and measurement noise.

    Parameters
    ----------
    fit : of the runs
    data, index : one of them, and its place among them
    colour : of the measurement, from static records; None: as the fit's residuals have it
    rng : that draws
    """
    first = stated(data.covariance, data.t_s)
    d = fit.disturbance
    if d is None:
        white = reweighted(fit.residual[index], first, colour)
        noise = np.column_stack([_coloured(white.regression[c], len(data.t_s), rng) for c in range(2)])
        noise *= white.scale * white.innovation
    elif colour is not None and data.still is not None:
        noise = np.column_stack([_coloured(a, len(data.t_s), rng) for a in colour.regression])
        noise *= np.sqrt(colour.share) * data.still.scaled.std(axis=0)
    else:
        noise = rng.normal(size=(len(data.t_s), 2)) * d.scale
    noise = np.linalg.solve(first.matrices, noise[:, :, None])[:, :, 0]
    if d is not None:
        noise = noise + pushed(fit, data, rng)
    path = fit.response[index] + noise
    return replace(data, y_m=path[:, 0], beta_rad=path[:, 1])


def _coloured(regression: Array, count: int, rng: np.random.Generator) -> Array:
    """An autoregression of unit innovations, its beginning forgotten."""
    from scipy.signal import lfilter

    drawn = rng.normal(size=count + SETTLES)
    return np.asarray(lfilter([1.0], np.concatenate([[1.0], -regression]), drawn))[SETTLES:]


def pushed(fit: Fit, data: RunData, rng: np.random.Generator) -> Array:
    """Motion (n, 2) of y and beta that the fitted disturbance makes on top of the mean, from rest at the first sample.

    Parameters
    ----------
    fit : with its noise model
    data : one run
    rng : that draws
    """
    d = fit.disturbance
    assert d is not None
    gaps = np.diff(data.t_s)
    usual = float(np.median(gaps))
    kinds, which = np.unique(np.rint(gaps / (0.01 * usual)).astype(int), return_inverse=True)
    noise = np.log([d.force_n, d.moment_n_m, d.time_s, 1.0, 1.0])
    transition, added = step_model(data, fit.six, noise, fit.speed_m_s, kinds * 0.01 * usual)
    steps, spreads = np.real(transition[:, 0]), np.real(added[:, 0])
    roots = []
    for spread in spreads:
        scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        values, vectors = np.linalg.eigh(spread / scale[:, None] / scale[None, :])
        roots.append(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
    state = np.zeros(6)
    state[4:] = rng.normal(size=2) * [d.force_n, d.moment_n_m]
    kicks = rng.normal(size=(len(gaps), 6))
    path = np.zeros((len(data.t_s), 2))
    for k, kind in enumerate(which):
        state = steps[kind] @ state + roots[kind] @ kicks[k]
        path[k + 1] = state[:2]
    return path
