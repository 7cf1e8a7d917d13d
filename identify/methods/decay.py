"""The decaying record (8.20): two exponentials and one oscillation shared by y and beta, by variable projection.

    y(t)    = y_b + A1 e^(-l1 t) + A2 e^(-l2 t) + C1 e^(-l3 t) sin(w t + p1)
    beta(t) = b_b + c1 e^(-l1 t) + c2 e^(-l2 t) + C3 e^(-l3 t) sin(w t + p2)

The amplitudes are linear: only l1, l2, l3, w are searched (Kaufman's Jacobian), from several starts, under l1 > l2 > 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError, solvable
from ...record.results import Measured
from ...simulate.model import Array, Tow
from ..data import ASSUMED_SIGMA_BETA_RAD, ASSUMED_SIGMA_Y_M
from ..decay_search import Sign, best_model, from_all_starts, inverse_of_squares, limits_of, search
from ..noise import Whitener, measured, stated
from .common import check_series, propagate
from .forced import Swing
from .phase import Amplitudes

REWEIGHTINGS = 2
"""Fits after the first, with the noise measured from what the last one left: a choice."""
AT_BOUND = 1e-3
"""A parameter this near to a bound, relative to its size, stands at it."""


@dataclass(frozen=True)
class DecayFit:
    """Result of ``fit_decay``.

    Attributes
    ----------
    theta : (14,): l1, l2, l3, w, then bias, A1, A2, cos and sin amplitude of y, and the same of beta
    covariance : (14, 14), residual scatter and colour included; 0 where the reduced form fixes A1 = c1 = 0 (l1 NaN)
    reduced : without the fast exponential
    residual : (n, 2), y m and beta rad
    starts, reached : tried starts, and those that ended at this optimum
    notes : parameters at a bound, starts that disagree
    t_0_s : time from which t counts
    """

    theta: Array
    covariance: Array
    reduced: bool
    residual: Array
    starts: int
    reached: int
    notes: tuple[str, ...]
    t_0_s: float

    def _one(self, index: int) -> Measured:
        return Measured(value=float(self.theta[index]), std=float(np.sqrt(max(self.covariance[index, index], 0.0))))

    @property
    def l1_per_s(self) -> Measured:
        """The fast decay; NaN in the reduced form."""
        return self._one(0)

    @property
    def l2_per_s(self) -> Measured:
        """The slow decay."""
        return self._one(1)

    @property
    def l3_per_s(self) -> Measured:
        """Damping of the pair; Tables 8.6 and 8.7 print lambda = -l3."""
        return self._one(2)

    @property
    def omega_rad_s(self) -> Measured:
        """Frequency of the pair."""
        return self._one(3)

    @property
    def y_bias_m(self) -> Measured:
        """y_b."""
        return self._one(4)

    @property
    def beta_bias_rad(self) -> Measured:
        """b_b."""
        return self._one(9)

    @property
    def roots(self) -> Array:
        """-l1, -l2, -l3 +- i w, (4,) complex (three in the reduced form)."""
        l1, l2, l3, w = self.theta[:4]
        real = [-l2] if self.reduced else [-l1, -l2]
        return np.array([*real, complex(-l3, w), complex(-l3, -w)])

    def coefficients(self) -> tuple[Array, Array]:
        """(b, c, d, e) of s^4 + b s^3 + c s^2 + d s + e and their covariance, (4,) and (4, 4): for (9.3).

        Raises
        ------
        EstimationError : the reduced form, which has three roots
        """
        if self.reduced:
            raise EstimationError("the reduced form has three roots; (9.3) needs the fourth")

        def four(rates: Array) -> Array:
            l1, l2, l3, w = rates
            return np.polymul(np.polymul([1.0, l1], [1.0, l2]), [1.0, 2 * l3, l3**2 + w**2])[1:]

        return propagate(four, self.theta[:4], self.covariance[:4, :4])

    def sines(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """((C1, p1), (C3, p2)): amplitude and phase of C e^(-l3 t) sin(w t + p), -pi < p <= pi."""
        y, b = self.theta[7:9], self.theta[12:14]
        return (float(np.hypot(*y)), float(np.arctan2(*y))), (float(np.hypot(*b)), float(np.arctan2(*b)))

    def amplitudes(self) -> Amplitudes:
        """The pair as complex amplitudes at ``t_0_s``, for ``phase_from_amplitudes``."""
        values, covariance = self._pair()
        return Amplitudes(
            complex(values[4], values[5]),
            complex(values[0], values[1]),
            complex(values[2], values[3]),
            covariance[:4, :4],
            float(self.theta[4]),
            float(self.theta[9]),
        )

    def swing(self, tow: Tow) -> Swing:
        """The pair with the covariance of its rate and amplitudes, for ``modal_derivatives``."""
        a = self.amplitudes()
        return Swing(tow, a.rate, a.y_m, a.beta_rad, 0.0, self._pair()[1])

    def _pair(self) -> tuple[Array, Array]:
        """(Re Y, Im Y, Re B, Im B, Re s, Im s) and its covariance; Re(Y e^(iwt)) = Re Y cos - Im Y sin."""
        take = np.zeros((6, 14))
        for row, (column, sign) in enumerate(((7, 1), (8, -1), (12, 1), (13, -1), (2, -1), (3, 1))):
            take[row, column] = sign
        filled = np.where(np.isfinite(self.theta), self.theta, 0.0)
        return take @ filled, take @ self.covariance @ take.T


@solvable(EstimationError)
def fit_decay(
    t_s: Array,
    y_m: Array,
    beta_rad: Array,
    *,
    reduced: bool = False,
    sign: Sign = "free",
    sigma: tuple[float, float] = (ASSUMED_SIGMA_Y_M, ASSUMED_SIGMA_BETA_RAD),
) -> DecayFit:
    """Fit (8.20) to a record; gaps are allowed.

    Parameters
    ----------
    t_s : (n,) times, s
    y_m : (n,) y_CG, m
    beta_rad : (n,) heading, rad
    reduced : A1 = c1 = 0, the form the thesis used for most runs
    sign : of the pair's damping: "stable" l3 > 0, "unstable" l3 < 0, "free" either (the thesis's constraints of (8.22))
    sigma : of y and beta to begin with; their scatter and colour are then measured

    Raises
    ------
    EstimationError : fewer than 30 samples, or less than three quarters of a swing in the record
    """
    check_series(t_s, y_m, beta_rad)
    t = np.asarray(t_s, dtype=float) - t_s[0]
    values = np.column_stack([y_m, beta_rad])
    if len(t) < 30:
        raise EstimationError(f"{len(t)} samples; the decay fit needs at least 30")
    variance = np.broadcast_to(np.diag(np.square(sigma)), (len(t), 2, 2))
    weight = stated(variance, t)
    limits = limits_of(t, reduced, sign)
    best, reached, starts = from_all_starts(t, values, weight, limits, reduced)
    for _ in range(REWEIGHTINGS):
        rest = values - best_model(t, best, values, weight, reduced)[0]
        weight = measured(rest, weight)
        best = search(t, values, weight, best, limits, reduced).x
    return _result(t, float(t_s[0]), values, weight, best, limits, reduced, starts, reached)


def _result(
    t: Array,
    t_0: float,
    values: Array,
    weight: Whitener,
    p: Array,
    limits: tuple[Array, Array],
    reduced: bool,
    starts: int,
    reached: int,
) -> DecayFit:
    model, amplitudes, residual, _ = best_model(t, p, values, weight, reduced)
    inverse = inverse_of_squares(t, p, amplitudes, weight, reduced, 1e-14)
    count, k = len(p), amplitudes.shape[1]
    per_dof = float(residual @ residual) / max(len(residual) - len(inverse), 1)
    own = inverse * max(per_dof, 1e-300)
    # into the fourteen of DecayFit: l1 = (l1 - l2) + l2
    take = np.zeros((14, count + 2 * k))
    rates = [1, 2, 3] if reduced else [0, 1, 2, 3]
    for column, row in enumerate(rates):
        take[row, column] = 1.0
    if not reduced:
        take[0, 1] = 1.0
    places = [0, 2, 3, 4] if reduced else [0, 1, 2, 3, 4]
    for channel in range(2):
        for column, place in enumerate(places):
            take[4 + 5 * channel + place, count + channel * k + column] = 1.0
    theta = take @ np.concatenate([p, amplitudes.ravel()])
    if reduced:
        theta[0] = np.nan
    names = ["l2", "l3", "w"] if reduced else ["l1 - l2", "l2", "l3", "w"]
    notes = []
    for name, value, low, high in zip(names, p, *limits, strict=True):
        room = AT_BOUND * min(high - low, max(abs(value), 1e-6))
        if value - low < room or high - value < room:
            notes.append(
                f"{name} = {value:.4g} stands at the edge of {low:.4g} .. {high:.4g}; the record does not hold it"
            )
    if reached < 2:
        notes.append(f"only one of {starts} starts ended here: look at the residuals before using it")
    return DecayFit(theta, take @ own @ take.T, reduced, values - model, starts, reached, tuple(notes), t_0)
