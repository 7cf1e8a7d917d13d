"""What other programs read: MATLAB's .mat, and a linear model's matrices as JSON (python-control, or anything that reads JSON)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from .errors import InputError
from .files import replacing
from .results import DerivativesFile, Measured, ResultFile, read_result

if TYPE_CHECKING:
    import control
    import pandas as pd

MAT_SCHEMA, MAT_VERSION = "towline/mat", 1
"""What a .mat says it is, and the version of its layout, raised when a name in it changes."""
STATUS_CODES = {"lost": 0.0, "predicted": 1.0, "measured": 2.0, "by_hand": 3.0}
"""A .mat holds numbers: the states of a row of motion.csv or tracks.csv."""
UNIT_NAMES = {
    "m_minus_y_vdot": "kg",
    "i_minus_n_rdot": "kg_m2",
    "y_v": "n_s_per_m",
    "y_r_minus_mu": "n_s",
    "n_v": "n_s",
    "n_r": "n_m_s",
    "y_delta": "n_per_rad",
    "n_delta": "n_m_per_rad",
    "y_v_over_mass": "per_s",
    "y_r_minus_mu_over_mass": "m_per_s",
    "n_v_over_inertia": "per_m_s",
    "n_r_over_inertia": "per_s",
    "y_delta_over_mass": "m_per_s2_rad",
    "n_delta_over_inertia": "per_s2_rad",
}
"""Units of the derivatives, and of what free runs give, as they end a variable's name."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class Pole(_Part):
    """An eigenvalue of A, 1/s."""

    real: Measured = Field(description="real part; above 0: grows")
    imag: Measured = Field(description="imaginary part, rad/s")


class StateSpaceFile(ResultFile):
    """The linear tow model x' = A x + B u + constant, output C x + D u."""

    schema_name: Literal["towline/state-space"] = Field(
        default="towline/state-space", alias="schema", description="this file"
    )
    version: int = Field(default=1, description="of the schema")
    run: str = Field(description="the run whose settings were taken")
    settings: dict[str, float] = Field(
        description="speed_m_s, line_length_m, tow_point_m, tow_point_offset_m, tension_n"
    )
    state_names: list[str] = Field(description="names of x; y_m is y_CG from the post's mean place")
    input_names: list[str] = Field(description="names of u")
    output_names: list[str] = Field(description="names of the outputs")
    a: list[list[float]] = Field(description="A, states x states, SI")
    b: list[list[float]] = Field(description="B, states x inputs")
    c: list[list[float]] = Field(description="C, outputs x states")
    d: list[list[float]] = Field(description="D, outputs x inputs")
    constant: list[float] = Field(description="rates at x = 0, u = 0: a tow point off the centre line; else 0")
    output_constant: list[float] = Field(description="outputs at x = 0, u = 0")
    a_std: list[list[float]] = Field(description="standard deviations of A from the derivatives' covariance")
    poles: list[Pole] = Field(description="eigenvalues of A, by falling real part")
    notes: list[str] = Field(description="what the reader must know")


def read_state_space(path: str | Path) -> StateSpaceFile:
    """Read a state-space file.

    Raises
    ------
    InputError : it is absent, another schema, or its matrices do not fit the names
    """
    model = read_result(path, StateSpaceFile)
    n, m, p = len(model.state_names), len(model.input_names), len(model.output_names)
    for name, rows, columns in (("a", n, n), ("b", n, m), ("c", p, n), ("d", p, m)):
        found = getattr(model, name)
        if [len(row) for row in found] != [columns] * rows:
            raise InputError(path, name, f"is not {rows} x {columns}, as its names say")
    return model


def to_control(path: str | Path) -> control.StateSpace:
    """The model as python-control's ``StateSpace`` with named states, inputs and outputs (continuous time).

    ``constant`` is not in it: a linear system has none. It is 0 unless the tow point is off the centre line.

    Raises
    ------
    InputError : the file cannot be read
    ImportError : python-control is not there (``pip install towline[control]``)
    """
    model = read_state_space(path)
    import control  # pyright: ignore[reportMissingImports]

    return control.StateSpace(
        *(np.array(getattr(model, name)) for name in "abcd"),
        states=model.state_names,
        inputs=model.input_names,
        outputs=model.output_names,
        name=_plain_name(model.run),
    )


def _plain_name(name: str) -> str:
    """python-control takes dots in a system's name for signals."""
    return "".join(letter if letter.isalnum() or letter == "_" else "_" for letter in name)


# MATLAB ------------------------------------------------------------------------------------------------------------


def write_mat(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write ``content`` as MATLAB 5 atomically; lists become cell arrays, dicts structs, 1-D arrays columns.

    Parameters
    ----------
    path : of the file
    content : names -> values
    """
    from scipy.io import savemat

    with replacing(path) as temporary:
        savemat(temporary, _for_matlab(dict(content)), appendmat=False, long_field_names=True, oned_as="column")


def _for_matlab(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _for_matlab(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        cells = np.empty((len(value), 1), dtype=object)
        for index, inner in enumerate(value):
            cells[index, 0] = _for_matlab(inner)
        return cells
    return value


def mat_run(
    name: str,
    settings: Mapping[str, float],
    motion: pd.DataFrame | None,
    tracks: pd.DataFrame | None,
) -> dict[str, Any]:
    """One run for ``write_mat``: name, settings, motion and tracks as structs of columns named as in formats.md.

    ``status`` becomes ``status_code``: 0 lost, 1 predicted, 2 measured, 3 set by hand. Tracks are a cell
    array, a struct per marker.

    Parameters
    ----------
    name : of the run
    settings : name -> number
    motion : motion table, or None
    tracks : tracks table, or None
    """
    run: dict[str, Any] = {"name": name, "settings": dict(settings)}
    if motion is not None:
        run["motion"] = _columns(motion)
    if tracks is not None:
        run["tracks"] = [
            {"marker": str(marker), **_columns(rows.drop(columns="marker"))}
            for marker, rows in tracks.groupby("marker", sort=False)
        ]
    return run


def _columns(table: pd.DataFrame) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in table.columns:
        if name == "status":
            found["status_code"] = np.array([STATUS_CODES.get(str(value), np.nan) for value in table[name]])
        elif table[name].dtype.kind in "fiub":
            found[str(name)] = table[name].to_numpy(dtype=float)
    return found


def mat_derivatives(file: DerivativesFile) -> dict[str, Any]:
    """The derivatives for ``write_mat``: values named with their units, standard deviations, covariance, primes."""
    names = list(file.derivatives)
    values = [file.derivatives[name] for name in names]
    std = np.array([one.std for one in values])
    labels = [f"{name}_{UNIT_NAMES[name]}" if name in UNIT_NAMES else name for name in names]
    return {
        "speed_m_s": file.speed_m_s,
        "density_kg_m3": np.nan if file.density_kg_m3 is None else file.density_kg_m3,
        "length_pp_m": file.length_pp_m,
        "mass_kg": file.mass_kg,
        "names": names,
        "units": [one.unit for one in values],
        **{label: one.value for label, one in zip(labels, values, strict=True)},
        "std": {label: one.std for label, one in zip(labels, values, strict=True)},
        "values": np.array([one.value for one in values]),
        "covariance": derivatives_covariance(file),
        "correlation": np.array(file.correlation),
        "prime": np.array([one.prime for one in values]),
        "prime_std": np.array([one.prime_std for one in values]),
        "values_std": std,
    }


def derivatives_covariance(file: DerivativesFile, names: Sequence[str] | None = None) -> np.ndarray:
    """Covariance of the derivatives, in the order of ``names`` (default: the file's), SI.

    Parameters
    ----------
    file : a derivatives file
    names : of the derivatives; None: the file's
    """
    own = list(file.derivatives)
    std = np.array([one.std for one in file.derivatives.values()])
    covariance = np.array(file.correlation) * np.outer(std, std)
    order = [own.index(name) for name in names or own]
    return covariance[np.ix_(order, order)]
