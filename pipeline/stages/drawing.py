"""The tracks drawn over their video: an overlay of all frames, a sheet of the worst."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..progress import Progress, throttled
from .tracks import TRACKS, RunTracks, frames_of

if TYPE_CHECKING:
    from ...vision import Frame

OVERLAY, SHEET = "overlay.mp4", "worst.png"


def draw_tracks(
    found: RunTracks, overlay: bool = True, sheet: bool = True, progress: Progress | None = None
) -> list[Path]:
    """Draw the tracks of a video over it, in one more pass; what is not older than the tracks stays as it is.

    Parameters
    ----------
    found : of a run with a video
    progress : as in ``track_run``
    overlay, sheet : write out/overlay.mp4 (all frames), out/worst.png (the worst frames on one sheet)

    Returns
    -------
    list : the files that were written

    Raises
    ------
    TowlineError : the video cannot be read
    """
    run, table = found.run, found.table
    overlay = overlay and not _drawn_before(run.out / OVERLAY, found)
    sheet = sheet and not _drawn_before(run.out / SHEET, found)
    if not overlay and not sheet:
        return []
    from ...vision import clip_info
    from ...vision.overlay import write_overlay
    from ...vision.sheet import Sheet, worst_frames, write_sheet

    total = int(table["frame"].nunique())
    tiles = Sheet(table, worst_frames(table), f"{run.name}: the worst of {total} frames")

    def tell(done: int, _: int) -> None:
        if progress is not None:
            progress(f"{run.name}: drawing", done, total)

    tell(0, 0)
    sometimes = throttled(tell)

    def watched() -> Iterator[Frame]:
        for done, frame in enumerate(frames_of(run), 1):
            complete = tiles.look(frame)
            yield frame
            sometimes(done, 0)
            if complete and not overlay:
                return

    if overlay:
        rate_hz = run.file.source.frame_rate_hz or clip_info(run.source_path).rate_hz
        write_overlay(run.out / OVERLAY, watched(), table, run.file.datum, rate_hz)
    else:
        for _ in watched():
            pass
    if sheet:
        write_sheet(run.out / SHEET, tiles.picture())
    tell(total, 0)
    return [run.out / name for name, wanted in ((OVERLAY, overlay), (SHEET, sheet)) if wanted]


def _drawn_before(path: Path, found: RunTracks) -> bool:
    """The drawing shows these tracks: it was made after them."""
    return not found.anew and path.is_file() and path.stat().st_mtime_ns >= (found.run.out / TRACKS).stat().st_mtime_ns
