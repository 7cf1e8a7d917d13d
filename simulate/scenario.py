"""scenario.toml -> motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from ..record.errors import InputError
from ..record.scenario import ScenarioFile
from ..record.schema import TowTable
from ..record.tables import read_history
from ..record.toml import read_toml
from .characteristic import Stability, stability
from .model import Array, ExtraForce, Hull, Line, Tow
from .motion import Histories, Start, simulate_full, simulate_linear

USUAL_X_UDOT, USUAL_X_VR = -0.05, 0.5
"""Of the mass, and of -Y_vdot (theory.md 10)."""


def read_scenario(path: str | Path, line: Line | None = None) -> ScenarioFile:
    """Read and check a scenario.toml; ``line``: what its tow line keeps, instead of what it says.

    Parameters
    ----------
    path : of the file
    line : what its tow line keeps, "surge" or "constant", instead of what it says
    """
    file = read_toml(path, ScenarioFile)
    return file if line is None else file.model_copy(update={"tow": file.tow.model_copy(update={"line": line})})


def hull_of(file: ScenarioFile) -> Hull:
    """The hull of a scenario; what is not said of its surge is usual for its mass (``HullTable``).

    Parameters
    ----------
    file : the scenario as read
    """
    table, mass = file.hull, file.model.mass_kg
    along = {
        "x_udot_kg": USUAL_X_UDOT * mass if table.x_udot_kg is None else table.x_udot_kg,
        "x_vr_kg": USUAL_X_VR * max(table.m_minus_y_vdot - mass, 0.0) if table.x_vr_kg is None else table.x_vr_kg,
    }
    return Hull(**(table.model_dump() | along), mass_kg=mass)


def tow_from_table(table: TowTable) -> Tow:
    """The tow of a run.toml or scenario.toml; a model without a line gets one of no tension.

    Parameters
    ----------
    table : [tow] of the file
    """
    resistance = getattr(table, "resistance_n", None)
    if table.line == "surge" and resistance is not None:
        table, resistance = table.model_copy(update={"tension_n": resistance}), None
    return Tow(
        speed_m_s=table.speed_m_s,
        line_length_m=table.line_length_m or 1.0,
        tow_point_m=table.tow_point_m or 0.0,
        tension_n=None if resistance is not None else (table.tension_n or 0.0),
        resistance_n=resistance,
        line=table.line,
        stiffness_n_m=getattr(table, "line_stiffness_n_m", None),
        line_damping_n_s_m=getattr(table, "line_damping_n_s_m", 0.0),
        tow_point_offset_m=table.tow_point_offset_m,
        rudder_rad=table.rudder_rad,
        post_m=table.post_m,
        post_amplitude_m=table.post_amplitude_m,
        post_frequency_hz=table.post_frequency_hz,
        post_phase_rad=table.post_phase_rad,
    )


def scenario_times(file: ScenarioFile) -> Array:
    """Sample times: 0, 1/rate, ... up to the duration (exclusive), s."""
    return np.arange(round(file.time.duration_s * file.time.rate_hz)) / file.time.rate_hz


def scenario_histories(file: ScenarioFile, folder: Path) -> Histories:
    """Histories named in [tow], on the record's clock, held constant beyond their ends.

    Parameters
    ----------
    file : the scenario as read
    folder : where its histories lie
    """

    def history(name: str | None, column: str, delay_s: float):
        if name is None:
            return None
        table = read_history(folder / name, column)
        times, values = table["t_s"].to_numpy() + delay_s, table[column].to_numpy()
        return lambda t: np.interp(t, times, values)

    tow = file.tow
    return Histories(
        tension_n=history(tow.tension, "tension_n", tow.tension_delay_s),
        rudder_rad=history(tow.rudder, "rudder_rad", tow.rudder_delay_s),
        speed_m_s=history(tow.speed, "speed_m_s", tow.speed_delay_s),
    )


def simulate_scenario(
    file: ScenarioFile,
    folder: Path,
    changed: Callable[[Hull, Tow], tuple[Hull, Tow, ExtraForce | None]] | None = None,
) -> pd.DataFrame:
    """Simulate a scenario; histories are read from ``folder``.

    Parameters
    ----------
    file : the scenario as read
    folder : where its histories lie
    changed : hull and tow -> the same with unmodelled effects, and their force

    Returns
    -------
    motion : columns as in ``simulate_full``
    """
    hull, tow, times = hull_of(file), tow_from_table(file.tow), scenario_times(file)
    extra: ExtraForce | None = None
    if changed is not None:
        hull, tow, extra = changed(hull, tow)
    start = Start(**file.start.model_dump())
    histories = scenario_histories(file, folder)
    if file.form == "linear":
        if not histories.empty or file.kind == "free" or extra is not None:
            raise InputError(
                folder / "scenario.toml",
                "form",
                '"linear" knows a tow with constant T, U, delta and no effects; use "full"',
            )
        return simulate_linear(hull, tow, start, times)
    return simulate_full(hull, tow, start, times, free=file.kind == "free", histories=histories, extra=extra)


def scenario_stability(file: ScenarioFile) -> Stability | None:
    """The verdict on a scenario's tow; None without a line or without a constant tension.

    Parameters
    ----------
    file : the scenario as read
    """
    tow = tow_from_table(file.tow)
    if file.kind == "free" or tow.tension_n is None or file.tow.tension is not None:
        return None
    return stability(hull_of(file).at_speed(tow.speed_m_s), tow)
