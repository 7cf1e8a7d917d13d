"""``towline render``: a scenario to a filmed run."""

from __future__ import annotations

import argparse
from pathlib import Path

from .common import (
    EXIT_OK,
    add_line,
    show_progress,
)

NAME = "render"
HELP = "scenario.toml to a filmed run: video, run.toml and its truth"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.toml")
    sub.add_argument("-o", "--out", type=Path, required=True, metavar="RUN", help="the run folder to write")
    add_line(sub)


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..simulate import read_scenario
    from ..simulate.render import render_scenario

    file = read_scenario(options.scenario, options.line)
    with show_progress() as show:
        render_scenario(
            file, options.scenario.parent, options.out, lambda done, total: show(f"{file.name}: rendering", done, total)
        )
    options.outcome.result["name"] = file.name
    options.outcome.wrote(options.out)
    return EXIT_OK
