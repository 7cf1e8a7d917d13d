"""What a planned run will do in the tank: walls, line, angles, swings; every warning quotes both numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .information import Towed
from .setting import Setting, TowPlan

EXCLUDING = ("unstable", "wall", "line", "angle", "reach")
"""A candidate with one of these cannot be chosen."""
BROADSIDE_RAD = np.pi / 2
"""Line angle at which the equations of motion end (theory.md 9.1): what a lost tow is said to reach."""
LOST_ROOM_M = -1e6
"""Room to the wall of a run whose motion the equations do not follow."""
GROWTH_SAID = 1.5
"""A swing that grows by no more than this over the run is not worth a warning."""


@dataclass(frozen=True)
class Conduct:
    """What a run will do, as its line makes it: a line of given tension by the linear form.

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


def swing(tow: Towed) -> tuple[float | None, float]:
    """Frequency (None: no oscillatory pair) and decay rate of the slowest pair, or of the slowest root.

    Parameters
    ----------
    tow : its motion

    Returns
    -------
    rad/s or None, and 1/s
    """
    roots = np.linalg.eigvals(tow.matrix)
    pair = roots[roots.imag > 1e-9 * np.abs(roots).max()]
    if not len(pair):
        return None, float(-roots.real.max())
    slow = pair[np.argmax(pair.real)]
    return float(slow.imag), float(-slow.real)


def conduct(setting: Setting, plan: TowPlan, tow: Towed) -> Conduct:
    """Judge one planned run.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plan : of the tow
    tow : its motion
    """
    course = tow.course(setting, plan)
    limits = setting.limits
    duration = float(tow.times_s[-1])
    length, x_t = plan.line_length_m, plan.tow_point_m
    omega, damping = swing(tow)
    cycles = 0.0 if omega is None else omega * duration / (2 * np.pi)
    lost = not np.isfinite(course.angle_rad).all()
    angle = BROADSIDE_RAD if lost else float(np.abs(course.angle_rad).max())
    room = LOST_ROOM_M if lost else _wall_room(setting, course.y_m, course.beta_rad)
    share = 0.0 if lost else float(course.line_share.min())
    warnings: dict[str, str] = {}
    x_v = setting.hull.x_v_m
    if x_t <= x_v:
        warnings["unstable"] = (
            f"X_T = {x_t:.3f} m is not ahead of X_v = {x_v:.3f} m: the tow is unstable and shears off to one side"
        )
    if lost:
        warnings["angle"] = f"released at {_release_words(plan)} it goes broadside, or its line does not reach that far"
        return Conduct(duration, float(cycles), omega, damping, angle, room, share, warnings)
    if room < limits.wall_m:
        warnings["wall"] = (
            f"a corner of the hull comes to {setting.width_m / 2 - room:.3f} m from the centre line, half the tank is "
            f"{setting.width_m / 2:.3f} m: {room:.3f} m of room, {limits.wall_m:.3f} m is wanted"
        )
    if share < limits.line_share or share <= 0:
        tension = setting.tow(plan).resistance
        state = "is slack" if share <= 0 else "is nearly slack"
        warnings["line"] = (
            f"the line {state}: surge of {setting.mass_kg:.1f} kg takes {tension * (1 - share):.2f} N of T = {tension:.2f} N "
            f"({100 * share:.0f} % is left, {100 * limits.line_share:.0f} % is wanted)"
        )
    if angle > limits.angle_rad:
        because = f"the linear form's line force is {100 * force_excess(angle):.1f} % too large there"
        if setting.line == "surge":
            because = "no linear hull drags as a model does there"
        warnings["angle"] = (
            f"alpha + beta reaches {np.degrees(min(angle, 99.0)):.1f} degrees, more than {np.degrees(limits.angle_rad):.1f}: "
            f"{because}"
        )
    reach = float(np.abs(course.reach_m).max())
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


def force_excess(angle: float) -> float:
    """By how much the linear form overstates the line's side force, which goes with the sine of its angle.

    Parameters
    ----------
    angle : alpha + beta, rad, not negative

    Returns
    -------
    excess : angle / sin(angle) - 1; infinite from half a turn on
    """
    return float("inf") if angle >= np.pi else angle / np.sin(angle) - 1


def _wall_room(setting: Setting, y: np.ndarray, beta: np.ndarray) -> float:
    half = setting.hull_length_m / 2
    # a model that has left on its linear way is at the wall long before its sine matters
    side = np.abs(y[:, None] + half * np.array([1.0, -1.0]) * np.sin(np.clip(beta, -np.pi / 2, np.pi / 2))[:, None])
    corner = side + setting.breadth_m / 2 * np.abs(np.cos(np.clip(beta, -np.pi / 2, np.pi / 2)))[:, None]
    return float(setting.width_m / 2 - corner.max())


def _release_words(plan: TowPlan) -> str:
    return f"y {plan.release_y_m:.2f} m, beta {plan.release_beta_rad:+.3f} rad"
