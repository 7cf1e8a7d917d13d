"""Rudder derivatives from free runs (zigzag, turn): output-error fit of the free ship, on the simulator's own equations (5.14).

A free run knows ratios only: forces per m', moments per I'. m' and I' (and, if wanted, the four linear derivatives) come from
tows, with their covariance; what a free run says beyond is Y_delta and N_delta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...record.errors import EstimationError, solvable
from ...record.results import Measured
from ...simulate.model import DERIVATIVE_UNITS, Array, Hull, Tow, free_rates
from .common import SixEstimate, check_series
from .output_error import SIGMA, OutputError, output_error

COMPLEX_STEP = 1e-30
RUDDER = ("y_delta", "n_delta", "y_bias_n", "n_bias_n_m")
OWN = ("y", "beta", "v", "r")
LARGEST_STEP_S = 0.2
"""Of the classical Runge-Kutta scheme; longer sampling steps are divided."""


@dataclass(frozen=True)
class FreeRecord:
    """A free run.

    Attributes
    ----------
    t_s, y_m, beta_rad : (n,), evenly sampled; y_CG in axes that move with U along the first course
    rudder_t_s, rudder_rad : (k,), history of delta, positive to port, linear between its points
    speed_m_s : U, taken as constant through the run
    """

    t_s: Array
    y_m: Array
    beta_rad: Array
    rudder_t_s: Array
    rudder_rad: Array
    speed_m_s: float

    def rudder(self, t_s: Array) -> Array:
        """delta at the times, held beyond the history's ends."""
        return np.interp(t_s, self.rudder_t_s, self.rudder_rad)


@dataclass(frozen=True)
class FreeRunFit:
    """Result of ``fit_free_run``.

    Attributes
    ----------
    y_delta, n_delta : N/rad and N m/rad at ``speed_m_s``
    y_bias_n, n_bias_n_m : Y*, N*; None where they were held at 0
    six : the linear derivatives after the fit, with covariance
    covariance : of (y_delta, n_delta, y_bias_n, n_bias_n_m), (4, 4)
    x_delta_m : N_delta/Y_delta
    speed_m_s : at which all are quoted
    fit : the output-error fit
    notes : for the user
    """

    y_delta: Measured
    n_delta: Measured
    y_bias_n: Measured | None
    n_bias_n_m: Measured | None
    six: SixEstimate
    covariance: Array
    x_delta_m: Measured
    speed_m_s: float
    fit: OutputError
    notes: tuple[str, ...]


@solvable(EstimationError)
def fit_free_run(
    runs: Sequence[FreeRecord],
    hull: Hull,
    covariance: Array | None = None,
    *,
    bias: bool = True,
    sigma: tuple[float, float] = SIGMA,
) -> FreeRunFit:
    """Fit Y_delta, N_delta (and the linear derivatives as far as they are free) to (y, beta) of one or more free runs.

    Parameters
    ----------
    hull : the six linear derivatives, known or to start from, and the speed at which all is quoted; its rudder is the start
    covariance : (6, 6), of the six as the tows gave it: they may move within it, and it comes through to the rudder's errors.
        Zeros hold them. None holds m' and I' and lets Y_v, Y_R, N_v, N_r free altogether.
    bias : also fit Y*, N*
    sigma : noise of y and beta to begin with

    Raises
    ------
    EstimationError : no run, a rudder that never moves, uneven samples
    """
    if not runs:
        raise EstimationError("no free run")
    for index, run in enumerate(runs):
        check_series(run.t_s, run.y_m, run.beta_rad)
        check_series(run.rudder_t_s, run.rudder_rad)
        steps = np.diff(run.t_s)
        if len(run.t_s) < 20 or np.abs(steps - steps.mean()).max() > 0.01 * steps.mean():
            raise EstimationError(f"free run {index}: at least 20 evenly sampled values are needed")
        if bias and np.ptp(run.rudder(run.t_s)) < 1e-6:
            raise EstimationError(
                f"free run {index}: the rudder never moves, its force cannot be told from Y* (bias=False)"
            )
    shape, pull = _freedom(hull.six, covariance)
    extra = len(RUDDER) if bias else 2
    # steps of 1 are large: the rudder in units of what swings the hull at its damping
    unit = np.array([abs(hull.y_v) * hull.speed_m_s / 2, abs(hull.n_v) * hull.speed_m_s / 2, 1.0, 1.0])[:extra]
    free = shape.shape[1]
    size = free + extra + len(OWN) * len(runs)
    own_0 = np.array([_start(r) for r in runs]).ravel()
    known = np.array([getattr(hull, n) for n in RUDDER])[:extra]
    if free:
        # with the six held the rudder enters almost linearly: from there the joint fit starts
        held = fit_free_run(runs, hull, np.zeros((6, 6)), bias=bias, sigma=sigma).fit.theta
        known, own_0 = held[:extra] * unit, held[extra:]
    begin = np.concatenate([np.zeros(free), known / unit, own_0])
    prior = np.concatenate([pull, np.zeros(extra + len(own_0))])

    def predict(theta: Array) -> tuple[list[Array], list[Array]]:
        six = hull.six + shape @ theta[:free]
        force = np.zeros(4)
        force[:extra] = theta[free : free + extra] * unit
        responses, slopes = [], []
        for index, run in enumerate(runs):
            at = slice(free + extra + 4 * index, free + extra + 4 * (index + 1))
            response, slope = _run(run, six, force, theta[at], hull.speed_m_s)
            whole = np.zeros((len(run.t_s), 2, size))
            whole[:, :, :free] = slope[:, :, :6] @ shape
            whole[:, :, free : free + extra] = slope[:, :, 6 : 6 + extra] * unit
            whole[:, :, at] = slope[:, :, 10:]
            responses.append(response)
            slopes.append(whole)
        return responses, slopes

    seen = [np.column_stack([r.y_m, r.beta_rad]) for r in runs]
    fit = output_error(predict, seen, [r.t_s for r in runs], begin, prior=prior, sigma=sigma)
    return _result(fit, hull, shape, unit, free, extra)


def _freedom(six: Array, covariance: Array | None) -> tuple[Array, Array]:
    """(6, k) and (k,): six = known + shape @ z with z of prior weight 1 (a covariance's root) or 0 (free)."""
    if covariance is None:
        return np.diag(np.abs(six))[:, 2:], np.zeros(4)
    scale = np.abs(six)
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    keep = values > 1e-18
    return scale[:, None] * vectors[:, keep] * np.sqrt(values[keep]), np.ones(int(keep.sum()))


def _start(run: FreeRecord) -> tuple[float, float, float, float]:
    near = slice(0, max(6, len(run.t_s) // 40))
    t = run.t_s[near] - run.t_s[0]
    y, beta = (np.polynomial.polynomial.polyfit(t, x[near], 1) for x in (run.y_m, run.beta_rad))
    return float(y[0]), float(beta[0]), float(y[1] - run.speed_m_s * beta[0]), float(beta[1])


def _run(run: FreeRecord, six: Array, force: Array, own: Array, speed: float) -> tuple[Array, Array]:
    """(y, beta), (n, 2), and its slope by (six, rudder, own), (n, 2, 14): Runge-Kutta on ``free_rates``, complex step."""
    values = np.concatenate([six, force, own])
    columns = np.repeat(values[:, None], 15, axis=1).astype(complex)
    columns[np.arange(14), np.arange(1, 15)] += 1j * COMPLEX_STEP
    hull = Hull(
        *columns[:6],
        speed_m_s=speed,
        y_delta=columns[6],  # pyright: ignore[reportArgumentType]
        n_delta=columns[7],  # pyright: ignore[reportArgumentType]
        y_bias_n=columns[8],  # pyright: ignore[reportArgumentType]
        n_bias_n_m=columns[9],  # pyright: ignore[reportArgumentType]
    ).at_speed(run.speed_m_s)
    sampling = float(run.t_s[-1] - run.t_s[0]) / (len(run.t_s) - 1)
    parts = max(1, int(np.ceil(sampling / LARGEST_STEP_S)))
    h = sampling / parts
    half = run.t_s[0] + np.arange(2 * parts * (len(run.t_s) - 1) + 1) * h / 2
    rudder = run.rudder(half)
    tows = [Tow(run.speed_m_s, 1.0, 0.0, None, resistance_n=0.0, rudder_rad=float(d)) for d in rudder]
    state = columns[10:14].copy()
    path = np.empty((len(run.t_s), 2, 15), dtype=complex)
    path[0] = state[:2]
    for k in range(parts * (len(run.t_s) - 1)):
        first, middle, last = tows[2 * k : 2 * k + 3]
        k1 = free_rates(0.0, state, hull, first)
        k2 = free_rates(0.0, state + h / 2 * k1, hull, middle)
        k3 = free_rates(0.0, state + h / 2 * k2, hull, middle)
        k4 = free_rates(0.0, state + h * k3, hull, last)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if (k + 1) % parts == 0:
            path[(k + 1) // parts] = state[:2]
    return np.real(path[:, :, 0]), np.imag(path[:, :, 1:]) / COMPLEX_STEP


def _result(fit: OutputError, hull: Hull, shape: Array, unit: Array, free: int, extra: int) -> FreeRunFit:
    at = slice(free, free + extra)
    values = np.zeros(4)
    covariance = np.zeros((4, 4))
    values[:extra] = fit.theta[at] * unit
    covariance[:extra, :extra] = fit.covariance[at, at] * unit[:, None] * unit
    named = [Measured(value=float(v), std=float(np.sqrt(c))) for v, c in zip(values, np.diag(covariance), strict=True)]
    six = hull.six + shape @ fit.theta[:free]
    spread = shape @ fit.covariance[:free, :free] @ shape.T
    arm = values[1] / values[0]
    slope = np.array([-arm / values[0], 1 / values[0]])
    notes = []
    if not fit.converged:
        notes.append("the fit did not converge")
    moved = np.abs(six - hull.six)
    for name, gap, sd in zip(DERIVATIVE_UNITS, moved, np.sqrt(np.diag(shape @ shape.T)), strict=True):
        if free and sd > 0 and gap > 3 * sd:
            notes.append(
                f"{name} moved by {gap / sd:.1f} of its stated standard deviations: tows and free runs disagree"
            )
    return FreeRunFit(
        named[0],
        named[1],
        named[2] if extra == 4 else None,
        named[3] if extra == 4 else None,
        SixEstimate(six, spread),
        covariance,
        Measured(value=float(arm), std=float(np.sqrt(max(slope @ covariance[:2, :2] @ slope, 0.0)))),
        hull.speed_m_s,
        fit,
        tuple(notes),
    )


def without_rudder(hull: Hull) -> Hull:
    """The hull with no rudder and no bias: the start where nothing is known of them."""
    return replace(hull, y_delta=0.0, n_delta=0.0, y_bias_n=0.0, n_bias_n_m=0.0)
