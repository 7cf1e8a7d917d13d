"""The page of a camera check: verdict, picture, invariants, uncertainty map, what it does to the derivatives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .check_figures import invariants_figure, map_figure, picture_figure
from .format import significant, to_decimals
from .html import Html, bullets, join, number, symbols, table, tag
from .page import document, write_document
from .sections import SYMBOLS_HTML

if TYPE_CHECKING:
    from ..geometry.checks.checked import Checked
    from ..record.check_file import CheckFile

VERDICTS = {
    "mistake": "run.toml holds a mistake",
    "sound": "The camera geometry is sound",
    "fault": "Something is wrong",
    "unknown": "Something does not fit",
}

IN_PICTURE = {True: "In the picture", False: "Where it shows in the picture"}
_UNITS = {"k": ("", 1.0), "p": ("", 1.0), "f": (" px", 1.0), "c": (" px", 1.0), "datum": (" %", 100.0)}
"""Of tolerances, by how they begin (k1, p2, fx, cy, datum width): unit, and how many of it are one; else mm of metres."""


def write_check_page(path: Path, found: Checked) -> None:
    """Write the page atomically.

    Parameters
    ----------
    path : of the file
    found : the check
    """
    write_document(path, check_page(found))


def check_page(found: Checked) -> Html:
    """The page as text."""
    file = found.file
    title = f"Camera check: {', '.join(file.runs)}"
    parts: list[object] = [
        tag("h1", title),
        tag("section", tag("h2", VERDICTS[file.verdict]), bullets(map(symbols, file.sentences)), id="verdict"),
    ]
    picture = picture_figure(found)
    if picture is not None:
        parts.append(tag("section", tag("h2", IN_PICTURE[file.verdict == "sound"]), picture, id="picture"))
    parts.append(tag("section", tag("h2", "What must stay constant"), invariants_figure(found), _invariants(file)))
    parts.append(tag("section", tag("h2", "The datum"), _datum(file)))
    parts.append(tag("section", tag("h2", "How well places are known"), map_figure(file)))
    if file.effects_percent:
        parts.append(tag("section", tag("h2", "What the camera does to the derivatives"), _effects(file)))
    if file.refined:
        parts.append(
            tag("section", tag("h2", "Estimated from the invariants"), _refined(file), bullets(file.refined_words))
        )
    parts.append(tag("section", tag("h2", "What was tried"), _tried(file), _tolerances(file)))
    if file.notes:
        parts.append(tag("section", tag("h2", "Notes"), bullets(file.notes)))
    parts.append(
        tag("footer", f"Written by towline {file.tool}. ± is one standard deviation; x ahead, y to starboard.")
    )
    return document(title, tag("main", *parts))


def _datum(file: CheckFile) -> Html:
    rows = []
    for p in file.datum:
        size = float(np.hypot(*p.residual_px)) / p.sigma_px
        cells = [number(_signed(v, 2)) for v in p.residual_px] + [number(_signed(v, 1)) for v in p.residual_mm]
        rows.append(
            [p.name, *cells, f"{p.sigma_px:g}", tag("strong", f"{size:.1f}") if size > 3 else number(f"{size:.1f}")]
        )
        if not p.used:
            rows[-1][0] = f"{p.name} (left out)"
    words = "Picked minus where the camera puts it. A point that stands out was mispicked or stands elsewhere than tank_m says."
    return table(["point", "Δu (px)", "Δv (px)", "Δx (mm)", "Δy (mm)", "σ (px)", "|Δ|/σ"], rows, caption=words)


def _invariants(file: CheckFile) -> Html:
    rows = [
        [f"{name}: {what}", number(f"{1e3 * m.value:+.2f}"), number(f"{1e3 * m.std:.2f}")]
        for name, values in file.invariants.items()
        for what, m in values.items()
    ]
    return table(["invariant", "mean − stated (mm)", "scatter (mm)"], rows)


def _effects(file: CheckFile) -> Html:
    keys = list(file.effects_percent)
    parameters = list(next(iter(file.effects_percent.values())))
    rows = []
    for parameter in parameters:
        cells = []
        for key in keys:
            value = file.effects_percent[key].get(parameter, float("nan"))
            text = number(_signed(value, 2))
            cells.append(tag("strong", text) if abs(value) >= 1 else text)
        rows.append([parameter, *cells])
    words = "Change of each derivative, in per cent, by one standard deviation (or tolerance) of each camera parameter."
    head = [SYMBOLS_HTML.get(key, key) for key in keys]
    return table(["parameter", *head], rows, caption=words)


def _refined(file: CheckFile) -> Html:
    rows = [
        [
            v.parameter,
            number(f"{v.stated:.5g}"),
            number(f"{v.value:.5g} +- {v.std:.2g}"),
            v.unit,
            "yes" if v.observable else "no",
        ]
        for v in file.refined
    ]
    words = "Nothing was changed: put what you believe into run.toml."
    return table(["parameter", "stated", "estimate", "unit", "told by these runs"], rows, caption=words)


def _tried(file: CheckFile) -> Html:
    if not file.tried:
        return tag("p", "No fault was worth a full fit.")
    rows = [[f.kind + (f" {f.item}" if f.item else ""), number(f"{f.evidence:.1f}"), f.sentence] for f in file.tried]
    words = "Log Bayes factor against nothing being wrong; from 2.5 on a fault is named."
    if file.verdict == "sound":  # what a fault would have been is no second answer
        return join(
            [tag("p", f"{words} None is.", class_="caption"), table(["fault", "evidence"], [row[:2] for row in rows])]
        )
    return table(["fault", "evidence", "as it would be"], rows, kind="wraps", caption=words)


def _tolerances(file: CheckFile) -> Html:
    return tag(
        "p",
        "Taken as known to within: ",
        ", ".join(_tolerance(name, sd) for name, sd in file.tolerances.items()),
        f" (chi-square of the joint fit {file.chi_square:.0f} of {file.degrees}, "
        f"the marks' and the line's variances taken {file.inflation:.1f} times for errors that last.)",
    )


def _tolerance(name: str, sd: float) -> str:
    """A tolerance with its unit: "fx 0.92 px", "depth bow 2.0 mm"."""
    short = len(name) == len("k1")
    unit, times = _UNITS.get(name[0] if short else name.partition(" ")[0], (" mm", 1e3))
    return f"{name} {significant(times * sd, 2)}{unit}"


def _signed(value: float, decimals: int) -> str:
    """With its sign, but 0 where nothing of it is shown."""
    text = to_decimals(value, decimals)
    return text if text.startswith("-") or not float(text or 0) else f"+{text}"
