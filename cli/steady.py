"""``towline steady``: the neutral point."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .common import (
    add_line,
    add_method,
    add_runs,
    console,
    exit_code,
    print_notes,
    read_batch,
)

NAME = "steady"
HELP = "neutral point X_v from steady tows at two or more tow points (out/steady.json)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_runs(sub)
    add_method(sub)
    add_line(sub)
    sub.add_argument("-o", "--out", type=Path, help="where steady.json goes")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.analysis import output_folder

    batch = read_batch(options)
    result = steady_and_write(options, batch, options.out or output_folder(options.runs))
    options.outcome.fail(result.failed)
    return exit_code(result.failed)


def steady_and_write(options: argparse.Namespace, batch: Any, out: Path) -> Any:
    """X_v: write steady.json and print its table; returns it."""
    from ..pipeline.analysis import fit_steady_batch
    from ..record.results import write_result
    from ..report import steady_sources_table, steady_table

    result = fit_steady_batch(batch)
    write_result(out / "steady.json", result)
    console().print(steady_table(result))
    sources = steady_sources_table(result)
    if sources is not None:
        console().print(sources)
    print_notes(result.notes)
    options.outcome.result["steady"] = result
    options.outcome.wrote(out / "steady.json")
    return result
