"""Scenarios to motions and films, with the effects that they name, a user's own among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..record.scenario import ScenarioFile
from ..simulate import read_scenario, simulate_scenario
from ..simulate.model import Array, ExtraForce, Hull, Tow

if TYPE_CHECKING:
    import pandas as pd

    from ..diagnose.effects import Effect
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
    return simulate_noted(scenario, effects, line)[:2]


def simulate_noted(
    scenario: Path, effects: Sequence[Path] = (), line: Line | None = None
) -> tuple[ScenarioFile, pd.DataFrame, list[str]]:
    """The same, and where the motion leaves the range in which the scenario's laws were found, a sentence each.

    Parameters
    ----------
    scenario, effects, line : as of ``simulate_file``

    Raises
    ------
    InputError : names file, key, value and what was expected
    """
    file = read_scenario(scenario, line)
    found = _named_by(file, scenario, effects)
    motion = simulate_scenario(file, scenario.parent, _changed_by(file, found))
    return file, motion, _beyond_reach(file, motion, [effect for effect, _ in found])


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
    render_scenario(file, scenario.parent, out, told, _changed_by(file, _named_by(file, scenario, effects)))
    return file


def _named_by(file: ScenarioFile, path: Path, effects: Sequence[Path]) -> list[tuple[Effect, Array]]:
    """Effects of a scenario's ``[[effect]]`` tables with their numbers."""
    if not file.effect:
        return []
    from ..diagnose.simulated import effects_of
    from .diagnosing import library_of

    return effects_of(file, path, library_of(effects))


def _changed_by(file: ScenarioFile, found: list[tuple[Effect, Array]]) -> Changed | None:
    """What effects do to hull and tow; None without any."""
    if not found:
        return None
    from ..diagnose.simulated import with_effects

    return lambda hull, tow: with_effects(hull, tow, found, file)


def _beyond_reach(file: ScenarioFile, motion: pd.DataFrame, effects: Sequence[Effect]) -> list[str]:
    """Where a motion leaves the range in which effects were found, a sentence each."""
    if not any(effect.reach for effect in effects):
        return []
    from ..diagnose.law.functions import dimensionless
    from .missing import beyond_reach

    width = file.water.tank_width_m
    columns = (motion[name].to_numpy() for name in ("v_m_s", "r_rad_s", "y_cg_m", "beta_rad"))
    alpha = motion["alpha_rad"].to_numpy()
    own = (file.tow.speed_m_s, file.model.length_pp_m, width / 2 if width else np.nan)
    # how the line turns against the hull is in no motion's table
    return beyond_reach(effects, dimensionless(*own, *columns, turn_rad_s=np.nan, time=np.nan, alpha_rad=alpha))


__all__ = ["render_file", "simulate_file", "simulate_noted"]
