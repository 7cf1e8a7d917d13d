"""Steady tows -> the neutral point X_v (4.9), (5.1)-(5.8): no force measurement is needed.

In the steady state Y_v v + Y_delta delta = F and N_v v + N_delta delta = F X_T with v = -U sin(beta) and
F = T sin(alpha+beta). Where T is not measured T = R/cos(alpha), and R cancels from X_v.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.special import chdtrc, ndtri

from ..record.errors import EstimationError, InputError, solvable
from ..record.results import Measured, SteadyTow
from ..record.run import RUN_FILE, Run
from ..record.tables import read_history
from ..simulate.model import Array
from .data import check_times, common_key
from .noise import LARGEST_ORDER, autoregression

BATCHES = 8
DRIFT_T = 3.0
"""A trend over the batch means beyond this many of its standard deviations is a drift ..."""
DRIFT_RAD = 1e-4
"""... unless it is smaller than this over the whole window (0.006 degrees)."""
SHORTEST_S = 4.0
SHORTEST_SHARE = 0.15
CLOSEST_FORCES = 1e-3
"""Two tows whose F differ by less than this share give no X_v."""


@dataclass(frozen=True)
class SteadyState:
    """The steady state of one tow.

    Attributes
    ----------
    name : of the run
    tow_point_m, tow_point_sd_m : X_T
    speed_m_s : U
    tension_n, tension_sd_rel, tension_common_sd_rel : T, its relative scatter, and its relative error common to all tows; None
        where T was not measured
    speed_sd_rel : error of U common to all tows, relative
    alpha_rad, beta_rad : means over the window
    covariance : (2, 2), of the two means, frame part (long-run variance)
    common : (k, 2), change of (alpha, beta) with each unit-variance common mode; common_key: whose modes
    span_s, settled : the window; False: the angles still drift in it
    trim_rad : of the model, or None
    """

    name: str
    tow_point_m: float
    alpha_rad: float
    beta_rad: float
    covariance: Array = field(default_factory=lambda: np.zeros((2, 2)))
    common: Array = field(default_factory=lambda: np.zeros((0, 2)))
    common_key: str = ""
    tow_point_sd_m: float = 0.0
    speed_m_s: float = 1.0
    tension_n: float | None = None
    tension_sd_rel: float = 0.0
    tension_common_sd_rel: float = 0.0
    speed_sd_rel: float = 0.0
    span_s: tuple[float, float] = (0.0, 0.0)
    settled: bool = True
    trim_rad: float | None = None

    def force(self) -> tuple[float, Array]:
        """F = T sin(alpha+beta), N, or F/R = sin(alpha+beta)/cos(alpha); and its slope by (alpha, beta), (2,)."""
        a, b = self.alpha_rad, self.beta_rad
        if self.tension_n is not None:
            return self.tension_n * np.sin(a + b), np.full(2, self.tension_n * np.cos(a + b))
        return np.sin(a + b) / np.cos(a), np.array([np.cos(b) / np.cos(a) ** 2, np.cos(a + b) / np.cos(a)])


@dataclass(frozen=True)
class SteadyFit:
    """Result of ``fit_steady``.

    Attributes
    ----------
    x_v_m, slope : Measured; slope is k of X_T = X_v + k/F
    interval_m : 95 % interval of x_v_m
    chi2_per_dof : of the line, None for two tows
    pairs : X_v of every two tows (4.9)
    y_v, n_v, y_delta_delta, n_delta_delta : with X_delta and T known, else None
    notes : for the user
    """

    x_v_m: Measured
    slope: Measured
    interval_m: tuple[float, float]
    chi2_per_dof: float | None
    pairs: dict[str, Measured]
    y_v: Measured | None
    n_v: Measured | None
    y_delta_delta: Measured | None
    n_delta_delta: Measured | None
    notes: tuple[str, ...]


def two_tow_x_v(force_a: float, x_t_a: float, force_b: float, x_t_b: float) -> float:
    """X_v = (F_A X_TA - F_B X_TB)/(F_A - F_B)  (4.9), m; forces in any common unit."""
    if abs(force_a - force_b) <= CLOSEST_FORCES * max(abs(force_a), abs(force_b)):
        raise EstimationError(f"the two tows pull alike (F = {force_a:.4g} and {force_b:.4g}); (4.9) has no value")
    return (force_a * x_t_a - force_b * x_t_b) / (force_a - force_b)


def steady_state(run: Run, motion: pd.DataFrame, common: Array | None) -> SteadyState:
    """Find the steady part of a tow and its mean angles.

    Parameters
    ----------
    motion : with alpha_rad and beta_rad
    common : (k, n, 3) of ``geometry.Motion`` or None

    Raises
    ------
    InputError : not a tow, no alpha, or too short
    """
    where = run.folder / RUN_FILE
    if run.file.kind != "tow":
        raise InputError(where, "kind", f'{run.file.kind!r}; a steady tow is of kind "tow"')
    tow = run.tow
    x_t = run.need(tow.tow_point_m, "tow.tow_point_m")
    span = run.file.source.span_s
    good = (motion["status"] == "measured").to_numpy() & np.isfinite(motion[["alpha_rad", "beta_rad"]].to_numpy()).all(
        axis=1
    )
    if span is not None:
        good &= motion["t_s"].between(span[0], span[1]).to_numpy()
    times = motion["t_s"].to_numpy()[good]
    check_times(run, times)
    if good.sum() < 5 * BATCHES or times[-1] - times[0] < SHORTEST_S:
        raise InputError(
            run.source_path, "", f"{int(good.sum())} samples with alpha and beta; {SHORTEST_S:g} s are needed"
        )
    angles = motion[["alpha_rad", "beta_rad"]].to_numpy()[good]
    first, settled = _window(times, angles)
    mean, covariance = _tail_mean(angles[first:])
    modes = np.zeros((0, 2)) if common is None else common[:, good][:, first:][:, :, [2, 1]].mean(axis=1)
    tension = tow.tension_n
    if tow.tension is not None:
        log = read_history(run.path(tow.tension), "tension_n")
        clock = log["t_s"].to_numpy() + tow.tension_delay_s
        inside = (clock >= times[first]) & (clock <= times[-1])
        if not inside.any():
            raise InputError(
                run.path(tow.tension), "column t_s", f"holds nothing between {times[first]:.2f} and {times[-1]:.2f} s"
            )
        tension = float(log["tension_n"].to_numpy()[inside].mean())
    priors = run.file.priors
    return SteadyState(
        name=run.name,
        tow_point_m=x_t,
        alpha_rad=float(mean[0]),
        beta_rad=float(mean[1]),
        covariance=covariance,
        common=modes,
        common_key=common_key(run),
        tow_point_sd_m=priors.tow_point_sd_m,
        speed_m_s=tow.speed_m_s,
        tension_n=tension,
        tension_sd_rel=priors.tension_sd_rel,
        tension_common_sd_rel=priors.tension_common_sd_rel,
        speed_sd_rel=priors.speed_sd_rel,
        span_s=(float(times[first]), float(times[-1])),
        settled=settled,
        trim_rad=run.model.trim_rad,
    )


def _window(times: Array, angles: Array) -> tuple[int, bool]:
    """First sample of the tail whose mean is known best, among the tails without a trend; else the last fifth, not settled.

    An early start lets the transient scatter the batch means, a late one has few samples: the least sum of both wins.
    """
    whole = times[-1] - times[0]
    shortest = max(SHORTEST_S, SHORTEST_SHARE * whole)
    best: tuple[float, int] | None = None
    for start in np.arange(times[0], times[-1] - shortest, 0.05 * whole):
        first = int(np.searchsorted(times, start))
        if len(times) - first < 3 * BATCHES or _drifts(times[first:], angles[first:]):
            continue
        variance = float(np.trace(_tail_mean(angles[first:])[1]))
        if best is None or variance < best[0]:
            best = (variance, first)
    if best is not None:
        return best[1], True
    return int(np.searchsorted(times, times[-1] - max(shortest, 0.2 * whole))), False


def _batches(times: Array, angles: Array) -> tuple[Array, Array]:
    parts = np.array_split(np.arange(len(times)), BATCHES)
    return np.array([times[p].mean() for p in parts]), np.array([angles[p].mean(axis=0) for p in parts])


def _drifts(times: Array, angles: Array) -> bool:
    t, means = _batches(times, angles)
    x = (t - t.mean()) / (t[-1] - t[0])
    for column in means.T:
        slope = float(x @ column / (x @ x))
        rest = column - column.mean() - slope * x
        sd = np.sqrt(rest @ rest / (BATCHES - 2) / (x @ x))
        if abs(slope) > max(DRIFT_T * sd, DRIFT_RAD) or abs(slope) > 20 * DRIFT_RAD:
            return True
    return False


def _tail_mean(angles: Array) -> tuple[Array, Array]:
    """Mean of the angles ``(n, 2)`` and its covariance from their long-run variance (an autoregression's, at frequency 0)."""
    mean = angles.mean(axis=0)
    rest = angles - mean
    sd = np.empty(2)
    for channel in range(2):
        variance = float(np.mean(rest[:, channel] ** 2))
        coefficients, share = autoregression(rest[:, channel], min(LARGEST_ORDER, len(rest) // 20))
        # a slow root that the record cannot resolve counts as one memory as long as a batch
        gain = max(1.0 - float(coefficients.sum()), BATCHES / len(rest))
        square = variance * share / gain**2 / len(rest)
        independent = variance / max(
            square, 1e-300
        )  # as many samples the record is worth; the mean and its memory cost three
        sd[channel] = np.sqrt(square * independent / max(independent - 3.0, 1.0))
    scatter = np.sqrt(np.maximum(np.diag(rest.T @ rest), 1e-300))
    correlation = (rest.T @ rest) / scatter[:, None] / scatter[None, :]
    return mean, correlation * sd[:, None] * sd[None, :]


@solvable(EstimationError)
def fit_steady(tows: list[SteadyState], x_delta_m: float | None = None) -> SteadyFit:
    """X_v from two or more steady tows: the line X_T = X_v + k/F (5.4), fitted as F = k/(X_T - X_v) with F's covariance.

    Parameters
    ----------
    tows : at different X_T, all with a measured T or none
    x_delta_m : the rudder's point of action; with measured T it gives Y_v, Y_delta delta, N_delta delta (5.6-5.8)

    Raises
    ------
    EstimationError : fewer than two tow points, or forces too alike or of both signs
    """
    if len({t.tow_point_m for t in tows}) < 2:
        raise EstimationError("X_v needs steady tows at two or more tow points")
    measured = [t.tension_n is not None for t in tows]
    if any(measured) and not all(measured):
        missing = next(t.name for t, m in zip(tows, measured, strict=True) if not m)
        raise EstimationError(f"run {missing!r} has no tension while others have; give it to all or to none")
    x_t = np.array([t.tow_point_m for t in tows])
    force = np.array([t.force()[0] for t in tows])
    by_force, inputs = force_slope(tows), input_covariance(tows)
    covariance = by_force @ inputs @ by_force.T
    if not all(measured):  # R's own scatter from tow to tow
        covariance += np.diag(np.square(force * [t.tension_sd_rel for t in tows]))
    notes = []
    if (np.sign(force) != np.sign(force[0])).any():
        raise EstimationError(
            "the tows pull to both sides; a line through X_T over 1/F needs one rudder setting and side"
        )
    # start: least squares of F X_T - X_v F = k
    x_v, k = np.linalg.lstsq(np.column_stack([force, np.ones_like(force)]), force * x_t, rcond=None)[0]
    inverse, gain, total = np.eye(2), np.zeros((2, len(tows))), covariance
    for _ in range(30):
        gap_x = x_t - x_v
        slope = np.column_stack([k / gap_x**2, 1 / gap_x])
        spread = np.diag([(k / g**2 * t.tow_point_sd_m) ** 2 for g, t in zip(gap_x, tows, strict=True)])
        total = covariance + spread + np.diag((1e-9 * force) ** 2)
        weight = np.linalg.inv(total)
        inverse = np.linalg.inv(slope.T @ weight @ slope)
        gain = inverse @ slope.T @ weight
        step = gain @ (force - k / gap_x)
        x_v, k = x_v + step[0], k + step[1]
        if np.abs(step).max() < 1e-14:
            break
    rest = force - k / (x_t - x_v)
    degrees = len(tows) - 2
    per_dof, widened = None, 1.0
    if degrees:
        square = float(rest @ np.linalg.inv(total) @ rest)
        per_dof = square / degrees
        if chdtrc(degrees, square) < 0.01:
            widened = per_dof
            notes.append(
                f"the tows do not lie on one line to within their errors (chi-square {square:.1f} of {degrees}): "
                f"the interval is widened {np.sqrt(per_dof):.1f} times; speed, rudder or tension changed between them, "
                "or the hull is not linear at these angles"
            )
    else:
        notes.append("two tows fix the line without a check; a third tow point would test it")
    for tow in tows:
        if not tow.settled:
            notes.append(f"run {tow.name!r} still drifts at its end; a longer tow would settle it")
    sd = np.sqrt(np.diag(inverse) * widened)
    half = float(ndtri(0.975) * sd[0])
    by_gap = by_force.copy()  # of F - k/(X_T - X_v)
    by_gap[:, 3::4] += np.diag(k / (x_t - x_v) ** 2)
    y_v, n_v, y_delta, n_delta = _hull_from_steady(tows, (x_v, k), by_force, gain @ by_gap, widened * inputs, x_delta_m)
    return SteadyFit(
        x_v_m=Measured(value=float(x_v), std=float(sd[0])),
        slope=Measured(value=float(k), std=float(np.hypot(sd[1], k * common_errors(tows)[0]))),
        interval_m=(float(x_v) - half, float(x_v) + half),
        chi2_per_dof=per_dof,
        pairs=_pairs(tows, x_t, force, covariance),
        y_v=y_v,
        n_v=n_v,
        y_delta_delta=y_delta,
        n_delta_delta=n_delta,
        notes=tuple(notes),
    )


def input_covariance(tows: list[SteadyState]) -> Array:
    """(4n, 4n), of (alpha, beta, ln T, X_T) of each tow; common camera modes run across tows, T's and U's common errors do not."""
    n = len(tows)
    covariance = np.zeros((4 * n, 4 * n))
    for i, a in enumerate(tows):
        at = slice(4 * i, 4 * i + 2)
        covariance[at, at] += a.covariance
        covariance[4 * i + 2, 4 * i + 2] = a.tension_sd_rel**2 if a.tension_n is not None else 0.0
        covariance[4 * i + 3, 4 * i + 3] = a.tow_point_sd_m**2
        for j, b in enumerate(tows):
            if len(a.common) and len(a.common) == len(b.common) and (i == j or a.common_key == b.common_key):
                covariance[at, 4 * j : 4 * j + 2] += a.common.T @ b.common
    return covariance


def force_slope(tows: list[SteadyState]) -> Array:
    """(n, 4n), change of each tow's F with the inputs of ``input_covariance``."""
    slope = np.zeros((len(tows), 4 * len(tows)))
    for i, tow in enumerate(tows):
        slope[i, 4 * i + 2], slope[i, 4 * i : 4 * i + 2] = tow.force()
    return slope


def common_errors(tows: list[SteadyState]) -> tuple[float, float]:
    """Relative errors that all tows share: of T (none where it was not measured) and of U."""
    tension = max(t.tension_common_sd_rel if t.tension_n is not None else 0.0 for t in tows)
    return tension, max(t.speed_sd_rel for t in tows)


def _pairs(tows: list[SteadyState], x_t: Array, force: Array, covariance: Array) -> dict[str, Measured]:
    found = {}
    for i in range(len(tows)):
        for j in range(i + 1, len(tows)):
            try:
                value = two_tow_x_v(force[i], x_t[i], force[j], x_t[j])
            except EstimationError:
                continue
            gap = force[i] - force[j]
            slope = np.array([(x_t[i] - value) / gap, (value - x_t[j]) / gap])
            variance = slope @ covariance[np.ix_([i, j], [i, j])] @ slope
            variance += (force[i] / gap * tows[i].tow_point_sd_m) ** 2 + (force[j] / gap * tows[j].tow_point_sd_m) ** 2
            found[f"{tows[i].name} & {tows[j].name}"] = Measured(value=float(value), std=float(np.sqrt(variance)))
    return found


def _hull_from_steady(
    tows: list[SteadyState],
    line: tuple[float, float],
    by_force: Array,
    by_line: Array,
    inputs: Array,
    x_delta_m: float | None,
) -> tuple[Measured | None, Measured | None, Measured | None, Measured | None]:
    """Y_v = F (X_T - X_delta)/(v (X_v - X_delta)), N_v = X_v Y_v, Y_delta delta = F (X_v - X_T)/(X_v - X_delta) and
    N_delta delta = X_delta Y_delta delta (4.10, 5.6-5.8).

    Errors of every tow's angles, T and X_T (``inputs``) are carried through both, by what they do to each F (``by_force``) and to
    the line's X_v and k (``by_line``, (2, 4n)); T's and U's common errors scale them.
    """
    if x_delta_m is None or any(t.tension_n is None for t in tows):
        return None, None, None, None
    (x_v, k), (x_v_by, k_by) = line, by_line
    arm = x_v - x_delta_m
    tension, speed = common_errors(tows)

    def measured(value: float, by: Array, shared: float) -> Measured:
        return Measured(value=float(value), std=float(np.hypot(np.sqrt(by @ inputs @ by), value * shared)))

    y_delta, y_delta_by = -k / arm, (k / arm * x_v_by - k_by) / arm  # F (X_v - X_T) = -k
    rudder = (
        measured(y_delta, y_delta_by, tension),
        measured(x_delta_m * y_delta, x_delta_m * y_delta_by, tension),
    )
    values, slopes, weights = [], [], []
    for i, tow in enumerate(tows):
        v = -tow.speed_m_s * np.sin(tow.beta_rad)
        if v == 0.0:
            continue
        force, lever = tow.force()[0], tow.tow_point_m - x_delta_m
        by = by_force[i] * lever
        by[4 * i + 3] += force
        by[4 * i + 1] -= force * lever / np.tan(tow.beta_rad)
        values.append(force * lever / (v * arm))
        slopes.append(by / (v * arm) - values[-1] / arm * x_v_by)
        share = np.sqrt(tow.covariance[1, 1]) / abs(np.tan(tow.beta_rad))
        weights.append(1 / max(share, 1e-6) ** 2)
    if not values:
        return None, None, *rudder
    y_v = float(np.average(values, weights=weights))
    y_v_by = np.average(slopes, axis=0, weights=weights)
    both = float(np.hypot(tension, speed))
    damping = measured(y_v, y_v_by, both), measured(x_v * y_v, x_v * y_v_by + y_v * x_v_by, both)
    return *damping, *rudder


def steady_tow_result(tow: SteadyState) -> SteadyTow:
    """The tow as it stands in steady.json."""
    force, slope = tow.force()
    total = tow.covariance + tow.common.T @ tow.common
    sd = np.sqrt(np.diag(total))
    return SteadyTow(
        tow_point_m=tow.tow_point_m,
        alpha_rad=Measured(value=tow.alpha_rad, std=float(sd[0])),
        beta_rad=Measured(value=tow.beta_rad, std=float(sd[1])),
        force=Measured(value=float(force), std=float(np.sqrt(slope @ total @ slope))),
        span_s=tow.span_s,
        settled=tow.settled,
        trim_rad=tow.trim_rad,
    )
