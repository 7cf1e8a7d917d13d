"""``towline simulate``: a scenario to its motion."""

from __future__ import annotations

import argparse
from pathlib import Path

from .common import (
    EXIT_OK,
    add_effects,
    add_line,
    print_notes,
)

NAME = "simulate"
HELP = "scenario.toml to motion.csv and the tow's stability verdict"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.toml")
    sub.add_argument(
        "-o", "--out", type=Path, help="the motion table, .csv or .parquet (default: motion.csv beside it)"
    )
    add_effects(sub)
    add_line(sub)


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.simulating import simulate_noted
    from ..record.tables import write_table
    from ..simulate import scenario_stability

    file, motion, notes = simulate_noted(options.scenario, options.effects, options.line)
    print_notes(notes)
    options.outcome.result["notes"] = notes
    target = options.out or options.scenario.parent / "motion.csv"
    write_table(target, motion)
    verdict = scenario_stability(file)
    if verdict is not None:
        options.outcome.result["stability"] = verdict
        print(f"tow {verdict.sentence}")
        print("roots 1/s: " + ", ".join(f"{root:.4f}" for root in verdict.roots))
    duration_s = motion["t_s"].iloc[-1]
    options.outcome.result |= {"samples": len(motion), "duration_s": duration_s}
    options.outcome.wrote(target, more=f": {len(motion)} samples, {duration_s:.2f} s")
    return EXIT_OK
