"""The score as a table of text: rows are scores, columns the diagnosis and the baselines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .check import Outcome
from .judge import INEXACT, NO_GAP, NONE, Call, Judged, names_of
from .scores import Score

WIDE = 21
"""Letters to a column of the table."""


def score_text(outcome: Outcome) -> str:
    """The table, the effects one by one, and what went wrong."""
    lines = [f"sha256 of the truth: {outcome.digest}", _kinds(outcome.cases), "", *_table(outcome.table), ""]
    lines += _by_effect(outcome.cases)
    lines += ["", *_by_form(outcome.cases)]
    wrong = [c for c in outcome.cases if not c.in_class(c.said)]
    if wrong:
        lines += ["", "not right:"]
        lines += [
            f"  {c.name}  {c.kind:8}{_d(c):>10}  {' + '.join(c.held) or 'nothing':44} said {named(c.said)} {c.probability:.2f}"
            for c in wrong
        ]
    if outcome.missing:
        lines += ["", f"without an answer yet: {len(outcome.missing)}"]
    return "\n".join(lines) + "\n"


def named(call: Call) -> str:
    """A call in words."""
    if call == NO_GAP:
        return "no gap"
    words = " + ".join(sorted(names_of(call)))
    return "(no answer)" if call == NONE else f"{words} ({INEXACT})" if INEXACT in call else words


def _d(case: Judged) -> str:
    return "" if case.nearest is None else f"D {min(case.nearest, 99999):.0f}"


def _kinds(cases: Sequence[Judged]) -> str:
    counts = {kind: sum(c.kind == kind for c in cases) for kind in ("effect", "pair", "null", "unknown")}
    return f"{len(cases)} campaigns: " + ", ".join(f"{n} {kind}" for kind, n in counts.items())


def _table(table: Sequence[Score]) -> list[str]:
    methods = list(dict.fromkeys(s.method for s in table))
    head = f"{'score':36}{'of':18}" + "".join(f"{m:>{WIDE}}" for m in methods)
    rows = list(dict.fromkeys((s.what, s.stratum) for s in table))
    by = {(s.what, s.stratum, s.method): s for s in table}
    lines = [head, "-" * len(head)]
    for what, stratum in rows:
        cells = [by.get((what, stratum, m)) for m in methods]
        lines.append(f"{what:36}{stratum:18}" + "".join(f"{_cell(s):>{WIDE}}" for s in cells))
    return [line.rstrip() for line in lines]


def _cell(score: Score | None) -> str:
    if score is None:
        return ""
    if score.hits is not None:
        return f"{score.hits}/{score.of} ({100 * score.low:.0f}-{100 * score.high:.0f} %)"
    unit = f" {score.unit}" if score.unit else ""
    if score.low == score.high:
        return f"{score.value:.3g}{unit}"
    return f"{score.value:.3g} ({score.low:.2g}-{score.high:.2g}){unit}"


def _by_effect(cases: Sequence[Judged]) -> list[str]:
    names = sorted({name for c in cases if c.kind == "effect" for name in c.truth})
    lines = [f"{'single effect':24}{'cases':>6}{'D > 20':>8}{'of these right':>16}{'in class':>10}   taken for"]
    for name in names:
        here = [c for c in cases if c.kind == "effect" and name in c.truth]
        clear = [c for c in here if c.clear]
        right, kin = sum(c.right(c.said) for c in clear), sum(c.in_class(c.said) for c in clear)
        others = sorted({named(c.said) for c in clear if not c.right(c.said)})
        lines.append(f"{name:24}{len(here):6}{len(clear):8}{right:16}{kin:10}   {', '.join(others)}".rstrip())
    return lines


@dataclass(frozen=True)
class FormRow:
    """Single effects of one form.

    Attributes
    ----------
    effect, form, kept : which; kept out or not
    cases, clear : how many; how many of them can be told
    outright, named, kin : of these: right and exact, right by name, right within their class
    others : what else was said of these
    """

    effect: str
    form: str
    kept: bool
    cases: int
    clear: int
    outright: int
    named: int
    kin: int
    others: list[str]


def form_rows(cases: Sequence[Judged]) -> list[FormRow]:
    """Effect by effect and form by form, in alphabetical order.

    Parameters
    ----------
    cases : judged ones
    """
    groups: dict[tuple[str, str], list[Judged]] = {}
    for case in cases:
        if case.kind == "effect":
            (effect,) = case.held
            groups.setdefault((effect, case.forms.get(effect, "")), []).append(case)
    rows = []
    for (effect, form), here in sorted(groups.items()):
        clear = [c for c in here if c.clear]
        rows.append(
            FormRow(
                effect,
                form,
                any(c.kept for c in here),
                len(here),
                len(clear),
                sum(c.right(c.said) for c in clear),
                sum(c.named_right(c.said) for c in clear),
                sum(c.in_class(c.said) for c in clear),
                sorted({named(c.said) for c in clear if not c.named_right(c.said)}),
            )
        )
    return rows


def _by_form(cases: Sequence[Judged]) -> list[str]:
    lines = [
        f"{'form (*: kept out)':46}{'cases':>6}{'D > 20':>8}{'outright':>10}{'by name':>9}{'in class':>10}   taken for"
    ]
    for row in form_rows(cases):
        name = f"{row.effect}: {row.form}{' *' if row.kept else ''}"
        counts = f"{row.cases:6}{row.clear:8}{row.outright:10}{row.named:9}{row.kin:10}"
        lines.append(f"{name:46}{counts}   {', '.join(row.others)}".rstrip())
    return lines


__all__ = ["FormRow", "form_rows", "named", "score_text"]
