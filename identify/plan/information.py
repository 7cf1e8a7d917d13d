"""Fisher information of a planned run: exact sensitivities, its own nuisances marginalised.

Of one run: the start (side, beta, v, r) is free, y_b and beta_b are free or under their priors, T_i and X_T,i move under
theirs, as in ``fit_runs``. What is left is the information on the six derivatives (relative) and on what all runs share beside
(``commons``, in their prior's sd; a tension that nobody measures: the logarithm of its factor): matrices of different runs add up.

Lines of given tension: the linear form, ``UnitTow``. Lines that keep their length: the full form, ``kept.KeptTow``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import expm

from ...record.priors import DERIVATIVE_NAMES
from ...simulate.model import Array, linear_system
from ..data import RunData
from ..joint.common import Common, commons_of, needs_full
from ..response import TENSION, TOW_POINT, linear_response
from .setting import Setting, TowPlan

GRID_SHARE = 0.08
"""The sum over samples becomes an integral on a grid of this share of the fastest root's time: it errs by 0.05 %."""
FREE_SD = 1e6
"""Prior of a free nuisance over the noise of one sample: as good as none, and the matrices stay invertible."""


@dataclass(frozen=True)
class Course:
    """Where a planned run goes.

    Attributes
    ----------
    y_m, beta_rad : (n,), of the LCG
    angle_rad : (n,), alpha + beta
    reach_m : (n,), of the tow point from the centre line
    line_share : (n,), line force over T taken
    """

    y_m: Array
    beta_rad: Array
    angle_rad: Array
    reach_m: Array
    line_share: Array


class Towed(Protocol):
    """A tow whose motion and sensitivities are known."""

    @property
    def times_s(self) -> Array:
        """(n,), from the release."""
        ...

    @property
    def weights(self) -> Array:
        """(n,), samples that each time stands for."""
        ...

    @property
    def matrix(self) -> Array:
        """(4, 4), of the linear form."""
        ...

    def slopes_of(self, plan: TowPlan) -> Array:
        """Change of (y, beta) with ``RUN_PARAMETERS``, (n, 2, 14 or more)."""
        ...

    def course(self, setting: Setting, plan: TowPlan) -> Course:
        """Where the planned run goes."""
        ...


@dataclass(frozen=True)
class Grid:
    """Times that stand for all samples of a record.

    Attributes
    ----------
    times_s, weights : (n,), from the release; samples that each stands for
    matrix : (4, 4), of the linear form
    """

    times_s: Array
    weights: Array
    matrix: Array


def grid_of(setting: Setting, plan: TowPlan, duration_s: float | None = None) -> Grid:
    """The grid of a plan's X_T, L and U; ``duration_s`` instead of the tank's.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow
    duration_s : of the record instead of the tank's, s
    """
    span = setting.duration_s(plan.speed_m_s) if duration_s is None else duration_s
    matrix, _ = linear_system(setting.hull_at(plan.speed_m_s), setting.tow(plan))
    fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
    rate = setting.noise.rate_hz
    count = max(2, int(np.floor(span * rate)) + 1)
    every = max(1, int(GRID_SHARE / fastest * rate))
    steps = max(1, (count - 1) // every)
    times = np.linspace(0.0, (count - 1) / rate, steps + 1)
    weights = np.full(len(times), times[1] * rate)
    weights[[0, -1]] = (times[1] * rate + 1) / 2  # the trapezoid rule, and half a sample more at each end
    return Grid(times, weights, matrix)


@dataclass(frozen=True)
class UnitTow:
    """Tow of one (X_T, L, U) for a release at y = 1 m and for one at beta = 1 rad, both at rest; the linear form adds them.

    Attributes
    ----------
    times_s : (n,), from the release
    weights : (n,), samples that each grid point stands for
    states : (2, n, 4), y, beta, v, r
    rates : (2, n, 4), their time derivatives
    slopes : (2, n, 2, 14), change of (y, beta) with ``RUN_PARAMETERS``
    matrix : (4, 4), of the linear form
    """

    times_s: Array
    weights: Array
    states: Array
    rates: Array
    slopes: Array
    matrix: Array

    def released(self, plan: TowPlan) -> tuple[Array, Array, Array]:
        """States (n, 4), rates (n, 4) and slopes (n, 2, 14) of the planned release; start columns are those of a unit start."""
        size = np.array([plan.release_y_m, plan.release_beta_rad])
        slopes = np.tensordot(size, self.slopes, axes=1)
        slopes[:, :, 6:10] = self.slopes[0, :, :, 6:10]
        return np.tensordot(size, self.states, axes=1), np.tensordot(size, self.rates, axes=1), slopes

    def slopes_of(self, plan: TowPlan) -> Array:
        """Slopes (n, 2, 14) of the planned release."""
        return self.released(plan)[2]

    def course(self, setting: Setting, plan: TowPlan) -> Course:
        """Where the planned run goes by the linear form, and what its surge does to the line."""
        states, rates, _ = self.released(plan)
        y, beta = states[:, 0], states[:, 1]
        length, x_t = plan.line_length_m, plan.tow_point_m
        angle = y / length + (1 + x_t / length) * beta
        share = _line_share(setting, plan, states, rates)
        return Course(y, beta, angle, y + x_t * beta, share)


def _line_share(setting: Setting, plan: TowPlan, states: Array, rates: Array) -> Array:
    """(T + m x'')/T, (n,), with x'' of the LCG on a taut line (2.10) to second order in the angles.

    x_CG = -L cos a - X_T cos b, so x'' = L (a'^2 + a a'') + X_T (b'^2 + b b''). The model's mass alone is taken: its
    added mass in surge (some 5 %) and the resistance's change are not known here.
    """
    x_t, length = plan.tow_point_m, plan.line_length_m
    y, beta, _, r = states.T
    y_rate, _, v_rate, r_rate = rates.T
    y_curve = v_rate + plan.speed_m_s * r
    alpha, a_rate, a_curve = (y + x_t * beta) / length, (y_rate + x_t * r) / length, (y_curve + x_t * r_rate) / length
    surge = length * (a_rate**2 + alpha * a_curve) + x_t * (r**2 + beta * r_rate)
    return 1 + setting.mass_kg * surge / setting.tow(plan).resistance


def unit_tow(setting: Setting, plan: TowPlan, duration_s: float | None = None) -> UnitTow:
    """The unit tow of a plan's X_T, L and U; ``duration_s`` instead of the tank's.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow
    duration_s : of the record instead of the tank's, s
    """
    grid, tow = grid_of(setting, plan, duration_s), setting.tow(plan)
    times = grid.times_s
    starts = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, -plan.speed_m_s, 0.0]])
    states = np.empty((2, len(times), 4))
    states[:, 0] = starts
    step = expm(grid.matrix * times[1])
    for k in range(1, len(times)):
        states[:, k] = states[:, k - 1] @ step.T
    data = planned_record(setting, plan, times)
    tail = [tow.resistance, tow.tow_point_m, tow.line_length_m, tow.speed_m_s]
    slopes = [
        linear_response(data, np.array([*setting.values, *start, *tail]), setting.hull.speed_m_s)[1] for start in starts
    ]
    return UnitTow(times, grid.weights, states, states @ grid.matrix.T, np.array(slopes), grid.matrix)


def planned_record(setting: Setting, plan: TowPlan, times: Array) -> RunData:
    """The planned run as the estimators take it, without its motion.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow
    times : (n,), s from the release
    """
    nothing = np.zeros(len(times))
    return RunData(
        name="planned",
        t_s=times,
        y_m=nothing,
        beta_rad=nothing,
        covariance=np.zeros((len(times), 2, 2)),
        common=np.zeros((0, len(times), 2)),
        common_key="",
        tow=setting.tow(plan),
        tension=None,
        speed=None,
        priors=setting.priors,
        assumed_sigma=False,
        mass_kg=setting.mass_kg,
        length_pp_m=setting.length_pp_m,
        tension_stated=setting.gauge,
        missing=setting.missing,
    )


def commons(setting: Setting) -> tuple[Common, ...]:
    """What all runs share beside the six, in the order of the matrices' last rows: the fit's own, at the guess's speed."""
    straight = TowPlan(1.0, 1.0, setting.hull.speed_m_s, 0.0)
    found = commons_of([planned_record(setting, straight, np.zeros(1))])
    return tuple(c for c in found if setting.line == "surge" or not needs_full(c.name))


def run_information(setting: Setting, plan: TowPlan, tow: Towed, from_s: float = 0.0) -> Array:
    """Information (6 + c, 6 + c) of one run on the relative derivatives and the c ``commons``; 0 where its motion cannot be.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow
    tow : of the plan's X_T, L and U; on a line that keeps its length, of its release
    from_s : samples before are dropped (what a late start of the record costs)
    """
    slopes = tow.slopes_of(plan)
    priors, noise, tension = setting.priors, setting.noise, setting.tow(plan).resistance
    shared_by_all = commons(setting)
    if not np.isfinite(slopes).all():
        return np.zeros((6 + len(shared_by_all),) * 2)
    keep = tow.times_s >= from_s
    columns = [slopes[:, :, i] * setting.scale[i] for i in range(6)]
    for common in shared_by_all:
        size = float(common.sd[0])
        if common.factor:
            size *= tension
        elif common.name == "speed":
            size *= plan.speed_m_s / setting.hull.speed_m_s
        columns.append(slopes[:, :, common.place] * size)
    shared = len(columns)
    # nuisances in units of their prior, or, free ones, as they are
    known: list[float] = []
    for i in range(6, 10):
        columns.append(slopes[:, :, i])
        known.append(0.0)
    for channel, sd in enumerate((priors.y_bias_sd_m, priors.beta_bias_sd_rad)):
        if sd == 0:
            continue
        column = np.zeros(slopes.shape[:2])
        column[:, channel] = 1.0 if sd is None else sd
        columns.append(column)
        known.append(0.0 if sd is None else 1.0)
    for place, sd in ((TENSION, setting.tension_scatter(plan) * tension), (TOW_POINT, priors.tow_point_sd_m)):
        if sd:
            columns.append(slopes[:, :, place] * sd)
            known.append(1.0)
    weight = (
        np.sqrt(tow.weights[keep])[:, None, None] / np.array([noise.sigma_y_m, noise.sigma_beta_rad])[None, :, None]
    )
    j = (np.stack(columns, axis=-1)[keep] * weight).reshape(-1, len(columns))
    full = j.T @ j
    full[shared:, shared:] += np.diag(known)
    own = full[shared:, shared:]
    size = np.sqrt(np.diag(own))
    size = np.where(size > 0, size, 1.0)
    scaled = own / size[:, None] / size[None, :] + np.eye(len(own)) / FREE_SD**2
    across = full[shared:, :shared] / size[:, None]
    return full[:shared, :shared] - across.T @ np.linalg.solve(scaled, across)


def prior_information(setting: Setting) -> Array:
    """Information (6 + c, 6 + c) that is there before any run: priors on derivatives and on what all runs share.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    """
    shared = commons(setting)
    matrix = np.zeros((6 + len(shared), 6 + len(shared)))
    for i, name in enumerate(DERIVATIVE_NAMES):
        prior = getattr(setting.priors.derivatives, name)
        if prior is not None:
            matrix[i, i] = (setting.scale[i] / prior.std) ** 2
    for i, common in enumerate(shared, start=6):
        matrix[i, i] = 1.0 if common.known else 0.0
    return matrix


def whole_covariance(information: Array) -> Array:
    """Covariance (..., k, k) from information (..., k, k), priors included."""
    size = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
    scaled = information / size[..., :, None] / size[..., None, :]
    # information that is not there at all leaves a very large variance, not an error
    inverse = np.linalg.inv(scaled + np.eye(scaled.shape[-1]) * 1e-14)
    return inverse / size[..., :, None] / size[..., None, :]


def relative_covariance(information: Array) -> Array:
    """Covariance (..., 6, 6) of the relative derivatives from information (..., 6 + c, 6 + c), priors included.

    Parameters
    ----------
    information : (..., 6 + c, 6 + c)
    """
    return whole_covariance(information)[..., :6, :6]
