"""From a run to its found datum points, and back into run.toml with its comments and order kept."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from ..geometry.camera import Lens
from ..record.errors import InputError
from ..record.files import TOML_BYTES, read_bytes
from ..record.run import RUN_FILE, Run
from ..record.schema import RunFile
from ..record.toml import check_tables
from ..record.typed import replacing_typed
from .datum_find import FoundDatum, FoundPoint, find_datum
from .recording import Frame, clip_info, read_frames

DIGITS = 4
"""Of what is written, px."""


def find_run_datum(run: Run, frames: int, lossless: frozenset[str] = frozenset()) -> FoundDatum:
    """Look for the datum points of a run in the first ``frames`` analysed frames.

    Parameters
    ----------
    run : the run folder as read
    frames : how many, from the first analysed one
    lossless : codecs whose pixels are as the camera gave them

    Raises
    ------
    InputError : no video, or no datum point says what it looks like
    VideoError : the video cannot be read
    """
    source = run.file.source
    where = run.folder / RUN_FILE
    if source.video is None:
        raise InputError(where, "source.video", "missing key; the datum is looked for in the recording")
    if not any(point.look for point in run.file.datum):
        raise InputError(
            where, "datum.look", "no point has one; expected mark, aruco:N:CORNER, apriltag:N:CORNER or checker:..."
        )
    shown = read_frames(run.source_path, source.span_s, source.frame_rate_hz, source.exposure_s)
    first: list[Frame] = [frame for frame in islice(shown, max(frames, 1)) if not frame.damaged]
    close = getattr(shown, "close", None)
    if close is not None:
        close()
    if not first:
        raise InputError(where, "source.video", f"the first {frames} frames are damaged; give another source.span_s")
    lens = None if run.file.camera is None else Lens.from_table(run.file.camera)
    lossy = clip_info(run.source_path).codec not in lossless
    try:
        return find_datum(run.file.datum, [f.luma for f in first], lens, float(first[0].white_dn), lossy)
    except InputError as error:
        raise InputError(where, error.where, error.message) from None


def write_datum(path: Path, points: tuple[FoundPoint | None, ...]) -> int:
    """Put found places and sigmas into a run.toml; points that were not found stay as they are.

    Parameters
    ----------
    path : of the file
    points : found, None where not, in run.toml's order

    Returns
    -------
    int : points changed

    Raises
    ------
    InputError : the file would no longer be a valid run.toml
    """
    import tomlkit

    document = tomlkit.parse(read_bytes(path, TOML_BYTES).decode("utf-8"))
    changed = 0
    for table, point in zip(document["datum"], points, strict=True):  # pyright: ignore
        if point is None or point.reason:
            continue
        pixel = tomlkit.array()
        pixel.extend(round(float(c), DIGITS) for c in point.pixel_px)
        table["pixel_px"] = pixel  # pyright: ignore
        table["sigma_px"] = round(point.sigma_px, DIGITS)  # pyright: ignore
        changed += 1
    checked = check_tables(document.unwrap(), RunFile, path)
    with replacing_typed(path, checked.outside) as temporary:
        temporary.write_bytes(tomlkit.dumps(document).encode("utf-8"))
    return changed
