"""Components to a combined and an expanded uncertainty, for the fit's own quantities and for what is computed from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from ...simulate.model import Array
from ..data import RunData
from ..fit import Fit
from .components import INFINITE, Component, ModeOrigin, components_of
from .gains import gains_of
from .given import Shape, given_components

LEVEL = 0.95
"""Level of confidence of an expanded uncertainty (ITTC 7.5-02-06-04: 95 %)."""


@dataclass(frozen=True)
class Judged:
    """One quantity of the budget.

    Attributes
    ----------
    value : as estimated
    u : combined standard uncertainty
    degrees : effective degrees of freedom (Welch-Satterthwaite)
    k : coverage factor for ``LEVEL``
    expanded : U = k u
    parts : (lines,), standard uncertainty by each component, u_i = |c_i| u(x_i); 0 where it is not included
    """

    value: float
    u: float
    degrees: float
    k: float
    expanded: float
    parts: Array

    @property
    def shares(self) -> Array:
        """(lines,) of the variance."""
        return self.parts**2 / max(self.u**2, 1e-300)


@dataclass(frozen=True)
class Budget:
    """The budget of a fit.

    Attributes
    ----------
    names, units : of the q quantities: the six derivatives, then Y_delta and N_delta where the fit has them
    value : (q,)
    stated : (6,), the fit's own standard deviations of the six
    components : every line; those of the fit sum to ``stated``
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    stated: Array
    components: tuple[Component, ...]

    @property
    def covariance(self) -> Array:
        """(q, q), combined."""
        return self._sum(lambda c: c.included)

    @property
    def closure(self) -> float:
        """Largest |combined over stated - 1| over the six, of what the fit carries: how well the lines sum to its sd."""
        carried = np.sqrt(np.diag(self._sum(lambda c: c.status == "fit"))[:6])
        return float(np.abs(carried / self.stated - 1).max())

    def _sum(self, wanted) -> Array:
        size = len(self.names)
        return sum((c.covariance for c in self.components if wanted(c)), np.zeros((size, size)))

    @property
    def correlation(self) -> Array:
        """(q, q)"""
        sd = np.sqrt(np.diag(self.covariance))
        return self.covariance / sd[:, None] / sd[None, :]

    def with_components(self, *more: Component) -> Budget:
        """The budget with further lines."""
        return Budget(self.names, self.units, self.value, self.stated, (*self.components, *more))


def budget_of(
    fit: Fit,
    runs: Sequence[RunData],
    modes: Mapping[str, Sequence[ModeOrigin]] | None = None,
    shapes: Sequence[Shape] = (),
) -> Budget:
    """The budget of a joint fit by output error.

    Parameters
    ----------
    fit : of ``runs``
    runs : as fitted
    modes : key of common modes -> where they come from; None: each key is a line
    shapes : inputs of the camera's side that the fit takes as exact

    Raises
    ------
    EstimationError : the fit is no output error

    Example
    -------
    ``budget = budget_of(fit_runs(runs), runs); budget.closure < 0.01``
    """
    gains = gains_of(fit, runs)
    surge = fit.form == "full" and runs[0].tow.line == "surge"
    lines = components_of(gains, modes or {}) + given_components(gains, shapes, surge)
    return Budget(gains.names, gains.units, gains.value, np.sqrt(np.diag(fit.covariance)), tuple(lines))


def judged(budget: Budget, gradient: Array, value: float) -> Judged:
    """A quantity f of the budget's, to first order (JCGM 100, 5.1.2, 5.2.2 and G.4.1).

    Parameters
    ----------
    budget : of the fit
    gradient : (q,), df/d(quantity)
    value : of f
    """
    parts = np.array([np.sqrt(max(float(gradient @ c.covariance @ gradient), 0.0)) for c in budget.components])
    u = float(np.sqrt((parts**2).sum()))
    degrees = effective_degrees(parts, [c.degrees for c in budget.components])
    k = coverage_factor(degrees)
    return Judged(float(value), u, degrees, k, k * u, parts)


def effective_degrees(parts: Array, degrees: Sequence[float]) -> float:
    """Welch and Satterthwaite: u^4 / sum of u_i^4/nu_i (JCGM 100, G.2b).

    Parameters
    ----------
    parts : (n,), standard uncertainties
    degrees : of freedom of each; infinite where it is taken as known
    """
    finite = np.isfinite(degrees)
    below = float((parts[finite] ** 4 / np.asarray(degrees, dtype=float)[finite]).sum()) if finite.any() else 0.0
    return float((parts**2).sum() ** 2 / below) if below > 0 else INFINITE


def coverage_factor(degrees: float, level: float = LEVEL) -> float:
    """k of an interval of that level: Student's t, degrees rounded down to a whole number (JCGM 100, G.4.1).

    Parameters
    ----------
    degrees : effective degrees of freedom
    level : of confidence
    """
    if not np.isfinite(degrees):
        return float(ndtri((1 + level) / 2))
    return float(stdtrit(max(np.floor(degrees), 1.0), (1 + level) / 2))


__all__ = ["LEVEL", "Budget", "Judged", "budget_of", "coverage_factor", "effective_degrees", "judged"]
