"""The section of a missing law: what it says, how sure, and the force against its variable with its band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING

import numpy as np

from ..diagnose.law.answer import Field, Law, Searched
from ..diagnose.law.field import basis_of
from ..diagnose.law.functions import State, term
from ..diagnose.law.terms import AHEAD, HEEL, parts_of, text_of
from ..diagnose.sizes import size_of
from ..diagnose.tow.towed import TowSimulator
from ..simulate.model import GRAVITY_M_S2
from .draw import BLUE, GREY, VERMILION, Columns, label, new_figure, svg_image
from .html import Html, bullets, figure, join, number, table, tag
from .told import told_size

if TYPE_CHECKING:
    from ..record.law_file import LawFile

DRAWS = 200
"""Of the law's numbers, for the band: its ends, two standard deviations, are then known to a twentieth."""
SHOWN = 5
"""Rows of what a force goes with."""
GRID = 160
"""Places of a curve."""
WORDS = {
    "v": "drift v/U",
    "r": "yaw rate r L/U",
    "y": "place y / half width",
    "beta": "heading (rad)",
    "turn": "turning of the line, by L/U",
    "time": "share of the run",
    "alpha": "line angle (rad)",
}
MM = 1e3
"""In a metre."""
SIDE, TURNING, PUSH, ASIDE = "side force (N)", "moment (N m)", "push ahead (N)", "marks aside (mm)"
DRAWN = {AHEAD: (PUSH,), HEEL: (ASIDE,)}
"""What a force without a form is drawn as; elsewhere a side force and a moment."""
HEELED = "Where marks above the roll axis would stand if the model had time to heel"


def law_section(file: LawFile, searched: Searched | None) -> Html:
    """Of law.json, with a picture of the first law.

    Parameters
    ----------
    file : law.json
    searched : what was found; None: nothing was searched
    """
    parts: list[object] = [tag("h2", "The missing law"), bullets(file.sentences)]
    if file.laws and searched is not None:
        rows: list[list[object]] = []
        for row in file.laws:
            sizes = [size_of(n, one.units.get(n, ""), x) for one in row.terms for n, x in one.numbers.items()]
            numbers = join(map(told_size, sizes), ", ")
            shrink = "" if row.shrink is None else number(f"{row.shrink:.2f}")
            rows.append([row.text, number(f"{row.probability:.3f}"), shrink, numbers])
        if file.verdict == "law":
            parts.append(law_figure(searched))
        parts.append(table(["law", "probability", "shrink", "numbers"], rows, kind="sized"))
        size = "½ρU²L² for a side force Y or a push ahead X, ½ρU²L³ for a moment N, U²/g for how far a heel K moves the marks"
        parts.append(tag("p", f"Numbers y, x, n and k times {size}; the others are inside the terms (docs/law.md)."))
    if searched is not None and searched.field is not None and file.verdict in ("law", "form_open", "field", "unknown"):
        parts += _without_a_form(file, searched, searched.field)
    return tag("section", *parts, id="law")


def _without_a_form(file: LawFile, searched: Searched, field: Field) -> list[object]:
    """The force as a function that no equation binds: against each variable, and what it goes with."""
    goes = [
        [" and ".join(" with ".join(group) for group in one.variables), number(f"{one.share:.2f}")]
        for one in file.goes_with
    ]
    return [
        tag("h3", "Without an equation"),
        *(field_figure(searched, field, k) for k in range(len(field.groups))),
        table(["what is missing goes with", "share of the evidence"], goes[:SHOWN]),
    ]


def field_figure(searched: Searched, field: Field, which: int) -> Html:
    """Force of one group of variables against its first, with its band, and where the runs have been.

    Of two variables the second stands at three values: its mean in the runs, and a standard deviation below and above.

    Parameters
    ----------
    searched, field : the search and its force without a form
    which : of the field's groups
    """
    group, states, simulator = field.groups[which], searched.states, searched.diagnosis.inference.simulator
    assert isinstance(simulator, TowSimulator)
    basis = basis_of(group, searched.seen)
    effects, numbers = field.fitted.hypothesis.effects, field.fitted.hypothesis.numbers
    begin = sum(len(e.parameters) for e in effects[:which])
    own = slice(begin, begin + len(effects[which].parameters))
    drawn = DRAWN.get(field.acts, (SIDE, TURNING))
    second = [np.nan] if len(group) == 1 else _about(getattr(states, group[1]))
    grids = [_grid_of(group, searched.seen.ends[group[0]], at) for at in second]
    drawing, axes = new_figure(2.8, columns=len(drawn))
    data: dict[str, Columns] = {}
    sizes = _sizes(simulator)
    there = np.array(basis.values(states)).T
    by_plain = np.linalg.lstsq(_plain(field, states), there, rcond=None)[0]
    for k, (ax, what) in enumerate(zip(axes, drawn, strict=True)):
        part = slice(k * there.shape[1], (k + 1) * there.shape[1])
        mean, spread = numbers[which][part], field.covariance[own, own][part, part]
        ax.axhline(0.0, color=GREY, linewidth=0.6)
        for one, (at, grid) in enumerate(zip(second, grids, strict=True)):
            table_of = np.array(basis.values(grid)).T - _plain(field, grid) @ by_plain
            force = sizes[what] * table_of @ mean
            sd = sizes[what] * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", table_of, spread, table_of), 0.0))
            x, colour = getattr(grid, group[0]), (BLUE, GREY, VERMILION)[one if len(second) == 1 else (1, 0, 2)[one]]
            ax.fill_between(x, force - 2 * sd, force + 2 * sd, color=colour, alpha=0.18, linewidth=0)
            name = None if np.isnan(at) else f"{group[-1]} {at:.2g}"
            ax.plot(x, force, color=colour, linewidth=1.3, label=name)
            data[f"{what} {name or ''}".strip()] = {group[0]: x, what: force, "sd": sd}
        low, high = ax.get_ylim()
        ax.plot(getattr(states, group[0]), np.full(len(states.v), low), "|", color=GREY, markersize=5, alpha=0.25)
        ax.set_ylim(low, high)
        ax.locator_params(axis="x", nbins=5)
        label(ax, x=WORDS[group[0]], y=what)
    if len(second) > 1:
        axes[0].legend(fontsize=7, frameon=False)
    return figure(
        svg_image(drawing, "the missing force without an equation", f"field-{which}", data),
        f"{'The heel' if field.acts == HEEL else 'The missing force'} as a smooth function of {' and '.join(group)} at "
        f"{simulator.speed_m_s:.2f} m/s, with two standard deviations; marks below: where the runs have been. "
        f"{'Its mean is' if field.acts in DRAWN else 'Its mean, and what is linear in drift and yaw rate, are'} not drawn.",
    )


def _plain(field: Field, states: State) -> np.ndarray:
    """(n, k) of what hides elsewhere: a constant force behind the settings' errors, one linear in drift and yaw rate in the
    derivatives; of a resistance only the constant, the straight tow's own, and of a heel that behind the place.
    """
    constant = np.ones(len(states.v))
    return np.column_stack([constant] if field.acts in DRAWN else [states.v, states.r, constant])


def _about(x: np.ndarray) -> list[float]:
    """Mean less and more a standard deviation, the mean between."""
    return [float(np.mean(x) + k * np.std(x)) for k in (-1, 0, 1)]


def _grid_of(group: tuple[str, ...], ends: tuple[float, float], at: float) -> State:
    """The first variable over its range, the second at a value, the others 0."""
    grid = _grid(group[0], ends)
    return grid if len(group) == 1 else replace(grid, **{group[1]: np.full(GRID, at)})


def _sizes(simulator: TowSimulator) -> dict[str, float]:
    """What is drawn -> its size for a coefficient of 1: rho/2 U^2 L^2 (L^3) of the runs, or U^2/g."""
    first = simulator.runs[0]
    whole, length = 0.5 * first.density_kg_m3 * simulator.speed_m_s**2 * first.length_pp_m**2, first.length_pp_m
    return {SIDE: whole, TURNING: whole * length, PUSH: whole, ASIDE: MM * simulator.speed_m_s**2 / GRAVITY_M_S2}


def law_figure(searched: Searched) -> Html:
    """Force of the first law against its first variable, at the runs' mean speed, with its band, and where the runs have been.

    Parameters
    ----------
    searched : with a law
    """
    law, states, simulator = searched.laws[0], searched.states, searched.diagnosis.inference.simulator
    assert isinstance(simulator, TowSimulator)
    terms = [term(text_of(effect)) for effect in law.effects]
    if any(one.lag_s for one in terms):
        return Html("")  # a force that remembers is no curve over the state
    variables = [v for one in terms for v in one.variables]
    variable = variables[0] if variables else "time"
    alone = set(variables) <= {variable}
    at = _grid(variable, searched.seen.ends[variable]) if alone else states
    sizes = _sizes(simulator)
    scale = np.array(list(sizes.values()))[:, None]
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.concatenate(law.numbers), law.covariance, DRAWS)
    told = scale * _force(law, law.numbers, at)
    spread = np.std([scale * _force(law, law.apart(d), at) for d in draws], axis=0)
    only_heels = all(effect.variant == HEEL for effect in law.effects)
    shown = [k for k in range(len(sizes)) if np.abs(told[k]).max() > 0] or [0]
    drawing, axes = new_figure(2.8, columns=len(shown))
    x = getattr(at, variable)
    order = np.argsort(x)
    data: dict[str, Columns] = {}
    for ax, k in zip(axes, shown, strict=True):
        force, sd = told[k][order], spread[k][order]
        ax.axhline(0.0, color=GREY, linewidth=0.6)
        if alone:
            ax.fill_between(x[order], force - 2 * sd, force + 2 * sd, color=BLUE, alpha=0.25, linewidth=0)
            ax.plot(x[order], force, color=BLUE, linewidth=1.4)
        else:
            ax.errorbar(x[order], force, 2 * sd, fmt=".", markersize=2, color=BLUE, elinewidth=0.3)
        low, high = ax.get_ylim()
        ax.plot(getattr(states, variable), np.full(len(states.v), low), "|", color=GREY, markersize=5, alpha=0.25)
        ax.set_ylim(low, high)
        what = list(sizes)[k]
        label(ax, x=WORDS[variable], y=what)
        data[what.split(" (")[0]] = {variable: x[order], what: force, "sd": sd}
    return figure(
        svg_image(drawing, "the law's force", "law", data),
        f"{' and '.join(_told(law))}, at {simulator.speed_m_s:.2f} m/s, with two standard deviations; the marks below are where "
        f"the runs have been.{'' if only_heels else ' What is linear in drift and yaw rate is in the derivatives.'}",
    )


def _told(law: Law) -> list[str]:
    found = {HEELED if effect.variant == HEEL else "The missing force": None for effect in law.effects}
    first, *rest = found
    return [first, *(part[0].lower() + part[1:] for part in rest)]


def _force(law: Law, numbers: Sequence[np.ndarray], at: State) -> np.ndarray:
    """(4, n) coefficients of side force, moment, push ahead and heel."""
    parts = [parts_of(text_of(e), e.variant, n, at) for e, n in zip(law.effects, numbers, strict=True)]
    return np.sum(parts, axis=0)


def _grid(variable: str, ends: tuple[float, float]) -> State:
    """The variable over its range, the others 0."""
    values = {f.name: np.zeros(GRID) for f in fields(State)}
    return State(**(values | {variable: np.linspace(*ends, GRID)}))


__all__ = ["field_figure", "law_figure", "law_section"]
