"""One self-contained HTML page of an analysis: no request leaves it, every picture and style stands inside."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from ..record.errors import TowlineError
from ..record.files import reading, write_text
from ..record.results import DerivativesFile, SteadyFile
from ..record.tables import for_people
from .budget_section import budget_section
from .html import FIGURES, Drawn, Html, bullets, join, safe, tag
from .run_section import RunPage, frames_of, run_section
from .sections import Frames, derivatives_section, failed_box, summary
from .steady_section import steady_section

if TYPE_CHECKING:
    import pandas as pd

    from ..record.budget_file import BudgetFile

__all__ = ["RunPage", "csv_text", "document", "page_html", "write_document", "write_page"]

MARK = "# drawn in "
"""How the first line of a figure's data begins."""

# belt and braces: even if a string slipped through, the page may load nothing and run nothing
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def write_page(
    path: Path,
    title: str,
    runs: list[RunPage],
    derivatives: DerivativesFile | None,
    steady: SteadyFile | None,
    notes: list[str],
    free: DerivativesFile | None = None,
    budget: BudgetFile | None = None,
) -> None:
    """Write the page atomically.

    Parameters
    ----------
    path : of the HTML file
    title : heading of the page
    runs : what each run shows, in this order; failed ones with their ``problem``
    derivatives, steady : the results of all runs together, where there are
    notes : what the reader must know, said at the end
    free : the result of the free runs among them, where towed runs have ``derivatives``
    budget : of ``derivatives``, or None
    """
    write_document(path, page_html(title, runs, derivatives, steady, notes, free, budget))


def page_html(
    title: str,
    runs: list[RunPage],
    derivatives: DerivativesFile | None,
    steady: SteadyFile | None,
    notes: list[str],
    free: DerivativesFile | None = None,
    budget: BudgetFile | None = None,
) -> Html:
    """The page as text; parameters as ``write_page``.

    Parameters
    ----------
    title : of the page
    runs : their pages
    derivatives : of the tows, or None
    steady : steady.json, or None
    notes : sentences for the user
    free : derivatives of free runs, or None
    budget : of ``derivatives``, or None
    """
    failed = {run.name: run.problem for run in runs if run.problem}
    elsewhere = _failed_without_section(runs, derivatives)
    frames = sum((frames_of(run) for run in runs), Frames())
    parts: list[object] = [
        tag("h1", title),
        summary(len(runs) + len(elsewhere), len(failed) + len(elsewhere), frames, derivatives, steady),
        _contents(runs, derivatives, steady, notes, budget),
    ]
    if derivatives is not None:
        parts.append(derivatives_section(derivatives))
    if budget is not None:
        parts.append(budget_section(budget))
    if free is not None:
        parts.append(derivatives_section(free, "Free runs", "free"))
    if elsewhere:
        parts.append(failed_box("Runs that could not be used", elsewhere))
    if steady is not None:
        parts.append(steady_section(steady))
    for order, run in enumerate(runs, start=1):
        found = [file.runs[run.name] for file in (derivatives, free) if file is not None and run.name in file.runs]
        parts.append(run_section(run, order, found[0] if found else None))
    if notes:
        parts.append(tag("section", tag("h2", "Notes"), bullets(notes), id="notes"))
    parts.append(_footer(derivatives, steady))
    return document(title, tag("main", *parts))


def _failed_without_section(runs: list[RunPage], derivatives: DerivativesFile | None) -> dict[str, str]:
    shown = {run.name for run in runs if run.problem}
    if derivatives is None:
        return {}
    return {name: why for name, why in derivatives.failed.items() if name not in shown}


def _contents(
    runs: list[RunPage],
    derivatives: DerivativesFile | None,
    steady: SteadyFile | None,
    notes: list[str],
    budget: BudgetFile | None,
) -> Html:
    links: list[object] = []
    if derivatives is not None:
        links.append(tag("a", "Derivatives", href="#derivatives"))
    if budget is not None:
        links.append(tag("a", "Uncertainty budget", href="#budget"))
    if steady is not None:
        links.append(tag("a", "Steady tows", href="#steady"))
    for order, run in enumerate(runs, start=1):
        links.append(tag("a", f"{run.name} (failed)" if run.problem else run.name, href=f"#run-{order}"))
    if notes:
        links.append(tag("a", "Notes", href="#notes"))
    return tag("nav", join(links, " "))


def _footer(derivatives: DerivativesFile | None, steady: SteadyFile | None) -> Html:
    tools = {file.tool for file in (derivatives, steady) if file is not None}
    words = "Angles in degrees, α and β positive to starboard; y positive to starboard; ± is one standard deviation."
    if tools:
        words += f" Written by towline {', '.join(sorted(tools))}."
    return tag("footer", words)


def write_document(path: Path, page: Html) -> None:
    """Write the page, and what its pictures were drawn from into PAGE_figures/NAME.csv beside it; each file atomically.

    Data of an earlier page of that name that this one does not hold are removed.

    Parameters
    ----------
    path : of the file
    page : the document
    """
    folder = path.with_name(f"{path.stem}_figures")
    for one in page.drawn:
        _write_drawn(folder / f"{one.name}.csv", path.name, one)
    for old in folder.glob("*.csv") if folder.is_dir() else ():
        if old.stem not in {one.name for one in page.drawn} and _is_drawn(old):
            old.unlink()
    write_text(path, page.replace(f'href="{FIGURES}/', f'href="{quote(folder.name)}/'))


def _is_drawn(path: Path) -> bool:
    """Whether a file holds the data of a picture."""
    try:
        with reading(path) as stream:
            return stream.read(len(MARK)) == MARK.encode()
    except TowlineError:
        return False


def _write_drawn(path: Path, page: str, drawn: Drawn) -> None:
    numbers = csv_text(drawn.table)
    write_text(path, f"{MARK}{page}: {' '.join(drawn.what.split())}\n{numbers}")


def csv_text(table: pd.DataFrame) -> str:
    """As ``to_csv`` with ten digits writes it, in a fifth of the time: the numbers of a column by one format."""
    table = for_people(table)
    if table.shape[1] < 2:
        return table.to_csv(index=False, float_format="%.10g", lineterminator="\n")
    columns = []
    for name in table:
        values = table[name].to_numpy()
        if values.dtype.kind == "f":
            text = ("%.10g\n" * len(values) % tuple(values.tolist())).split("\n")[:-1]
            columns.append(["" if one == "nan" else one for one in text] if np.isnan(values).any() else text)
        else:
            texts = table[[name]].to_csv(index=False, header=False, lineterminator="\n").split("\n")[:-1]
            columns.append(["" if one == '""' else one for one in texts])
    head = table.iloc[:0].to_csv(index=False, lineterminator="\n")
    return head + "".join(f"{','.join(row)}\n" for row in zip(*columns, strict=True))


def document(title: str, body: Html) -> Html:
    """A whole self-contained page; the names of its pictures' data differ.

    Parameters
    ----------
    title : of the page
    body : of the page
    """
    names = [one.name for one in body.drawn]
    if len(set(names)) < len(names):
        raise ValueError(f"data of two pictures have one name: {sorted(names)}")
    style = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    return Html(
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{safe(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n",
        body.drawn,
    )
