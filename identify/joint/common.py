"""What all runs of a fit share beside the six derivatives: errors of T, L and U, the model along its way, rudder and asymmetry.

Each is a number of its prior's standard deviations in the parameter vector; this says what it is to each run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...record.priors import Priors, ValuePrior
from ...simulate.model import RESISTANCE_EXPONENT, Array
from ...simulate.scenario import USUAL_X_UDOT
from ..data import WATER_KG_M3, RunData
from .parameters import ACROSS, ALONG, LINEAR_COUNT, RUN_PARAMETERS

USUAL_ALONG: dict[str, tuple[Callable[[float, float], float], Callable[[float, float], float]]] = {
    "x_udot_kg": (lambda m, _: USUAL_X_UDOT * m, lambda m, _: 0.03 * m),
    "x_vr_kg": (lambda m, _: 0.45 * m, lambda m, _: 0.26 * m),
    "x_vv_kg_m": (lambda m, length: -0.4 * m / length, lambda m, length: 1.2 * m / length),
    "x_rr_kg_m": (lambda *_: 0.0, lambda m, length: 0.02 * m * length),
    "resistance_exponent": (lambda *_: RESISTANCE_EXPONENT, lambda *_: 0.1),
}
"""(mean, standard deviation) by mass and length_pp_m where [priors.surge] says nothing: bare models (theory.md 10)."""
WIDE_RUDDER = 0.03
"""Y_delta over rho/2 L^2 U^2, N_delta over rho/2 L^3 U^2: about nine times a usual rudder's; as good as free."""
SCALE = "tension"


@dataclass(frozen=True)
class Common:
    """One number that all runs share.

    Attributes
    ----------
    name : as in ``RUN_PARAMETERS``
    base, sd : (runs,), what a run's parameter gets more: base + theta sd
    factor : it multiplies the run's parameter by exp(theta sd) instead
    known : theta has a prior of unit variance about 0; else it is free
    """

    name: str
    base: Array
    sd: Array
    factor: bool = False
    known: bool = True

    @property
    def place(self) -> int:
        """In ``RUN_PARAMETERS``."""
        return RUN_PARAMETERS.index(self.name)

    def put(self, values: Array, theta: float) -> None:
        """Into the runs' parameters (runs, ``COUNT``)."""
        if self.factor:
            values[:, self.place] *= np.exp(theta * self.sd)
        else:
            values[:, self.place] += self.base + theta * self.sd

    def slope(self, values: Array) -> Array:
        """(runs,), change of the runs' parameter with theta, at ``values`` with it put in."""
        return values[:, self.place] * self.sd if self.factor else self.sd


def commons_of(runs: list[RunData]) -> tuple[Common, ...]:
    """What the first run's priors let move, in the order of the parameter vector.

    Raises
    ------
    EstimationError : lines that keep their length with a model whose mass is not given
    """
    priors = runs[0].priors
    found = []
    nothing = np.zeros(len(runs))

    def add(name: str, sd: Array, base: Array = nothing, **more: bool) -> None:
        if sd.any() or base.any():
            found.append(Common(name, base, sd, **more))

    if not any(d.tension_stated for d in runs):
        add(SCALE, np.ones(len(runs)), factor=True, known=False)
    else:
        add(SCALE, np.full(len(runs), priors.tension_common_sd_rel), factor=True)
    add("line_length", np.full(len(runs), priors.line_length_sd_m))
    add("speed", priors.speed_sd_rel * np.array([d.tow.speed_m_s for d in runs]))
    if runs[0].tow.line == "surge":
        for name in ALONG:
            value, sd = along_prior(runs[0], name)
            add(name, np.full(len(runs), sd), np.full(len(runs), value))
    for name in ACROSS:
        known = across_prior(runs, name)
        if known is not None:
            add(name, np.full(len(runs), known[1]), np.full(len(runs), known[0]))
    return tuple(found)


def along_prior(run: RunData, name: str) -> tuple[float, float]:
    """Mean and standard deviation of a number of ``ALONG``, as [priors.surge] says or as usual for its mass.

    Parameters
    ----------
    run : one run
    name : which one
    """
    if run.mass_kg is None and getattr(run.priors.surge, name) is None:
        raise EstimationError(
            f'run {run.name!r}: model.mass_kg is missing; line = "surge" weighs the model (give it, or line = "constant")'
        )
    return along_of(run.priors, run.mass_kg or 0.0, _length(run), name)


def along_of(priors: Priors, mass_kg: float, length_pp_m: float, name: str) -> tuple[float, float]:
    """``along_prior`` of a model of this mass and length.

    Parameters
    ----------
    priors : of the run
    mass_kg : of the model, kg
    length_pp_m : LBP, m
    name : which one
    """
    stated: ValuePrior | None = getattr(priors.surge, name)
    if stated is not None:
        return stated.value, stated.std
    mean, spread = USUAL_ALONG[name]
    return float(mean(mass_kg, length_pp_m)), float(spread(mass_kg, length_pp_m))


def across_prior(runs: list[RunData], name: str) -> tuple[float, float] | None:
    """The same of ``ACROSS`` at the runs' mean speed; None: not there.

    Parameters
    ----------
    runs : the runs, in their order
    name : which one
    """
    run, priors = runs[0], runs[0].priors
    stated: ValuePrior | None = getattr(priors.derivatives, name)
    speed = float(np.mean([d.tow.speed_m_s for d in runs]))
    if stated is not None:
        ratio = (speed / run.tow.speed_m_s) ** 2
        return stated.value * ratio, stated.std * ratio
    if name not in ("y_delta", "n_delta") or not any(d.steered for d in runs):
        return None
    size = WIDE_RUDDER * WATER_KG_M3 / 2 * _length(run) ** 2 * speed**2
    return 0.0, size * (_length(run) if name == "n_delta" else 1.0)


def _length(run: RunData) -> float:
    return run.length_pp_m if np.isfinite(run.length_pp_m) else 1.5 * abs(run.tow.tow_point_m)


def needs_full(name: str) -> bool:
    """The linear form does not know it."""
    return RUN_PARAMETERS.index(name) >= LINEAR_COUNT


__all__ = ["Common", "across_prior", "along_of", "along_prior", "commons_of", "needs_full"]
