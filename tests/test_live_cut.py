"""A tow whose machine dies while it is filmed: the film up to the last second is there, and the run is an ordinary one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from clips import film, number_of, pieces

from towline.cli import main
from towline.live.folder import make_folder, next_of, tows_of
from towline.live.pieces import Packet
from towline.live.recorder import Recorder
from towline.record.run import read_run
from towline.vision import read_frames

HOUSE = Path(__file__).resolve().parents[2]
LOST_S = 1.0
"""Film that a cut may cost at most."""
RATE_HZ = 30
LENGTH_S = 8

RECORDING = """
import sys, threading, time
from pathlib import Path
from towline.live.recorder import Recorder
from towline.live.source import Hearing

def record(number, source, folder):
    time.sleep(0.55 * number)
    folder.mkdir()
    recorder = Recorder(folder)

    def take(piece):
        if not recorder.name:
            (folder / "began").write_text(repr(time.monotonic()))
        return recorder.take(piece)

    Hearing(source, take).start()

for number in range(int(sys.argv[3])):
    folder = Path(sys.argv[2]) / str(number)
    threading.Thread(target=record, args=(number, sys.argv[1], folder)).start()
print("recording", flush=True)
time.sleep(60)
"""
"""Records one film several times over, each a little later than the one before: one kill meets each at another moment."""


@pytest.mark.slow
@pytest.mark.parametrize(("codec", "suffix", "name"), [("libx264", "mp4", "film.ts"), ("mjpeg", "mkv", "film.mkv")])
def test_kill_9_at_several_moments_costs_the_last_second_at_most(
    tmp_path: Path, codec: str, suffix: str, name: str
) -> None:
    """A film at its own rate, recorded six times by one process that is killed: what had been sent by then is known by the
    clock alone."""
    source = encoded(tmp_path / f"film.{suffix}", codec, RATE_HZ * LENGTH_S)
    many = 6
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDING, str(source), str(tmp_path), str(many)], stdout=subprocess.PIPE, cwd=HOUSE
    )
    try:
        assert process.stdout is not None
        process.stdout.readline()
        last = tmp_path / str(many - 1) / "began"
        until = time.monotonic() + 30
        while not last.exists() and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(0.3)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        killed_s = time.monotonic()
        process.wait()
    for number in range(many):
        sent_s = killed_s - float((tmp_path / str(number) / "began").read_text())
        frames = list(read_frames(tmp_path / str(number) / name)) if sent_s > LOST_S else []
        assert [number_of(f.luma) for f in frames if not f.damaged] == list(range(len(frames)))
        assert len(frames) / RATE_HZ >= min(sent_s, LENGTH_S) - LOST_S, number
    assert killed_s - float((tmp_path / "0" / "began").read_text()) > 2 * LOST_S  # so that something was to be kept


def encoded(path: Path, codec: str, count: int) -> Path:
    """A numbered film in this codec."""
    if codec == "libx264":
        return film(path, range(count), Fraction(1, RATE_HZ))
    with av.open(str(path), "w") as target:
        stream: Any = None
        for piece in pieces(codec, count, Fraction(1, RATE_HZ)):
            if not isinstance(piece, Packet):
                stream = target.add_stream_from_template(piece.template, opaque=True)
                continue
            packet = av.Packet(piece.data)
            packet.pts, packet.dts, packet.time_base, packet.stream = piece.pts, piece.dts, piece.base, stream
            packet.is_keyframe = piece.key
            target.mux(packet)
    return path


@pytest.mark.once
@pytest.mark.parametrize(("codec", "name"), [("libx264", "film.ts"), ("mjpeg", "film.mkv")])
@pytest.mark.parametrize("rate", [12, 30, 60])
def test_a_power_cut_costs_the_last_second_at_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, codec: str, name: str, rate: int
) -> None:
    """Of what was written only that stands after a power cut which was put on the disk (fsync): at every moment it holds all
    but the last second's film."""
    now_s, on_disk = [0.0], [0]
    sync = os.fsync

    def put(handle: int) -> None:
        sync(handle)
        if (tmp_path / name).exists() and os.path.samestat(os.fstat(handle), (tmp_path / name).stat()):
            on_disk[0] = os.fstat(handle).st_size

    monkeypatch.setattr("towline.live.recorder.os.fsync", put)
    monkeypatch.setattr("towline.live.recorder.time.monotonic", lambda: now_s[0])
    recorder, cuts = Recorder(tmp_path), {}
    for piece in pieces(codec, 4 * rate, Fraction(1, rate)):
        if isinstance(piece, Packet):
            now_s[0] = piece.arrived_s
        recorder.take(piece)
        cuts.setdefault(on_disk[0], []).append(now_s[0])
    whole = (tmp_path / name).read_bytes()
    assert len(cuts) > 4
    for size, moments in cuts.items():
        (tmp_path / f"cut-{name}").write_bytes(whole[:size])
        kept_s = len(list(read_frames(tmp_path / f"cut-{name}"))) / rate if size and moments[-1] > LOST_S else 0.0
        assert kept_s >= moments[-1] - LOST_S


@pytest.mark.parametrize(("codec", "name"), [("libx264", "film.ts"), ("mjpeg", "film.mkv")])
def test_a_picture_that_was_half_written_is_damaged_or_absent(tmp_path: Path, codec: str, name: str) -> None:
    """Noise, whose pictures take several writes each: cut at any byte, every picture is the one filmed, or said to be damaged."""
    rng = np.random.default_rng(0)
    recorder = Recorder(tmp_path)
    noise = [rng.integers(0, 255, (720, 640), dtype=np.uint8) for _ in range(9)]
    for piece in pieces(codec, 9, Fraction(1, RATE_HZ), planes=noise.__getitem__):
        recorder.take(piece)
    recorder.close()
    whole = (tmp_path / name).read_bytes()
    there = [frame.luma for frame in read_frames(tmp_path / name)]
    assert len(there) == 9
    fewest = 9
    for size in rng.integers(len(whole) // 2, len(whole), 6):
        (tmp_path / f"cut-{name}").write_bytes(whole[:size])
        frames = list(read_frames(tmp_path / f"cut-{name}"))
        assert all(f.damaged or np.array_equal(f.luma, o) for f, o in zip(frames, there, strict=False))
        fewest = min(fewest, len(frames))
    assert fewest < 9


def killed(words: list[str], when: Callable[[], bool]) -> None:
    """Run towline and kill it as soon as ``when`` holds."""
    process = subprocess.Popen([sys.executable, "-m", "towline", *words], stdout=subprocess.DEVNULL, cwd=HOUSE)
    try:
        until = time.monotonic() + 60
        while not when() and process.poll() is None and time.monotonic() < until:
            time.sleep(0.02)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.slow
def test_a_killed_tow_is_an_ordinary_run_and_the_day_goes_on(samples: Path, tmp_path: Path) -> None:
    """The command itself, killed after two seconds of film: tracked afterwards to the last whole picture; the next is tow-02."""
    day, setup = tmp_path / "day", samples / "mariner" / "x1446"
    log = day / "tow-01" / "out" / "live.jsonl"
    killed(
        ["live", str(setup / "video.mp4"), str(day), "--like", str(setup), "--no-fit"],
        lambda: log.is_file() and log.read_text().count('"frame": ') >= 45,
    )
    lines = log.read_text().splitlines()
    seen = [json.loads(line) for line in lines[:-1]]  # the last one may be half a line
    arrived = [record["t_s"] for record in seen if "frame" in record]
    kept = [f.t_s for f in read_frames(day / "tow-01" / "film.ts")]
    assert kept[-1] - kept[0] >= arrived[-1] - arrived[0] - LOST_S
    assert main(["motion", str(day / "tow-01")]) == 0
    assert next_of(day).name == "tow-02"
    assert [path.name for path in tows_of(day)] == ["tow-01"]


def test_a_folder_that_was_begun_and_not_finished_stops_no_later_tow(samples: Path, tmp_path: Path) -> None:
    """Killed before run.toml was whole: what is left is no tow, and the next one can be filmed."""
    setup = read_run(samples / "mariner" / "x1446")
    (tmp_path / "tow-01").mkdir()
    assert tows_of(tmp_path) == []
    made = make_folder(setup, next_of(tmp_path), "film.ts")
    assert [path.name for path in tows_of(tmp_path)] == [made.folder.name]


def test_a_run_folder_appears_whole_or_not_at_all(
    samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its run.toml cannot be written: no folder of a tow is there, nor anything else."""
    setup = read_run(samples / "mariner" / "x1446")

    def fails(*_: object, **__: object) -> None:
        raise OSError("the disk is full")

    monkeypatch.setattr("towline.live.folder.write_text", fails)
    with pytest.raises(OSError, match="disk is full"):
        make_folder(setup, next_of(tmp_path), "film.ts")
    assert list(tmp_path.iterdir()) == []
