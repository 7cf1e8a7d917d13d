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
from .cut import before_cut
from .data import check_sizes, check_times, common_key, usual_resistance
from .joint.common import along_of
from .settled import Judged, Stability, judge, slowest_swing_s, tail_mean, words

CLOSEST_FORCES = 1e-3
"""Two tows whose F differ by less than this share give no X_v."""

UNSEEN = Stability("settled")
LEAST_FORCE_SDS = 10.0
"""A steady tow gives an X_v only if its side force F is at least so many of its standard deviations, and its angle as below."""
LEAST_ANGLE_RAD = np.radians(3.0)
"""Least alpha + beta of such a tow: a datum may err by 2 mm and 0.2 degrees that nobody stated, a tenth of it, and X_v then errs by
a tenth of X_T - X_v."""


@dataclass(frozen=True)
class Along:
    """What a hull that drifts on a line of constant length resists along itself, over R (theory.md 10).

    Attributes
    ----------
    exponent, drag : n of R ~ u^n, and X_vv U^2/R, each with its standard deviation; the same in all tows of a hull
    """

    exponent: tuple[float, float]
    drag: tuple[float, float]

    def share(self, beta_rad: float) -> tuple[float, float]:
        """-X/(R cos(beta)^2) at u = U cos(beta), v = -U sin(beta), and its slope by beta.

        A rudder's force goes with u^2: over cos(beta)^2 it is the same in all tows, as the line X_T = X_v + k/F asks.
        """
        tangent, cosine, n, drag = np.tan(beta_rad), np.cos(beta_rad), self.exponent[0], self.drag[0]
        slope = -(n - 2) * cosine ** (n - 2) * tangent - 2 * drag * tangent / cosine**2
        return float(cosine ** (n - 2) - drag * tangent**2), float(slope)

    def relative(self, beta_rad: float) -> Array:
        """(2,), relative change of F with one standard deviation of the exponent and of the drag."""
        share, cosine = self.share(beta_rad)[0], np.cos(beta_rad)
        by_power = cosine ** (self.exponent[0] - 2) * np.log(cosine) * self.exponent[1]
        return np.array([by_power, -(np.tan(beta_rad) ** 2) * self.drag[1]]) / share


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
    common : (k, 2), change of (alpha, beta) with each unit-variance common mode
    common_key : whose modes: runs with the same key share them
    span_s, settled : the window; False: it was not judged to be settled
    stability : what the record says of the tow's stability (3.2.3)
    whole : the window is the whole record: the tow was at rest from its beginning
    along : what the hull resists along itself, where the line keeps its length and no load cell says T; tension_n is R then
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
    stability: Stability = UNSEEN
    whole: bool = False
    along: Along | None = None
    trim_rad: float | None = None

    def force(self) -> tuple[float, Array]:
        """F = T sin(alpha+beta), N, or F/R; and its slope by (alpha, beta), (2,).

        With ``along`` T cos(alpha+beta) is what the hull resists at its own speed u = U cos(beta) (theory.md 10), and F is
        brought to U (divided by cos(beta)^2); else T is as measured, or R/cos(alpha) (4.7).
        """
        a, b = self.alpha_rad, self.beta_rad
        if self.along is not None:
            share, by_beta = self.along.share(b)
            pull = 1.0 if self.tension_n is None else self.tension_n
            steep = share / np.cos(a + b) ** 2
            return pull * share * np.tan(a + b), pull * np.array([steep, steep + by_beta * np.tan(a + b)])
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
    by_inputs : (4n,), change of X_v with (alpha, beta, ln F by T or R, X_T) of each tow
    widened : the variances are so many times those of the tows' own errors: they do not lie on one line
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
    by_inputs: Array = field(default_factory=lambda: np.zeros(0))
    widened: float = 1.0


def two_tow_x_v(force_a: float, x_t_a: float, force_b: float, x_t_b: float) -> float:
    """X_v = (F_A X_TA - F_B X_TB)/(F_A - F_B)  (4.9), m; forces in any common unit.

    Parameters
    ----------
    force_a : F of the first tow
    x_t_a : X_T of the first tow, m
    force_b : F of the second
    x_t_b : X_T of the second, m
    """
    if abs(force_a - force_b) <= CLOSEST_FORCES * max(abs(force_a), abs(force_b)):
        raise EstimationError(f"the two tows pull alike (F = {force_a:.4g} and {force_b:.4g}); (4.9) has no value")
    return (force_a * x_t_a - force_b * x_t_b) / (force_a - force_b)


class UnsettledError(EstimationError):
    """A tow that is not steady.

    Attributes
    ----------
    stability : what its record says instead
    """

    def __init__(self, message: str, stability: Stability) -> None:
        super().__init__(message)
        self.stability = stability


def tow_angles(run: Run, motion: pd.DataFrame) -> tuple[Array, Array, Array]:
    """The usable angles of a tow: which rows of ``motion`` (n,), their times (m,) and (alpha, beta) (m, 2).

    Parameters
    ----------
    run : the run folder as read
    motion : motion table

    Raises
    ------
    InputError : not a tow, or times that do not rise
    """
    if run.file.kind != "tow":
        raise InputError(run.folder / RUN_FILE, "kind", f'{run.file.kind!r}; a steady tow is of kind "tow"')
    span = run.file.source.span_s
    angles = motion[["alpha_rad", "beta_rad"]].to_numpy()
    good = (motion["status"] == "measured").to_numpy() & np.isfinite(angles).all(axis=1) & before_cut(run, motion)
    if span is not None:
        good &= motion["t_s"].between(span[0], span[1]).to_numpy()
    times = motion["t_s"].to_numpy()[good]
    check_times(run, times)
    check_sizes(run, motion, good, ("alpha_rad", "beta_rad"))
    return good, times, angles[good]


def judged_tow(run: Run, motion: pd.DataFrame, common: Array | None) -> Judged:
    """Whether a tow has settled, by what is left of its motion against F's own uncertainty (``settled.judge``).

    Parameters, raises: as ``steady_state``, which refuses what this only judges

    Parameters
    ----------
    run : the run folder as read
    motion : motion table
    common : (k, n, 3) of ``geometry.Motion`` or None
    """
    good, times, angles = tow_angles(run, motion)
    tow, priors = run.tow, run.file.priors
    x_t = run.need(tow.tow_point_m, "tow.tow_point_m")
    known = tension_known(run)
    # X_v lies ahead of LCG: an error of X_T does to X_v at least what this share of F does
    relative = float(np.hypot(priors.tension_sd_rel, priors.tow_point_sd_m / max(abs(x_t), 1e-9)))

    along = along_of_run(run)

    def pull(mean: Array) -> tuple[float, Array]:
        force, slope = SteadyState("", x_t, *mean, tension_n=1.0 if known else None, along=along).force()
        return float(force), slope

    def error(first: int) -> tuple[Array, float]:
        modes = window_modes(common, good, first)
        return modes.T @ modes, relative

    slowest_s = slowest_swing_s(run.model.length_pp_m, tow.speed_m_s)
    try:
        return judge(times, angles, slowest_s, pull, error)
    except EstimationError as short:
        raise InputError(run.source_path, "", str(short)) from None


def along_of_run(run: Run) -> Along | None:
    """What a run's hull resists along itself; None where the line's tension is given or logged."""
    tow, model, priors = run.tow, run.model, run.file.priors
    if tow.line != "surge" or tow.tension is not None:
        return None
    resistance = tow.tension_n or usual_resistance(model.mass_kg, model.length_pp_m, tow.speed_m_s)
    drag, spread = along_of(priors, model.mass_kg, model.length_pp_m, "x_vv_kg_m")
    over = tow.speed_m_s**2 / resistance
    exponent = along_of(priors, model.mass_kg, model.length_pp_m, "resistance_exponent")
    return Along(exponent, (drag * over, spread * over))


def tension_known(run: Run) -> bool:
    """T is stated or logged."""
    return run.tow.tension_n is not None or run.tow.tension is not None


def window_modes(common: Array | None, good: Array, first: int) -> Array:
    """(k, 2), mean change of (alpha, beta) over the tail with each common mode.

    Parameters
    ----------
    common : (k, n, 3) of ``geometry.Motion`` or None
    good : which of the n are used
    first : of these, the tail's first
    """
    return np.zeros((0, 2)) if common is None else common[:, good][:, first:][:, :, [2, 1]].mean(axis=1)


def steady_state(run: Run, motion: pd.DataFrame, common: Array | None) -> SteadyState:
    """Find the steady part of a tow and its mean angles.

    Parameters
    ----------
    run : the run folder as read
    motion : with alpha_rad and beta_rad
    common : (k, n, 3) of ``geometry.Motion`` or None

    Raises
    ------
    InputError : not a tow, no alpha, or too short
    UnsettledError : the tow still swings, drifts or shears off
    """
    good, times, angles = tow_angles(run, motion)
    found = judged_tow(run, motion, common)
    if not found.settled:
        raise UnsettledError(f"run {run.name!r} is not steady: {words(found, tension_known(run))}", found.stability)
    first = found.first
    mean, covariance = tail_mean(angles[first:])
    modes = window_modes(common, good, first)
    return state_of(run, times[first:], mean, covariance + found.small, modes, found.stability, first == 0)


def state_of(
    run: Run, times: Array, mean: Array, covariance: Array, modes: Array, stability: Stability, whole: bool = False
) -> SteadyState:
    """A tow's steady state from the angles at which it rests, with the rig that run.toml states.

    Parameters
    ----------
    run : the run folder as read
    times : (m,), of the window, s
    mean, covariance : (2,), (2, 2), of alpha and beta
    modes : (k, 2), change of both with each common mode
    stability : what the record says of it
    whole : the window is the whole record

    Raises
    ------
    InputError : a log of the tension holds nothing of the window
    """
    tow = run.tow
    x_t = run.need(tow.tow_point_m, "tow.tow_point_m")
    tension = tow.tension_n
    if tow.tension is not None:
        log = read_history(run.path(tow.tension), "tension_n")
        clock = log["t_s"].to_numpy() + tow.tension_delay_s
        inside = (clock >= times[0]) & (clock <= times[-1])
        if not inside.any():
            raise InputError(
                run.path(tow.tension), "column t_s", f"holds nothing between {times[0]:.2f} and {times[-1]:.2f} s"
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
        span_s=(float(times[0]), float(times[-1])),
        stability=stability,
        whole=whole,
        along=along_of_run(run),
        trim_rad=run.model.trim_rad,
    )


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
            notes.append(f"run {tow.name!r} was not judged to be settled")
    sd = np.sqrt(np.diag(inverse) * widened)
    half = float(ndtri(0.975) * sd[0])
    by_gap = by_force.copy()  # of F - k/(X_T - X_v)
    by_gap[:, 3::4] += np.diag(k / (x_t - x_v) ** 2)
    by_line = gain @ by_gap
    y_v, n_v, y_delta, n_delta = _hull_from_steady(tows, (x_v, k), by_force, by_line, widened * inputs, x_delta_m)
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
        by_inputs=by_line[0],
        widened=float(widened),
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
            if a.along is not None and b.along is not None:
                shared = a.along.relative(a.beta_rad) @ b.along.relative(b.beta_rad)
                covariance[4 * i + 2, 4 * j + 2] += shared
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
        v = -tow.speed_m_s * (np.sin if tow.along is None else np.tan)(tow.beta_rad)
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


def stands_off(tow: SteadyState) -> bool:
    """F is large enough to give an X_v (``LEAST_FORCE_SDS``, ``LEAST_ANGLE_RAD``)."""
    force, slope = tow.force()
    total = tow.covariance + tow.common.T @ tow.common
    large = abs(tow.alpha_rad + tow.beta_rad) > LEAST_ANGLE_RAD
    return bool(large and abs(force) > LEAST_FORCE_SDS * np.sqrt(slope @ total @ slope))


def steady_tow_result(tow: SteadyState) -> SteadyTow:
    """The tow as it stands in steady.json."""
    force, slope, total = tow.force()[0], force_slope([tow])[0], input_covariance([tow])
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
