"""``towline plan``: which tows, and how many, bring each derivative to a wished interval."""

from __future__ import annotations

import argparse
from pathlib import Path

NAME = "plan"
HELP = "which tow points, lines, speeds and releases, and how many runs, reach the wished intervals (plan.json)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("request", type=Path, metavar="plan.toml", help="tank, model, hull guess, choices, wish")
    sub.add_argument("-o", "--out", type=Path, metavar="plan.json", help="default: plan.json beside plan.toml")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..__version__ import __version__
    from ..identify.plan import make_plan
    from ..identify.plan.words import plan_lines
    from ..record.files import sha256_of_file
    from ..record.plan_file import PlanRequest
    from ..record.results import write_result
    from ..record.toml import read_toml
    from .common import show_progress

    path: Path = options.request
    request = read_toml(path, PlanRequest)
    named = [name for name in (request.guess.reference, request.guess.derivatives) if name is not None]
    inputs = {path.name: sha256_of_file(path)}
    inputs |= {name: sha256_of_file(path.parent / name) for name in named if (path.parent / name).is_file()}
    with show_progress() as show:
        plan = make_plan(request, path, __version__, inputs, show)
    print("\n".join(plan_lines(plan)))
    target = options.out or path.parent / "plan.json"
    write_result(target, plan)
    options.outcome.result["plan"] = plan
    options.outcome.wrote(target)
    return 0
