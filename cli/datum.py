"""``towline datum RUN``: find the datum points that say what they look like, and put them into run.toml."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

NAME = "datum"
HELP = "find datum points by their look (tag corner, chessboard corner, mark) and compare or replace run.toml's picks"
FRAMES = 16
"""Default of --frames: noise falls to a quarter; a choice."""


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    sub.add_argument("run", type=Path, metavar="RUN", help="run folder (with a run.toml)")
    sub.add_argument("--write", action="store_true", help="put pixel_px and sigma_px into run.toml")
    sub.add_argument(
        "--frames",
        type=int,
        default=FRAMES,
        metavar="N",
        help=f"frames from the first analysed one that are averaged if the camera stands still (default: {FRAMES})",
    )


def call(options: argparse.Namespace) -> int:
    """Find, print, write."""
    from ..pipeline.progress import loading
    from ..record.run import RUN_FILE, read_run, refuse_two_cameras

    with loading("pipeline.stages"):
        from ..vision.datum_write import find_run_datum, write_datum
        from ..vision.recording.codecs import LOSSLESS

    run = read_run(options.run)
    refuse_two_cameras(run, "towline datum")
    found = find_run_datum(run, options.frames, LOSSLESS)
    print(f"{'point':20} {'look':22} {'run.toml, px':>20} {'found, px':>20} {'apart':>7} {'sigma':>7} frames")
    for point, stated in zip(found.points, run.file.datum, strict=True):
        print(_line(point, stated))
    options.outcome.result |= {"points": found.points, "moved": found.moved}
    if found.moved:
        print("note: the camera does not stand still; the first frame alone was used")
    missing = sum(point is not None and bool(point.reason) for point in found.points)
    if options.write:
        path = run.folder / RUN_FILE
        changed = write_datum(path, found.points)
        options.outcome.wrote(path, more=f": {changed} points")
    return 3 if missing else 0


def _line(point: Any, stated: Any) -> str:
    u, v = stated.pixel_px
    start = f"{(stated.name or '-'):20} {(stated.look or '-'):22} {f'{u:.2f}, {v:.2f}':>20}"
    if point is None:
        return start + "  stays as picked"
    if point.reason:
        return f"{start}  {point.reason}"
    x, y = point.pixel_px
    apart = ((x - u) ** 2 + (y - v) ** 2) ** 0.5
    return f"{start} {f'{x:.3f}, {y:.3f}':>20} {apart:7.2f} {point.sigma_px:7.3f} {point.frames:6d}"
