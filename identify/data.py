"""What the estimators take: a run's motion with its weights, its tow, and its common camera modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from ..record.errors import InputError
from ..record.files import sha256_of_texts
from ..record.priors import Priors
from ..record.run import RUN_FILE, Run
from ..record.tables import read_history
from ..simulate.model import RESISTANCE_EXPONENT, Array, Tow
from ..simulate.scenario import USUAL_X_UDOT, tow_from_table
from .cut import before_cut
from .still import Still

SHORTEST_LOG_S = 2.0
"""A log must share so much of the record's time: a choice."""
MEAN_S = 1.0
"""Step of the clock on which the carriage's acceleration is looked at, so that a log's noise is not taken for one."""
LONGEST_S = 1e6
"""No record is longer: its times are in another unit."""
LARGEST = 1e6
"""No place (m) or angle (rad) of a towed model is larger: it is a fill value for what is missing, or in another unit."""
WATER_KG_M3 = 1000.0
"""Fresh water, for a start and for wide priors only: where it counts, density_kg_m3 of run.toml is used."""
ASSUMED_SIGMA_Y_M = 1e-3
"""With the next line's 0.1 degree."""
ASSUMED_SIGMA_BETA_RAD = np.radians(0.1)
"""Weights of a motion without sigma columns; the fit measures the noise itself, these only start it."""


@dataclass(frozen=True)
class Missing:
    """A force on the hull that no derivative holds, known beforehand: fitted is what is beside it.

    Attributes
    ----------
    force : (t_s from the run's begin, state (4, ...), tow, duration_s, half_width_m) -> Y N, N N m, X N; all broadcast
    half_width_m : of the run's tank; NaN: not known
    """

    force: Callable[..., tuple[Any, Any, Any]]
    half_width_m: float = float("nan")


@dataclass(frozen=True)
class RunData:
    """One run for the estimators.

    Attributes
    ----------
    name : of the run
    t_s : (n,), measured samples only, rising
    y_m, beta_rad : (n,), y_CG measured from the post, heading
    covariance : (n, 2, 2), frame part, of (y m, beta rad)
    common : (k, n, 2), change of (y, beta) with each unit-variance common mode
    common_key : runs with the same key share their modes (same camera, datum, markers)
    lag, lag_key : (l, n, 2), the same of the codec's modes, which go with the way and the speed and not with the place
        (``geometry.lag``); shared by runs of one camera wherever it stood
    tow : Tow; tension_n is the mean of a history, speed_m_s too; of a line that keeps its length tension_n is R
    tension : (times, values) of a history that moves a line of given tension, on the run's clock, or None
    speed : the same of the carriage speed
    priors : of the run
    assumed_sigma : the motion came without sigma
    still : the model held still, as the same camera sees it; None: no such record
    mass_kg, length_pp_m : of the model; the mass is needed where the line keeps its length
    rudder : (times, rad) of a history; else tow.rudder_rad
    gauge : (times, N) of a load cell on a line that keeps its length: an observation of its tension
    tension_stated : R or T is known beside the motion; False: tow.tension_n is a guess of the right order
    trim_rad : of the model, or None where run.toml does not say it
    missing : a force that is known beforehand; None: none. Of all runs of a fit or of none, with one ``force``
    """

    name: str
    t_s: Array
    y_m: Array
    beta_rad: Array
    covariance: Array
    common: Array
    common_key: str
    tow: Tow
    tension: tuple[Array, Array] | None
    speed: tuple[Array, Array] | None
    priors: Priors
    assumed_sigma: bool
    still: Still | None = None
    lag: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    lag_key: str = ""
    mass_kg: float | None = None
    length_pp_m: float = float("nan")
    rudder: tuple[Array, Array] | None = None
    gauge: tuple[Array, Array] | None = None
    tension_stated: bool = True
    trim_rad: float | None = None
    missing: Missing | None = None

    @property
    def steered(self) -> bool:
        """Its rudder is over, or moves."""
        return self.rudder is not None or self.tow.rudder_rad != 0.0

    @property
    def shared(self) -> tuple[tuple[str, Array], ...]:
        """Keys and modes (k, n, 2) of unit variance that are shared with runs of the same keys."""
        sets = (self.common_key, self.common), (self.lag_key, self.lag)
        return tuple((key, modes) for key, modes in sets if len(modes))


def run_data(
    run: Run,
    motion: pd.DataFrame,
    common: Array | None,
    priors: Priors | None = None,
    still: pd.DataFrame | None = None,
    lag: Array | None = None,
) -> RunData:
    """Prepare a run of kind "tow" or "forced".

    Parameters
    ----------
    run : the run folder as read
    motion : as ``record.read_motion`` gives or ``geometry.motion_from_tracks`` makes
    common : (k, n, 3) of ``geometry.Motion``, rows as ``motion``; None = none known
    priors : instead of the run's own
    still : motion of the static record ([noise] static), or None
    lag : (l, n, 3), like ``common``

    Raises
    ------
    InputError : a free run, no tension (line = "constant"), or fewer than 20 measured samples
    """
    where = run.folder / RUN_FILE
    if run.file.kind == "free":
        raise InputError(
            where, "kind", '"free": this estimator needs the line\'s force; kind "tow" or "forced" is expected'
        )
    table = run.tow
    measured = measured_rows(run, motion)
    rows = motion[measured]
    times = rows["t_s"].to_numpy()
    check_times(run, times)
    tow = tow_from_table(table)
    tension = speed = gauge = None
    if table.tension is not None:
        whole = table.line == "constant"
        tension = history_of(run, table.tension, "tension_n", table.tension_delay_s, times, whole)
    elif "tension_n" in rows and rows["tension_n"].notna().all():
        tension = (times, rows["tension_n"].to_numpy())
    elif table.tension_n is None and table.line == "constant":
        raise InputError(where, "tow.tension_n", "missing key; the derivatives are proportional to the tension")
    if tension is not None:
        there = times[(times >= tension[0][0]) & (times <= tension[0][-1])]
        tow = replace(tow, tension_n=float(np.interp(there, *tension).mean()), resistance_n=None)
    elif table.tension_n is None:
        tow = replace(tow, tension_n=usual_resistance(run.model.mass_kg, run.model.length_pp_m, tow.speed_m_s))
    stated = tension is not None or table.tension_n is not None
    if table.line == "surge":
        tension, gauge = None, tension
    if table.speed is not None:
        speed = history_of(run, table.speed, "speed_m_s", table.speed_delay_s, times)
        tow = replace(tow, speed_m_s=float(np.interp(times, *speed).mean()))
        if table.line == "surge":
            _check_taut(run, tow, speed, times)
    if tow.tension_n is not None and tow.tension_n <= 0:
        raise InputError(where, "tow.tension_n", f"{tow.tension_n:g} N; a tow needs a tension above 0")
    if tow.speed_m_s <= 0:
        raise InputError(where, "tow.speed_m_s", f"{tow.speed_m_s:g} m/s; a tow needs a speed above 0")
    covariance, assumed = stated_covariance(rows)
    modes, lags = (np.zeros((0, len(rows), 2)) if m is None else m[:, measured, :2] for m in (common, lag))
    return RunData(
        name=run.name,
        t_s=times,
        y_m=rows["y_cg_m"].to_numpy() - tow.post_m[1],
        beta_rad=rows["beta_rad"].to_numpy(),
        covariance=covariance,
        common=modes,
        common_key=common_key(run),
        tow=replace(tow, post_m=(tow.post_m[0], 0.0)),
        tension=tension,
        speed=speed,
        priors=run.file.priors if priors is None else priors,
        assumed_sigma=assumed,
        still=None if still is None else _still(still),
        lag=lags,
        lag_key=lag_key(run),
        mass_kg=run.model.mass_kg,
        length_pp_m=run.model.length_pp_m,
        rudder=None
        if table.rudder is None
        else history_of(run, table.rudder, "rudder_rad", table.rudder_delay_s, times),
        gauge=gauge,
        tension_stated=stated,
        trim_rad=run.model.trim_rad,
    )


def measured_rows(run: Run, motion: pd.DataFrame) -> Array:
    """(n,) which rows of the motion are measured and lie within the span; InputError where fewer than 20 are.

    Parameters
    ----------
    run : the run folder as read
    motion : motion table
    """
    span = run.file.source.span_s
    measured = (motion["status"] == "measured").to_numpy() & np.isfinite(motion[["y_cg_m", "beta_rad"]].to_numpy()).all(
        axis=1
    )
    if span is not None:
        measured &= motion["t_s"].between(span[0], span[1]).to_numpy()
    measured &= before_cut(run, motion)  # named by analysis.identify_batch
    check_sizes(run, motion, measured, ("y_cg_m", "beta_rad"))
    if measured.sum() < 20:
        raise InputError(run.source_path, "", f"{int(measured.sum())} measured samples; at least 20 are needed")
    return measured


def usual_resistance(mass_kg: float, length_pp_m: float, speed_m_s: float) -> float:
    """R of a bare hull of this size, N: where a fit begins that weighs the model and knows no tension.

    rho/2 S U^2 C_T with C_T 0.0045 and the wetted surface S = 2.6 sqrt(displacement length) (Taylor).

    Parameters
    ----------
    mass_kg : of the model, kg
    length_pp_m : LBP, m
    speed_m_s : U, m/s
    """
    surface = 2.6 * np.sqrt(mass_kg / WATER_KG_M3 * length_pp_m)
    return float(0.5 * WATER_KG_M3 * surface * speed_m_s**2 * 0.0045)


def _check_taut(run: Run, tow: Tow, speed: tuple[Array, Array], times: Array) -> None:
    """InputError where a straight tow behind this carriage is never taut: R (U/U_0)^n + (m - X_udot) U' < 0 (theory.md 10)."""
    clock = np.arange(times[0], times[-1], MEAN_S)
    here = np.interp(clock, *speed)
    if len(clock) < 3 or tow.tension_n is None:
        return
    gain = np.gradient(here, clock)
    mass = run.model.mass_kg * (1 - USUAL_X_UDOT)
    if (tow.tension_n * (here / tow.speed_m_s) ** RESISTANCE_EXPONENT + mass * gain).max() < 0:
        raise InputError(
            run.path(run.tow.speed or ""),
            "column speed_m_s",
            f"falls by {-gain.max():.3g} m/s2 and more throughout; the line is slack where the carriage slows by more than "
            f"R/(m - X_udot) = {tow.tension_n / mass:.2g} m/s2",
        )


def check_times(run: Run, times: Array) -> None:
    """InputError unless the times of a motion are finite and rise strictly, as ``read_motion`` sees to.

    Parameters
    ----------
    run : the run folder as read
    times : (n,), s
    """
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise InputError(run.source_path, "t_s", "times must be finite and rise strictly")
    if len(times) > 1 and times[-1] - times[0] > LONGEST_S:
        raise InputError(
            run.source_path, "t_s", f"from {times[0]:g} to {times[-1]:g} s; a tow lasts less than {LONGEST_S:g} s"
        )


def check_sizes(run: Run, motion: pd.DataFrame, rows: Array, columns: Sequence[str]) -> None:
    """InputError where a place or an angle of these rows is beyond all that a towed model reaches.

    Parameters
    ----------
    run : the run folder as read
    motion : motion table
    rows : (n,) which of its rows are used
    columns : of places and angles
    """
    for column in columns:
        values = motion[column].to_numpy()
        beyond = np.flatnonzero(rows & (np.abs(values) > LARGEST))
        if len(beyond):
            raise InputError(run.source_path, f"row {beyond[0] + 1}, {column}", beyond_all(values[beyond[0]]))


def beyond_all(value: float) -> str:
    """What is said of a place or an angle that is larger than LARGEST."""
    return f"is {value:g}; at most {LARGEST:g} m or rad are expected (an empty cell says that a value is missing)"


def _still(motion: pd.DataFrame) -> Still:
    rows = motion[(motion["status"] == "measured") & motion[["y_cg_m", "beta_rad"]].notna().all(axis=1)]
    return Still(rows["t_s"].to_numpy(), rows[["y_cg_m", "beta_rad"]].to_numpy(), stated_covariance(rows)[0])


def history_of(
    run: Run, name: str, column: str, delay_s: float, times: Array, whole: bool = True
) -> tuple[Array, Array]:
    """A history on the recording's clock; ``whole``: it must cover all of the record, else ``SHORTEST_LOG_S`` of it.

    Parameters
    ----------
    run : the run folder as read
    name : of the history's file
    column : of its table
    delay_s : added to its clock
    times : (n,) of the record, s
    whole : it must cover all of the record
    """
    table = read_history(run.path(name), column)
    clock = table["t_s"].to_numpy() + delay_s
    together = min(clock[-1], times[-1]) - max(clock[0], times[0])
    if (whole and (clock[0] > times[0] or clock[-1] < times[-1])) or together < SHORTEST_LOG_S:
        raise InputError(
            run.path(name),
            "column t_s",
            f"covers {clock[0]:.2f} .. {clock[-1]:.2f} s of the recording's clock; {times[0]:.2f} .. {times[-1]:.2f} s is needed",
        )
    return clock, table[column].to_numpy()


def stated_covariance(rows: pd.DataFrame) -> tuple[Array, bool]:
    """(n, 2, 2), frame part, of (y m, beta rad) of motion rows; True: they state no sigma, it is assumed."""
    covariance = np.zeros((len(rows), 2, 2))
    known = {"sigma_y_cg_m", "sigma_beta_rad"} <= set(rows.columns)
    if known:
        sd = rows[["sigma_y_cg_m", "sigma_beta_rad"]].to_numpy()
        known = bool(np.isfinite(sd).all() and (sd > 0).all())
    if not known:
        covariance[:, 0, 0], covariance[:, 1, 1] = ASSUMED_SIGMA_Y_M**2, ASSUMED_SIGMA_BETA_RAD**2
        return covariance, True
    sd = rows[["sigma_y_cg_m", "sigma_beta_rad"]].to_numpy()
    covariance[:, 0, 0], covariance[:, 1, 1] = sd[:, 0] ** 2, sd[:, 1] ** 2
    if "cov_y_cg_beta_m_rad" in rows:
        cross = np.nan_to_num(rows["cov_y_cg_beta_m_rad"].to_numpy())
        covariance[:, 0, 1] = covariance[:, 1, 0] = np.clip(
            cross, -0.999 * sd[:, 0] * sd[:, 1], 0.999 * sd[:, 0] * sd[:, 1]
        )
    return covariance, False


def common_key(run: Run) -> str:
    """The same for runs that share camera, datum and marks, and with them the camera's common errors.

    Where a mark is first seen, and how it looks, is the recording's own: it changes no place in the tank.
    """
    file = run.file
    marks = [(m.name, m.body_m, m.depth_m, m.on) for m in file.marker]
    return sha256_of_texts(repr(file.camera), repr(file.datum), repr(marks), *_second_camera(run))


def lag_key(run: Run) -> str:
    """The same for runs whose lags and pulls are the same numbers: of one camera, wherever it stood."""
    names = (m.name for m in run.file.marker)
    return sha256_of_texts("lag", repr(run.file.camera), *names, *_second_camera(run)[:1])


def _second_camera(run: Run) -> tuple[str, ...]:
    """Lens and datum of the second of two cameras; nothing of one alone."""
    return tuple(text for camera in run.file.cameras[1:] for text in (repr(camera.lens), repr(camera.datum)))
