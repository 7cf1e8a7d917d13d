"""Lines with a law of their own, whose length is a state: the model surges on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from .base import Effect, Parameter, Situation
from .line import ELASTIC, KEPT, LAW, no_length
from .members import with_some

SLIDES_M_S = 0.002
"""A pulley that rubs has turned over at this speed of the line (its friction is smoothed there)."""
STIFFEST_M_N = 1e-4
"""No line, with its load cell and knots, gives less."""
MOST_TIGHT, MOST_TIGHTER = 10.0, 3.0
"""Of a hanging line's pull, over a straight tow's, beyond which it is damped no more, and of the power with which that grows."""
CATENARY_STEPS, LEAST_SLOPE = 12, 1e-12
"""Newton's steps to a hanging line's pull, and the least slope, m N, that they divide by."""


def _spring(s: Situation, compliance, damper, stiffens):
    """A spring that is the stiffer the harder it is pulled, and a damper; it cannot push."""
    held = np.maximum(s.longer_m, 0.0) / (np.maximum(compliance, 0.0) + STIFFEST_M_N)
    share = held / s.tension_n
    taut = np.clip(share, 0.0, 1.0)
    return held * np.maximum(1 + 0.5 * stiffens * (share - 1), 0.1) + taut * damper * s.longer_rate_m_s


def _hanging(s: Situation, weight, damper, tighter):
    """A heavy line hangs: its chord is shorter than the line by L (w L/T)^2/24, the parabola of a shallow catenary.

    It hardly stretches: x = -L (w L/T)^2/24 + (T - R) c, solved for T from above.
    """
    rest, give, length = s.tension_n, STIFFEST_M_N, s.line_length_m - s.longer_m
    room, deep = s.longer_m + give * rest, length * (np.maximum(weight, 0.0) * length) ** 2 / 24
    held = np.maximum(room, 0.0) / give + np.cbrt(deep / give)
    for _ in range(CATENARY_STEPS):
        slope = np.maximum(held * (3 * give * held - 2 * room), LEAST_SLOPE)
        held = np.maximum(held - (held**2 * (give * held - room) - deep) / slope, 0.0)
    tight = np.minimum(held / rest, MOST_TIGHT) ** np.clip(tighter, 0.0, MOST_TIGHTER)
    return held + tight * damper * s.longer_rate_m_s


_HEAVIER = Parameter("heavier", "", 0.005)
"""By how much what keeps a tension pulls harder than the straight tow's resistance: the model then gains on the carriage, or falls
back. So well is a resistance known when a weight is hung (usual size, a choice)."""


def _weight(s: Situation, rub, drag, grows, heavier):
    """A weight over a pulley that rubs and drags, on a drum that grows."""
    sliding = np.tanh(s.longer_rate_m_s / SLIDES_M_S)
    held = s.tension_n * (1 + heavier) * (1 + rub * sliding)
    return held + drag * s.longer_rate_m_s + grows * s.longer_m


def _winch(s: Situation, power, late, wraps, heavier):
    """A winch that holds R/cos(alpha)^power, a little late, and more by what a wrapped rope rubs."""
    angle = s.alpha_rad - late * s.alpha_rate
    held = s.tension_n * (1 + heavier) * np.maximum(np.cos(angle), 0.1) ** -power
    return held * (1 + wraps * np.sqrt(np.sin(angle) ** 2 + 1e-4))


SURGING = "with the model's surge on it"
"""What the forms of line that have a law of their own are called."""


def _surging(
    effect: Effect,
    law: Callable[..., Any],
    always: Sequence[Parameter],
    others: Sequence[Parameter],
    what: str = "",
    physics: str = "",
) -> Effect:
    """An effect of the line as a law of the line's own, instead of what it changes of one that keeps its length."""
    members = with_some([p.name for p in always], [p.name for p in others])
    return replace(
        effect, parameters=(*always, *others), law=law, keeps=None, tension=None, length=None, stretch=None, needs=no_length,
        variant=f"{what}{SURGING}", sizes=(1.0,), members=members, physics=physics or effect.physics,
    )  # fmt: skip


LAWS = (
    _surging(
        ELASTIC,
        _spring,
        [Parameter("compliance_m_n", "m/N", 0.003, one_sided=True)],
        [Parameter("damper_n_s_m", "N s/m", 20.0, one_sided=True), Parameter("stiffens", "", 1.0)],
    ),
    _surging(
        ELASTIC,
        _hanging,
        [Parameter("weight_n_m", "N/m", 2.0, one_sided=True)],
        [Parameter("damper_n_s_m", "N s/m", 20.0, one_sided=True), Parameter("tighter", "", 0.5, none=1.0)],
        "hanging, ",
        "The line is heavy and hangs: its ends come the nearer together the less it is pulled, and the model surges on it.",
    ),
    _surging(
        KEPT,
        _weight,
        [],
        [
            Parameter("rub", "", 0.03, one_sided=True),
            Parameter("drag_n_s_m", "N s/m", 2.0, one_sided=True),
            Parameter("grows_n_m", "N/m", 1.0),
            _HEAVIER,
        ],
    ),
    _surging(
        LAW,
        _winch,
        [Parameter("power", "", 1.0)],
        [Parameter("late_s", "s", 0.3), Parameter("wraps", "", 0.2), _HEAVIER],
    ),
)
"""Lines whose length is a state, because what they pull with follows a law: never absent, they begin at the measured motion
(``Effect.law``)."""


PULLEYS_M = tuple(np.geomspace(0.06, 0.27, 10))
"""Ways of the line to a turn of a pulley, from which one that is out of round is sought: pulleys of 2 to 9 cm."""
MOST_SMALLER = 0.2
"""No fit goes further from one of these, as a share of it."""


def out_of_round(turn_m: float) -> Effect:
    """A weight over a pulley that is out of round: its arm is longer and shorter once a turn, as the line pays out and in.

    Parameters
    ----------
    turn_m : way of the line to a turn from which a fit begins
    """
    form = _surging(
        KEPT,
        partial(_unround, turn_m),
        [Parameter("sine", "", 0.01), Parameter("cosine", "", 0.01), Parameter("smaller", "", 0.1)],
        [
            Parameter("rub", "", 0.03, one_sided=True),
            Parameter("drag_n_s_m", "N s/m", 2.0, one_sided=True),
            _HEAVIER,
        ],
        f"a pulley out of round, a turn about {1e3 * turn_m:.0f} mm, ",
        "A weight over a pulley that is out of round pulls harder and less hard once a turn, as the line pays out and in.",
    )
    return replace(form, cure="Run the line over a pulley that is true, or hang the weight on a larger one.")


def _unround(turn_m: float, s: Situation, sine, cosine, smaller, rub, drag, heavier):
    phase = 2 * np.pi / turn_m * (1 + np.clip(smaller, -MOST_SMALLER, MOST_SMALLER)) * s.longer_m
    return _weight(s, rub, drag, 0.0, heavier) + s.tension_n * (sine * np.sin(phase) + cosine * np.cos(phase))


PULLEYS = tuple(out_of_round(turn_m) for turn_m in PULLEYS_M)
"""A weight over each of these."""
