"""``towline export``: results for MATLAB (.mat) and for control design (a state-space model)."""

from __future__ import annotations

import argparse
from pathlib import Path

NAME = "export"
HELP = "runs to MATLAB (--mat), or derivatives.json to a state-space model for python-control (--state-space)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument(
        "sources", nargs="+", type=Path, metavar="SOURCE", help="run folders (--mat), or one derivatives.json"
    )
    what = sub.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--mat", type=Path, metavar="OUT.mat", help="motion, tracks and derivatives with their covariance"
    )
    what.add_argument("--state-space", type=Path, metavar="MODEL.json", help="A, B, C, D of the linear tow model")
    sub.add_argument(
        "--derivatives",
        type=Path,
        metavar="FILE.json",
        help="--mat: the derivatives (default: derivatives.json in the runs' common out/)",
    )
    sub.add_argument(
        "--run",
        type=Path,
        metavar="RUN",
        help="--state-space: whose settings (default: the run whose out/ holds SOURCE)",
    )


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.exporting import export_mat, state_space
    from ..record.errors import InputError
    from ..record.results import write_result
    from .common import EXIT_OK, EXIT_SOME_FAILED, show_progress

    if options.mat is not None:
        with show_progress() as show:
            found = export_mat(options.mat, options.sources, options.derivatives, show)
        if found.derivatives is None:
            print("note: no derivatives.json stands in the runs' common out/; the file holds motion and tracks only")
        options.outcome.result |= {"runs": found.runs, "derivatives": found.derivatives}
        options.outcome.wrote(options.mat, more=f": {', '.join(found.runs)}")
        options.outcome.fail(found.failed)
        return EXIT_SOME_FAILED if found.failed else EXIT_OK
    if len(options.sources) > 1:
        raise InputError(options.sources[1], "", "--state-space takes one derivatives.json")
    model = state_space(options.sources[0], options.run)
    write_result(options.state_space, model)
    print(f"{model.run}: " + ", ".join(f"{name} {value:g}" for name, value in model.settings.items()))
    for pole in model.poles:
        print(f"  {pole.real.value:+.4f} +- {pole.real.std:.1g}  {pole.imag.value:+.4f}i +- {pole.imag.std:.1g}  1/s")
    for note in model.notes:
        print(f"note: {note}")
    options.outcome.result["state_space"] = model
    options.outcome.wrote(options.state_space)
    return EXIT_OK
