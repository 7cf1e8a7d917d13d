"""The doors of the app, tried from outside: by a stranger of the same machine, a hostile run folder, and a bad moment.

    python benchmarks/doors.py [--connections 2000] [--kills 40] [--shots FOLDER] > benchmarks/doors.txt

Starts `towline app` on a copy of a sample, carries the attacks out, and prints a line for each. Linux, with playwright and
Chromium. Ends with code 1 if one was not held.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import doors_browser as browser
import doors_wire as wire
from doors_wire import App, Row

HEADS = ("attack", "tries", "result", "")


def attacks(place: Path, connections: int, kills: int, shots: Path | None) -> Iterator[Row]:
    """All of them, one after the other."""
    folder = wire.run_folder(place / "hall" / "x1446")
    errors = place / "errors.txt"
    yield wire.listed_processes(folder, errors)
    with App(folder, errors) as app:
        with browser.chromium() as context:
            yield from browser.hostile_report(app, context, folder, shots)
            yield wire.cookie_alone(app, browser.other_port(app, context))
        app.enter()
        yield wire.idle_connections(app, connections)
        yield wire.idle_connections(app, connections, b"GET / HTTP/1.1\r\nHost: ")
        yield wire.flood(app)
        yield wire.slow_heads(app)
        for what in wire.ENDLESS:
            yield wire.endless(app, what)
        yield wire.absurd_addresses(app)
        yield wire.absurd_requests(app)
        yield wire.absurd_messages(app)
        with browser.chromium() as context:
            yield from browser.two_windows(app, context, folder)
    yield wire.killed_saves(kills)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connections", type=int, default=2000, help="that say nothing (default: 2000)")
    parser.add_argument("--kills", type=int, default=40, help="while run.toml is saved (default: 40)")
    parser.add_argument("--shots", type=Path, help="folder for pictures of the hostile report")
    options = parser.parse_args()
    held = True
    print(f"| {' | '.join(HEADS)} |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        for row in attacks(Path(place), options.connections, options.kills, options.shots):
            held &= row.held
            print(f"| {row.attack} | {row.tries:,} | {row.result} | {'held' if row.held else 'NOT HELD'} |", flush=True)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
