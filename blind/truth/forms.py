"""The grammar of reality: in which forms an effect may come, and which of them are kept out while the diagnosis is worked on.

A form's numbers are drawn from its ranges as in ``sizes``; which of them are there says which law holds. The first form of each
effect is the one that reality had before it had others. The first number of a form says its size. In words:

- crossflow_drag: strips with a coefficient that varies along the hull; one deep part (a skeg); the whole hull's v|v| with trim;
  the books' moduli v|v|, v|r|, r|r|; strips that cost resistance ahead as well (X_vv).
- cubic_damping: polynomial in drift angle that grows with U^2; v^3 and r^3 whatever U; with v r^2 and r v^2, growing with U^1 to
  U^2; another power of the drift angle, 2.4 to 4.5.
- hull_asymmetry: a crooked fin anywhere, and a twist; a fin that stalls, aft or forward; a cable's constant force and moment; a
  force that grows with U^0.7 to U^3.2.
- fluid_memory: two exponentials; one, of sway or of yaw; a kernel that swings.
- bank_suction: images behind both walls; the gap to a power of 1 to 3, both walls or the nearer one, a lever of its own; with
  sway damping that rises near the wall.
- cross_current: sheared across the tank; even; growing along the tank; to and fro.
- speed_drift: settling; even; a ramp that ends; a slow swing. The surge follows from it.
- elastic_line: a spring; one that stiffens; one with much damping; one that creeps; a heavy line that hangs.
- swivel_friction: Stribeck and oil; dry; oil; both; grease; the swivel at the post.
- slack_line: the carriage slows, or a wave pushes; the carriage slows suddenly and comes back slowly; a train of waves; a shove.
- tension_variation: a winch's servo to R/cos^power, well damped; one that hunts; one with a lag of the first order; R and more by
  the sine of the angle, as a wrapped pulley rubs.
- constant_tension: a weight over a pulley; one that sticks; one out of round; a drum that its rope makes larger.
- added_mass_coupling: Y_rdot and N_vdot nearly one; unlike; one of them alone. Two numbers are all that accelerations allow.
- tow_point_offset: fixed; slipped at some time; in some runs alone; on a rail. The place itself is one number.
- lens_distortion: a bend of the finished picture; k1; k1 and k2 against each other; a fisheye's angles; a bend about another place.
- camera_shift: three axes, before the tows, between two or in mid-run; one axis; slowly; little by little in all tows; and back.
- deck_height: all marks; the first alone; trim; squat with the speed.
- datum_scale: both ways; ahead alone; aside alone; unlike.
- datum_bias: the post stands aside and ahead; aside alone; ahead alone; since a run. A place has no more.
- frame_rate: a rate that is off; two rates; one that drifts away.
- sync_delay: late by one time; more and more; by another one since some time; in each run another.
- rolling_shutter: rows read downwards; upwards; columns.
- marker_roll: driven by the line's pull, as an oscillator or at once; by sway acceleration; by turning; marks of unlike height.
"""

from __future__ import annotations

from zlib import crc32

import numpy as np

from .cases import Case
from .sizes import EFFECTS, Range

Form = dict[str, Range]
KEEP_SEED = 27
"""Draws what is kept out where no other seed is given."""
KEPT_SHARE = 0.4
"""Of an effect's forms but the first; at least one."""
CHOICES = ("all", "known", "kept", "classic")
"""Which forms campaigns are drawn from: all, those not kept out, those kept out alone, the first of each alone."""

# ranges that several forms of an effect share: choices, as those of ``sizes``
_ROLL: Form = {"period_s": (0.7, 1.8, "even"), "damping": (0.08, 0.3, "log")}
_STRIPS: Form = {"tilt": (-0.4, 0.4, "even"), "ends": (-0.5, 0.8, "even")}
_SOFT: Form = {"damping": (0.02, 0.1, "log"), "shock": (0.0, 0.6, "even")}
_EVENT: Form = {"length_s": (1.6, 2.8, "even"), "begin_s": (8.0, 30.0, "even")}
_TURN: Form = {f"{axis}_rad": (0.001, 0.005, "either") for axis in ("right", "down", "roll")}
_GAP: Form = {"power": (1.0, 3.0, "even"), "lever": (-0.4, 0.4, "even")}

_MORE: dict[str, tuple[str, dict[str, Form]]] = {
    "crossflow_drag": (
        "strips",
        {
            "skeg": {"skeg_m": (0.15, 0.8, "log"), "at": (-0.45, 0.45, "even"), "wide": (0.06, 0.18, "even")},
            "whole hull": {
                "whole_m": (0.04, 0.25, "log"),
                "lever": (-0.25, 0.25, "even"),
                "turning": (0.0, 1.5, "even"),
            },
            "moduli": {
                "moduli_m": (0.04, 0.25, "log"),
                "v_by_r": (-0.3, 0.6, "even"),
                "moment_v_by_r": (-0.05, 0.15, "even"),
                "r_r": (0.01, 0.05, "log"),
            },
            "with drag ahead": {"drag_m": (0.04, 0.25, "log"), "ahead_kg_m": (10.0, 60.0, "log"), **_STRIPS},
        },
    ),
    "cubic_damping": (
        "drift angle",
        {
            "plain cubes": {
                "plain_side": (0.3, 1.5, "log"),
                "plain_turn": (0.006, 0.03, "log"),
                "arm": (-0.3, 0.4, "even"),
            },
            "mixed": {
                "mix_side": (0.3, 1.5, "log"),
                "mix_turn": (0.006, 0.03, "log"),
                "cross": (-0.5, 1.5, "even"),
                "yaw_cross": (-1.0, 3.0, "even"),
                "growth": (1.0, 2.0, "even"),
                "arm": (-0.3, 0.4, "even"),
            },
            "steep": {"steep_side": (0.4, 2.0, "log"), "power": (2.4, 4.5, "even"), "arm": (-0.3, 0.4, "even")},
        },
    ),
    "hull_asymmetry": (
        "fin",
        {
            "fin aft, stalling": {
                "stall_n_s2_m2": (0.03, 0.2, "either"),
                "place": (-0.5, -0.35, "even"),
                "stall_rad": (0.15, 0.5, "log"),
            },
            "fin forward, stalling": {
                "stall_n_s2_m2": (0.03, 0.2, "either"),
                "place": (0.3, 0.5, "even"),
                "stall_rad": (0.15, 0.5, "log"),
            },
            "cable": {"wire_n": (0.03, 0.25, "either"), "wire_n_m": (0.008, 0.05, "either")},
            "growing": {"grows_n": (0.03, 0.25, "either"), "power": (0.7, 3.2, "even"), "place": (-0.5, 0.4, "even")},
        },
    ),
    "fluid_memory": (
        "two lags",
        {
            "one lag, sway": {
                "sway": (0.1, 0.5, "log"),
                "quick": (1.0, 1.0, "even"),
                "fast_s": (0.4, 4.0, "log"),
                "arm": (0.5, 1.2, "even"),
            },
            "one lag, yaw": {"yaw": (0.06, 0.35, "log"), "quick": (1.0, 1.0, "even"), "fast_s": (0.4, 4.0, "log")},
            "ringing": {
                "ring_sway": (0.12, 0.6, "log"),
                "ring_yaw": (0.12, 0.6, "log"),
                "ring_s": (1.5, 6.0, "log"),
                "ring_damping": (0.15, 0.5, "log"),
                "arm": (0.5, 1.2, "even"),
            },
        },
    ),
    "bank_suction": (
        "images",
        {
            "gap": {"gap_n_s2_m2": (0.35, 1.6, "log"), **_GAP},
            "near wall": {"near_n_s2_m2": (0.35, 1.6, "log"), **_GAP},
            "gap and sway": {"gap_n_s2_m2": (0.35, 1.6, "log"), **_GAP, "by_sway": (10.0, 60.0, "log")},
        },
    ),
    "cross_current": (
        "sheared",
        {
            "even": {"even_m_s": (0.003, 0.02, "either")},
            "growing": {"grows_m_s": (0.0008, 0.006, "either"), "first": (0.0, 0.4, "even")},
            "to and fro": {
                "swirl_m_s": (0.0003, 0.002, "log"),
                "eddy_m": (12.0, 50.0, "log"),
                "phase": (0.0, 6.28, "even"),
            },
        },
    ),
    "speed_drift": (
        "settling",
        {
            "even": {"ramp_share": (0.008, 0.05, "either"), "ramp_end": (1.05, 1.05, "even")},
            "ramp that ends": {"ramp_share": (0.008, 0.05, "either"), "ramp_end": (0.2, 0.7, "even")},
            "slow swing": {
                "swing_share": (0.003, 0.015, "log"),
                "swing_s": (20.0, 90.0, "log"),
                "swing_phase": (0.0, 6.28, "even"),
            },
        },
    ),
    "elastic_line": (
        "spring",
        {
            "stiffening": {"compliance_m_n": (0.002, 0.01, "log"), "stiffens": (0.4, 2.0, "even"), **_SOFT},
            "much damping": {
                "compliance_m_n": (0.002, 0.01, "log"),
                "damping": (0.2, 0.9, "log"),
                "shock": (0.0, 0.6, "even"),
            },
            "creeping": {
                "compliance_m_n": (0.0015, 0.008, "log"),
                "creep": (0.2, 1.0, "log"),
                "creep_s": (1.0, 10.0, "log"),
                **_SOFT,
            },
            "hanging": {"sag": (0.005, 0.03, "log"), **_SOFT},
        },
    ),
    "swivel_friction": (
        "Stribeck and oil",
        {
            "dry": {"dry_n_m": (0.015, 0.09, "log")},
            "oil": {"oil_n_m": (0.03, 0.2, "log")},
            "dry and oil": {"dry_n_m": (0.01, 0.06, "log"), "oil_n_m": (0.01, 0.1, "log")},
            "grease": {"grease_n_m": (0.015, 0.1, "log"), "thins": (0.3, 0.7, "even")},
            "at the post": {"post_n_m": (0.01, 0.06, "log")},
        },
    ),
    "marker_roll": (
        "swinging",
        {
            "at once": {
                "lean_rad": (0.02, 0.1, "either"),
                "period_s": (0.3, 0.4, "even"),
                "damping": (0.7, 1.0, "even"),
            },
            "by sway": {"sway_rad": (0.012, 0.06, "either"), **_ROLL},
            "by turning": {"turn_rad": (0.008, 0.04, "either"), **_ROLL},
            "unlike heights": {"lean_rad": (0.02, 0.1, "either"), **_ROLL, "uneven": (0.3, 0.9, "either")},
        },
    ),
    "added_mass_coupling": (
        "alike",
        {
            "unlike": {"y_rdot": (6.0, 30.0, "either"), "n_vdot": (8.0, 40.0, "either")},
            "sway by yaw alone": {"y_rdot": (8.0, 40.0, "either")},
            "yaw by sway alone": {"n_vdot": (8.0, 40.0, "either")},
        },
    ),
    "slack_line": (
        "stop or wave",
        {
            "sudden stop": {"brake": (1.6, 2.6, "log"), **_EVENT},
            "train of waves": {
                "crest": (1.6, 2.6, "log"),
                "length_s": (4.5, 7.5, "even"),
                "begin_s": (8.0, 28.0, "even"),
            },
            "shove": {"shove": (1.3, 2.2, "log"), **_EVENT},
        },
    ),
    "tension_variation": (
        "servo",
        {
            "hunting": {"power": (0.6, 1.8, "log"), "period_s": (1.5, 4.0, "log"), "rings": (0.1, 0.35, "log")},
            "lag": {"power": (0.6, 1.8, "log"), "lag_s": (0.3, 2.0, "log")},
            "wrapped": {"wrap": (0.05, 0.25, "log"), "period_s": (0.6, 3.0, "log")},
        },
    ),
    "constant_tension": (
        "weight",
        {
            "sticking": {
                "friction": (0.004, 0.02, "log"),
                "stick": (0.3, 1.5, "log"),
                "drag_n_s_m": (0.5, 5.0, "log"),
                "weight": (0.998, 1.003, "even"),
            },
            "out of round": {
                "unround": (0.003, 0.02, "log"),
                "round_m": (0.06, 0.3, "log"),
                "phase": (0.0, 6.28, "even"),
                "drag_n_s_m": (0.5, 5.0, "log"),
                "weight": (0.998, 1.003, "even"),
            },
            "drum": {
                "drum_1_m": (0.03, 0.25, "log"),
                "friction": (0.002, 0.02, "log"),
                "drag_n_s_m": (0.5, 5.0, "log"),
                "weight": (0.998, 1.003, "even"),
            },
        },
    ),
    "tow_point_offset": (
        "fixed",
        {
            "slipped": {"slip_m": (0.0012, 0.007, "either"), "slip_s": (8.0, 32.0, "even")},
            "in some runs": {"offset_m": (0.004, 0.02, "either")},
            "on a rail": {"slide_m": (0.003, 0.015, "log")},
        },
    ),
    "lens_distortion": (
        "bend",
        {
            "k1": {"k1": (0.01, 0.05, "either")},
            "k1 and k2": {"k1": (0.015, 0.07, "either"), "k2_share": (-2.0, -0.7, "even")},
            "fisheye": {"fisheye": (0.03, 0.15, "log")},
            "off centre": {
                "aside": (0.01, 0.05, "either"),
                "centre_u": (0.05, 0.2, "either"),
                "centre_v": (0.03, 0.12, "either"),
            },
        },
    ),
    "camera_shift": (
        "three axes",
        {
            "one axis": dict.fromkeys(_TURN, (0.0015, 0.007, "either")),
            "slowly": {**_TURN, "over_s": (2.0, 15.0, "log")},
            "little by little": {**_TURN, "creep_s": (90.0, 300.0, "even")},
            "and back": {**_TURN, "back_s": (5.0, 20.0, "even")},
        },
    ),
    "deck_height": (
        "all marks",
        {
            "first mark": {"bow_m": (0.006, 0.025, "either")},
            "trim": {"trim_m": (0.004, 0.015, "either")},
            "squat": {"squat_m": (0.006, 0.025, "log")},
        },
    ),
    "datum_scale": (
        "both ways",
        {
            "ahead": {"ahead_scale": (0.004, 0.015, "either")},
            "aside": {"aside_scale": (0.004, 0.015, "either")},
            "unlike": {"ahead_scale": (0.004, 0.015, "either"), "aside_scale": (0.004, 0.015, "either")},
        },
    ),
    "datum_bias": (
        "post",
        {
            "aside": {"aside_m": (0.003, 0.012, "either")},
            "ahead": {"ahead_m": (0.003, 0.02, "either")},
            "since a run": {"ahead_m": (0.003, 0.016, "either"), "aside_m": (0.004, 0.016, "either")},
        },
    ),
    "frame_rate": (
        "off",
        {
            "two rates": {
                "piece_one": (0.002, 0.012, "either"),
                "piece_two": (0.002, 0.012, "either"),
                "change_s": (8.0, 35.0, "even"),
            },
            "drifting": {"drift": (0.002, 0.01, "either")},
        },
    ),
    "sync_delay": (
        "late",
        {
            "drifting": {"drift_s": (0.15, 0.9, "either")},
            "jumping": {
                "delay_s": (0.04, 0.3, "either"),
                "jump_s": (0.1, 0.5, "either"),
                "change_s": (8.0, 35.0, "even"),
            },
            "each run": {"delay_s": (0.06, 0.5, "either")},
        },
    ),
    "rolling_shutter": (
        "downwards",
        {"upwards": {"up_s": (0.008, 0.035, "log")}, "columns": {"across_s": (0.02, 0.07, "log")}},
    ),
}
"""Name of the first form, and the others."""
IN_SOME_RUNS = {"slack_line": None, "kick": None, "tow_point_offset": "in some runs"}
"""Effects that act in one run or two: all of their forms (None) or one; all else acts in every run."""
SINCE_A_RUN, IN_EACH_RUN = {"datum_bias": "since a run"}, {"sync_delay": "each run"}
"""Those of which a form begins with a run, and those of which one has other numbers in each."""

FORMS: dict[str, dict[str, Form]] = {
    effect: {_MORE[effect][0]: first, **_MORE[effect][1]} for effect, first in EFFECTS.items()
}
"""Effect -> form -> number -> range."""


def first_form(effect: str) -> str:
    """The form that an effect had when it had one."""
    return next(iter(FORMS[effect]))


def form_of(case: Case, effect: str) -> str:
    """The form that an effect has in a case; "" of what is in no library.

    Parameters
    ----------
    case : as drawn
    effect : one of it
    """
    return "" if effect not in FORMS else case.form.get(effect, first_form(effect))


def kept_out(seed: int) -> dict[str, list[str]]:
    """Forms that are kept out by a seed: of every effect's but its first a share, in the grammar's order.

    Parameters
    ----------
    seed : of the drawing, which is one of its own for every effect
    """
    found: dict[str, list[str]] = {}
    for effect, forms in FORMS.items():
        others = list(forms)[1:]
        if others:
            count = max(1, int(KEPT_SHARE * len(others)))
            rng = np.random.default_rng([seed, crc32(effect.encode())])
            found[effect] = [others[i] for i in sorted(rng.choice(len(others), count, replace=False).tolist())]
    return found


def allowed(effect: str, choice: str, seed: int) -> list[str]:
    """Forms of an effect that may be drawn; an effect of one form has that one, whatever is chosen.

    Parameters
    ----------
    effect : of the library
    choice : one of ``CHOICES``
    seed : of what is kept out
    """
    forms, kept = list(FORMS[effect]), kept_out(seed).get(effect, [])
    if choice == "classic" or len(forms) == 1:
        return forms[:1]
    if choice == "kept":
        return kept
    return [form for form in forms if choice == "all" or form not in kept]
