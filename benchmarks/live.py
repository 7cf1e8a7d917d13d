"""``towline live`` on the loopback, its provisional values, and faults planted in live tows.

    python benchmarks/live.py [--seconds 180] [--tows 60] [--sequences 40] [--only loopback work values planted settles enough]

Loopback: a rendered tow (720p at 30 frames/s, and 1080p at 60) is played forwards and backwards and sent by ffmpeg's libraries
over UDP (H.264 in MPEG-TS), by a server over RTSP (where rtsp-server-perl of Debian is installed), and as MJPEG over HTTP, by
processes of their own; ``towline live`` hears it. Latency is from the moment at which a picture's last byte was handed to the
system until its values were there; which picture is which is told by y against the truth. Values: the sample films, frame by
frame, as fast as they are read; provisional values against the tracks that are made later of the same film and against the
truth, z by the stated standard deviation. Planted: windows of 20 s of the sample films with a fault from a random moment on,
and as many without; a fault is named when an event of its kind comes within 2 s of the film's time, and nothing else counts.
Work: processor time of a frame, until its values are out and after them, which the load of the machine does not move as it
moves latencies. Settles: X_v of steady tows while they settle (``live_settles``). Enough: days of simulated tows with a wish
(``live_enough``).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from live_enough import judge
from live_planted import KINDS, bases, planted
from live_settles import settles

from towline.geometry import motion_from_tracks
from towline.live.session import Looking
from towline.live.stamped import Stamped
from towline.pipeline.stages import fit_run_datum
from towline.record.run import read_run
from towline.record.tables import read_motion
from towline.vision import read_frames, track
from towline.vision.backend import NUMPY
from towline.vision.recording.codecs import losses

HERE = Path(__file__).resolve().parent
SAMPLES = HERE.parent / "sample_videos"
FILMS = {"720p 30/s": (1280, 720, 30.0, 40.0), "1080p 60/s": (1920, 1080, 60.0, 12.0)}
SERVER = "rtsp-server-perl"
SETTLED_S = 2.0
"""Frames after the first so many seconds count for latency: before, what was read to learn the format comes at once."""
NAMED_S = 2.0
WORK_S = 12.0
"""Of a sample film whose frames' work is timed."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--tows", type=int, default=60)
    parser.add_argument("--sequences", type=int, default=40)
    parser.add_argument("--seed", type=int, default=30)
    parser.add_argument("--only", nargs="+", default=["loopback", "work", "values", "planted", "settles", "enough"])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        if "loopback" in options.only:
            loopback(Path(scratch), options.seconds)
        if "work" in options.only:
            work()
        if "values" in options.only:
            values()
        if "planted" in options.only:
            plant(options.tows, options.seed)
        if "settles" in options.only:
            settles(options.tows, options.seed)
        if "enough" in options.only:
            judge(Path(scratch), options.sequences, options.seed)


# sources on the loopback ----------------------------------------------------------------------------------------------


def loopback(scratch: Path, seconds: float) -> None:
    """Every source at 720p 30/s; UDP at 1080p 60/s for a fifth of the time."""
    print(
        "sources on the loopback: latency from a picture's last byte to y, beta, alpha, ms; all frames after the first 2 s"
    )
    print(
        f"{'source':28}{'s':>5}{'sent':>7}{'recorded':>9}{'looked at':>10}{'median':>8}{'99 %':>7}{'largest':>8}"
        f"{'late':>6}{'core':>6}{'MiB at 1/4':>11}{'end':>6}"
    )
    for name, (width, height, rate, length) in FILMS.items():
        folder = looped(scratch, name, width, height, rate, length)
        for kind in ("udp", "rtsp", "http") if rate == 30 else ("udp",):
            if kind == "rtsp" and shutil.which(SERVER) is None:
                print(f"{name} rtsp: {SERVER} is not installed")
                continue
            print(heard(scratch, folder, f"{name} {kind}", kind, seconds if rate == 30 else seconds / 5), flush=True)
    print()


def looped(scratch: Path, name: str, width: int, height: int, rate: float, length_s: float) -> Path:
    """A run whose film goes forwards and backwards, so that it can be sent again and again without a jump."""
    import av

    text = (SAMPLES / "mariner" / "x1446" / "scenario.toml").read_text(encoding="utf-8")
    focus = 920.0 * height / 600
    for old, new in (
        ("image_size_px = [800, 600]", f"image_size_px = [{width}, {height}]"),
        ("fx_px = 920.0", f"fx_px = {focus}"),
        ("fy_px = 920.0", f"fy_px = {focus}"),
        ("cx_px = 399.5", f"cx_px = {(width - 1) / 2}"),
        ("cy_px = 299.5", f"cy_px = {(height - 1) / 2}"),
        ("duration_s = 40.0", f"duration_s = {length_s}"),
        ("rate_hz = 30.0", f"rate_hz = {rate}"),
    ):
        assert old in text
        text = text.replace(old, new)
    folder = scratch / name.replace(" ", "_").replace("/", "_")
    folder.mkdir()
    (folder / "scenario.toml").write_text(text, encoding="utf-8")
    towline("render", str(folder / "scenario.toml"), "-o", str(folder))
    pictures = [frame.raw for frame in read_frames(folder / "video.mp4")]
    with av.open(str(folder / "looped.mp4"), "w") as target:
        stream = target.add_stream(
            "libx264", rate=Fraction(rate), options={"crf": "21", "preset": "veryfast", "bf": "0"}
        )
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.gop_size = round(rate)
        for number, raw in enumerate([*pictures, *pictures[::-1]]):
            raw.pts, raw.time_base = number, 1 / Fraction(rate)
            raw.pict_type = 0
            target.mux(stream.encode(raw))
        target.mux(stream.encode(None))
    shutil.move(folder / "looped.mp4", folder / "video.mp4")
    return folder


def towline(*words: str) -> str:
    """Run a command to its end."""
    done = subprocess.run([sys.executable, "-m", "towline", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"towline {' '.join(words)}: {done.stderr}")
    return done.stdout


def heard(scratch: Path, folder: Path, name: str, kind: str, seconds: float) -> str:
    """Hear one source: a row of the table."""
    port, log, day = (
        {"udp": 5401, "rtsp": 8654, "http": 8480}[kind],
        scratch / f"{kind}.log",
        scratch / f"day-{name[:5]}-{kind}",
    )
    address = {
        "udp": f"udp://127.0.0.1:{port}",
        "rtsp": f"rtsp://127.0.0.1:{port - 1}/tow",
        "http": f"http://127.0.0.1:{port}/",
    }[kind]
    send = [
        sys.executable,
        str(HERE / "live_senders.py"),
        kind,
        str(folder / "video.mp4"),
        str(port),
        str(seconds),
        str(log),
    ]
    live = [sys.executable, "-m", "towline", "live", address, str(day), "--like", str(folder), "--no-fit"]
    server = sender = None
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    if kind == "rtsp":
        words = [SERVER, "--serverport", str(port), "--clientport", str(port - 1), "--rtp_start_port", "20000"]
        server = subprocess.Popen(words, **quiet)
        time.sleep(1.0)
    if kind == "http":
        sender = subprocess.Popen(send, stdout=subprocess.PIPE)
        assert sender.stdout is not None
        sender.stdout.readline()
    hears = subprocess.Popen(live, **quiet)
    if sender is None:
        while kind == "udp" and f":{port:04X} " not in Path("/proc/net/udp").read_text(encoding="utf-8"):
            time.sleep(0.1)
        sender = subprocess.Popen(send, **quiet)
    memory: list[float] = []
    began = time.monotonic()
    while time.monotonic() - began < seconds + 6:
        time.sleep(0.5)
        memory.append(resident_mib(hears.pid))
    hears.send_signal(signal.SIGINT)
    _, _, used = os.wait4(hears.pid, 0)
    hears.returncode = 0
    for process in (sender, server):
        if process is not None:
            process.terminate()
            process.wait()
    tow = day / "tow-01"
    return f"{name:28}{row(tow, folder, log, seconds, used.ru_utime + used.ru_stime, memory)}"


def resident_mib(pid: int) -> float:
    """Memory that a process holds."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return float("nan")
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")), float("nan"))


def row(tow: Path, folder: Path, log: Path, seconds: float, cpu_s: float, memory: list[float]) -> str:
    """What became of one source's frames."""
    sent = {
        int(n): float(t) for n, t in (line.split() for line in log.read_text().splitlines() if line.count(" ") == 1)
    }
    frames = [r for r in map(json.loads, (tow / "out" / "live.jsonl").read_text().splitlines()) if "frame" in r]
    shift = first_sent(frames, folder, sent)
    recorded = sum(1 for _ in read_frames(read_run(tow).source_path))
    late = np.array([
        1e3 * (r["arrived_s"] + r["latency_s"] - sent[r["frame"] + shift])
        for r in frames
        if r["t_s"] > SETTLED_S and r["frame"] + shift in sent
    ])  # fmt: skip
    quarter = memory[len(memory) // 4]
    return (
        f"{seconds:5.0f}{len(sent):7d}{recorded:9d}{len(frames):10d}{np.median(late):8.1f}{np.percentile(late, 99):7.1f}"
        f"{late.max():8.1f}{int((late > 100).sum()):6d}{cpu_s / seconds:6.2f}{quarter:11.0f}{np.nanmax(memory):6.0f}"
        f"{'':>6}(first heard {shift})"
    )


def first_sent(frames: list[dict[str, Any]], folder: Path, sent: dict[int, float]) -> int:
    """Which picture the first one heard is: by y against the truth of the film, forwards and backwards."""
    there = read_motion(folder / "truth" / "motion.csv")["y_cg_m"].to_numpy()
    there = np.concatenate([there, there[::-1]])
    some = [r for r in frames if r["y_cg_m"] is not None][: 2 * len(there)]
    index, y = np.array([r["frame"] for r in some]), np.array([r["y_cg_m"][0] for r in some])
    most = min(len(there), max(sent) + 1)
    off = [np.mean((there[(index + shift) % len(there)] - y) ** 2) for shift in range(most)]
    return int(np.argmin(off))


# work of a frame ------------------------------------------------------------------------------------------------------


def work() -> None:
    """Processor time of a frame's work, once the marks were learnt (two seconds)."""
    run = read_run(SAMPLES / "mariner" / "x1446")
    looking = Looking(run, fit_run_datum(run), "h264")
    spent = []
    for frame in list(read_frames(run.source_path, (0.0, WORK_S))):
        times = [time.thread_time()]
        looking.step(Stamped(frame, frame.t_s))
        times.append(time.thread_time())
        looking.settle()
        spent.append(1e3 * np.diff([*times, time.thread_time()]))
    until, after = np.array(spent)[round(SETTLED_S * 30) :].T
    print(
        f"processor time of a frame, ms, 800x600, {len(until)} frames: until its values are out median {np.median(until):.1f}, ",
        end="",
    )
    print(
        f"99 % {np.percentile(until, 99):.1f}; after that mean {after.mean():.1f}, largest {after.max():.0f}\n",
        flush=True,
    )


# provisional values ---------------------------------------------------------------------------------------------------


def values() -> None:
    """z of the provisional values against the later motion and the truth."""
    print(
        "provisional values of the sample films: z, the rms of the difference (its mean taken out) over the stated standard"
    )
    print(
        "deviation of a frame, against the motion made later of the whole film and against the truth; frames without a value"
    )
    print("(none); ms a frame")
    heads = ("later: y", "beta", "alpha", "truth: y", "beta", "alpha", "later/truth y")
    print(f"{'film':18}" + "".join(f"{head:>{max(7, len(head) + 2)}}" for head in heads) + f"{'none':>6}{'ms':>6}")

    def cells(z: Sequence[float]) -> str:
        return "".join(f"{value:{max(7, len(head) + 2)}.2f}" for head, value in zip(heads, z, strict=True))

    total: list[list[float]] = []
    for folder in sorted(SAMPLES.glob("*/*/run.toml")):
        run = read_run(folder.parent)
        fit = fit_run_datum(run)
        looking = Looking(run, fit, "h264")
        rows, spent = [], 0.0
        for frame in read_frames(run.source_path):
            began = time.perf_counter()
            seen, _ = looking.step(Stamped(frame, frame.t_s))
            looking.settle()
            spent += time.perf_counter() - began
            assert seen is not None
            rows.append([x for v in (seen.y_cg_m, seen.beta_rad, seen.alpha_rad) for x in (v.value, v.sd)])
        found = np.array(rows)
        tracks = track(run, read_frames(run.source_path), fit.mapping, None, NUMPY, *losses("h264")).table
        later = motion_from_tracks(run, tracks, fit).motion
        truth = read_motion(folder.parent / "truth" / "motion.csv")
        names = ("y_cg_m", "beta_rad", "alpha_rad")
        z = [
            _z(found[:, 2 * i], m[n].to_numpy(), found[:, 2 * i + 1])
            for m in (later, truth)
            for i, n in enumerate(names)
        ]
        own = _z(later["y_cg_m"].to_numpy(), truth["y_cg_m"].to_numpy(), later["sigma_y_cg_m"].to_numpy())
        none = int(np.isnan(found[:, 0]).sum())
        total.append([*z, own])
        print(f"{run.name:18}{cells(total[-1])}{none:6d}{1e3 * spent / len(found):6.1f}", flush=True)
    middle = np.sqrt((np.array(total) ** 2).mean(axis=0))
    print(f"{'all (rms)':18}{cells(middle)}\n")


def _z(value: np.ndarray, there: np.ndarray, sd: np.ndarray) -> float:
    off = value - there
    return float(np.sqrt(np.nanmean(((off - np.nanmean(off)) / sd) ** 2)))


# planted faults -------------------------------------------------------------------------------------------------------


def plant(tows: int, seed: int) -> None:
    """Faults planted and named; clean tows in which nothing is named."""
    rng = np.random.default_rng(seed)
    films = list(bases(SAMPLES))
    named, delays, others = Counter(), {kind: [] for kind in KINDS}, Counter()
    for number in range(tows):
        kind = KINDS[number % len(KINDS)]
        case = planted(films[int(rng.integers(len(films)))], kind, rng)
        events = watched(case)
        at = [e.t_s - case.begins_s for e in events if e.kind == kind and e.level != "good" and e.t_s >= case.begins_s]
        if at and min(at) <= NAMED_S:
            named[kind] += 1
            delays[kind].append(min(at))
        else:
            print(f"  not named: {case.words}; said: {[(e.kind, round(e.t_s, 2)) for e in events]}")
        others.update(e.kind for e in events if e.level != "good" and (e.kind != kind or e.t_s < case.begins_s))
    print(f"faults planted in {tows} live tows of 20 s, named within 2 s of the film's time")
    for kind in KINDS:
        count = sum(KINDS[n % len(KINDS)] == kind for n in range(tows))
        late = f"after {np.median(delays[kind]):.2f} s (latest {max(delays[kind]):.2f})" if delays[kind] else ""
        print(f"  {kind:10}{named[kind]:4d} of {count}   {late}")
    print(f"  all       {sum(named.values()):4d} of {tows}; named beside the planted: {dict(others) or 'nothing'}")
    false = 0
    for _ in range(tows):
        case = planted(films[int(rng.integers(len(films)))], None, rng)
        events = watched(case)
        false += bool(events)
        for event in events:
            print(f"  in a clean tow ({case.words}): {event}")
    print(f"clean tows in which something was named: {false} of {tows}")


def watched(case: Any) -> list[Any]:
    """Everything that is named in a case."""
    looking = Looking(case.run, case.fit, case.codec)
    events: list[Any] = []
    for stamped in _cut(case):
        events += looking.step(stamped)[1]
        looking.settle()
    return events


def _cut(case: Any) -> Iterator[Stamped]:
    for number, (frame, t_s, arrived_s) in enumerate(case.frames()):
        yield Stamped(replace(frame, index=number, t_s=t_s), arrived_s)


if __name__ == "__main__":
    main()
