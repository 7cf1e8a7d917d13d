"""``towline render``: a scenario to a filmed run."""

from __future__ import annotations

import argparse
from pathlib import Path

from .common import (
    EXIT_OK,
    add_effects,
    add_line,
    show_progress,
)

NAME = "render"
HELP = "scenario.toml to a filmed run: video, run.toml and its truth"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.toml")
    sub.add_argument("-o", "--out", type=Path, required=True, metavar="RUN", help="the run folder to write")
    add_effects(sub)
    add_line(sub)


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.simulating import render_file

    with show_progress() as show:
        file = render_file(
            options.scenario,
            options.out,
            options.effects,
            options.line,
            lambda name, done, total: show(f"{name}: rendering", done, total),
        )
    options.outcome.result["name"] = file.name
    options.outcome.wrote(options.out)
    return EXIT_OK
