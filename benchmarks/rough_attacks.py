"""The ways that rough.py tries: which file is put in place of which, and the command that meets it."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import faults_bases as base
import numpy as np

SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446"
SPARSE_BYTES = 3 << 30
MIB = 1 << 20
Change = Callable[[Path], None]
"""Changes a file (a folder), in place."""
RUNS = ("run", "track", "motion", "check", "datum", "rectify", "identify", "steady", "diagnose", "campaign")


@dataclass(frozen=True)
class Attack:
    """One try.

    Attributes
    ----------
    name : row of the table
    command : towline's arguments, in the folder
    prepare : changes the folder
    named : what the one line must hold
    signals, moments_s : sent to it, the first between these
    memory : limit, bytes
    largest_kib : of a file that is written
    stdout : where standard output goes
    """

    name: str
    command: tuple[str, ...]
    prepare: Change = lambda folder: None
    named: str = ""
    signals: tuple[signal.Signals, ...] = ()
    moments_s: tuple[float, float] = (0.0, 0.0)
    memory: int | None = None
    largest_kib: int | None = None
    stdout: str | None = None


# what is put in place of a file ------------------------------------------------------------------------------------------


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _folder(path: Path) -> None:
    path.mkdir()


def _socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's path is short
    try:
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(path.name)
    finally:
        os.chdir(here)


def _sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(SPARSE_BYTES)


def _endless_link(path: Path) -> None:
    path.symlink_to(path.name)


INSTEAD: dict[str, Change] = {
    "a named pipe": _fifo,
    "/dev/zero": _device,
    "a socket": _socket,
    "a folder": _folder,
    "3 GiB of nothing": _sparse,
    "a link to itself": _endless_link,
}
SELDOM = {_socket, _folder, _endless_link, _sparse}
"""Tried once for every file, the others with every command that reads it."""


def _instead(target: str, make: Change) -> Change:
    def prepare(folder: Path) -> None:
        path = folder / target
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        make(path)

    return prepare


def _claims(path: Path) -> None:
    """An array whose header claims 800 GB."""
    with path.open("wb") as stream:
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**11,)}
        np.lib.format.write_array_header_1_0(stream, header)
        stream.write(b"\0" * 64)


def _objects(path: Path) -> None:
    """An array that says it holds a pickle."""
    with path.open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": (1,)})
        stream.write(b"\x80\x04.")


# folders ---------------------------------------------------------------------------------------------------------------


def towline(*arguments: str, cwd: Path) -> None:
    """The command, that must do its work."""
    subprocess.run([sys.executable, "-m", "towline", *arguments], cwd=cwd, check=True, stdout=subprocess.DEVNULL)


def base_folder(folder: Path) -> Path:
    """What every try begins with: a film, runs from its tracks and from its motion, every description, results of each."""
    folder.mkdir()
    shutil.copytree(SAMPLE, folder / "film")
    towline("run", "film", cwd=folder)
    text = (folder / "film" / "run.toml").read_text()
    for kind in ("tracks", "motion"):
        run = folder / f"by-{kind}"
        run.mkdir()
        (run / "run.toml").write_text(
            text.replace('video = "video.mp4"', f'{kind} = "{kind}.csv"').replace("mariner-x1446", f"by-{kind}")
        )
        shutil.copy(folder / "film" / "out" / f"{kind}.csv", run)
    history = "t_s,{0}\n" + "\n".join(f"{k},{{1}}" for k in range(41)) + "\n"
    described = (folder / "by-motion" / "run.toml").read_text()
    (folder / "by-motion" / "tension.csv").write_text(history.format("tension_n", 3.96))
    (folder / "by-motion" / "speed.csv").write_text(history.format("speed_m_s", 1.28))
    (folder / "by-motion" / "run.toml").write_text(
        described.replace("tension_n = 3.96", 'tension = "tension.csv"\nspeed = "speed.csv"')
    )
    shutil.copytree(folder / "by-tracks", folder / "still")
    shutil.copy(folder / "still" / "tracks.csv", folder / "still" / "static.csv")
    with (folder / "still" / "run.toml").open("a") as stream:
        stream.write('\n[noise]\nstatic = "static.csv"\n')
    (folder / "lens.json").write_text("{}")
    shutil.copytree(folder / "by-tracks", folder / "lensed")
    lensed = (folder / "lensed" / "run.toml").read_text()
    (folder / "lensed" / "run.toml").write_text(lensed.replace("[camera]", '[camera]\ncalibration = "lens.json"'))
    towline("motion", "by-tracks", cwd=folder)
    (folder / "scenario.toml").write_text((SAMPLE / "scenario.toml").read_text())
    (folder / "plan.toml").write_text(base.PLAN)
    (folder / "setup.toml").write_text(base.SETUP)
    (folder / "priors.toml").write_text("")
    (folder / "mine.py").write_text("x = 1\n")
    shutil.copytree(folder / "film" / "out", folder / "out")
    (folder / "hall").mkdir()
    for k in range(3):
        shutil.copytree(folder / "by-tracks", folder / "hall" / f"run{k}", ignore=shutil.ignore_patterns("out"))
        path = folder / "hall" / f"run{k}" / "run.toml"
        path.write_text(path.read_text().replace('"by-tracks"', f'"run{k}"'))
    return folder


def _read() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every file that a command reads, and the command."""
    quick = ("--form", "linear", "--noise", "output")
    for command in RUNS:
        yield "film/run.toml", (command, "film")
    yield "film/run.toml", ("export", "film", "--mat", "a.mat")
    yield "film/run.toml", ("init", "film")
    for command in ("run", "track", "check", "rectify", "diagnose"):
        yield "film/video.mp4", (command, "film")
    yield "film/video.mp4", ("lens", "film/video.mp4", "--board", "9x6", "--square-m", "0.02")
    yield "board.png", ("lens", "board.png", "--board", "9x6", "--square-m", "0.02")
    for command in ("run", "motion", "identify", "campaign", "check"):
        yield "by-tracks/tracks.csv", (command, "by-tracks")
    for target in ("motion.csv", "tension.csv", "speed.csv"):
        yield f"by-motion/{target}", ("identify", "by-motion", *quick)
    yield "by-motion/motion.csv", ("steady", "by-motion")
    yield "still/static.csv", ("diagnose", "still")
    yield "lensed/lens.json", ("motion", "lensed")
    yield "scenario.toml", ("simulate", "scenario.toml")
    yield "scenario.toml", ("render", "scenario.toml", "-o", "new")
    yield "plan.toml", ("plan", "plan.toml")
    yield "priors.toml", ("identify", "by-motion", *quick, "--priors", "priors.toml")
    yield "reference.csv", ("identify", "by-motion", *quick, "--reference", "reference.csv")
    yield "reference.csv", ("compare", "out/derivatives.json", "--reference", "reference.csv")
    yield "out/derivatives.json", ("compare", "out/derivatives.json", "--reference", "ittc")
    yield "out/derivatives.json", ("export", "out/derivatives.json", "--state-space", "m.json", "--run", "film")
    yield "out/derivatives.json", ("diagnose", "by-motion", "--reference", "out/derivatives.json")
    yield "mine.py", ("diagnose", "by-motion", "--effects", "mine.py")
    for program in ("auto", "trackpy", "dltdv", "kinovea", "tracker", "instruments"):
        more = ("--setup", "setup.toml") if program == "instruments" else ("--rate", "25")
        yield "table.csv", ("import", "table.csv", "--from", program, "-o", "t.csv", *more)
    yield "table.parquet", ("import", "table.parquet", "--from", "trackpy", "-o", "t.csv", "--rate", "25")
    yield "setup.toml", ("import", "table.csv", "--from", "instruments", "--setup", "setup.toml", "-o", "t.csv")


def _kept() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every file of before that a command reads again, or writes over: made anew where it is none."""
    for name in ("marks.csv", "motion.csv", "motion_common.npy", "motion_lag.npy", "camera.json"):
        yield f"by-tracks/out/{name}", ("motion", "by-tracks")
    yield "film/out/tracks.csv", ("motion", "film")
    yield "film/truth/motion.csv", ("run", "film")
    yield "film/truth/derivatives.json", ("run", "film")
    yield "film/out/report_figures/x.csv", ("run", "film")
    yield "hall/out/.campaign.lock", ("campaign", "hall", "--form", "linear", "--noise", "output")
    yield "hall/out/derivatives/campaign.json", ("campaign", "hall", "--form", "linear", "--noise", "output")
    yield "hall/run1/run.toml", ("campaign", "hall", "--form", "linear", "--noise", "output")
    yield "hall/run1/tracks.csv", ("campaign", "hall", "--form", "linear", "--noise", "output", "--workers", "2")


def attacks(folder: Path) -> Iterator[Attack]:
    """All of them, in the table's order; ``folder``: the base."""
    for words, make in INSTEAD.items():
        seen: set[str] = set()
        for target, command in _read():
            if make in SELDOM and target in seen:
                continue
            seen.add(target)
            if make is _sparse and target.endswith((".mp4", ".json")) and "derivatives" not in target:
                continue  # a video may be of any size; see below
            yield Attack(f"{words} where a file is read", command, _instead(target, make), Path(target).name)
    yield from _videos()
    for words, make in INSTEAD.items():
        for target, command in _kept() if make in (_fifo, _device) else ():
            yield Attack(f"{words} in out/, truth/ or one of several runs", command, _instead(target, make))
    for name in ("motion_common.npy", "motion_lag.npy"):
        for make in (_claims, _objects):
            words = "an array in out/ that claims 800 GB, or holds objects"
            yield Attack(words, ("motion", "by-tracks"), _instead(f"by-tracks/out/{name}", make))
    yield from _links()
    yield from _names()
    yield from _interrupts()
    yield from _killed()
    yield from _memory()
    yield from _full()
    yield from _said_nowhere()


def _videos() -> Iterator[Attack]:
    def written(content: bytes) -> Change:
        return _instead("film/video.mp4", lambda path: path.write_bytes(content) and None)

    def with_pipe(content: bytes) -> Change:
        def prepare(folder: Path) -> None:
            written(content)(folder)
            os.mkfifo(folder / "film" / "pipe.mp4")

        return prepare

    words = "a video that names other files (ffconcat, HLS, DASH), 3 GiB of nothing, boxes without end"
    hls = b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\npipe.mp4\n#EXT-X-ENDLIST\n"
    deep = b""
    for _ in range(5000):
        deep = (len(deep) + 8).to_bytes(4, "big") + b"trak" + deep
    box = (len(deep) + 8).to_bytes(4, "big") + b"moov" + deep
    for command in ("run", "track"):
        for prepare in (
            with_pipe(b"ffconcat version 1.0\nfile pipe.mp4\n"),
            with_pipe(hls),
            with_pipe(b'<?xml version="1.0"?><MPD type="static"><BaseURL>pipe.mp4</BaseURL></MPD>'),
            written(b"\0\0\0\x14ftypisom\0\0\0\0isom" + box),
            written(b"\0\0\0\x14ftypisom\0\0\0\0isom" + b"\0\0\0\x08free" * 4_000_000),
            _instead("film/video.mp4", _sparse),
        ):
            yield Attack(words, (command, "film"), prepare, "video.mp4")


def _links() -> Iterator[Attack]:
    def round_and_round(folder: Path) -> None:
        for name in ("a", "b", "c"):
            (folder / "hall" / name).symlink_to(".")
        (folder / "hall" / "up").symlink_to("..")
        (folder / "hall" / "run1" / "x").symlink_to("../..")

    def deep(folder: Path) -> None:
        here = os.getcwd()
        os.chdir(folder / "hall")
        try:
            for _ in range(400):
                os.mkdir("d")
                os.chdir("d")
        finally:
            os.chdir(here)

    for prepare in (round_and_round, deep):
        for workers in ("1", "2"):
            command = ("campaign", "hall", "--form", "linear", "--noise", "output", "--workers", workers)
            yield Attack("links in a ring, folders 400 deep below a campaign", command, prepare)


def _names() -> Iterator[Attack]:
    odd = b"r\xff\xfe"

    def renamed(folder: Path) -> None:
        for name in ("film", "by-tracks", "by-motion", "hall"):
            os.rename(folder / name, os.path.join(os.fsencode(folder), odd + name.encode()))

    def named(name: str) -> str:
        return os.fsdecode(odd + name.encode())

    for more in ((), ("--json",)):
        for command in RUNS:
            for run in ("by-motion",) if more else ("film", "by-motion"):
                yield Attack("a folder whose name is no UTF-8", (command, named(run), *more), renamed)
        for words in (
            ("campaign", named("hall"), "--workers", "2"),
            ("export", named("film"), "--mat", "a.mat"),
            ("simulate", "scenario.toml", "-o", named("m.csv")),
            ("simulate", "scenario.toml", "-o", named("m.parquet")),
            ("render", named("none.toml"), "-o", "new"),
            ("doctor", named("film")),
            ("compare", named("none.json"), "--reference", "ittc"),
            ("identify", named("by-motion"), "-o", named("here")),
        ):
            yield Attack("a folder whose name is no UTF-8", (*words, *more), renamed)

    def formula(folder: Path) -> None:
        for k, name in enumerate(("=HYPERLINK(1)", "+1", "@x;=2")):
            path = folder / "hall" / f"run{k}" / "run.toml"
            path.write_text(path.read_text().replace(f'"run{k}"', f'"{name}"'))

    yield Attack("runs named =..., +..., @...", ("campaign", "hall", "--form", "linear", "--noise", "output"), formula)


def _interrupts() -> Iterator[Attack]:
    hall = ("campaign", "hall", "--workers", "2", "--fresh")
    for _ in range(25):
        yield Attack("Ctrl+C, campaign of two workers", hall, signals=(signal.SIGINT,), moments_s=(0.15, 6.0))
    for _ in range(6):
        yield Attack("Ctrl+C twice, campaign", hall, signals=(signal.SIGINT,) * 2, moments_s=(0.15, 6.0))
    for command in (("run", "film", "--fresh"), ("track", "film", "--fresh"), ("diagnose", "by-motion", "film")):
        for _ in range(5):
            words = "Ctrl+C, run, track, diagnose"
            yield Attack(words, command, signals=(signal.SIGINT,), moments_s=(0.15, 8.0))


def _killed() -> Iterator[Attack]:
    for command in (("diagnose", "by-tracks"), ("campaign", "hall", "--workers", "2", "--fresh")):
        for _ in range(6):
            words = f"kill -9 of {command[0]} alone"
            yield Attack(words, command, signals=(signal.SIGKILL,), moments_s=(1.0, 8.0))
    for _ in range(4):
        words = "kill (SIGTERM) of diagnose alone"
        yield Attack(words, ("diagnose", "by-tracks"), signals=(signal.SIGTERM,), moments_s=(3.0, 8.0))


def _memory() -> Iterator[Attack]:
    """From what Python alone takes up to what is enough."""
    commands: Sequence[tuple[str, ...]] = (
        ("run", "film", "--fresh"),
        ("identify", "by-motion", "--form", "linear", "--noise", "output"),
        ("diagnose", "by-tracks"),
        ("campaign", "hall", "--workers", "2"),
        ("simulate", "scenario.toml"),
        ("import", "film/out/tracks.csv", "--from", "trackpy", "-o", "t.csv"),
    )
    for command in commands:
        for limit in (80, 300, 640, 700, 760, 900, 1100):
            yield Attack("memory of 80-1,100 MiB (ulimit -v)", command, memory=limit * MIB)


def _full() -> Iterator[Attack]:
    """A file that may not grow stands for a full disk: the same calls fail, and say so in the same way."""
    commands: Sequence[tuple[str, ...]] = (
        ("run", "film", "--fresh"),
        ("track", "film", "--fresh"),
        ("motion", "by-tracks", "--method", "trapezoid"),
        ("identify", "by-motion", "--form", "linear", "--noise", "output"),
        ("campaign", "hall", "--form", "linear", "--noise", "output"),
        ("simulate", "scenario.toml"),
        ("simulate", "scenario.toml", "-o", "m.parquet"),
        ("render", "scenario.toml", "-o", "new"),
        ("export", "film", "--mat", "a.mat"),
        ("rectify", "film"),
    )
    for command in commands:
        for kib in (0, 4, 64):
            yield Attack("a disk that fills (ulimit -f)", command, largest_kib=kib)


def _said_nowhere() -> Iterator[Attack]:
    for command in (("doctor",), ("--help",), ("identify", "by-motion"), ("doctor", "--json"), ("completion", "bash")):
        yield Attack("standard output full (/dev/full)", command, named="standard output", stdout="/dev/full")


__all__ = ["Attack", "attacks", "base_folder"]
