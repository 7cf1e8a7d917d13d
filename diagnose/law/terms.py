"""What a term of the grammar makes: a force on the hull, or a roll under the marks, as an effect that the engine fits.

A term times its coefficient is a side force or a push ahead by rho/2 U^2 L^2, a moment by rho/2 U^2 L^3, or, where it heels the
model, how far the marks would stand aside by U^2/g if the model had time to follow (what heels it grows with
U^2, what rights it does not).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...record.errors import TowlineError
from ...simulate.model import GRAVITY_M_S2, Array
from ..effects import Effect, Parameter, Seen, Situation, rolled
from .functions import Range, Shape, State, Term, dimensionless, family, term, written

NAME = "law"
"""First word of the name of a law's effect; its term follows."""
AHEAD = "X"
"""Where a term acts that is a resistance beyond the straight tow's, or less."""
HEEL = "K"
"""Where a term acts that heels the model: it moves nothing but the marks."""
ACTS = {"Y": ("y",), "N": ("n",), "Y and N": ("y", "n"), AHEAD: ("x",), HEEL: ("k",)}
"""Where a term may act -> its coefficients. What acts ahead a line that keeps its length answers by its tension."""
APART = (AHEAD, HEEL)
"""Where terms act that are searched apart from those of side force and moment."""
ROLLS = (Shape("period_s", 1.2, 0.4, "s"), Shape("damping", 0.15, 0.07), Shape("turn_rad_m", 0.0, 0.3, "rad/m"))
"""Numbers of a model that heels, behind those inside the term: its own roll's period and damping, and by how much marks of unlike
height turn the heading for each metre that they sway."""
ACTING = {"Y": "force", "N": "force", "Y and N": "force", AHEAD: "resistance", HEEL: "heel"}
"""Where a term acts -> what it is, in a word."""
STAGE = {"N": "yaw", AHEAD: "line", HEEL: "camera"}
"""Where a term acts -> where it shows; elsewhere in sway."""


def state_of(s: Situation) -> State:
    """The dimensionless state of a situation.

    Parameters
    ----------
    s : of the tow
    """
    return dimensionless(
        s.speed_m_s, s.length_pp_m, s.half_width_m, s.v_m_s, s.r_rad_s, s.y_m, s.beta_rad,
        turn_rad_s=s.alpha_rate + s.r_rad_s, time=s.t_s / s.duration_s + 0.0 * s.v_m_s, v_late_m_s=s.v_lag,
        r_late_rad_s=s.r_lag, alpha_rad=s.alpha_rad, tow_point_m=s.tow_point_m,
    )  # fmt: skip


def state_seen(seen: Seen) -> State:
    """The dimensionless state of a simulated run.

    Parameters
    ----------
    seen : with times, pose and rates
    """
    _, y, beta = seen.pose
    r, v = seen.rate[2], seen.through_water[1]
    turn = np.gradient(seen.alpha_rad, seen.step_s, axis=0) + r
    return dimensionless(
        seen.speed_m_s, seen.length_pp_m, seen.half_width_m, v, r, y, beta,
        turn_rad_s=turn, time=seen.t_s / seen.duration_s + 0.0 * v, alpha_rad=seen.alpha_rad,
    )  # fmt: skip


def heeled(seen: Seen, aside: Any, period_s: Any, damping: Any, turn_rad_m: Any) -> tuple[Any, Any, Any, Any]:
    """What is seen of a model that heels: change of measured x, y, beta and marker distance.

    Parameters
    ----------
    seen : of the run
    aside : (samples, runs, columns) of U^2/g, where the marks would stand if the model had time to follow
    period_s, damping, turn_rad_m : as of ROLLS
    """
    return rolled(seen, seen.speed_m_s**2 / GRAVITY_M_S2 * aside, period_s, damping, turn_rad_m)


def text_of(effect: Effect) -> str:
    """The text of the term that a law's effect is.

    Parameters
    ----------
    effect : of ``effect_of``
    """
    return effect.name.removeprefix(f"{NAME} ")


def shapes_of(effect: Effect) -> tuple[Shape, ...]:
    """The numbers of a law's effect that are no coefficients, behind these: those inside its term, then those of a roll.

    Parameters
    ----------
    effect : of ``effect_of``
    """
    return term(text_of(effect)).shapes + _shapes_at(effect.variant)


def shapes_from(effect: Effect, roll: Array | None = None) -> Array:
    """Where the numbers of ``shapes_of`` begin.

    Parameters
    ----------
    effect : of ``effect_of``
    roll : those of ROLLS, where it heels the model; None: usual ones
    """
    begin = np.array([shape.value for shape in shapes_of(effect)])
    if roll is not None and effect.variant == HEEL:
        begin[-len(ROLLS) :] = roll
    return begin


def _shapes_at(acts: str) -> tuple[Shape, ...]:
    return ROLLS if acts == HEEL else ()


def coefficients_of(effect: Effect) -> tuple[Parameter, ...]:
    """The numbers of a law's effect that its forces are straight lines of.

    Parameters
    ----------
    effect : of ``effect_of``
    """
    return effect.parameters[: len(effect.parameters) - len(shapes_of(effect))]


def inside_of(effect: Effect, numbers: Array) -> Array:
    """Of a law's effect's numbers those inside its term.

    Parameters
    ----------
    effect : of ``effect_of``
    numbers : of it
    """
    first = len(coefficients_of(effect))
    return numbers[first : first + len(term(text_of(effect)).shapes)]


def effect_of(
    text: str,
    acts: str = "Y and N",
    sd: Sequence[float] = (0.01, 0.01, 0.01, 0.01),
    reach: Mapping[str, tuple[float, float]] | None = None,
) -> Effect:
    """The effect that a term of the grammar is.

    Parameters
    ----------
    text : of the term
    acts : one of ACTS: side force, moment or both, ahead, or heeling
    sd : usual size of the coefficients of side force and moment, of a push ahead, and of the marks' place aside
    reach : variable -> smallest and largest value where it was found; simulating beyond is said

    Raises
    ------
    TowlineError : no such term, or no such place

    Examples
    --------
    >>> effect_of("v|v|", "Y").parameters[0].name
    'y'
    """
    if acts not in ACTS:
        raise TowlineError(f"{acts!r}: a law acts in one of {', '.join(ACTS)}")
    found, channels = term(text), ACTS[acts]
    sizes, count = dict(zip("ynxk", sd, strict=False)), found.functions
    if lacking := [channel for channel in channels if channel not in sizes]:
        raise TowlineError(f"{text!r}: {acts!r} needs {'ynxk'.index(lacking[0]) + 1} usual sizes; got {len(sd)}")
    if acts == HEEL and found.lag_s:
        raise TowlineError(f"{text!r}: what heels a model is no term with a lag; the roll has its own")

    def force(s: Situation, *numbers: Any) -> tuple[Any, Any]:
        by = _coefficients(found, channels, numbers, state_of(s))
        return by["y"] * whole(s), by["n"] * whole(s) * s.length_pp_m

    def ahead(s: Situation, *numbers: Any) -> Any:
        return _coefficients(found, channels, numbers, state_of(s))["x"] * whole(s)

    def observe(seen: Seen, *numbers: Any) -> tuple[Any, Any, Any, Any]:
        own, roll = numbers[: -len(ROLLS)], numbers[-len(ROLLS) :]
        return heeled(seen, _coefficients(found, channels, own, state_seen(seen))["k"], *roll)

    half = {name: max(abs(low), abs(high)) / 2 for name, (low, high) in (reach or {}).items()}
    logs = np.array([np.log(half.get(shape.of, 0.0) or 1.0) for shape in found.shapes])
    coefficients = count * len(channels)

    def moved(numbers: Array, step: Array) -> Array:
        """The force at half the furthest goes along the step, and not the coefficient, which another power makes another by powers
        of ten."""
        after = numbers + step
        by = float(logs @ step[coefficients : coefficients + len(logs)])
        after[:coefficients] = (after[:coefficients] + by * numbers[:coefficients]) * np.exp(-by)
        return after

    names = [f"{channel}{k + 1}" if count > 1 else channel for channel in channels for k in range(count)]
    shapes = (*found.shapes, *_shapes_at(acts))
    return Effect(
        f"{NAME} {text}",
        STAGE.get(acts, "sway"),
        (
            *(Parameter(name, "", sizes[name[0]]) for name in names),
            *(Parameter(shape.name, shape.unit, shape.sd, none=shape.value) for shape in shapes),
        ),
        f"A {ACTING[acts]} that goes with {text}, found in these runs and in no book.",
        "Set the marks lower, measure the roll, or find what heels the model."
        if acts == HEEL
        else "Put the term into the simulator (law.toml, law.py), or find what makes it.",
        "towline diagnose --law",
        force=force if acts not in APART else None,
        ahead=ahead if acts == AHEAD else None,
        observe=observe if acts == HEEL else None,
        remembers=acts == HEEL,
        lag_s=found.lag_s,
        variant=acts,
        cost=float(np.log(2.0)) * found.parts,
        title=f"a {ACTING[acts]} that goes with {text}",
        reach=tuple((name, reach[name][0], reach[name][1]) for name in found.variables if reach and name in reach),
        moved=moved if logs.any() else None,
    )


def whole(s: Situation) -> Any:
    """rho/2 U^2 L^2, N.

    Parameters
    ----------
    s : of the tow
    """
    return 0.5 * s.density_kg_m3 * s.speed_m_s**2 * s.length_pp_m**2


def family_of(effect: Effect) -> str:
    """What laws' effects have in common that differ by the numbers inside alone; what acts ahead is another force than what acts
    aside, and a heel is none.

    Parameters
    ----------
    effect : of ``effect_of``
    """
    own = family(text_of(effect))
    return f"{effect.variant} {own}" if effect.variant in APART else own


def effect_like(effect: Effect, text: str, acts: str, seen: Range | None = None) -> Effect:
    """A law's effect of another text, or that acts elsewhere, of the same usual force (heel) and reach.

    Parameters
    ----------
    effect : of ``effect_of``
    text, acts : as ``effect_of`` takes them
    seen : of the runs: a usual coefficient is another one by another power; None: it is taken as it is
    """
    old, height = text_of(effect), 1.0
    if seen is not None and seen.states is not None and text != old:
        heights = [height_of(one, where, seen.states) for one, where in ((old, effect.variant), (text, acts))]
        height = heights[0] / heights[1] if min(heights) > 0 else 1.0
    by = {p.name[0]: height * p.sd for p in coefficients_of(effect)}
    some = next(iter(by.values()))  # where it does not act: as where it does
    return effect_of(text, acts, [by.get(channel, some) for channel in "ynxk"], {n: (a, b) for n, a, b in effect.reach})


def height_of(text: str, acts: str, states: State) -> float:
    """How large a term is in states, its coefficients 1: its root mean square; of one with a lag 0.

    Parameters
    ----------
    text, acts : as ``effect_of`` takes them
    states : (n,) of the runs
    """
    one = term(text)
    numbers = [1.0] * one.functions + [shape.value for shape in one.shapes]
    value = values_of(text, "Y", numbers, states)[0]
    # what a resistance always has is the straight tow's
    return float(np.std(value) if acts == AHEAD else np.sqrt(np.mean(value**2)))


def written_of(effect: Effect, numbers: Array) -> str:
    """The text of a law's effect's term with the numbers that a fit has found.

    Parameters
    ----------
    effect : of ``effect_of``
    numbers : of it
    """
    return written(text_of(effect), inside_of(effect, numbers))


def roll_of(effect: Effect, numbers: Array) -> Array:
    """Of a law's effect's numbers those of ROLLS; none where it does not heel the model.

    Parameters
    ----------
    effect : of ``effect_of``
    numbers : of it
    """
    return numbers[len(numbers) - len(_shapes_at(effect.variant)) :]


def values_of(text: str, acts: str, numbers: Sequence[float] | Array, states: State) -> Array:
    """(3, ...) side force and moment coefficients of a term in states, and the marks' place aside; a lagged one is not counted (0).

    What acts ahead is there by what the line answers: X tan(alpha + beta) aside, at the tow point. (The line also has to move the
    model that this pushes aside; that changes the answer by the square of the angle.)

    Parameters
    ----------
    text, acts : of the term
    numbers : of its effect
    states : where
    """
    side, moment, ahead, heel = parts_of(text, acts, numbers, states)
    aside = ahead * np.tan(states.alpha + states.beta)
    return np.array([side + aside, moment + aside * states.arm, heel])


def parts_of(text: str, acts: str, numbers: Sequence[float] | Array, states: State) -> Array:
    """(4, ...) coefficients of side force, moment, push ahead and heel of a term in states; a lagged one is not counted (0).

    Parameters
    ----------
    text, acts, numbers, states : as of ``values_of``
    """
    found = term(text)
    if found.lag_s:
        return np.zeros((4, *np.shape(states.v)))
    own = len(numbers) - len(_shapes_at(acts))
    by = _coefficients(found, ACTS[acts], numbers[:own], states)
    return np.array([by[channel] for channel in "ynxk"])


def _coefficients(
    found: Term, channels: Sequence[str], numbers: Sequence[Any] | Array, states: State
) -> dict[str, Any]:
    """By a term's effect's numbers: its functions' in each channel, then its shapes; what no channel has is 0."""
    count = found.functions
    values = found.basis(states, *numbers[len(channels) * count :])
    by = dict.fromkeys("ynxk", 0.0 * states.v)
    for k, channel in enumerate(channels):
        for number, value in zip(numbers[k * count : (k + 1) * count], values, strict=True):
            by[channel] = by[channel] + number * value
    return by


__all__ = [
    "ACTING", "ACTS", "AHEAD", "APART", "HEEL", "NAME", "ROLLS", "coefficients_of", "effect_like", "effect_of", "family_of",
    "heeled", "height_of", "inside_of", "parts_of", "roll_of", "shapes_from", "shapes_of", "state_of", "state_seen", "text_of",
    "values_of", "whole", "written_of",
]  # fmt: skip
