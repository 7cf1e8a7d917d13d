"""Inputs that the fit takes as exact: how far an error of theirs would move the quantities, by the model's own equations.

Each is perturbed by itself, with the records as they are, and the fit's gains turn the change of the response into one of the
derivatives. The line stands there with its sensitivity and is not included, until somebody says how well the input is known
(``Component.known``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array
from ..data import RunData
from ..joint.problem import OWN, Problem
from .components import INFINITE, Component
from .gains import Gains

STEP_REL = 1e-3
"""Of a perturbation, relative: its square, the error of a central difference, is 1e-6; a path's own is 1e-8 of the amplitude."""
STEP_M = 1e-3
"""The same of a tow point, m."""
TAKEN = "taken as exact: how well it is known is not stated"


@dataclass(frozen=True)
class Shape:
    """An exact input of the camera's side by what it does to the records.

    Attributes
    ----------
    source, name, unit : of the line
    data : of each run (n, 2), change of y m and beta rad with one unit more of what is stated; None: not this run's
    """

    source: str
    name: str
    unit: str
    data: tuple[Array | None, ...]


Change = Callable[[RunData, float], RunData]


def given_components(gains: Gains, shapes: Sequence[Shape], surge: bool) -> list[Component]:
    """Lines of what the fit takes as exact.

    Parameters
    ----------
    gains : of the fit
    shapes : inputs of the camera's side
    surge : the line keeps its length, so that the model's mass is in the equations
    """
    runs, priors = gains.runs, gains.runs[0].priors
    held = {c.name for c in gains.problem.commons if gains.problem.free[gains.problem.common_at[c.name]]}
    found: list[Component] = []

    def line(source: str, name: str, unit: str, moved: Array) -> None:
        nothing = np.zeros((len(moved), len(moved)))
        found.append(
            Component(
                source,
                name,
                "",
                "B",
                None,
                unit,
                moved,
                nothing,
                INFINITE,
                TAKEN,
                "not included",
            )
        )

    if "tension" not in held:
        moved = _by_own(gains, "tension", relative=True)
        line("tension gauge", "scale common to all runs", "1", moved)
    if "line_length" not in held:
        line("line length", "line_length_m", "m", _by_run(gains, _line_length, STEP_M))
    if "speed" not in held:
        line("speed", "speed_m_s", "m/s", _by_run(gains, _speed, STEP_REL * runs[0].tow.speed_m_s))
    if not priors.tow_point_sd_m:
        line("tow point", "tow_point_m, all runs", "m", _by_own(gains, "tow_point", relative=False))
    if surge and runs[0].mass_kg is not None:
        line("mass and inertia", "mass_kg", "kg", _by_run(gains, _mass, STEP_REL * runs[0].mass_kg))
    line("clock", "rate of the recording's clock", "1", _clock(gains))
    for shape in shapes:
        moved = gains.shift([None if d is None else d.T for d in shape.data])
        line(shape.source, shape.name, shape.unit, moved)
    return found


def absent(source: str, name: str, why: str, size: int) -> Component:
    """A line that says that a source is not in the budget, and why.

    Parameters
    ----------
    source, name : of the line
    why : in words
    size : number of quantities
    """
    return Component(source, name, "", "B", None, "", None, np.zeros((size, size)), INFINITE, why, "not included")


def _by_own(gains: Gains, what: str, relative: bool) -> Array:
    """By one unit more of a run's own number, in all runs together."""
    places = [gains.problem.own_at(i) + OWN.index(what) for i in range(len(gains.runs))]
    step = STEP_REL if relative else STEP_M
    ends = []
    for sign in (1, -1):
        theta = gains.theta.copy()
        theta[places] = theta[places] * (1 + sign * step) if relative else theta[places] + sign * step
        ends.append(_answered(gains, gains.problem, theta))
    return _moved(gains, ends, step)


def _by_run(gains: Gains, change: Change, step: float) -> Array:
    """By one unit more of what ``change`` puts into every run."""
    ends = []
    for sign in (1, -1):
        runs = [change(d, sign * step) for d in gains.runs]
        problem = Problem(runs, gains.problem.form, gains.problem.speed, path=gains.problem.path)
        ends.append(_answered(gains, problem, gains.theta))
    return _moved(gains, ends, step)


Ends = tuple[list[Array], list[Array | None]]


def _answered(gains: Gains, problem: Problem, theta: Array) -> Ends:
    if all(d.gauge is None for d in gains.runs):
        return problem.residuals(theta), [None] * len(gains.runs)
    answers = problem.evaluate(theta)
    return [a.residual for a in answers], [None if a.gauge is None else a.gauge[0] for a in answers]


def _moved(gains: Gains, ends: list[Ends], step: float) -> Array:
    (more, gauge_more), (less, gauge_less) = ends
    data = [(a - b) / (2 * step) for a, b in zip(more, less, strict=True)]
    gauges = [
        None if a is None or b is None else (a - b) / (2 * step) for a, b in zip(gauge_more, gauge_less, strict=True)
    ]
    return gains.shift(data, gauges)


def _line_length(data: RunData, by: float) -> RunData:
    return replace(data, tow=replace(data.tow, line_length_m=data.tow.line_length_m + by))


def _speed(data: RunData, by: float) -> RunData:
    return replace(data, tow=replace(data.tow, speed_m_s=data.tow.speed_m_s + by))


def _mass(data: RunData, by: float) -> RunData:
    return replace(data, mass_kg=(data.mass_kg or 0.0) + by)


def _clock(gains: Gains) -> Array:
    """A clock that runs fast by a share stamps a motion later, the later it is: the record changes by -t dy/dt."""
    data = []
    for run, answer in zip(gains.runs, gains.answers, strict=True):
        clock = run.t_s - run.t_s[0]
        data.append(-clock * np.gradient(answer.response, run.t_s, axis=1))
    return gains.shift(data)


__all__ = ["Shape", "absent", "given_components"]
