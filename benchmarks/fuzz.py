"""Damaged recordings: what the decoder makes of 200 broken copies of a clip whose every frame is known.

    python benchmarks/fuzz.py [--copies 200] [--seed 1] [--threads 2] [--list]

Two moving spots, 640 x 480, 120 frames at 30 Hz, H.264: an mp4 with B frames (index in front) and an mkv without. Each frame
carries its own number as a row of large blocks, so that a frame handed out tells which one it is. Copies are broken by flipped
bits in the index or the pictures, wiped stretches, truncation, and packets left out or doubled. Every copy is read in a watched
process; of every frame that is not marked as damaged, the time must be that very frame's own and the spots must look as in the
unbroken clip, or the recording must have said that it is doubtful (*warned*: a note, which the commands print). Ends with code 1 if
there was a crash, a hang or a wrong time without a word.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Timer

import numpy as np
from fuzz_copies import BREAKINGS, FRAMES, HEIGHT, RATE_HZ, WIDTH, Copy, make_clip, number_of, plan, spot_windows

from towline.record import VideoError
from towline.vision import read_frames

TIME_TOLERANCE_S = 6e-4
"""Matroska counts in milliseconds: half of one, and a little."""
PICTURE_TOLERANCE_DN = 4
HANG_S = 30.0
MEMORY_BYTES = 4 << 30
WORKERS, COPIES_PER_WORKER = 2, 50
OUTCOMES = ("clean", "gaps", "warned", "error", "wrong time", "wrong picture", "hang", "crash")


def judge(path: Path, truth: np.ndarray, threads: int) -> dict:
    """Read a copy and say what came of it.

    Parameters
    ----------
    truth : (frames, 2, s, s), the spots of the unbroken clip
    threads : decoder threads; more than one reads clips with B frames in haste first
    """
    good = damaged = wrong_time = wrong_picture = 0
    note = error = ""
    said: list[str] = []
    try:
        for frame in read_frames(path, decode_threads=threads):
            said += frame.notes
            if frame.damaged:
                damaged += 1
                continue
            good += 1
            number, place = number_of(frame.luma), round(frame.t_s * RATE_HZ)
            if number < FRAMES and _looks_like(frame.luma, number, truth):
                if abs(frame.t_s - number / RATE_HZ) > TIME_TOLERANCE_S:
                    wrong_time += 1
                    note = note or f"frame {number} at {frame.t_s:.6f} s, true {number / RATE_HZ:.6f} s"
            else:
                wrong_picture += 1
                note = note or f"picture at {frame.t_s:.6f} s reads {number}, is at the place of {place}"
    except VideoError as caught:
        error = str(caught)
    if error:
        outcome = "error"  # ends the evaluation: frames before it are not used
    elif said:
        outcome = "warned"
    elif wrong_time:
        outcome = "wrong time"
    elif wrong_picture:
        outcome = "wrong picture"
    else:
        outcome = "clean" if good == FRAMES and not damaged else "gaps"
    return {
        "outcome": outcome,
        "good": good,
        "damaged": damaged,
        "wrong_time": 0 if said else wrong_time,
        "warned_time": wrong_time if said else 0,
        "wrong_picture": wrong_picture,
        "said": said,
        "error": error,
        "note": note,
    }


def _looks_like(luma: np.ndarray, number: int, truth: np.ndarray) -> bool:
    if luma.shape != (HEIGHT, WIDTH):
        return False
    return bool(np.abs(spot_windows(luma, number) - truth[number]).max() <= PICTURE_TOLERANCE_DN)


def _work(folder: Path, threads: int) -> None:
    """Judge the files named on standard input, one JSON line each."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    truth = {suffix: np.load(folder / f"truth{suffix}.npy") for suffix in (".mp4", ".mkv")}
    for line in sys.stdin:
        path = Path(line.rstrip("\n"))
        result = judge(path, truth[path.suffix], threads)
        result["peak_mib"] = _peak_mib()
        print(json.dumps(result), flush=True)


def _peak_mib() -> int:
    """Peak memory of this process (getrusage would count the parent's before the start)."""
    status = Path("/proc/self/status").read_text() if sys.platform == "linux" else ""
    peak = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return int(peak[0]) // 1024 if peak else 0


class Watched:
    """A process that judges copies, watched: one that does not answer in time is ended and counted as a hang."""

    def __init__(self, folder: Path, threads: int) -> None:
        self._folder, self._threads = folder, threads
        self._process: subprocess.Popen | None = None

    def judge(self, path: Path) -> dict:
        """Judge a copy, in a new process if the last one is gone."""
        if self._process is None or self._process.poll() is not None:
            command = [sys.executable, __file__, "--work", str(self._folder), "--threads", str(self._threads)]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        late: list[bool] = []
        timer = Timer(HANG_S, lambda: (late.append(True), process.kill()))
        timer.start()
        try:
            process.stdin.write(f"{path}\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        timer.cancel()
        if line:
            return json.loads(line)
        process.wait()
        return {"outcome": "hang" if late else "crash", "note": f"exit code {process.returncode}"}

    def close(self) -> None:
        """End the process."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
            self._process.wait()


def fuzz(copies: int, seed: int, threads: int) -> Iterator[tuple[Copy, dict]]:
    """Make and judge copies."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for suffix, b_frames in ((".mp4", 2), (".mkv", 0)):
            clip = folder / f"clip{suffix}"
            make_clip(clip, b_frames)
            frames = list(read_frames(clip))
            assert [number_of(frame.luma) for frame in frames] == list(range(FRAMES))
            np.save(folder / f"truth{suffix}.npy", [spot_windows(f.luma, f.index) for f in frames])
        workers = WORKERS if copies > COPIES_PER_WORKER else 1
        watched = [Watched(folder, threads) for _ in range(workers)]

        def one(job: tuple[int, Copy]) -> tuple[Copy, dict]:
            index, copy = job
            path = folder / f"{index}{copy.suffix}"
            rng = np.random.default_rng(copy.seed)
            path.write_bytes(BREAKINGS[copy.kind][1](folder / f"clip{copy.suffix}", rng))
            worker = watched.pop()
            try:
                return copy, worker.judge(path)
            finally:
                watched.append(worker)
                path.unlink()

        with ThreadPoolExecutor(workers) as pool:
            yield from pool.map(one, enumerate(plan(copies, seed)))
        for worker in watched:
            worker.close()


def main() -> int:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--copies", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2, help="decoder threads")
    parser.add_argument("--list", action="store_true", help="print every copy")
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work is not None:
        _work(given.work, given.threads)
        return 0
    began = time.perf_counter()
    table: dict[tuple[str, str], Counter] = {}
    frames: Counter = Counter()
    for copy, result in fuzz(given.copies, given.seed, given.threads):
        row = table.setdefault((copy.suffix, copy.kind), Counter())
        row[result["outcome"]] += 1
        frames.update(
            {key: result.get(key, 0) for key in ("good", "damaged", "wrong_time", "warned_time", "wrong_picture")}
        )
        frames["peak_mib"] = max(frames["peak_mib"], result.get("peak_mib", 0))
        if given.list or result["outcome"] in ("wrong time", "wrong picture", "hang", "crash"):
            print(f"{copy.suffix} {copy.kind}, seed {copy.seed}: {result}")
    print(f"{'':30}" + "".join(f"{name:>14}" for name in ("copies", *OUTCOMES)))
    total: Counter = Counter()
    for suffix in (".mp4", ".mkv"):
        for kind in BREAKINGS:
            row = table.get((suffix, kind), Counter())
            total += row
            print(f"{suffix[1:]:4} {kind:25}{row.total():14}" + "".join(f"{row[name] or '-':>14}" for name in OUTCOMES))
    print(f"{'all':30}{total.total():14}" + "".join(f"{total[name] or '-':>14}" for name in OUTCOMES))
    print(
        f"\nframes: {frames['good']} handed out as good, of them {frames['wrong_time']} with a wrong time and "
        f"{frames['wrong_picture']} with a wrong picture; {frames['damaged']} marked as damaged; "
        f"{frames['warned_time']} with a wrong time in recordings that say so; "
        f"peak memory {frames['peak_mib']} MiB; {time.perf_counter() - began:.0f} s"
    )
    return int(any(total[name] for name in ("wrong time", "hang", "crash")))


if __name__ == "__main__":
    sys.exit(main())
