"""Fisher information of a planned run: exact sensitivities of the linear form, its own nuisances marginalised.

Of one run: the start (y, beta, v, r) is free, y_b and beta_b are free or under their priors, T_i and X_T,i move under
theirs, as in ``fit_runs``. What is left is the information on the six derivatives (relative) and on the errors of T, L and U that
are common to all runs (in their prior's sd): matrices of different runs add up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from ...record.priors import DERIVATIVE_NAMES, Priors
from ...simulate.model import Array, linear_system
from ..data import RunData
from ..response import LINE_LENGTH, SPEED, TENSION, TOW_POINT, linear_response
from .setting import Setting, TowPlan

GRID_SHARE = 0.08
"""The sum over samples becomes an integral on a grid of this share of the fastest root's time: it errs by 0.05 %."""
FREE_SD = 1e6
"""Prior of a free nuisance over the noise of one sample: as good as none, and the matrices stay invertible."""


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


def unit_tow(setting: Setting, plan: TowPlan, duration_s: float | None = None) -> UnitTow:
    """The unit tow of a plan's X_T, L and U; ``duration_s`` instead of the tank's."""
    span = setting.duration_s(plan.speed_m_s) if duration_s is None else duration_s
    tow, hull = setting.tow(plan), setting.hull_at(plan.speed_m_s)
    matrix, _ = linear_system(hull, tow)
    fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
    rate = setting.noise.rate_hz
    count = max(2, int(np.floor(span * rate)) + 1)
    every = max(1, int(GRID_SHARE / fastest * rate))
    steps = max(1, (count - 1) // every)
    times = np.linspace(0.0, (count - 1) / rate, steps + 1)
    weights = np.full(len(times), times[1] * rate)
    weights[[0, -1]] = (times[1] * rate + 1) / 2  # the trapezoid rule, and half a sample more at each end
    starts = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, -plan.speed_m_s, 0.0]])
    states = np.empty((2, len(times), 4))
    states[:, 0] = starts
    step = expm(matrix * times[1])
    for k in range(1, len(times)):
        states[:, k] = states[:, k - 1] @ step.T
    data = _record(setting, plan, times)
    assert tow.tension_n is not None
    tail = [tow.tension_n, tow.tow_point_m, tow.line_length_m, tow.speed_m_s]
    slopes = [
        linear_response(data, np.array([*setting.values, *start, *tail]), setting.hull.speed_m_s)[1] for start in starts
    ]
    return UnitTow(times, weights, states, states @ matrix.T, np.array(slopes), matrix)


def _record(setting: Setting, plan: TowPlan, times: Array) -> RunData:
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
    )


def common_names(priors: Priors) -> tuple[str, ...]:
    """Errors common to all runs that the priors let move, in the order of the matrices' last rows."""
    stated = {
        "tension": priors.tension_common_sd_rel,
        "line_length": priors.line_length_sd_m,
        "speed": priors.speed_sd_rel,
    }
    return tuple(name for name, sd in stated.items() if sd)


def run_information(setting: Setting, plan: TowPlan, unit: UnitTow, from_s: float = 0.0) -> Array:
    """Information (6 + c, 6 + c) of one run on the relative derivatives and the c common errors.

    Parameters
    ----------
    unit : of the plan's X_T, L and U
    from_s : samples before are dropped (what a late start of the record costs)
    """
    _, _, slopes = unit.released(plan)
    priors, noise, tow = setting.priors, setting.noise, setting.tow(plan)
    assert tow.tension_n is not None
    keep = unit.times_s >= from_s
    sizes = {"tension": tow.tension_n * priors.tension_common_sd_rel, "line_length": priors.line_length_sd_m}
    sizes["speed"] = tow.speed_m_s * priors.speed_sd_rel
    places = {"tension": TENSION, "line_length": LINE_LENGTH, "speed": SPEED}
    columns = [slopes[:, :, i] * setting.scale[i] for i in range(6)]
    names = common_names(priors)
    columns += [slopes[:, :, places[name]] * sizes[name] for name in names]
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
    tension_sd = float(np.hypot(priors.tension_sd_rel * tow.tension_n, noise.tension_sd_n))
    for place, sd in ((TENSION, tension_sd), (TOW_POINT, priors.tow_point_sd_m)):
        if sd:
            columns.append(slopes[:, :, place] * sd)
            known.append(1.0)
    weight = (
        np.sqrt(unit.weights[keep])[:, None, None] / np.array([noise.sigma_y_m, noise.sigma_beta_rad])[None, :, None]
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
    """Information (6 + c, 6 + c) that is there before any run: priors on derivatives and on common errors."""
    names = common_names(setting.priors)
    matrix = np.zeros((6 + len(names), 6 + len(names)))
    for i, name in enumerate(DERIVATIVE_NAMES):
        prior = getattr(setting.priors.derivatives, name)
        if prior is not None:
            matrix[i, i] = (setting.scale[i] / prior.std) ** 2
    for i in range(6, len(matrix)):
        matrix[i, i] = 1.0
    return matrix


def relative_covariance(information: Array) -> Array:
    """Covariance (..., 6, 6) of the relative derivatives from information (..., 6 + c, 6 + c), priors included."""
    size = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
    scaled = information / size[..., :, None] / size[..., None, :]
    # information that is not there at all leaves a very large variance, not an error
    inverse = np.linalg.inv(scaled + np.eye(scaled.shape[-1]) * 1e-14)
    return (inverse / size[..., :, None] / size[..., None, :])[..., :6, :6]
