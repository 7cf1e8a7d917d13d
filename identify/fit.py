"""Joint output-error fit of the six derivatives over any number of runs (theory.md 8; design.md).

Shared: the six derivatives. Per run: start (4), datum biases y_b and beta_b, and T_i, X_T,i where priors let them move.
Shared by all runs where priors let them move: errors of T, L and U. Shared among runs of one camera: its common modes, each
with a unit prior. Weights: each channel's residual scatter and
colour (an autoregression), re-estimated until they stand; the covariance is then widened by what autocorrelation is left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..record.errors import EstimationError
from ..record.priors import DERIVATIVE_NAMES
from ..simulate.model import Array
from .data import RunData
from .noise import Whitener, autocorrelation, measured, stated
from .response import RUN_PARAMETERS, TENSION, TOW_POINT, full_response, linear_response, side_from_y
from .start import start_state, weak_form_start

FORMS = ("linear", "full")
OWN = ("side", "beta", "v", "r", "y_b", "beta_b", "tension", "tow_point")
"""Parameters of each run, in the order of the parameter vector."""
MAX_STEPS = 60
CONVERGED = 1e-8
"""Steps end when no parameter moves by more than this share of its standard deviation squared (in chi-square)."""
REWEIGHTINGS = 4
LAG_SHARE = 0.1
LAG_S = 3.0
"""Left-over autocorrelation is looked for up to this lag: longer ones cannot be told from the fit's own freedom."""
FIXED_SD = 1e-9
"""Prior of a parameter that stands as stated, relative to its size."""


@dataclass(frozen=True)
class Fit:
    """Result of ``fit_runs``.

    Attributes
    ----------
    form : "linear" or "full"
    six, covariance : (6,) and (6, 6), at ``speed_m_s``
    filtered_covariance : (6, 6), had the whitened residuals been white
    speed_m_s : reference speed
    own : (runs, 8), ``OWN``; sides: y m (linear) or alpha rad (full)
    own_sd : (runs, 8)
    common : errors of tension, line_length, speed common to all runs, in their prior's sd: {name: (value, sd)}
    modes : common modes' sizes by camera key, in their standard deviations
    response : per run (n, 2), fitted y_m and beta_rad with biases and common modes
    residual : per run (n, 2), measured minus response
    scale : (runs, 2), residual scatter over the stated sigma, per channel
    innovation : per run (n, 2), the residuals whitened by their own scatter and colour
    orders : (runs, 2), of the autoregressions
    chi2_per_dof : over all runs, by the stated sigmas
    steps : iterations
    converged : bool
    """

    form: str
    six: Array
    covariance: Array
    filtered_covariance: Array
    speed_m_s: float
    own: Array
    own_sd: Array
    common: dict[str, tuple[float, float]]
    modes: dict[str, Array]
    response: list[Array]
    residual: list[Array]
    scale: Array
    innovation: list[Array]
    orders: NDArray[np.int_]
    chi2_per_dof: float
    steps: int
    converged: bool


def fit_runs(
    runs: list[RunData],
    form: str = "full",
    speed_m_s: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Fit the derivatives to ``runs`` jointly.

    Parameters
    ----------
    runs : one or more; runs of one hull share the prime derivatives
    form : "full" (full sine and kinematics) or "linear" (exact matrix exponential); the full fit starts from the linear
    speed_m_s : at which the derivatives are quoted; default: the runs' mean

    Raises
    ------
    EstimationError : no runs, or the fit has no optimum with positive m' and I'
    """
    if not runs:
        raise EstimationError("no run to fit")
    if form not in FORMS:
        raise EstimationError(f"form {form!r}; expected {', '.join(FORMS)}")
    speed = float(np.mean([d.tow.speed_m_s for d in runs])) if speed_m_s is None else speed_m_s
    needs_full = [d.name for d in runs if d.tow.post_amplitude_m or d.tension is not None or d.speed is not None]
    if needs_full and form == "linear":
        raise EstimationError(
            f"run {needs_full[0]!r}: a moving post and histories of tension or speed are known to the full form only"
        )
    # a rough fit without the common modes: they must be known along a smooth path before they may move
    rough = _Problem([replace(d, common=d.common[:0]) for d in runs], "full" if needs_full else "linear", speed)
    weights = [stated(d.covariance, d.t_s) for d in runs]
    theta, steps, converged = _minimise(rough, rough.start(), weights, progress)
    found = rough.evaluate(theta)
    if rough.form != form:
        theta = rough.to_full(theta)
    first_chi2 = np.nan
    problem = rough
    for turn in range(REWEIGHTINGS):
        problem = _Problem([_modes_along(d, p) for d, p in zip(runs, found[0], strict=True)], form, speed)
        theta = np.concatenate([theta, np.zeros(problem.size - len(theta))])  # the modes stand last
        theta, count, converged = _minimise(problem, theta, weights, progress)
        steps += count
        found = problem.evaluate(theta)
        residual = found[1]
        if turn == 0:
            first_chi2 = _chi2_per_dof(residual, weights, len(theta))
        # colour belongs to the right equations: the linear form's own misfit of a large tow must not pass for noise
        before = np.array([w.scale * w.innovation for w in weights])
        weights = [measured(r, w) for r, w in zip(residual, weights, strict=True)]
        after = np.array([w.scale * w.innovation for w in weights])
        if turn > 0 and np.abs(after / before - 1).max() < 0.01:
            break
    return _report(problem, theta, found, weights, first_chi2, steps, converged)


def _modes_along(data: RunData, path: Array) -> RunData:
    """The run with its common modes taken along the fitted ``path (n, 2)`` instead of the noisy measurement.

    A mode is a smooth function of where the model stands: a cubic in (y, beta). Taken at the measured places it would
    hold their noise, and the fit would move it to shrink the residuals (a 0.1 % scale by several of its sds).
    """
    if not len(data.common):
        return data
    centre, spread = path.mean(axis=0), path.std(axis=0) + 1e-12
    seen = _cubic((np.column_stack([data.y_m, data.beta_rad]) - centre) / spread)
    here = _cubic((path - centre) / spread)
    flat = data.common.transpose(1, 0, 2).reshape(len(path), -1)
    values = here @ np.linalg.lstsq(seen, flat, rcond=1e-9)[0]
    return replace(data, common=values.reshape(len(path), len(data.common), 2).transpose(1, 0, 2))


def _cubic(xy: Array) -> Array:
    return np.column_stack([xy[:, 0] ** i * xy[:, 1] ** j for i in range(4) for j in range(4 - i)])


class _Problem:
    """Parameter vector, residuals and sensitivities: [six, own of each run, common errors, modes of each camera]."""

    def __init__(self, runs: list[RunData], form: str, speed: float) -> None:
        self.runs, self.form, self.speed = runs, form, speed
        self.keys = list(dict.fromkeys(d.common_key for d in runs if len(d.common)))
        self.mode_count = {key: next(len(d.common) for d in runs if d.common_key == key) for key in self.keys}
        self.own_end = 6 + len(OWN) * len(runs)
        self.common_sd = _common_sds(runs)
        self.common_at = {name: self.own_end + i for i, name in enumerate(self.common_sd)}
        offset = self.own_end + len(self.common_sd)
        self.size = offset + sum(self.mode_count.values())
        self.mode_at: dict[str, slice] = {}
        for key in self.keys:
            self.mode_at[key] = slice(offset, offset + self.mode_count[key])
            offset += self.mode_count[key]

    def own_at(self, run: int) -> slice:
        return slice(6 + len(OWN) * run, 6 + len(OWN) * (run + 1))

    def start(self) -> Array:
        theta = np.zeros(self.size)
        theta[:6] = weak_form_start(self.runs, self.speed)
        for index, data in enumerate(self.runs):
            y, beta, v, r = start_state(data)
            side = side_from_y(self.form, data, y, beta)
            theta[self.own_at(index)] = [side, beta, v, r, 0, 0, data.tow.tension_n, data.tow.tow_point_m]
        return theta

    def to_full(self, theta: Array) -> Array:
        """Take the linear optimum over to the full form: only the sides are other coordinates."""
        self.form = "full"
        theta = theta.copy()
        for index, data in enumerate(self.runs):
            own = self.own_at(index)
            theta[own.start] = side_from_y("full", data, float(theta[own.start]), float(theta[own.start + 1]))
        return theta

    def run_values(self, theta: Array) -> Array:
        """(runs, 14), ``RUN_PARAMETERS``."""
        own = theta[6 : self.own_end].reshape(len(self.runs), len(OWN))
        stated = np.array([[d.tow.line_length_m, d.tow.speed_m_s] for d in self.runs])
        values = np.column_stack([np.tile(theta[:6], (len(self.runs), 1)), own[:, :4], own[:, 6:], stated])
        for name, at in self.common_at.items():
            values[:, RUN_PARAMETERS.index(name)] += theta[at] * self.common_sd[name]
        return values

    def evaluate(self, theta: Array) -> tuple[list[Array], list[Array], list[Array]]:
        """Response and residual (n, 2) and sensitivity (n, 2, size) of every run."""
        values = self.run_values(theta)
        if self.form == "full":
            answers = full_response(self.runs, values, self.speed)
        else:
            answers = [linear_response(d, v, self.speed) for d, v in zip(self.runs, values, strict=True)]
        responses, residuals, slopes = [], [], []
        for index, (data, (response, sensitivity)) in enumerate(zip(self.runs, answers, strict=True)):
            slope = np.zeros((len(data.t_s), 2, self.size))
            slope[:, :, :6] = sensitivity[:, :, :6]
            own = self.own_at(index)
            slope[:, :, own.start : own.start + 4] = sensitivity[:, :, 6:10]
            slope[:, 0, own.start + 4] = slope[:, 1, own.start + 5] = 1.0
            slope[:, :, own.start + 6 : own.stop] = sensitivity[:, :, TENSION : TOW_POINT + 1]
            for name, at in self.common_at.items():
                slope[:, :, at] = sensitivity[:, :, RUN_PARAMETERS.index(name)] * self.common_sd[name][index]
            total = response + theta[own.start + 4 : own.start + 6]
            if len(data.common):
                at = self.mode_at[data.common_key]
                slope[:, :, at] = data.common.transpose(1, 2, 0)
                total = total + slope[:, :, at] @ theta[at]
            responses.append(total)
            residuals.append(np.column_stack([data.y_m, data.beta_rad]) - total)
            slopes.append(slope)
        return responses, residuals, slopes

    def prior(self, theta: Array) -> tuple[Array, Array]:
        """Prior residuals (stated minus here, over sd) and their rows of sensitivity."""
        gaps, rows = [], []

        def add(index: int, stated: float, sd: float) -> None:
            row = np.zeros(self.size)
            row[index] = 1.0 / sd
            gaps.append((stated - theta[index]) / sd)
            rows.append(row)

        for index, data in enumerate(self.runs):
            own, priors = self.own_at(index).start, data.priors
            assert data.tow.tension_n is not None
            add(own + 6, data.tow.tension_n, max(priors.tension_sd_rel, FIXED_SD) * data.tow.tension_n)
            point_sd = max(priors.tow_point_sd_m, FIXED_SD * max(abs(data.tow.tow_point_m), 1e-3))
            add(own + 7, data.tow.tow_point_m, point_sd)
            for offset, sd in ((4, priors.y_bias_sd_m), (5, priors.beta_bias_sd_rad)):
                if sd is not None:
                    add(own + offset, 0.0, max(sd, FIXED_SD))
        for index, (value, sd) in self._derivative_priors().items():
            add(index, value, sd)
        for at in self.common_at.values():
            add(at, 0.0, 1.0)
        for at in self.mode_at.values():
            for index in range(at.start, at.stop):
                add(index, 0.0, 1.0)
        return np.array(gaps), np.array(rows).reshape(len(gaps), self.size)

    def _derivative_priors(self) -> dict[int, tuple[float, float]]:
        found: dict[int, tuple[float, float]] = {}
        for data in self.runs:
            for index, name in enumerate(DERIVATIVE_NAMES):
                prior = getattr(data.priors.derivatives, name)
                if prior is not None:
                    ratio = 1.0 if index < 2 else self.speed / data.tow.speed_m_s
                    found[index] = (prior.value * ratio, prior.std * ratio)
        return found


def _common_sds(runs: list[RunData]) -> dict[str, Array]:
    """Standard deviation (runs,) of each common error that the first run's priors let move, in the parameter's unit."""
    priors = runs[0].priors
    found = {}
    if priors.tension_common_sd_rel:
        found["tension"] = priors.tension_common_sd_rel * np.array([d.tow.tension_n for d in runs], dtype=float)
    if priors.line_length_sd_m:
        found["line_length"] = np.full(len(runs), priors.line_length_sd_m)
    if priors.speed_sd_rel:
        found["speed"] = priors.speed_sd_rel * np.array([d.tow.speed_m_s for d in runs])
    return found


def _chi2_per_dof(residual: list[Array], weights: list[Whitener], size: int) -> float:
    total = sum(float((w(r) ** 2).sum()) for w, r in zip(weights, residual, strict=True))
    return total / max(sum(r.size for r in residual) - size, 1)


def _normal(problem: _Problem, theta: Array, weights: list[Whitener]) -> tuple[Array, Array, float]:
    """Normal matrix, gradient and chi-square with priors."""
    _, residual, slope = problem.evaluate(theta)
    gap, rows = problem.prior(theta)
    matrix, gradient, cost = rows.T @ rows, rows.T @ gap, float(gap @ gap)
    for w, r, s in zip(weights, residual, slope, strict=True):
        e = w(r).ravel()
        j = w(s).reshape(len(e), -1)
        matrix += j.T @ j
        gradient += j.T @ e
        cost += float(e @ e)
    return matrix, gradient, cost


def _usable(theta: Array) -> bool:
    return bool(theta[0] > 0 and theta[1] > 0 and np.isfinite(theta).all())


def _minimise(
    problem: _Problem, theta: Array, weights: list[Whitener], progress: Callable[[str], None] | None
) -> tuple[Array, int, bool]:
    """Levenberg-Marquardt with Marquardt's scaling and Nielsen's damping."""
    matrix, gradient, cost = _normal(problem, theta, weights)
    if not np.isfinite(cost):
        raise EstimationError(
            "the motion simulated from the weak-form start grows beyond bounds; is the tow stable (X_T > X_v)?"
        )
    damping, growth = 1e-3, 2.0
    for step_number in range(1, MAX_STEPS + 1):
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled = matrix / scale[:, None] / scale[None, :]
        step = np.linalg.solve(scaled + damping * np.eye(len(theta)), gradient / scale) / scale
        expected = float(step @ (2 * gradient - matrix @ step))
        trial = theta + step
        new_cost, answer = np.inf, None
        if _usable(trial):
            with np.errstate(all="ignore"):
                answer = _normal(problem, trial, weights)
            new_cost = answer[2]
        if answer is not None and np.isfinite(new_cost) and new_cost <= cost:
            gain = (cost - new_cost) / max(expected, 1e-300)
            theta, (matrix, gradient, cost) = trial, answer
            damping *= max(1 / 3, 1 - (2 * gain - 1) ** 3)
            damping, growth = max(damping, 1e-12), 2.0
            if progress is not None:
                progress(f"{problem.form}: step {step_number}, chi-square {cost:.6g}")
            if expected < CONVERGED * max(cost, 1.0):
                return theta, step_number, True
        else:
            if expected < CONVERGED * max(cost, 1.0):
                return theta, step_number, True
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                return theta, step_number, False
    return theta, MAX_STEPS, False


def _coloured_meat(slope: Array, correlations: tuple[Array, Array], matrix: Array) -> None:
    """Add to ``matrix`` the information's variance beyond white noise: sum of rho_k (J_t' J_t+k + transposed)."""
    for channel, rho in enumerate(correlations):
        rows = slope[:, channel]
        for lag in range(1, len(rho)):
            if rho[lag] <= 0:  # the initial positive sequence; beyond it the estimates are noise
                break
            cross = rows[:-lag].T @ rows[lag:] * rho[lag]
            matrix += cross + cross.T


def _report(
    problem: _Problem,
    theta: Array,
    found: tuple[list[Array], list[Array], list[Array]],
    weights: list[Whitener],
    chi2_first: float,
    steps: int,
    converged: bool,
) -> Fit:
    """Put the optimum ``theta``, where ``problem.evaluate`` gave ``found``, into a Fit."""
    response, residual, slope = found
    _, rows = problem.prior(theta)
    information = rows.T @ rows
    meat = rows.T @ rows
    innovations = []
    for data, w, r, s in zip(problem.runs, weights, residual, slope, strict=True):
        e, j = w(r), w(s)
        innovations.append(e)
        flat = j.reshape(-1, problem.size)
        information += flat.T @ flat
        meat += flat.T @ flat
        step = float(np.median(np.diff(data.t_s)))
        lags = int(max(1, min(LAG_SHARE * len(e), LAG_S / step)))
        rho = (autocorrelation(e[:, 0], lags), autocorrelation(e[:, 1], lags))
        _coloured_meat(j, rho, meat)
    scaling = np.sqrt(np.diag(information))
    scaling = np.where(scaling > 0, scaling, 1.0)
    inverse = np.linalg.pinv(information / scaling[:, None] / scaling[None, :], rcond=1e-15, hermitian=True)
    inverse = inverse / scaling[:, None] / scaling[None, :]
    covariance = inverse @ meat @ inverse
    count = len(problem.runs)
    own = theta[6 : problem.own_end].reshape(count, len(OWN))
    own_sd = np.sqrt(np.maximum(np.diag(covariance), 0))[6 : problem.own_end].reshape(count, len(OWN))
    return Fit(
        form=problem.form,
        six=theta[:6],
        covariance=covariance[:6, :6],
        filtered_covariance=inverse[:6, :6],
        speed_m_s=problem.speed,
        own=own,
        own_sd=own_sd,
        common={
            name: (float(theta[at]), float(np.sqrt(max(covariance[at, at], 0.0))))
            for name, at in problem.common_at.items()
        },
        modes={key: theta[at] for key, at in problem.mode_at.items()},
        response=response,
        residual=residual,
        scale=np.array([w.scale for w in weights]),
        innovation=innovations,
        orders=np.array([[len(a) for a in w.regression] for w in weights]),
        chi2_per_dof=chi2_first,
        steps=steps,
        converged=converged,
    )


__all__ = ["FORMS", "OWN", "RUN_PARAMETERS", "Fit", "fit_runs"]
