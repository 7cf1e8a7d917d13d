"""``towline import``: tracks from trackpy, DLTdv, Kinovea or Tracker; motion from the channels of a tracking system."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

NAME = "import"
HELP = "tracks that trackpy, DLTdv, Kinovea or Tracker wrote, or motion from instruments' channels (docs/import.md)"
PROGRAMS = ("auto", "trackpy", "dltdv", "kinovea", "tracker", "instruments")


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("source", type=Path, metavar="SOURCE", help="the other program's file, or the channels as CSV")
    sub.add_argument(
        "--from", dest="program", choices=PROGRAMS, default="auto", help="who wrote it (default: told from the file)"
    )
    sub.add_argument("-o", "--out", type=Path, required=True, metavar="FILE.csv", help="the table, .csv or .parquet")
    sub.add_argument(
        "--marker",
        action="append",
        default=[],
        metavar="NAME=ID",
        help="the program's point ID is run.toml's marker NAME; may be repeated (default: all points, own names)",
    )
    sub.add_argument("--rate", type=float, metavar="HZ", help="frames per second")
    sub.add_argument("--image-height", type=float, metavar="PX", help="needed where y starts at the lower edge")
    sub.add_argument("--y", choices=("up", "down"), help="where y runs; DLTdv 1-7: up, DLTdv8: down")
    sub.add_argument(
        "--origin", metavar="X,Y", help="where the program's axes stand in its picture, pixels from top left"
    )
    sub.add_argument(
        "--first-pixel", type=float, metavar="C", help="the program's coordinate of the first pixel's middle"
    )
    sub.add_argument("--pixels-per-unit", type=float, metavar="N", help="undo a calibration (default: 1)")
    sub.add_argument("--camera", type=int, metavar="N", help="DLTdv: which camera of several")
    sub.add_argument(
        "--between",
        type=float,
        metavar="HZ",
        help="points digitised in a few frames: rows between them, marked as predicted",
    )
    sub.add_argument(
        "--largest-gap", type=float, default=1.0, metavar="S", help="with --between: wider gaps stay lost (default: 1)"
    )
    sub.add_argument("--setup", type=Path, metavar="SETUP.toml", help="instruments: what each channel measures")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    return _instruments(options) if options.program == "instruments" else _tracks(options)


def _tracks(options: argparse.Namespace) -> int:
    from ..record.errors import TowlineError
    from ..record.imported import Wanted, import_tracks
    from ..record.tables import write_table

    markers: dict[str, str] = {}
    for pair in options.marker:
        name, mark, own = pair.partition("=")
        if not (name and mark and own) or name in markers or own in markers.values():
            raise TowlineError(f"--marker {pair}: NAME=ID is expected, each name and each ID once")
        markers[name] = own
    for name in ("rate", "image_height", "pixels_per_unit", "between", "largest_gap"):
        value = getattr(options, name)
        if value is not None and not 0 < value < float("inf"):
            raise TowlineError(f"--{name.replace('_', '-')} {value:g}: a number above 0 is expected")
    wanted = Wanted(
        rate_hz=options.rate,
        markers=markers,
        image_height_px=options.image_height,
        y=options.y,
        origin_px=_pair(options.origin),
        first_pixel=options.first_pixel,
        pixels_per_unit=options.pixels_per_unit,
        camera=options.camera,
    )
    found = import_tracks(options.source, options.program, wanted)
    table = found.table
    if options.between is not None:
        from ..record.tables import seen_rows
        from ..vision.picked import interpolated

        # frames in which nobody digitised the point come anew, predicted or lost
        table = interpolated(table[seen_rows(table)], options.between, options.largest_gap)
    write_table(options.out, table)
    for note in found.notes:
        print(f"note: {note}")
    print(f"{found.program}: " + "; ".join(_seen(str(m), rows) for m, rows in table.groupby("marker", sort=False)))
    rows_of = {str(marker): len(rows) for marker, rows in table.groupby("marker", sort=False)}
    options.outcome.result |= {"program": found.program, "rows": rows_of, "notes": found.notes}
    options.outcome.wrote(options.out)
    return 0


def _seen(marker: str, rows: Any) -> str:
    return f"{marker} measured in {int((rows['status'] == 'measured').sum())} of {len(rows)} frames"


def _pair(text: str | None) -> tuple[float, float] | None:
    from ..record.errors import TowlineError

    if text is None:
        return None
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise TowlineError(f"--origin {text}: two numbers X,Y are expected") from None
    return x, y


def _instruments(options: argparse.Namespace) -> int:
    from ..record.errors import TowlineError

    if options.setup is None:
        raise TowlineError("--from instruments needs --setup SETUP.toml, which says what each channel measures")
    from ..record.instruments import motion_from_channels, read_channels, read_setup
    from ..record.tables import write_table

    setup = read_setup(options.setup)
    found = motion_from_channels(setup, read_channels(options.source, setup, options.setup))
    write_table(options.out, found.motion)
    good = int((found.motion["status"] == "measured").sum())
    print(f"{good} of {len(found.motion)} samples; tow point {found.tow_point_m:.4f} m ahead of LCG")
    for sentence in found.sentences:
        print(f"  {sentence}")
    for note in found.notes:
        print(f"note: {note}")
    options.outcome.result |= {
        "samples": len(found.motion),
        "measured": good,
        "tow_point_m": found.tow_point_m,
        "sentences": found.sentences,
        "notes": found.notes,
    }
    options.outcome.wrote(options.out)
    return 0
