"""The joint fit as a least-squares problem: parameter vector, residuals, sensitivities, priors.

Parameter vector: [six derivatives, own of each run, errors common to all runs, modes of each camera]. What its priors hold
fast is in the vector but not ``free``: it costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...record.priors import DERIVATIVE_NAMES
from ...simulate.model import Array
from ..data import RunData
from ..start import rudder_start, start_state, weak_form_start
from .arrow import Arrow, Layout
from .common import commons_of, needs_full
from .full import full_paths
from .gauge import gauge_blocks
from .guess import Guess, Path
from .linear import linear_paths
from .parameters import (
    COUNT,
    LINEAR_COUNT,
    N_DELTA,
    TENSION,
    TOW_POINT,
    Y_DELTA,
    side_from_y,
)

OWN = ("side", "beta", "v", "r", "y_b", "beta_b", "tension", "tow_point")
"""Parameters of each run, in the order of the parameter vector."""
USUAL_ADDED = 1.9
"""(m - Y_vdot)/m of a bare model, where the fit begins without any tension."""
GUESSED_SCATTER = 0.03
"""Of the guessed resistances of runs at unlike speeds: R ~ U^n with n known to 0.1."""


@dataclass(frozen=True)
class Answer:
    """One run at a parameter vector.

    Attributes
    ----------
    response, residual : (2, n), y and beta; residual = measured minus response
    slope : (2, k, n), change of the response with the parameters ``columns``
    columns : (k,), places in the parameter vector
    gauge : whitened residual (q,) and slope (k, q) of a load cell's block means; None: no history
    tension_n : (n,), T at the samples of a line that keeps its length; else None
    """

    response: Array
    residual: Array
    slope: Array
    columns: NDArray[np.int_]
    gauge: tuple[Array, Array] | None = None
    tension_n: Array | None = None


@dataclass(frozen=True)
class Pull:
    """Gaussian knowledge of single parameters beside the motion.

    Attributes
    ----------
    index : (k,), places in the parameter vector
    value, sd : (k,)
    """

    index: NDArray[np.int_]
    value: Array
    sd: Array

    def rows(self, theta: Array) -> tuple[Array, Array]:
        """(stated minus here)/sd, and 1/sd."""
        return (self.value - theta[self.index]) / self.sd, 1.0 / self.sd


class Problem:
    """Residuals and sensitivities of all runs at a parameter vector.

    Parameters
    ----------
    runs : to fit
    form : "linear" or "full"
    speed_m_s : at which the derivatives are quoted
    hold : derivatives (indices) that keep their start value
    extra : more knowledge of derivatives, (index, value, sd), beside the priors
    rough : paths of the full form by longer steps
    path : near which the full form's first path is looked for
    apart : what the runs share is held, and each run's own are looked for by themselves
    """

    def __init__(
        self,
        runs: list[RunData],
        form: str,
        speed_m_s: float,
        hold: tuple[int, ...] = (),
        extra: tuple[tuple[int, float, float], ...] = (),
        rough: bool = False,
        path: Path | None = None,
        apart: bool = False,
    ) -> None:
        self.runs, self.form, self.speed = runs, form, speed_m_s
        self.hold, self.extra, self.rough = hold, extra, rough
        self.mode_count = {key: len(modes) for d in runs for key, modes in d.shared}
        self.own_end = 6 + len(OWN) * len(runs)
        self.commons = commons_of(runs)
        self.common_at = {c.name: self.own_end + i for i, c in enumerate(self.commons)}
        self._moving = tuple(c for c in self.commons if form == "full" or not needs_full(c.name))
        self._gauges = [gauge_blocks(d) if form == "full" else None for d in runs]
        offset = self.own_end + len(self.commons)
        self.size = offset + sum(self.mode_count.values())
        self.mode_at: dict[str, slice] = {}
        for key, count in self.mode_count.items():
            self.mode_at[key] = slice(offset, offset + count)
            offset += count
        self.pull = self._pull()
        k2 = next((p for d in runs if (p := d.priors.derivatives.k2_m2) is not None), None)
        self.gyration = None if k2 is None else (k2.value, k2.std)
        self.free = self._free()
        if apart:
            self.free[self.layout.shared] = False
        self.wanted = self._wanted()
        self._guess = path

    @property
    def path(self) -> Path | None:
        """The last one found, near which another problem's may be looked for; None: none, and for the linear form."""
        return self._guess.path if isinstance(self._guess, Guess) else self._guess

    def own_at(self, run: int) -> int:
        """Where the run's own parameters begin."""
        return 6 + len(OWN) * run

    def start(self) -> Array:
        """A parameter vector without any guess: the weak form, and quadratics through the records' first part."""
        return self.from_six(weak_form_start(self.runs, self.speed))

    def from_six(self, six: Array) -> Array:
        """A parameter vector with these derivatives."""
        theta = np.zeros(self.size)
        theta[:6] = six
        for index, data in enumerate(self.runs):
            y, beta, v, r = start_state(data)
            side = side_from_y(self.form, data, y, beta)
            at = self.own_at(index)
            theta[at : at + len(OWN)] = [side, beta, v, r, 0, 0, data.tow.tension_n, data.tow.tow_point_m]
        return theta

    def sides_to_full(self, theta: Array) -> Array:
        """The linear form's parameter vector with the sides in the full form's coordinates."""
        theta = theta.copy()
        for index, data in enumerate(self.runs):
            at = self.own_at(index)
            theta[at] = side_from_y("full", data, float(theta[at]), float(theta[at + 1]))
        return theta

    def from_linear(self, theta: Array) -> Array:
        """The linear form's parameter vector for this full form.

        The sides are other coordinates; rudder forces begin where they hold the model at its mean angles; where no tension is
        stated the model's mass sets the scale.
        """
        theta = self.sides_to_full(theta)
        rudder = dict(zip((Y_DELTA, N_DELTA), rudder_start(self.runs, theta[:6], self.speed), strict=True))
        for common in self._moving:
            at = self.common_at[common.name]
            if common.place in rudder and not common.base.any():
                theta[at] = rudder[common.place] / common.sd[0]
                for index in (i for i, d in enumerate(self.runs) if d.steered):
                    bias = slice(self.own_at(index) + 4, self.own_at(index) + 6)
                    theta[bias] = 0.0
            if common.factor and not common.known and self.runs[0].mass_kg is not None:
                factor = float(np.clip(USUAL_ADDED * self.runs[0].mass_kg / theta[0], 0.3, 3.0))
                if not self.hold:
                    theta[:6] *= factor
                theta[at] += np.log(factor) / common.sd[0]
        return theta

    def run_values(self, theta: Array) -> Array:
        """(runs, ``COUNT``), ``RUN_PARAMETERS``."""
        runs = len(self.runs)
        own = theta[6 : self.own_end].reshape(runs, len(OWN))
        stated = np.array([[d.tow.line_length_m, d.tow.speed_m_s] for d in self.runs])
        parts = [np.tile(theta[:6], (runs, 1)), own[:, :4], own[:, 6:], stated]
        values = np.zeros((runs, COUNT))
        values[:, :LINEAR_COUNT] = np.column_stack(parts)
        for common in self._moving:
            common.put(values, theta[self.common_at[common.name]])
        return values

    def evaluate(self, theta: Array) -> list[Answer]:
        """Every run at ``theta``; NaN responses where the motion cannot be."""
        values = self.run_values(theta)
        guess = None
        if self.form == "full":
            paths, guess = full_paths(self.runs, values, self.speed, self.wanted, self._guess, self.rough)
            if np.isfinite(guess.states).all():
                self._guess = guess
        else:
            paths = linear_paths(self.runs, values, self.speed, self.wanted)
        return [self._answer(i, theta, values, guess, *path) for i, path in enumerate(paths)]

    def residuals(self, theta: Array) -> list[Array]:
        """What ``evaluate`` leaves, (2, n) of every run, without its slopes."""
        values = self.run_values(theta)
        if self.form == "full":
            paths, guess = full_paths(self.runs, values, self.speed, (), self._guess, self.rough)
            if self._guess is None and np.isfinite(guess.states).all():
                self._guess = guess
        else:
            paths = linear_paths(self.runs, values, self.speed, ())
        return [
            _measured(d) - self._seen(i, theta, path)
            for i, (d, (path, _)) in enumerate(zip(self.runs, paths, strict=True))
        ]

    def _seen(self, index: int, theta: Array, path: Array) -> Array:
        """``path`` (2, n) of a run with its biases and common modes."""
        own = self.own_at(index)
        seen = path + theta[own + 4 : own + 6, None]
        for key, shared in self.runs[index].shared:
            seen = seen + np.einsum("cmn,m->cn", shared.transpose(2, 0, 1), theta[self.mode_at[key]])
        return seen

    @property
    def layout(self) -> Layout:
        """Where each run's own parameters stand."""
        return Layout(6, len(OWN), len(self.runs), self.size)

    def prior(self, theta: Array) -> tuple[Arrow, Array, float]:
        """Normal matrix, gradient and chi-square of what is known beside the motion."""
        matrix, gradient = Arrow.zeros(self.layout), np.zeros(self.size)
        gap, slope = self.pull.rows(theta)
        at = self.pull.index
        matrix.add_diagonal(at, slope**2)
        np.add.at(gradient, at, slope * gap)
        cost = float(gap @ gap)
        if self.gyration is not None:
            k2, sd = self.gyration
            row = np.array([-theta[1] / theta[0], 1.0]) / theta[0] / sd
            short = (k2 - theta[1] / theta[0]) / sd
            matrix.shared[:2, :2] += np.outer(row, row)
            gradient[:2] += row * short
            cost += short**2
        return matrix, gradient, float(cost)

    def _answer(
        self, index: int, theta: Array, values: Array, guess: Guess | None, path: Array, sensitivity: Array
    ) -> Answer:
        data, own = self.runs[index], self.own_at(index)
        columns, parts = self._chained(index, theta, values, sensitivity)
        count = len(columns)
        for channel in range(2):
            if self.free[own + 4 + channel]:
                columns.append(own + 4 + channel)
                ones = np.zeros((2, 1, path.shape[1]))
                ones[channel] = 1.0
                parts.append(ones)
        for key, shared in data.shared:
            at = self.mode_at[key]
            columns += range(at.start, at.stop)
            parts.append(shared.transpose(2, 0, 1))
        slope = np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]
        response = self._seen(index, theta, path)
        gauge = tension = None
        if guess is not None and guess.tension is not None and data.tow.line == "surge":
            tension = guess.tension_at(index, data.t_s - data.t_s[0])[0]
            gauge = self._gauge(index, theta, values, guess, count, len(columns))
        return Answer(response, _measured(data) - response, slope, np.array(columns), gauge, tension)

    def _chained(self, index: int, theta: Array, values: Array, sensitivity: Array) -> tuple[list[int], list[Array]]:
        """Places in the parameter vector and slopes (channels, k, n) of what moves the motion, from those of ``wanted``."""
        own = self.own_at(index)
        place = {p: k for k, p in enumerate(self.wanted)}
        columns = [p if p < 6 else own + p - 6 for p in self.wanted if p < 10]
        parts = [sensitivity[:, : len(columns)]]
        if self.free[own + 6]:
            columns.append(own + 6)
            # a common factor stands on the run's own tension
            parts.append(sensitivity[:, place[TENSION], None] * (values[index, TENSION] / theta[own + 6]))
        if self.free[own + 7]:
            columns.append(own + 7)
            parts.append(sensitivity[:, place[TOW_POINT], None])
        for common in self._moving:
            if self.free[self.common_at[common.name]]:
                columns.append(self.common_at[common.name])
                parts.append(sensitivity[:, place[common.place], None] * common.slope(values)[index])
        return columns, parts

    def _gauge(
        self, index: int, theta: Array, values: Array, guess: Guess, count: int, width: int
    ) -> tuple[Array, Array] | None:
        """What the load cell leaves, whitened, and its slope over the run's columns.

        The cell reads T over the factor by which all tensions are wrong together.
        """
        blocks = self._gauges[index]
        if blocks is None:
            return None
        tension, moved = guess.tension_at(index, blocks.t_s)
        columns, parts = self._chained(index, theta, values, moved[None])
        slope = np.concatenate(parts, axis=1)[0]
        factor = 1.0
        scale = next((c for c in self._moving if c.factor), None)
        if scale is not None:
            at = self.common_at[scale.name]
            factor = float(np.exp(-theta[at] * scale.sd[index]))
            if at in columns:
                slope[columns.index(at)] -= tension * scale.sd[index]
        whole = np.zeros((width, len(tension)))
        whole[:count] = slope * factor
        return blocks.white @ (blocks.tension_n - tension * factor), whole @ blocks.white.T

    def _pull(self) -> Pull:
        index: list[int] = []
        value: list[float] = []
        spread: list[float] = []

        def add(at: int, stated: float, sd: float | None) -> None:
            if sd:
                index.append(at)
                value.append(stated)
                spread.append(sd)

        for run, data in enumerate(self.runs):
            at, priors = self.own_at(run), data.priors
            assert data.tow.tension_n is not None
            if self._tension_known(data):
                add(at + 6, data.tow.tension_n, self._tension_scatter(data) * data.tow.tension_n)
            add(at + 7, data.tow.tow_point_m, priors.tow_point_sd_m)
            add(at + 4, 0.0, priors.y_bias_sd_m)
            add(at + 5, 0.0, priors.beta_bias_sd_rad)
        for at, (stated, sd) in self._derivative_priors().items():
            add(at, stated, sd)
        for at, stated, sd in self.extra:
            add(at, stated, sd)
        common = (self.common_at[c.name] for c in self.commons if c.known)
        for at in (*common, *(i for s in self.mode_at.values() for i in range(s.start, s.stop))):
            add(at, 0.0, 1.0)
        return Pull(np.array(index, dtype=int), np.array(value), np.array(spread))

    def _free(self) -> NDArray[np.bool_]:
        free = np.ones(self.size, dtype=bool)
        free[list(self.hold)] = False
        for run, data in enumerate(self.runs):
            at, priors = self.own_at(run), data.priors
            free[at + 4] = priors.y_bias_sd_m != 0
            free[at + 5] = priors.beta_bias_sd_rad != 0
            free[at + 6] = bool(self._tension_scatter(data)) or not self._tension_known(data)
            free[at + 7] = bool(priors.tow_point_sd_m)
        for common in self.commons:
            free[self.common_at[common.name]] = common in self._moving and bool(common.sd.any())
        return free

    def _wanted(self) -> tuple[int, ...]:
        """The runs' parameters whose sensitivities are asked for, rising."""
        wanted = {*np.flatnonzero(self.free[:6]).tolist(), *range(6, 10)}
        wanted |= {c.place for c in self._moving if self.free[self.common_at[c.name]]}
        if any(self.free[self.own_at(i) + 6] for i in range(len(self.runs))):
            wanted.add(TENSION)
        if any(d.priors.tow_point_sd_m for d in self.runs):
            wanted.add(TOW_POINT)
        return tuple(sorted(wanted))

    def _tension_known(self, data: RunData) -> bool:
        """Its own tension has a prior: it is stated, or a guess like every other run's."""
        if data.gauge is not None and self.form == "full":
            return False
        return data.tension_stated or not any(d.tension_stated for d in self.runs)

    def _tension_scatter(self, data: RunData) -> float:
        """Relative scatter of R about what is stated, or about the guess: guessed from run to run it follows the speed only."""
        if data.tension_stated or len({d.tow.speed_m_s for d in self.runs}) == 1:
            return data.priors.tension_sd_rel
        return max(data.priors.tension_sd_rel, GUESSED_SCATTER)

    def _derivative_priors(self) -> dict[int, tuple[float, float]]:
        found: dict[int, tuple[float, float]] = {}
        for data in self.runs:
            for index, name in enumerate(DERIVATIVE_NAMES):
                prior = getattr(data.priors.derivatives, name)
                if prior is not None:
                    ratio = 1.0 if index < 2 else self.speed / data.tow.speed_m_s
                    found[index] = (prior.value * ratio, prior.std * ratio)
        return found


def _measured(data: RunData) -> Array:
    return np.stack([data.y_m, data.beta_rad])
