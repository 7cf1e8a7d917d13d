"""The budget as a picture: what each quantity's variance comes from."""

from __future__ import annotations

import numpy as np

from ..record.budget_file import BudgetFile
from .budget_rows import SHORT
from .draw import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, label, new_figure, svg_image
from .html import Html

COLOURS = (BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, "#7A5195", "#A6761D", "#1B4965", "#B3446C")
"""Of the sources in the order of their weight: Okabe and Ito's, then four that print apart."""
SMALL = 0.01
"""Sources of less than this share of every quantity are put together."""
TEX = {
    "m'": "$m'$",
    "I'": "$I'$",
    "Y_v": "$Y_v$",
    "Y_R": "$Y_R$",
    "N_v": "$N_v$",
    "N_r": "$N_r$",
    "Y_delta": r"$Y_\delta$",
    "N_delta": r"$N_\delta$",
    "X_v": "$X_v$",
}
"""Symbols in a picture."""


def shares_figure(file: BudgetFile, alternative: str) -> Html:
    """A bar of each quantity, cut into its sources' shares of the variance.

    Parameters
    ----------
    file : budget.json
    alternative : text for those who do not see the picture
    """
    names = list(file.quantities)
    shares: dict[str, np.ndarray] = {}
    for line in file.lines:
        if line.status != "not included":
            mine = np.array([line.share[n] for n in names])
            shares[line.source] = shares.get(line.source, np.zeros(len(names))) + mine
    large = sorted((s for s in shares if shares[s].max() >= SMALL), key=lambda s: -shares[s].sum())[: len(COLOURS)]
    rest = sum((shares[s] for s in shares if s not in large), np.zeros(len(names)))
    drawing, (ax,) = new_figure(0.36 * len(names) + 1.5)
    rows = np.arange(len(names))[::-1]
    begin = np.zeros(len(names))
    parts = [(s, shares[s], c) for s, c in zip(large, COLOURS, strict=False)]
    for source, share, colour in [*parts, ("all others", rest, GREY)]:
        ax.barh(rows, 100 * share, 0.72, left=100 * begin, color=colour, label=source, edgecolor="white", linewidth=0.6)
        begin = begin + share
    ax.set_yticks(rows, [TEX[SHORT[n]] for n in names])
    ax.set_xlim(0, 100)
    ax.set_ylim(-0.6, len(names) + 0.7)
    ax.grid(visible=False, axis="y")
    ax.legend(
        loc="upper left", ncols=4, fontsize=8, frameon=False, handlelength=1.0, columnspacing=1.0, handletextpad=0.4,
        bbox_to_anchor=(0.0, 1.04),
    )  # fmt: skip
    label(ax, x="share of the variance (%)")
    columns = {"quantity": names} | {source: 100 * share for source, share, _ in parts} | {"all others": 100 * rest}
    return svg_image(drawing, alternative, "budget-shares", {"shares": columns})


__all__ = ["shares_figure"]
