"""What the line pulls with: springs of several kinds, a winch, a weight."""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lanes

SLIDES_M_S, STICKS_M_S = 0.002, 0.006
"""Dry friction of a pulley has turned over at the first speed of the line; what sticks below about the second slides above."""
ROUNDS = 15
"""Newton's steps to a hanging line's pull, from above: they fall one after another, and end at the last digit."""


def stretch_at_rest(q: Lanes) -> Array:
    """How much longer than stated the line is under the pull of a straight tow, m: none, where it was measured so."""
    soft = q["elastic_line.compliance_m_n"] * (1 + q["elastic_line.creep"])
    return soft * q["tension"] - q["elastic_line.sag"] * q["line"]


def pull_of(q: Lanes, servo_n: Array, crept_m: Array, length: Array, length_rate: Array) -> Array:
    """What the line pulls with, N ``(n,)``: a spring that cannot push, or what a winch or a weight at its other end makes it.

    Parameters
    ----------
    q : numbers
    servo_n : what a winch's servo gives
    crept_m : by how much a creeping line has grown
    length, length_rate : from the post to the tow point, m and m/s
    """
    pull = _spring(q, crept_m, length, length_rate)
    if q.has("elastic_line.sag"):
        pull = np.where(q["elastic_line.sag"] > 0, _hanging(q, length, length_rate), pull)
    if q.once(servo_anywhere):
        pull = np.where(q.once(servo_on), servo_n, pull)
    if q.has("constant_tension.weight"):
        pull = np.where(q["constant_tension.weight"] > 0, _weighed(q, length, length_rate), pull)
    return np.maximum(pull, 0.0)


def servo_on(q: Lanes) -> Array:
    """Lanes whose line a winch holds by a law ``(n,)``."""
    return (q["tension_variation.power"] != 0) | (q["tension_variation.wrap"] != 0)


def servo_anywhere(q: Lanes) -> bool:
    """Some lane has one."""
    return bool(servo_on(q).any())


def servo_command(q: Lanes, cosine: Array) -> Array:
    """What a winch should pull with, N ``(n,)``: R/cos^power of the line's angle, and more by its sine (a wrapped pulley).

    Parameters
    ----------
    q : numbers
    cosine : of the line's angle
    """
    command = q["tension"] / np.maximum(cosine, 0.1) ** q["tension_variation.power"]
    if q.has("tension_variation.wrap"):
        command = command * (1 + q["tension_variation.wrap"] * np.sqrt(np.maximum(1 - cosine**2, 0.0)))
    return command


def servo_rates(q: Lanes, cosine: Array, pull: Array, rate: Array) -> tuple[Array, Array]:
    """How a winch's servo follows: an oscillator, damped by 0.7 or as given, or a lag of the first order; N/s and N/s2.

    Parameters
    ----------
    q : numbers
    cosine : of the line's angle
    pull, rate : of the servo, N and N/s
    """
    w = 2 * np.pi / np.maximum(q["tension_variation.period_s"], 0.2)
    off = servo_command(q, cosine) - pull
    double = np.where(q["tension_variation.rings"] > 0, 2 * q["tension_variation.rings"], 1.4)
    first, second = rate, w**2 * off - double * w * rate
    if q.has("tension_variation.lag_s"):
        lags = q["tension_variation.lag_s"] > 0
        first = np.where(lags, off / np.maximum(q["tension_variation.lag_s"], 0.1), first)
        second = np.where(lags, 0.0, second)
    on = servo_on(q)
    return np.where(on, first, 0.0), np.where(on, second, 0.0)


def _weighed(q: Lanes, length: Array, length_rate: Array) -> Array:
    """A weight over a pulley that rubs and may stick, be out of round, or wind its rope on a drum that grows."""
    rub = q["constant_tension.friction"] * np.tanh(length_rate / SLIDES_M_S)
    if q.has("constant_tension.stick"):
        rub = rub * (1 + q["constant_tension.stick"] * np.exp(-((length_rate / STICKS_M_S) ** 2)))
    held = q["constant_tension.weight"] * q["tension"] * (1 + rub) + q["constant_tension.drag_n_s_m"] * length_rate
    paid = length - q["line"]
    if q.has("constant_tension.drum_1_m"):
        held = held + q["tension"] * q["constant_tension.drum_1_m"] * paid
    if q.has("constant_tension.unround"):
        phase = 2 * np.pi * paid / np.maximum(q["constant_tension.round_m"], 0.02) + q["constant_tension.phase"]
        held = held + q["tension"] * q["constant_tension.unround"] * np.sin(phase)
    return held


def creep_rate(q: Lanes, crept_m: Array, tension: Array) -> Array:
    """A creeping line grows towards a share of its spring's stretch, m/s ``(n,)``.

    Parameters
    ----------
    q : numbers
    crept_m : by how much it has grown
    tension : what it pulls with, N
    """
    last = q["elastic_line.creep"] * q["elastic_line.compliance_m_n"] * tension
    return (last - crept_m) / np.maximum(q["elastic_line.creep_s"], 0.2)


def _spring(q: Lanes, crept_m: Array, length: Array, length_rate: Array) -> Array:
    """A straight spring, or one that stiffens: the pull goes with the stretch to a power (1 + stiffens)."""
    rest, line = q["tension"], q["line"]
    stiff, loose, more, damper = q.once(_spring_numbers)
    # a taut line's length is taken under the pull of a tow; a soft one's with none
    stretch = length - line + loose - crept_m
    held = stiff * stretch
    if more is not None:
        held = np.where(more > 0, rest * np.maximum(held / rest, 0.0) ** (1 + more), held)
    # strands grip as they tighten: no jump of the pull where a slack line comes straight
    grip = np.clip(held / rest, 0.0, 1.0)
    return np.where(stretch > 0, held + grip * damper * length_rate, 0.0)


def _spring_numbers(q: Lanes) -> tuple[Array, Array, Array | None, Array]:
    """Stiffness N/m, stretch m under the pull of a tow that the line's length holds, by how much it stiffens, damper."""
    soft = q["elastic_line.compliance_m_n"] > 0
    stiff = np.where(soft, 1 / np.where(soft, q["elastic_line.compliance_m_n"], 1.0), q["stiffness_n_m"])
    more, steepest = None, stiff
    if q.has("elastic_line.stiffens"):
        more = np.where(soft, q["elastic_line.stiffens"], 0.0)
        steepest = stiff * (1 + more)
    ratio = np.where(soft, q["elastic_line.damping"], q["line_damping"])
    return stiff, np.where(soft, 0.0, q["tension"] / stiff), more, 2 * ratio * np.sqrt(steepest * q["surge_mass"])


def _hanging(q: Lanes, length: Array, length_rate: Array) -> Array:
    """A heavy line: its chord is shorter than the line by ``sag`` (R/T)^2 of it, and it stretches a little as a taut one does.

    chord/L = 1 - sag (R/T)^2 + (T - R)/(k L), the parabola of a shallow catenary; solved for T.
    """
    rest, sag = q["tension"], np.maximum(q["elastic_line.sag"], 1e-9)
    spring = q["stiffness_n_m"] * q["line"]
    short = 1 - length / q["line"] - rest / spring
    pull = spring * np.maximum(-short, 0.0) + np.cbrt(sag * rest**2 * spring)
    for _ in range(ROUNDS):
        over = pull**3 / spring + short * pull**2 - sag * rest**2
        pull = pull - over / (3 * pull**2 / spring + 2 * short * pull)
    give = q["line"] * 2 * sag * rest**2 / pull**3 + 1 / q["stiffness_n_m"]
    damper = 2 * q["elastic_line.damping"] * np.sqrt(q["surge_mass"] / give)
    return pull + np.clip(pull / rest, 0.0, 1.0) * damper * length_rate
