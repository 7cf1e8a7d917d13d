"""A model of one's own with its records, as the engine wants a simulator: fits, random forces, free forms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from ...simulate.model import Array
from ..effects import Effect
from ..inference.evidence import Fitted, Inference
from ..inference.hypothesis import EFFECT_STEP, Hypothesis, Slopes
from ..inference.noise import FORCE_SD_N, Measured, Noise, force_colour
from ..users import STEP_SHARE, UsersNumber, UsersRun, UsersSimulator
from .begin import Beginning, begun
from .course import FAR, Grid, Put, held, simulated
from .free import free_forms
from .library import Scales, library_for
from .model import Missing, Output, System, rate_of, usual_size
from .records import Record
from .terms import laws_for

INNERS, EXACT = (1, 2, 4, 8, 16, 32), 0.02
"""Steps of integration between two samples: the fewest whose outputs are within this share of the noise of twice as many."""
MOST_COLUMNS = 800
"""Simulations side by side: for memory."""
PULSES, PULSE = 16, 1e-3
"""At so many times of a record it is looked what a random force does; how large it is there, of the equation's own rate."""
USUAL_FORCE, MOST_FORCE = 1e-3, 0.02
"""Random forces on an equation, of its own rate: what stays when nothing is missing, and what is a gap. Choices."""
TIMES = (2.5, 0.1)
"""Random forces last from so many steps of a record to this share of its length, or the geometric mean of both."""
TURNS = 0.05
"""A state is above and below zero where it is so by more than this share of its usual size."""
HALF_SURE, WIDTH = 0.96, 0.01
"""``Simulator.half_sure``. Of a model of one's own every near relative is offered under a name of its own (drag by the square and
by the cube, a lag and a delay), so that what takes less is more likely a relative than the effect itself in another form. Of 17
effects left out of the library (seed 11 of benchmarks/any_simulator.py, D over 20) the nearest relative took 0.94 at most, and a
pair 0.98 once.
"""
TERM_STEP = 1e-4
"""Share by which a number is changed to see its term."""
LARGE = 95.0
"""Percentile of a state's absolute value that is its usual size."""


@dataclass(frozen=True)
class Blocks:
    """A record in blocks.

    Attributes
    ----------
    record : with its samples
    size : samples in a block
    """

    record: Record
    size: int

    @property
    def count(self) -> int:
        """Of blocks."""
        return len(self.record.values) // self.size

    def means(self, samples: Array) -> Array:
        """(blocks, ...) of (samples, ...), of what was measured."""
        whole = samples[: self.count * self.size].reshape(self.count, self.size, *samples.shape[1:])
        return whole.mean(axis=1)

    @cached_property
    def run(self) -> UsersRun:
        """As the engine has it."""
        record, values = self.record, self.record.values
        good = np.isfinite(values)
        share = self.means(good.astype(float))
        with np.errstate(invalid="ignore"):
            means = self.means(np.where(good, values, 0.0)) / share
        # a block of which less than all was measured would be the mean of another time
        means[share < 1] = np.nan
        centre_s = (np.arange(self.count) + 0.5 * (self.size - 1) / self.size) * self.size * record.step_s
        lag_s = np.abs(centre_s[:, None] - centre_s[None, :])
        covariance = np.array([noise.covariance(self.size, record.step_s, lag_s) for noise in record.noises])
        return UsersRun(record.name, centre_s, means, covariance)


class OwnSimulator(UsersSimulator):
    """A model with its records as ``inference.diagnosable.Diagnosable``.

    Parameters
    ----------
    system : the model
    records : of one step
    size : samples in a block
    without : names of effects that are not offered
    law : terms of the states are offered, too (``terms``)

    Attributes
    ----------
    times_s : how long random forces last
    missing : name -> what is offered
    scales : of the records

    Raises
    ------
    EstimationError : no course of the model stays within bounds, or none is exact
    """

    def __init__(
        self, system: System, records: Sequence[Record], size: int, without: Sequence[str] = (), law: bool = False
    ) -> None:
        self.system, self.blocks = system, [Blocks(record, size) for record in records]
        self.kinematic = rate_of(system)
        self._numbers = [n for n in system.numbers if not n.known]
        self._free = [s for s in system.states if not s.known]
        values = {s.name: [self._first(s.name, record) for record in records] for s in self._free}
        super().__init__(
            [blocks.run for blocks in self.blocks],
            lambda run, numbers, effects: np.zeros(0),
            [UsersNumber(n.name, n.start, n.sd, n.usual) for n in self._numbers],
            [UsersNumber(s.name, values[s.name], None, usual_size(s.start, s.size)) for s in self._free],
        )
        self.shared_bounds: Array | None = np.array([[n.least, n.most] for n in self._numbers]).reshape(-1, 2).T
        longest = max(r.length_s for r in records)
        first, last = TIMES[0] * self.step_s, max(TIMES[1] * longest, 2 * TIMES[0] * self.step_s)
        self.times_s = (first, float(np.sqrt(first * last)), last)
        self.missing: dict[str, Missing] = {}
        self._inner = INNERS[0]
        self._own_effects: dict[str, Effect] = {}
        self._begun: list[Hypothesis] | None = None
        self._inner = self._exact(Hypothesis(self._begin(self._shared)[0], self._begin(self._own)))
        best = self.starts()[0]
        self._inner = max(self._inner, self._exact(best))
        self.scales, self.random = self._scaled(best)
        laws = laws_for(system, self.kinematic, self.scales) if law else ()
        offered = (*library_for(system, self.kinematic, self.scales), *laws, *system.missing)
        self.missing = {m.name: m for m in offered if m.name not in without}
        self._dynamic = [s for s in system.states if self.random.get(s.name)]
        self.most_force = MOST_FORCE / USUAL_FORCE * FORCE_SD_N
        self.half_sure, self.sure_width = HALF_SURE, WIDTH
        self.noise_known = True

    @property
    def longest_step_s(self) -> float:
        """Steps of integration that were short enough."""
        return self.blocks[0].record.step_s / self._inner

    @property
    def own_names(self) -> list[str]:
        """States whose starts are fitted."""
        return [s.name for s in self._free]

    def with_records(self, records: Sequence[Record]) -> OwnSimulator:
        """The same model, effects and sizes with other records of the same step, for what is simulated and not fitted.

        Parameters
        ----------
        records : of any lengths
        """
        other = copy(self)
        other.__dict__.pop("_held", None)
        other.blocks = [Blocks(record, self.blocks[0].size) for record in records]
        other._runs, other._begun = [blocks.run for blocks in other.blocks], None
        other.own_sd, other.stated = (np.tile(a[:1], (len(records), 1)) for a in (self.own_sd, self.stated))
        other.modes = [np.zeros((*run.values.shape, 0)) for run in other._runs]
        return other

    @property
    def dynamic(self) -> dict[str, float]:
        """State -> usual random changes of its rate, of equations that have physics."""
        return {s.name: self.random[s.name] for s in self._dynamic}

    @property
    def library(self) -> list[Effect]:
        """What is offered, as the engine knows it; the same objects each time."""
        for name, m in self.missing.items():
            if name not in self._own_effects:
                self._own_effects[name] = m.effect(self.stage_of(m))
        return [self._own_effects[name] for name in self.missing]

    def stage_of(self, m: Missing) -> str:
        """Where something missing acts, in the user's words."""
        for name, those in (
            (m.equation, self.system.states),
            (m.input, self.system.inputs),
            (m.output, self.system.outputs),
        ):
            for one in those:
                if name and one.name == name:
                    return getattr(one, "stage", "") or getattr(one, "equation", "") or name
        return "clock"

    # where it begins ------------------------------------------------------------------------------------------------

    def _first(self, state: str, record: Record) -> float:
        """Where a run's state begins, as measured where it is."""
        outputs = [o.name for o in self.system.outputs]
        if state in outputs:
            return record.first(outputs.index(state), 0)
        for place, rate in self.kinematic.items():
            if rate == state and place in outputs:
                return record.first(outputs.index(place), 1)
        return next(s.start for s in self.system.states if s.name == state)

    def starts(self) -> list[Hypothesis]:
        """Ends of least squares over longer and longer beginnings, from many places at once; then where the user says."""
        if self._begun is None:
            own = np.array([n.size for n in self._own])
            given = Hypothesis(self._begin(self._shared)[0], self._begin(self._own))
            beginning = Beginning(self._numbers, own, self.values, self.linear, [blocks.run for blocks in self.blocks])
            self._begun = begun(beginning, given)
        return self._begun

    def _exact(self, h: Hypothesis) -> int:
        """Steps between samples that are enough for this hypothesis."""
        if self.system.whole:
            return INNERS[0]
        before: Sequence[Array] | None = None
        sd = [np.sqrt(np.einsum("cnn->nc", run.covariance)) for run in self._runs]
        for inner in INNERS:
            self._inner = inner
            now = self.values([h])[0]
            if before is not None:
                worst = max(float(np.max(np.abs(a - b) / s)) for a, b, s in zip(now, before, sd, strict=True))
                if worst < EXACT:
                    return INNERS[INNERS.index(inner) - 1]
            before = now
        return INNERS[-1]

    # courses --------------------------------------------------------------------------------------------------------

    def values(self, hypotheses: Sequence[Hypothesis], share: float = 1.0) -> list[list[Array]]:
        """Of each hypothesis and run (n, c), over the first ``share`` of the record; beyond it NaN."""
        return [[rows[..., 0] for rows in one] for one in self._simulated(hypotheses, share, False)]

    def linear(self, hypotheses: Sequence[Hypothesis], closings: int = 0, share: float = 1.0) -> list[Slopes]:
        """Residuals and slopes by differences, all variations of all runs and hypotheses side by side."""
        answers = []
        for h, those in zip(hypotheses, self._simulated(hypotheses, share, True), strict=True):
            rows = []
            for index, (run, values) in enumerate(zip(self._runs, those, strict=True)):
                with np.errstate(all="ignore"):
                    slopes = (values[..., 1:] - values[..., :1]) / self._steps(h, index)
                rows.append((run.values - values[..., 0], slopes))
            answers.append(Slopes(rows))
        return answers

    def _here(self, h: Hypothesis, index: int) -> Array:
        return np.concatenate([h.shared, h.own[index], *h.numbers])

    def _steps(self, h: Hypothesis, index: int) -> Array:
        """(v,) of the differences; away from an upper bound."""
        own = [*self._shared, *self._own]
        here = self._here(h, index)
        steps = [STEP_SHARE * max(abs(v), n.size) for v, n in zip(here, own, strict=False)]
        for k, most in enumerate(n.most for n in self._numbers):
            if here[k] + steps[k] > most:
                steps[k] = -steps[k]
        return np.array(steps + [EFFECT_STEP * q.sd for e in h.effects for q in e.parameters])

    def _simulated(self, hypotheses: Sequence[Hypothesis], share: float, slopes: bool) -> list[list[Array]]:
        """Per hypothesis and run (n, c, 1 or 1 + v)."""
        tables = []
        for h in hypotheses:
            for index in range(len(self._runs)):
                here = self._here(h, index)[:, None]
                tables.append((h, index, here + np.diag(self._steps(h, index)) if slopes else here[:, :0], here))
        wholes = [(h, index, np.concatenate([here, varied], axis=1)) for h, index, varied, here in tables]
        found = [values for part in _parts(wholes, MOST_COLUMNS) for values in self._side_by_side(part, share)]
        count = len(self._runs)
        return [found[k * count : (k + 1) * count] for k in range(len(hypotheses))]

    def _side_by_side(self, wholes: Sequence[tuple[Hypothesis, int, Array]], share: float) -> list[Array]:
        widths = [table.shape[1] for _, _, table in wholes]
        run_of = np.repeat([index for _, index, _ in wholes], widths)
        p, start = self._filled(wholes)
        puts = self._puts(wholes, widths)
        seen = self._courses(run_of, p, start, puts, share)
        answers, at = [], 0
        for (_, index, _), width in zip(wholes, widths, strict=True):
            answers.append(self._of_blocks(index, seen[..., at : at + width]))
            at += width
        return answers

    def _filled(self, wholes: Sequence[tuple[Hypothesis, int, Array]]) -> tuple[Array, Array]:
        """Numbers (q, k) and starts (s, k), with those that are known."""
        own = np.concatenate([table[: len(self._numbers) + len(self._free)] for _, _, table in wholes], axis=1)
        rows = iter(own)
        wide = np.zeros(own.shape[1])
        p = [wide + n.start if n.known else next(rows) for n in self.system.numbers]
        start = [wide + s.start if s.known else next(rows) for s in self.system.states]
        return np.array(p).reshape(-1, len(wide)), np.array(start).reshape(-1, len(wide))

    def _puts(self, wholes: Sequence[tuple[Hypothesis, int, Array]], widths: Sequence[int]) -> list[Put]:
        """Every effect of any of the hypotheses, absent in the others."""
        effects = {e.name: e for h, _, _ in wholes for e in h.effects}
        numbers = {name: [np.full(sum(widths), q.none) for q in e.parameters] for name, e in effects.items()}
        at = 0
        for (h, _, table), width in zip(wholes, widths, strict=True):
            row = len(self._numbers) + len(self._free)
            for effect in h.effects:
                for own in numbers[effect.name]:
                    own[at : at + width] = table[row]
                    row += 1
            at += width
        return [Put(self._of_name(name), tuple(those)) for name, those in numbers.items()]

    def _of_name(self, name: str) -> Missing:
        return self.missing[name] if name in self.missing else self._free_missing[name]

    def _courses(
        self, run_of: Array, p: Array, start: Array, puts: Sequence[Put], share: float = 1.0, push: Array | None = None
    ) -> Array:
        """(samples, c, k); ``push`` (blocks, s, k) is added to the rates."""
        size = self.blocks[0].size
        most = max(len(self._runs[k].centre_s) for k in set(run_of.tolist()))
        blocks = max(int(np.ceil(share * most)), min(2, most))
        grid = Grid(self.blocks[0].record.step_s, blocks * size, self._inner, self.blocks[0].record.stays)
        inputs = self._inputs(grid)[:, :, run_of]
        pushed = None if push is None else lambda sample: push[min(sample // size, len(push) - 1)]
        seen = simulated(self.system, grid, start, inputs, p, puts, pushed)
        return np.clip(np.nan_to_num(seen, nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR)

    def _inputs(self, grid: Grid) -> Array:
        """(halves, m, runs)."""
        if grid not in self._held:
            found = []
            for blocks in self.blocks:
                own = blocks.record.inputs[: grid.count]
                own = np.concatenate([own, np.repeat(own[-1:], grid.count - len(own), axis=0)])
                found.append(held(own, grid))
            self._held[grid] = np.stack(found, axis=2)
        return self._held[grid]

    @cached_property
    def _held(self) -> dict[Grid, Array]:
        return {}

    def _of_blocks(self, index: int, seen: Array) -> Array:
        """(n, c, k) means of a run; NaN beyond what was simulated."""
        blocks = self.blocks[index]
        count = min(len(seen) // blocks.size, blocks.count)
        whole = seen[: count * blocks.size].reshape(count, blocks.size, *seen.shape[1:]).mean(axis=1)
        return np.concatenate([whole, np.full((blocks.count - count, *whole.shape[1:]), np.nan)])

    # sizes ----------------------------------------------------------------------------------------------------------

    def _scaled(self, h: Hypothesis) -> tuple[Scales, dict[str, float]]:
        """Sizes along a course, and usual random changes of the rates of equations that have physics."""
        state, rate, term, random = {}, {}, {}, {}
        turns: list[str] = []
        nothing = np.zeros((0, 1))
        states, rates, terms = (nothing, nothing, nothing) if self.system.whole else self._path(h)
        for k, one in enumerate(() if self.system.whole else self.system.states):
            state[one.name] = _large(states[k]) or usual_size(one.start, one.size)
            rate[one.name] = _large(rates[k])
            term[one.name] = max(rate[one.name], _large(terms[k]))
            if states[k].min() < -TURNS * state[one.name] and states[k].max() > TURNS * state[one.name]:
                turns.append(one.name)
            if one.name not in self.kinematic:
                random[one.name] = one.random if one.random is not None else USUAL_FORCE * rate[one.name]
        inputs = np.concatenate([blocks.record.inputs for blocks in self.blocks])
        outputs = np.concatenate([blocks.record.values for blocks in self.blocks])
        names = [(o.name, outputs[:, k]) for k, o in enumerate(self.system.outputs)]
        given = [(i.name, inputs[:, k]) for k, i in enumerate(self.system.inputs)]
        length_s = max(blocks.record.length_s for blocks in self.blocks)
        scales = Scales(
            state,
            rate,
            term,
            turns,
            {name: float(np.abs(v).max()) for name, v in given},
            {name: float(np.nanmax(np.abs(v))) for name, v in names},
            {name: float(np.nanstd(v)) or float(np.nanmax(np.abs(v))) for name, v in (*names, *given)},
            self.blocks[0].record.step_s,
            length_s,
        )
        return scales, random

    def _path(self, h: Hypothesis) -> tuple[Array, Array, Array]:
        """States, their rates, and the largest term of each rate (s, n) of all runs, one after the other.

        A number's term is what the rate changes by with it, times the number: what balances others is in no rate.
        """
        p, start = self._filled([(h, k, self._here(h, k)[:, None]) for k in range(len(self._runs))])
        most = max(blocks.count * blocks.size for blocks in self.blocks)
        grid = Grid(self.blocks[0].record.step_s, most, self._inner, self.blocks[0].record.stays)
        watched = _Watched(self.system)
        x = np.moveaxis(simulated(watched, grid, start, self._inputs(grid), p), 1, 0)
        u = np.moveaxis(self._inputs(grid)[:: 2 * self._inner], 0, 1)
        # beside the numbers themselves, each of them a little larger
        runs, ways = len(self._runs), 1 + len(p)
        table = np.tile(p, (1, ways))
        for k in range(len(p)):
            table[k, runs * (k + 1) : runs * (k + 2)] *= 1 + TERM_STEP
        with np.errstate(all="ignore"):
            every = np.array(
                [
                    self.system.derivatives(t, np.tile(x[:, k], (1, ways)), np.tile(u[:, k], (1, ways)), table)
                    for k, t in enumerate(grid.times_s)
                ]
            )
            every = np.moveaxis(every, 1, 0).reshape(len(x), len(grid.times_s), ways, runs)
            rates = every[:, :, 0]
            terms = np.nan_to_num(np.abs(every - every[:, :, :1]).max(axis=2) / TERM_STEP)
        found = []
        for part in (x, rates, terms):
            found.append(np.concatenate([part[:, : b.count * b.size, k] for k, b in enumerate(self.blocks)], axis=1))
        return found[0], found[1], found[2]

    # noise ----------------------------------------------------------------------------------------------------------

    def noise(self, hypothesis: Hypothesis) -> Noise:
        """Measurement noise, and slow random forces on every equation that has physics."""
        responses = self._responses(hypothesis)

        def measured(index: int, run: UsersRun) -> Measured:
            n, channels = run.values.shape
            good = np.isfinite(run.values)
            lag_s = np.abs(run.centre_s[:, None] - run.centre_s[None, :])
            keep = good.T.ravel().astype(float)[:, None]

            def roots(time: int) -> list[Array]:
                colour = force_colour(self.times_s[time], lag_s)
                found = [keep * (own[index] @ colour) for own in responses]
                nothing = np.zeros((n * channels, n))
                first, rest = found[:1] or [nothing], found[1:] or [nothing]
                return [first[0], np.concatenate(rest, axis=1)]

            return Measured(good, run.covariance, tuple(range(channels)), roots)

        return Noise([measured(index, run) for index, run in enumerate(self._runs)])

    def _responses(self, h: Hypothesis) -> list[list[Array]]:
        """Per equation and run (c n, n): outputs by a random force of the engine's unit size in each block.

        At PULSES times it is looked what a push does; between them it does what it does at both, each by its distance.
        """
        if not self._dynamic:
            # what shows no equation errs slowly in its outputs
            unit = [USUAL_FORCE * self.scales.moves[o.name] / FORCE_SD_N for o in self.system.outputs]
            return [[np.concatenate([one * np.eye(blocks.count) for one in unit]) for blocks in self.blocks]]
        count = [blocks.count for blocks in self.blocks]
        at = [np.unique(np.linspace(0, n - 1, min(PULSES, n)).astype(int)) for n in count]
        names = [s.name for s in self.system.states]
        wholes = [(h, k, self._here(h, k)[:, None]) for k in range(len(count))]
        widths = [1 + len(self._dynamic) * len(places) for places in at]
        run_of = np.repeat(np.arange(len(count)), widths)
        p, start = (a[:, run_of] for a in self._filled(wholes))
        push = np.zeros((max(count), len(names), len(run_of)))
        size = {s.name: PULSE * (self.scales.rate[s.name] or 1.0) for s in self._dynamic}
        column = 0
        for places, width in zip(at, widths, strict=True):
            own = column + 1
            for state in self._dynamic:
                push[places, names.index(state.name), own + np.arange(len(places))] = size[state.name]
                own += len(places)
            column += width
        puts = [replace(q, numbers=tuple(v[run_of] for v in q.numbers)) for q in self._puts(wholes, [1] * len(count))]
        seen = self._courses(run_of, p, start, puts, push=push)
        found: list[list[Array]] = [[] for _ in self._dynamic]
        column = 0
        for index, (places, width) in enumerate(zip(at, widths, strict=True)):
            values = self._of_blocks(index, seen[..., column : column + width])
            change = values[..., 1:] - values[..., :1]
            for k, state in enumerate(self._dynamic):
                own = change[..., k * len(places) : (k + 1) * len(places)] / size[state.name]
                unit = self.random[state.name] / FORCE_SD_N
                found[k].append(unit * _between(own, places))
            column += width
        return found

    # what the engine asks beyond a fit ------------------------------------------------------------------------------

    def as_quiet_as(self, inference: Inference, base: Fitted) -> Self:
        """Itself: the measurement's noise is as it was told."""
        return self

    def unlike(self, base: Fitted, best: Effect | None = None) -> list[Hypothesis]:
        """Effects that have hardly a slope where they are absent, begun where they are there; all of them at first."""
        if best is not None:
            return []
        found = []
        for effect in self.library:
            for numbers in self.missing[effect.name].begins:
                h = base.hypothesis
                found.append(replace(h, effects=(effect,), numbers=(np.array(numbers, dtype=float),)))
        return found

    def free_forms(self, shaken_hz: Sequence[float]) -> Sequence[Effect]:
        """What stands for something that is not offered: any function of a state, an input or an output."""
        return [m.effect(self.stage_of(m)) for m in self._free_missing.values()]

    def one_off(self, inference: Inference, base: Fitted) -> Sequence[Effect]:
        """None: of what acts once, nothing is known."""
        return ()

    def free_beside(self) -> Sequence[Effect]:
        """The same: an effect of the library that leaves something that goes with the motion is not all that is missing."""
        return self.free_forms(())

    @cached_property
    def _free_missing(self) -> Mapping[str, Missing]:
        return {m.name: m for m in free_forms(self.system, self.kinematic, self.scales)}


class _Watched:
    """A model whose outputs are its states."""

    def __init__(self, system: System) -> None:
        self.states, self.inputs, self.numbers = system.states, system.inputs, system.numbers
        self.name, self.whole = system.name, False
        self.outputs: Sequence[Output] = ()
        self.missing: Sequence[Missing] = ()
        self.built_in: Sequence[tuple[Missing, tuple[float, ...]]] = [
            one for one in system.built_in if one[0].equation or one[0].input
        ]
        self.derivatives, self.arguments, self.course = system.derivatives, system.arguments, system.course

    def seen(self, t: Array, x: Array, u: Array, p: Array) -> Array:
        """The states."""
        return x


def _parts(
    wholes: Sequence[tuple[Hypothesis, int, Array]], most: int
) -> Iterator[Sequence[tuple[Hypothesis, int, Array]]]:
    """In stretches of at most so many columns."""
    part: list[tuple[Hypothesis, int, Array]] = []
    width = 0
    for one in wholes:
        if part and width + one[2].shape[1] > most:
            yield part
            part, width = [], 0
        part.append(one)
        width += one[2].shape[1]
    if part:
        yield part


def _large(values: Array) -> float:
    size = float(np.percentile(np.abs(values[np.abs(values) < FAR]), LARGE)) if (np.abs(values) < FAR).any() else 0.0
    return size if np.isfinite(size) else 0.0


def _between(own: Array, places: Array) -> Array:
    """(c n, n) of the responses (n, c, places) to pushes at some blocks."""
    n, channels = own.shape[:2]
    answer = np.zeros((channels, n, n))
    for block in range(n):
        after = int(np.searchsorted(places, block))
        after = min(after, len(places) - 1)
        before = max(after - 1, 0) if places[after] != block else after
        gap = places[after] - places[before]
        share = (block - places[before]) / gap if gap else 0.0
        length = n - block
        for place, weight in ((before, 1 - share), (after, share)):
            if weight:
                course = own[places[place] :, :, place][:length]
                answer[:, block : block + len(course), block] += weight * course.T
    return answer.reshape(channels * n, n)


__all__ = ["Blocks", "OwnSimulator"]
