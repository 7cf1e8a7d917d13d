"""Half an hour of film and two hundred runs: seconds and memory of the commands against frames and runs.

    python benchmarks/whole_path.py [--frames 6000 18000 54000] [--runs 50 100 200]

The film is a sample joined to itself without encoding it again, taken through ``towline run``: tracked, mapped, refused by the fit
with a line that names where it steps. What the fit takes is measured on records of as many frames that are one tow
(``identify_scale``), and on campaigns of small runs: 20 s at 25 samples a second, one after the other with one worker. Each command
is run once more: what is done is not done again. The largest campaign is interrupted in its joint step, too, and on its page.
Every command runs on a terminal, where its progress is.
"""

from __future__ import annotations

import argparse
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from identify_cases import POINTS_M, times
from identify_scale import LONG_POINT_M, written

from towline.pipeline.executor.processes import THREADS

SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446"
RATE_HZ = 30.0
LOOK_EVERY_S = 0.05
FITTING, DRAWING = re.compile(r"full: step \d+"), re.compile(r"drawing the page")
"""What a campaign says in its joint step, and once that is done."""
SCRATCH = re.compile(r"\S*/(?=(film|long|campaign)-)")
CONTROLS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def joined(folder: Path, frames: int) -> Path:
    """A run whose video is the sample's, again and again."""
    import av

    folder.mkdir(parents=True)
    with av.open(str(SAMPLE / "video.mp4")) as source, av.open(str(folder / "video.mp4"), "w") as target:
        stream = source.streams.video[0]
        out = target.add_stream_from_template(stream)
        packets = [p for p in source.demux(stream) if p.dts is not None]
        length = max(p.pts + p.duration for p in packets if p.pts is not None)
        data = [(bytes(p), p.pts, p.dts, p.duration, p.is_keyframe) for p in packets]
        for k in range(frames):
            turn, at = divmod(k, len(data))
            content, pts, dts, duration, key = data[at]
            packet = av.Packet(content)
            packet.pts, packet.dts, packet.duration = pts + turn * length, dts + turn * length, duration
            packet.time_base, packet.stream, packet.is_keyframe = stream.time_base, out, key
            target.mux(packet)
    shutil.copy(SAMPLE / "run.toml", folder)
    return folder


def timed(arguments: Sequence[str | Path], stop_at: re.Pattern | None = None) -> tuple[float, float, float, int, str]:
    """Wall and processor seconds, largest memory of a process in MiB, exit code, and what it said last; on a terminal.

    stop_at : SIGINT as soon as the progress says this
    """
    began = time.perf_counter()
    here, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "towline", *map(str, arguments)], stdout=terminal, stderr=terminal, stdin=terminal
    )
    os.close(terminal)
    os.set_blocking(here, False)
    largest, busy, said, looked = 0.0, 0.0, "", 0
    while process.poll() is None:
        rss, cpu = _tree(process.pid)
        largest, busy = max(largest, rss), max(busy, cpu)
        said += _heard(here)
        if stop_at is not None and (found := stop_at.search(said, looked)):
            process.send_signal(signal.SIGINT)
            stop_at = None
            print(f"{'':34}stopped at: {found.group(0)}")
        looked = max(0, len(said) - 200)
        time.sleep(LOOK_EVERY_S)
    said += _heard(here)
    os.close(here)
    lines = [line for line in re.split(r"[\r\n]+", CONTROLS.sub("", said)) if line.strip()]
    return time.perf_counter() - began, busy, largest, process.returncode, lines[-1] if lines else ""


def _heard(terminal: int) -> str:
    parts = []
    with suppress(OSError):  # nothing there now, or the other side is gone
        while part := os.read(terminal, 1 << 16):
            parts.append(part.decode(errors="replace"))
    return "".join(parts)


def _tree(pid: int) -> tuple[float, float]:
    """Memory of the largest of a process and its children, MiB, and the processor seconds of all that live."""
    import psutil

    try:
        one = psutil.Process(pid)
        found = [one, *one.children(recursive=True)]
        memory = [p.memory_info().rss / 2**20 for p in found]
        spent = sum(sum(p.cpu_times()[:4]) for p in found)
    except psutil.Error:
        return 0.0, 0.0
    return max(memory), spent


def _row(words: str, size: int, found: tuple[float, float, float, int, str]) -> None:
    wall, busy, memory, code, last = found
    print(
        f"{words:34}{size:8d}{wall:9.1f}{busy:11.1f}{1000 * busy / size:14.2f}{memory:9.0f}{code:6d}   {_short(last)}",
        flush=True,
    )


def _short(last: str) -> str:
    return SCRATCH.sub("", last)[:60]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, nargs="*", default=[6000, 18000, 54000])
    parser.add_argument("--runs", type=int, nargs="*", default=[50, 100, 200])
    given = parser.parse_args()
    for name in THREADS:
        os.environ[name] = "1"
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job passes on that it is ignored
    print(f"{'':34}{'size':>8}{'seconds':>9}{'processor':>11}{'ms each':>14}{'MiB':>9}{'exit':>6}   said last")
    with tempfile.TemporaryDirectory() as place:
        folder, rng = Path(place), np.random.default_rng(24)
        for frames in given.frames:
            run = joined(folder / f"film-{frames}", frames)
            _row("run, a film, frames", frames, timed(["run", run]))
            _row("  once more", frames, timed(["run", run]))
            shutil.rmtree(run)
        for frames in given.frames:
            run = written(folder, f"long-{frames}", LONG_POINT_M, times(RATE_HZ, frames / RATE_HZ), rng)
            _row("identify, one tow, frames", frames, timed(["identify", run]))
        many = folder / "many"
        for k in range(max(given.runs, default=0)):
            written(many, f"run-{k + 1:03d}", POINTS_M[k % 4], times(25.0, 20.0), rng)
        for runs in given.runs:
            some = folder / f"campaign-{runs}"
            for run in sorted(many.glob("run-*"))[:runs]:
                shutil.copytree(run, some / run.name)
            command = ["campaign", some, "--workers", "1"]
            if runs == max(given.runs):
                _row("campaign, stopped in its fit", runs, timed(command, FITTING))
                _row("campaign, stopped after its fit", runs, timed(command, DRAWING))
                _row("campaign, to its end", runs, timed(command))
                shutil.rmtree(some / "out")
            _row("campaign, runs", runs, timed(command))
            _row("  once more", runs, timed(command))
            shutil.rmtree(some)


if __name__ == "__main__":
    main()
