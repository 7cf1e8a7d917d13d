"""``towline doctor``: what this machine has of what towline needs, and what to do about the rest."""

from __future__ import annotations

import argparse
from pathlib import Path

NAME = "doctor"
HELP = "say what is missing on this machine: Python, packages, codecs, memory, disk, text encoding, GPU"
LIGHT = True


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument(
        "folder", type=Path, nargs="?", default=Path(), metavar="FOLDER", help="where you work (default: this one)"
    )


def call(options: argparse.Namespace) -> int:
    """Look, and print one line for each thing."""
    from .machine import looked_at

    found = looked_at(options.folder)
    short = [item for item in found if item.needed and item.status != "ok"]
    options.outcome.result |= {"items": found, "not_ready": [item.name for item in short]}
    for item in found:
        todo = f"; {item.todo}" if item.todo else ""
        optional = "" if item.needed else " (optional)"
        print(f"{item.status:8}{item.name:24}{item.found:20}{item.purpose}{optional}{todo}")
    print("ready" if not short else "not ready: " + ", ".join(item.name for item in short))
    return 1 if short else 0
