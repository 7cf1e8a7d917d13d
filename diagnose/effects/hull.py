"""Forces on the hull that the linear derivatives do not hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .base import Effect, Parameter, Situation, along_the_run, swinging
from .members import any_of, with_some

STRIPS, _WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Stations along the hull from -1 (stern) to 1 (bow), and their shares."""


SWINGS = 0.3
"""Damping of a memory that swings: a kernel that is lost after two swings or so. A choice."""
STALLS_RAD, LEAST_STALL_RAD = 0.3, 0.05
"""Angle to the water at which a fin has lost most of its lift, where a fit begins, and how small it is at least: choices."""
NEAREST_WALL = 0.9
"""Of the way to the wall: no hull's middle comes nearer, and no force grows beyond that of this place."""


def _crossflow(s: Situation, drag, trim, ends=0.0):
    """-1/2 rho c d Int |v + x r| (v + x r) (1, x) dx over the length.

    c d grows towards the bow by ``trim``, and towards both ends by ``ends``.
    """
    place = STRIPS.reshape(-1, *[1] * np.ndim(s.v_m_s))
    half = 0.5 * s.length_pp_m
    across = s.v_m_s + half * place * s.r_rad_s
    local = _WEIGHTS.reshape(place.shape) * across * np.abs(across)
    even, odd, square, third = ((place**k * local).sum(axis=0) for k in range(4))
    size, middle = -0.5 * s.density_kg_m3 * half, drag - ends / 3
    side = middle * even + trim * odd + ends * square
    return size * side, size * half * (middle * odd + trim * square + ends * third)


def _cubic(s: Situation, y_vvv, n_vvv, n_rrr):
    v3, r3 = s.v_m_s**3, s.r_rad_s**3
    return y_vvv * v3, n_vvv * v3 + n_rrr * r3


def _cubic_mixed(s: Situation, y_vvv, n_vvv, n_rrr, y_vvr, n_vvr, y_vrr, n_vrr, y_rrr):
    """Abkowitz's cubic with all of its mixed terms."""
    side, moment = _cubic(s, y_vvv, n_vvv, n_rrr)
    v, r = s.v_m_s, s.r_rad_s
    side = side + y_vvr * v * v * r + y_vrr * v * r * r + y_rrr * r**3
    return side, moment + n_vvr * v * v * r + n_vrr * v * r * r


def _cubic_by_angle(s: Situation, y_vvv, n_vvv, n_rrr):
    """A polynomial in the drift angle whose forces grow with U^2: with v^3/U."""
    side, moment = _cubic(s, y_vvv, n_vvv, n_rrr)
    return side / s.speed_m_s, moment / s.speed_m_s


def _asymmetry(s: Situation, side, moment):
    return side * s.speed_m_s**2, moment * s.speed_m_s**2


def _fin(place: float) -> Callable[..., tuple[Any, Any]]:
    """A crooked fin, ``place`` + ``ahead`` in lengths ahead of midship: its lift falls as the water there comes from aside."""

    def force(s: Situation, side, moment, ahead, stalls):
        across = s.v_m_s + (place + ahead) * s.length_pp_m * s.r_rad_s
        aside = np.arctan2(across, s.speed_m_s) / np.maximum(stalls, LEAST_STALL_RAD)
        flow = (s.speed_m_s**2 + across**2) * np.exp(-(aside**2))
        return side * flow, moment * flow

    return force


def _cable(s: Situation, side, moment):
    return side + 0.0 * s.v_m_s, moment + 0.0 * s.v_m_s


def _moduli(s: Situation, y_vv, y_vr, n_vv, n_vr, n_rr):
    """v|v| and v|r| aside, these and r|r| in the moment; depth times coefficient of a hull that drags as a plate of it."""
    size, turn = -0.5 * s.density_kg_m3 * s.length_pp_m, s.r_rad_s * s.length_pp_m
    v, own, rate = s.v_m_s, np.abs(s.v_m_s), np.abs(turn)
    return size * v * (y_vv * own + y_vr * rate), size * s.length_pp_m * (
        v * (n_vv * own + n_vr * rate) + n_rr * turn * rate
    )


def _one_part(place: float) -> Callable[..., tuple[Any, Any]]:
    """A skeg, a deep forefoot: drag of a part of the hull about one place, ``place`` + ``ahead`` in lengths ahead of midship.

    A bell of the standard deviation ``wide``, by Gauss and Hermite's three points.
    """

    def force(s: Situation, drag, ahead, wide):
        side = moment = 0.0
        for weight, off in ((2 / 3, 0.0), (1 / 6, np.sqrt(3.0)), (1 / 6, -np.sqrt(3.0))):
            arm = (place + ahead + off * wide) * s.length_pp_m
            across = s.v_m_s + arm * s.r_rad_s
            here = -0.5 * weight * s.density_kg_m3 * s.length_pp_m * drag * across * np.abs(across)
            side, moment = side + here, moment + arm * here
        return side, moment

    return force


def _carried(s: Situation, flow: Any) -> tuple[Any, Any]:
    """Water that moves to starboard: the hull's sway through it is smaller by as much."""
    return -s.y_v * flow, -s.n_v * flow


def _current(s: Situation, speed, shear):
    """The water moves to starboard at ``speed`` + ``shear`` y."""
    return _carried(s, speed + shear * s.y_m)


def _current_along(s: Situation, speed, along, bent, twice):
    """It changes along the tank, as Legendre's polynomials of the way do: grows, or goes to and fro once or so."""
    return _carried(s, speed + along_the_run(s, along, bent, twice))


def _current_swings(length_m: float) -> Callable[..., tuple[Any, Any]]:
    """Eddies that an earlier tow has left: to and fro along the tank, the faster for a model the faster it passes them."""

    def force(s: Situation, speed, sine, cosine, faster):
        return _carried(s, speed + swinging(s, length_m / s.speed_m_s, sine, cosine, faster))

    return force


def _memory(s: Situation, sway, yaw, moment, *_):
    late = s.v_lag - s.v_m_s
    return sway * s.y_v * late, yaw * s.n_r * (s.r_lag - s.r_rad_s) + moment * s.n_v * late


def _bank(power: int, near: bool) -> Callable[..., tuple[Any, Any]]:
    """Suction by a power of the gap, of both walls or of the nearer one alone; 1 near the middle for each half width off it.

    The force stands ``ahead`` of midship (it sees the gap there), and a hull that heads for the wall is turned by ``turn``.
    """

    def pull(share):
        share = np.clip(share, -NEAREST_WALL, NEAREST_WALL)
        if near:
            return np.sign(share) * ((1 - np.abs(share)) ** -power - 1) / power
        return ((1 - share) ** -power - (1 + share) ** -power) / (2 * power)

    def force(s: Situation, suction, arm, ahead=0.0, turn=0.0):
        there = (s.y_m + ahead * s.length_pp_m * s.beta_rad) / s.half_width_m
        drawn, size = pull(there), s.density_kg_m3 * s.speed_m_s**2
        across = s.length_pp_m * s.beta_rad / s.half_width_m
        return size * suction * drawn, size * s.length_pp_m * (arm * drawn + turn * across)

    return force


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
    members=with_some(["drag_depth_m"], ["trim_depth_m"]),
    title="quadratic cross-flow drag",
)
CROSSFLOW_ENDS = replace(
    CROSSFLOW,
    parameters=(*CROSSFLOW.parameters, Parameter("ends_depth_m", "m", 0.05)),
    members=with_some(["drag_depth_m", "ends_depth_m"], ["trim_depth_m"]),
    variant="fuller at the ends",
)
"""Or finer: a number below zero."""
CROSSFLOW_FORMS = (
    replace(
        CROSSFLOW,
        parameters=(
            Parameter("y_v_v_m", "m", 0.1, one_sided=True),
            Parameter("y_v_r_m", "m", 0.02),
            Parameter("n_v_v_m", "m", 0.05),
            Parameter("n_v_r_m", "m", 0.01),
            Parameter("n_r_r_m", "m", 0.02, one_sided=True),
        ),
        force=_moduli,
        members=any_of("y_v_v_m", "y_v_r_m", "n_v_v_m", "n_v_r_m", "n_r_r_m"),
        source="Fedyaevsky and Sobolev (1963)",
        variant="second-order moduli",
    ),
    *(
        replace(
            CROSSFLOW,
            parameters=(
                Parameter("drag_depth_m", "m", 0.06, one_sided=True),
                Parameter("ahead", "", 0.15),
                Parameter("wide", "", 0.05, none=0.1),
            ),
            force=_one_part(place),
            members=(),
            variant=f"of the {part} alone",
        )
        for place, part in ((-0.35, "after body"), (0.0, "middle body"), (0.35, "fore body"))
    ),
)
"""Beside sections that drag by their own speed alone."""
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
    members=any_of("y_vvv", "n_vvv", "n_rrr"),
    title="cubic damping",
)
CUBIC_FORMS = (
    replace(
        CUBIC,
        parameters=(
            *CUBIC.parameters,
            Parameter("y_vvr", "N s3/m2", 2000.0),
            Parameter("n_vvr", "N s3/m", 2000.0),
            Parameter("y_vrr", "N s3/m", 2000.0),
            Parameter("n_vrr", "N s3", 2000.0),
            Parameter("y_rrr", "N s3", 2000.0),
        ),
        force=_cubic_mixed,
        members=with_some(["y_vvv", "n_vvv", "n_rrr"], [("y_vvr", "n_vvr"), ("y_vrr", "n_vrr"), "y_rrr"], 1),
        variant="with mixed terms",
    ),
    replace(
        CUBIC,
        parameters=tuple(
            replace(p, unit=unit) for p, unit in zip(CUBIC.parameters, ("N s2/m2", "N s2/m", "N m2 s2"), strict=True)
        ),
        force=_cubic_by_angle,
        variant="by the drift angle",
    ),
)
"""Beside the plain one."""
ASYMMETRY = Effect(
    "hull_asymmetry",
    "yaw",
    (Parameter("y_star_n_s2_m2", "N s2/m2", 0.05), Parameter("n_star_n_m_s2_m2", "N m s2/m2", 0.05)),
    "A crooked appendage or a rudder not amidships pushes with a constant force and moment that grow with U^2.",
    "Set the rudder amidships, or give Y* and N* to the simulator.",
    "thesis 4.1",
    force=_asymmetry,
    members=any_of("y_star_n_s2_m2", "n_star_n_m_s2_m2"),
    title="a hull that pulls to one side",
)
CABLE = replace(
    ASYMMETRY,
    parameters=(Parameter("y_star_n", "N", 0.08), Parameter("n_star_n_m", "N m", 0.08)),
    physics="A cable to the carriage, or a list, pushes with a constant force and moment at any speed.",
    cure="Let the cable hang free of the model, or give Y* and N* at each speed.",
    source="thesis 4.1",
    force=_cable,
    members=any_of("y_star_n", "n_star_n_m"),
    variant="a cable's, at any speed",
)
"""Beside what grows with U^2; runs of one speed cannot tell the two."""
FINS = tuple(
    replace(
        ASYMMETRY,
        parameters=(
            *ASYMMETRY.parameters,
            Parameter("ahead", "", 0.1),
            Parameter("stalls_rad", "rad", 0.12, none=STALLS_RAD),
        ),
        physics="A crooked fin or rudder pushes aside, the less the more the water comes at it from aside.",
        force=_fin(place),
        members=with_some(["ahead", "stalls_rad"], ["y_star_n_s2_m2", "n_star_n_m_s2_m2"], 1),
        variant=f"a fin {where}, stalling",
    )
    for place, where in ((-0.4, "aft"), (0.4, "forward"))
)
"""And what stalls: a crooked fin's lift is not the same at all angles of the hull."""
COUPLING = Effect(
    "added_mass_coupling",
    "yaw",
    (Parameter("y_rdot", "kg m", 15.0), Parameter("n_vdot", "kg m", 15.0)),
    "Accelerating water about an unsymmetrical fore and aft body couples sway and yaw.",
    "Add Y_rdot and N_vdot to the equations of motion.",
    "theory.md 2",
    coupling=lambda y_rdot, n_vdot: (y_rdot, n_vdot),
    members=any_of("y_rdot", "n_vdot"),
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
    members=any_of("current_m_s", "shear_1_s"),
    title="a current across the tank",
)
CURRENT_ALONG = replace(
    CURRENT,
    parameters=(
        CURRENT.parameters[0],
        Parameter("along_m_s", "m/s", 0.004),
        Parameter("bent_m_s", "m/s", 0.003),
        Parameter("twice_m_s", "m/s", 0.003),
    ),
    force=_current_along,
    members=with_some(["along_m_s"], ["current_m_s", "bent_m_s", "twice_m_s"]),
    variant="that changes along the tank",
)
"""Beside one that is stronger at one wall ..."""
EDDIES_M = (13.0, 19.0, 27.0, 39.0)
"""Lengths from which eddies along the tank are sought; longer ones are a current that grows."""
CURRENT_SWINGS = tuple(
    replace(
        CURRENT,
        parameters=(
            CURRENT.parameters[0],
            Parameter("sine_m_s", "m/s", 0.002),
            Parameter("cosine_m_s", "m/s", 0.002),
            Parameter("faster", "", 0.1),
        ),
        force=_current_swings(length_m),
        members=with_some(["sine_m_s", "cosine_m_s", "faster"], ["current_m_s"]),
        variant=f"to and fro, about {length_m:g} m",
    )
    for length_m in EDDIES_M
)
"""... and as eddies of an earlier tow."""
_OF_BANK = (Parameter("suction_m2", "m2", 0.01, one_sided=True), Parameter("moment_m2", "m2", 0.005))
"""Numbers of a force on the whole hull: their usual sizes, choices; ..."""
_BY_SECTIONS = (*_OF_BANK, Parameter("ahead", "", 0.2), Parameter("turn_m2", "m2", 0.003))
"""... and of one that sections of the hull see."""
BANK = tuple(
    Effect(
        "bank_suction",
        "sway",
        parameters,
        "Water runs faster between hull and the near wall; its pressure falls and the hull is pulled there.",
        "Tow in a wider tank or nearer to its middle; add the wall force to the simulator.",
        "Norrbin (1974)",
        force=_bank(power, near),
        members=with_some(always, others),
        needs=_no_width,
        variant=f"{'near wall' if near else 'both walls'}, gap^-{power}{', by sections' if len(parameters) > 2 else ''}",
        title="suction of the near wall",
    )
    for near in (False, True)
    for power in (2, 1, 3)
    for parameters, always, others in (
        (_OF_BANK, ["suction_m2"], ["moment_m2"]),
        (_BY_SECTIONS, ["suction_m2", "ahead"], ["moment_m2", "turn_m2"]),
    )
)
"""Powers of the gap that panel methods and model tests have; forces on one section or on all."""
_OF_MEMORY = (
    Parameter("share_sway", "", 0.3, one_sided=True),
    Parameter("share_yaw", "", 0.3, one_sided=True),
    Parameter("share_n_v", "", 0.3),
)
"""How much of the damping comes late; ..."""
_FASTER, _DAMPED = Parameter("faster", "", 0.2), Parameter("damped", "", 0.12)
"""... and how it follows, from where a fit begins."""
MEMORY = tuple(
    Effect(
        "fluid_memory",
        "sway",
        (*_OF_MEMORY, _FASTER, *([_DAMPED] if damping else [])),
        "Part of the damping comes from vortices and waves shed a little earlier: it lags behind the motion.",
        "Use damping with memory (a lag of first order, or one that swings) in the simulator.",
        "Cummins (1962)",
        force=_memory,
        members=tuple(
            (*some, "faster", *(["damped"] if damping else [])) for some in any_of(*(p.name for p in _OF_MEMORY))
        ),
        lag_s=lag_s,
        swings=damping,
        lagging=2 if damping else 1,
        variant=f"swinging, about {lag_s:g} s" if damping else f"about {lag_s:g} s",
        title="damping with memory",
    )
    for lag_s, damping in (*((t, 0.0) for t in (0.5, 1.0, 2.0, 4.0)), *((t, SWINGS) for t in (1.7, 2.5, 3.6, 5.2)))
)
"""Time constants of a kernel that dies away, and periods of one that swings as waves at the free surface do: where fits begin."""
