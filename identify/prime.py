"""The non-dimensional (prime) system of theory.md 2: force / (rho/2 L^2 U^2), moment / (rho/2 L^3 U^2), ..."""

from __future__ import annotations

import numpy as np

from ..simulate.model import DERIVATIVE_UNITS

_LENGTH_POWER = {"m_minus_y_vdot": 3, "i_minus_n_rdot": 5, "y_v": 2, "y_r_minus_mu": 3, "n_v": 3, "n_r": 4}
"""Powers of L in rho/2 L^n U^k (theory.md 2)."""
_SPEED_POWER = {"m_minus_y_vdot": 0, "i_minus_n_rdot": 0, "y_v": 1, "y_r_minus_mu": 1, "n_v": 1, "n_r": 1}
"""Powers of U."""


def prime_factors(density_kg_m3: float, length_pp_m: float, speed_m_s: float) -> np.ndarray:
    """Dimensional value of one prime unit of each of the six derivatives, (6,), in the order of ``DERIVATIVE_UNITS``.

    Parameters
    ----------
    density_kg_m3 : of the water, kg/m3
    length_pp_m : LBP, m
    speed_m_s : U, m/s
    """
    return np.array(
        [0.5 * density_kg_m3 * length_pp_m ** _LENGTH_POWER[n] * speed_m_s ** _SPEED_POWER[n] for n in DERIVATIVE_UNITS]
    )
