"""What a tow line does beside pulling with a constant force."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...simulate.model import RESISTANCE_EXPONENT
from .base import Effect, Parameter, Seen, Situation
from .members import any_of, with_some

TENSION_SECOND = 0.015
"""Of what a winch, a weight or a gauge's course explains, so much another effect may take beside it without being there. Of 26
campaigns of the blind check with one of these alone four had a wrong second one, which took 0.1, 0.3, 0.9 and 1.2 %; of those with
two the true second one took 0.1, 0.7 and 1.5 %.
"""
RAIL = 0.1
"""Sine of the line's angle to the hull at which it has gone three quarters of a rail's way."""
SLIPS_AT_S = (8.0, 13.0, 18.0, 23.0, 28.0, 33.0)
"""Times from which one at which a tow point slips is sought ..."""
SLIPS_S = 1.0
"""... and how long it takes: a choice; a tow is slower."""
RUB_RATE = 0.004
"""rad/s at which dry friction has turned over (it is smoothed there)."""
STRIBECK_RATE = 0.02
"""rad/s at which a swivel that sticks has begun to slide; tows turn their lines at up to ten times that."""


def _friction(s: Situation, moment, oil=0.0, stick=0.0):
    """The swivel rubs against the line's turning about the tow point: dry, with a moment that grows as oil's, sticking at rest."""
    turning = s.alpha_rate + s.r_rad_s
    grip = moment + stick * np.exp(-((turning / STRIBECK_RATE) ** 2))
    return 0.0 * s.alpha_rad, -grip * np.tanh(turning / RUB_RATE) - oil * turning


def _at_the_post(s: Situation, moment, oil):
    """The line's other end rubs: a moment on the line, and by its length a force across it at the tow point."""
    grip = moment * np.tanh(s.alpha_rate / RUB_RATE) + oil * s.alpha_rate
    side = -grip / s.line_length_m * np.cos(s.alpha_rad + s.beta_rad)
    return side, s.tow_point_m * side


def _turned_by(s: Situation, offset: Any) -> tuple[Any, Any]:
    """A line that holds beside the centre line pulls at another angle than to the point on it, and turns the model."""
    ahead = s.tension_n * np.cos(s.alpha_rad + s.beta_rad)
    side = -ahead * offset / s.line_length_m * np.cos(s.beta_rad)
    return side, s.tow_point_m * side - ahead * offset


def _moved_aside(seen: Seen, offset: Any) -> Any:
    """By how much further from the post the point on the centre line is than the one that is held."""
    return -offset * seen.side


def _along_the_rail(side: Any, slides: Any) -> Any:
    """The line draws its point along a rail, to the side it pulls to."""
    return slides * np.tanh(side / RAIL)


def _drawn_in(s: Situation, slides: Any) -> Any:
    """What a point that is drawn along a rail makes the line pull more, N."""
    sine, cosine = np.sin(s.alpha_rad + s.beta_rad), np.cos(s.alpha_rad + s.beta_rad)
    place = np.tanh(sine / RAIL)
    steep = (1 - place**2) / RAIL
    slope, bend = steep * cosine, -steep * (2 * place * cosine**2 / RAIL + sine)
    return _followed(
        s, slides * place, slides * slope * s.bend_rate, slides * (bend * s.bend_rate**2 + slope * s.bend_rate2)
    )


def _let_go(s: Situation, before: Any, slipped: Any, when: Any) -> Any:
    """What a point that slips makes the line pull more, N."""
    gone = np.tanh((s.t_s - when) / SLIPS_S)
    rate = 0.5 * slipped * (1 - gone**2) / SLIPS_S
    return _followed(s, _slipped(s.t_s, before, slipped, when), rate, -2 * gone * rate / SLIPS_S)


def _followed(s: Situation, offset: Any, rate: Any, rate2: Any) -> Any:
    """A point beside the centre line makes the line to that longer by -offset sin(a+b), and the model has to follow, N.

    u changes by -L'/cos(a+b), and the resistance with it; u' by -L''/cos(a+b), and T by that over what a newton does.
    """
    sine, cosine = np.sin(s.alpha_rad + s.beta_rad), np.cos(s.alpha_rad + s.beta_rad)
    faster = (rate * sine + offset * s.bend_rate * cosine) / cosine
    turned = offset * (s.bend_rate2 * cosine - s.bend_rate**2 * sine)
    return carried(s, faster, (rate2 * sine + 2 * rate * s.bend_rate * cosine + turned) / cosine)


def carried(s: Situation, faster: Any, sooner: Any) -> Any:
    """What a line that keeps its length pulls more where it makes the model go ahead otherwise, N; 0 on any other line.

    Parameters
    ----------
    s : where a change of T is asked
    faster, sooner : by how much, m/s and m/s2
    """
    resistance = np.where(np.isfinite(s.gain), s.tension_n - s.beyond_n, 0.0)
    cosine = np.cos(s.alpha_rad + s.beta_rad)
    return sooner / s.gain + RESISTANCE_EXPONENT * resistance / s.speed_m_s * faster / cosine


def _slipped(t_s: Any, before: Any, slipped: Any, when: Any) -> Any:
    return before + slipped * 0.5 * (1 + np.tanh((t_s - when) / SLIPS_S))


def _varies(s: Situation, power, late):
    """With the angle, or with the angle a little earlier where a winch or a falling weight follows it."""
    angle = s.alpha_rad - late * s.alpha_rate
    return (s.tension_n - s.beyond_n) * (np.maximum(np.cos(angle), 0.1) ** -power - 1)


def _instead(s: Situation, share, power, late):
    """The same law, so far as it stands instead of what keeps the line's length."""
    return share * (_varies(s, power, late) - s.beyond_n)


def stretched(seen: Seen, compliance, follows):
    """A line beyond its length on the axis, m: by what it pulls harder there, and as far as the pull follows R/cos(alpha)."""
    rest = seen.tension_n * (1 / np.maximum(np.cos(seen.alpha_rad), 0.1) - 1)
    return compliance * (seen.beyond_n + follows * rest)


def no_length(run) -> str:
    """Why a run's line keeps no length that could give way (``Effect.needs``); empty: it keeps one."""
    tow = run.file.tow
    return "" if tow is not None and tow.line == "surge" else 'line = "constant" keeps its tension'


def _length(run) -> str:
    return "" if no_length(run) else 'line = "surge" keeps its length'


KEPT = Effect(
    "constant_tension",
    "line",
    (Parameter("share", "", 1.0, one_sided=True),),
    "A falling weight or a winch keeps the line at one tension: it gives way instead of swinging the model's mass.",
    'Give line = "constant", or tow on a line that keeps its length.',
    "theory.md 10",
    keeps=lambda share: share,
    needs=no_length,
    second=TENSION_SECOND,
    title="a weight or a winch that keeps the line's tension",
)
TENSION = Effect(
    "tension_variation",
    "line",
    (Parameter("power", "", 1.0), Parameter("late_s", "s", 0.3)),
    "The line must overcome the hull's resistance along the tank, so that T grows as R/cos(alpha) (power 1).",
    "Measure T over time, or let the simulator use T = R/cos(alpha).",
    "thesis (4.7)",
    tension=_varies,
    members=with_some(["power"], ["late_s"]),
    needs=_length,
    second=TENSION_SECOND,
    title="a line tension that changes with the angle",
)
LAW = replace(
    TENSION,
    parameters=(
        Parameter("share", "", 1.0, one_sided=True),
        Parameter("power", "", 1.0, none=1.0),
        Parameter("late_s", "s", 0.3),
    ),
    physics="A winch or a servo gives the line a tension of its own, R/cos(alpha) (power 1), instead of what keeps its length.",
    cure="Measure T over time, or tow on a line that keeps its length.",
    tension=_instead,
    members=with_some(["share"], ["power", "late_s"]),
    needs=no_length,
    variant="instead of the line's length",
)
"""A tension that a winch makes; `none` of the power is that of R/cos(alpha)."""
ELASTIC = Effect(
    "elastic_line",
    "line",
    (Parameter("compliance_m_n", "m/N", 0.003, one_sided=True), Parameter("follows", "", 1.0)),
    "The line is a spring: it is longer the harder it pulls, and the model surges on it.",
    "Use a stiffer line (thin steel), or measure its length under load.",
    "theory.md 4",
    length=lambda tension_n, _length_m, compliance, _follows: compliance * tension_n,
    stretch=stretched,
    members=with_some(["compliance_m_n"], ["follows"]),
    title="a line that stretches",
)
OFFSET = Effect(
    "tow_point_offset",
    "line",
    (Parameter("offset_m", "m", 0.005, apart=1e-3),),
    "The line pulls beside the centre line and turns the model.",
    "Measure the tow point's offset and give tow_point_offset_m.",
    "theory.md 2",
    offset=lambda offset_m: offset_m,
    title="a tow point off the centre line",
)
OFFSET_FORMS = (
    replace(
        OFFSET,
        parameters=(Parameter("slides_m", "m", 0.006),),
        physics="The tow point slides on a rail or a bridle to the side that the line pulls to, and the line turns the model.",
        cure="Fix the tow point.",
        offset=None,
        force=lambda s, slides: _turned_by(s, _along_the_rail(np.sin(s.alpha_rad + s.beta_rad), slides)),
        by_pull=True,
        tension=_drawn_in,
        stretch=lambda seen, slides: _moved_aside(seen, _along_the_rail(seen.side, slides)),
        variant="on a rail",
    ),
    *(
        replace(
            OFFSET,
            parameters=(*OFFSET.parameters, Parameter("slipped_m", "m", 0.005), Parameter("when_s", "s", 2.0, none=at)),
            physics="The tow point slips during a run, and the line pulls beside the centre line.",
            offset=None,
            force=lambda s, *numbers: _turned_by(s, _slipped(s.t_s, *numbers)),
            by_pull=True,
            tension=_let_go,
            members=with_some(["slipped_m", "when_s"], ["offset_m"]),
            stretch=lambda seen, *numbers: _moved_aside(seen, _slipped(seen.t_s, *numbers)),
            variant=f"slips at about {at:g} s",
        )
        for at in SLIPS_AT_S
    ),
)
"""Beside one that stands off all along."""


def offset_each(runs: int) -> Effect:
    """A tow point that was set anew before each run.

    Parameters
    ----------
    runs : of the campaign
    """
    return replace(
        OFFSET,
        parameters=tuple(Parameter(f"offset_{k + 1}_m", "m", 0.005, apart=1e-3) for k in range(runs)),
        offset=lambda *offsets: np.array(offsets),
        variant="in each run another",
        bound=True,
    )


FRICTION = Effect(
    "swivel_friction",
    "line",
    (Parameter("moment_n_m", "N m", 0.05, one_sided=True),),
    "The swivel at the tow point rubs with a moment of constant size against the line's turning.",
    "Use a ball bearing swivel, or add the dry friction moment.",
    "Coulomb friction",
    force=_friction,
    title="friction in the swivel",
)
_OIL = Parameter("oil_n_m_s", "N m s", 0.3, one_sided=True)
"""Of a swivel's oil: its usual size, a choice."""
FRICTION_FORMS = (
    replace(
        FRICTION,
        parameters=(*FRICTION.parameters, _OIL),
        members=with_some(["oil_n_m_s"], ["moment_n_m"]),
        variant="dry, and oil",
    ),
    replace(
        FRICTION,
        parameters=(*FRICTION.parameters, _OIL, Parameter("stick_n_m", "N m", 0.02, one_sided=True)),
        members=with_some(["stick_n_m"], ["moment_n_m", "oil_n_m_s"]),
        source="Stribeck (1902)",
        variant="sticking, and oil",
    ),
    replace(
        FRICTION,
        parameters=(*FRICTION.parameters, _OIL),
        force=_at_the_post,
        members=any_of("moment_n_m", "oil_n_m_s"),
        variant="at the post",
    ),
)
"""Beside the dry one. Oil alone is damping, which the derivatives take up."""
