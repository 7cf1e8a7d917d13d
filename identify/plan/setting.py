"""What a plan is made for: hull guess, tank, noise, priors and limits, and one planned run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.plan_file import LimitsTable, PlanNoise
from ...record.priors import Priors
from ...simulate.model import Array, Hull, Line, Tow
from ..data import Missing
from ..joint.problem import GUESSED_SCATTER


@dataclass(frozen=True)
class TowPlan:
    """One tow, released at rest.

    Attributes
    ----------
    tow_point_m, line_length_m, speed_m_s : X_T, L, U
    release_y_m, release_beta_rad : place of the LCG from the post and heading at the release
    """

    tow_point_m: float
    line_length_m: float
    speed_m_s: float
    release_y_m: float
    release_beta_rad: float = 0.0


@dataclass(frozen=True)
class Setting:
    """Everything that is the same for all candidates.

    Attributes
    ----------
    hull : the guess, at any speed
    tension_n, tension_speed_m_s : T at that speed; it grows with U^2
    way_m : usable length of the tank
    width_m : between the walls
    hull_length_m, breadth_m : of the model, LCG midway
    mass_kg : of the model
    noise, priors, limits : as in plan.toml
    line : what the runs' lines keep: "surge", their length; "constant", their tension
    gauge : their tension is measured; else the scale of all forces is free
    length_pp_m : of the model; the usual model along its way goes with it (``joint.common``)
    unlike_speeds : the campaign holds several speeds: without a gauge their resistances are guessed apart
    missing : a force on the hull that is known beforehand, of lines that keep their length; None: none
    """

    hull: Hull
    tension_n: float
    tension_speed_m_s: float
    way_m: float
    width_m: float
    hull_length_m: float
    breadth_m: float
    mass_kg: float
    noise: PlanNoise
    priors: Priors
    limits: LimitsTable
    line: Line = "surge"
    gauge: bool = True
    length_pp_m: float = float("nan")
    unlike_speeds: bool = False
    missing: Missing | None = None

    def duration_s(self, speed_m_s: float) -> float:
        """Usable way over U, s."""
        return self.way_m / speed_m_s

    def tow(self, plan: TowPlan) -> Tow:
        """The tow of a planned run, T = tension_n (U/tension_speed_m_s)^2."""
        tension = self.tension_n * (plan.speed_m_s / self.tension_speed_m_s) ** 2
        return Tow(plan.speed_m_s, plan.line_length_m, plan.tow_point_m, tension, line=self.line)

    def tension_scatter(self, plan: TowPlan) -> float:
        """Relative scatter of a run's own T about what is stated, or about the guess, as the fit takes it."""
        stated = self.priors.tension_sd_rel
        if self.gauge:
            return float(np.hypot(stated, self.noise.tension_sd_n / self.tow(plan).resistance))
        return max(stated, GUESSED_SCATTER) if self.unlike_speeds else stated

    def hull_at(self, speed_m_s: float) -> Hull:
        """The guess at another speed."""
        return self.hull.at_speed(speed_m_s)

    @property
    def values(self) -> Array:
        """The six derivatives of the guess, (6,)."""
        return self.hull.six

    @property
    def scale(self) -> Array:
        """|derivative|, (6,): what a relative standard deviation is relative to."""
        return np.abs(self.values)
