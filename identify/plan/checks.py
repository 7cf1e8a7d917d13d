"""What a planned run will do in the tank: walls, line, angles, swings; every warning quotes both numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .information import UnitTow
from .setting import Setting, TowPlan

EXCLUDING = ("unstable", "wall", "line", "angle", "reach")
"""A candidate with one of these cannot be chosen."""
GROWTH_SAID = 1.5
"""A swing that grows by no more than this over the run is not worth a warning."""


@dataclass(frozen=True)
class Conduct:
    """What a run will do, by the linear form.

    Attributes
    ----------
    duration_s, cycles : usable way over U; swings in it (0: it does not swing)
    omega_rad_s : of the swing, or None
    damping_per_s : of the swing, else of the slowest root; positive = decaying
    largest_angle_rad : of |alpha + beta|
    wall_room_m : least room between a corner of the hull and the wall; negative = contact
    line_share : least line force over T; 0 or less = slack
    warnings : {kind: sentence}; kinds: unstable, wall, line, angle, reach, cycles, growing
    """

    duration_s: float
    cycles: float
    omega_rad_s: float | None
    damping_per_s: float
    largest_angle_rad: float
    wall_room_m: float
    line_share: float
    warnings: dict[str, str]

    @property
    def possible(self) -> bool:
        """No warning excludes it."""
        return self.reason is None

    @property
    def reason(self) -> str | None:
        """The kind of warning that excludes it."""
        return next((kind for kind in EXCLUDING if kind in self.warnings), None)


def swing(unit: UnitTow) -> tuple[float | None, float]:
    """Frequency (None: no oscillatory pair) and decay rate of the slowest pair, or of the slowest root."""
    roots = np.linalg.eigvals(unit.matrix)
    pair = roots[roots.imag > 1e-9 * np.abs(roots).max()]
    if not len(pair):
        return None, float(-roots.real.max())
    slow = pair[np.argmax(pair.real)]
    return float(slow.imag), float(-slow.real)


def conduct(setting: Setting, plan: TowPlan, unit: UnitTow) -> Conduct:
    """Judge one planned run."""
    states, rates, _ = unit.released(plan)
    y, beta, _, _ = states.T
    limits = setting.limits
    duration = float(unit.times_s[-1])
    length, x_t = plan.line_length_m, plan.tow_point_m
    omega, damping = swing(unit)
    cycles = 0.0 if omega is None else omega * duration / (2 * np.pi)
    angle = float(np.abs(y / length + (1 + x_t / length) * beta).max())
    room = _wall_room(setting, y, beta)
    share = _line_share(setting, plan, states, rates)
    warnings: dict[str, str] = {}
    x_v = setting.hull.x_v_m
    if x_t <= x_v:
        warnings["unstable"] = (
            f"X_T = {x_t:.3f} m is not ahead of X_v = {x_v:.3f} m: the tow is unstable and shears off to one side"
        )
    if room < limits.wall_m:
        warnings["wall"] = (
            f"a corner of the hull comes to {setting.width_m / 2 - room:.3f} m from the centre line, half the tank is "
            f"{setting.width_m / 2:.3f} m: {room:.3f} m of room, {limits.wall_m:.3f} m is wanted"
        )
    if share < limits.line_share:
        tension = setting.tow(plan).tension_n
        assert tension is not None
        state = "is slack" if share <= 0 else "is nearly slack"
        warnings["line"] = (
            f"the line {state}: surge of {setting.mass_kg:.1f} kg takes {tension * (1 - share):.2f} N of T = {tension:.2f} N "
            f"({100 * share:.0f} % is left, {100 * limits.line_share:.0f} % is wanted)"
        )
    if angle > limits.angle_rad:
        warnings["angle"] = (
            f"alpha + beta reaches {np.degrees(min(angle, 99.0)):.1f} degrees, more than {np.degrees(limits.angle_rad):.1f}: the "
            f"linear form's line force is {100 * _excess(angle):.1f} % too large there"
        )
    reach = float(np.abs(y + x_t * beta).max())
    if reach >= length:
        warnings["reach"] = f"the tow point is {reach:.3f} m aside, the line is {length:.3f} m long"
    if omega is not None and cycles <= limits.cycles:
        warnings["cycles"] = (
            f"{cycles:.2f} cycles in {duration:.1f} s ({setting.way_m:.1f} m at {plan.speed_m_s:g} m/s), no more than "
            f"{limits.cycles:g}: a shorter line, a tow point further forward or a longer way gives more"
        )
    if omega is not None and damping < 0 and x_t > x_v:
        growth = float(np.exp(min(-damping * duration, 99.0)))
        if growth > GROWTH_SAID:
            warnings["growing"] = (
                f"the swing grows by {-damping:.4f} 1/s, to {growth:.2f} times its size in {duration:.1f} s "
                f"(more than {GROWTH_SAID:g})"
            )
    return Conduct(duration, float(cycles), omega, damping, angle, room, share, warnings)


def _excess(angle: float) -> float:
    return float("inf") if angle >= np.pi else angle / np.sin(angle) - 1


def _wall_room(setting: Setting, y: np.ndarray, beta: np.ndarray) -> float:
    half = setting.hull_length_m / 2
    # a model that has left on its linear way is at the wall long before its sine matters
    side = np.abs(y[:, None] + half * np.array([1.0, -1.0]) * np.sin(np.clip(beta, -np.pi / 2, np.pi / 2))[:, None])
    corner = side + setting.breadth_m / 2 * np.abs(np.cos(np.clip(beta, -np.pi / 2, np.pi / 2)))[:, None]
    return float(setting.width_m / 2 - corner.max())


def _line_share(setting: Setting, plan: TowPlan, states: np.ndarray, rates: np.ndarray) -> float:
    """Least of (T + m x'')/T, with x'' of the LCG on a taut line (2.10) to second order in the angles.

    x_CG = -L cos a - X_T cos b, so x'' = L (a'^2 + a a'') + X_T (b'^2 + b b''). The model's mass alone is taken: its
    added mass in surge (some 5 %) and the resistance's change are not known here.
    """
    x_t, length = plan.tow_point_m, plan.line_length_m
    y, beta, _, r = states.T
    y_rate, _, v_rate, r_rate = rates.T
    y_curve = v_rate + plan.speed_m_s * r
    alpha, a_rate, a_curve = (y + x_t * beta) / length, (y_rate + x_t * r) / length, (y_curve + x_t * r_rate) / length
    surge = length * (a_rate**2 + alpha * a_curve) + x_t * (r**2 + beta * r_rate)
    tension = setting.tow(plan).tension_n
    assert tension is not None
    return float(1 + setting.mass_kg * surge.min() / tension)
