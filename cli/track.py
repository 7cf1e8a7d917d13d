"""``towline track``: video to pixel tracks."""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .common import (
    add_runs,
    exit_code,
    print_notes,
    show_progress,
)
from .outcome import Outcome

if TYPE_CHECKING:
    from ..record.corrections import Placed

NAME = "track"
HELP = "video to pixel tracks (out/tracks.csv), an overlay video (out/overlay.mp4) and the worst frames (out/worst.png)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_runs(sub)
    sub.add_argument("--no-overlay", action="store_true", help="write neither out/overlay.mp4 nor out/worst.png")
    sub.add_argument("--sheet", action="store_true", help="write out/worst.png also with --no-overlay")
    sub.add_argument("--follow", action="store_true", help="say how it goes: frames per second, frames done, losses")
    sub.add_argument(
        "--device",
        choices=("cpu", "cuda"),
        default="cpu",
        help="where the fits run (default: cpu; cuda gave the same, at 0.4 of its speed)",
    )
    sub.add_argument("--fresh", action="store_true", help="track again even if the tracks are up to date")
    sub.add_argument(
        "--from",
        dest="from_frame",
        type=int,
        metavar="FRAME",
        help="with --seed: follow the marks anew from this frame on; kept in RUN/corrections.toml",
    )
    sub.add_argument(
        "--seed",
        action="append",
        default=[],
        metavar="NAME=U,V",
        help="where the marker NAME is in the frame of --from, pixels; may be repeated",
    )


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.progress import loading
    from ..record.errors import TowlineError

    with loading("pipeline.stages"):
        import av  # noqa: F401

        from ..pipeline import stages
        from ..record.corrections import in_words, read_corrections
        from ..record.run import CORRECTIONS, cameras_of, read_run
    seeds = seeds_of(options.from_frame, options.seed)
    if seeds and len(options.runs) > 1:
        raise TowlineError(f"--seed is of one run; {len(options.runs)} are given")
    failed: dict[str, str] = {}
    overlay, sheet = not options.no_overlay, options.sheet or not options.no_overlay
    for folder in options.runs:
        try:
            whole = read_run(folder)
            stages.refuse_corrections(whole)
            if seeds and whole.file.cameras:
                raise TowlineError(f"{folder}: --seed cannot be used with two [[camera]] yet")
            for run in cameras_of(whole):
                filmed = run.file.source.video is not None
                corrections = read_corrections(run)
                new = corrections.seeded(seeds) if seeds else None
                with show_progress(options.follow) as show:
                    found = stages.track_run(run, show, options.fresh, options.device, new)
                    drawn = stages.draw_tracks(found, overlay, sheet, show) if filmed else []
                options.outcome.result[run.name] = {"markers": _markers_seen(found.table), "notes": found.notes}
                print(f"{run.name}: {markers_in_words(found.table)}")
                print_notes(found.notes)
                if corrected := in_words(new or corrections):
                    print(f"corrected by hand ({run.folder / CORRECTIONS}): {corrected}")
                if new:
                    options.outcome.wrote(run.folder / CORRECTIONS)
                if filmed:
                    wanted = {"tracks.csv": True, "overlay.mp4": overlay, "worst.png": sheet}
                    _say_written(options.outcome, run.out, wanted, found.anew, drawn)
        except TowlineError as error:
            if len(options.runs) == 1:
                raise
            failed[str(folder)] = str(error)
    options.outcome.fail(failed)
    return exit_code(failed)


def seeds_of(frame: int | None, given: Sequence[str]) -> list[Placed]:
    """Seeds of --from and --seed; none where neither is given.

    Parameters
    ----------
    frame : of --from
    given : NAME=U,V each

    Raises
    ------
    TowlineError : one without the other, a frame below 0, a seed that is none, or a name that stands twice
    """
    from ..record.corrections import Placed
    from ..record.errors import TowlineError

    if frame is None and not given:
        return []
    if frame is None or not given:
        raise TowlineError(
            "--from FRAME and --seed NAME=U,V go together: where the marks are in the frame to go on from"
        )
    if frame < 0:
        raise TowlineError(f"--from {frame}: a frame's number is 0 or above")
    seeds: dict[str, Placed] = {}
    for text in given:
        name, mark, place = text.rpartition("=")
        u_px, comma, v_px = place.partition(",")
        try:
            pixel = float(u_px), float(v_px)
        except ValueError:
            pixel = math.nan, math.nan
        if not (name and mark and comma and all(map(math.isfinite, pixel))):
            raise TowlineError(f"--seed {text}: NAME=U,V is expected, two numbers in pixels")
        if name in seeds:
            raise TowlineError(f"--seed {text}: {name!r} is given twice")
        seeds[name] = Placed(frame=frame, marker=name, pixel_px=pixel)
    return list(seeds.values())


def _say_written(outcome: Outcome, out: Path, wanted: dict[str, bool], anew: bool, drawn: Sequence[Path]) -> None:
    """Which files were written, and which were up to date."""
    paths = [out / name for name, asked in wanted.items() if asked]
    made = [path for path in paths if path in drawn or (anew and path.name == "tracks.csv")]
    outcome.wrote(*made)
    if kept := [path for path in paths if path not in made]:
        print("up to date: " + ", ".join(map(str, kept)))


def _markers_seen(table: Any) -> list[dict[str, Any]]:
    return [_marker_seen(str(marker), rows) for marker, rows in table.groupby("marker", sort=False)]


def markers_in_words(table: Any) -> str:
    """How often and how well each marker was measured."""
    return "; ".join(map(_seen_words, _markers_seen(table)))


def _marker_seen(marker: str, rows: Any) -> dict[str, Any]:
    """How often and how well a marker was measured, and why not."""
    from ..record.tables import BY_HAND

    lost = rows[rows["status"] == "lost"]
    reasons = lost["reason"] if "reason" in rows else []
    return {
        "marker": marker,
        "frames": len(rows),
        "measured": int((rows["status"] == "measured").sum()),
        "by_hand": int((rows["status"] == BY_HAND).sum()),
        "sigma_px": rows[["sigma_u_px", "sigma_v_px"]].median().mean(),
        "lost": dict(
            Counter(why if isinstance(why, str) and why else "no reason given" for why in reasons).most_common()
        ),
    }


def _seen_words(seen: dict[str, Any]) -> str:
    """In words: "lost: 20 covered, 14 brightness"."""
    text = f"{seen['marker']} measured in {100 * seen['measured'] / seen['frames']:.2f} % of {seen['frames']} frames"
    if not math.isnan(seen["sigma_px"]):
        text += f" (sigma {seen['sigma_px']:.3f} px)"
    if seen["by_hand"]:
        text += f"; {seen['by_hand']} by hand"
    if seen["lost"]:
        text += "; lost: " + ", ".join(f"{count} {reason}" for reason, count in seen["lost"].items())
    return text
