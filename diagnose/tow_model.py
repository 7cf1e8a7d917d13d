"""The simulator as the diagnosis uses it: all runs and all variations of all hypotheses in one integration, side by side.

The equations are ``simulate.model``'s; effects add to them. Columns of the arrays are variations: a hypothesis as it stands, and
with each of its numbers moved a little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..simulate.model import Array, Hull, Tow, full_rates, full_x_cg, full_y_cg, line_angle_rate
from .effects import Effect, Seen, Situation
from .tow_data import TowRun, corrected

OWN = ("alpha", "beta", "v", "r", "y_b", "beta_b", "tension", "tow_point", "line", "speed")
"""Each run's own numbers."""
STEPS = {"alpha": 1e-5, "beta": 1e-5, "v": 1e-5, "r": 1e-5, "y_b": 1e-4, "beta_b": 1e-4}
RELATIVE_STEP = 1e-4
EFFECT_STEP = 0.02
"""Of an effect's prior standard deviation."""
LARGEST_ANGLE = 1.4
SMALLEST_COSINE = 0.05
BLOW_UP = 1e3


@dataclass(frozen=True)
class Active:
    """An effect in the columns where it is not absent.

    Attributes
    ----------
    effect : which
    columns : of all
    numbers : (p, columns)
    """

    effect: Effect
    columns: slice
    numbers: Array


@dataclass(frozen=True)
class Hypothesis:
    """The simulator with some effects.

    Attributes
    ----------
    six : (6,) linear derivatives at the reference speed
    own : (runs, 10), OWN
    effects : which
    numbers : per effect (p,)
    """

    six: Array
    own: Array
    effects: tuple[Effect, ...] = ()
    numbers: tuple[Array, ...] = ()

    @property
    def size(self) -> int:
        """Numbers of all its effects together."""
        return sum(len(n) for n in self.numbers)


class TowModel:
    """All runs of a campaign.

    Parameters
    ----------
    runs : with one block length
    speed_m_s : at which derivatives are quoted
    """

    def __init__(self, runs: Sequence[TowRun], speed_m_s: float) -> None:
        self.runs, self.speed_m_s = list(runs), speed_m_s
        self.step_s = runs[0].step_s
        self._corrections: dict[tuple, Array] = {}
        self.count = max(len(r.centre_s) for r in runs)
        tows = [r.data.tow for r in runs]
        self.stated = np.array(
            [[t.line_length_m, t.tow_point_m, t.speed_m_s, t.tow_point_offset_m, t.post_m[0]] for t in tows],
            dtype=float,
        )

    def field(self, name: str) -> Array:
        """A number of every run, (runs, 1)."""
        return np.array([getattr(r, name) for r in self.runs], dtype=float)[:, None]

    # the measured side ------------------------------------------------------------------------------------------------

    def measured(self, hypothesis: Hypothesis) -> list[Array]:
        """Values of every run (n, 4), with the hypothesis's camera faults taken out."""
        answers = []
        for tow in self.runs:
            values = tow.values
            for effect, numbers in zip(hypothesis.effects, hypothesis.numbers, strict=True):
                if effect.correct is not None and numbers.any():
                    values = values + self._correction(tow, effect, numbers)
            answers.append(values)
        return answers

    def _correction(self, tow: TowRun, effect: Effect, numbers: Array) -> Array:
        """Change of the values (n, 4) when the fault is taken out."""
        assert effect.correct is not None
        key = (tow.name, effect.label, numbers.tobytes())
        if key not in self._corrections:
            if tow.marks is None:
                # a motion can only be shifted: the post is all that is stated of its geometry
                change = np.zeros_like(tow.values)
                if effect.name == "datum_bias":
                    change[:, 0] = -numbers[1]
            else:
                change = corrected(tow, *effect.correct(tow.marks.run, tow.marks.fit, *numbers))
            self._corrections[key] = change
        return self._corrections[key]

    # the simulated side -----------------------------------------------------------------------------------------------

    def linear(self, hypotheses: Sequence[Hypothesis]) -> list[list[tuple[Array, Array]]]:
        """Per hypothesis and run: residual (n, 4) and slopes (n, 4, 6 + 10 + p) of the simulation by six, own, effects.

        A camera fault moves the measured side: its slope is the change of the values when it is taken out, negative.
        """
        columns = [1 + 6 + len(OWN) + h.size for h in hypotheses]
        starts = np.concatenate([[0], np.cumsum(columns)])
        six, own, active, steps = self._stack(hypotheses, starts)
        answers = self.simulate(six, own, active)
        result = []
        for index, hypothesis in enumerate(hypotheses):
            first = starts[index]
            measured = self.measured(hypothesis)
            rows = []
            for i, tow in enumerate(self.runs):
                n = len(tow.centre_s)
                base = answers[i][:n, :, first]
                slope = answers[i][:n, :, first + 1 : starts[index + 1]] - base[..., None]
                slope = slope / steps[index][i]
                self._camera_slopes(hypothesis, tow, slope)
                rows.append((measured[i] - base, slope))
            result.append(rows)
        return result

    def _camera_slopes(self, hypothesis: Hypothesis, tow: TowRun, slope: Array) -> None:
        at = 6 + len(OWN)
        for effect, numbers in zip(hypothesis.effects, hypothesis.numbers, strict=True):
            if effect.correct is not None:
                here = self._correction(tow, effect, numbers) if numbers.any() else 0.0
                for k, parameter in enumerate(effect.parameters):
                    step = EFFECT_STEP * parameter.sd
                    moved = numbers.copy()
                    moved[k] += step
                    slope[:, :, at + k] = -(self._correction(tow, effect, moved) - here) / step
            at += len(numbers)

    def _stack(self, hypotheses: Sequence[Hypothesis], starts: Array):
        """All hypotheses' variations as columns, and the steps (per hypothesis and run) between them."""
        width, runs = int(starts[-1]), len(self.runs)
        six, own = np.empty((6, width)), np.empty((runs, len(OWN), width))
        active: list[Active] = []
        steps = []
        for hypothesis, first, last in zip(hypotheses, starts[:-1], starts[1:], strict=True):
            six[:, first:last] = hypothesis.six[:, None]
            own[:, :, first:last] = hypothesis.own[:, :, None]
            step = np.ones((runs, last - first - 1))
            for k in range(6):
                step[:, k] = RELATIVE_STEP * max(abs(hypothesis.six[k]), 1.0)
                six[k, first + 1 + k] += step[0, k]
            for k, name in enumerate(OWN):
                size = np.full(runs, STEPS[name]) if name in STEPS else RELATIVE_STEP * np.abs(hypothesis.own[:, k])
                step[:, 6 + k] = size
                own[:, k, first + 7 + k] += size
            at = int(first) + 7 + len(OWN)
            for effect, numbers in zip(hypothesis.effects, hypothesis.numbers, strict=True):
                none = np.array([p.none for p in effect.parameters])
                moved = slice(at, at + len(numbers))
                # an effect that is absent works only where it is moved
                columns = moved if (numbers == none).all() else slice(int(first), int(last))
                table = np.tile(numbers[:, None], (1, columns.stop - columns.start))
                for k, parameter in enumerate(effect.parameters):
                    step[:, at - first - 1 + k] = EFFECT_STEP * parameter.sd
                    table[k, at - columns.start + k] += EFFECT_STEP * parameter.sd
                if effect.correct is None:
                    active.append(Active(effect, columns, table))
                at += len(numbers)
            steps.append(step)
        return six, own, active, steps

    def simulate(self, six: Array, own: Array, active: Sequence[Active]) -> list[Array]:
        """What would be measured.

        Parameters
        ----------
        six : (6, columns); own : (runs, 10, columns)
        active : effects

        Returns
        -------
        per run (n, 4, columns)
        """
        path, rates, tow = self._integrate(six, own, active)
        half = self.step_s / 2
        t_s = (np.arange(len(path)) * half)[:, None, None]
        seen = self._seen(t_s, path, rates, tow)
        x, y, beta = seen.pose
        more = np.zeros((4, *y.shape))
        for a in active:
            if a.effect.stretch is None and a.effect.observe is None:
                continue
            here = _columns(seen, a.columns)
            if a.effect.stretch is not None:
                longer = a.effect.stretch(here, *a.numbers)
                more[0][..., a.columns] -= longer * np.cos(here.alpha_rad)
                more[1][..., a.columns] += longer * np.sin(here.alpha_rad)
            if a.effect.observe is not None:
                for channel, change in enumerate(a.effect.observe(here, *a.numbers)):
                    more[channel][..., a.columns] += change
        x, y, beta = x + more[0], y + more[1] + own[:, 4], beta + more[2] + own[:, 5]
        series = np.stack([y, beta, self._line(x, y, beta), more[3]], axis=1)  # (nodes, 4, runs, columns)
        late = [(a, a.effect.clock(t_s[:-2:2, 0] + half, *a.numbers)) for a in active if a.effect.clock is not None]
        answers = []
        for i, run in enumerate(self.runs):
            n = len(run.centre_s)
            begin, middle, end = (series[k : k + 2 * n : 2, :, i] for k in (0, 1, 2))
            total = np.tile((run.centre_s - (np.arange(n) + 0.5) * self.step_s)[:, None], (1, y.shape[2]))
            for a, shift in late:
                total[:, a.columns] += shift[:n]
            answers.append((begin + 4 * middle + end) / 6 + (end - begin) / self.step_s * total[:, None])
        return answers

    def _line(self, x: Array, y: Array, beta: Array) -> Array:
        """Radius of the stated tow point about the stated post, minus the stated length."""
        x_t, y_t, post, length = (self.stated[:, k, None] for k in (1, 3, 4, 0))
        cosine, sine = np.cos(beta), np.sin(beta)
        return np.hypot(x + x_t * cosine - y_t * sine - post, y + x_t * sine + y_t * cosine) - length

    def _seen(self, t_s: Array, path: Array, rates: Array, tow: Any) -> Seen:
        alpha, beta = path[:, 0], path[:, 1]
        x, y = full_x_cg(alpha, beta, tow), full_y_cg(0.0, alpha, beta, tow)
        half = self.step_s / 2
        x_rate, y_rate = np.gradient(x, half, axis=0), np.gradient(y, half, axis=0)
        shutter = np.zeros((len(path), len(self.runs), 4, 3))
        for i, run in enumerate(self.runs):
            nodes = np.clip((np.arange(len(path)) - 1) // 2, 0, len(run.shutter) - 1)
            shutter[:, i] = np.nan_to_num(run.shutter[nodes])
        return Seen(
            t_s, (x, y, beta), (x_rate, y_rate, rates[:, 1]), np.sin(alpha + beta), alpha, tow.tension_n, shutter
        )

    def _integrate(self, six: Array, own: Array, active: Sequence[Active]):
        """Classical Runge-Kutta over half blocks: path and rates (nodes, states, runs, columns)."""
        column = {name: own[:, k] for k, name in enumerate(OWN)}
        # the equations broadcast: their fields are arrays here
        hull_of: Any = Hull
        tow_of: Any = Tow
        coupled = [a for a in active if a.effect.coupling is not None]
        y_rdot: Any = np.zeros((1, six.shape[1])) if coupled else 0.0
        n_vdot: Any = np.zeros((1, six.shape[1])) if coupled else 0.0
        for a in coupled:
            assert a.effect.coupling is not None
            one, two = a.effect.coupling(*a.numbers)
            y_rdot[0, a.columns] += one
            n_vdot[0, a.columns] += two
        reference = hull_of(*(s[None] for s in six), speed_m_s=self.speed_m_s, y_rdot=y_rdot, n_vdot=n_vdot)
        line, offset = column["line"].copy(), np.tile(self.stated[:, 3, None], (1, six.shape[1]))
        for a in active:
            if a.effect.length is not None:
                line[:, a.columns] += a.effect.length(column["tension"][:, a.columns], *a.numbers)
            if a.effect.offset is not None:
                offset[:, a.columns] += a.effect.offset(*a.numbers)
        tow = tow_of(
            column["speed"],
            line,
            column["tow_point"],
            column["tension"],
            tow_point_offset_m=offset,
            post_m=(self.stated[:, 4, None], 0.0),
        )
        hull = reference.at_speed(column["speed"])
        lags = sorted({a.effect.lag_s for a in active if a.effect.lag_s})
        rates = self._rates(reference, hull, tow, active, lags)
        start = [column[name] for name in ("alpha", "beta", "v", "r")]
        state = np.stack(start + [column[name] for _ in lags for name in ("v", "r")])
        half, nodes = self.step_s / 2, 2 * self.count + 1
        path = np.empty((nodes, *state.shape))
        slope = np.empty_like(path)
        with np.errstate(all="ignore"):
            for k in range(nodes):
                t = k * half
                k1 = rates(t, state)
                path[k], slope[k] = state, k1
                k2 = rates(t + half / 2, state + half / 2 * k1)
                k3 = rates(t + half / 2, state + half / 2 * k2)
                k4 = rates(t + half, state + half * k3)
                state = np.clip(state + half / 6 * (k1 + 2 * k2 + 2 * k3 + k4), -BLOW_UP, BLOW_UP)
        return path, slope, tow

    def _rates(
        self, reference: Any, hull: Any, tow: Any, active: Sequence[Active], lags: list[float]
    ) -> Callable[[float, Array], Array]:
        pushing = [a for a in active if a.effect.force is not None or a.effect.tension is not None]
        speeding = [a for a in active if a.effect.speed is not None]
        histories = [r.data.tension for r in self.runs]
        means = [float(r.data.tow.tension_n or 1.0) for r in self.runs]

        def history(t_s):
            if not any(h is not None for h in histories):
                return np.ones((len(histories), 1))
            rows = [
                np.interp(np.asarray(t_s) + run.start_s, *h) / m if h is not None else 1.0 + 0.0 * np.asarray(t_s)
                for run, h, m in zip(self.runs, histories, means, strict=True)
            ]
            return np.array([np.broadcast_to(row, (1,)) if np.ndim(row) == 0 else np.atleast_1d(row) for row in rows])

        loaded = any(h is not None for h in histories)
        fixed = {
            "length_pp_m": self.field("length_pp_m"),
            "density_kg_m3": self.field("density_kg_m3"),
            "half_width_m": self.field("half_width_m"),
            "duration_s": np.array([[len(r.centre_s) * self.step_s] for r in self.runs]),
        }

        def situation(t, y, beta, v, r, alpha, here: Any, tow: Any, lagged) -> Situation:
            cosine = np.clip(np.cos(alpha + beta), SMALLEST_COSINE, None)
            return Situation(
                t, y, beta, v, r, alpha, tow.speed_m_s, tow.line_length_m, tow.tow_point_m, tow.tension_n,
                line_angle_rate(tow, beta, v, r, cosine),
                v_lag=lagged[0], r_lag=lagged[1], y_v=here.y_v, n_v=here.n_v, n_r=here.n_r, history=history, **fixed,
            )  # fmt: skip

        offset = tow.tow_point_offset_m

        def rates(t: float, state: Array) -> Array:
            here, now = hull, tow
            if loaded:
                now = replace(now, tension_n=tow.tension_n * history(t))
            alpha, beta = (np.clip(state[k], -LARGEST_ANGLE, LARGEST_ANGLE) for k in (0, 1))
            beta = np.clip(beta, -LARGEST_ANGLE - alpha, LARGEST_ANGLE - alpha)
            v, r = state[2], state[3]
            if speeding:
                base = situation(t, 0.0 * v, beta, v, r, alpha, here, now, (v, r))
                speed = now.speed_m_s + 0.0 * v
                for a in speeding:
                    assert a.effect.speed is not None
                    speed[:, a.columns] += a.effect.speed(_columns(base, a.columns), *a.numbers)
                here, now = reference.at_speed(speed), replace(now, speed_m_s=speed)

            def extra(t, y, beta, v, r, alpha):
                side, moment = np.zeros_like(v), np.zeros_like(v)
                base = situation(t, y, beta, v, r, alpha, here, now, (v, r))
                parts: dict[tuple[int, int, float], Situation] = {}
                for a in pushing:
                    key = (a.columns.start, a.columns.stop, a.effect.lag_s)
                    if key not in parts:
                        at = base
                        if a.effect.lag_s:
                            k = 4 + 2 * lags.index(a.effect.lag_s)
                            at = replace(base, v_lag=state[k], r_lag=state[k + 1])
                        parts[key] = _columns(at, a.columns)
                    at = parts[key]
                    if a.effect.force is not None:
                        one, two = a.effect.force(at, *a.numbers)
                        side[:, a.columns] += one
                        moment[:, a.columns] += two
                    if a.effect.tension is not None:
                        change = a.effect.tension(at, *a.numbers)
                        angle = at.alpha_rad + at.beta_rad
                        sine, cosine = np.sin(angle), np.cos(angle)
                        side[:, a.columns] -= change * sine
                        moment[:, a.columns] -= change * (at.tow_point_m * sine + offset[:, a.columns] * cosine)
                return side, moment

            core = full_rates(t, (alpha, beta, v, r), here, now, extra if pushing else None)
            if not lags:
                return core
            more = [
                (state[source] - state[4 + 2 * i + j]) / lag
                for i, lag in enumerate(lags)
                for j, source in ((0, 2), (1, 3))
            ]
            return np.concatenate([core, np.stack(more)])

        return rates


def _columns(whole: Any, columns: slice) -> Any:
    """A dataclass of arrays that broadcast to (..., columns), restricted to some."""
    changes = {}
    for name, value in whole.__dict__.items():
        if isinstance(value, np.ndarray):
            if value.ndim > 1 and value.shape[-1] > 1 and name != "shutter":
                changes[name] = value[..., columns]
        elif isinstance(value, tuple) and all(isinstance(v, np.ndarray) and v.shape[-1] > 1 for v in value):
            changes[name] = tuple(v[..., columns] for v in value)
    part = object.__new__(type(whole))
    part.__dict__.update(whole.__dict__)
    part.__dict__.update(changes)
    return part
