"""Joint output-error fit of the six derivatives over any number of runs (theory.md 8; design.md).

Shared: the six derivatives. Per run: start (4), datum biases y_b and beta_b, and T_i, X_T,i where priors let them move.
Shared by all runs where priors let them move: errors of T, L and U. Shared among runs of one camera: its common modes, each
with a unit prior. Weights: each channel's residual scatter and
colour (an autoregression), re-estimated until they stand; the covariance is then widened by what slower noise is left.

Order of work: weak form, linear form on block means, then the wanted form on every sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..record.errors import EstimationError, solvable
from ..simulate.model import Array
from .colour.disturbance import Disturbance
from .data import RunData
from .informed import informed
from .joint.arrow import Inverse, Shares, inverse_of, shares_of, widened
from .joint.begin import knows_full_only, rough_optimum
from .joint.common import SCALE, Common, needs_full
from .joint.guess import Path
from .joint.parameters import RUN_PARAMETERS, TENSION
from .joint.problem import OWN, Answer, Problem
from .joint.solve import Optimum, minimise
from .joint.thin import without_modes
from .noise import Whitener, stated
from .static_records import colours
from .stepping import refuse_stepping, why_not_followed
from .still import Colour, reweighted

FORMS = ("linear", "full")
REWEIGHTINGS = 4
"""Fits with the noise measured anew before each, at most; they end earlier when the scatter has settled."""
SCATTER_CONVERGED = 0.01
"""Reweighting ends when no scatter changes by more than this share."""
NEAR = 1e-7
"""Damping where the fit starts near its optimum."""


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
    own_sd : (runs, 8); 0 where a value stands as stated
    common : errors of tension, line_length, speed common to all runs, in their prior's sd: {name: (value, sd)}; a tension that
        nobody stated: logarithm of its factor to the guess
    beside : numbers of the hull beside the six, at ``speed_m_s``: model along its way, rudder, asymmetry: {name: (value, sd)}
    resistance : (runs, 2), R (or T) of each run as fitted and its standard deviation, N
    tension_n : per run (n,), T from the motion at the samples, of a line that keeps its length; else empty
    modes : common modes' sizes by camera key, in their standard deviations
    response : per run (n, 2), fitted y_m and beta_rad with biases and common modes
    residual : per run (n, 2), measured minus response
    scale : (runs, 2), residual scatter over the stated sigma, per channel
    innovation : per run (n, 2), the residuals whitened by their own scatter and colour
    orders : (runs, 2), of the autoregressions
    chi2_per_dof : over all runs, by the stated sigmas
    steps : iterations
    converged : bool
    theta : the whole parameter vector
    naive_covariance : (6, 6), had the residuals been white with the scatter they have; too small where they are not
    method : "output_error" or "innovations"; the second's ``innovation`` are those of block means, unit variance
    disturbance : what pushes the hull about, of the innovations form
    notes : how the noise was judged
    weights : of the residuals, per run; of the output error
    commons : what all runs share beside the six, as the parameter vector holds it: {name: (what it is, its size in sds)}
    shares : what each run says of the shared parameters
    path : of the full form on the integrator's grid, where another fit to the same records may begin
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
    theta: Array = field(default_factory=lambda: np.zeros(0))
    naive_covariance: Array | None = None
    beside: dict[str, tuple[float, float]] = field(default_factory=dict)
    resistance: Array = field(default_factory=lambda: np.zeros((0, 2)))
    tension_n: list[Array] = field(default_factory=list)
    method: str = "output_error"
    disturbance: Disturbance | None = None
    notes: tuple[str, ...] = ()
    weights: list[Whitener] = field(default_factory=list)
    commons: dict[str, tuple[Common, float]] = field(default_factory=dict)
    shares: Shares | None = None
    path: Path | None = None


@dataclass(frozen=True)
class Near:
    """Where a fit to some of the runs of another fit may begin.

    Attributes
    ----------
    theta : parameter vector
    paths : per run (n, 2), fitted y_m and beta_rad
    path : of the full form on the integrator's grid; None: not known
    """

    theta: Array
    paths: tuple[Array, ...]
    path: Path | None = None

    @classmethod
    def of(cls, fit: Fit, runs: list[RunData], chosen: Sequence[int]) -> Near:
        """At the optimum of ``fit``, of whose ``runs`` some are chosen."""
        problem = Problem([runs[k] for k in chosen], fit.form, fit.speed_m_s)
        theta = np.zeros(problem.size)
        theta[:6] = fit.six
        theta[6 : problem.own_end] = fit.own[list(chosen)].ravel()
        _share(fit, problem, theta)
        path = None if fit.path is None else fit.path.of(chosen)
        return cls(theta, tuple(fit.response[k] for k in chosen), path)


@solvable(EstimationError)
def fit_runs(
    runs: list[RunData],
    form: str = "full",
    speed_m_s: float | None = None,
    progress: Callable[[str], None] | None = None,
    start: Array | None = None,
    extra: tuple[tuple[int, float, float], ...] = (),
    hold: tuple[int, ...] = (),
    near: Near | None = None,
) -> Fit:
    """Fit the derivatives to ``runs`` jointly.

    Parameters
    ----------
    runs : one or more; runs of one hull share the prime derivatives
    form : "full" (full sine and kinematics) or "linear" (exact matrix exponential); the full fit starts from the linear
    speed_m_s : at which the derivatives are quoted; default: the runs' mean
    progress : is told in a sentence what is done
    start : (6,) derivatives to start from; default: the weak form's, no guess is needed
    extra : knowledge of derivatives beside the priors: (index, value, sd), at ``speed_m_s``
    hold : indices of derivatives that keep the value of ``start``
    near : the answer of a fit to these runs and others: the search begins there, at once with every sample

    Raises
    ------
    EstimationError : no runs, or the fit has no optimum with positive m' and I'
    """
    speed = check_runs(runs, form, speed_m_s)
    try:
        return _fitted(runs, form, speed, progress, start, extra, hold, near)
    except EstimationError as error:
        raise why_not_followed(runs, error) from error


def _fitted(
    runs: list[RunData],
    form: str,
    speed: float,
    progress: Callable[[str], None] | None,
    start: Array | None,
    extra: tuple[tuple[int, float, float], ...],
    hold: tuple[int, ...],
    near: Near | None,
) -> Fit:
    weights = [stated(d.covariance, d.t_s) for d in runs]
    paths = None
    if near is not None:
        theta, steps, path = near.theta, 0, near.path
        paths = list(near.paths) if any(d.shared for d in runs) else None
    else:
        begin = rough_optimum(runs, speed, form, progress, start, extra, hold)
        theta, steps, path = begin.theta, begin.steps, begin.path

        def plain() -> Problem:
            return Problem([without_modes(d) for d in runs], form, speed, hold, extra, path=path)

        refuse_stepping(runs, lambda: plain().residuals(begin.theta))
        if any(d.shared for d in runs):
            # the common modes must be known along a smooth path before they may move
            problem = plain()
            optimum = minimise(problem, theta, weights, progress, damping=NEAR)
            theta, steps, path = optimum.theta, steps + optimum.steps, problem.path
            paths = [a.response.T for a in optimum.answers]
    first_chi2 = np.nan
    known = colours(runs)
    problem = Problem(runs, form, speed, hold, extra, path=path)
    optimum, answers = None, None
    for turn in range(REWEIGHTINGS):
        if paths is not None:
            along = [modes_along(d, p) for d, p in zip(runs, paths, strict=True)]
            problem, answers = Problem(along, form, speed, hold, extra, path=problem.path), None
        theta = np.concatenate([theta, np.zeros(problem.size - len(theta))])  # the modes stand last
        optimum = minimise(problem, theta, weights, progress, answers, NEAR)
        theta, answers, steps = optimum.theta, optimum.answers, steps + optimum.steps
        if paths is not None:
            paths = [a.response.T for a in answers]
        if turn == 0:
            first_chi2 = _chi2_per_dof(answers, weights, int(problem.free.sum()))
        # colour belongs to the right equations: the linear form's own misfit of a large tow must not pass for noise
        before = np.array([w.scale * w.innovation for w in weights])
        weights = [reweighted(a.residual.T, w, c) for a, w, c in zip(answers, weights, known, strict=True)]
        after = np.array([w.scale * w.innovation for w in weights])
        if turn > 0 and np.abs(after / before - 1).max() < SCATTER_CONVERGED:
            break
    assert optimum is not None
    return _report(problem, optimum, weights, known, first_chi2, steps)


def _share(fit: Fit, problem: Problem, theta: Array) -> None:
    """Put what the fit found of shared parameters into a parameter vector of ``problem``."""
    for common in problem.commons:
        if common.name in fit.commons and common.sd[0]:
            was, size = fit.commons[common.name]
            theta[problem.common_at[common.name]] = (was.base[0] + size * was.sd[0] - common.base[0]) / common.sd[0]
    for key, at in problem.mode_at.items():
        if key in fit.modes:
            theta[at] = fit.modes[key]


def continued(fit: Fit, runs: list[RunData]) -> Fit:
    """The same fit of the same records with other knowledge beside them (tensions, priors), from where it ended.

    Parameters
    ----------
    fit : output error
    runs : those of the fit, the same samples; line, tension, gauge or priors may differ

    Raises
    ------
    EstimationError : no optimum near the fit's
    """
    runs = [modes_along(d, r) for d, r in zip(runs, fit.response, strict=True)]
    problem = Problem(runs, fit.form, fit.speed_m_s, path=fit.path)
    theta = np.zeros(problem.size)
    theta[: problem.own_end] = fit.theta[: problem.own_end]
    _share(fit, problem, theta)
    optimum = minimise(problem, theta, fit.weights, damping=NEAR)
    return _report(problem, optimum, fit.weights, colours(runs), fit.chi2_per_dof, fit.steps + optimum.steps)


def check_runs(runs: list[RunData], form: str, speed_m_s: float | None) -> float:
    """The reference speed; EstimationError where the runs or the form cannot be fitted.

    Parameters
    ----------
    runs : the runs, in their order
    form : "full" or "linear"
    speed_m_s : asked for, or None
    """
    if not runs:
        raise EstimationError("no run to fit")
    if form not in FORMS:
        raise EstimationError(f"form {form!r}; expected {', '.join(FORMS)}")
    needs_full = [d.name for d in runs if knows_full_only(d)]
    if needs_full and form == "linear":
        raise EstimationError(
            f"run {needs_full[0]!r}: a moving post and histories of tension, speed or rudder are known to the full form only"
        )
    lines = {d.tow.line: d.name for d in runs}
    if len(lines) > 1:
        said = ", ".join(f"{name!r} line = {line!r}" for line, name in lines.items())
        raise EstimationError(
            f"tow.line: {said}; the runs of one fit share one equation of motion (or choose it with --line)"
        )
    return float(np.mean([d.tow.speed_m_s for d in runs])) if speed_m_s is None else speed_m_s


def modes_along(data: RunData, path: Array) -> RunData:
    """The run with its common modes taken along the fitted ``path (n, 2)`` instead of the noisy measurement.

    A mode is a smooth function of where the model stands: a cubic in (y, beta). Taken at the measured places it would
    hold their noise, and the fit would move it to shrink the residuals (a 0.1 % scale by several of its sds). What is no
    function of the place stays: where one of three marks is hidden the modes jump. Lags go by the time and stay whole.

    Parameters
    ----------
    data : one run
    path : (n, 2) fitted y and beta
    """
    if not len(data.common):
        return data
    centre, spread = path.mean(axis=0), path.std(axis=0) + 1e-12
    seen = _cubic((np.column_stack([data.y_m, data.beta_rad]) - centre) / spread)
    here = _cubic((path - centre) / spread)
    flat = data.common.transpose(1, 0, 2).reshape(len(path), -1)
    values = flat + (here - seen) @ np.linalg.lstsq(seen, flat, rcond=1e-9)[0]
    return replace(data, common=values.reshape(len(path), len(data.common), 2).transpose(1, 0, 2))


def _cubic(xy: Array) -> Array:
    return np.column_stack([xy[:, 0] ** i * xy[:, 1] ** j for i in range(4) for j in range(4 - i)])


def _chi2_per_dof(answers: list[Answer], weights: list[Whitener], size: int) -> float:
    total = sum(float((w.along(a.residual) ** 2).sum()) for w, a in zip(weights, answers, strict=True))
    return total / max(sum(a.residual.size for a in answers) - size, 1)


def _report(
    problem: Problem,
    optimum: Optimum,
    weights: list[Whitener],
    known: list[Colour | None],
    chi2_first: float,
    steps: int,
) -> Fit:
    """Put the optimum into a Fit."""
    theta = optimum.theta
    found = informed(problem, theta, optimum.answers, weights, known)
    inverse = found.inverse
    covariance, variance = widened(inverse, [(a.columns, m) for a, m in zip(optimum.answers, found.meat, strict=True)])
    sd = np.sqrt(np.maximum(variance, 0.0))
    count = len(problem.runs)
    return Fit(
        form=problem.form,
        six=theta[:6],
        covariance=covariance[:6, :6],
        filtered_covariance=inverse.shared[:6, :6],
        speed_m_s=problem.speed,
        own=theta[6 : problem.own_end].reshape(count, len(OWN)),
        own_sd=sd[6 : problem.own_end].reshape(count, len(OWN)),
        common=common_errors(problem, theta, sd),
        beside=beside_of(problem, theta, sd),
        resistance=_resistance(problem, theta, inverse, variance),
        tension_n=[a.tension_n for a in optimum.answers if a.tension_n is not None],
        modes={key: theta[at] for key, at in problem.mode_at.items()},
        response=[a.response.T for a in optimum.answers],
        residual=[a.residual.T for a in optimum.answers],
        scale=np.array([w.scale for w in weights]),
        innovation=[run.error.T for run in found.white],
        orders=np.array([[len(a) for a in w.regression] for w in weights]),
        chi2_per_dof=chi2_first,
        steps=steps,
        converged=optimum.converged,
        theta=theta,
        weights=weights,
        commons={
            c.name: (c, float(theta[at])) for c, at in zip(problem.commons, problem.common_at.values(), strict=True)
        },
        naive_covariance=inverse_of(found.plain, problem.free).shared[:6, :6],
        shares=shares_of(found.prior, found.pull, inverse, problem.free, list(found.parts)),
        path=problem.path,
    )


def _resistance(problem: Problem, theta: Array, inverse: Inverse, variance: Array) -> Array:
    """``Fit.resistance``: a run's own tension times the factor common to all, with what the fit says of both together."""
    found = np.zeros((len(problem.runs), 2))
    values = problem.run_values(theta)
    scale = next((c for c in problem.commons if c.name == SCALE), None)
    for run in range(len(problem.runs)):
        own = problem.own_at(run) + OWN.index("tension")
        tension = values[run, TENSION]
        slopes = {own: tension / theta[own]}
        if scale is not None:
            slopes[problem.common_at[SCALE]] = scale.slope(values)[run]
        at = np.array([k for k in slopes if problem.free[k]], dtype=int)
        found[run, 0] = tension
        if len(at):
            here, row = inverse.of(at), np.array([slopes[int(k)] for k in at])
            wider = np.sqrt(np.maximum(variance[at] / np.maximum(np.diag(here), 1e-300), 1.0))
            found[run, 1] = np.sqrt(max(float((row * wider) @ here @ (row * wider)), 0.0))
    return found


def common_errors(problem: Problem, theta: Array, sd: Array) -> dict[str, tuple[float, float]]:
    """``Fit.common``.

    Parameters
    ----------
    problem : runs and what is free
    theta : parameter vector of ``problem``
    sd : standard deviations of ``theta``
    """
    at = problem.common_at
    return {
        c.name: (float(theta[at[c.name]]), float(sd[at[c.name]])) for c in problem.commons if not needs_full(c.name)
    }


def beside_of(problem: Problem, theta: Array, sd: Array) -> dict[str, tuple[float, float]]:
    """``Fit.beside``; nothing of it is known to the linear form.

    Parameters
    ----------
    problem : runs and what is free
    theta : parameter vector of ``problem``
    sd : standard deviations of ``theta``
    """
    if problem.form == "linear":
        return {}
    found = {}
    for c in problem.commons:
        if needs_full(c.name):
            at = problem.common_at[c.name]
            found[c.name] = (float(c.base[0] + theta[at] * c.sd[0]), float(sd[at] * c.sd[0]))
    return found


__all__ = ["FORMS", "OWN", "RUN_PARAMETERS", "Fit", "Near", "fit_runs"]
