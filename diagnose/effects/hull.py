"""Forces on the hull that the linear derivatives do not hold."""

from __future__ import annotations

import numpy as np

from .base import Effect, Parameter, Situation

STRIPS, _WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Stations along the hull from -1 (stern) to 1 (bow), and their shares."""


def _crossflow(s: Situation, drag, trim):
    """-1/2 rho c d Int |v + x r| (v + x r) (1, x) dx over the length; c d grows towards the bow by ``trim``."""
    place = STRIPS.reshape(-1, *[1] * np.ndim(s.v_m_s))
    half = 0.5 * s.length_pp_m
    across = s.v_m_s + half * place * s.r_rad_s
    local = _WEIGHTS.reshape(place.shape) * across * np.abs(across)
    even, odd, square = local.sum(axis=0), (place * local).sum(axis=0), (place**2 * local).sum(axis=0)
    size = -0.5 * s.density_kg_m3 * half
    return size * (drag * even + trim * odd), size * half * (drag * odd + trim * square)


def _cubic(s: Situation, y_vvv, n_vvv, n_rrr):
    v3, r3 = s.v_m_s**3, s.r_rad_s**3
    return y_vvv * v3, n_vvv * v3 + n_rrr * r3


def _asymmetry(s: Situation, side, moment):
    return side * s.speed_m_s**2, moment * s.speed_m_s**2


def _current(s: Situation, speed, shear):
    """The water moves to starboard at ``speed`` + ``shear`` y: the hull's sway through it is smaller by as much."""
    flow = speed + shear * s.y_m
    return -s.y_v * flow, -s.n_v * flow


def _memory(s: Situation, sway, yaw, moment):
    late = s.v_lag - s.v_m_s
    return sway * s.y_v * late, yaw * s.n_r * (s.r_lag - s.r_rad_s) + moment * s.n_v * late


def _bank(s: Situation, force, arm):
    """Suction grows with the inverse square of the gap to each wall; the net force is that of the two walls."""
    share = np.clip(s.y_m / s.half_width_m, -0.9, 0.9)
    pull = 0.25 * ((1 - share) ** -2.0 - (1 + share) ** -2.0)
    side = force * s.density_kg_m3 * s.speed_m_s**2 * pull
    return side, arm * s.density_kg_m3 * s.speed_m_s**2 * s.length_pp_m * pull


def _no_width(run) -> str:
    return "" if run.file.water is not None and run.file.water.tank_width_m else "water.tank_width_m is not given"


CROSSFLOW = Effect(
    "crossflow_drag",
    "sway",
    (Parameter("drag_depth_m", "m", 0.15, one_sided=True), Parameter("trim_depth_m", "m", 0.05)),
    "Each section of a hull that moves sideways leaves a wake and drags with the square of its own speed.",
    "Add Y_v|v|, N_v|v|, N_r|r| (or strip theory) to the simulator; keep the tow's angles small for the linear derivatives.",
    "theory.md 2; Faltinsen (1990), ch. 6",
    force=_crossflow,
    title="quadratic cross-flow drag",
)
CUBIC = Effect(
    "cubic_damping",
    "sway",
    (
        Parameter("y_vvv", "N s3/m3", 2000.0),
        Parameter("n_vvv", "N s3/m2", 1000.0),
        Parameter("n_rrr", "N m s3", 2000.0),
    ),
    "Lift and drag at larger drift angles, in Abkowitz's odd cubic form.",
    "Add Y_vvv, N_vvv, N_rrr to the simulator.",
    "thesis (2.41)",
    force=_cubic,
    title="cubic damping",
)
ASYMMETRY = Effect(
    "hull_asymmetry",
    "yaw",
    (Parameter("y_star_n_s2_m2", "N s2/m2", 0.05), Parameter("n_star_n_m_s2_m2", "N m s2/m2", 0.05)),
    "A crooked appendage or a rudder not amidships pushes with a constant force and moment that grow with U^2.",
    "Set the rudder amidships, or give Y* and N* to the simulator.",
    "thesis 4.1",
    force=_asymmetry,
    title="a hull that pulls to one side",
)
COUPLING = Effect(
    "added_mass_coupling",
    "yaw",
    (Parameter("y_rdot", "kg m", 15.0), Parameter("n_vdot", "kg m", 15.0)),
    "Accelerating water about an unsymmetrical fore and aft body couples sway and yaw.",
    "Add Y_rdot and N_vdot to the equations of motion.",
    "theory.md 2",
    coupling=lambda y_rdot, n_vdot: (y_rdot, n_vdot),
    title="added mass that couples sway and yaw",
)
CURRENT = Effect(
    "cross_current",
    "sway",
    (Parameter("current_m_s", "m/s", 0.01), Parameter("shear_1_s", "1/s", 0.003)),
    "The water in the tank drifts sideways, so that a hull on a straight course already sways through it.",
    "Wait between runs until the tank is calm; measure the current.",
    "theory.md 2",
    force=_current,
    title="a current across the tank",
)
BANK = Effect(
    "bank_suction",
    "sway",
    (Parameter("suction_m2", "m2", 0.01, one_sided=True), Parameter("moment_m2", "m2", 0.005)),
    "Water runs faster between hull and the near wall; its pressure falls and the hull is pulled there.",
    "Tow in a wider tank or nearer to its middle; add the wall force to the simulator.",
    "Norrbin (1974)",
    force=_bank,
    needs=_no_width,
    title="suction of the near wall",
)
MEMORY = tuple(
    Effect(
        "fluid_memory",
        "sway",
        (
            Parameter("share_sway", "", 0.3, one_sided=True),
            Parameter("share_yaw", "", 0.3, one_sided=True),
            Parameter("share_n_v", "", 0.3),
        ),
        "Part of the damping comes from vortices and waves shed a little earlier: it lags behind the motion.",
        "Use damping with memory (a first-order lag) in the simulator.",
        "Cummins (1962)",
        force=_memory,
        lag_s=lag_s,
        variant=f"{lag_s:g} s",
        title="damping with memory",
    )
    for lag_s in (0.5, 1.0, 2.0, 4.0)
)
