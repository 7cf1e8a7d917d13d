"""The budget as files for others: CSV of every line, a LaTeX table (booktabs), a DOCX of the tables (python-docx, an extra)."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

from ..record.budget_file import BudgetFile
from ..record.files import replacing, write_text
from .budget_rows import (
    MEANT,
    QUANTITY_HEAD,
    SHORT,
    carried_text,
    exact_rows,
    moves_text,
    quantity_rows,
    share_text,
    source_rows,
)

CSV_HEAD = (
    "quantity", "value", "unit", "source", "input", "run", "type", "input_std", "input_unit", "degrees", "sensitivity",
    "contribution", "share", "status", "origin",
)  # fmt: skip
TEX = {"m'": "$m'$", "I'": "$I'$", "Y_delta": r"$Y_\delta$", "N_delta": r"$N_\delta$"}
"""Symbols that are not a letter with an index."""
PLAIN = "Table Grid"
"""Style of a DOCX table that every Word has."""


def budget_csv(file: BudgetFile) -> str:
    """A row for each quantity and line; a row ``combined`` and a row ``expanded`` end each quantity.

    Parameters
    ----------
    file : budget.json
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_HEAD)
    for name, q in file.quantities.items():
        first = [name, repr(q.value), q.unit]
        for line in file.lines:
            numbers = [line.degrees, line.sensitivity.get(name), line.contribution.get(name), line.share.get(name)]
            degrees, *rest = ("" if n is None else repr(n) for n in numbers)
            std = "" if line.std is None else repr(line.std)
            degrees = degrees or ("" if line.status == "not included" else "inf")
            writer.writerow(
                [
                    *first,
                    line.source,
                    line.name,
                    line.run,
                    line.evaluation,
                    std,
                    line.unit,
                    degrees,
                    *rest,
                    line.status,
                    line.origin,
                ]
            )
        degrees = "inf" if q.degrees is None else repr(q.degrees)
        said = [
            ("combined", q.combined_std, "JCGM 100, 5.1.2"),
            ("expanded", q.expanded, f"k = {q.coverage_factor:.3f}, 95 %"),
        ]
        for word, u, origin in said:
            writer.writerow([*first, word, "", "", "", "", "", degrees, "", repr(u), "", "", origin])
    return text.getvalue()


def budget_tex(file: BudgetFile) -> str:
    """A LaTeX table for a paper: sources by their share of the variance, then the combined and expanded uncertainties.

    Parameters
    ----------
    file : budget.json
    """
    names = list(file.quantities)
    rows = [
        rf"% towline {file.tool}; needs \usepackage{{booktabs}}",
        r"\begin{table}",
        r"\caption{Uncertainty budget at $U = " + f"{file.speed_m_s:.4g}" + r"$ m/s: shares of the variance in \%, "
        r"$m' = m - Y_{\dot v}$, $I' = I - N_{\dot r}$, $Y_R = Y_r - mU$; $U_{95} = k u_c$.}",
        r"\centering\small",
        r"\begin{tabular}{llcll" + "r" * len(names) + "}",
        r"\toprule",
        " & ".join(["source", "input", "type", "$u(x)$", r"$\nu$", *(_symbol(SHORT[n]) for n in names)]) + r" \\",
        r"\midrule",
    ]
    for row in source_rows(file):
        cells = [row.source, row.name, row.evaluation, row.std, row.degrees]
        cells = [_escaped(cell) for cell in cells] + [share_text(row.shares[n]) for n in names]
        rows.append(" & ".join(cells).replace("inf", r"$\infty$") + r" \\")
    rows.append(r"\midrule")
    kept = {"value": 1, "unit": 2, "$u_c$": 4, r"$\nu_{\mathrm{eff}}$": 5, "$k$": 6, "$U_{95}$": 7, r"$U_{95}$, \%": 8}
    shown = quantity_rows(file)
    for head, place in kept.items():
        cells = [_minus(_escaped(row[place])).replace("inf", r"$\infty$") for row in shown]
        rows.append(rf"\multicolumn{{5}}{{l}}{{{head}}} & " + " & ".join(cells) + r" \\")
    rows += [r"\bottomrule", r"\end{tabular}", r"\end{table}", ""]
    return "\n".join(rows)


def _symbol(text: str) -> str:
    return TEX.get(text) or f"${text}$"


def _escaped(text: str) -> str:
    return re.sub(r"([_%&#])", r"\\\1", text)


def _minus(text: str) -> str:
    return re.sub(r"^-", "$-$", text)


def write_docx(path: str | Path, file: BudgetFile) -> None:
    """The same as a Word document: values, sources, what is not included, what is carried on.

    Parameters
    ----------
    path : of the file
    file : budget.json

    Raises
    ------
    ModuleNotFoundError : python-docx is not installed (the extra ``docx``)
    """
    from docx import Document

    names = list(file.quantities)
    document = Document()
    document.add_heading("Uncertainty budget", level=1)
    document.add_paragraph(f"Runs {', '.join(file.runs)}; at {file.speed_m_s:g} m/s, {file.form} equations. {MEANT}.")
    _table(document, QUANTITY_HEAD, quantity_rows(file))
    document.add_heading("Sources, share of the variance in %", level=2)
    rows = [
        [r.source, r.name, r.evaluation, r.std, r.degrees, *(share_text(r.shares[n]) for n in names)]
        for r in source_rows(file)
    ]
    _table(document, ("source", "input", "type", "u(x)", "nu", *(SHORT[n] for n in names)), rows)
    document.add_heading("Not included", level=2)
    rows = [
        [r.source, r.name, r.step, *(moves_text(r.moves[n]) if r.step else "" for n in names), r.why]
        for r in exact_rows(file)
    ]
    _table(document, ("source", "input", "moved by", *(f"{SHORT[n]}, %" for n in names), "why"), rows)
    document.add_heading("Carried on", level=2)
    _table(
        document, ("quantity", "value", "95 % interval"), [[name, *carried_text(q)] for name, q in file.carried.items()]
    )
    for note in file.notes:
        document.add_paragraph(note, style="List Bullet")
    with replacing(path) as temporary, temporary.open("wb") as stream:
        document.save(stream)


def _table(document, head, rows) -> None:
    from docx.shared import Pt

    table = document.add_table(rows=1, cols=len(head))
    table.style = PLAIN
    for row in (head, *rows):
        cells = table.rows[0].cells if row is head else table.add_row().cells
        for cell, text in zip(cells, row, strict=True):
            run = cell.paragraphs[0].add_run(text.replace("+-", "±"))
            run.font.size, run.bold = Pt(8), row is head


def write_tables(out: Path, file: BudgetFile) -> list[Path]:
    """budget.csv and budget.tex into a folder; returns their paths.

    Parameters
    ----------
    out : folder
    file : budget.json
    """
    paths = [out / "budget.csv", out / "budget.tex"]
    for path, text in zip(paths, (budget_csv(file), budget_tex(file)), strict=True):
        write_text(path, text)
    return paths


__all__ = ["budget_csv", "budget_tex", "write_docx", "write_tables"]
