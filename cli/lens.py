"""``towline lens``: pictures or a video of a board -> a [camera] table, and how good it is."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NAME = "lens"
HELP = "calibrate a lens from pictures or a video of a chessboard or ChArUco board: a [camera] table (lens.json)"

PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".pgm", ".webp")
_EPILOG = (
    "A chessboard is counted by its inner corners, a ChArUco board by its squares. Hold the board still, tilt it by 30 to 45 "
    "degrees about both sides, and bring it to every edge of the picture: 15 to 30 pictures."
)


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.epilog = _EPILOG
    sub.add_argument("sources", nargs="+", type=Path, metavar="PICTURE|FOLDER|VIDEO")
    sub.add_argument("--board", type=_size, required=True, metavar="9x6", help="inner corners (ChArUco: squares)")
    sub.add_argument("--square-m", type=float, required=True, metavar="M", help="side of a square, m")
    sub.add_argument("--charuco", default="", metavar="DICT", help="a ChArUco board of this dictionary (DICT_6X6_250)")
    sub.add_argument("--marker-m", type=float, default=0.0, metavar="M", help="side of a ChArUco mark, m")
    sub.add_argument("--legacy", action="store_true", help="ChArUco board made by OpenCV before 4.6")
    sub.add_argument(
        "--coefficients",
        type=int,
        choices=(0, 1, 2, 4, 5),
        default=5,
        help="how many of k1 k2 p1 p2 k3 are fitted (default: 5; the errors then hold whatever the lens)",
    )
    sub.add_argument("--square-pixels", action="store_true", help="fx = fy")
    sub.add_argument("--flat", action="store_true", help="take the board as flat and true (default: fit its shape too)")
    sub.add_argument("--keep-all", action="store_true", help="name bad views, but leave none out")
    sub.add_argument("--window-px", type=int, metavar="PX", help="half-width of the corners' refinement window")
    sub.add_argument("--run", type=Path, metavar="RUN", help="check that this run's working area was covered")
    sub.add_argument("-o", "--out", type=Path, metavar="lens.json", help="write the result")


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)[xX](\d+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r}: two numbers are expected, like 9x6")
    return int(match[1]), int(match[2])


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..geometry.lens import Board, calibrate, coverage
    from ..geometry.lens.advice import advice
    from ..geometry.lens.report import lens_file, report_lines
    from ..record.errors import TowlineError
    from ..record.files import sha256_of_file
    from ..record.lens_file import write_lens

    if options.charuco and not options.marker_m:
        raise TowlineError("--charuco needs --marker-m, the side of a mark in m")
    if options.window_px is not None and not 1 <= options.window_px <= 100:
        raise TowlineError(f"--window-px {options.window_px}: 1 to 100 is expected")
    board = Board(
        options.board[0], options.board[1], options.square_m, options.charuco, options.marker_m, options.legacy
    )
    views, missed, size, files, left_out = _views(options, board)
    answer = calibrate(views, size, options.coefficients, options.square_pixels, not options.keep_all, options.flat)
    found = coverage(answer)
    notes = [*left_out, *answer.notes, *advice(answer, found)]
    if options.run is not None:
        notes += _working_area(options.run, found)
    hashes = {str(path): sha256_of_file(path) for path in files}
    result = lens_file(answer, found, board, missed, notes, hashes)
    print("\n".join(report_lines(result, found, "" if options.out is None else options.out.name)))
    options.outcome.result["lens"] = result
    if options.out is not None:
        write_lens(options.out, result)
        options.outcome.wrote(options.out)
    return 0


def _views(
    options: argparse.Namespace, board: Any
) -> tuple[list[Any], list[str], tuple[int, int], list[Path], list[str]]:
    """Views, names of pictures without a board, picture size, the files that were used, and a note on each that was not."""
    from ..geometry.lens import find_board, other_size
    from ..pipeline.progress import progress
    from ..record.errors import TowlineError

    files = _files(options.sources)
    looked: list[tuple[Path, tuple[int, int], list[Any], str]] = []
    last = None
    with progress() as show:
        for done, path in enumerate(files):
            show("looking for the board", done, len(files))
            if path.suffix.lower() not in PICTURES:
                found, seen, size_here = _from_video(path, board, options.window_px)
                missed = "" if found else f"{path.name} ({seen} frames looked at)"
            else:
                luma = _picture(path)
                size_here = (luma.shape[1], luma.shape[0])
                view = find_board(luma, board, path.name, options.window_px)
                found, missed = ([], path.name) if view is None else ([view], "")
                last = luma if view is None else last
            looked.append((path, size_here, found, missed))
    size, left_out = _one_size([(path, size_here, max(len(found), 1)) for path, size_here, found, _ in looked])
    used = [row for row in looked if row[1] == size]
    views = [view for _, _, found, _ in used for view in found]
    if not views:
        other = None if last is None else other_size(last, board)
        hint = "is --board the number of inner corners, and the whole board in the picture?"
        if board.dictionary:
            hint = "are --board (squares), --charuco and --legacy right?"
        if other is not None:
            hint = f"the board looks like {other[0]}x{other[1]} inner corners"
        what = f"{board.columns}x{board.rows} board"
        raise TowlineError(f"no {what} was found in {len(files)} file{'s' * (len(files) > 1)}: {hint}")
    return views, [row[3] for row in used if row[3]], size, [row[0] for row in used], left_out


def _one_size(pictures: list[tuple[Path, tuple[int, int], int]]) -> tuple[tuple[int, int], list[str]]:
    """The size that more than half of the pictures have (each file with how many it counts for), and a note on each other."""
    from collections import Counter

    from ..record.errors import InputError

    counts: Counter[tuple[int, int]] = Counter()
    for _, size, count in pictures:
        counts[size] += count
    usual, most = counts.most_common(1)[0]
    others = [(path, size) for path, size, _ in pictures if size != usual]
    if others and 2 * most <= counts.total():
        path, size = others[0]
        raise InputError(
            path,
            "",
            f"is {size[0]} x {size[1]} px, others are {usual[0]} x {usual[1]}, and no size is that of most pictures; all must "
            "come from one camera in one setting",
        )
    words = f"px, the others {usual[0]} x {usual[1]}; left out, a lens is of one camera in one setting"
    return usual, [f"{path.name}: {size[0]} x {size[1]} {words}" for path, size in others]


def _files(sources: list[Path]) -> list[Path]:
    from ..record.errors import InputError
    from ..record.files import ABSENT, refusal

    files: list[Path] = []
    for source in sources:
        if source.is_dir():
            inside = sorted(path for path in source.iterdir() if path.suffix.lower() in PICTURES)
            if not inside:
                raise InputError(source, "", f"holds no pictures ({', '.join(PICTURES)})")
            files += inside
        else:
            wrong = refusal(source)
            if wrong is not None:
                raise InputError(source, "", f"{wrong} or folder" if wrong == ABSENT else wrong)
            files.append(source)
    return files


def _picture(path: Path) -> Any:
    import cv2
    import numpy as np

    from ..record.errors import InputError
    from ..record.files import PICTURE_BYTES, read_bytes

    content = read_bytes(path, PICTURE_BYTES)
    try:
        luma = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if content else None
    except cv2.error:  # a header that claims more pixels than OpenCV takes
        luma = None
    if luma is None:
        raise InputError(path, "", "is no picture that OpenCV can read")
    return luma


def _from_video(path: Path, board: Any, window_px: int | None) -> tuple[list[Any], int, tuple[int, int]]:
    from ..geometry.lens.choose import LOOKS, apart, still_views
    from ..vision.recording import clip_info, read_frames

    info = clip_info(path)
    frames = round((info.duration_s or 60.0) * info.rate_hz)
    every = max(2, frames // LOOKS)

    def named() -> Iterator[tuple[str, Any]]:
        for frame in read_frames(path):
            yield f"{path.name} frame {frame.index}", frame.luma

    views = list(still_views(named(), board, every, window_px))
    return apart(views, info.width_px), max(1, frames // every), (info.width_px, info.height_px)


def _working_area(folder: Path, found: Any) -> list[str]:
    """Sentences on the run's working area."""
    from ..geometry.lens.area import area_notes, working_box
    from ..record.run import read_run
    from ..record.tables import read_tracks
    from ..vision.recording import clip_info

    run = read_run(folder)
    path = run.out / "tracks.csv"
    if run.file.source.tracks is not None:
        path = run.source_path
    tracks = read_tracks(path) if path.is_file() else None
    size = None
    if run.file.source.video is not None:
        info = clip_info(run.source_path)
        size = (info.width_px, info.height_px)
    elif run.file.camera is not None:
        size = run.file.camera.image_size_px
    return area_notes(found, working_box(run, tracks), run.name, size)
