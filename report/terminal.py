"""The result tables for a terminal, as rich renderables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..record.results import DerivativesFile, SteadyFile
from .format import Row, derivative_rows, interval_text, steady_rows

if TYPE_CHECKING:
    from rich.table import Table


def derivatives_table(result: DerivativesFile) -> Table:
    """The derivatives with their standard deviations; the true columns appear where a run carries its truth.

    Parameters
    ----------
    result : of the fit
    """
    title = f"Derivatives at {result.speed_m_s:g} m/s ({result.method}, {result.form} equations)"
    return _table(title, "derivative", derivative_rows(result), primes=True)


def steady_table(result: SteadyFile) -> Table:
    """What the steady tows give: X_v, the slope of the line, the rest where known, X_v of every two tows.

    Parameters
    ----------
    result : of the steady analysis
    """
    title = f"Steady tows; X_v lies in {interval_text(*result.x_v_interval_m)} m (95 %)"
    return _table(title, "quantity", steady_rows(result), primes=False)


def steady_sources_table(result: SteadyFile) -> Table | None:
    """What every source does to X_v, the largest first; None where the file has no budget.

    Parameters
    ----------
    result : of the steady analysis
    """
    from rich.table import Table
    from rich.text import Text

    budget = result.x_v_budget
    if budget is None or not budget.lines:
        return None
    title = f"Budget of X_v: u {1e3 * budget.combined_m:.2g} mm, k {budget.coverage_factor:.2f}, U {1e3 * budget.expanded_m:.2g} mm"
    table = Table(title=Text(title), title_justify="left")
    for name in ("source", "input", "tow", "type"):
        table.add_column(name)
    for name in ("u(X_v), mm", "share, %"):
        table.add_column(name, justify="right", no_wrap=True)
    for line in sorted(budget.lines, key=lambda line: -line.share):
        cells = [line.source, line.name, line.run, line.evaluation]
        table.add_row(*(Text(c) for c in cells), f"{1e3 * line.contribution_m:.2g}", f"{100 * line.share:.0f}")
    return table


def _table(title: str, first: str, rows: list[Row], *, primes: bool) -> Table:
    from rich.table import Table
    from rich.text import Text

    known = any(row.true != "-" for row in rows)
    table = Table(title=Text(title), title_justify="left")
    table.add_column(first, no_wrap=True)
    for name in ("value", "std"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit")
    table.add_column("%", justify="right", no_wrap=True)
    if primes:
        table.add_column("prime x1e3", justify="right", no_wrap=True)
    if known:
        table.add_column("true", justify="right", no_wrap=True)
        table.add_column("deviation in std", justify="right")
    for row in rows:
        cells = [row.symbol, row.value, row.std, row.unit, row.percent]
        if primes:
            cells.append(f"{row.prime} +- {row.prime_std}")
        if known:
            cells += [row.true, row.deviation]
        table.add_row(*(Text(cell) for cell in cells))
    return table
