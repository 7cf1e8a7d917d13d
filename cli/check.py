"""``towline check``: is the camera geometry right? No hydrodynamics needed."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

NAME = "check"
HELP = (
    "what the datum, the marks' distances and the taut line say of the camera geometry (out/check.json, out/check.html)"
)
REFINE = "deck_height,k1,k2,focal,centre,datum_width,datum_length,datum_scale,line_length,tow_point,post_ahead"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    from .common import add_line

    add_line(sub)
    sub.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="run folders; those of one camera are checked together"
    )
    sub.add_argument(
        "--refine",
        default="",
        metavar="NAMES",
        help=f"estimate these from the invariants over all runs, and say what cannot be told: {REFINE}; run.toml stays",
    )
    sub.add_argument(
        "--no-effects", action="store_true", help="leave out the camera's share in each derivative (faster)"
    )
    sub.add_argument("--no-page", action="store_true", help="write no HTML page")
    sub.add_argument("-o", "--out", type=Path, help="where check.json and check.html go (default: RUN/out)")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.analysis import output_folder
    from ..pipeline.checking import agreements, checked, filmed_runs, set_ups
    from ..record.results import write_result
    from .common import EXIT_OK, EXIT_SOME_FAILED, show_progress

    wanted = [name for name in options.refine.split(",") if name]
    with show_progress() as show:
        runs, tables, failed = filmed_runs(options.runs, show, options.line)
    for stem, some, their in set_ups(runs, tables):
        with show_progress() as show:
            found = checked(some, their, wanted, not options.no_effects, lambda text: show(text, 0, None))
        out = options.out or output_folder([run.folder for run in some])
        write_result(out / f"{stem}.json", found.file)
        _print(found.file)
        paths = [out / f"{stem}.json"]
        if not options.no_page:
            from ..report.check_page import write_check_page

            write_check_page(out / f"{stem}.html", found)
            paths.append(out / f"{stem}.html")
        options.outcome.result.setdefault("checks", []).append(found.file)
        options.outcome.wrote(*paths)
    with show_progress() as show:
        together, unmatched = agreements([folder for folder in options.runs if str(folder) not in failed], show)
    for name, said in together.items():
        print(f"{name}: {said.cameras[0]} and {said.cameras[1]} {'agree' if said.agree else 'do not agree'}")
        for sentence in said.sentences:
            print(f"  {sentence}")
        options.outcome.result.setdefault("cameras", {})[name] = said
    failed |= unmatched
    options.outcome.fail(failed)
    return EXIT_SOME_FAILED if failed else EXIT_OK


def _print(file: Any) -> None:
    print(f"{', '.join(file.runs)}: {file.verdict}")
    for sentence in file.sentences:
        print(f"  {sentence}")
    if file.verdict == "mistake":
        return
    for point in file.datum:
        px, mm = point.residual_px, point.residual_mm
        left = "" if point.used else "  left out"
        print(
            f"  datum {point.name}: {px[0]:+.2f} {px[1]:+.2f} px (picked to {point.sigma_px:g}), "
            f"x {mm[0]:+.1f} y {mm[1]:+.1f} mm{left}"
        )
    for name, values in file.invariants.items():
        for what, value in values.items():
            print(f"  {name}: {what} off by {1e3 * value.value:+.2f} mm (scatter {1e3 * value.std:.2f})")
    grid = file.uncertainty
    x, y = (max(max(row) for row in rows) for rows in (grid.x_mm, grid.y_mm))
    print(f"  common error over the working area: x up to {x:.2f} mm, y up to {y:.2f} mm")
    if file.effects_percent:
        keys = list(file.effects_percent)
        print("  one standard deviation of the camera's parameters changes, in %:")
        print(f"    {'':32}" + "".join(f"{key:>16}" for key in keys))
        for parameter in next(iter(file.effects_percent.values())):
            print(
                f"    {parameter:32}"
                + "".join(f"{file.effects_percent[key].get(parameter, float('nan')):16.2f}" for key in keys)
            )
    for value in file.refined:
        told = "" if value.observable else "  (not told by these runs)"
        print(
            f"  refined {value.parameter}: {value.value:.5g} +- {value.std:.2g} {value.unit} (stated {value.stated:.5g}){told}"
        )
    for sentence in file.refined_words:
        print(f"  {sentence}")
    for note in file.notes:
        print(f"note: {note}")
