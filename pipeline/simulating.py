"""Scenarios to motions and films, with the effects that they name, a user's own among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..record.scenario import ScenarioFile
from ..simulate import read_scenario, simulate_scenario
from ..simulate.model import ExtraForce, Hull, Tow

if TYPE_CHECKING:
    import pandas as pd

    from ..record.schema import Line

Changed = Callable[[Hull, Tow], tuple[Hull, Tow, ExtraForce | None]]


def simulate_file(
    scenario: Path, effects: Sequence[Path] = (), line: Line | None = None
) -> tuple[ScenarioFile, pd.DataFrame]:
    """A scenario and its motion.

    Parameters
    ----------
    scenario : a scenario.toml; its ``[[effect]]`` tables are in the motion
    effects : Python files with effects of one's own that it may name
    line : what the tow line keeps, instead of ``tow.line``

    Raises
    ------
    InputError : names file, key, value and what was expected
    """
    file = read_scenario(scenario, line)
    return file, simulate_scenario(file, scenario.parent, changed_by(file, scenario, effects))


def render_file(
    scenario: Path,
    out: Path,
    effects: Sequence[Path] = (),
    line: Line | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> ScenarioFile:
    """Simulate and film a scenario into the run folder ``out``.

    Parameters
    ----------
    scenario : scenario.toml
    out : folder that is made
    effects : Python files of a user's own effects
    line : what the tow line keeps, "surge" or "constant", instead of what run.toml says; None: what it says
    progress : called with the scenario's name, frames drawn, frames in all
    """
    from ..simulate.render import render_scenario

    file = read_scenario(scenario, line)
    told = None if progress is None else lambda done, total: progress(file.name, done, total)
    render_scenario(file, scenario.parent, out, told, changed_by(file, scenario, effects))
    return file


def beyond_reach(file: ScenarioFile, path: Path, motion: pd.DataFrame, effects: Sequence[Path] = ()) -> list[str]:
    """Where a motion leaves the range in which the scenario's laws were found, a sentence each.

    Parameters
    ----------
    file : the scenario as read
    path : of the scenario
    motion : of ``simulate_file``
    effects : Python files of a user's own effects
    """
    if not file.effect or file.tow is None:
        return []
    from ..diagnose.simulated import effects_of
    from .diagnosing import library_of

    speed, length, width = file.tow.speed_m_s, file.model.length_pp_m, file.water.tank_width_m
    states = {
        "v": motion["v_m_s"] / speed,
        "r": motion["r_rad_s"] * length / speed,
        "y": motion["y_cg_m"] / (width / 2 if width else length),
        "beta": motion["beta_rad"],
    }
    told = []
    for effect, _ in effects_of(file, path, library_of(effects)):
        for name, low, high in effect.reach:
            if name in states and (states[name].min() < low or states[name].max() > high):
                told.append(
                    f"{effect.name}: found for {name} from {low:.3g} to {high:.3g}; this motion goes from "
                    f"{states[name].min():.3g} to {states[name].max():.3g}, where nothing is known of it"
                )
    return told


def changed_by(file: ScenarioFile, path: Path, effects: Sequence[Path] = ()) -> Changed | None:
    """What a scenario's ``[[effect]]`` tables do to hull and tow; None without any.

    Parameters
    ----------
    file : the scenario as read
    path : of the scenario
    effects : Python files of a user's own effects
    """
    if not file.effect:
        return None
    from ..diagnose.simulated import effects_of, with_effects
    from .diagnosing import library_of

    found = effects_of(file, path, library_of(effects))
    return lambda hull, tow: with_effects(hull, tow, found, file)


__all__ = ["beyond_reach", "changed_by", "render_file", "simulate_file"]
