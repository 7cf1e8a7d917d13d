"""The straight line X_T over 1/F (5.4) whose intercept is the neutral point."""

from __future__ import annotations

import numpy as np

from ..record.results import SteadyFile
from .draw import BLACK, BLUE, GREEN, TEXT_PT, VERMILION, Columns, label, legend, new_figure, svg_image
from .format import tension_measured
from .html import Html


def line_figure(result: SteadyFile) -> Html | None:
    """X_T over 1/F with its line and intercept; tows numbered in the file's order. None without a usable force."""
    tows = [(k + 1, tow) for k, tow in enumerate(result.tows.values()) if tow.force.value != 0]
    if not tows:
        return None
    figure, (ax,) = new_figure(3.9)
    force = np.array([tow.force.value for _, tow in tows])
    over, place = 1 / force, np.array([tow.tow_point_m for _, tow in tows])
    spread = np.array([tow.force.std for _, tow in tows]) / force**2
    reach = 1.12 * over[np.argmax(np.abs(over))]
    other = min(0.0, 1.12 * float(over.min())) if reach > 0 else max(0.0, 1.12 * float(over.max()))
    ends = np.array([other, reach])
    value, (low, high) = result.x_v_m.value, result.x_v_interval_m
    ax.plot(ends, value + result.slope.value * ends, color=VERMILION, linewidth=1.7, zorder=2, label="fitted line")
    ax.errorbar(over, place, xerr=spread, color=BLACK, linestyle="", marker="o", markersize=5, capsize=3, label="tow")
    for (order, _), x, y in zip(tows, over, place, strict=True):
        ax.annotate(
            str(order), (x, y), xytext=(7, -13), textcoords="offset points", fontsize=TEXT_PT, color=BLACK, zorder=5
        )
    below, above = max(0.0, value - low), max(0.0, high - value)
    ax.errorbar(
        [0], [value], yerr=[[below], [above]], color=BLUE, marker="D", markersize=6, capsize=5, linewidth=1.7, zorder=4,
        label=r"intercept $X_v$, 95 %",
    )  # fmt: skip
    if result.x_v_true_m is not None:
        ax.axhline(result.x_v_true_m, color=GREEN, linestyle="--", linewidth=1.4, label=r"true $X_v$")
    ax.axvline(0, color=BLACK, linewidth=0.8)
    margin = 0.06 * abs(reach - other)
    ax.set_xlim(min(ends) - margin, max(ends) + margin)
    legend(ax, place="best", columns=1)
    label(ax, "1/F (1/N)" if tension_measured(result) else "R/F (tension not measured)")
    label(ax, y=r"$X_T$ ahead of LCG (m)")
    inverse = "one_over_f_per_n" if tension_measured(result) else "r_over_f"
    data: dict[str, Columns] = {
        "tow": {"tow": [order for order, _ in tows], inverse: over, f"{inverse}_sd": spread, "tow_point_m": place},
        "line": {inverse: ends, "tow_point_m": value + result.slope.value * ends},
        "intercept": {inverse: [0.0], "tow_point_m": [value], "from_95_m": [low], "to_95_m": [high]},
    }
    words = "tow point over one by the steady line force, with the fitted line and its intercept"
    return svg_image(figure, words, "steady-line", data)
