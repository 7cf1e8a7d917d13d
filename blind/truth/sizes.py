"""What reality may hold, and how large: the ranges that sizes are drawn from.

A range is (from, to, how): ``log`` logarithmically even, ``even`` even, ``either`` logarithmically even with either sign.
Numbers of forces are those of the MARINER hull; ``draw`` scales them by the line's pull (and by the length, for moments).

What holds the line, in words:

- tension_variation: a winch whose servo (of ``period_s``) holds T at R/cos(alpha)^power; the line pays out and in, its length is
  free.
- constant_tension: the line runs over a pulley to a falling weight, or to a winch without a law: T = weight R, and a little more
  while it pays out (friction of the pulley, drag of the drive). The model surges freely, its distance from the post is free.
- elastic_line: a soft spring whose stated length is the unloaded one. In every other tow the line is a stiff spring, measured
  taut.
- slack_line: the carriage slows (``carriage`` above 0.5) by ``surplus`` R/(m - X_udot) at the worst and comes back to its speed,
  or a following wave pushes the model with ``surplus`` R and pulls it back: the line falls slack, and straightens with a jerk.
- stick_slip: the drive's speed swings by a share of it and two harmonics; 0.6 % at 0.2 Hz take six tenths of the pull away.
"""

from __future__ import annotations

Range = tuple[float, float, str]

TOLD: dict[str, dict[str, Range]] = {
    "rudder held": {"rudder.angle_rad": (0.02, 0.26, "either")},
    "rudder moved": {
        "rudder.angle_rad": (0.05, 0.26, "log"),
        "rudder.period_s": (7.0, 20.0, "log"),
        "rudder.phase": (0.0, 1.0, "even"),
    },
    "speed history": {"speed_drift.share": (0.008, 0.05, "either"), "speed_drift.settle_s": (8.0, 60.0, "log")},
    "tow point aside": {"tow_point_offset.offset_m": (0.003, 0.03, "either")},
    "post moved": {
        "carriage_shake.size_m": (0.02, 0.08, "log"),
        "carriage_shake.rate_hz": (0.04, 0.2, "log"),
        "carriage_shake.phase": (0.0, 6.28, "even"),
    },
}
"""Inputs that run.toml tells, each run's its own: nothing is missing where they act, and none may be blamed for a gap."""
RUDDER_N_RAD, RUDDER_ARM = (1.0, 3.0), (-0.5, -0.4)
"""Y_delta, N to starboard by an angle to port, of the MARINER hull; N_delta over Y_delta Lpp."""

EFFECTS: dict[str, dict[str, Range]] = {
    "crossflow_drag": {"drag_m": (0.04, 0.25, "log"), "tilt": (-0.4, 0.4, "even"), "ends": (-0.5, 0.8, "even")},
    "cubic_damping": {"side": (0.3, 1.5, "log"), "turn": (0.006, 0.03, "log"), "arm": (-0.3, 0.4, "even")},
    "hull_asymmetry": {
        "lift_n_s2_m2": (0.02, 0.15, "either"),
        "place": (-0.5, 0.4, "even"),
        "twist_n_m_s2_m2": (0.005, 0.03, "either"),
    },
    "added_mass_coupling": {"y_rdot": (6.0, 30.0, "either"), "n_vdot": (6.0, 30.0, "either")},
    "fluid_memory": {
        "sway": (0.06, 0.35, "log"),
        "yaw": (0.06, 0.35, "log"),
        "quick": (0.3, 0.7, "even"),
        "fast_s": (0.3, 0.8, "even"),
        "slow_s": (1.5, 5.0, "even"),
        "arm": (0.5, 1.2, "even"),
    },
    "bank_suction": {"strength_m5": (0.003, 0.015, "log"), "lead": (-0.5, 0.5, "even")},
    "cross_current": {"flow_m_s": (0.003, 0.02, "either"), "shear": (-0.8, 0.8, "even")},
    "speed_drift": {"share": (0.008, 0.05, "either"), "settle_s": (8.0, 60.0, "log")},
    "tension_variation": {"power": (0.6, 1.8, "log"), "period_s": (0.6, 3.0, "log")},
    "constant_tension": {
        "friction": (0.002, 0.02, "log"),
        "drag_n_s_m": (0.5, 5.0, "log"),
        "weight": (0.998, 1.003, "even"),
    },
    "elastic_line": {
        "compliance_m_n": (0.002, 0.01, "log"),
        "damping": (0.02, 0.1, "log"),
        "shock": (0.0, 0.6, "even"),
    },
    "slack_line": {
        "surplus": (1.3, 1.9, "log"),
        "length_s": (1.6, 2.8, "even"),
        "begin_s": (8.0, 30.0, "even"),
        "carriage": (0.0, 1.0, "even"),
    },
    "tow_point_offset": {"offset_m": (0.003, 0.015, "either")},
    "swivel_friction": {"moment_n_m": (0.015, 0.09, "log"), "stick": (0.0, 0.5, "even")},
    "lens_distortion": {"bend": (0.01, 0.05, "either")},
    "deck_height": {"depth_m": (0.006, 0.025, "either")},
    "camera_shift": {
        "right_rad": (0.001, 0.005, "either"),
        "down_rad": (0.001, 0.005, "either"),
        "roll_rad": (0.001, 0.005, "either"),
    },
    "datum_scale": {"scale": (0.004, 0.015, "either")},
    "datum_bias": {"ahead_m": (0.002, 0.012, "either"), "aside_m": (0.003, 0.012, "either")},
    "marker_roll": {
        "lean_rad": (0.02, 0.1, "either"),
        "period_s": (0.7, 1.8, "even"),
        "damping": (0.08, 0.3, "log"),
    },
    "frame_rate": {"fast": (0.004, 0.02, "either")},
    "sync_delay": {"delay_s": (0.08, 0.5, "either")},
    "rolling_shutter": {"readout_s": (0.008, 0.035, "log")},
}
"""Effects that the library knows by name (formats.md), in the first of their ``forms``; the first number of each may be cut down
(``draw.gentle``)."""

OUTSIDE: dict[str, dict[str, Range]] = {
    "washboard": {
        "side_n": (0.06, 0.3, "log"),
        "moment_n_m": (0.03, 0.2, "either"),
        "length_m": (0.06, 0.2, "log"),
        "phase": (0.0, 6.28, "even"),
    },
    "kick": {
        "side_n": (1.0, 5.0, "either"),
        "moment_n_m": (0.5, 4.0, "either"),
        "width_s": (0.2, 0.8, "log"),
        "time_s": (8.0, 35.0, "even"),
    },
    "sloshing": {
        "side_n": (0.05, 0.3, "log"),
        "arm_m": (-0.6, 0.6, "even"),
        "rate_hz": (0.25, 0.45, "even"),
        "damping": (0.003, 0.02, "log"),
        "feed": (0.05, 0.5, "log"),
    },
    "vibration": {"size_m": (0.001, 0.005, "log"), "rate_hz": (0.4, 1.2, "even")},
    "magnet": {
        "side_n": (0.04, 0.2, "log"),
        "moment_n_m": (0.03, 0.15, "either"),
        "angle_rad": (0.01, 0.03, "log"),
        "phase": (0.0, 6.28, "even"),
    },
    "carriage_shake": {"size_m": (0.002, 0.01, "log"), "rate_hz": (0.12, 0.5, "log"), "phase": (0.0, 6.28, "even")},
    "new_mass": {"share": (0.08, 0.35, "log"), "time_s": (10.0, 28.0, "even")},
    "stick_slip": {"share": (0.001, 0.006, "log"), "rate_hz": (0.1, 0.3, "log")},
}
"""What no library holds."""

FORCES = {
    "hull_asymmetry.lift_n_s2_m2",
    "hull_asymmetry.stall_n_s2_m2",
    "hull_asymmetry.wire_n",
    "hull_asymmetry.grows_n",
    "bank_suction.strength_m5",
    "bank_suction.gap_n_s2_m2",
    "bank_suction.near_n_s2_m2",
    "washboard.side_n",
    "kick.side_n",
    "sloshing.side_n",
    "magnet.side_n",
}
MOMENTS = {
    "hull_asymmetry.twist_n_m_s2_m2",
    "hull_asymmetry.wire_n_m",
    "swivel_friction.moment_n_m",
    "swivel_friction.dry_n_m",
    "swivel_friction.oil_n_m",
    "swivel_friction.grease_n_m",
    "swivel_friction.post_n_m",
    "washboard.moment_n_m",
    "kick.moment_n_m",
    "magnet.moment_n_m",
}
MASS_ARMS = {"added_mass_coupling.y_rdot", "added_mass_coupling.n_vdot"}
