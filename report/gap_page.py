"""The page of a diagnosis: what is missing, how sure, where, how far, what it had done to the derivatives, what to do next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..diagnose.sizes import size_of, sizes_of
from ..diagnose.tow.numbers import COMPLIANCE
from ..diagnose.words import is_open, is_unseen
from ..simulate.model import DERIVATIVE_UNITS
from .format import plus_minus, significant
from .gap_figures import drop_figure, ladder_figure, runs_figure, stage_figure
from .html import Html, bullets, join, number, symbols, table, tag, unit
from .page import document, write_document
from .sections import BESIDE, SYMBOLS_HTML
from .told import told_size

if TYPE_CHECKING:
    from ..diagnose.gap import Diagnosed
    from ..record.gap_file import GapFile
    from ..record.results import Measured

HEADLINES = {
    "no_gap": "No gap",
    "effect": "An effect is missing",
    "form_not_exact": "An effect is missing, its form not exact",
    "unknown": "Something unknown is missing",
    "not_converged": "No answer: the fit did not converge",
}
UNSEEN = "An effect fits, but no other run shows it"
"""Instead of "is missing", where the gap of the runs kept aside does not shrink with it."""


def headline(file: GapFile) -> str:
    """The verdict in two or three words; "Open" where no gap is said for want of proof.

    Parameters
    ----------
    file : gap.json
    """
    if is_unseen(file):
        return UNSEEN
    return "Open" if is_open(file) else HEADLINES[file.verdict]


def write_gap_page(path: Path, found: Diagnosed, law: Html | None = None) -> None:
    """Write the page atomically.

    Parameters
    ----------
    path : of the file
    found : the diagnosis
    law : ``law_section``, where a law was searched
    """
    write_document(path, gap_page(found, law))


def gap_page(found: Diagnosed, law: Html | None = None) -> Html:
    """The page as text."""
    file = found.diagnosis.file
    parts: list[object] = [
        tag("h1", f"Simulator against tank: {', '.join(file.runs)}"),
        tag("section", tag("h2", headline(file)), bullets(map(symbols, file.sentences)), id="verdict"),
        tag("section", tag("h2", "How sure"), ladder_figure(file), _ranking(file), _not_told(file)),
        tag("section", tag("h2", "Where"), stage_figure(file), drop_figure(found.diagnosis), _place(file)),
        tag("section", tag("h2", "Measured against simulated"), runs_figure(found.diagnosis)),
        tag("section", tag("h2", "The derivatives, before and after"), _derivatives(file)),
    ]
    if law is not None:
        parts.insert(3, law)
    if file.next_run is not None:
        parts.append(tag("section", tag("h2", "The next run"), _next(file)))
    if file.next_measurement is not None:
        said = tag("p", f"Measure {file.next_measurement.why} State it as [[measured]] in one run.toml, zero or not.")
        parts.append(tag("section", tag("h2", "Without a tow"), said))
    if file.excluded:
        rows = [[name.replace("_", " "), why] for name, why in file.excluded.items()]
        parts.append(tag("section", tag("h2", "Not judged"), table(["effect", "why"], rows, kind="wraps")))
    noise = file.noise
    words = (
        f"Slow random forces taken: {significant(noise['side_n'], 2)} N and {significant(noise['moment_n_m'], 2)} N m, lasting "
        f"{noise['time_s']:g} s. {_lasting(file)}Written by towline {file.tool}. ± is one standard deviation."
    )
    parts.append(tag("footer", words))
    return document("Simulator against tank", tag("main", *parts))


def _lasting(file: GapFile) -> str:
    if file.lasting_px is None:
        return ""
    return f"Errors of the marks that last: {significant(file.lasting_px, 2)} px are granted, as the marks' distance shows. "


def _ranking(file: GapFile) -> Html:
    rows: list[list[object]] = [["nothing missing", number(f"{file.p_no_gap:.3f}"), "", "", "", "", ""]]
    for row in file.ranking:
        low, high = row.shrink_interval
        size = join(map(told_size, sizes_of(row.parameters, row.units)), ", ")
        rows.append(
            [
                row.words,
                number(f"{row.probability:.3f}"),
                number(f"{row.probability_inexact:.3f}" if row.probability_inexact else ""),
                number(f"{row.gap_before:.2f}"),
                number(f"{row.gap_after:.2f}"),
                number("-" if row.shrinks is None else f"{row.shrink:.2f} ({low:.2f} to {high:.2f})"),
                size,
            ]
        )
    rows.append(["something in no library", number(f"{file.p_unknown:.3f}"), "", "", "", "", ""])
    where = "runs kept aside" if file.kept_aside else "the fitted run itself"
    words = (
        f"Gap: root mean square of what the simulator misses in y and heading on {where}, over the noise (1 = noise). "
        "Shrink: share of the excess that goes away, with its 90 % interval; – where the gap is noise without the "
        "effect. Form not exact: probability that the effect is there "
        "in another form than the library's."
    )
    return table(
        ["hypothesis", "probability", "form not exact", "gap before", "after", "shrink", "size"],
        rows,
        kind="wraps",
        caption=words,
    )


def _not_told(file: GapFile) -> Html:
    words = {row.effects[0]: row.titles[0] for row in file.ranking if len(row.effects) == 1 and row.titles}
    rows = [" and ".join(words.get(name, name.replace("_", " ")) for name in names) for names in file.indistinguishable]
    return tag("div", tag("h3", "What these runs cannot tell apart"), bullets(rows)) if rows else Html("")


def _place(file: GapFile) -> Html:
    place = file.where
    said = []
    if place.span_s:
        said.append(f"Most of it shows from {place.span_s[0]:.0f} to {place.span_s[1]:.0f} s after the runs' start.")
    if place.band_hz:
        said.append(f"It changes the motion at {place.band_hz[0]:.2f} to {place.band_hz[1]:.2f} Hz.")
    if place.when:
        said.append(place.when[0].upper() + place.when[1:] + ".")
    return bullets(said)


def _derivatives(file: GapFile) -> Html:
    rows = []
    before, after = file.derivatives["before"], file.derivatives.get("after")
    for name, value in before.items():
        symbol, shown, units = _derivative(name, value)
        row: list[object] = [symbol, shown]
        if after is not None:
            other = after[name]
            # of a number that may be zero a share says nothing
            known = abs(other.value) > other.std
            bias = f"{100 * (value.value / other.value - 1):+.1f}" if known else ""
            row += [_derivative(name, other)[1], number(bias)]
        rows.append([*row, unit(units)])
    if after is None:
        return table(["derivative", "fitted", "unit"], rows, caption="The simulator as it is, fitted to these runs.")
    words = "What leaving the effect out had done to the derivatives."
    return table(["derivative", "without the effect", "with it", "bias, %", "unit"], rows, caption=words)


def _derivative(name: str, measured: Measured) -> tuple[object, Html, str]:
    """Symbol, value and unit of a number of the hull or the line; one of somebody else's simulator keeps its name."""
    if name == COMPLIANCE:
        one = size_of(name, "m/N", measured)
        return f"line's {one.word}", number(plus_minus(one.value, one.std)), one.unit
    shown = number(plus_minus(measured.value, measured.std))
    if name in BESIDE:
        return Html(BESIDE[name][0]), shown, BESIDE[name][1]
    return SYMBOLS_HTML.get(name, name), shown, DERIVATIVE_UNITS.get(name, "")


def _next(file: GapFile) -> Html:
    run = file.next_run
    assert run is not None
    rows = [
        ["tow point ahead of LCG", f"{run.tow_point_m:.3f}", "m"],
        ["line", f"{run.line_length_m:.2f}", "m"],
        ["carriage", f"{run.speed_m_s:.2f}", "m/s"],
        ["release, y", f"{run.y_release_m:.2f}", "m"],
        ["release, heading", f"{run.beta_release_rad:.2f}", "rad"],
    ]
    return tag("div", tag("p", run.why[0].upper() + run.why[1:] + "."), table(["setting", "value", "unit"], rows))
