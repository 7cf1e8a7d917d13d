"""The score as a table of text: rows are scores, columns the diagnosis and the baselines."""

from __future__ import annotations

from collections.abc import Sequence

from .check import Outcome
from .judge import NO_GAP, NONE, Call, Judged
from .scores import Score

WIDE = 21
"""Letters to a column of the table."""


def score_text(outcome: Outcome) -> str:
    """The table, the effects one by one, and what went wrong."""
    lines = [f"sha256 of the truth: {outcome.digest}", _kinds(outcome.cases), "", *_table(outcome.table), ""]
    lines += _by_effect(outcome.cases)
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
    return " + ".join(sorted(call)) if call != NONE else "(no answer)"


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


__all__ = ["named", "score_text"]
