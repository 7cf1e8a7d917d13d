"""A scenario with effects: what ``towline diagnose --write-model`` saved, put into the simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..record.errors import InputError
from ..record.scenario import LawScenario, ScenarioFile
from ..simulate.model import (
    Array,
    ExtraForce,
    Hull,
    Taut,
    Tow,
    accelerated,
    full_state,
    full_y_cg,
    line_angle_rate,
    line_force,
)
from .effects import LIBRARY, Effect, Situation, on_line

MissingForce = Callable[..., tuple[Any, Any, Any]]
"""(t_s, state (4, ...), tow, duration_s, half_width_m) -> Y N, N N m, X N."""
TINY_N = 2.0**-100
"""Imaginary step of the tension: a derivative by it has no difference's error, a power of two no rounding."""


def effects_of(
    file: ScenarioFile | LawScenario, path: Path, library: Sequence[Effect] = LIBRARY
) -> list[tuple[Effect, Array]]:
    """Effects of a scenario's [[effect]] tables with their numbers.

    Parameters
    ----------
    file : the scenario as read, or a law's
    path : of it, for errors
    library : effects that it may name

    Raises
    ------
    InputError : an unknown name, form or number, or an effect that the simulator of motions has no place for
    """
    found = []
    for index, table in enumerate(file.effect):
        where = f"effect[{index}]"
        named = [e for e in library if e.name == table.name]
        if not named:
            known = ", ".join(sorted({e.name for e in library}))
            raise InputError(
                path,
                f"{where}.name",
                f"{table.name!r}; expected one of {known}, or one of your own with --effects FILE.py",
            )
        if table.form and table.form not in (forms := [e.variant for e in named]):
            known = ", ".join(repr(form) for form in forms if form)
            raise InputError(path, f"{where}.form", f"{table.form!r}; {table.name} has {known or 'one form only'}")
        formed = [e for e in named if e.variant == table.form] if table.form else named
        effect = next((e for e in formed if set(table.numbers) <= {p.name for p in e.parameters}), formed[0])
        works = effect.force, effect.ahead, effect.tension, effect.keeps, effect.coupling, effect.length, effect.offset
        if not any(works) and effect.observe is not None:
            raise InputError(
                path,
                f"{where}.name",
                f"{table.name!r} shows in the marks and does not move the model; take its table out of the scenario",
            )
        if not any(works) or effect.lag_s:
            raise InputError(
                path,
                f"{where}.name",
                f"{table.name!r} is no force of constant form; the simulator of motions has no place for it",
            )
        known = [p.name for p in effect.parameters]
        wrong = [key for key in table.numbers if key not in known]
        if wrong:
            raise InputError(path, f"{where}.numbers.{wrong[0]}", f"unknown; {table.name} has {', '.join(known)}")
        found.append((effect, np.array([table.numbers.get(p.name, p.none) for p in effect.parameters])))
    return found


def missing_force(effects: Sequence[tuple[Effect, Array]], length_pp_m: float, density_kg_m3: float) -> MissingForce:
    """Forces of effects as what a fit of the derivatives knows beforehand (``identify.data.Missing``).

    Parameters
    ----------
    effects : with their numbers; what they do beside ``force`` and ``ahead`` is not in it
    length_pp_m, density_kg_m3 : of model and water
    """

    def force(t_s, state, tow: Tow, duration_s, half_width_m):
        alpha, beta, v, r = state
        turning = line_angle_rate(tow, beta, v, r, np.cos(alpha + beta), tow.post_motion(t_s)[1])
        unknown = float("nan")
        s = Situation(
            t_s, full_y_cg(t_s, alpha, beta, tow), beta, v, r, alpha, tow.speed_m_s, tow.line_length_m, tow.tow_point_m,
            tow.resistance, turning, length_pp_m=length_pp_m, density_kg_m3=density_kg_m3, half_width_m=half_width_m,
            v_lag=v, r_lag=r, duration_s=duration_s, y_v=unknown, n_v=unknown, n_r=unknown, history=lambda _: 1.0,
        )  # fmt: skip
        side = moment = ahead = 0.0 * v
        for effect, n in effects:
            if effect.force is not None:
                one, two = effect.force(s, *n)
                side, moment = side + one, moment + two
            if effect.ahead is not None:
                ahead = ahead + effect.ahead(s, *n)
        return side, moment, ahead

    return force


def with_effects(
    hull: Hull, tow: Tow, effects: list[tuple[Effect, Array]], file: ScenarioFile
) -> tuple[Hull, Tow, ExtraForce | None]:
    """Hull, tow and added force of a simulation with effects.

    A line that keeps its length, and is the longer the harder it pulls (``Effect.length``), becomes a spring with its stiffness and
    length at the straight tow's pull. What changes its tension acts beyond what
    keeps its length, as in the diagnosis: the constraint answers a force, so that a force and a moment are put in whose answer is
    just that. The carriage's speed is taken as constant there.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : the run as the diagnosis sees it
    effects : with their numbers
    file : the scenario as read
    """
    pull = tow.tension_n if tow.tension_n is not None else float(tow.resistance_n or 0.0)
    for effect, n in effects:
        if effect.coupling is not None:
            y_rdot, n_vdot = effect.coupling(*n)
            hull = replace(hull, y_rdot=hull.y_rdot + float(y_rdot), n_vdot=hull.n_vdot + float(n_vdot))
        if effect.length is not None:
            stated = tow.line_length_m
            longer = float(effect.length(pull, stated, *n))
            gives = complex(effect.length(pull + 1j * TINY_N, stated, *n)).imag / TINY_N  # m/N, exact
            if tow.line == "surge" and gives > 0:
                tow = replace(tow, line_length_m=stated + (longer - gives * pull), stiffness_n_m=1 / gives)
            else:
                tow = replace(tow, line_length_m=stated + longer)
        if effect.offset is not None:
            tow = replace(tow, tow_point_offset_m=tow.tow_point_offset_m + float(effect.offset(*n)))
    pushing = [(e, n) for e, n in effects if e.force or e.ahead or e.tension or e.keeps]
    if not pushing:
        return hull, tow, None
    surging = any(e.ahead is not None for e, _ in pushing)
    here = hull.at_speed(tow.speed_m_s)
    width = file.water.tank_width_m

    def extra(t_s, y, beta, v, r, alpha):
        angle = alpha + beta
        turning = line_angle_rate(tow, beta, v, r, np.cos(angle))
        s = Situation(
            t_s, y, beta, v, r, alpha, tow.speed_m_s, tow.line_length_m, tow.tow_point_m, pull, turning,
            length_pp_m=file.model.length_pp_m, density_kg_m3=file.water.density_kg_m3,
            half_width_m=width / 2 if width else np.nan, v_lag=v, r_lag=r, duration_s=file.time.duration_s,
            y_v=here.y_v, n_v=here.n_v, n_r=here.n_r, history=lambda _: 1.0,
        )  # fmt: skip
        side, moment = _pushes(((e, n) for e, n in pushing if not e.by_pull), s)
        ahead = sum((effect.ahead(s, *n) for effect, n in pushing if effect.ahead is not None), start=0.0)
        by_pull = [(e, n) for e, n in pushing if e.by_pull]
        if by_pull:
            held = full_state(t_s, (alpha, beta, v, r), here, tow, lambda *_: (side, moment, ahead))
            one, two = _pushes(by_pull, on_line(s, held))
            side, moment = side + one, moment + two
        if not any(effect.tension is not None or effect.keeps is not None for effect, _ in pushing):
            return (side, moment, ahead) if surging else (side, moment)

        def answer(more_side: float, more_moment: float, tow: Tow = tow) -> Taut:
            return full_state(
                t_s, (alpha, beta, v, r), here, tow, lambda *_: (side + more_side, moment + more_moment, ahead)
            )

        plain = answer(0.0, 0.0)
        kept = sum(float(effect.keeps(*n)) for effect, n in pushing if effect.keeps is not None)
        tension = (1 - kept) * plain.tension_n + kept * pull
        at = replace(on_line(s, plain), tension_n=tension, beyond_n=tension - pull)
        change = sum(effect.tension(at, *n) for effect, n in pushing if effect.tension is not None)
        wanted = np.array(accelerated(here, *line_force(tow, change, np.sin(angle), np.cos(angle))))
        if kept:
            wanted = wanted + kept * (answer(0.0, 0.0, replace(tow, line="constant")).rates - plain.rates)[2:]
        by_force = np.stack([(answer(*one).rates - plain.rates)[2:] for one in np.eye(2)], axis=1)
        matrix, right = np.moveaxis(by_force, (0, 1), (-2, -1)), np.moveaxis(wanted, 0, -1)[..., None]
        more = np.linalg.solve(matrix, right)
        side, moment = side + more[..., 0, 0], moment + more[..., 1, 0]
        return (side, moment, ahead) if surging else (side, moment)

    return hull, tow, extra


def _pushes(effects: Iterable[tuple[Effect, Array]], s: Situation) -> tuple[Any, Any]:
    """Side force and moment of all effects together."""
    side: Any = 0.0
    moment: Any = 0.0
    for effect, n in effects:
        if effect.force is not None:
            one, two = effect.force(s, *n)
            side, moment = side + one, moment + two
    return side, moment
