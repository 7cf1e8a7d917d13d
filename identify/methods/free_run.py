"""Rudder derivatives from free runs (zigzag, turn): output-error fit of the free ship, on the simulator's own equations (5.14).

A free run knows ratios only: forces per m', moments per I'. m' and I' (and, if wanted, the four linear derivatives) come from
tows, with their covariance; what a free run says beyond is Y_delta and N_delta. ``fit_free_ratios`` needs no tows and gives the
ratios themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...record.errors import EstimationError, solvable
from ...record.results import Measured
from ...simulate.model import DERIVATIVE_UNITS, Array, Hull, accelerated, constant_force, sway_yaw_acceleration
from .common import SixEstimate, check_series
from .free_start import ratios_by_integrals
from .output_error import SIGMA, OutputError, output_error

COMPLEX_STEP = 1e-30
"""Step of the complex derivative: so small that it is exact to rounding, as nothing is subtracted."""
RUDDER = ("y_delta", "n_delta", "y_bias_n", "n_bias_n_m")
OWN = ("y", "beta", "v", "r")
LARGEST_STEP_S = 0.2
"""Longer sampling steps are divided; Simpson's rule for y is then good to 2e-7 m (zigzags of 10-30 degrees)."""
TERMS = 8
"""Of the exponential's series, over half a step of 0.1 s: of a hull that answers within 0.3 s 0.3^9/9! = 5e-11 is left."""
SIX_THEN_BASE = np.array([0, 1, 2, 3, 4, 5, 6, 0, 0, 0, 0, 0, 0, 0, 0])
"""Which column's matrix each column has: only the six derivatives change it."""
STILL_RAD = 1e-6
"""A rudder that moves less than this through all runs does not move."""
BUMPS_S = (3.0, 6.0, 1.5)
"""Lengths of the integrals that a fit without tows begins from, tried in this order; the best start is taken."""


@dataclass(frozen=True)
class FreeRecord:
    """A free run.

    Attributes
    ----------
    t_s, y_m, beta_rad : (n,), rising; y_CG in axes that move with U along the first course; samples may be missing
    rudder_t_s, rudder_rad : (k,), history of delta, positive to port, linear between its points
    speed_m_s : U, the mean of a history
    speed : (times, values) of a history of U; None: constant through the run
    covariance : (n, 2, 2), frame part, of (y m, beta rad), to begin with; None: ``sigma`` of the fit
    shared : keys and modes (k, n, 2) of unit variance of (y, beta), shared with runs of the same key (camera, codec)
    beta_bias_sd_rad : of an error of this run's heading; 0: none
    """

    t_s: Array
    y_m: Array
    beta_rad: Array
    rudder_t_s: Array
    rudder_rad: Array
    speed_m_s: float
    speed: tuple[Array, Array] | None = None
    covariance: Array | None = None
    shared: tuple[tuple[str, Array], ...] = field(default=())
    beta_bias_sd_rad: float = 0.0

    def rudder(self, t_s: Array) -> Array:
        """delta at the times, held beyond the history's ends."""
        return np.interp(t_s, self.rudder_t_s, self.rudder_rad)

    def speeds(self, t_s: Array) -> Array:
        """U at the times, held beyond the history's ends."""
        return np.full(len(t_s), self.speed_m_s) if self.speed is None else np.interp(t_s, *self.speed)


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
    joint : (10, 10), covariance of the six, then of those four
    starts, starts_sd : (runs, 4), y, beta, v, r at the first sample
    beta_bias, beta_bias_sd : (runs,), error of each run's heading, rad
    modes : per key the sizes of the shared modes, in their own standard deviations
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
    joint: Array
    starts: Array
    starts_sd: Array
    beta_bias: Array
    beta_bias_sd: Array
    modes: dict[str, Array]


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
    runs : free runs of one hull
    hull : the six linear derivatives, known or to start from, and the speed at which all is quoted; its rudder is the start
    covariance : (6, 6), of the six as the tows gave it: they may move within it, and it comes through to the rudder's errors.
        Zeros hold them. None holds m' and I' and lets Y_v, Y_R, N_v, N_r free altogether.
    bias : also fit Y*, N*
    sigma : noise of y and beta to begin with

    Raises
    ------
    EstimationError : no run, fewer than 20 samples, or a rudder that never moves
    """
    _check(runs, bias)
    shape, pull = _freedom(hull.six, covariance)
    extra = len(RUDDER) if bias else 2
    # steps of 1 are large: the rudder in units of what swings the hull at its damping
    unit = np.array([abs(hull.y_v) * hull.speed_m_s / 2, abs(hull.n_v) * hull.speed_m_s / 2, 1.0, 1.0])[:extra]
    at = _Places(shape.shape[1], extra, runs)
    own_0 = np.array([_start(r) for r in runs])
    known = np.array([getattr(hull, n) for n in RUDDER])[:extra]
    if at.free:
        # with the six held the rudder enters almost linearly: from there the joint fit starts
        held = fit_free_run(runs, hull, np.zeros((6, 6)), bias=bias, sigma=sigma)
        known, own_0 = held.fit.theta[:extra] * unit, held.starts
    begin, prior = np.zeros(at.size), np.zeros(at.size)
    begin[at.rudder] = known / unit
    prior[: at.free] = pull
    for index in range(len(runs)):
        begin[at.own(index)] = own_0[index]
    for where in (*at.modes.values(), *(w for w in at.bias if w is not None)):
        prior[where] = 1.0

    grids = [_grid(run) for run in runs]

    def predict(theta: Array) -> tuple[list[Array], list[Array]]:
        six = hull.six + shape @ theta[: at.free]
        force = np.zeros(4)
        force[:extra] = theta[at.rudder] * unit
        responses, slopes = [], []
        for index, run in enumerate(runs):
            response, slope = _run(run, grids[index], six, force, theta[at.own(index)], hull.speed_m_s)
            whole = np.zeros((len(run.t_s), 2, at.size))
            whole[:, :, : at.free] = slope[:, :, :6] @ shape
            whole[:, :, at.rudder] = slope[:, :, 6 : 6 + extra] * unit
            whole[:, :, at.own(index)] = slope[:, :, 10:]
            for key, modes in run.shared:
                whole[:, :, at.modes[key]] = np.moveaxis(modes, 0, -1)
                response = response + np.tensordot(theta[at.modes[key]], modes, 1)
            if (where := at.bias[index]) is not None:
                whole[:, 1, where] = run.beta_bias_sd_rad
                response = response + np.array([0.0, run.beta_bias_sd_rad * theta[where]])
            responses.append(response)
            slopes.append(whole)
        return responses, slopes

    seen = [np.column_stack([r.y_m, r.beta_rad]) for r in runs]
    stated = [r.covariance for r in runs]
    fit = output_error(predict, seen, [r.t_s for r in runs], begin, prior=prior, sigma=sigma, sample_covariance=stated)
    return _result(fit, hull, shape, unit, at, runs, bool(pull.any()))


@solvable(EstimationError)
def fit_free_ratios(runs: Sequence[FreeRecord], speed_m_s: float, *, bias: bool = True) -> FreeRunFit:
    """Free runs alone: every force over its mass. m' and I' are 1 in the answer, so that its Y_v is Y_v/m', its N_r N_r/I' ...

    The fit begins from weighted integrals of the records (``free_start``); nothing has to be known.

    Parameters
    ----------
    runs : free runs of one hull
    speed_m_s : at which the ratios are quoted
    bias : also fit Y*, N*

    Raises
    ------
    EstimationError : as ``fit_free_run``; the records are too short to begin from, or no start leads to a finite motion

    Examples
    --------
    >>> import numpy as np
    >>> from towline.simulate import Histories, Hull, Start, Tow, simulate_full
    >>> hull = Hull(249.6, 93.9, -97.2, -42.8, -92.6, -94.0, speed_m_s=1.3, y_delta=-18.0, n_delta=25.5)
    >>> t, over = np.arange(0, 40, 0.2), (np.arange(0, 41, 4.0), 0.2 * np.array([0, 0, 1, -1, 1, 1, -1, 0, 1, -1, 0]))
    >>> histories = Histories(rudder_rad=lambda s: float(np.interp(s, *over)))
    >>> tow, start = Tow(1.3, 1.0, 0.0, 0.0), Start(y_cg_m=0.0)
    >>> motion = simulate_full(hull, tow, start, t, free=True, histories=histories)
    >>> record = FreeRecord(t, motion.y_cg_m.to_numpy(), motion.beta_rad.to_numpy(), *over, 1.3)
    >>> found = fit_free_ratios([record], 1.3)
    >>> round(float(found.six.six[2]), 3), round(hull.y_v / hull.m_minus_y_vdot, 3)
    (-0.389, -0.389)
    """
    _check(runs, bias)
    fits: list[FreeRunFit] = []
    why = "no start was found"
    for bump_s in BUMPS_S:
        try:
            (a11, a12, b1, _), (a21, a22, b2, _) = ratios_by_integrals(runs, bump_s, speed_m_s)
            start = Hull(1.0, 1.0, a11, a12, a21, a22, speed_m_s=speed_m_s, y_delta=b1, n_delta=b2)
            fits.append(fit_free_run(runs, start, None, bias=bias))
        except EstimationError as error:
            why = str(error)
            continue
        if fits[-1].fit.converged:
            break
    if not fits:
        raise EstimationError(why)
    return fits[-1]


def _check(runs: Sequence[FreeRecord], bias: bool) -> None:
    if not runs:
        raise EstimationError("no free run")
    for index, run in enumerate(runs):
        check_series(run.t_s, run.y_m, run.beta_rad)
        check_series(run.rudder_t_s, run.rudder_rad)
        if len(run.t_s) < 20:
            raise EstimationError(f"free run {index}: {len(run.t_s)} samples; at least 20 are needed")
    angles = np.concatenate([run.rudder(run.t_s) for run in runs])
    if bias and np.ptp(angles) < STILL_RAD:
        raise EstimationError(
            f"the rudder never moves (it stands at {np.degrees(angles[0]):.3g} degrees throughout): its force cannot be told "
            "from Y* (bias=False)"
        )


class _Places:
    """Where everything stands among the parameters: the six, the rudder, shared modes, each run's start and heading error."""

    def __init__(self, free: int, extra: int, runs: Sequence[FreeRecord]) -> None:
        self.free, self.extra = free, extra
        self.rudder = slice(free, free + extra)
        here = free + extra
        self.modes: dict[str, slice] = {}
        for run in runs:
            for key, modes in run.shared:
                if key not in self.modes:
                    self.modes[key] = slice(here, here + len(modes))
                    here += len(modes)
        self._own = here
        here += len(OWN) * len(runs)
        self.bias: list[int | None] = []
        for run in runs:
            self.bias.append(here if run.beta_bias_sd_rad > 0 else None)
            here += run.beta_bias_sd_rad > 0
        self.size = here

    def own(self, index: int) -> slice:
        return slice(self._own + len(OWN) * index, self._own + len(OWN) * (index + 1))


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


def _run(run: FreeRecord, grid: _Grid, six: Array, force: Array, own: Array, speed: float) -> tuple[Array, Array]:
    """(y, beta), (n, 2), and its slope by (six, rudder, own), (n, 2, 14): complex step.

    Without a line nothing of y comes back into beta, v and r, which are linear in each other and in the rudder: they go from
    one time to the next by the exponential of ``sway_yaw_acceleration`` on unit vectors, under a rudder that is linear in
    between; y' = U sin(beta) + v cos(beta) is then summed by Simpson's rule.
    """
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
    )
    there = hull.at_speed(grid.speeds[:, None])  # pyright: ignore[reportArgumentType]
    pushed = np.zeros((len(grid.half), 15, 3), dtype=complex)
    pushed[:, :, 1], pushed[:, :, 2] = accelerated(there, *constant_force(there, grid.rudder[:, None]))  # pyright: ignore
    there = hull.at_speed(run.speed_m_s if grid.between is None else grid.between[:, None])  # pyright: ignore
    matrix, which = _rates_matrix(there)[:, :7], grid.which
    over, first, second = (one[:, SIX_THEN_BASE] for one in _exponential(matrix, grid.steps))
    gain = np.einsum("kcij,kcj->kci", first[which], pushed[:-1]) + np.einsum(
        "kcij,kcj->kci", second[which], np.diff(pushed, axis=0)
    )
    state = np.empty((len(grid.half), 15, 3), dtype=complex)
    state[0] = columns[11:14].T
    for k, i in enumerate(which):
        state[k + 1] = np.matmul(over[i], state[k][:, :, None])[:, :, 0] + gain[k]
    beta = state[:, :, 0]
    rate = grid.speeds[:, None] * np.sin(beta) + state[:, :, 1] * np.cos(beta)
    way = np.diff(grid.half[::2])[:, None] / 6 * (rate[:-1:2] + 4 * rate[1::2] + rate[2::2])
    y = columns[10] + np.concatenate([np.zeros((1, 15)), np.cumsum(way, axis=0)])
    path = np.stack([y[grid.sampled], beta[::2][grid.sampled]], axis=1)
    return np.real(path[:, :, 0]), np.imag(path[:, :, 1:]) / COMPLEX_STEP


def _rates_matrix(hull: Hull) -> Array:
    """A of (beta, v, r)' = A (beta, v, r) + pushed, (k, 15, 3, 3)."""
    by_v, by_r = (sway_yaw_acceleration(hull, *unit, 0.0, 0.0) for unit in ((1.0, 0.0), (0.0, 1.0)))
    matrix = np.zeros((*np.broadcast_shapes(np.shape(by_v[0]), (1, 15)), 3, 3), dtype=complex)
    matrix[..., 0, 2] = 1.0
    matrix[..., 1, 1], matrix[..., 2, 1] = by_v
    matrix[..., 1, 2], matrix[..., 2, 2] = by_r
    return matrix


def _exponential(matrix: Array, steps: Array) -> tuple[Array, Array, Array]:
    """e^M and h (e^M - 1)/M, h (e^M - 1 - M)/M^2 with M = A h: x, a constant push and one that grows over the step; Taylor.

    beta only follows r: with B of v and r alone, a series in M is the same series in B, and one power later in beta's row. By
    Cayley and Hamilton a series in B is a + b B with two numbers: c + B (a + b B) = (c - b det B) + (a + b tr B) B.
    """
    h = steps[:, None]
    block = matrix[..., 1:, 1:] * h[..., None, None]
    trace = block[..., 0, 0] + block[..., 1, 1]
    determinant = block[..., 0, 0] * block[..., 1, 1] - block[..., 0, 1] * block[..., 1, 0]
    one, by_block = np.full(trace.shape, 1 / math.factorial(TERMS + 2), dtype=complex), np.zeros_like(trace)
    series: list[tuple[Array, Array]] = []
    for k in range(TERMS + 1, -1, -1):
        one, by_block = 1 / math.factorial(k) - by_block * determinant, one + by_block * trace
        series.append((one, by_block))
    found = []
    for power in range(3):
        a, b = series[-1 - power]
        whole = np.zeros((*trace.shape, 3, 3), dtype=complex)
        whole[..., 1:, 1:] = b[..., None, None] * block
        whole[..., 1, 1] += a
        whole[..., 2, 2] += a
        a, b = series[-2 - power]
        whole[..., 0, 0] = 1 / math.factorial(power)
        whole[..., 0, 1] = h * b * block[..., 1, 0]
        whole[..., 0, 2] = h * (a + b * block[..., 1, 1])
        found.append(whole)
    return found[0], h[..., None, None] * found[1], h[..., None, None] * found[2]


@dataclass(frozen=True)
class _Grid:
    """The times of a run, and what no parameter changes there.

    Attributes
    ----------
    half : (2 n - 1,), the times between which the scheme steps and their middles
    sampled : where among the n times the samples stand
    speeds, rudder : (2 n - 1,), U and delta at ``half``
    steps, which : the lengths of the steps from one ``half`` to the next, and which of them each has
    between : U in the middle of each step; None: it is constant
    """

    half: Array
    sampled: Array
    speeds: Array
    rudder: Array
    steps: Array
    which: Array
    between: Array | None


def _grid(run: FreeRecord) -> _Grid:
    """Samples, corners of a rudder history that has few of them (within a step the rudder is taken as linear), and what divides
    long steps.
    """
    edges = run.t_s
    if len(run.rudder_t_s) <= len(run.t_s):
        inside = (run.rudder_t_s > edges[0]) & (run.rudder_t_s < edges[-1])
        edges = np.union1d(edges, run.rudder_t_s[inside])
    parts = np.maximum(1, np.ceil(np.diff(edges) / LARGEST_STEP_S - 1e-9)).astype(int)
    fine = [np.linspace(a, b, p, endpoint=False) for a, b, p in zip(edges[:-1], edges[1:], parts, strict=True)]
    edges = np.concatenate([*fine, edges[-1:]])
    half = np.empty(2 * len(edges) - 1)
    half[::2], half[1::2] = edges, (edges[1:] + edges[:-1]) / 2
    speeds, between = run.speeds(half), None
    steps, which = np.unique(np.round(np.diff(half), 12), return_inverse=True)
    if run.speed is not None:
        steps, which, between = np.diff(half), np.arange(len(half) - 1), (speeds[1:] + speeds[:-1]) / 2
    return _Grid(half, np.searchsorted(edges, run.t_s), speeds, run.rudder(half), steps, which, between)


def _result(
    fit: OutputError, hull: Hull, shape: Array, unit: Array, at: _Places, runs: Sequence[FreeRecord], pulled: bool
) -> FreeRunFit:
    free, extra = at.free, at.extra
    values = np.zeros(4)
    values[:extra] = fit.theta[at.rudder] * unit
    # (10, free + extra): the six and the rudder from the parameters
    out = np.zeros((10, free + extra))
    out[:6, :free] = shape
    out[6 : 6 + extra, free:] = np.diag(unit)
    joint = out @ fit.covariance[: free + extra, : free + extra] @ out.T
    covariance = joint[6:, 6:]
    named = [Measured(value=float(v), std=float(np.sqrt(c))) for v, c in zip(values, np.diag(covariance), strict=True)]
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    six = hull.six + shape @ fit.theta[:free]
    arm = values[1] / values[0]
    slope = np.array([-arm / values[0], 1 / values[0]])
    notes = []
    if not fit.converged:
        notes.append("the fit did not converge")
    moved = np.abs(six - hull.six)
    known = np.sqrt(np.diag(shape @ shape.T)) if pulled else np.zeros(6)
    for name, gap, before in zip(DERIVATIVE_UNITS, moved, known, strict=True):
        if before > 0 and gap > 3 * before:
            notes.append(
                f"{name} moved by {gap / before:.1f} of its stated standard deviations: tows and free runs disagree"
            )
    return FreeRunFit(
        named[0],
        named[1],
        named[2] if extra == 4 else None,
        named[3] if extra == 4 else None,
        SixEstimate(six, joint[:6, :6]),
        covariance,
        Measured(value=float(arm), std=float(np.sqrt(max(slope @ covariance[:2, :2] @ slope, 0.0)))),
        hull.speed_m_s,
        fit,
        tuple(notes),
        joint,
        np.array([fit.theta[at.own(i)] for i in range(len(runs))]),
        np.array([sd[at.own(i)] for i in range(len(runs))]),
        np.array([0.0 if w is None else fit.theta[w] * r.beta_bias_sd_rad for w, r in zip(at.bias, runs, strict=True)]),
        np.array([0.0 if w is None else sd[w] * r.beta_bias_sd_rad for w, r in zip(at.bias, runs, strict=True)]),
        {key: fit.theta[where] for key, where in at.modes.items()},
    )


def without_rudder(hull: Hull) -> Hull:
    """The hull with no rudder and no bias: the start where nothing is known of them."""
    return replace(hull, y_delta=0.0, n_delta=0.0, y_bias_n=0.0, n_bias_n_m=0.0)
