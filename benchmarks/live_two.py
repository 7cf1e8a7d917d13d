"""Two network cameras of one tow, not synchronised, heard by ``towline live`` as it is sent: loss, latency, and their clocks.

    python benchmarks/live_two.py OUT [--tows 4] [--first 5000]

The tows are those of ``two_cameras_rendered`` (two films of 1280x720, 30-45 s, offsets to 2 s; without loss, since what H.264 holds
back of a mark's way no camera of JPEG pictures does), each film sent as MJPEG over HTTP in real time on one clock of the tow, by
a server of its own. The sources send no stamps: frames are stamped when they come.
Latency: from a picture's last byte to what both cameras say of it. Offset: the second clock against the first as the recordings
have it, from when their pictures were taken, with the recordings' times as in tracks: those of each camera's beat
(``vision.recording.beat``); late: by how much its pictures came after it, median of the two cameras' 99th percentiles.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from live_senders import jpegs, serve_jpegs
from two_cameras_cases import Case
from two_cameras_rendered import rendered

from towline.record import read_run
from towline.record.run import cameras_of
from towline.vision import read_frames
from towline.vision.recording.beat import on_beat

AHEAD_S, AFTER_S = 8.0, 6.0
"""The tow begins so long after the command, which ends so long after it."""
SETTLED_S = 2.0


def heard(folder: Path, case: Case, day: Path) -> str:
    """One tow sent and heard: a row of the table."""
    films = [jpegs(view.source_path) for view in cameras_of(read_run(folder))]
    clocks = ((0.0, 1.0), (case.offset_s, 1.0 + case.rate))
    ends = [zero + step * len(pictures) / rate for (pictures, rate), (zero, step) in zip(films, clocks, strict=True)]
    sent: tuple[dict[int, float], ...] = ({}, {})
    begins_s, addresses = time.monotonic() + AHEAD_S, []
    for (pictures, rate), (zero, step), log in zip(films, clocks, sent, strict=True):
        note = partial(_note, log)
        seconds = step * len(pictures) / rate
        server = serve_jpegs(pictures, rate / step, 0, seconds, note, zero_s=begins_s + zero)
        addresses.append(f"http://127.0.0.1:{server.server_address[1]}/")
    words = [sys.executable, "-m", "towline", "live", *addresses, str(day), "--like", str(folder), "--no-fit"]
    hears = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(begins_s + max(ends) + AFTER_S - time.monotonic())
    hears.send_signal(signal.SIGINT)
    _, _, used = os.wait4(hears.pid, 0)
    hears.returncode = 0
    tow, text, zeros_s, late_ms = day / "tow-01", "", [], []
    for view, log, (_, rate), (zero, step) in zip(cameras_of(read_run(tow)), sent, films, clocks, strict=True):
        frames = [line for line in lines_of(tow / "out" / view.camera / "live.jsonl") if "frame" in line]
        text += f"{len(log):8d}{sum(1 for _ in read_frames(view.source_path)):6d}{len(frames):6d}"
        # when, on the tow's clock, the recording's own shows 0
        number, came_s = np.array([(line["frame"], line["t_s"]) for line in frames]).T
        beat = on_beat(came_s)
        late_ms.append(1e3 * float(np.percentile(beat.late_s, 99)))
        zeros_s.append(float(np.median(zero + step * (min(log) + number) / rate - beat.t_s)))
    text += f"{np.median(late_ms):7.0f}"
    return text + row(
        lines_of(tow / "out" / "live.jsonl"), zeros_s[1] - zeros_s[0], (used.ru_utime + used.ru_stime) / max(ends)
    )


def _note(log: dict[int, float], number: int) -> None:
    log[number] = time.monotonic()


def row(joint: list[dict[str, Any]], offset_s: float, core: float) -> str:
    """What both said together."""
    late = np.array([1e3 * line["latency_s"] for line in joint if "joint" in line and line["t_s"] > SETTLED_S])
    text = f"{np.median(late):9.0f}{np.percentile(late, 99):6.0f}{late.max():6.0f}{core:6.2f}"
    told = [line for line in joint if line.get("told") is True and "offset_s" in line]
    if not told:
        return text + "   clock not told"
    first, last = ((1e3 * (line["offset_s"][0] - offset_s), 1e3 * line["offset_s"][1]) for line in (told[0], told[-1]))
    return text + f"{told[0]['t_s']:8.1f}{first[0]:9.1f} +- {first[1]:4.1f}{last[0]:8.1f} +- {last[1]:4.1f}"


def lines_of(path: Path) -> list[dict[str, Any]]:
    """Of live.jsonl."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tows", type=int, default=4)
    parser.add_argument("--first", type=int, default=5000)
    given = parser.parse_args()
    print(
        "tow; first camera's pictures sent, recorded, looked at; second's; late, ms; from picture to value, ms: median, 99 %, most;"
    )
    print(
        "of a core; when the second clock was told, s; how far off it was, ms, with its stated sd: then, and at the end"
    )
    for seed in range(given.first, given.first + given.tows):
        case = rendered(seed, False, given.out, lossless=True)
        day = given.out / f"day-{seed}-{int(time.time())}"
        print(f"level-{seed:<6}" + heard(given.out / f"level-{seed}", case, day), flush=True)


if __name__ == "__main__":
    main()
