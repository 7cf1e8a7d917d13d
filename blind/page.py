"""The page of a blind check: are the stated probabilities true ones, and what was right."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..report.draw import BLACK, BLUE, GREY, Columns, label, legend, new_figure, svg_image
from ..report.html import Html, figure, number, table, tag
from ..report.page import document, write_document
from .words import form_rows, named

if TYPE_CHECKING:
    from .check import Outcome
    from .scores import Bin, Score


def write_blind_page(path: Path, outcome: Outcome) -> None:
    """Write the page atomically.

    Parameters
    ----------
    path : of the file
    outcome : of the check
    """
    write_document(path, blind_page(outcome))


def blind_page(outcome: Outcome) -> Html:
    """The page as text."""
    parts = [
        tag("h1", f"Blind check of the diagnosis: {len(outcome.cases)} campaigns"),
        tag("p", "SHA-256 of the truth, made known before the first diagnosis: ", tag("code", outcome.digest)),
        tag("section", tag("h2", "Stated and true probability"), reliability_figure(outcome.bins)),
        tag("section", tag("h2", "Scores"), _scores(outcome.table)),
        tag("section", tag("h2", "Form by form"), _forms(outcome)),
        tag("section", tag("h2", "Case by case"), _cases(outcome)),
    ]
    return document("Blind check of the diagnosis", tag("main", *parts))


def reliability_figure(bins: list[Bin]) -> Html:
    """Share of right answers over stated probability, with 95 % intervals."""
    from .scores import interval

    drawing, (ax,) = new_figure(3.6)
    rows: list[tuple[float, ...]] = []
    ax.plot([0, 1], [0, 1], color=GREY, linewidth=1, linestyle="--", label="honest")
    for k, part in enumerate(bins):
        share = part.right / part.count
        low, high = interval(part.right, part.count)
        rows.append((part.mean, share, low, high, part.count))
        ax.plot([part.mean, part.mean], [low, high], color=BLUE, linewidth=1.4)
        named = "answers, 95 % interval" if k == 0 else None
        ax.plot([part.mean], [share], "o", color=BLUE, label=named)
        ax.annotate(str(part.count), (part.mean, share), (5, -10), textcoords="offset points", fontsize=8, color=BLACK)
    ax.set_xlim(0, 1.02)
    ax.set_ylim(-0.02, 1.02)
    label(ax, x="stated probability of the answer", y="share that was right")
    legend(ax, place="best")
    words = "Answers by stated probability; beside a point, how many. Above the line: too modest; below: too sure."
    head = ("stated_probability", "share_right", "from_95", "to_95", "answers")
    data: dict[str, Columns] = {"": dict(zip(head, (list(c) for c in zip(*rows)), strict=False))}
    return figure(svg_image(drawing, "share of right answers over stated probability", "reliability", data), words)


def _scores(scores: list[Score]) -> Html:
    methods = list(dict.fromkeys(s.method for s in scores))
    by = {(s.what, s.stratum, s.method): s for s in scores}
    rows = [
        [what, stratum, *(number(_cell(by.get((what, stratum, method)))) for method in methods)]
        for what, stratum in dict.fromkeys((s.what, s.stratum) for s in scores)
    ]
    words = (
        "Hits of how many, and the 95 % interval in per cent; numbers with theirs. D: how far the truth can be told from its "
        "nearest rival; at 20 two effects are told apart in 98.7 % of draws."
    )
    return table(["score", "of", *methods], rows, caption=words)


def _cell(score: Score | None) -> str:
    if score is None:
        return ""
    if score.hits is not None:
        return f"{score.hits}/{score.of} ({100 * score.low:.0f}-{100 * score.high:.0f})"
    spread = "" if score.low == score.high else f" ({score.low:.2g}-{score.high:.2g})"
    return f"{score.value:.3g}{spread} {score.unit}".strip()


def _forms(outcome: Outcome) -> Html:
    rows = [
        [row.effect, row.form, "kept out" if row.kept else ""]
        + [number(str(n)) for n in (row.cases, row.clear, row.outright, row.named, row.kin)]
        + [", ".join(row.others)]
        for row in form_rows(outcome.cases)
    ]
    words = (
        "Single effects by the form that reality gave them: how many, how many of these can be told (D above 20), and of those how "
        "many were named and called exact, named at all, or named within their class. Forms marked were kept out while the "
        "diagnosis was worked on."
    )
    head = ["effect", "form", "", "cases", "D > 20", "outright", "by name", "in class", "taken for"]
    return table(head, rows, caption=words)


def _cases(outcome: Outcome) -> Html:
    rows = []
    for case in outcome.cases:
        truth = " + ".join(case.held) or "nothing"
        forms = ", ".join(form for form in case.forms.values() if form)
        said = named(case.said)
        distance = "" if case.nearest is None else f"{case.nearest:.1f}"
        right = "right" if case.right(case.said) else "in class" if case.in_class(case.said) else "wrong"
        rows.append(
            [case.name, case.hull, truth, forms, number(distance), said, number(f"{case.probability:.2f}"), right]
        )
    return table(["case", "hull", "truth", "form", "D", "said", "p", ""], rows)
