"""A law that was found (law.toml, law.py) as a force that fits and plans know beforehand; and where a motion leaves its range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..diagnose.effects import Effect
from ..diagnose.law.field import is_term
from ..diagnose.law.functions import State, dimensionless
from ..diagnose.simulated import effects_of, missing_force
from ..identify.data import Missing, RunData
from ..record.errors import InputError
from ..record.files import sha256_of_file
from ..record.run import Run
from ..record.scenario import LawScenario
from ..record.toml import read_toml
from ..simulate.model import Array
from .diagnosing import library_of


@dataclass(frozen=True)
class KnownLaw:
    """A law that is known beforehand.

    Attributes
    ----------
    effects : its terms with their numbers
    inputs : files behind it -> their SHA-256
    """

    effects: tuple[tuple[Effect, Array], ...]
    inputs: dict[str, str]

    @property
    def text(self) -> str:
        """Its terms, in words."""
        return " + ".join(f"{effect.variant}: {effect.name}" for effect, _ in self.effects)

    def missing(self, length_pp_m: float, density_kg_m3: float, half_width_m: float) -> Missing:
        """As what a fit of runs knows beforehand; each call makes a force of its own.

        Parameters
        ----------
        length_pp_m, density_kg_m3 : of model and water
        half_width_m : of the tank; NaN: not known
        """
        return Missing(missing_force(self.effects, length_pp_m, density_kg_m3), half_width_m)

    def beyond(self, states: State) -> list[str]:
        """Where states leave the range in which the law was found, a sentence each.

        Parameters
        ----------
        states : of a motion
        """
        return beyond_reach([effect for effect, _ in self.effects], states)


def read_law(files: Sequence[Path]) -> KnownLaw:
    """A law from what ``towline diagnose --law`` wrote.

    Parameters
    ----------
    files : law.toml with the numbers, and law.py with the terms (it is run)

    Raises
    ------
    InputError : no law.toml or several, a term that no file has, or one that is no law
    """
    tables = [path for path in files if path.suffix == ".toml"]
    if len(tables) != 1:
        raise InputError(
            files[0],
            "",
            f"--effects: {len(tables)} TOML files given; one law.toml with the numbers, and law.py with the terms, are expected",
        )
    path = tables[0]
    file = read_toml(path, LawScenario)
    found = effects_of(file, path, library_of([one for one in files if one != path]))
    for index, (effect, _) in enumerate(found):
        if not is_term(effect):
            raise InputError(
                path,
                f"effect[{index}].name",
                f"{effect.name!r} is no law; a force that towline diagnose --law found is expected",
            )
    return KnownLaw(tuple(found), {one.name: sha256_of_file(one) for one in files})


def half_width_of(run: Run) -> float:
    """Of a run's tank; NaN: not known."""
    width = run.water.tank_width_m
    return width / 2 if width else float("nan")


def states_of(data: RunData, half_width_m: float, y_m: Array, beta_rad: Array) -> State:
    """The dimensionless state along a run's motion.

    Parameters
    ----------
    data : of the run
    half_width_m : of its tank; NaN: not known
    y_m, beta_rad : (n,), from the post, at the run's samples
    """
    tow, t_s = data.tow, data.t_s
    alpha = np.arcsin(np.clip((y_m + tow.tow_point_m * np.sin(beta_rad)) / tow.line_length_m, -1.0, 1.0))
    v, r = np.gradient(y_m, t_s) - tow.speed_m_s * beta_rad, np.gradient(beta_rad, t_s)
    own = (tow.speed_m_s, data.length_pp_m, half_width_m)
    turn, time = np.gradient(alpha, t_s) + r, (t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]), 1e-9)
    return dimensionless(*own, v, r, y_m, beta_rad, turn_rad_s=turn, time=time, alpha_rad=alpha)


def beyond_reach(effects: Sequence[Effect], states: State) -> list[str]:
    """Where states leave the range in which effects were found, a sentence each.

    Parameters
    ----------
    effects : some of which may have a ``reach``
    states : of a motion; what is NaN is not judged
    """
    told = []
    for effect in effects:
        for name, low, high in effect.reach:
            least, most = np.min(getattr(states, name)), np.max(getattr(states, name))
            if least < low or most > high:
                told.append(
                    f"{effect.name}: found for {name} from {low:.3g} to {high:.3g}; this motion goes from "
                    f"{least:.3g} to {most:.3g}, where nothing is known of it"
                )
    return told


__all__ = ["KnownLaw", "beyond_reach", "half_width_of", "read_law", "states_of"]
