"""Steady tows -> Y_v, N_v, Y_delta, N_delta, X_v, X_delta directly from the two equilibrium equations (5.1), (5.6-5.8).

    Y_v v + Y_delta delta = F ,   N_v v + N_delta delta = F X_T ,   v = -U sin(beta), F = T sin(alpha+beta)

``identify.steady`` finds X_v from the line X_T over 1/F and needs X_delta for the rest; here two or more tows at one rudder angle
give all four, because v changes with the tow point. Without a measured T the equations hold for F/R: X_v and X_delta follow, the
forces in units of R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtri

from ...record.errors import EstimationError
from ...record.results import Measured
from ...simulate.model import Array
from ..steady import SteadyState, common_errors, fit_steady, force_slope, input_covariance
from .common import propagate

ROUNDS = 8
"""Of weights (they depend on the estimate) and estimate, always all of them."""
NAMES = ("y_v", "y_delta_delta", "n_v", "n_delta_delta")


@dataclass(frozen=True)
class SteadyHull:
    """Result of ``fit_steady_hull``.

    Attributes
    ----------
    y_v, n_v : N s/m and N s, at ``speed_m_s`` (per unit of R where T was not measured: s/m and s)
    y_delta_delta, n_delta_delta : rudder force and moment at the tows' rudder angle, with Y*, N* in them, N and N m
    y_delta, n_delta : per radian; None without a rudder angle
    x_v_m, x_delta_m : points of action
    intervals : 95 % interval by name
    covariance : (4, 4), of (y_v, y_delta_delta, n_v, n_delta_delta)
    in_units_of_resistance : T was not measured
    chi2_per_dof : None for two tows
    notes : for the user
    """

    y_v: Measured
    y_delta_delta: Measured
    n_v: Measured
    n_delta_delta: Measured
    y_delta: Measured | None
    n_delta: Measured | None
    x_v_m: Measured
    x_delta_m: Measured
    intervals: dict[str, tuple[float, float]]
    covariance: Array
    in_units_of_resistance: bool
    chi2_per_dof: float | None
    speed_m_s: float
    notes: tuple[str, ...]


def fit_steady_hull(
    tows: Sequence[SteadyState],
    *,
    rudder_rad: float | None = None,
    rudder_sd_rad: float = 0.0,
    resistance_n: float | None = None,
    resistance_sd_n: float = 0.0,
) -> SteadyHull:
    """Fit the four to steady tows at two or more tow points and one rudder setting and speed.

    Parameters
    ----------
    tows : all with a measured T or none (then F/R is used)
    rudder_rad, rudder_sd_rad : delta, positive to port; None = only the products Y_delta delta, N_delta delta
    resistance_n, resistance_sd_n : R where T was not measured; None = results in units of R

    Raises
    ------
    EstimationError : fewer than two tow points, T measured in some tows only, different speeds, or headings too alike

    Errors in alpha, beta, T and X_T are all carried: the misclosure of each tow's two equations is weighted by its covariance.
    """
    tows = list(tows)
    if len({t.tow_point_m for t in tows}) < 2:
        raise EstimationError("Y_v and the rudder force need steady tows at two or more tow points")
    known = [t.tension_n is not None for t in tows]
    if any(known) != all(known):
        raise EstimationError("some tows have a tension and others have none; give it to all or to none")
    speeds = np.array([t.speed_m_s for t in tows])
    if np.ptp(speeds) > 0.02 * speeds.mean():
        raise EstimationError(
            f"the tows' speeds are {speeds.min():g} .. {speeds.max():g} m/s; one rudder force needs one speed"
        )
    v = -speeds * np.sin([t.beta_rad for t in tows])
    if np.ptp(v) < 1e-6 * speeds.mean():
        raise EstimationError("all tows lie at one heading: Y_v and the rudder force cannot be told apart")
    force = np.array([t.force()[0] for t in tows])
    x_t = np.array([t.tow_point_m for t in tows])
    rows, target = _equations(v, force, x_t)
    inputs = input_covariance(tows)
    theta = np.linalg.lstsq(rows, target, rcond=None)[0]
    inverse, weight = np.eye(4), np.eye(len(target))
    for _ in range(ROUNDS):
        slope = _misclosure_slope(tows, theta)
        covariance = slope @ inputs @ slope.T
        covariance += np.eye(len(target)) * (1e-12 * np.abs(target).max()) ** 2
        weight = np.linalg.inv(covariance)
        inverse = np.linalg.inv(rows.T @ weight @ rows)
        # the instruments: v and F as the fit sees them, not as the noise moved them
        theta = _structural(rows, target, weight, theta, tows, inputs)
    rest = target - rows @ theta
    degrees = len(target) - 4
    square = float(rest @ weight @ rest)
    notes, per_dof = [], None
    if degrees > 0:
        per_dof = square / degrees
        if chdtrc(degrees, square) < 0.01:
            inverse = inverse * per_dof
            notes.append(
                f"the tows do not close to within their errors (chi-square {square:.1f} of {degrees}): intervals "
                f"widened {np.sqrt(per_dof):.1f} times; rudder, speed or resistance changed between them, or the hull is not "
                "linear at these angles"
            )
    else:
        notes.append("two tows fix the four numbers without a check; a third tow point would test them")
    in_r = not all(known)
    tension, speed = common_errors(tows)  # T's stands in all four, U's in the two that are over v
    for moved in (tension * theta, speed * theta * [1.0, 0.0, 1.0, 0.0]):
        inverse = inverse + np.outer(moved, moved)
    if in_r and resistance_n is not None:
        relative = resistance_sd_n / resistance_n
        theta, inverse = theta * resistance_n, inverse * resistance_n**2
        inverse = inverse + np.outer(theta, theta) * relative**2
        in_r = False
    elif in_r:
        notes.append(
            "no tension was measured: forces are in units of the resistance R, X_v and X_delta are not affected"
        )
    return _result(theta, inverse, rudder_rad, rudder_sd_rad, in_r, per_dof, float(speeds.mean()), notes)


def _equations(v: Array, force: Array, x_t: Array) -> tuple[Array, Array]:
    zero, one = np.zeros_like(v), np.ones_like(v)
    rows = np.concatenate([np.column_stack([v, one, zero, zero]), np.column_stack([zero, zero, v, one])])
    return rows, np.concatenate([force, force * x_t])


def _misclosure_slope(tows: list[SteadyState], theta: Array) -> Array:
    """d(F - Y_v v - Y_d, F X_T - N_v v - N_d) by (alpha, beta, ln T, X_T), (2n, 4n)."""
    n = len(tows)
    by_force = force_slope(tows)
    slope = np.concatenate([by_force, np.array([[t.tow_point_m] for t in tows]) * by_force])
    for i, tow in enumerate(tows):
        by_beta = -tow.speed_m_s * np.cos(tow.beta_rad)
        slope[i, 4 * i + 1] -= theta[0] * by_beta
        slope[n + i, 4 * i + 1] -= theta[2] * by_beta
        slope[n + i, 4 * i + 3] = tow.force()[0]
    return slope


def _structural(
    rows: Array, target: Array, weight: Array, theta: Array, tows: list[SteadyState], inputs: Array
) -> Array:
    """One Gauss-Newton step of the errors-in-variables fit: rows at the headings corrected by the misclosure."""
    n = len(tows)
    slope = _misclosure_slope(tows, theta)
    corrections = -(inputs @ slope.T @ weight @ (target - rows @ theta)).reshape(n, 4)
    beta = np.array([t.beta_rad for t in tows]) + corrections[:, 1]
    v = -np.array([t.speed_m_s for t in tows]) * np.sin(beta)
    clean, _ = _equations(v, v, v)
    return theta + np.linalg.solve(clean.T @ weight @ clean, clean.T @ weight @ (target - rows @ theta))


def _result(
    theta: Array,
    covariance: Array,
    rudder: float | None,
    rudder_sd: float,
    in_r: bool,
    per_dof: float | None,
    speed: float,
    notes: list[str],
) -> SteadyHull:
    sd = np.sqrt(np.diag(covariance))
    four = [Measured(value=float(v), std=float(s)) for v, s in zip(theta, sd, strict=True)]
    points, spread = propagate(lambda x: np.array([x[2] / x[0], x[3] / x[1]]), theta, covariance)
    x_v, x_delta = (Measured(value=float(points[i]), std=float(np.sqrt(spread[i, i]))) for i in range(2))
    per_rad: list[Measured | None] = [None, None]
    if rudder is not None:
        if rudder == 0.0:
            raise EstimationError("rudder_rad = 0: a rudder amidships gives no Y_delta")
        for place, part in enumerate((four[1], four[3])):
            value = part.value / rudder
            per_rad[place] = Measured(value=value, std=float(np.hypot(part.std / rudder, value * rudder_sd / rudder)))
    half = float(ndtri(0.975))
    named = {**dict(zip(NAMES, four, strict=True)), "x_v_m": x_v, "x_delta_m": x_delta}
    return SteadyHull(
        *four,
        y_delta=per_rad[0],
        n_delta=per_rad[1],
        x_v_m=x_v,
        x_delta_m=x_delta,
        intervals={k: (m.value - half * m.std, m.value + half * m.std) for k, m in named.items()},
        covariance=covariance,
        in_units_of_resistance=in_r,
        chi2_per_dof=per_dof,
        speed_m_s=speed,
        notes=tuple(notes),
    )


def damping_from_known_point(tows: Sequence[SteadyState], x_delta_m: float) -> tuple[Measured, Measured]:
    """(Y_v, N_v = X_v Y_v) of tows with measured T and a known X_delta (4.10, 5.7), through ``identify.fit_steady``.

    Parameters
    ----------
    tows : settled, with T
    x_delta_m : X_delta, m ahead of LCG

    Raises
    ------
    EstimationError : no tension
    """
    fit = fit_steady(list(tows), x_delta_m)
    if fit.y_v is None or fit.n_v is None:
        raise EstimationError("Y_v by (4.10) needs a measured tension")
    return fit.y_v, fit.n_v
