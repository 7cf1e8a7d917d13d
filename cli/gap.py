"""``towline gap``: what a model of one's own, a Python file or an FMU, misses against measured records."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

NAME = "gap"
HELP = "what a model of your own (a Python file, an FMU) misses against your records (out/gap.json, corrected.py, corrected.json)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument(
        "model",
        type=Path,
        metavar="MODEL",
        help="MODEL.py with a Model, or MODEL.fmu; this RUNS the file as a program: name none that you would not run yourself",
    )
    sub.add_argument(
        "tables", nargs="+", type=Path, metavar="DATA", help="records: CSV, Parquet, MAT, MCAP or a ROS bag"
    )
    sub.add_argument(
        "--columns",
        type=Path,
        metavar="FILE.toml",
        help="what the columns are (default: NAME.toml beside NAME.csv, else data.toml)",
    )
    sub.add_argument(
        "--hold-out",
        nargs="+",
        type=Path,
        default=[],
        metavar="DATA",
        help="records kept aside to measure the shrink on",
    )
    sub.add_argument(
        "--law", action="store_true", help="search a missing term of the states, too, for what no effect explains"
    )
    sub.add_argument(
        "--try",
        dest="tried",
        nargs="+",
        type=Path,
        default=[],
        metavar="INPUTS",
        help="tables of inputs that could come next: which would best tell what is still open ([[next]] of data.toml: a box)",
    )
    sub.add_argument(
        "--fmu",
        action="store_true",
        help="write the corrected model as an FMU as well (corrected.fmu; needs pythonfmu)",
    )
    sub.add_argument("-o", "--out", type=Path, help="where the results go (default: out beside the first table)")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..diagnose.own.back_fmu import check_wrappable
    from ..diagnose.own.read import read_model
    from ..pipeline.own_models import gap_of_model, write_fmu, write_gap
    from .common import EXIT_OK, print_notes, show_progress

    if options.fmu:
        check_wrappable(read_model(options.model))
    with show_progress() as show:

        def tell(text: str, done: int, total: int | None) -> None:
            if sys.stderr.isatty():
                show(text, done, total)
            else:
                print(f"{text} ...", file=sys.stderr, flush=True)

        found = gap_of_model(
            options.model, options.tables, options.columns, options.hold_out, tell, options.tried, options.law
        )
    file = found.file
    out = options.out or options.tables[0].parent / "out"
    written = write_gap(out, found, options.model)
    print_notes(found.notes)
    for sentence in file.sentences:
        print(sentence)
    print()
    print(f"{'hypothesis':44}{'probability':>12}{'gap before':>12}{'after':>8}{'shrink':>8}")
    print(f"{'no gap':44}{file.p_no_gap:12.3f}")
    for row in file.ranking[:5]:
        name = " + ".join(row.effects)
        print(f"{name:44}{row.named:12.3f}{row.gap_before:12.2f}{row.gap_after:8.2f}{row.shrink:8.2f}")
    print(f"{'unknown':44}{file.p_unknown:12.3f}")
    print(f"where: {', '.join(f'{stage} {share:.2f}' for stage, share in file.where.share.items())}")
    options.outcome.result["gap"] = file
    if options.fmu:
        written += write_fmu(out, found, options.model)
    options.outcome.wrote(*written)
    return EXIT_OK
