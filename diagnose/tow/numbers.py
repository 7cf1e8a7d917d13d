"""What all tows of a campaign share: the six derivatives, and what is known of surge, rudder and asymmetry beside the runs.

The six come first in every hypothesis. A line that keeps its length adds the numbers of surge (theory.md 10): nuisances with
priors, refitted with everything else. A rudder that is over adds its force and moment, [priors.derivatives] what it states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...record.priors import ValuePrior
from ...simulate.model import DERIVATIVE_UNITS, RESISTANCE_EXPONENT, Array
from .tow_run import TowRun

SIX = tuple(DERIVATIVE_UNITS)
SURGE = ("x_udot_kg", "x_vr_kg", "x_vv_kg_m", "x_rr_kg_m", "resistance_exponent")
COMPLIANCE = "compliance_m_n"
"""Of a line that is taken as stiff; what stretches more is an effect."""
STIFF_M_N = 2e-4
"""A load cell, swivels and knots give so much: 5 kN/m."""
RUDDER, BIAS = ("y_delta", "n_delta"), ("y_bias_n", "n_bias_n_m")
BESIDE = (*SURGE, COMPLIANCE, *RUDDER, *BIAS)
"""All that is fitted beside the six."""
USUAL = ((-0.05, 0.03), (0.45, 0.26), (-0.4, 1.2), (0.0, 0.02), (RESISTANCE_EXPONENT, 0.1))
"""Of SURGE, mean and standard deviation: in the mass m, m, m/Lpp, m Lpp and 1 (``record.priors.SurgePriors``)."""
RUDDER_PRIME = 0.02
"""Y_delta' of a large rudder (the MARINER's is 0.003): how far a step of the fit may go, no prior."""
STEP_SDS = 5.0
"""A step of the fit moves a number with a prior by no more than two of these fifths (``inference.LARGEST_SHARE``)."""


@dataclass(frozen=True)
class Shared:
    """The shared numbers of a campaign.

    Attributes
    ----------
    names : fields of ``simulate.model.Hull``, the six first; and COMPLIANCE
    mean, sd : (s,), what is known of them beside the runs; sd inf: nothing
    least : (s,), below which a value counts as small where the fit's steps are limited
    """

    names: tuple[str, ...]
    mean: Array
    sd: Array
    least: Array

    def start(self, six: Array) -> Array:
        """(s,) where a fit begins."""
        return np.concatenate([six, self.mean[len(SIX) :]])


def shared_numbers(
    runs: Sequence[TowRun], speed_m_s: float, reference: tuple[Array, Array] | None = None, least: float = 1.0
) -> Shared:
    """What these runs share.

    Parameters
    ----------
    runs : as the diagnosis sees them
    speed_m_s : at which forces are quoted
    reference : mean and standard deviation of the six there; None: fitted freely
    least : of the six, and of what nobody states
    """
    mean, sd = reference if reference is not None else (np.zeros(6), np.full(6, np.inf))
    rows = [(name, float(m), float(s), least) for name, m, s in zip(SIX, mean, sd, strict=True)]
    rows += _surge(runs) if any(run.data.tow.line == "surge" for run in runs) else []
    rows += _inputs(runs, speed_m_s)
    names, *columns = zip(*rows, strict=True)
    return Shared(tuple(names), *(np.array(column, dtype=float) for column in columns))


def _surge(runs: Sequence[TowRun]) -> list[tuple[str, float, float, float]]:
    mass = float(np.mean([run.run.model.mass_kg for run in runs]))
    length = float(np.mean([run.length_pp_m for run in runs]))
    rows = []
    for name, (mean, sd), unit in zip(SURGE, USUAL, (mass, mass, mass / length, mass * length, 1.0), strict=True):
        told = _told([getattr(run.data.priors.surge, name) for run in runs])
        value, spread = (mean * unit, sd * unit) if told is None else (told.value, told.std)
        rows.append((name, value, spread, STEP_SDS * spread))
    if any(run.marks is not None for run in runs):
        rows.append((COMPLIANCE, 0.0, STIFF_M_N, STEP_SDS * STIFF_M_N))
    return rows


def _inputs(runs: Sequence[TowRun], speed_m_s: float) -> list[tuple[str, float, float, float]]:
    """A rudder that is over pushes, by how much is not known unless stated; asymmetry is none unless stated."""
    over = any(rudder_is_over(run) for run in runs)
    first = runs[0]
    push = 0.5 * first.density_kg_m3 * first.length_pp_m**2 * speed_m_s**2 * RUDDER_PRIME
    rows = []
    for name, size in zip((*RUDDER, *BIAS), (push, push * first.length_pp_m, 0.0, 0.0), strict=True):
        told = _told([getattr(run.data.priors.derivatives, name) for run in runs])
        if told is not None:
            rows.append((name, told.value, told.std, STEP_SDS * told.std))
        elif name in RUDDER and over:
            rows.append((name, 0.0, np.inf, size))
    return rows


def _told(priors: Sequence[ValuePrior | None]) -> ValuePrior | None:
    """One model: the first run that says it says it for all."""
    return next((prior for prior in priors if prior is not None), None)


def rudder_history(run: TowRun) -> tuple[Array, Array] | None:
    """Times and angles of a rudder that moves, or None."""
    return getattr(run.data, "rudder", None)


def rudder_is_over(run: TowRun) -> bool:
    """Whether the rudder pushes at any time of the run."""
    history = rudder_history(run)
    return bool(run.data.tow.rudder_rad) or (history is not None and bool(np.any(history[1])))


__all__ = ["BESIDE", "COMPLIANCE", "SIX", "SURGE", "Shared", "rudder_history", "rudder_is_over", "shared_numbers"]
