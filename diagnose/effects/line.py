"""What a tow line does beside pulling with a constant force."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ...geometry.checks.bundle import half_sine
from ...simulate.model import RESISTANCE_EXPONENT
from .base import SMALLEST_COSINE, Effect, Parameter, Seen, Situation
from .members import any_of, with_some

SLACK = "slack_line"
"""Name of the effect whose windows or courses are found in the runs."""
GIVES = 0.15
"""Share of the way at which a line that a wave slackens has lost most of its pull."""
SLACK_FORM = 0.01
"""A slack line's course is a guess, its time and size are fitted."""
TENSION_SECOND = 0.015
"""Of what a winch, a weight or a gauge's course explains, so much another effect may take beside it without being there. Of 26
campaigns of the blind check with one of these alone four had a wrong second one, which took 0.1, 0.3, 0.9 and 1.2 %; of those with
two the true second one took 0.1, 0.7 and 1.5 %.
"""
JERK_FORM = 0.03
"""What carries a model ahead takes a course of its own, and bounces are told by a camera coarsely."""
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


def _stretch(seen: Seen, compliance, follows):
    """Beyond its length on the axis: by what the line pulls harder there, and as far as the pull follows R/cos(alpha) besides."""
    rest = seen.tension_n * (1 / np.maximum(np.cos(seen.alpha_rad), 0.1) - 1)
    return compliance * (seen.beyond_n + follows * rest)


def _no_length(run) -> str:
    tow = run.file.tow
    return "" if tow is not None and tow.line == "surge" else 'line = "constant" keeps its tension'


def _length(run) -> str:
    return "" if _no_length(run) else 'line = "surge" keeps its length'


KEPT = Effect(
    "constant_tension",
    "line",
    (Parameter("share", "", 1.0, one_sided=True),),
    "A falling weight or a winch keeps the line at one tension: it gives way instead of swinging the model's mass.",
    'Give line = "constant", or tow on a line that keeps its length.',
    "theory.md 10",
    keeps=lambda share: share,
    needs=_no_length,
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
    needs=_no_length,
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
    stretch=_stretch,
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
        effect, parameters=(*always, *others), law=law, keeps=None, tension=None, length=None, stretch=None, needs=_no_length,
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


STIFFNESS = Parameter("stiffness_n_m", "N/m", 200.0, one_sided=True)
"""Of a soft line's spring, beside what its compliance says: prior standard deviation, a choice."""


def springing(bounce: Callable[[Any], Any], variant: str, cost: float, form: float) -> Effect:
    """A soft line on which the model bounces; the engine finds the bounce in the taut-line residual.

    The pull follows it by the line's stiffness, and cannot push. Only how much of the bounce is real is a number, and what it does
    to the pull.

    Parameters
    ----------
    bounce : time -> how much longer the line is, m, (..., runs, 1)
    variant : which bounce, in words
    cost : log evidence that finding it costs
    form : share of what it explains that it may leave over
    """

    def tension(s: Situation, compliance, follows, share, stiffness):
        # a longer line stands at a smaller angle
        change = bounce(s.t_s) * (stiffness - share * s.tension_n / s.line_length_m)
        return np.maximum(change, -s.tension_n)

    def stretch(seen: Seen, compliance, follows, share, stiffness):
        return _stretch(seen, compliance, follows) + share * bounce(seen.t_s)

    return replace(
        ELASTIC,
        parameters=(*ELASTIC.parameters, Parameter("bounce", "", 1.0), STIFFNESS),
        length=lambda tension_n, _length_m, compliance, *_: compliance * tension_n,
        tension=tension,
        stretch=stretch,
        members=(),
        variant=variant,
        bound=True,
        sizes=(1.0,),
        cost=cost,
        form=form,
    )


@dataclass(frozen=True)
class Jerks:
    """Slackenings of some runs' lines: courses of time, and how these change with an event's own numbers.

    Attributes
    ----------
    count : of all runs
    runs : indices of those that have one
    ahead : time -> by how much lines are shorter, m, and how that changes with an event's length, hardness and skew (logarithms):
        (4, ..., runs, columns)
    faster : by how much the models go faster through the water, m/s; likewise
    pushed : what pushes them ahead, over the straight tow's resistance; likewise
    """

    count: int
    runs: Sequence[int]
    ahead: Callable[[Any], Any]
    faster: Callable[[Any], Any]
    pushed: Callable[[Any], Any]

    def moved(self, course: Callable[[Any], Any], t_s: Any, own: Sequence[Any]) -> Any:
        """The course with every event so much later, longer, harder and more skewed, (..., runs, columns)."""
        numbers = np.zeros((4, self.count, np.size(own[0])))
        numbers[:, list(self.runs)] = np.reshape(own, (len(self.runs), 4, -1)).swapaxes(0, 1)
        here, *changes = course(t_s - numbers[0])
        for number, change in zip(numbers[1:], changes, strict=True):
            change *= number
            here += change
        return here


def jerked(jerks: Jerks, variant: str, cost: float) -> Effect:
    """A line that keeps its length goes slack and comes straight with a jerk; the engine finds the courses in the taut-line radius.

    The model goes as fast as those say. The line pulls with what that takes of it: nothing where it coasts, and the jerks.

    Parameters
    ----------
    jerks : the events
    variant : which events, in words
    cost : log evidence that finding them costs
    """

    def speed(s: Situation, share, _, *own):
        return share * jerks.moved(jerks.faster, s.t_s, own)

    def ahead(s: Situation, share, _, *own):
        return share * s.tension_n * jerks.moved(jerks.pushed, s.t_s, own)

    def observe(seen: Seen, _, nearer, *own):
        # how the model goes aside meanwhile its speed says
        ahead_m = nearer * jerks.moved(jerks.ahead, seen.t_s, own)
        return ahead_m / np.clip(np.cos(seen.alpha_rad), SMALLEST_COSINE, None), 0.0, 0.0, 0.0

    own = [
        (
            Parameter(f"later_{k + 1}_s", "s", 0.1),
            Parameter(f"longer_{k + 1}", "", 0.2),
            Parameter(f"harder_{k + 1}", "", 0.2),
            Parameter(f"skewed_{k + 1}", "", 0.2),
        )
        for k in jerks.runs
    ]
    return replace(
        slack([]),
        parameters=(
            Parameter("share", "", 1.0, one_sided=True),
            Parameter("nearer", "", 1.0, one_sided=True),
            *(number for numbers in own for number in numbers),
        ),
        physics="The carriage slows, or a wave or a hand carries the model ahead: the line goes slack and straightens with a jerk.",
        ahead=ahead,
        speed=speed,
        observe=observe,
        tension=None,
        stretch=None,
        variant=variant,
        form=JERK_FORM,
        cost=cost,
    )


def slack(windows: Sequence[tuple[float, float] | None], wave: bool = False) -> Effect:
    """A slack line in a window of each run (or none); the engine finds the windows in the taut-line residual.

    The carriage slows for a while (half sines), or a wave carries the model ahead: there and back smoothly, without any pull.

    Parameters
    ----------
    windows : begin and end of each run's window, s from its start, or None
    wave : a wave carries the model ahead, instead of the carriage slowing
    """
    begin, end = (np.array([[np.nan if w is None else w[k]] for w in windows]) for k in range(2))

    def bump(t_s, later, longer):
        return half_sine(t_s, begin + later - longer / 2, end + later + longer / 2)

    def tension(s: Situation, loss, _, later, longer):
        course = bump(s.t_s, later, longer)
        return -np.clip(loss, -0.2, 1) * s.tension_n * (np.tanh(course / GIVES) if wave else course)

    def stretch(seen: Seen, _, nearer, later, longer):
        return -nearer * bump(seen.t_s, later, longer) ** (2 if wave else 1)

    found = [f"run {i + 1} {w[0]:.1f}-{w[1]:.1f} s" for i, w in enumerate(windows) if w is not None]
    return Effect(
        SLACK,
        "line",
        (
            Parameter("loss", "", 0.7, one_sided=True),
            Parameter("nearer_m", "m", 0.02, one_sided=True),
            Parameter("later_s", "s", 0.1),
            Parameter("longer_s", "s", 0.1),
        ),
        "The carriage slows or the model surges ahead: the line goes slack and pulls no more for a while.",
        "Tow faster or add drag astern so that the line stays taut; cut those seconds out.",
        "theory.md 4",
        tension=tension,
        stretch=stretch,
        variant=("wave " if wave else "") + ", ".join(found),
        bound=True,
        sizes=(1.0,),
        form=SLACK_FORM,
        title="a line that goes slack",
    )
