"""What stands for "something that is in no library": forces of free form, and faults of free form in what is seen.

If one of these explains the runs far better than every named effect, the gap is real and its cause unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...simulate.model import Array
from ..effects import Effect, Parameter, Seen, Situation
from ..effects.line import carried
from ..effects.members import Members
from .beside import MOST_N
from .pushes import Push
from .waves import GRIDS, Wave

V_M_S, R_RAD_S, Y_M, BETA_RAD = 0.1, 0.05, 0.2, 0.15
"""Usual sizes of a tow's motion."""
SHARP = 0.3
"""Of a change of side, in usual sizes: the hyperbolic tangent is smooth over this."""
ACROSS_PER_M, TURNED_PER_RAD = np.arange(2.0, 17.0, 2.0), np.arange(4.0, 17.0, 4.0)
"""Waves to a metre across the tank and to a radian of heading: together any force that depends on place or heading, down to 6 cm
and 4 degrees.
"""
CHANGES = (0.25, 0.4, 0.55, 0.7)
"""Of a run's duration: when something may have changed."""
CHANGE_S = 1.0
"""... and how long the change takes."""
SIZES_N = (0.01, 0.07, 0.4)
"""Prior standard deviations of such forces: faint, plain and gross. Choices."""
SIZES_M = (0.0005, 0.003)
"""The same of such faults of what is seen."""
CHANNELS = ("x", "y", "b", "d")
"""Of what is seen: x, y, heading, marker distance."""
SEEN = 12
"""How many ``shapes_of`` there are."""
SHAKES = 4
"""Frequencies that are tried."""
POST = 4
"""Where the numbers of a post that shakes stand, to starboard, behind those of two forces and of x and y."""
OFF_HZ = 0.01
"""A peak of a run of 45 s is as wide."""
NAMED = (0, 5, 6, 7, 8, 9, 10, 14, 15)
"""Of the smooth shapes: a constant (``hull_asymmetry``), moduli and cubes (``crossflow_drag``, ``cubic_damping``)."""
SEEN_NAMED = {"x": (0, 1, 2, 7), "y": (0, 2, 7), "b": (0, 8), "d": (0, 2, 8)}
"""Of ``shapes_of``, channel by channel: what is constant, goes with the place or with a rate (``datum_bias``, ``datum_scale``,
``deck_height``, ``frame_rate``, ``rolling_shutter``)."""
REMEMBERED, LAG_S = "remembered", 1.5
"""A variant, and how long it takes to forget."""
DRAWN, SIDE_N = "drawn", 0.5
"""A variant, and a usual side force of a line."""
Shapes = Callable[[Situation], Sequence[Any]]


def _smooth(s: Situation) -> Sequence[Any]:
    """What grows with the motion."""
    v, r, y, b = s.v_m_s / V_M_S, s.r_rad_s / R_RAD_S, s.y_m / Y_M, s.beta_rad / BETA_RAD
    time = 2 * s.t_s / s.duration_s - 1 + 0.0 * v
    plain = (1 + 0.0 * v, time, y, y * np.abs(y), y**3, v * np.abs(v), v**3, r * np.abs(r), r**3, v * v * r, v * r * r)
    drifting = (time * v, time * r, np.abs(v) * r, v * np.abs(r))
    return (*plain, b * b, *drifting, np.tanh(b / SHARP), np.tanh(v / SHARP), np.tanh(r / SHARP))


def _drawn(s: Situation) -> Sequence[Any]:
    """What goes with the line's side force as it is: for a hull that follows its equation, all that goes with accelerations."""
    side = s.tension_n * np.sin(s.alpha_rad + s.beta_rad) / SIDE_N
    return side, side * np.abs(side), side**3, (2 * s.t_s / s.duration_s - 1) * side


def _remembered(s: Situation) -> Sequence[Any]:
    """What has not come to rest since the motion was another."""
    return (s.v_lag - s.v_m_s) / V_M_S, (s.r_lag - s.r_rad_s) / R_RAD_S


def _placed(s: Situation) -> Sequence[Any]:
    """What comes and goes with place or heading."""
    angles = [2 * np.pi * k * s.y_m for k in ACROSS_PER_M] + [2 * np.pi * k * s.beta_rad for k in TURNED_PER_RAD]
    return [wave(angle) for angle in angles for wave in (np.sin, np.cos)]


def _changed(s: Situation) -> Sequence[Any]:
    """What is another after some time than before it."""
    with_motion = (1.0, s.v_m_s / V_M_S, s.r_rad_s / R_RAD_S, (s.alpha_rad + s.beta_rad) / BETA_RAD)
    times = [0.5 * (1 + np.tanh((s.t_s - share * s.duration_s) / CHANGE_S)) for share in CHANGES]
    return [time * motion + 0.0 * s.v_m_s for time in times for motion in with_motion]


SHAPES: dict[str, tuple[Shapes, int, list[tuple[int, ...]]]] = {
    "": (_smooth, 19, [(k,) for k in range(19) if k not in NAMED]),
    "placed": (_placed, 24, [(k, k + 1) for k in range(0, 24, 2)]),
    "changed": (_changed, 16, [(k,) for k in range(16)]),
    REMEMBERED: (_remembered, 2, [(0,), (1,)]),
    DRAWN: (_drawn, 4, [(k,) for k in range(4)]),
}
"""Variants of a free force, how many shapes each has, and which of these may be there without the others: not those that are an
effect of the library, with which they would share the probability.
"""


def _force_of(shapes: Shapes, count: int) -> Callable[..., tuple[Any, Any]]:
    def force(s: Situation, *numbers):
        found = shapes(s)
        return _sum(numbers[:count], found), _sum(numbers[count:], found)

    return force


def _sum(numbers: Sequence[Any], shapes: Sequence[Any]) -> Any:
    return sum(a * f for a, f in zip(numbers, shapes, strict=True))


def shapes_of(seen: Seen) -> tuple[Array, ...]:
    """Shapes that a fault of what is seen may have: 1, time, y, y^2, beta, beta^2, y beta, the rates of y and beta, time times
    each of these, and the line's side force.

    Time goes from -1 to 1 over the run; y, beta, their rates and the sine of the angle between line and model are in units of
    Y_M, BETA_RAD, V_M_S, R_RAD_S and BETA_RAD.

    Parameters
    ----------
    seen : of a simulated run
    """
    y, b = seen.pose[1] / Y_M, seen.pose[2] / BETA_RAD
    time = seen.t_s / np.maximum(seen.t_s.max(), 1.0) * 2 - 1 + 0.0 * y
    across, turning = seen.rate[1] / V_M_S, seen.rate[2] / R_RAD_S
    late = (across, turning, time * across, time * turning)
    return (1 + 0.0 * y, time, y, y * y, b, b * b, y * b, *late, seen.side / BETA_RAD)


def _seen(seen: Seen, *numbers) -> tuple[Any, Any, Any, Any]:
    forms = shapes_of(seen)
    each = len(forms)
    x, y, beta, apart = (_sum(numbers[k * each : (k + 1) * each], forms) for k in range(4))
    return x, y, beta, apart


def free_forms(runs: int, shaken_hz: Sequence[float]) -> tuple[Effect, ...]:
    """Free forms at several sizes.

    Parameters
    ----------
    runs : how many
    shaken_hz : frequencies that stand out of what the linear fit leaves
    """
    forces = tuple(
        Effect(
            f"unknown force {kind}".strip(),
            "sway",
            tuple(
                Parameter(f"{what}{k}", "N" if what == "y" else "N m", size)
                for what in ("y", "n")
                for k in range(count)
            ),
            "A force on the hull that no effect of the library has.",
            "Look at when and where it shows.",
            force=force,
            sizes=(1.0,),
            members=_alone([[f"{what}{k}" for k in group for what in "yn"] for group in groups], _names("yn", count)),
            variant=f"{size:g} N",
            lag_s=LAG_S if kind == REMEMBERED else 0.0,
            by_pull=kind == DRAWN,
        )
        for kind, (shapes, count, groups) in SHAPES.items()
        for force in (_force_of(shapes, count),)
        for size in SIZES_N
    )
    sights = tuple(
        Effect(
            "unknown fault of what is seen",
            "camera",
            tuple(
                Parameter(f"{what}{k}", _unit(what), size * (0.5 if what == "b" else 1.0))
                for what in CHANNELS
                for k in range(SEEN)
            ),
            "Something in camera or clock that no effect of the library has.",
            "Run towline check; look where the invariants depart.",
            observe=_seen,
            sizes=(1.0,),
            members=_alone(
                [[f"{what}{k}"] for what in CHANNELS for k in range(SEEN) if k not in SEEN_NAMED[what]],
                _names(CHANNELS, SEEN),
            ),
            variant=f"{1e3 * size:g} mm",
        )
        for size in SIZES_M
    )
    return (*forces, *sights, *(shake for hz in shaken_hz[:SHAKES] for shake in _shaken(runs, hz)))


def _alone(groups: Sequence[Sequence[str]], every: Sequence[str]) -> Members:
    """Each group of numbers alone, half of the prior, or every number, the other half."""
    return (*(tuple(group) for group in groups), *[tuple(every)] * len(groups))


def _names(channels: Sequence[str], count: int) -> list[str]:
    return [f"{what}{k}" for what in channels for k in range(count)]


def _unit(channel: str) -> str:
    return "rad" if channel == "b" else "m"


def _shaken(runs: int, hz: float) -> list[Effect]:
    """Something swings at one frequency, in every run as it likes: it pushes the hull, and moves what stands still; by size."""
    what = (("side", "N"), ("moment", "N m"), ("x", "m"), ("y", "m"), ("post", "m"))
    width = 2 * len(what)

    def waves(t_s: Any, numbers: Sequence[Any], which: int, later: float = 0.0) -> Any:
        sine, cosine = (
            np.stack([np.atleast_1d(numbers[run * width + 2 * which + k]) for run in range(runs)]) for k in range(2)
        )
        angle = 2 * np.pi * ((hz + numbers[-1]) * t_s + later)
        return sine * np.sin(angle) + cosine * np.cos(angle)

    def force(s: Situation, *numbers):
        return waves(s.t_s, numbers, 0), waves(s.t_s, numbers, 1)

    def tension(s: Situation, *numbers):
        # the mass of what it draws back and ahead
        turns = 2 * np.pi * (hz + numbers[-1])
        post = waves(s.t_s, numbers, POST)
        rate, rate2 = turns * waves(s.t_s, numbers, POST, 0.25), -(turns**2) * post
        sine, cosine = np.sin(s.alpha_rad), np.cos(s.alpha_rad)
        faster = -(rate * sine + post * s.alpha_rate * cosine)
        return carried(s, faster, -(rate2 * sine + 2 * rate * s.alpha_rate * cosine))

    def observe(seen: Seen, *numbers):
        # a taut line whose post moves further away draws the model ahead
        ahead = -np.sin(seen.alpha_rad) * waves(seen.t_s, numbers, POST)
        nothing = 0.0 * seen.side
        return waves(seen.t_s, numbers, 2) + ahead, waves(seen.t_s, numbers, 3), nothing, nothing

    def sized(size_m: float) -> Effect:
        sizes = (SIZES_N[1], SIZES_N[1], size_m, size_m, 5 * size_m)
        each = [[f"{name}{run}{wave}" for run in range(runs) for wave in ("sin", "cos")] for name, _ in what]
        return Effect(
            "unknown shake",
            "line",
            (
                *(
                    Parameter(f"{name}{run}{wave}", unit, size)
                    for run in range(runs)
                    for (name, unit), size in zip(what, sizes, strict=True)
                    for wave in ("sin", "cos")
                ),
                Parameter("off_hz", "Hz", OFF_HZ),
            ),
            "Something swings at one frequency, whatever the model does.",
            "Look for what shakes at that frequency: carriage, camera, the tank's own wave.",
            force=force,
            tension=tension,
            observe=observe,
            sizes=(1.0,),
            bound=True,
            members=_alone(
                [[*names, "off_hz"] for names in each], [*(name for names in each for name in names), "off_hz"]
            ),
            variant=f"{hz:.3f} Hz, {1e3 * size_m:g} mm",
            cost=float(np.log(SHAKES * len(SIZES_M))),
        )

    return [sized(size_m) for size_m in SIZES_M]


def one_off(names: Sequence[str], pushes: Sequence[Push]) -> tuple[Effect, ...]:
    """A push at one time in each of some runs; none where nothing stands out.

    Parameters
    ----------
    names : of the runs
    pushes : what stands out, at most one of a run
    """
    if not pushes:
        return ()

    def force(s: Situation, *numbers):
        nothing = 0.0 * np.atleast_1d(numbers[0])
        side, moment = [nothing] * len(names), [nothing] * len(names)
        begin_s, length_s = np.zeros((len(names), 1)), np.ones((len(names), 1))
        for k, push in enumerate(pushes):
            side[push.run], moment[push.run] = np.atleast_1d(numbers[2 * k]), np.atleast_1d(numbers[2 * k + 1])
            begin_s[push.run], length_s[push.run] = push.begin_s, push.end_s - push.begin_s
        share = np.clip((s.t_s - begin_s) / length_s, 0.0, 1.0)
        course = 2 * np.sin(np.pi * share) ** 2
        return np.stack(side) * course, np.stack(moment) * course

    when = ", ".join(f"in {names[push.run]} at {(push.begin_s + push.end_s) / 2:.1f} s" for push in pushes)
    return (
        Effect(
            "unknown push",
            "sway",
            tuple(
                Parameter(f"{'n' if unit == 'N m' else 'y'}_{push.run + 1}", unit, MOST_N)
                for push in pushes
                for unit in ("N", "N m")
            ),
            "Something pushed the model once.",
            "Look at the film at that time: a hand, a line that catches, a wave.",
            force=force,
            bound=True,
            variant=when,
            title=f"a push that comes once, {when}",
            cost=sum(push.cost for push in pushes),
        ),
    )


def repeating(found: Sequence[Wave]) -> tuple[Effect, ...]:
    """A force that comes and goes at one wave number, in y or in the heading.

    Parameters
    ----------
    found : wave numbers that stand out
    """
    return tuple(_repeats(wave) for wave in found)


def _repeats(wave: Wave) -> Effect:
    metres, step = wave.along == "y", float(np.diff(GRIDS[wave.along])[0])
    unit = "m" if metres else "rad"

    def force(s: Situation, side_sine, side_cosine, turn_sine, turn_cosine, off):
        angle = 2 * np.pi * (wave.per_unit + off) * (s.y_m if metres else s.beta_rad)
        sine, cosine = np.sin(angle), np.cos(angle)
        return side_sine * sine + side_cosine * cosine, turn_sine * sine + turn_cosine * cosine

    where = (
        f"every {100 / wave.per_unit:.1f} cm across the tank"
        if metres
        else f"every {np.degrees(1 / wave.per_unit):.1f} degrees"
    )
    return Effect(
        "unknown force that repeats",
        "sway",
        (
            *(
                Parameter(f"{what}_{part}", f"N{' m' * (what == 'n')}", MOST_N)
                for what in "yn"
                for part in ("sine", "cosine")
            ),
            Parameter("off", f"1/{unit}", step),
        ),
        "A force comes and goes with the place.",
        "Look for what repeats at that distance: a grating, seams, an eddy left standing.",
        force=force,
        variant=where,
        title=f"a force that comes and goes {where}",
        cost=wave.cost,
    )


__all__ = ["free_forms", "one_off", "repeating"]
