"""Pictures of the diagnosis."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .draw import BLACK, BLUE, GREEN, GREY, ORANGE, TEXT_PT, VERMILION, Columns, label, legend, new_figure, svg_image
from .html import Html, figure, join

if TYPE_CHECKING:
    from ..diagnose.gap import Diagnosis
    from ..record.gap_file import GapFile

WIDE = 34
"""Letters of a hypothesis on one line of the picture."""
ROWS = 6
"""Hypotheses in the picture: the most probable ones."""


def ladder_figure(file: GapFile) -> Html:
    """Probabilities of the hypotheses."""
    rows = [(r.words, r.named) for r in file.ranking[:ROWS]]
    rows += [("nothing missing", file.p_no_gap), ("in no library", file.p_unknown)]
    rows.sort(key=lambda row: row[1])
    names, values = zip(*rows, strict=True)
    # a title is a user's where the effect is: no letter of it may set a formula
    lines = [textwrap.fill(name.replace("_", " ").replace("$", r"\$"), WIDE) for name in names]
    height = 0.2 * sum(1 + text.count("\n") for text in lines) + 0.16 * len(rows) + 0.8
    drawing, (ax,) = new_figure(height)
    ax.set_position((0.4, 0.5 / height, 0.57, 0.92 - 0.5 / height))
    ax.barh(range(len(rows)), values, color=BLUE, height=0.6)
    ax.set_yticks(range(len(rows)), lines)
    ax.set_xlim(0, 1)
    label(ax, x="probability")
    data = {"": {"hypothesis": names, "probability": values}}
    shown = svg_image(drawing, "probabilities of the hypotheses", "hypotheses", data)
    return figure(shown, "Half of the prior stands for nothing missing.")


def stage_figure(file: GapFile) -> Html:
    """Stages and runs, side by side."""
    drawing, axes = new_figure(2.3, columns=2)
    share = file.where.share
    axes[0].barh(list(share), list(share.values()), color=VERMILION, height=0.6)
    axes[0].set_xlim(0, 1)
    label(axes[0], x="probability by stage")
    runs = file.where.runs
    numbers = [str(k + 1) for k in range(len(runs))]
    axes[1].barh(numbers, list(runs.values()), color=GREEN, height=0.6)
    label(axes[1], x="share of the gap by run", y="run")
    names = ", ".join(f"{k + 1} {name}" for k, name in enumerate(runs))
    data = {
        "stage": {"name": list(share), "share": list(share.values())},
        "run": {"name": list(runs), "share": list(runs.values())},
    }
    shown = svg_image(drawing, "stages and runs", "where", data)
    return figure(shown, f"Where the difference lies. Runs: {names}")


def drop_figure(found: Diagnosis) -> Html:
    """When it shows: drop of the misfit over time, a small picture per run."""
    drop = found.place.drop
    if not drop:
        return Html("")
    step = found.inference.simulator.step_s
    drawing, axes = new_figure(0.75 * len(drop) + 0.6, tuple([1.0] * len(drop)))
    top = max(float(np.max(d)) for d in drop.values())
    data: dict[str, Columns] = {}
    for ax, (index, values) in zip(axes, enumerate(drop.values()), strict=True):
        t_s = (np.arange(len(values)) + 0.5) * step
        data[f"run {index + 1}"] = {"t_s": t_s, "taken_away_sigma2": np.maximum(values, 0)}
        ax.fill_between(t_s, 0, np.maximum(values, 0), color=VERMILION, linewidth=0, step="mid")
        ax.set_ylim(0, 1.05 * max(top, 1.0))
        # the top of a picture and the foot of the one above it are one place: each has a number at its foot and in its middle
        middle = float(f"{0.5 * max(top, 1.0):.1g}")
        ax.set_yticks([0, middle], ["0", f"{middle:g}"])
        ax.text(0.99, 0.85, f"run {index + 1}", transform=ax.transAxes, fontsize=8, ha="right", va="top", color=GREY)
    label(axes[-1], x="t (s)")
    drawing.supylabel("taken away (σ²)", fontsize=TEXT_PT + 0.5, x=0.02)
    return figure(
        svg_image(drawing, "misfit over time", "when", data),
        "When it shows: squared misfit, in units of the noise, that the effect takes away.",
    )


def runs_figure(found: Diagnosis) -> Html:
    """Measured minus simulated, before and after, y and heading, a pair of pictures per run."""
    base = found.ranking.base
    after = found.best.fitted if found.best is not None else None
    parts = []
    for index, run in enumerate(found.inference.simulator.runs):
        drawing, axes = new_figure(2.2, columns=2)
        t_s = run.centre_s
        data: dict[str, ArrayLike] = {"t_s": t_s}
        for ax, channel, unit, scale in ((axes[0], 0, "y (mm)", 1e3), (axes[1], 1, "heading (deg)", np.degrees(1.0))):
            name = ("y{}_mm", "beta{}_deg")[channel]
            before = data[name.format("_as_it_is")] = scale * base.linear.rows[index][0][:, channel]
            ax.plot(t_s, before, color=ORANGE, linewidth=2.6, alpha=0.75, label="as it is")
            if after is not None:
                left = data[name.format("_with_the_effect")] = scale * after.linear.rows[index][0][:, channel]
                ax.plot(t_s, left, color=BLUE, linewidth=1.0, label="with the effect", zorder=3)
            sd = data[name.format("_sigma")] = float(scale * np.sqrt(np.median(np.diag(run.covariance[channel]))))
            ax.axhspan(-2 * sd, 2 * sd, color="#DDDDDD", zorder=0)
            ax.axhline(0, color=BLACK, linewidth=0.6)
            label(ax, x="t (s)", y=unit)
        legend(axes[0], place="best", columns=1)
        parts.append(
            figure(
                svg_image(drawing, f"residuals of {run.name}", f"run-{index + 1}", {"": data}),
                f"{run.name}: measured minus simulated; grey: two sigma of the measurement.",
            )
        )
    return join(parts)
