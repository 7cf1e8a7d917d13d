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
from ..start import start_state, weak_form_start
from .arrow import Arrow, Layout
from .full import Guess, full_paths
from .linear import linear_paths
from .parameters import LINE_LENGTH, RUN_PARAMETERS, SPEED, TENSION, TOW_POINT, side_from_y

OWN = ("side", "beta", "v", "r", "y_b", "beta_b", "tension", "tow_point")
"""Parameters of each run, in the order of the parameter vector."""


@dataclass(frozen=True)
class Answer:
    """One run at a parameter vector.

    Attributes
    ----------
    response, residual : (2, n), y and beta; residual = measured minus response
    slope : (2, k, n), change of the response with the parameters ``columns``
    columns : (k,), places in the parameter vector
    """

    response: Array
    residual: Array
    slope: Array
    columns: NDArray[np.int_]


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
    """

    def __init__(
        self,
        runs: list[RunData],
        form: str,
        speed_m_s: float,
        hold: tuple[int, ...] = (),
        extra: tuple[tuple[int, float, float], ...] = (),
    ) -> None:
        self.runs, self.form, self.speed = runs, form, speed_m_s
        self.hold, self.extra = hold, extra
        self.mode_count = {key: len(modes) for d in runs for key, modes in d.shared}
        self.own_end = 6 + len(OWN) * len(runs)
        self.common_sd = _common_sds(runs)
        self.common_at = {name: self.own_end + i for i, name in enumerate(self.common_sd)}
        offset = self.own_end + len(self.common_sd)
        self.size = offset + sum(self.mode_count.values())
        self.mode_at: dict[str, slice] = {}
        for key, count in self.mode_count.items():
            self.mode_at[key] = slice(offset, offset + count)
            offset += count
        self.pull = self._pull()
        k2 = next((p for d in runs if (p := d.priors.derivatives.k2_m2) is not None), None)
        self.gyration = None if k2 is None else (k2.value, k2.std)
        self.free = self._free()
        moving = set(range(10)) - set(hold)
        if any(d.priors.tension_sd_rel for d in runs) or "tension" in self.common_at:
            moving.add(TENSION)
        if any(d.priors.tow_point_sd_m for d in runs):
            moving.add(TOW_POINT)
        moving |= {at for name, at in (("line_length", LINE_LENGTH), ("speed", SPEED)) if name in self.common_at}
        self.wanted = tuple(sorted(moving))
        self._guess: Guess | None = None

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
        """The linear form's parameter vector for the full form: only the sides are other coordinates."""
        theta = theta.copy()
        for index, data in enumerate(self.runs):
            at = self.own_at(index)
            theta[at] = side_from_y("full", data, float(theta[at]), float(theta[at + 1]))
        return theta

    def run_values(self, theta: Array) -> Array:
        """(runs, 14), ``RUN_PARAMETERS``."""
        own = theta[6 : self.own_end].reshape(len(self.runs), len(OWN))
        stated = np.array([[d.tow.line_length_m, d.tow.speed_m_s] for d in self.runs])
        values = np.column_stack([np.tile(theta[:6], (len(self.runs), 1)), own[:, :4], own[:, 6:], stated])
        for name, at in self.common_at.items():
            values[:, RUN_PARAMETERS.index(name)] += theta[at] * self.common_sd[name]
        return values

    def evaluate(self, theta: Array) -> list[Answer]:
        """Every run at ``theta``; NaN responses where the motion cannot be."""
        values = self.run_values(theta)
        if self.form == "full":
            paths, guess = full_paths(self.runs, values, self.speed, self.wanted, self._guess)
            if np.isfinite(guess.path).all():
                self._guess = guess
        else:
            paths = linear_paths(self.runs, values, self.speed, self.wanted)
        return [self._answer(i, theta, *path) for i, path in enumerate(paths)]

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

    def _answer(self, index: int, theta: Array, response: Array, sensitivity: Array) -> Answer:
        data, own = self.runs[index], self.own_at(index)
        place = {p: k for k, p in enumerate(self.wanted)}
        columns = [p if p < 6 else own + p - 6 for p in self.wanted if p < 10]
        parts = [sensitivity[:, : len(columns)]]
        for p, at in ((TENSION, own + 6), (TOW_POINT, own + 7)):
            if self.free[at]:
                columns.append(at)
                parts.append(sensitivity[:, place[p], None])
        for name, at in self.common_at.items():
            columns.append(at)
            parts.append(sensitivity[:, place[RUN_PARAMETERS.index(name)], None] * self.common_sd[name][index])
        for channel in range(2):
            if self.free[own + 4 + channel]:
                columns.append(own + 4 + channel)
                ones = np.zeros((2, 1, response.shape[1]))
                ones[channel] = 1.0
                parts.append(ones)
        total = response + theta[own + 4 : own + 6, None]
        for key, shared in data.shared:
            at = self.mode_at[key]
            columns += range(at.start, at.stop)
            modes = shared.transpose(2, 0, 1)
            parts.append(modes)
            total = total + np.einsum("cmn,m->cn", modes, theta[at])
        slope = np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]
        residual = np.stack([data.y_m, data.beta_rad]) - total
        return Answer(total, residual, slope, np.array(columns))

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
            add(at + 6, data.tow.tension_n, priors.tension_sd_rel * data.tow.tension_n)
            add(at + 7, data.tow.tow_point_m, priors.tow_point_sd_m)
            add(at + 4, 0.0, priors.y_bias_sd_m)
            add(at + 5, 0.0, priors.beta_bias_sd_rad)
        for at, (stated, sd) in self._derivative_priors().items():
            add(at, stated, sd)
        for at, stated, sd in self.extra:
            add(at, stated, sd)
        for at in (*self.common_at.values(), *(i for s in self.mode_at.values() for i in range(s.start, s.stop))):
            add(at, 0.0, 1.0)
        return Pull(np.array(index, dtype=int), np.array(value), np.array(spread))

    def _free(self) -> NDArray[np.bool_]:
        free = np.ones(self.size, dtype=bool)
        free[list(self.hold)] = False
        for run, data in enumerate(self.runs):
            at, priors = self.own_at(run), data.priors
            free[at + 4] = priors.y_bias_sd_m != 0
            free[at + 5] = priors.beta_bias_sd_rad != 0
            free[at + 6] = bool(priors.tension_sd_rel)
            free[at + 7] = bool(priors.tow_point_sd_m)
        return free

    def _derivative_priors(self) -> dict[int, tuple[float, float]]:
        found: dict[int, tuple[float, float]] = {}
        for data in self.runs:
            for index, name in enumerate(DERIVATIVE_NAMES):
                prior = getattr(data.priors.derivatives, name)
                if prior is not None:
                    ratio = 1.0 if index < 2 else self.speed / data.tow.speed_m_s
                    found[index] = (prior.value * ratio, prior.std * ratio)
        return found


def _common_sds(runs: list[RunData]) -> dict[str, Array]:
    """Standard deviation (runs,) of each common error that the first run's priors let move, in the parameter's unit."""
    priors = runs[0].priors
    found = {}
    if priors.tension_common_sd_rel:
        found["tension"] = priors.tension_common_sd_rel * np.array([d.tow.tension_n for d in runs], dtype=float)
    if priors.line_length_sd_m:
        found["line_length"] = np.full(len(runs), priors.line_length_sd_m)
    if priors.speed_sd_rel:
        found["speed"] = priors.speed_sd_rel * np.array([d.tow.speed_m_s for d in runs])
    return found
