"""``towline compare``: derivatives.json against a reference set."""

from __future__ import annotations

import argparse
from pathlib import Path

NAME = "compare"
HELP = "a derivatives.json against a reference set: value, sd, reference, difference relative and in sd"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("results", nargs="+", type=Path, metavar="derivatives.json")
    sub.add_argument(
        "--reference",
        required=True,
        metavar="ittc|southampton|FILE.csv",
        help="a built-in set (thesis tables 8.2 and 8.4), or a CSV of name,value[,std] in primes",
    )


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..identify.reference import compare_to_reference, comparison_lines, reference_set
    from ..record.results import DerivativesFile, read_result
    from ..report.format import SYMBOLS_TEXT

    reference = reference_set(options.reference)
    for path in options.results:
        result = read_result(path, DerivativesFile)
        found = compare_to_reference(result, reference)
        options.outcome.result[str(path)] = found
        print(f"{path}: at {result.speed_m_s:g} m/s, {result.density_kg_m3:g} kg/m3, LBP {result.length_pp_m:g} m")
        print("\n".join(comparison_lines(found, SYMBOLS_TEXT)))
        for note in found.notes:
            print(f"note: {note}")
    return 0
