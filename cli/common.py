"""What several commands share: arguments, progress, what is printed, exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

PIPE_WIDTH = 130
"""Columns of a table that does not go to a terminal."""
EXIT_OK, EXIT_ERROR, EXIT_USAGE, EXIT_SOME_FAILED, EXIT_INTERRUPTED = 0, 1, 2, 3, 130
"""docs/commands.md has them; 130 is a shell's code for an end by SIGINT, 128 + 2."""


def add_runs(sub: argparse.ArgumentParser) -> None:
    """The run folders of a command."""
    sub.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run folder (with a run.toml)")


def add_method(sub: argparse.ArgumentParser) -> None:
    """--method, of every command that maps tracks."""
    sub.add_argument(
        "--method",
        choices=("exact", "trapezoid", "trapezoid_corners"),
        default="exact",
        help="exact plane at each marker's depth (default), the thesis's trapezoid with its deck-height shift (4.2), or "
        "the trapezoid with its corners moved down",
    )


def add_line(sub: argparse.ArgumentParser) -> None:
    """--line, of every command that takes a tow's forces."""
    sub.add_argument(
        "--line",
        choices=("surge", "constant"),
        help="what the tow line keeps, instead of what tow.line says: its length (surge in full) or its tension",
    )


def add_effects(sub: argparse.ArgumentParser) -> None:
    """--effects, of every command that an effect of one's own may change."""
    sub.add_argument(
        "--effects",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE.py",
        help="effects of one's own; this RUNS the file as a program: name none that you would not run yourself",
    )


def add_fit(sub: argparse.ArgumentParser) -> None:
    """What a fit can be told."""
    add_line(sub)
    sub.add_argument(
        "--form",
        choices=("full", "linear"),
        default="full",
        help="full sine and kinematics (default) or the linear model",
    )
    sub.add_argument(
        "--speed", type=float, metavar="M_S", help="quote the derivatives at this speed (default: the runs' mean)"
    )
    sub.add_argument("--priors", type=Path, metavar="PRIORS.toml", help="priors instead of each run.toml's own")
    sub.add_argument(
        "--noise",
        choices=("auto", "output", "innovations"),
        default="auto",
        help="output error, a Kalman filter's innovations (a force pushes the hull about), or whichever the residuals show "
        "(default: auto)",
    )


def console() -> Any:
    """For tables: as wide as the terminal, or ``PIPE_WIDTH``."""
    from rich.console import Console

    plain = Console(highlight=False)
    return plain if plain.is_terminal else Console(highlight=False, width=PIPE_WIDTH)


def show_progress(follow: bool = False) -> AbstractContextManager[Callable[[str, int, int | None], None]]:
    """A progress line on the terminal; silent where the output is not one, unless it is to be followed."""
    from ..pipeline.progress import progress

    return progress(follow)


def print_notes(notes: Sequence[str]) -> None:
    """A line each."""
    for note in notes:
        print(f"note: {note}")


def read_batch(options: argparse.Namespace, fresh: bool = False):
    """Motion of all runs; raises where none can be used."""
    from ..pipeline.analysis import compute_motions
    from ..record.errors import TowlineError

    with show_progress() as show:
        batch = compute_motions(options.runs, options.method, show, fresh, getattr(options, "line", None))
    if not batch.runs:
        if len(batch.failed) == 1:
            raise TowlineError(next(iter(batch.failed.values())))
        options.outcome.fail(batch.failed)
        raise TowlineError("no run could be used")
    return batch


def exit_code(failed: dict[str, str]) -> int:
    """Of a command that ended, some of its runs maybe left out."""
    return EXIT_SOME_FAILED if failed else EXIT_OK
