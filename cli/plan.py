"""``towline plan``: which tows, and how many, bring each derivative to a wished interval."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

NAME = "plan"
HELP = "which tow points, lines, speeds and releases, and how many runs, reach the wished intervals (plan.json)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("request", type=Path, metavar="plan.toml", help="tank, model, hull guess, choices, wish")
    sub.add_argument("-o", "--out", type=Path, metavar="plan.json", help="default: plan.json beside plan.toml")
    sub.add_argument(
        "--effects",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="a law of towline diagnose --law that the model is to be planned with: law.toml with its numbers and law.py with its "
        "terms, which is RUN as a program: name none that you would not run yourself",
    )


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
    missing: Any = None
    outside: Any = None
    if options.effects is not None:
        from ..pipeline.missing import read_law, states_of

        law, half_width_m = read_law(options.effects), request.tank.width_m / 2
        missing = law.missing(request.model.length_pp_m, request.water.density_kg_m3, half_width_m)
        inputs |= law.inputs

        def beyond(data: Any, y_m: Any, beta_rad: Any) -> list[str]:
            return law.beyond(states_of(data, half_width_m, y_m, beta_rad))

        outside = beyond

    with show_progress() as show:
        plan = make_plan(request, path, __version__, inputs, show, missing, outside)
    print("\n".join(plan_lines(plan)))
    target = options.out or path.parent / "plan.json"
    write_result(target, plan)
    options.outcome.result["plan"] = plan
    options.outcome.wrote(target)
    return 0
