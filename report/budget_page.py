"""The uncertainty budget as a page of its own."""

from __future__ import annotations

from pathlib import Path

from ..record.budget_file import BudgetFile
from .budget_section import budget_section
from .html import tag
from .page import document, write_document


def write_budget_page(path: str | Path, file: BudgetFile) -> None:
    """budget.html: the section by itself.

    Parameters
    ----------
    path : of the file
    file : budget.json
    """
    title = f"Uncertainty budget: {', '.join(file.runs)}"
    words = f"± is one standard uncertainty. Written by towline {file.tool}."
    body = tag("main", tag("h1", title), budget_section(file), tag("footer", words))
    write_document(Path(path), document(title, body))


__all__ = ["write_budget_page"]
