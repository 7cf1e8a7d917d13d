"""``towline run``: everything, from video to page."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..record.names import lines_joined
from .common import (
    EXIT_ERROR,
    add_fit,
    add_method,
    add_runs,
    exit_code,
    read_batch,
)
from .identify import fit_and_write, fit_free_and_write
from .motion import motion_found, motion_line
from .steady import steady_and_write

NAME = "run"
HELP = "everything: video to tracks, motion, derivatives or steady state, and an HTML page"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_runs(sub)
    add_method(sub)
    add_fit(sub)
    sub.add_argument("-o", "--out", type=Path, help="where results go (default: RUN/out, or out/ beside several runs)")
    sub.add_argument("--fresh", action="store_true", help="redo stages whose results are up to date")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.analysis import Batch, good_for, has_rudder, has_tension, output_folder
    from ..pipeline.mistaken import mistake_lines
    from ..pipeline.stages import make_run_page
    from ..record.budget_file import budget_beside
    from ..record.errors import TowlineError
    from ..report import write_page

    batch = read_batch(options, options.fresh)
    out = options.out or output_folder(options.runs)
    for m in batch.runs:
        print(f"{m.run.name}: {motion_line(m)}")
        for line in mistake_lines(m.run, m.camera.notes if m.camera is not None else []):
            print(f"towline: {line}", file=sys.stderr)
    options.outcome.result["runs"] = {m.run.name: motion_found(m) for m in batch.runs}
    options.outcome.result["against_truth"] = _truth_lines(batch.runs)
    failed = dict(batch.failed)
    problems: list[str] = []
    remarks: list[str] = []
    identified = steady = free = None
    fitted: dict[str, Any] = {}
    kinds = [good_for(m) for m in batch.runs]
    settled = [m for m, good in zip(batch.runs, kinds, strict=True) if "steady" in good]
    tensioned = [m for m, good in zip(batch.runs, kinds, strict=True) if "derivatives" in good]
    if tensioned:
        try:
            identified = fit_and_write(options, Batch(tensioned, batch.failed), out)
            failed |= identified.result.failed
            fitted = identified.fitted
        except TowlineError as error:
            problems.append(f"no derivatives: {lines_joined(str(error))}")
    if len({m.run.tow.tow_point_m for m in settled}) > 1:
        try:
            steady = steady_and_write(options, Batch(settled, batch.failed), out)
            # a tow that is not steady may have served the derivatives
            failed |= {name: why for name, why in steady.failed.items() if name not in fitted}
        except TowlineError as error:
            (remarks if identified is not None else problems).append(f"no neutral point: {lines_joined(str(error))}")
    elif settled and not tensioned:
        why = "the tows were at rest from their first frame" if has_tension(settled[0]) else "no tension is given"
        problems.append(f"no derivatives: {why}; no neutral point: steady tows at two or more tow points are needed")
    steered = [m for m in batch.runs if has_rudder(m)]
    if steered:
        try:
            alone = len(steered) == len(batch.runs)
            free = fit_free_and_write(options, Batch(steered, batch.failed if alone else {}), out, identified)
            failed |= free.result.failed
            fitted |= free.fitted
        except TowlineError as error:
            problems.append(f"no derivatives from the free runs: {lines_joined(str(error))}")
    silent = [m.run.name for m in batch.runs if m.run.file.kind == "free" and not has_rudder(m)]
    if silent:
        remarks.append(
            f"no derivatives from {', '.join(silent)}: a free run gives its motion only, unless [tow] says its speed and its "
            "rudder (tow.rudder or tow.rudder_rad)"
        )
    notes = [*problems, *remarks]
    options.outcome.result |= {"problems": problems, "remarks": remarks}
    for note in notes:
        print(f"towline: {note}", file=sys.stderr)
    pages = [make_run_page(m, fitted.get(m.run.name), failed.get(m.run.name)) for m in batch.runs]
    page = out / "report.html"
    title = pages[0].name if len(pages) == 1 else f"{out.parent.name}: {len(pages)} runs"
    found = [answer.result for answer in (identified, free) if answer is not None]
    said = [*notes, *(f"{name}: {why}" for name, why in batch.failed.items())]
    budget = None if identified is None else budget_beside(out, identified.result.inputs)
    write_page(page, title, pages, found[0] if found else None, steady, said, found[1] if found[1:] else None, budget)
    options.outcome.wrote(page, word="page:")
    options.outcome.fail(failed)
    return EXIT_ERROR if problems else exit_code(failed)


def _truth_lines(runs: Sequence[Any]) -> dict[str, Any]:
    """Say how far the motion lies from the truth, of those runs that carry it."""
    from ..diagnose import motion_error
    from ..pipeline.stages import read_true_motion

    errors: dict[str, Any] = {}
    for m in runs:
        truth = read_true_motion(m.run)
        if truth is None:
            continue
        error = errors[m.run.name] = motion_error(m.motion, truth)
        alpha = f", alpha {error.alpha_deg:.4f} deg" if not math.isnan(error.alpha_deg) else ""
        print(
            f"{m.run.name}: against its truth: y_CG {1e3 * error.y_cg_m:.2f} mm, beta {error.beta_deg:.4f} deg{alpha} rms"
        )
    return errors
