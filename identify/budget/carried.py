"""What is computed from the derivatives, with the budget carried on: neutral points, straight-line stability, turning, zigzag.

Algebraic quantities have a gradient, and with it a budget of their own; beside it stands the interval of draws from the combined
covariance (JCGM 101), which also holds where a quantity bends within its uncertainty. Turning and zigzag need rudder forces.
Model and signs: theory.md 2; the hull at constant speed, m' v' = Y_v v + Y_R r + Y_delta delta and its like in yaw, delta positive
to port.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from .combine import LEVEL, Budget, Judged, judged
from .gains import RUDDER_UNITS
from .zigzag import zigzag

DRAWS = 2000
"""From the combined covariance: the ends of a 95 % interval are then known to a twentieth of its half width."""
TURN_DEG = 10.0
"""Rudder of the turning circle: a linear model holds for gentle turns only. A choice."""
ZIGZAGS_DEG = (10.0, 20.0)
"""The IMO's two zigzags (MSC.137(76)): rudder and heading at which it is thrown over."""
GRADIENT_STEP = 1e-6
"""Of central differences, in parts of a quantity's size; functions here are smooth and exact to rounding."""
Function = Callable[[Array], Array]


@dataclass(frozen=True)
class Carried:
    """A quantity computed from the derivatives.

    Attributes
    ----------
    name, unit : of it
    value : at the estimate; NaN where there is none (a turn of an unstable hull)
    judged : its own budget by gradients; None for what draws alone can say
    low, high : probabilistically symmetric 95 % interval of the draws; NaN where fewer than 95 % of them have it
    share : of the draws that have it
    """

    name: str
    unit: str
    value: float
    judged: Judged | None
    low: float
    high: float
    share: float


@dataclass(frozen=True)
class Stability:
    """Whether the hull keeps a straight line with its rudder amidships.

    Attributes
    ----------
    stable : by the estimate: Y_v N_r - N_v Y_R > 0
    probability : of a stable hull, by the draws
    """

    stable: bool
    probability: float


@dataclass(frozen=True)
class CarriedOn:
    """Result of ``carried_on``.

    Attributes
    ----------
    quantities : in the order of ``FUNCTIONS``; of a rudder where the budget has its forces
    stability : the verdict
    """

    quantities: tuple[Carried, ...]
    stability: Stability


def carried_on(budget: Budget, speed_m_s: float, length_pp_m: float, rng: np.random.Generator) -> CarriedOn:
    """Carry a budget on to the hull's straight-line stability and, where it has rudder forces, to turning and zigzag.

    Parameters
    ----------
    budget : of the fit
    speed_m_s : at which its quantities are quoted
    length_pp_m : of the model
    rng : of the draws

    Raises
    ------
    EstimationError : the covariance holds what is not finite
    """
    covariance = budget.covariance
    if not np.isfinite(covariance).all():
        raise EstimationError("the budget's covariance is not finite")
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = budget.value[:, None] + root @ rng.standard_normal((len(values), DRAWS))
    found = []
    for name, (unit, function) in _functions(budget, speed_m_s, length_pp_m).items():
        at = np.concatenate([budget.value[:, None], drawn], axis=1)
        here = function(at)
        value = float(here[0])
        own = None
        if np.isfinite(value):
            own = judged(budget, _gradient(function, budget.value, np.diag(covariance)), value)
        found.append(_carried(name, unit, value, own, here[1:]))
    for angle in ZIGZAGS_DEG if set(RUDDER_UNITS) <= set(budget.names) else ():
        at = np.concatenate([budget.value[:, None], drawn], axis=1)
        for name, unit, here in zigzag(*_matrices(at), np.radians(angle), speed_m_s, length_pp_m):
            found.append(_carried(f"{angle:g}/{angle:g} zigzag: {name}", unit, float(here[0]), None, here[1:]))
    index = stability_index(drawn)
    return CarriedOn(
        tuple(found), Stability(bool(stability_index(budget.value[:, None])[0] > 0), float((index > 0).mean()))
    )


def stability_index(six: Array) -> Array:
    """C = Y_v N_r - N_v Y_R (n,) of derivatives ``(>= 6, n)``: above 0 the hull keeps a straight line.

    Parameters
    ----------
    six : the six derivatives first
    """
    return six[2] * six[5] - six[4] * six[3]


def _carried(name: str, unit: str, value: float, own: Judged | None, drawn: Array) -> Carried:
    good = np.isfinite(drawn)
    share = float(good.mean())
    if share < LEVEL:
        return Carried(name, unit, value, own, np.nan, np.nan, share)
    low, high = np.quantile(drawn[good], [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Carried(name, unit, value, own, float(low), float(high), share)


def _gradient(function: Function, value: Array, variance: Array) -> Array:
    """df/d(quantity), by central differences."""
    step = GRADIENT_STEP * np.maximum(np.abs(value), np.sqrt(np.maximum(variance, 1e-300)))
    ends = value[:, None] + np.concatenate([np.diag(step), -np.diag(step)], axis=1)
    here = function(ends)
    return (here[: len(value)] - here[len(value) :]) / (2 * step)


def _matrices(at: Array) -> tuple[Array, Array]:
    """A (n, 2, 2) and b (n, 2) of (v, r)' = A (v, r) + b delta."""
    mass, inertia = at[0], at[1]
    a = np.stack([np.stack([at[2], at[3]]) / mass, np.stack([at[4], at[5]]) / inertia])
    b = np.stack([at[6] / mass, at[7] / inertia])
    return a.transpose(2, 0, 1), b.T


def _functions(budget: Budget, speed: float, length: float) -> dict[str, tuple[str, Function]]:
    """name -> (unit, function of (q, n))."""

    def gain(at: Array) -> Array:
        return (at[4] * at[6] - at[2] * at[7]) / stability_index(at)

    def roots(at: Array) -> Array:
        """(2, n), rising real parts, 1/s; NaN where they swing."""
        trace = at[2] / at[0] + at[5] / at[1]
        inside = trace**2 / 4 - stability_index(at) / (at[0] * at[1])
        root = np.sqrt(np.where(inside >= 0, inside, np.nan))
        return np.stack([trace / 2 - root, trace / 2 + root])

    def time(at: Array) -> Array:
        """Nomoto's T1 + T2 - T3, s: T3 from the zero of r over delta."""
        slow, fast = -1 / roots(at)[1], -1 / roots(at)[0]
        third = at[0] * at[7] / (at[4] * at[6] - at[2] * at[7])
        return slow + fast - third

    def diameter(at: Array) -> Array:
        stable = stability_index(at) > 0
        turned = 2 * speed / (np.abs(gain(at)) * np.radians(TURN_DEG)) / length
        return np.where(stable, turned, np.nan)

    found: dict[str, tuple[str, Function]] = {
        "X_v": ("m", lambda at: at[4] / at[2]),
        "X_r": ("m", lambda at: at[5] / at[3]),
        "X_r - X_v": ("m", lambda at: at[5] / at[3] - at[4] / at[2]),
        "C' of straight-line stability": (
            "1",
            lambda at: stability_index(at) / (at[0] * at[1]) * (length / speed) ** 2,
        ),
        "slower root of a straight course, by U/L": ("1", lambda at: roots(at)[1] * length / speed),
    }
    if set(RUDDER_UNITS) <= set(budget.names):
        found |= {
            "turning ability K = r/delta": ("1/s", gain),
            "Nomoto's time T": ("s", time),
            f"turning circle at {TURN_DEG:g} deg of rudder, diameter over L": ("1", diameter),
        }
    return found


__all__ = ["Carried", "CarriedOn", "Stability", "carried_on", "stability_index"]
