"""The simulator as the diagnosis uses it: all runs and all hypotheses side by side, with the slopes of what would be measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ...record.errors import GeometryError
from ...simulate.model import Array
from ..effects import Effect, Late
from ..inference.hypothesis import EFFECT_STEP, Hypothesis, Path, Slopes
from ..inference.shooting import (
    BLOW_UP,
    CLOSE,
    HOPELESS,
    MOST_CLOSINGS,
    STATE_STEP,
    between,
    carried,
    integrated,
    stepped,
)
from .columns import OWN, STATES, Numbers, held_before, held_from
from .data import corrected
from .fields import Fields, OtherHull, tow_of
from .noise import moved_channels
from .numbers import shared_numbers
from .rates import TowRates
from .seen import TowSeen
from .tow_run import TowRun
from .variations import PROBE_N, Variations, joined, only_pushes

BEYOND = 4
"""Blocks after the end of the longest run: a clock that runs off may need them."""
BEGUN_STEPS = 4
"""Nodes to a step of a path that is closed afterwards."""
AT_ONCE = 8000
"""Numbers of an array in the steps: what a processor's cache holds."""
Answer = TypeVar("Answer")
"""Of one hypothesis."""


class TowModel:
    """All runs of a campaign.

    Parameters
    ----------
    runs : with one block length
    speed_m_s : at which derivatives are quoted
    names : of the shared numbers; None: those that the runs ask for
    hull : its equations, where they are another simulator's
    """

    def __init__(
        self,
        runs: Sequence[TowRun],
        speed_m_s: float,
        names: tuple[str, ...] | None = None,
        hull: OtherHull | None = None,
    ) -> None:
        self.runs, self.speed_m_s, self.hull = list(runs), speed_m_s, hull
        self.step_s = runs[0].step_s
        self._corrections: dict[tuple, Array] = {}
        self.count = max(len(r.centre_s) for r in runs) + BEYOND
        self.node_s = np.arange(2 * self.count + 1) * self.step_s / 2
        duration = np.array([[len(r.centre_s) * self.step_s] for r in runs])
        self.shared_names = shared_numbers(runs, speed_m_s).names if names is None else names
        self._fields = Fields(runs, duration, speed_m_s, self.shared_names, hull)
        self._seen = TowSeen(runs, self._fields, self.node_s)

    # the measured side ------------------------------------------------------------------------------------------------

    def measured(self, hypothesis: Hypothesis) -> list[Array]:
        """Values of every run (n, c), with the hypothesis's camera faults taken out."""
        answers = []
        for tow in self.runs:
            values = tow.values
            for effect, numbers in zip(hypothesis.effects, hypothesis.numbers, strict=True):
                if effect.correct is not None and numbers.any():
                    values = values + self._correction(tow, effect, numbers)
            answers.append(values)
        return answers

    def _correction(self, tow: TowRun, effect: Effect, numbers: Array) -> Array:
        """Change of the values (n, c) when the fault is taken out."""
        assert effect.correct is not None
        sizes, times = np.split(numbers, [len(numbers) - effect.timed])
        share = None if effect.when is None else effect.when(tow.name, tow.centre_s, *times)
        if share is not None and not share.any():
            return np.zeros_like(tow.values)
        key = (tow.name, effect.correct, sizes.tobytes())
        if key not in self._corrections:
            if tow.marks is None:
                shift = (0.0, 0.0, 0.0, 0.0) if effect.shift is None else effect.shift(*sizes)
                change = np.zeros((len(tow.values), 4)) + np.array(shift)
            else:
                try:
                    change = corrected(tow, *effect.correct(tow.marks.run, tow.marks.fit, *sizes))
                except GeometryError:  # no camera sees like that
                    change = np.full((len(tow.values), 4), BLOW_UP)
            # what a load cell says no camera spoils
            self._corrections[key] = np.pad(change, ((0, 0), (0, tow.values.shape[1] - 4)))
        return self._corrections[key] if share is None else share[:, None] * self._corrections[key]

    # the simulated side -----------------------------------------------------------------------------------------------

    def linear(self, hypotheses: Sequence[Hypothesis], closings: int = MOST_CLOSINGS) -> list[Slopes]:
        """Residuals and slopes of hypotheses.

        A camera fault moves the measured side: its slope is the change of the values when it is taken out, negative.

        Parameters
        ----------
        closings : Newton steps that may be taken to close the hypotheses' paths first; 0 leaves them open, and the residual is
            what the linearised motion would leave
        """
        return _by_law(hypotheses, lambda alike: self._linear(alike, closings))

    def _linear(self, hypotheses: Sequence[Hypothesis], closings: int) -> list[Slopes]:
        """``linear`` of hypotheses with the same states."""
        lates = _lates(hypotheses)
        groups = [self._variations(h) for h in hypotheses]
        courses = self._courses(hypotheses, groups, lates, closings)
        transition, push, start = self._steps(groups, courses, lates)
        moved = carried(transition, push, start)  # (nodes, hypotheses, runs, states, 1 + numbers)
        result = []
        for k, (h, group) in enumerate(zip(hypotheses, groups, strict=True)):
            path = np.clip(courses[k].path + moved[:, k, ..., 0].transpose(2, 0, 1), -BLOW_UP, BLOW_UP)
            changes = moved[:, k, ..., 1 : 1 + group.size]
            rows = []
            with np.errstate(all="ignore"):  # a motion that has run off is told by what is not finite
                seen = self._seen.slopes(group, path, changes, lates)
            for (value, slope), run, measured in zip(seen, self.runs, self.measured(h), strict=True):
                self._camera_slopes(h, run, slope)
                rows.append((measured - value, slope))
            result.append(Slopes(rows, Path(lates, path), changes))
        return result

    def values(self, hypotheses: Sequence[Hypothesis]) -> list[list[Array]]:
        """What hypotheses say would be measured: per hypothesis and run (n, c)."""
        return _by_law(hypotheses, self._values)

    def _values(self, hypotheses: Sequence[Hypothesis]) -> list[list[Array]]:
        """``values`` of hypotheses with the same states."""
        lates = _lates(hypotheses)
        groups = [self._variations(h) for h in hypotheses]
        numbers, _ = joined([g.columns((), 0) for g in groups], lates)
        courses = self._courses(hypotheses, groups, lates, MOST_CLOSINGS)
        paths = np.stack([c.path for c in courses], axis=-1) + _closing(courses, numbers.start())
        return self._seen.values(numbers, paths)

    def begun(self, h: Hypothesis) -> Hypothesis:
        """The hypothesis with a path near its own, integrated by steps four times as long, for ``linear`` to close."""
        lates, step = _lates([h]), BEGUN_STEPS * self._half
        numbers, _ = joined([self._variations(h).columns((), 0)], lates)
        rates, count = self._rates(numbers), -(-(len(self.node_s) - 1) // BEGUN_STEPS) + 1
        path = integrated(rates, numbers.start(), count, step)
        t_s = step * np.arange(count)
        with np.errstate(all="ignore"):
            slope = rates(t_s[:, None, None], path)
        if not (np.isfinite(path).all() and np.isfinite(slope).all()):
            return replace(h, path=None)
        return replace(h, path=Path(lates, CubicHermiteSpline(t_s, path, slope, axis=1)(self.node_s)[..., 0]))

    def momentum(self, h: Hypothesis, width: int) -> tuple[Array, Array]:
        """By how much the hypothesis's path changes more over ``width`` nodes than its rates give, and that with every number.

        Returns
        -------
        (windows, runs, states), (windows, runs, states, numbers); 0 beyond a run's end
        """
        assert h.path is not None
        group = self._variations(h)
        numbers, _ = joined([group.columns((), 0)], h.path.lates)
        path = h.path.states
        rates = self._slopes_of_rates(numbers, path[..., None])[..., 0].transpose(1, 2, 0)
        change = self._by_numbers(group, path, h.path.lates)

        def over(values: Array) -> Array:
            """Trapezoids over each window."""
            whole = np.concatenate([np.zeros_like(values[:1]), np.cumsum((values[1:] + values[:-1]) / 2, axis=0)])
            return self._half * (whole[width:] - whole[:-width])

        there = np.array([[2 * len(r.centre_s) - 1 >= k for r in self.runs] for k in range(width, len(self.node_s))])
        states = path.transpose(1, 2, 0)
        missed = states[width:] - states[:-width] - over(rates)
        return missed * there[..., None], over(change) * there[..., None, None]

    def pushed(self, h: Hypothesis) -> list[Array]:
        """How the means of what moves answer forces that last one block each, along the hypothesis's own path.

        A line that swings answers a push otherwise than a straight one, by the square of its angles: forces that move a model by
        centimetres would else leave tenths of a millimetre that no noise explains.

        Returns
        -------
        of each run (n, m, 2, n): y, m, heading, rad, and, where a load cell says it, what the line pulls with, N
        (``moved_channels``); by a side force, N, and a moment, N m; in every block
        """
        lates, group = _lates([h]), self._variations(h)
        course = self._courses([h], [group], lates, 0)[0]
        numbers, _ = joined([group.columns((), 0, probed=True)], lates)
        rates = self._slopes_of_rates(numbers, course.path[..., None])
        by_force = (rates[..., 1:3] - rates[..., :1]).transpose(1, 2, 0, 3) / PROBE_N
        once = course.early @ by_force[:-1] + course.late @ by_force[1:]
        blocks = self.count - BEYOND
        push, nodes = np.zeros((*once.shape, blocks)), np.arange(2 * blocks)
        push[nodes, ..., nodes // 2] = once[nodes]
        push = push.reshape(*once.shape[:3], 2 * blocks)
        changes = np.clip(carried(course.transition, push, np.zeros_like(push[0])), -BLOW_UP, BLOW_UP)
        found = self._seen.by_motion(group, course.path, changes, lates)
        answers = [
            answer[:, list(moved_channels(run))].reshape(len(answer), -1, 2, blocks)[..., : len(answer)]
            for run, answer in zip(self.runs, found, strict=True)
        ]
        if self.celled:
            # a taut line pulls harder at once, and not only as what is pushed moves
            with np.errstate(all="ignore"):
                pull = self._rates(numbers).pulls(self.node_s[:, None, None], course.path[..., None])[1]
            for k, answer in enumerate(answers):
                at = np.arange(len(answer))
                once = (pull[:, k, 1:3] - pull[:, k, :1]) / PROBE_N
                answer[at, -1, :, at] += (once[2 * at] + 2 * once[2 * at + 1] + once[2 * at + 2]) / 4
        return answers

    @property
    def celled(self) -> bool:
        """Whether a load cell says what lines pull with."""
        return self.runs[0].celled

    def taut(self, h: Hypothesis, path: Path) -> tuple[Array, Array]:
        """(nodes, runs) what the lines pull with, N, and ``Taut.gain``, m/s2 per N, without effects, along a path that need not be
        the hypothesis's own.
        """
        numbers, _ = joined([self._variations(replace(h, effects=(), numbers=())).columns((), 0)], ())
        with np.errstate(all="ignore"):
            taut = self._rates(numbers).taut(self.node_s[:, None, None], path.states[:STATES, ..., None])
        shape = path.states.shape[1:]
        pull, gain = (np.broadcast_to(one, (*shape, 1))[..., 0] for one in (taut.tension_n, taut.gain))
        return pull, gain

    def _variations(self, h: Hypothesis) -> Variations:
        return Variations(h, len(self.runs), self.shared_names, self.celled)

    @property
    def _half(self) -> float:
        return self.step_s / 2

    def _rates(self, numbers: Numbers) -> TowRates:
        return TowRates(self._fields, numbers, tow_of(self._fields, numbers))

    def _step(self, numbers: Numbers, path: Array) -> Array:
        """One step from every node but the last: (states, nodes - 1, runs, columns)."""
        with np.errstate(all="ignore"):
            return stepped(self._rates(numbers), self.node_s[:-1, None, None], path[:, :-1], self._half)

    def _slopes_of_rates(self, numbers: Numbers, path: Array) -> Array:
        """Rates at every node, some nodes at a time: (states, nodes, runs, columns); the path has columns or one for all."""
        rates, answer = self._rates(numbers), np.empty((*path.shape[:3], numbers.width))
        stretch = max(1, AT_ONCE // (path.shape[2] * numbers.width))
        with np.errstate(all="ignore"):
            for k in range(0, path.shape[1], stretch):
                here = slice(k, k + stretch)
                answer[:, here] = rates(self.node_s[here, None, None], path[:, here])
        return answer

    def _courses(
        self, hypotheses: Sequence[Hypothesis], groups: Sequence[Variations], lates: tuple[Late, ...], closings: int
    ) -> list[_Course]:
        """A motion of every hypothesis, closed to CLOSE as far as ``closings`` allow, and how changes are carried along it."""
        numbers, _ = joined([g.columns((), 0) for g in groups], lates)
        if any(h.path is None for h in hypotheses):
            whole = integrated(self._rates(numbers), numbers.start(), len(self.node_s), self._half)
            return self._along(groups, whole, lates)
        paths = np.stack([_with_lates(h.path, lates) for h in hypotheses if h.path is not None], axis=-1)
        start, going, lost = numbers.start(), list(range(len(hypotheses))), list[int]()
        courses = dict[int, _Course](zip(going, self._along(groups, paths, lates), strict=True))
        for turn in range(closings):
            step = _closing([courses[k] for k in going], start[..., going])
            size = np.abs(step).max(axis=(0, 1, 2))
            lost += [k for k, one in zip(going, size, strict=True) if not one < HOPELESS]
            kept = (size >= CLOSE) & (size < HOPELESS)
            going = [k for k, one in zip(going, kept, strict=True) if one]
            if not going or turn == closings - 1:
                break
            paths[..., going] = np.clip(paths[..., going] + step[..., kept], -BLOW_UP, BLOW_UP)
            courses.update(zip(going, self._along([groups[k] for k in going], paths[..., going], lates), strict=True))
        lost += going if closings else []
        if lost:
            some = [replace(hypotheses[k], path=None) for k in lost]
            courses.update(zip(lost, self._courses(some, [groups[k] for k in lost], lates, 0), strict=True))
        return [courses[k] for k in range(len(hypotheses))]

    def _along(self, groups: Sequence[Variations], paths: Array, lates: tuple[Late, ...]) -> list[_Course]:
        """How changes are carried along paths (states, nodes, runs, hypotheses).

        From the rates' slopes at the nodes; between them these are taken as straight lines.
        """
        size = len(paths)
        alone, _ = joined([g.columns((), 0) for g in groups], lates)
        missed = (self._step(alone, paths) - paths[:, 1:]).transpose(3, 1, 2, 0)
        base, begins = joined([g.columns((), size) for g in groups], lates)
        rates = self._slopes_of_rates(base, _with_each_state_stepped(paths, begins, [1 + size] * len(groups)))
        courses = []
        for k, begin in enumerate(begins):
            by_state = (rates[..., begin + 1 : begin + 1 + size] - rates[..., begin, None]) / STATE_STEP
            carry = between(by_state.transpose(1, 2, 0, 3), self._half)
            courses.append(_Course(np.ascontiguousarray(paths[..., k]), missed[k], *carry))
        return courses

    def _steps(
        self, groups: Sequence[Variations], courses: Sequence[_Course], lates: tuple[Late, ...]
    ) -> tuple[Array, Array, Array]:
        """How changes are carried from node to node, what every number adds there, and where it begins (``carried``'s)."""
        size, most = len(courses[0].path), max(g.size for g in groups)
        push = np.zeros((len(self.node_s) - 1, len(groups), len(self.runs), size, most + 1))
        start = np.zeros((len(groups), len(self.runs), size, most + 1))
        for k, (group, course) in enumerate(zip(groups, courses, strict=True)):
            change = self._by_numbers(group, course.path, lates)
            push[:, k, :, :, 0] = course.missed
            push[:, k, :, :, 1 : 1 + group.size] = course.early @ change[:-1] + course.late @ change[1:]
            start[k, :, :, 0] = (group.start(lates)[0] - course.path[:, 0]).T
            start[k, :, :, 1 : 1 + group.size] = group.start(lates)[1].transpose(1, 0, 2)
        return np.stack([c.transition for c in courses], axis=1), push, start

    def _by_numbers(self, group: Variations, path: Array, lates: tuple[Late, ...]) -> Array:
        """How every number of a hypothesis changes the rates along its path: (nodes, runs, states, numbers).

        The state is the same in all columns: what depends on it alone is worked out once.
        """
        few = group.pushing()
        numbers, _ = joined([group.columns(few, 0, probed=True)], lates)
        rates = self._slopes_of_rates(numbers, path[..., None])
        change = np.zeros((*rates.shape[1:3], len(rates), group.size))
        moved = (rates[..., 1:] - rates[..., :1]).transpose(1, 2, 0, 3)
        change[..., few] = moved[..., : len(few)] / group.steps[None, :, None][..., few]
        self._pushes(group, path, lates, moved[..., len(few) :] / PROBE_N, change)
        return change

    def _pushes(self, group: Variations, path: Array, lates: tuple[Late, ...], by_force: Array, change: Array) -> None:
        """Put in how the numbers of effects that push or pull change the rates."""
        pushing = [(e, n, at) for e, n, at in group.each() if only_pushes(e) and (e.force or e.tension or e.ahead)]
        if not pushing:
            return
        numbers, _ = joined([group.columns((), 0)], lates)
        rates = self._rates(numbers)
        for effect, here, at in pushing:
            step = EFFECT_STEP * np.array([p.sd for p in effect.parameters])
            table = np.column_stack([here, here[:, None] + np.diag(step)])
            with np.errstate(all="ignore"):
                found = rates.pushes(self.node_s[:, None, None], path[..., None], effect, table)
            force = np.stack([(f[..., 1:] - f[..., :1]) / step for f in found], axis=2)
            change[..., at : at + len(here)] += by_force @ force

    def _camera_slopes(self, hypothesis: Hypothesis, tow: TowRun, slope: Array) -> None:
        at = len(hypothesis.shared) + len(OWN)
        for effect, numbers in zip(hypothesis.effects, hypothesis.numbers, strict=True):
            if effect.correct is not None:
                here = self._correction(tow, effect, numbers) if numbers.any() else 0.0
                for k, parameter in enumerate(effect.parameters):
                    step = EFFECT_STEP * parameter.sd
                    moved = numbers.copy()
                    moved[k] += step
                    slope[:, :, at + k] = -(self._correction(tow, effect, moved) - here) / step
            at += len(numbers)


@dataclass(frozen=True)
class _Course:
    """A motion of one hypothesis, and how changes are carried along it.

    Attributes
    ----------
    path : (states, nodes, runs)
    missed : (nodes - 1, runs, states), by how much it misses itself
    transition, early, late : (nodes - 1, runs, states, states), of ``between``
    """

    path: Array
    missed: Array
    transition: Array
    early: Array
    late: Array


def _closing(courses: Sequence[_Course], start: Array) -> Array:
    """The Newton step (states, nodes, runs, hypotheses) that closes paths; they begin at ``start`` (states, runs, hypotheses)."""
    transition = np.stack([c.transition for c in courses], axis=1)
    push = np.stack([c.missed for c in courses], axis=1)[..., None]
    first = np.stack([(start[..., k] - c.path[:, 0]).T for k, c in enumerate(courses)])[..., None]
    return carried(transition, push, first)[..., 0].transpose(3, 0, 2, 1)


def _with_each_state_stepped(paths: Array, begins: Sequence[int], widths: Sequence[int]) -> Array:
    """Paths (states, nodes, runs, hypotheses) in every column of theirs; of the first columns each has one state stepped by
    STATE_STEP."""
    whole = np.repeat(paths, widths, axis=3)
    for begin in begins:
        for s in range(len(paths)):
            whole[s, ..., begin + 1 + s] += STATE_STEP
    return whole


def _by_law(hypotheses: Sequence[Hypothesis], work: Callable[[list[Hypothesis]], list[Answer]]) -> list[Answer]:
    """``work`` of those whose line has a law of its own and of the others apart: they have more states."""
    answers: dict[int, Answer] = {}
    for lawful in (False, True):
        at = [k for k, h in enumerate(hypotheses) if h.lawful == lawful]
        if at:
            answers.update(zip(at, work([hypotheses[k] for k in at]), strict=True))
    return [answers[k] for k in range(len(hypotheses))]


def _lates(hypotheses: Sequence[Hypothesis]) -> tuple[Late, ...]:
    """How all their effects hold velocities back."""
    return tuple(sorted({e.late for h in hypotheses for e in h.effects if e.late is not None}))


def _with_lates(path: Path, lates: tuple[Late, ...]) -> Array:
    """A path with these lagged velocities; those it does not have begin as the velocities."""
    if path.lates == lates:
        return path.states
    first = len(path.states) - sum(late.size for late in path.lates)
    rows = [*path.states[:first]]
    for late in lates:
        if late in path.lates:
            at = first + held_before(path.lates, late)
            rows += [*path.states[at : at + late.size]]
        else:
            rows += [path.states[k] if k else np.zeros_like(path.states[0]) for k in held_from([late])]
    return np.stack(rows)


__all__ = ["BEYOND", "TowModel"]
