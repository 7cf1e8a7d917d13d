"""``towline motion``: tracks to motion."""

from __future__ import annotations

import argparse
from typing import Any

from .common import (
    add_method,
    add_runs,
    exit_code,
    print_notes,
    read_batch,
)

NAME = "motion"
HELP = "tracks to metres (out/marks.csv), motion (out/motion.csv) and camera (out/camera.json)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_runs(sub)
    add_method(sub)


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    batch = read_batch(options)
    for m in batch.runs:
        options.outcome.result[m.run.name] = motion_found(m)
        print(f"{m.run.name}: {motion_line(m)}")
        if m.camera is not None:
            print_notes(m.camera.notes)
            both = ("cameras.json",) if m.run.file.cameras else ()
            options.outcome.wrote(*(m.run.out / name for name in ("marks.csv", "motion.csv", "camera.json", *both)))
    options.outcome.fail(batch.failed)
    return exit_code(batch.failed)


def motion_found(m: Any) -> dict[str, Any]:
    """A run's motion as ``--json`` says it."""
    good = m.motion["status"] == "measured"
    first_s, last_s = m.motion["t_s"].iloc[0], m.motion["t_s"].iloc[-1]
    return {"frames": len(m.motion), "measured": int(good.sum()), "duration_s": last_s - first_s, "camera": m.camera}


def motion_line(m: Any) -> str:
    """A run's motion in a line."""
    motion = m.motion
    good = motion["status"] == "measured"
    text = f"{int(good.sum())} of {len(motion)} frames, {motion['t_s'].iloc[-1] - motion['t_s'].iloc[0]:.1f} s"
    if m.camera is not None:
        rows = motion[good]
        frame, common = (1e3 * rows[f"{kind}_y_cg_m"].median() for kind in ("sigma", "common"))
        text += f"; y_CG +- {frame:.2f} mm frame to frame, {common:.2f} mm common"
        text += f"; camera {m.camera.method}, datum {m.camera.rms_px:.2f} px rms"
        for name, value in m.camera.invariants.items():
            text += f"; {name} off by {1e3 * value.value:+.1f} mm (scatter {1e3 * value.std:.1f})"
    return text
