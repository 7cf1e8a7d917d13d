"""Hull conditions of Table 3.2 (3.6), the prime system with errors, the straight-line stability verdict with its probability."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from ...record.errors import EstimationError
from ...record.results import Measured
from ...simulate.model import DERIVATIVE_UNITS, Array, Hull
from ..prime import prime_factors

X_DELTA_SHARE = -0.45
"""The stern force's point of action over Lpp (3.6)."""


def with_stern_force(hull: Hull, force_n_s_m: float, length_pp_m: float) -> Hull:
    """The hull with its rudder's damping reduced by F at x_d = -0.45 Lpp (3.6).

    Y_v + F, N_v + F x_d, Y_R + F x_d, N_r + F x_d^2: what a fixed fin at x_d feels of the drift v + x_d r.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    force_n_s_m : F, N s/m, positive = less stabilising force aft (7.0, 10.76, 15.85 in Table 3.2)
    length_pp_m : LBP, m
    """
    arm = X_DELTA_SHARE * length_pp_m
    return replace(
        hull,
        y_v=hull.y_v + force_n_s_m,
        n_v=hull.n_v + force_n_s_m * arm,
        y_r_minus_mu=hull.y_r_minus_mu + force_n_s_m * arm,
        n_r=hull.n_r + force_n_s_m * arm**2,
    )


def neutral_stern_force(hull: Hull, length_pp_m: float) -> float:
    """F that brings X_r and X_v together (Table 3.2's case 3), N s/m: linear, because F's own part of the criterion is 0.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    length_pp_m : LBP, m
    """
    at_0 = _criterion(hull.six)
    slope = _criterion(with_stern_force(hull, 1.0, length_pp_m).six) - at_0
    if slope == 0:
        raise EstimationError("the stern force does not change this hull's straight-line stability")
    return -at_0 / slope


def to_prime(
    six: Array, density_kg_m3: float, length_pp_m: float, speed_m_s: float, covariance: Array | None = None
) -> dict[str, Measured]:
    """The six derivatives in the prime system with standard deviations (theory.md 2; Tables 3.1, 8.2).

    Parameters
    ----------
    six : (6,), SI
    density_kg_m3 : of the water, kg/m3
    length_pp_m : LBP, m
    speed_m_s : at which they are quoted, m/s
    covariance : (6, 6) of the six, or None
    """
    unit = prime_factors(density_kg_m3, length_pp_m, speed_m_s)
    sd = np.zeros(6) if covariance is None else np.sqrt(np.diag(covariance))
    return {
        name: Measured(value=float(v), std=float(s))
        for name, v, s in zip(DERIVATIVE_UNITS, six / unit, sd / unit, strict=True)
    }


def from_prime(prime: Array, density_kg_m3: float, length_pp_m: float, speed_m_s: float) -> Hull:
    """A hull from the six prime values, (6,), quoted at ``speed_m_s``.

    Parameters
    ----------
    prime : (6,), in the order of ``DERIVATIVE_UNITS``
    density_kg_m3 : of the water, kg/m3
    length_pp_m : LBP, m
    speed_m_s : at which the derivatives are quoted, m/s
    """
    return Hull(*(np.asarray(prime) * prime_factors(density_kg_m3, length_pp_m, speed_m_s)), speed_m_s=speed_m_s)


@dataclass(frozen=True)
class StraightLine:
    """Verdict on a hull's straight-line stability.

    Attributes
    ----------
    criterion : Y_v N_r - N_v Y_R, N2 s2, stable above 0 (3.5)
    x_v_m, x_r_m : points of action; stable for x_r > x_v
    probability_stable : that the criterion is above 0, by the delta method
    sentence : the verdict with its numbers
    """

    criterion: Measured
    x_v_m: Measured
    x_r_m: Measured
    probability_stable: float
    sentence: str


def straight_line_stability(six: Array, covariance: Array) -> StraightLine:
    """Is the hull straight-line stable, and how sure is that?

    Parameters
    ----------
    six, covariance : (6,) and (6, 6), as any estimator here or ``fit_runs`` gives

    The delta method: the criterion is a product, its curvature is neglected; ``probability_by_sampling`` is not.
    """
    _, _, y_v, y_r, n_v, n_r = six
    value = _criterion(six)

    def one(v: float, slope: list[float]) -> Measured:
        g = np.array(slope)
        return Measured(value=float(v), std=float(np.sqrt(max(g @ covariance @ g, 0.0))))

    criterion = one(value, [0, 0, n_r, -n_v, -y_r, y_v])
    x_v = one(n_v / y_v, [0, 0, -n_v / y_v**2, 0, 1 / y_v, 0])
    x_r = one(n_r / y_r, [0, 0, 0, -n_r / y_r**2, 0, 1 / y_r])
    probability = float(ndtr(value / criterion.std)) if criterion.std > 0 else float(value > 0)
    verdict = "stable" if value > 0 else "unstable"
    sure = probability if value > 0 else 1 - probability
    sentence = (
        f"straight-line {verdict}: Y_v N_r - N_v Y_R = {value:.4g} +- {criterion.std:.2g}, X_r = {x_r.value:.3f} and "
        f"X_v = {x_v.value:.3f} m; probability of that verdict {100 * sure:.1f} %"
    )
    return StraightLine(criterion, x_v, x_r, probability, sentence)


def probability_by_sampling(six: Array, covariance: Array, rng: np.random.Generator, draws: int = 20_000) -> Measured:
    """Share of normal draws of the derivatives whose criterion is above 0, with its binomial standard deviation.

    Parameters
    ----------
    six : (6,), the derivatives
    covariance : (6, 6)
    rng : that draws
    draws : how many
    """
    drawn = rng.multivariate_normal(six, covariance, draws)
    share = float(np.mean(_criterion(drawn.T) > 0))
    return Measured(value=share, std=float(np.sqrt(max(share * (1 - share), 1 / draws) / draws)))


def _criterion(six: Array) -> float:
    return six[2] * six[5] - six[4] * six[3]
