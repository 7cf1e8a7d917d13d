"""Phase analysis of one slowly damped oscillation (8.2): six derivatives from omega, y0/beta0 and K^2."""

from __future__ import annotations

import numpy as np

from ..simulate.model import Array


def phase_analysis(
    omega_rad_s: float,
    y0_over_beta0_m: float,
    tension_n: float,
    tow_point_m: float,
    line_length_m: float,
    speed_m_s: float,
    k2_m2: float,
) -> Array:
    """Return (m', I', Y_v, Y_R, N_v, N_r), (6,), SI, for y = -y0 cos(wt), beta = b0 sin(wt) (8.4, 8.8, 8.9).

    N_r = -T X_T (y0/b0)/(L w); Y_v = T (1 + X_T/L)/(w (y0/b0) - U); Y_R = [m' w (w (y0/b0) - U) - T (y0/b0)/L]/w;
    N_v = [T X_T (1 + X_T/L) - I' w^2]/(w (y0/b0) - U); m' = T (1 + L X_T/K^2)/(L w^2); I' = K^2 m'.

    Parameters
    ----------
    omega_rad_s : w
    y0_over_beta0_m : amplitude ratio y0/b0, m/rad, positive
    tension_n : T, N
    tow_point_m : X_T, m ahead of LCG
    line_length_m : L, m
    speed_m_s : U, m/s
    k2_m2 : K^2 = I'/m', m2

    (8.4) is exact at zero damping; (8.8) is an empirical closure, on the ITTC hull off by +4 to -1 % (theory.md 6).
    """
    t, x, length, w, ratio = tension_n, tow_point_m, line_length_m, omega_rad_s, y0_over_beta0_m
    sway = w * ratio - speed_m_s
    mass = t * (1 + length * x / k2_m2) / (length * w**2)
    inertia = k2_m2 * mass
    return np.array(
        [
            mass,
            inertia,
            t * (1 + x / length) / sway,
            (mass * w * sway - t * ratio / length) / w,
            (t * x * (1 + x / length) - inertia * w**2) / sway,
            -t * x * ratio / (length * w),
        ]
    )
