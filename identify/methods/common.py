"""What the methods share: the record they take, the six derivatives they give, and the delta method between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...record.results import Measured
from ...simulate.model import DERIVATIVE_UNITS, Array, Tow, linear_system, sway_yaw_acceleration
from ...simulate.model import Hull as _Hull
from ..data import LARGEST, LONGEST_S, RunData, beyond_all

DIFFERENCE_SHARE = 1e-5
"""Step of the central differences relative to the value, or to its standard deviation where that is larger."""


@dataclass(frozen=True)
class Record:
    """One run's motion for the methods that need no weights.

    Attributes
    ----------
    t_s : (n,), rising
    y_m, beta_rad : (n,), y_CG from the post, heading
    tow : Tow with a constant tension_n
    """

    t_s: Array
    y_m: Array
    beta_rad: Array
    tow: Tow

    @classmethod
    def of(cls, data: RunData) -> Record:
        """The record of a run prepared by ``identify.run_data``; of histories of T and U only the means, in the tow."""
        return cls(data.t_s, data.y_m, data.beta_rad, data.tow)

    @property
    def step_s(self) -> float:
        """The sampling step; raises EstimationError where the samples are not even to 1 %."""
        steps = np.diff(self.t_s)
        if len(steps) < 4 or np.abs(steps - steps.mean()).max() > 0.01 * steps.mean():
            raise EstimationError("this method needs evenly sampled records without gaps; resample or use fit_runs")
        return float(steps.mean())


@dataclass(frozen=True)
class SixEstimate:
    """The six linear derivatives with what is known of their errors.

    Attributes
    ----------
    six : (6,), in the order of ``DERIVATIVE_UNITS``, SI
    covariance : (6, 6); from the inputs' stated covariance or the residuals, as the method says
    notes : for the user
    """

    six: Array
    covariance: Array
    notes: tuple[str, ...] = ()

    @property
    def sd(self) -> Array:
        """Standard deviations, (6,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def named(self) -> dict[str, Measured]:
        """Value and standard deviation by name."""
        return {n: Measured(value=float(v), std=float(s)) for n, v, s in zip(DERIVATIVE_UNITS, self.six, self.sd)}


def check_series(t_s: Array, *values: Array, least: int = 1) -> None:
    """EstimationError unless there are ``least`` samples, all finite and none beyond LARGEST, at times that rise strictly.

    Parameters
    ----------
    t_s : (n,) times, s
    least : samples that are needed
    values : (n,) each
    """
    t_s = np.asarray(t_s, dtype=float)
    if len(t_s) < max(least, 1):
        raise EstimationError(f"{len(t_s)} samples; at least {least} are needed")
    if any(np.shape(one)[:1] != t_s.shape for one in values):
        raise EstimationError(f"{len(t_s)} times, and series of other lengths beside them")
    series = [np.asarray(one, dtype=float) for one in values]
    if not all(np.isfinite(one).all() for one in (t_s, *series)):
        raise EstimationError("the record holds values that are not finite; leave these samples out")
    for one in series:
        beyond = np.argwhere(np.abs(one) > LARGEST)
        if len(beyond):
            raise EstimationError(f"sample {beyond[0][0] + 1} {beyond_all(float(one[tuple(beyond[0])]))}")
    if not (np.diff(t_s) > 0).all():
        raise EstimationError("the times of the record do not rise strictly")
    if t_s[-1] - t_s[0] > LONGEST_S:
        raise EstimationError(f"the record lasts {t_s[-1] - t_s[0]:g} s; at most {LONGEST_S:g} s are expected")


def jacobian(function: Callable[[Array], Array], values: Array, scale: Array | None = None) -> Array:
    """Slope of ``function`` (m,) at ``values`` (n,), (m, n), by central differences.

    Parameters
    ----------
    function : of (n,) values
    values : (n,)
    scale : (n,), standard deviations of the values; a step is 1e-5 of the larger of value and scale
    """
    values = np.asarray(values, dtype=float)
    size = np.abs(values) if scale is None else np.maximum(np.abs(values), scale)
    steps = DIFFERENCE_SHARE * np.where(size > 0, size, 1.0)
    columns = []
    for index, step in enumerate(steps):
        up, down = values.copy(), values.copy()
        up[index] += step
        down[index] -= step
        columns.append((np.asarray(function(up)) - np.asarray(function(down))) / (2 * step))
    return np.stack(columns, axis=-1)


def propagate(function: Callable[[Array], Array], values: Array, covariance: Array) -> tuple[Array, Array]:
    """Value of ``function`` and its covariance to first order (delta method).

    Parameters
    ----------
    function : of (n,) values
    values : (n,)
    covariance : (n, n) of the values
    """
    values = np.asarray(values, dtype=float)
    slope = jacobian(function, values, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    return np.asarray(function(values)), slope @ covariance @ slope.T


def covariance_of(sds: Array | tuple[float, ...]) -> Array:
    """Diagonal covariance of independent errors."""
    return np.diag(np.square(np.asarray(sds, dtype=float)))


def constant_tension(tow: Tow) -> float:
    """T of a tow; raises EstimationError where it is not stated."""
    if tow.tension_n is None or tow.tension_n <= 0:
        raise EstimationError(f"tension_n = {tow.tension_n}; this method needs a constant tension above 0")
    return tow.tension_n


def shared_tow(tows: list[Tow]) -> tuple[float, float, float]:
    """T, L, U that all tows share; raises EstimationError where they differ by more than 1e-9 of their size."""
    wanted = [(constant_tension(t), t.line_length_m, t.speed_m_s) for t in tows]
    for name, column in zip(("tension_n", "line_length_m", "speed_m_s"), np.array(wanted).T, strict=True):
        if np.ptp(column) > 1e-9 * abs(column[0]):
            raise EstimationError(f"{name} is {column.min():g} .. {column.max():g}; (9.3) needs one value in all tows")
    return wanted[0]


def balance(v_rate: Array, r_rate: Array, v: Array, r: Array, side: Array, moment: Array) -> tuple[Array, Array]:
    """The equations of motion (2.18) as equations for the six derivatives: rows @ six = right.

    Parameters
    ----------
    v_rate, r_rate, v, r : (n,), real or complex
    side, moment : (n,), everything beside the linear hull

    Returns
    -------
    rows : (2, n, 6), sway and yaw
    right : (2, n)

    The rows are the residual m' v' - ... of ``simulate.model.sway_yaw_acceleration`` on unit derivatives: where one
    derivative is 1 and both masses are 1, its accelerations are that derivative's own column.
    """
    rows = np.zeros((2, len(v), 6), dtype=np.result_type(v, v_rate, side))
    for index in range(2, 6):
        unit = np.zeros(6)
        unit[:2], unit[index] = 1.0, 1.0
        rows[0, :, index], rows[1, :, index] = sway_yaw_acceleration(_Hull(*unit, speed_m_s=1.0), v, r, 0.0, 0.0)
    rows[0, :, 0], rows[1, :, 1] = -v_rate, -r_rate
    return rows, -np.stack([side, moment])


def sway_velocity(y_rate: Array, beta: Array, tow: Tow) -> Array:
    """v = y' - U beta (2.12), from the first row of the linear form.

    Parameters
    ----------
    y_rate : y', m/s
    beta : heading, rad
    tow : T, X_T, L, U of the tow
    """
    matrix, _ = linear_system(_UNIT_HULL, tow)
    return (y_rate - matrix[0, 1] * beta) / matrix[0, 2]


_UNIT_HULL = _Hull(1.0, 1.0, -1.0, 0.0, 0.0, -1.0, speed_m_s=1.0)
"""Any hull will do: the first row of the linear form is kinematics."""
