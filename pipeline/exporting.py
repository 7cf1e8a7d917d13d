"""Results for other programs: a run's tables and derivatives for MATLAB, the linear tow model for control design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..__version__ import __version__
from ..record.errors import InputError, TowlineError
from ..record.exports import (
    MAT_SCHEMA,
    MAT_VERSION,
    Pole,
    StateSpaceFile,
    derivatives_covariance,
    mat_derivatives,
    mat_run,
    write_mat,
)
from ..record.files import sha256_of_file
from ..record.results import DerivativesFile, Measured, read_result
from ..record.run import RUN_FILE, Run, all_inputs, read_run

if TYPE_CHECKING:
    from ..simulate.model import Array, Hull, Tow
    from .progress import Progress

STATES = ("y_m", "beta_rad", "v_m_s", "r_rad_s")
INPUTS = ("side_force_n", "yaw_moment_n_m", "post_y_m")
OUTPUTS = ("y_cg_m", "beta_rad", "alpha_rad")
DERIVATIVES = "derivatives.json"


@dataclass(frozen=True)
class LinearModel:
    """x' = a x + b u + constant, output c x + d u + output_constant; x, u and outputs as STATES, INPUTS, OUTPUTS.

    Attributes
    ----------
    a, b, c, d : (4, 4), (4, 3), (3, 4), (3, 3)
    constant, output_constant : (4,), (3,)
    """

    a: Array
    b: Array
    c: Array
    d: Array
    constant: Array
    output_constant: Array


def linear_model(hull: Hull, tow: Tow) -> LinearModel:
    """The linear form (2.20, 8.26) with a lateral force and a moment at the LCG and the post's displacement as inputs.

    A and the constant are ``simulate.linear_system``; the force's columns are ``sway_yaw_acceleration`` of unit forces; the line
    acts on y - y_o, so that the post's column is A's first with its sign turned; alpha = (y + X_T beta + Y_T - y_o)/L (2.17).

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow

    Raises
    ------
    ValueError : the tow has no constant tension
    """
    from ..simulate.model import linear_system, sway_yaw_acceleration

    here = hull.at_speed(tow.speed_m_s)
    a, constant = linear_system(here, tow)
    unit = np.array([sway_yaw_acceleration(here, 0.0, 0.0, *force) for force in ((1.0, 0.0), (0.0, 1.0))])
    b = np.zeros((4, 3))
    b[2:, :2] = unit.T
    b[:, 2] = 0.0 - a[:, 0]
    length = tow.line_length_m
    c, d = np.zeros((3, 4)), np.zeros((3, 3))
    c[0, 0] = c[1, 1] = 1.0
    c[2, :2] = 1 / length, tow.tow_point_m / length
    d[2, 2] = -1 / length
    return LinearModel(a, b, c, d, constant, np.array([0.0, 0.0, tow.tow_point_offset_m / length]))


def state_space(source: str | Path, run_folder: str | Path | None = None) -> StateSpaceFile:
    """The linear model of derivatives.json at a run's settings.

    Parameters
    ----------
    source : derivatives.json
    run_folder : whose speed, line, tow point and tension are taken; None: the folder above the out/ in which source lies

    Raises
    ------
    InputError, TowlineError : a file cannot be used, no run is known, or the run states no tension
    """
    from ..identify.methods.common import propagate
    from ..simulate.model import DERIVATIVE_UNITS, Hull

    source = Path(source)
    file = read_result(source, DerivativesFile)
    run = _settings_run(source, run_folder)
    tow, notes = _tow_of(run)
    absent = [name for name in DERIVATIVE_UNITS if name not in file.derivatives]
    if absent:
        raise InputError(source, f"derivatives.{absent[0]}", "missing")
    six = np.array([file.derivatives[name].value for name in DERIVATIVE_UNITS])
    covariance = derivatives_covariance(file, tuple(DERIVATIVE_UNITS))

    def hull(values: Array) -> Hull:
        return Hull(*(float(value) for value in values), speed_m_s=file.speed_m_s)

    def matrix(values: Array) -> Array:
        return linear_model(hull(values), tow).a.ravel()

    def roots(values: Array) -> Array:
        found = _poles(linear_model(hull(values), tow).a)
        return np.concatenate([np.real(found), np.imag(found)])

    model = linear_model(hull(six), tow)
    _, a_covariance = propagate(matrix, six, covariance)
    values, pole_covariance = propagate(roots, six, covariance)
    pole_std = np.sqrt(np.maximum(np.diag(pole_covariance), 0.0))
    poles = [
        Pole(
            real=Measured(value=float(values[i]), std=float(pole_std[i])),
            imag=Measured(value=float(values[i + 4]), std=float(pole_std[i + 4])),
        )
        for i in range(4)
    ]
    if model.constant.any():
        notes.append("the tow point is off the centre line: `constant` holds the rates that it causes at x = 0")
    fitted = file.runs.get(run.name)
    if fitted is not None and fitted.nuisance:
        notes.append("the settings are run.toml's; the fit moved " + ", ".join(sorted(fitted.nuisance)))
    hashes = {source.name: sha256_of_file(source), **all_inputs([run])}
    settings = ("speed_m_s", "line_length_m", "tow_point_m", "tow_point_offset_m", "tension_n")
    return StateSpaceFile(
        tool=__version__,
        inputs=hashes,
        run=run.name,
        settings={name: float(getattr(tow, name)) for name in settings},
        state_names=list(STATES),
        input_names=list(INPUTS),
        output_names=list(OUTPUTS),
        a=model.a.tolist(),
        b=model.b.tolist(),
        c=model.c.tolist(),
        d=model.d.tolist(),
        constant=model.constant.tolist(),
        output_constant=model.output_constant.tolist(),
        a_std=np.sqrt(np.maximum(np.diag(a_covariance), 0.0)).reshape(4, 4).tolist(),
        poles=poles,
        notes=notes,
    )


def _poles(a: Array) -> Array:
    """Eigenvalues by falling real part, of a pair the one above the axis first."""
    found = np.linalg.eigvals(a)
    return found[np.lexsort((-np.imag(found), -np.real(found)))]


def _settings_run(source: Path, run_folder: str | Path | None) -> Run:
    if run_folder is not None:
        return read_run(run_folder)
    above = source.resolve().parent.parent
    if not (above / RUN_FILE).is_file():
        raise InputError(source, "", "no run.toml stands above its folder; say whose settings are taken (--run RUN)")
    return read_run(above)


def _tow_of(run: Run) -> tuple[Tow, list[str]]:
    """The run's tow with a constant tension: its own, or the mean of its history."""
    from ..record.tables import read_history
    from ..simulate.scenario import tow_from_table

    notes: list[str] = []
    table = run.tow
    for key in ("line_length_m", "tow_point_m"):
        run.need(getattr(table, key), f"tow.{key}")
    if table.tension is not None:
        history = read_history(run.path(table.tension), "tension_n")
        mean = float(history["tension_n"].mean())
        notes.append(f"tension_n = {mean:.6g}: mean of {table.tension}")
        table = table.model_copy(update={"tension": None, "tension_n": mean})
    run.need(table.tension_n, "tow.tension_n")
    if table.speed is not None:
        notes.append(f"speed_m_s = {table.speed_m_s:g}: the nominal one; the history {table.speed} is left out")
    return tow_from_table(table), notes


# MATLAB ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Exported:
    """What went into a .mat.

    Attributes
    ----------
    runs : names of the runs
    derivatives : the file they came from; None: there was none
    failed : runs that could not be used, and why
    """

    runs: tuple[str, ...]
    derivatives: Path | None
    failed: dict[str, str]


def export_mat(
    target: str | Path,
    folders: Sequence[str | Path],
    derivatives: str | Path | None = None,
    progress: Progress | None = None,
) -> Exported:
    """Write motion, tracks and derivatives of runs into one .mat.

    Parameters
    ----------
    target : the .mat
    folders : run folders; what was not yet computed (tracks, motion) is computed now
    derivatives : derivatives.json; None: the one in the runs' common out/, if there is one
    progress : is told what is done

    Raises
    ------
    TowlineError : no run could be used
    InputError : ``derivatives`` is named and cannot be read
    """
    from .analysis import compute_motions, output_folder

    batch = compute_motions(folders, progress=progress)
    if not batch.runs:
        raise TowlineError("; ".join(batch.failed.values()) or "no run was given")
    source = Path(derivatives) if derivatives is not None else output_folder(folders) / DERIVATIVES
    content: dict[str, Any] = {"schema": MAT_SCHEMA, "version": float(MAT_VERSION), "tool": __version__}
    content["runs"] = [mat_run(m.run.name, _settings(m.run), m.motion, m.tracks) for m in batch.runs]
    there = derivatives is not None or source.is_file()
    if there:
        content["derivatives"] = mat_derivatives(read_result(source, DerivativesFile))
    write_mat(target, content)
    return Exported(tuple(m.run.name for m in batch.runs), source if there else None, batch.failed)


def _settings(run: Run) -> dict[str, float]:
    """Numbers of run.toml's tow, model and water tables, under their own names (pairs as _x and _y)."""
    found: dict[str, float] = {}
    for table in (run.file.tow, run.file.model, run.file.water):
        if table is None:
            continue
        for name, value in table.model_dump().items():
            if isinstance(value, (int, float)):
                found[name] = float(value)
            elif isinstance(value, tuple) and len(value) == 2:
                stem, _, unit = name.rpartition("_")
                found |= {f"{stem}_x_{unit}": float(value[0]), f"{stem}_y_{unit}": float(value[1])}
    return found
