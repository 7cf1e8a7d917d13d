"""``towline budget``: the uncertainty budget of a fit by the GUM: every source, its share, what is not included."""

from __future__ import annotations

import argparse
from pathlib import Path

from .common import add_fit, add_method, add_runs, console, print_notes, read_batch, show_progress

NAME = "budget"
HELP = (
    "uncertainty budget of the derivatives and of X_v by the GUM: out/budget.json, .csv, .tex, .html (docs/budget.md)"
)


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_runs(sub)
    add_method(sub)
    add_fit(sub)
    sub.add_argument(
        "--inputs",
        type=Path,
        metavar="INPUTS.toml",
        help="what is known of lines: degrees of freedom, where a number comes from, inputs that the fit takes as exact",
    )
    sub.add_argument(
        "--gap",
        type=Path,
        metavar="gap.json",
        help="the diagnosis of these runs (default: the one in the output folder)",
    )
    sub.add_argument("--docx", action="store_true", help="write budget.docx as well (pip install python-docx)")
    sub.add_argument("--no-page", action="store_true", help="write no HTML page")
    sub.add_argument("-o", "--out", type=Path, help="where results go (default: RUN/out, or out/ beside several runs)")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.analysis import by_line, identify_batch, output_folder
    from ..pipeline.budgeting import budget_batch
    from ..record.budget_file import BUDGET
    from ..record.errors import TowlineError
    from ..record.priors import read_priors
    from ..record.results import write_result
    from ..report.budget_page import write_budget_page
    from ..report.budget_paper import write_docx, write_tables
    from ..report.budget_rows import probability_text
    from ..report.budget_section import budget_tables
    from .common import exit_code

    out = options.out or output_folder(options.runs)
    towed, free = by_line(read_batch(options))
    if free.runs:
        raise TowlineError(f"{free.runs[0].run.name}: a free run; the budget is of towed runs")
    priors = None if options.priors is None else read_priors(options.priors)
    if options.gap is not None and not options.gap.is_file():
        raise TowlineError(f"{options.gap}: no such file; towline diagnose writes it")
    with show_progress() as show:

        def say(text: str) -> None:
            show(text, 0, None)

        answer = identify_batch(towed, options.form, options.speed, priors, say, options.noise)
        file = budget_batch(answer, options.inputs, options.gap or out / "gap.json", say)
    for table in budget_tables(file):
        console().print(table)
    print(f"straight-line stable with a probability {probability_text(file.stable_probability)}")
    print_notes(file.notes)
    options.outcome.result["budget"] = file
    write_result(out / BUDGET, file)
    options.outcome.wrote(out / BUDGET, *write_tables(out, file))
    if options.docx:
        write_docx(out / "budget.docx", file)
        options.outcome.wrote(out / "budget.docx")
    if not options.no_page:
        write_budget_page(out / "budget.html", file)
        options.outcome.wrote(out / "budget.html", word="page:")
    options.outcome.fail(answer.result.failed)
    return exit_code(answer.result.failed)
