"""What slackens a line, and how a model bounces on one: the engine finds the courses in the measured radius."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...geometry.checks.bundle import half_sine
from .base import SMALLEST_COSINE, Effect, Parameter, Seen, Situation
from .line import ELASTIC, stretched

SLACK = "slack_line"
"""Name of the effect whose windows or courses are found in the runs."""
GIVES = 0.15
"""Share of the way at which a line that a wave slackens has lost most of its pull."""
SLACK_FORM = 0.01
"""A slack line's course is a guess, its time and size are fitted."""
JERK_FORM = 0.03
"""What carries a model ahead takes a course of its own, and bounces are told by a camera coarsely."""
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
        return stretched(seen, compliance, follows) + share * bounce(seen.t_s)

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
