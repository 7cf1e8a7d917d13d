"""A hull in sway, yaw and surge as an FMU, for ``towline diagnose --hull``: the equations of docs/theory.md in C of their own.

    python examples/hull_fmu.py hull.fmu --version 2

(m - X_u') u' = X + m v r,  (m - Y_v') v' = Y,  (I - N_r') r' = N, with damping that grows with the speed u.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from fmu_of_c import Variable, make

EQUATIONS = r"""
enum { SPEED_U, SWAY_V, YAW_R, M_Y, I_N, Y_V, Y_R, N_V, N_R, QUOTED, MASS, X_U, X_VR, X_VV, X_RR, RESIST, POWER, Y_D, N_D, Y_0,
       N_0, AHEAD, SIDE, MOMENT, RUDDER };
static void rates(const Model *m, const double *x, double *d) {
    const double *p = m->v, v = x[1], r = x[2], s = x[0] / p[QUOTED], square = s * s;
    const double resistance = p[RESIST] * s * pow(fabs(s), p[POWER] - 1);
    const double along = -resistance + v * (p[X_VV] * v + p[X_VR] * r) + p[X_RR] * r * r;
    const double side = s * (p[Y_V] * v + p[Y_R] * r) + square * (p[Y_D] * p[RUDDER] + p[Y_0]);
    const double moment = s * (p[N_V] * v + p[N_R] * r) + square * (p[N_D] * p[RUDDER] + p[N_0]);
    d[0] = (along + p[MASS] * v * r + p[AHEAD]) / (p[MASS] - p[X_U]);
    d[1] = (side + p[SIDE]) / p[M_Y];
    d[2] = (moment + p[MOMENT]) / p[I_N];
}
"""
STATES = (("u_m_s", "m/s", 1.0), ("v_m_s", "m/s", 0.0), ("r_rad_s", "rad/s", 0.0))
PARAMETERS = (
    ("m_minus_y_vdot", "kg", 150.0), ("i_minus_n_rdot", "kg m2", 60.0), ("y_v", "N s/m", -50.0), ("y_r_minus_mu", "N s", -65.0),
    ("n_v", "N s", -50.0), ("n_r", "N m s", -60.0), ("speed_m_s", "m/s", 1.0), ("mass_kg", "kg", 80.0), ("x_udot_kg", "kg", 0.0),
    ("x_vr_kg", "kg", 0.0), ("x_vv_kg_m", "kg/m", 0.0), ("x_rr_kg_m", "kg m", 0.0), ("resistance_n", "N", 4.0),
    ("resistance_exponent", "", 1.85), ("y_delta", "N", 0.0), ("n_delta", "N m", 0.0), ("y_bias_n", "N", 0.0),
    ("n_bias_n_m", "N m", 0.0),
)  # fmt: skip
INPUTS = (("ahead_n", "N"), ("side_n", "N"), ("moment_n_m", "N m"), ("rudder_rad", "rad"))
VARIABLES = (
    *(Variable(name, unit, start, "output") for name, unit, start in STATES),
    *(Variable(name, unit, start, "parameter", "tunable") for name, unit, start in PARAMETERS),
    *(Variable(name, unit, 0.0, "input") for name, unit in INPUTS),
)


def main(arguments: list[str] | None = None) -> None:
    """Make one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("path", type=Path)
    parser.add_argument("--version", type=int, choices=(2, 3), default=2)
    given = parser.parse_args(arguments)
    make(given.path, "hull", EQUATIONS, VARIABLES, len(STATES), given.version)


if __name__ == "__main__":
    main()
