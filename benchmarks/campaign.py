"""Campaigns of rendered runs: two workers against one, kills at random moments, memory.

    python benchmarks/campaign.py [--runs 24] [--seconds 20] [--kills 20]

Renders runs of the sample's MARINER hull, adds one corrupt video, one bad run.toml and one empty folder, and prints a table.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from towline.cli import EXIT_SOME_FAILED
from towline.pipeline.executor.processes import THREADS

SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner"


def rendered(folder: Path, runs: int, seconds: float) -> None:
    """Runs of the sample's scenarios, shortened, each with its own release."""
    scenarios = sorted(SAMPLE.glob("*/scenario.toml"))
    for k in range(runs):
        text = scenarios[k % len(scenarios)].read_text()
        lines = []
        for line in text.splitlines():
            if line.startswith("name = ") and not any(kept.startswith("[") for kept in lines):
                line = f'name = "run-{k + 1:02d}"'
            if line.startswith("duration_s"):
                line = f"duration_s = {seconds}"
            if line.startswith("seed"):
                line = f"seed = {1000 + k}"
            lines.append(line)
        scenario = folder / f"scenario-{k}.toml"
        scenario.write_text("\n".join(lines) + "\n")
        subprocess.run(
            [sys.executable, "-m", "towline", "render", str(scenario), "-o", str(folder / "hall" / f"run-{k + 1:02d}")],
            check=True,
            stdout=subprocess.DEVNULL,
        )
    hall = folder / "hall"
    first = hall / "run-01"
    for name in ("corrupt", "bad"):
        shutil.copytree(first, hall / name, ignore=shutil.ignore_patterns("out"))
        toml = (hall / name / "run.toml").read_text().replace('name = "run-01"', f'name = "{name}"')
        (hall / name / "run.toml").write_text(toml if name == "corrupt" else toml.replace("speed_m_s", "speed"))
    video = next((hall / "corrupt").glob("*.mp4"))
    video.write_bytes(np.random.default_rng(0).bytes(20000))
    (hall / "empty").mkdir()


def command(hall: Path, workers: int) -> list[str]:
    """The command, one decoding and one BLAS thread a worker."""
    return [sys.executable, "-m", "towline", "campaign", str(hall), "--workers", str(workers)]


def digest(hall: Path) -> dict[str, str]:
    """Every result's hash."""
    found = {}
    for path in sorted(hall.rglob("*")):
        if path.is_file() and path.name != ".campaign.lock":
            found[path.relative_to(hall).as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def timed(hall: Path, workers: int) -> float:
    """Seconds of a whole campaign."""
    began = time.perf_counter()
    code = subprocess.run(command(hall, workers), capture_output=True, check=False).returncode
    assert code == EXIT_SOME_FAILED, code
    return time.perf_counter() - began


def killed(hall: Path, kills: int, whole_s: float) -> tuple[int, int]:
    """Kills at random moments; returns how many results stood already when they struck, and how many of these were redone."""
    rng, stood, redone = np.random.default_rng(1), {}, 0
    for _ in range(kills):
        process = subprocess.Popen(command(hall, 2), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(rng.uniform(0.3, max(1.0, 2.5 * whole_s / kills)))
        process.send_signal(signal.SIGKILL)
        process.wait()
        time.sleep(0.7)  # its workers notice and end
        for path in hall.rglob("out/*.csv"):
            when = path.stat().st_mtime_ns
            redone += stood.get(path, when) != when
            stood[path] = when
    timed(hall, 2)
    redone += sum(path.stat().st_mtime_ns != when for path, when in stood.items() if path.parent != hall / "out")
    return len(stood), redone


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--kills", type=int, default=20)
    given = parser.parse_args()
    for name in THREADS:
        os.environ[name] = "1"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        rendered(folder, given.runs, given.seconds)
        halls = {n: Path(shutil.copytree(folder / "hall", folder / n / "hall")) for n in ("one", "two", "killed")}
        one, two = timed(halls["one"], 1), timed(halls["two"], 2)
        again = timed(halls["one"], 1)
        same = digest(halls["one"]) == digest(halls["two"])
        stood, redone = killed(halls["killed"], given.kills, two)
        after = digest(halls["killed"]) == digest(halls["one"])
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"{given.runs} runs of {given.seconds:g} s, and three that cannot be used; {os.cpu_count()} cores")
    print(f"one worker           {one:7.1f} s")
    print(f"two workers          {two:7.1f} s   {one / two:.2f} times faster; the same bytes: {same}")
    print(f"nothing to do        {again:7.1f} s")
    print(
        f"killed {given.kills} times        {stood} results stood, {redone} of them redone; the same bytes in the end: {after}"
    )
    print(f"largest process      {peak:7.0f} MiB")


if __name__ == "__main__":
    main()
