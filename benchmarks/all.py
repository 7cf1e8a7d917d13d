"""Every benchmark by one command; each table is written beside its script with what made it.

    python benchmarks/all.py [--only first_path vision ...] [--list]

A table's first lines say the command, the commit, the day, the machine with its load before and after, and the versions. What was
measured before stays until its successor is whole. Some take hours (--list says about how long, on two cores); the long ones go
on where they were stopped.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from towline.pipeline.executor.processes import THREADS
from towline.record.files import write_text

HERE = Path(__file__).resolve().parent
PACKAGES = (
    "towline", "numpy", "scipy", "pandas", "opencv-python-headless", "scikit-image", "av", "kornia", "torch", "trackpy", "casadi",
    "jax-sysid", "pysindy", "cosmic-ray", "pytest-cov", "mitsuba",
)  # fmt: skip

OUTPUTS = (":(exclude)benchmarks/*.txt", ":(exclude)*.svg", ":(exclude)*.html")
"""What benchmarks write into the tree."""


@dataclass(frozen=True)
class Table:
    """A benchmark.

    Attributes
    ----------
    command : after ``python``; {out} is a folder that is kept, so that it can go on
    file : table, in benchmarks/
    minutes : to expect on two cores; the table says what it took
    says : what it measures
    """

    command: str
    file: str
    minutes: float
    says: str


TABLES = {
    "first_path": Table("benchmarks/first_path.py", "first_path.txt", 1, "the sample videos from film to derivatives"),
    "vision": Table("benchmarks/vision.py", "vision.txt", 6, "marks against their bound, beside trackpy, OpenCV, scikit-image"),
    "fuzz": Table("benchmarks/fuzz.py", "fuzz.txt", 1, "damaged recordings"),
    "faults": Table("benchmarks/faults.py --cases 2000 --estimators 100", "faults.txt", 20, "damaged files of every other kind"),
    "rough": Table("benchmarks/rough.py", "rough.txt", 30, "hostile files, links, names, signals, short memory, full disks"),
    "footage_edits": Table("benchmarks/footage_edits.py", "footage_edits.txt", 8, "60 edits and re-encodings, marks known"),
    "geometry": Table("benchmarks/geometry.py", "geometry.txt", 8, "random cameras, planted faults"),
    "graphics_card": Table("benchmarks/graphics_card.py", "graphics_card.txt", 2, "tracks and the chain on a CUDA device"),
    "mistakes": Table("benchmarks/mistakes.py", "mistakes.txt", 6, "gross mistakes of a run.toml, planted in random set-ups"),
    "two_cameras": Table("benchmarks/two_cameras.py {out}/two-cameras", "two_cameras.txt", 110, "two cameras over one tow"),
    "trapezoid": Table("benchmarks/trapezoid.py", "trapezoid.txt", 1, "the thesis's trapezoid against the exact form"),
    "identify": Table("benchmarks/identify.py", "identify.txt", 90, "the joint fit, its bound, scipy, CasADi, jax-sysid, pysindy"),
    "surge_peers": Table("benchmarks/surge_peers.py", "surge_peers.txt", 2, "four tows with surge beside scipy"),
    "whole_path": Table("benchmarks/whole_path.py", "whole_path.txt", 25, "long films and many runs, seconds and memory"),
    "identify_scale": Table(
        "benchmarks/identify_scale.py", "identify_scale.txt", 3, "the joint fit by the command against runs and frames"
    ),
    "identify_surge": Table(
        "benchmarks/identify_surge.py all --out {out}/surge", "identify_surge.txt", 90, "the joint fit of tows with surge in full"
    ),
    "budget": Table("benchmarks/budget.py all --out {out}/budget", "budget.txt", 40, "the uncertainty budget against refits"),
    "steady": Table("benchmarks/steady.py", "steady.txt", 8, "swinging and settled tows told apart, stability, bracket of X_v"),
    "methods": Table("benchmarks/methods.py", "methods.txt", 6, "every estimator under one noise"),
    "gap": Table("benchmarks/gap.py", "gap.txt", 5, "every effect of the library, planted once"),
    "doors": Table("benchmarks/doors.py", "doors.txt", 5, "the app's doors, tried from outside"),
    "app": Table("benchmarks/app.py", "app.txt", 3, "the page: seconds per interaction, memory"),
    "campaign": Table("benchmarks/campaign.py", "campaign.txt", 9, "two workers against one, kills, memory"),
    "end_to_end": Table("benchmarks/end_to_end.py {out}/end-to-end", "end_to_end.txt", 100, "100 campaigns, film to derivatives"),
    "path_traced": Table(
        "benchmarks/path_traced.py {out}/path-traced --keep benchmarks/path_traced", "path_traced.txt", 180,
        "10 campaigns path-traced by mitsuba, film to derivatives to verdict",
    ),
    "path_traced_again": Table(
        "benchmarks/path_traced.py {out}/path-traced-again --again benchmarks/path_traced", "path_traced_again.txt", 2,
        "verdicts on their kept tracks",
    ),
    "blind": Table(
        "-m towline blind {out}/blind --cases 600 --nulls 300 --seed 271148 --workers 2 --html", "blind/score.txt", 100,
        "600 campaigns whose truth is sealed",
    ),
    "live": Table("benchmarks/live.py --seconds 60", "live.txt", 40, "towline live: sources, values, faults, when it is enough"),
    "mutants": Table("benchmarks/mutants.py {out}/mutants --seed 3", "mutants.txt", 120, "300 random mutants against the tests"),
}  # fmt: skip


def head(command: str) -> str:
    """What made a table."""
    found = []
    for name in PACKAGES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    machine = f"{platform.machine()}, {os.cpu_count()} cores, {_processor()}"
    return (
        f"# python {command}\n# {date.today()}, commit {_commit()}, {machine}, load {_load()} before\n"
        f"# python {platform.python_version()}, {', '.join(found)}\n"
    )


def _commit() -> str:
    """With "-dirty" where more than tables and pictures of other benchmarks is not as it was committed."""
    found = _git("describe", "--always")
    return f"{found}-dirty" if _git("status", "--porcelain", "--", ".", *OUTPUTS) else found or "unknown"


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=HERE.parent, capture_output=True, text=True, check=False).stdout.strip()


def _load() -> str:
    return ", ".join(f"{value:.1f}" for value in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def made(table: Table, out: Path) -> bool:
    """Run one and write its table; False: it ended with an error, the old table stays, and what it printed is in ``out``."""
    shown, command = table.command.format(out="OUT"), table.command.format(out=out).split()
    began, first = time.perf_counter(), head(shown)
    one = dict.fromkeys(THREADS, "1")
    done = subprocess.run(
        [sys.executable, *command],
        cwd=HERE.parent,
        # byte code is kept, whatever the environment says: a command that compiles the package first is no measure of its start
        env={**os.environ, **one, "PYTHONDONTWRITEBYTECODE": ""},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        printed = out / f"{Path(table.file).stem}-failed.txt"
        out.mkdir(parents=True, exist_ok=True)
        write_text(printed, done.stdout)
        print(f"{shown}: ended with {done.returncode} ({printed}); benchmarks/{table.file} stays", file=sys.stderr)
        return False
    first += f"# {(time.perf_counter() - began) / 60:.1f} minutes, load {_load()} after\n\n"
    write_text(HERE / table.file, first + done.stdout)
    return True


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES), metavar="NAME")
    parser.add_argument("--list", action="store_true", help="say what there is, run nothing")
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "towline-benchmarks")
    given = parser.parse_args()
    if given.list:
        for name, table in TABLES.items():
            print(f"{name:12}{table.minutes:5.0f} min  {table.says}")
        return
    failed = []
    for name in given.only:
        print(f"{name}: {TABLES[name].says} ({TABLES[name].minutes:g} min)", flush=True)
        if not made(TABLES[name], given.out):
            failed.append(name)
    if failed:
        raise SystemExit(f"not measured: {', '.join(failed)}")


if __name__ == "__main__":
    main()
