"""``towline app``: the local web page."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

NAME = "app"
HELP = (
    "a page in the browser: pick the datum and the marks, track, look at the motion, work the results out (docs/app.md)"
)


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument(
        "run",
        type=Path,
        nargs="?",
        metavar="RUN",
        help="run folder, a folder with a video, or one with runs below it (default: this one)",
    )
    sub.add_argument("--port", type=int, default=0, help="port on this machine (default: any that is free)")
    sub.add_argument("--no-browser", action="store_true", help="print the address and open nothing")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..app.server import serve
    from ..record.errors import InputError
    from ..record.run import RUN_FILE
    from ..record.sources import recordings_in

    folder: Path = options.run or Path()
    if folder.name == RUN_FILE:
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder")
    is_run = (folder / RUN_FILE).is_file() or (options.run is not None and len(recordings_in(folder)) == 1)
    if not 0 <= options.port <= 65535:
        raise InputError("--port", "", f"{options.port}: 0 to 65535 is expected")

    def say(address: str, file: Path) -> None:
        words = (
            f"towline app: {address}\nThe address is good once, on this machine; the file {file} opens the page each time.\n"
            "Ctrl+C ends it."
        )
        print(words, file=sys.stderr if options.json else sys.stdout, flush=True)

    serve(folder.resolve(), is_run, options.port, say, not options.no_browser, options.debug)
    return 0
