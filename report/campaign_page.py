"""The page of a campaign: what its runs gave together, each run at a glance, and what failed and why."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..record.campaigns import Answer, Campaign
from ..record.errors import TowlineError
from ..record.results import DerivativesFile, SteadyFile, read_result
from .draw import BLUE, GREY, TEXT_PT, VERMILION, Columns, svg_image
from .html import Html, figure, number, table, tag
from .page import document, write_document
from .sections import derivatives_section, failed_box
from .steady_section import steady_section

COLUMNS, PANEL_IN = 4, (1.65, 1.15)
"""Small pictures side by side, and the size of each, inches: four fill WIDTH_IN."""
SHOWN = (
    ("duration", "duration (s)", 1.0, 1),
    ("measured_share", "measured (%)", 100.0, 1),
    ("speed", "U (m/s)", 1.0, 3),
    ("tow_point", "X_T (m)", 1.0, 4),
    ("line_length", "line (m)", 1.0, 3),
    ("tension", "T (N)", 1.0, 3),
    ("trim", "trim by the stern (°)", float(np.degrees(1.0)), 2),
    ("y_cg_largest", "largest |y| (m)", 1.0, 3),
    ("beta_largest", "largest |β| (°)", float(np.degrees(1.0)), 2),
    ("y_cg_sigma", "σ y (mm)", 1e3, 3),
)
"""Quantity, heading, factor, decimals."""


def write_campaign_page(path: Path, found: Campaign) -> None:
    """Write the page atomically.

    Parameters
    ----------
    path : of the file
    found : the campaign
    """
    write_document(path, campaign_page(found))


def campaign_page(found: Campaign) -> Html:
    """The page as text."""
    good = [a for a in found.runs if not a.reason]
    title = f"Campaign {found.folder.resolve().name}"
    parts: list[object] = [
        tag("h1", title),
        tag("p", _summary(found, good), class_="summary"),
    ]
    if found.failed:
        parts.append(failed_box("What could not be used", found.failed))
    for fit in found.fits:
        parts += _results(found, fit)
    parts.append(tag("section", tag("h2", "Runs"), _runs(good), runs_figure(found, good), id="runs"))
    words = "Largest values and median sigma are those of measured frames; y and angles positive to starboard."
    parts.append(tag("footer", words))
    return document(title, tag("main", *parts))


def _summary(found: Campaign, good: list[Answer]) -> str:
    fits = [fit.name for fit in found.fits if not fit.reason]
    words = f"{len(good)} of {len(found.runs)} runs could be used; "
    return words + (f"together they give {' and '.join(fits)}." if fits else "no fit of several runs was possible.")


def _results(found: Campaign, fit: Answer) -> list[Html]:
    if fit.reason:
        return []
    place = found.out / fit.name
    try:
        if fit.wants in ("derivatives", "free_run"):
            title = "Free runs" if fit.wants == "free_run" else "Hydrodynamic derivatives"
            return [derivatives_section(read_result(place / "derivatives.json", DerivativesFile), title, fit.name)]
        return [steady_section(read_result(place / "steady.json", SteadyFile))]
    except TowlineError as error:
        return [failed_box(f"{fit.name} cannot be shown", {fit.name: str(error)})]


def _runs(good: list[Answer]) -> Html:
    rows = []
    trimmed = any(quantity == "trim" for a in good for quantity, *_ in a.numbers)
    shown = [one for one in SHOWN if trimmed or one[0] != "trim"]
    for a in good:
        values = {quantity: value for quantity, value, *_ in a.numbers}
        cells = [
            number(f"{factor * values[key]:.{decimals}f}") if key in values else ""
            for key, _, factor, decimals in shown
        ]
        rows.append([tag("strong", a.name), a.job, a.wants or "motion", *cells])
    head = ["run", "folder", "good for", *(words for _, words, *_ in shown)]
    return tag("div", table(head, rows, kind="wide"), class_="scroll")


def runs_figure(found: Campaign, good: list[Answer]) -> Html:
    """y and heading of every run, small: the odd one is seen at once. Numbers in the panels are the table's rows.

    Parameters
    ----------
    found : the campaign
    good : answers of the runs that have a motion
    """
    from matplotlib.figure import Figure

    from ..record.run import read_run
    from ..record.tables import read_motion

    if not good:
        return Html("")
    lines = -(-len(good) // COLUMNS)
    width, height = PANEL_IN
    drawing = Figure(figsize=(COLUMNS * width, lines * height + 0.3))
    # axes that share, and a layout that measures every text, would cost the square of their number
    axes = drawing.subplots(lines, COLUMNS, squeeze=False).ravel()
    high, across = drawing.get_figheight(), drawing.get_figwidth()
    drawing.subplots_adjust(
        left=0.3 / across, right=1 - 0.05 / across, bottom=0.45 / high, top=1 - 0.06 / high, wspace=0.24, hspace=0.18
    )
    ends: list[float] = []
    data: dict[str, Columns] = {}
    for k, (ax, a) in enumerate(zip(axes, good, strict=False), 1):
        run = read_run(found.folder / a.job)
        path = run.source_path if run.file.source.motion is not None else run.out / "motion.csv"
        motion = read_motion(path)
        t_s, measured = motion["t_s"].to_numpy(), (motion["status"] == "measured").to_numpy()
        thin = slice(None, None, max(1, len(t_s) // 300))
        part: dict[str, ArrayLike] = {"run": a.name, "t_s": t_s[thin]}
        ends += [float(t_s[0]), float(t_s[-1])] if len(t_s) else []
        for column, factor, colour, name in (
            ("y_cg_m", 100.0, BLUE, "y_cg_cm"), ("beta_rad", float(np.degrees(1.0)), VERMILION, "beta_deg"),
        ):  # fmt: skip
            values = np.where(measured, factor * motion[column].to_numpy(dtype=float), np.nan)
            part[name] = values[thin]
            ax.plot(t_s[thin], values[thin], color=colour, linewidth=0.9)
        data[str(k)] = part
        ax.axhline(0, color=GREY, linewidth=0.4)
        ax.tick_params(labelsize=TEXT_PT - 3, length=2)
        ax.text(0.98, 0.95, str(k), transform=ax.transAxes, ha="right", va="top", fontsize=TEXT_PT - 1.5, color=GREY)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    for k, ax in enumerate(axes[: len(good)]):
        ax.set_xlim(min(ends, default=0.0), max(ends, default=1.0))
        ax.tick_params(labelbottom=k + COLUMNS >= len(good))
    for ax in axes[len(good) :]:
        ax.set_axis_off()
    drawing.supxlabel("t (s)", fontsize=TEXT_PT - 1, y=0.05 / high)
    caption = (
        "Every run in the table's order: y in cm (blue) and heading in degrees (vermilion); gaps were not measured."
    )
    return figure(svg_image(drawing, "runs at a glance", "runs", data), caption)


__all__ = ["campaign_page", "runs_figure", "write_campaign_page"]
