"""The section of a missing law: what it says, how sure, and the force against its variable with its band."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from ..diagnose.law.search import Searched, force_of
from ..diagnose.law.terms import State, term, text_of
from ..diagnose.tow.towed import TowSimulator
from .draw import BLUE, GREY, Columns, label, new_figure, svg_image
from .format import significant
from .html import Html, bullets, figure, number, table, tag

if TYPE_CHECKING:
    from ..record.law_file import LawFile

DRAWS = 200
"""Of the law's numbers, for the band: its ends, two standard deviations, are then known to a twentieth."""
GRID = 160
"""Places of a curve."""
WORDS = {
    "v": "drift v/U",
    "r": "yaw rate r L/U",
    "y": "place y / half width",
    "beta": "heading (rad)",
    "turn": "turning of the line, by L/U",
    "time": "share of the run",
}


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
            numbers = "; ".join(
                f"{name} {significant(value.value, 3)} ± {significant(value.std, 2)}"
                for one in row.terms
                for name, value in one.numbers.items()
            )
            shrink = "" if row.shrink is None else number(f"{row.shrink:.2f}")
            rows.append([row.text, number(f"{row.probability:.3f}"), numbers, shrink])
        parts += [law_figure(searched), table(["law", "probability", "numbers", "shrink"], rows)]
        size = "½ρU²L² for a side force Y, ½ρU²L³ for a moment N"
        parts.append(tag("p", f"Numbers y and n times {size}; the others are those inside the terms (docs/law.md)."))
    return tag("section", *parts, id="law")


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
    first = simulator.runs[0]
    size = 0.5 * first.density_kg_m3 * simulator.speed_m_s**2 * first.length_pp_m**2
    scale = np.array([[size], [size * first.length_pp_m]])
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.concatenate(law.numbers), law.covariance, DRAWS)
    told = scale * force_of(law.effects, law.numbers, at)
    spread = np.std([scale * force_of(law.effects, law.apart(d), at) for d in draws], axis=0)
    shown = [k for k in range(2) if np.abs(told[k]).max() > 0] or [0]
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
        what = ("side force (N)", "moment (N m)")[k]
        label(ax, x=WORDS[variable], y=what)
        data[what.split(" (")[0]] = {variable: x[order], what: force, "sd": sd}
    return figure(
        svg_image(drawing, "the law's force", "law", data),
        f"The missing force at {simulator.speed_m_s:.2f} m/s, with two standard deviations; the marks below are where the runs "
        "have been. What is linear in drift and yaw rate is in the derivatives.",
    )


def _grid(variable: str, ends: tuple[float, float]) -> State:
    """The variable over its range, the others 0."""
    values = {f.name: np.zeros(GRID) for f in fields(State)}
    return State(**(values | {variable: np.linspace(*ends, GRID)}))


__all__ = ["law_figure", "law_section"]
