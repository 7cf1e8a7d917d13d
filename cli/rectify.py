"""``towline rectify RUN``: the recording from straight above, to scale, and a scale grid over it."""

from __future__ import annotations

import argparse
from pathlib import Path

NAME = "rectify"
HELP = "a top view of a plane below the datum (out/top.png, out/top.mp4), and a scale grid on a frame (out/grid.png)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    sub.add_argument("run", type=Path, metavar="RUN", help="run folder (with a run.toml)")
    sub.add_argument(
        "--depth", type=float, metavar="M", help="plane below the datum (default: the markers' mean depth)"
    )
    which = sub.add_mutually_exclusive_group()
    which.add_argument("--frame", type=int, metavar="N", help="frame of the stills (default: the first analysed one)")
    which.add_argument("--time", type=float, metavar="S", help="the first frame at or after this time instead")
    sub.add_argument(
        "--area",
        type=float,
        nargs=4,
        metavar=("X0", "X1", "Y0", "Y1"),
        help="what to show, m (default: around the datum points and the marks' places)",
    )
    sub.add_argument("--mm-per-px", type=float, metavar="MM", help="scale (default: as fine as the picture)")
    sub.add_argument("--video", action="store_true", help="also out/top.mp4: all analysed frames")
    sub.add_argument("--grid", action="store_true", help="also out/grid.png: lines of equal x and y, datum residuals")


def call(options: argparse.Namespace) -> int:
    """Make the pictures and say where they are."""
    from ..pipeline.mistaken import refuse_untouched
    from ..pipeline.progress import progress
    from ..record.run import read_run, refuse_two_cameras
    from ..report.rectify import Wanted, rectify

    run = read_run(options.run)
    refuse_untouched(run)
    refuse_two_cameras(run, "towline rectify")
    area = None if options.area is None else tuple(options.area)
    wanted = Wanted(
        options.depth, area, options.mm_per_px, options.frame, options.time, film=options.video, grid=options.grid
    )
    with progress(False) as show:
        made = rectify(run, wanted, lambda done: show(f"{run.name}: top view", done, None))
    (x0, x1), (y0, y1) = made.view.area.x_m, made.view.area.y_m
    print(
        f"{run.name}: frame {made.frame}, t {made.t_s:.3f} s; depth {made.view.area.depth_m:g} m, "
        f"x {x0:.3f} .. {x1:.3f} m to the right, y {y0:.3f} .. {y1:.3f} m downwards, {made.view.mm_per_px:g} mm/px; "
        f"{100 * made.view.seen_share:.0f} % of it in the picture"
    )
    for note in made.notes:
        print(f"note: {note}")
    options.outcome.result |= {
        "frame": made.frame,
        "t_s": made.t_s,
        "depth_m": made.view.area.depth_m,
        "x_m": (x0, x1),
        "y_m": (y0, y1),
        "mm_per_px": made.view.mm_per_px,
        "seen_share": made.view.seen_share,
        "notes": made.notes,
    }
    options.outcome.wrote(*made.paths)
    return 0
