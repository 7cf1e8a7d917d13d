"""The uncertainty budget on a page, and on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..record.budget_file import BudgetFile
from .budget_figure import shares_figure
from .budget_rows import (
    MEANT,
    QUANTITY_HEAD,
    SHORT,
    carried_text,
    degrees_text,
    exact_rows,
    moves_text,
    probability_text,
    quantity_rows,
    share_text,
    source_rows,
)
from .format import significant
from .html import Html, bullets, figure, join, number, table, tag, unit

if TYPE_CHECKING:
    from rich.table import Table

SYMBOLS = {
    "m'": "<i>m</i>′",
    "I'": "<i>I</i>′",
    "Y_v": "<i>Y</i><sub>v</sub>",
    "Y_R": "<i>Y</i><sub>R</sub>",
    "N_v": "<i>N</i><sub>v</sub>",
    "N_r": "<i>N</i><sub>r</sub>",
    "Y_delta": "<i>Y</i><sub>δ</sub>",
    "N_delta": "<i>N</i><sub>δ</sub>",
    "X_v": "<i>X</i><sub>v</sub>",
}
HEADS = {
    "u fit": "<i>u</i> of the fit",
    "u_c": "<i>u</i><sub>c</sub>",
    "nu_eff": "<i>ν</i><sub>eff</sub>",
    "k": "<i>k</i>",
    "U": "<i>U</i><sub>95</sub>",
    "U, %": "<i>U</i><sub>95</sub>, %",
    "prime x1e3": "prime × 10³ (± <i>u</i>)",
}


def budget_section(file: BudgetFile) -> Html:
    """The section: values, sources by their share, what is not included, what is carried on, repeats, every line.

    Parameters
    ----------
    file : budget.json
    """
    names = list(file.quantities)
    heads = [_symbol(SHORT[n]) for n in names]
    values = [
        [_symbol(row[0]), number(row[1]), unit(row[2]), *(number(_infinite(cell)) for cell in row[3:])]
        for row in quantity_rows(file)
    ]
    sources = [
        [_first(row.source, row.name), row.evaluation, number(row.std), number(_infinite(row.degrees))]
        + [_shade(row.shares[n]) for n in names]
        for row in source_rows(file)
    ]
    outside = exact_rows(file)
    exact = [
        [_first(row.source, row.name), row.step, *(number(moves_text(row.moves[n])) for n in names)]
        for row in outside
        if row.step
    ]
    unknown = [f"{row.source}, {row.name}: {row.why}" for row in outside if not row.step]
    carried = [[name, *(number(text) for text in carried_text(q))] for name, q in file.carried.items()]
    parts: list[object] = [
        tag("h2", "Uncertainty budget"),
        tag(
            "p",
            "Combined standard uncertainties u_c, and expanded ones U = k u_c for 95 %, k by Welch and Satterthwaite (JCGM 100). "
            f"The fit's own lines combine to its standard deviations within {_percent(file.closure)}.",
        ),
        table(
            [Html(HEADS.get(h, h)) for h in QUANTITY_HEAD],
            values,
            kind="units",
            caption=f"{MEANT}; at {file.speed_m_s:g} m/s",
        ),
        figure(
            shares_figure(file, "fit and added lines"),
            "What each quantity's variance comes from; sources of less than 1 % everywhere are put together.",
        ),
        table(
            ["source", "type", Html("<i>u</i>(<i>x</i>)"), Html("<i>ν</i>"), *heads],
            sources,
            kind="wide",
            caption="Every input that is included: share of the variance in %. In brackets: in so many runs.",
        ),
        table(
            ["not included", "were it off by", *(join([h, ", %"]) for h in heads)],
            exact,
            kind="wide",
            caption="Inputs that the fit takes as exact: no number above holds them. How far each quantity would move; say what "
            "you know of them in [priors], or with --inputs.",
        ),
        tag("p", "Not included, and without a sensitivity:"),
        bullets(unknown),
        table(
            ["carried on", Html("value ± <i>u</i><sub>c</sub>"), "95 % interval (draws)"],
            carried,
            caption=f"The linear hull. It keeps a straight line with a probability {probability_text(file.stable_probability)}.",
        ),
        _repeats(file),
        bullets(note for note in file.notes if not note.startswith("not included")),
        _every_line(file, names, heads),
    ]
    return tag("section", *parts, id="budget")


def _symbol(short: str) -> Html:
    return Html(SYMBOLS[short])


def _first(source: str, name: str) -> Html:
    return join([source, tag("small", name)])


def _infinite(text: str) -> str:
    return "∞" if text == "inf" else text


def _percent(share: float) -> str:
    return f"{100 * share:.1g} %" if share >= 1e-5 else "0.001 %"


def _shade(share: float) -> Html:
    """A share, darker the larger."""
    return tag(
        "span",
        share_text(share),
        style=f"font-weight:{700 if share >= 0.1 else 400};opacity:{1 if share >= 0.01 else 0.55}",
    )


def _repeats(file: BudgetFile) -> Html:
    if not file.repeats:
        return Html("")
    rows = [
        [
            _symbol(SHORT[name]),
            number(significant(r.pooled_std, 2)),
            number(significant(r.stated_std, 2)),
            str(r.degrees),
            number(f"{r.ratio:.2f} ({r.interval[0]:.2f} to {r.interval[1]:.2f})"),
            f"{r.p_value:.3f}",
        ]
        for name, r in file.repeats.items()
    ]
    groups = "; ".join(", ".join(group) for group in file.repeated)
    return table(
        ["repeats", "pooled scatter", "its own lines say", Html("<i>ν</i>"), "ratio (95 %)", "p"],
        rows,
        caption=f"Type A check of the whole, runs of one set-up each fitted alone: {groups}. What they share is not seen here.",
    )


def _every_line(file: BudgetFile, names: list[str], heads: list[Html]) -> Html:
    rows = []
    for line in file.lines:
        told = [number(significant(line.sensitivity[n], 3)) if n in line.sensitivity else "" for n in names]
        std = (
            ""
            if line.std is None
            else number(f"{significant(line.std, 3)} {line.unit if line.unit != '1' else ''}".rstrip())
        )
        degrees = number(_infinite(degrees_text(line.degrees))) if line.status != "not included" else ""
        rows.append(
            [
                _first(line.source, f"{line.name} {line.run}".rstrip()),
                line.evaluation,
                std,
                degrees,
                *told,
                line.status,
                line.origin,
            ]
        )
    head = ["source", "type", Html("<i>u</i>(<i>x</i>)"), Html("<i>ν</i>"), *heads, "status", "where from"]
    caption = "Sensitivity coefficients: change of each quantity with one unit more of what is stated, SI."
    return tag(
        "details",
        tag("summary", "Every line with its sensitivity and where it comes from"),
        table(head, rows, kind="wide", caption=caption),
    )


# terminal -------------------------------------------------------------------------------------------------------------


def budget_tables(file: BudgetFile) -> list[Table]:
    """The tables for a terminal: values, sources, what is not included, what is carried on.

    Parameters
    ----------
    file : budget.json
    """
    names = list(file.quantities)
    short = [SHORT[n] for n in names]
    sources = [
        [r.source, r.name, r.evaluation, r.std, r.degrees, *(share_text(r.shares[n]) for n in names)]
        for r in source_rows(file)
    ]
    exact = [
        [r.source, r.name, r.step, *(moves_text(r.moves[n]) if r.step else "" for n in names)] for r in exact_rows(file)
    ]
    return [
        _plain(f"Uncertainty budget at {file.speed_m_s:g} m/s ({MEANT})", QUANTITY_HEAD, quantity_rows(file), 1),
        _plain("Share of the variance, %", ("source", "input", "type", "u(x)", "nu", *short), sources, 3),
        _plain("Not included: how far each would move, %", ("source", "input", "moved by", *short), exact, 3),
        _plain(
            "Carried on",
            ("quantity", "value", "95 % interval"),
            [[n, *carried_text(q)] for n, q in file.carried.items()],
            1,
        ),
    ]


def _plain(title: str, head: tuple[str, ...], rows: list[list[str]], left: int) -> Table:
    from rich.table import Table
    from rich.text import Text

    made = Table(title=Text(title), title_justify="left")
    for k, name in enumerate(head):
        made.add_column(name, justify="left" if k < left else "right")
    for row in rows:
        made.add_row(*(Text(cell) for cell in row))
    return made


__all__ = ["budget_section", "budget_tables"]
