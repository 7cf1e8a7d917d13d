"""One self-contained HTML page of an analysis: no request leaves it, every picture and style stands inside."""

from __future__ import annotations

from pathlib import Path

from ..record.files import write_text
from ..record.results import DerivativesFile, SteadyFile
from .html import Html, bullets, join, safe, tag
from .run_section import RunPage, frames_of, run_section
from .sections import Frames, derivatives_section, failed_box, summary
from .steady_section import steady_section

__all__ = ["RunPage", "page_html", "write_page"]

# belt and braces: even if a string slipped through, the page may load nothing and run nothing
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def write_page(
    path: Path,
    title: str,
    runs: list[RunPage],
    derivatives: DerivativesFile | None,
    steady: SteadyFile | None,
    notes: list[str],
) -> None:
    """Write the page atomically.

    Parameters
    ----------
    path : of the HTML file
    title : heading of the page
    runs : what each run shows, in this order; failed ones with their ``problem``
    derivatives, steady : the results of all runs together, where there are
    notes : what the reader must know, said at the end
    """
    write_text(path, page_html(title, runs, derivatives, steady, notes))


def page_html(
    title: str,
    runs: list[RunPage],
    derivatives: DerivativesFile | None,
    steady: SteadyFile | None,
    notes: list[str],
) -> str:
    """The page as text; parameters as ``write_page``."""
    failed = {run.name: run.problem for run in runs if run.problem}
    elsewhere = _failed_without_section(runs, derivatives)
    frames = sum((frames_of(run) for run in runs), Frames())
    parts: list[object] = [
        tag("h1", title),
        summary(len(runs) + len(elsewhere), len(failed) + len(elsewhere), frames, derivatives, steady),
        _contents(runs, derivatives, steady, notes),
    ]
    if derivatives is not None:
        parts.append(derivatives_section(derivatives))
    if elsewhere:
        parts.append(failed_box("Runs that could not be used", elsewhere))
    if steady is not None:
        parts.append(steady_section(steady))
    for order, run in enumerate(runs, start=1):
        parts.append(run_section(run, order, derivatives.runs.get(run.name) if derivatives else None))
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
    runs: list[RunPage], derivatives: DerivativesFile | None, steady: SteadyFile | None, notes: list[str]
) -> Html:
    links: list[object] = []
    if derivatives is not None:
        links.append(tag("a", "Derivatives", href="#derivatives"))
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


def document(title: str, body: Html) -> str:
    """A whole self-contained page."""
    style = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{safe(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )
