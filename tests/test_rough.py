"""A hostile file, a bad day, an impatient user: one clear line or the work done; nothing hangs, nothing is left."""

from __future__ import annotations

import errno
import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from towline.cli import main
from towline.diagnose.effects import load_effects
from towline.pipeline.campaign import find
from towline.pipeline.campaign.find import run_folders
from towline.record import InputError, read_motion, read_run, read_table, read_tracks, write_table
from towline.record.errors import TowlineError, VideoError
from towline.record.files import TABLE_BYTES, TOML_BYTES, read_array, replacing, sha256_of_file, write_array
from towline.record.imported import import_tracks
from towline.record.instruments import read_setup
from towline.record.lens_file import read_lens
from towline.record.names import shown
from towline.record.priors import Priors
from towline.record.tables import as_meant, input_hash_of, no_formula
from towline.record.toml import read_toml

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="named pipes, /proc and limits as Linux has them")
SPARSE_BYTES = 3 << 30
SOON_S = 20.0


@pytest.fixture
def run(motion_run: Callable[..., Path], tmp_path: Path) -> Path:
    return motion_run(tmp_path / "run")


@pytest.fixture(autouse=True)
def heard() -> Iterator[None]:
    """Ctrl+C is heard by what a test starts, also where the tests run in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def quick(command: str, *more: str | Path) -> list[str]:
    return [command, *map(str, more), "--form", "linear", "--noise", "output"]


def command_line(
    arguments: Sequence[str | Path], limit_mib: int = 0, stdout: int | io.TextIOWrapper = subprocess.PIPE
) -> subprocess.Popen:
    """The command in a session of its own, its memory bounded."""
    limit = f"ulimit -v {limit_mib << 10}; " if limit_mib else ""
    words = [sys.executable, "-m", "towline", *map(str, arguments)]
    return subprocess.Popen(
        ["sh", "-c", limit + 'exec "$@"', "sh", *words],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def one_line(said: str, *words: str) -> None:
    """One line of towline's, that holds the words."""
    assert said.startswith("towline: "), said
    assert said.count("\n") == 1, said
    assert all(word in said for word in words), said


def ends_soon(pid: int) -> bool:
    """Whether the process is gone, or dead and not fetched yet, within some seconds."""
    until_s = time.monotonic() + SOON_S
    while time.monotonic() < until_s:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


# what is read is a plain file of bounded size ----------------------------------------------------------------------------


def pipe(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def listening(path: Path) -> None:
    os.chdir(path.parent)  # the path of a socket is short
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(path.name)


def sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(SPARSE_BYTES)


INSTEAD = {
    "a named pipe": pipe,
    "a device": device,
    "a socket": listening,
    "a folder": Path.mkdir,
    "at most": sparse,
}
READERS: dict[str, Callable[[Path], object]] = {
    "run.toml": lambda path: read_run(path.parent),
    "setup.toml": read_setup,
    "priors.toml": lambda path: read_toml(path, Priors),
    "motion.csv": read_motion,
    "tracks.csv": read_tracks,
    "tracks.parquet": read_tracks,
    "lens.json": read_lens,
    "dltdv.csv": import_tracks,
    "trackpy.parquet": import_tracks,
    "modes.npy": read_array,
    "mine.py": load_effects,
}


@LINUX
@pytest.mark.parametrize("words", INSTEAD)
@pytest.mark.parametrize("name", READERS)
def test_what_is_read_is_a_plain_file(name: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    INSTEAD[words](tmp_path / name)
    with pytest.raises(InputError, match=words) as caught:
        READERS[name](tmp_path / name)
    one_line(f"towline: {caught.value}\n", name)


@LINUX
@pytest.mark.parametrize("words", ["a named pipe", "a device", "a folder"])
def test_what_run_toml_names_is_a_plain_file(run: Path, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "motion.csv").unlink()
    INSTEAD[words](run / "motion.csv")
    assert main(quick("identify", run)) == 1
    one_line(capsys.readouterr().err, "run.toml", "source.motion: motion.csv is", words)


@LINUX
def test_a_recording_is_a_plain_file_and_no_list_of_others(tmp_path: Path) -> None:
    from towline.vision import clip_info

    path = tmp_path / "v.mp4"
    pipe(path)
    with pytest.raises(VideoError, match="is a named pipe; a plain file is expected"):
        clip_info(path)
    path.rename(tmp_path / "pipe.mp4")
    for text in ("ffconcat version 1.0\nfile pipe.mp4\n", "#EXTM3U\n#EXTINF:9,\npipe.mp4\n#EXT-X-ENDLIST\n"):
        path.write_text(text)
        with pytest.raises(VideoError, match="is not a video that can be read"):
            clip_info(path)


def test_an_index_that_is_nothing_but_boxes_comes_to_an_end(tmp_path: Path) -> None:
    from towline.vision.recording.mp4 import contradiction

    path = tmp_path / "v.mp4"
    deep = b""
    for _ in range(3000):
        deep = (len(deep) + 8).to_bytes(4, "big") + b"trak" + deep
    path.write_bytes((len(deep) + 8).to_bytes(4, "big") + b"moov" + deep)
    doubt = contradiction(path)
    assert doubt is not None
    assert "deep" in doubt.words
    with path.open("wb") as stream:
        for _ in range(20):
            stream.write(b"\0\0\0\x08free" * (1 << 18))
    begun_s = time.monotonic()
    assert contradiction(path) is None
    assert time.monotonic() - begun_s < 5


def test_a_file_is_read_up_to_its_kinds_size(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("#" * (TOML_BYTES + 1))
    with pytest.raises(InputError, match="has 4 MiB; at most 4 MiB are read of such a file"):
        read_run(tmp_path)
    path.write_text("#" * TOML_BYTES)
    with pytest.raises(InputError, match="missing key"):
        read_run(tmp_path)


def test_an_array_is_as_long_as_its_header_claims(tmp_path: Path) -> None:
    path = tmp_path / "modes.npy"
    kept = np.arange(12.0).reshape(2, 3, 2)
    write_array(path, kept)
    assert (read_array(path) == kept).all()
    for shape, kind in (((10**11,), "<f8"), ((3,), "<f8"), ((-1, -2), "<f8"), ((1,), "|O")):
        with path.open("wb") as stream:
            np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
            stream.write(bytes(16))
        with pytest.raises(InputError, match="is no array that can be read"):
            read_array(path)


def test_a_table_of_repeated_values_is_as_long_as_its_rows(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    path = tmp_path / "motion.parquet"
    many = pa.array(np.zeros(TABLE_BYTES // 16 + 8))
    parquet.write_table(pa.table({"t_s": many, "y_cg_m": many, "beta_rad": many}), path)
    assert path.stat().st_size < 1 << 20
    with pytest.raises(InputError, match="rows of 3 columns; no table here is so long"):
        read_motion(path)


@pytest.mark.slow
@LINUX
def test_results_of_before_that_are_no_files_are_made_anew(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], tmp_path: Path
) -> None:
    (folder,) = write_runs(cases.campaign("none", np.random.default_rng(8)).runs[:1], tmp_path)
    assert main(["motion", str(folder)]) == 0
    before = {path.name: path.read_bytes() for path in (folder / "out").iterdir()}
    for name in ("motion.csv", "motion_common.npy", "camera.json"):
        (folder / "out" / name).unlink()
        pipe(folder / "out" / name)
        assert main(["motion", str(folder)]) == 0
        assert {path.name: path.read_bytes() for path in (folder / "out").iterdir()} == before
    pipe(folder / "x.csv")
    assert input_hash_of(folder / "x.csv") is None
    with pytest.raises(InputError, match="named pipe"):
        sha256_of_file(folder / "x.csv")


@pytest.mark.slow
@LINUX
def test_a_campaigns_lock_is_no_way_out(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A link in its place would have its target emptied, a named pipe would be waited for; links below out/ are not swept."""
    (run / "out").mkdir()
    (tmp_path / "precious").write_text("kept")
    (run / "out" / ".campaign.lock").symlink_to(tmp_path / "precious")
    assert main(quick("campaign", run)) == 1
    one_line(capsys.readouterr().err, ".campaign.lock", "a plain file is expected")
    assert (tmp_path / "precious").read_text() == "kept"
    (run / "out" / ".campaign.lock").unlink()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / ".mine.tmp.txt").write_text("kept")
    (run / "out" / "there").symlink_to(tmp_path / "elsewhere")
    assert main(quick("campaign", run)) in (0, 3)
    assert (tmp_path / "elsewhere" / ".mine.tmp.txt").is_file()


# links and names -----------------------------------------------------------------------------------------------------


def test_links_lead_a_campaign_nowhere_twice(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    hall = tmp_path / "hall"
    motion_run(hall / "z" / "tow")
    other = motion_run(tmp_path / "other" / "tow")
    (hall / "a").symlink_to(".")
    (hall / "b").symlink_to(".")
    (hall / "z" / "up").symlink_to("../..")
    (hall / "again").symlink_to("z/tow")
    (hall / "away").symlink_to(other)
    (hall / "nothing").mkdir()
    found = run_folders(hall)
    assert found.runs == ["away", "z/tow"]  # each once, by its own name where that lies in the folder
    assert found.without == ["nothing"]


def test_a_campaigns_folders_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(find, "MOST_FOLDERS", 20)
    for k in range(30):
        (tmp_path / str(k)).mkdir()
    with pytest.raises(InputError, match="more than 20 folders in it; name the one that holds the runs"):
        run_folders(tmp_path)


def test_folders_may_stand_deep(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    deep = tmp_path.joinpath(*["d"] * 450)
    os.makedirs(deep)
    motion_run(tmp_path / "run")
    assert run_folders(tmp_path).runs == ["run"]


ODD = os.fsdecode(b"r\xff\xfe")


@pytest.fixture
def odd(motion_run: Callable[..., Path], tmp_path: Path) -> Path:
    """A campaign whose folders' names are no UTF-8, one of its runs without its motion."""
    try:
        os.mkdir(tmp_path / ODD)
    except OSError:
        pytest.skip("this file system takes UTF-8 only")
    for k, point in enumerate((1.446, 1.548)):
        motion_run(tmp_path / ODD / f"{ODD}{k}", point, f"tow {k}")
    broken = motion_run(tmp_path / ODD / f"{ODD}2")
    (broken / "motion.csv").unlink()
    return tmp_path / ODD


@pytest.mark.slow
def test_a_campaign_whose_names_are_no_utf8(odd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(quick("campaign", odd)) == 3
    said = capsys.readouterr()
    assert r"r\xff\xfe" in said.out
    assert r"failed: r\xff\xfe2: r\xff\xfe2/run.toml: source.motion: no such file: motion.csv" in said.err
    table = pd.read_csv(odd / "out" / "campaign.csv")
    assert set(table["folder"].dropna()) == {rf"r\xff\xfe{k}" for k in range(3)}
    pd.testing.assert_series_equal(
        read_table(odd / "out" / "campaign.parquet", ("folder",))["folder"],
        table["folder"].fillna(""),
        check_dtype=False,
    )
    assert r"r\xff\xfe0" in (odd / "out" / "campaign.html").read_text(encoding="utf-8")
    assert main([*quick("campaign", odd), "--json"]) == 3
    told = json.loads(capsys.readouterr().out.encode("utf-8"))
    assert list(told["failed"]) == [r"r\xff\xfe2"]
    json.dumps(told, ensure_ascii=False).encode("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("more", [[], ["--json"]])
def test_a_run_whose_name_is_no_utf8(odd: Path, capsys: pytest.CaptureFixture[str], more: list[str]) -> None:
    assert main([*quick("identify", *sorted(p for p in odd.iterdir() if p.is_dir())), *more]) == 3
    assert "derivatives.json" in capsys.readouterr().out
    assert main([*quick("identify", odd / f"{ODD}2"), *more]) == 1
    assert r"r\xff\xfe2/run.toml" in capsys.readouterr().err
    write_table(odd / "a.parquet", pd.DataFrame({"x": [1.0]}))
    assert len(read_table(odd / "a.parquet", ("x",))) == 1


def test_only_what_cannot_be_said_is_written_out() -> None:
    assert shown("Größe 船 \\xff") == "Größe 船 \\xff"
    assert shown(os.fsdecode(b"a\xff")) == r"a\xff"
    assert shown("\ud800") == r"\ud800"
    assert str(TowlineError(os.fsdecode(b"a\xff"))) == r"a\xff"
    assert str(TowlineError("Größe\x1b[2J\n船")) == r"Größe\x1b[2J\n船"
    assert str(TowlineError("tow\u202efdp.\u2069 سفينة")) == r"tow\u202efdp.\u2069 سفينة"


FORMULAS = ("=HYPERLINK(1)", "+1", "-2+3", "@SUM(A1)", "'=1", "''=1", "x;=1+1", "\t=1")


@pytest.mark.slow
def test_no_cell_of_a_campaign_is_a_formula(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    for k, name in enumerate(FORMULAS[:4]):
        motion_run(tmp_path / f"={k}", 1.4 + 0.05 * k, name)
    assert main(quick("campaign", tmp_path)) == 0
    rows = (tmp_path / "out" / "campaign.csv").read_text().splitlines()[1:]
    for row in rows:
        assert not any(cell.startswith(("=", "+", "@", "-2")) for cell in row.split(",")), row
    table = read_table(tmp_path / "out" / "campaign.csv", ("name",))
    whole = pd.read_parquet(tmp_path / "out" / "campaign.parquet")
    assert list(table["name"]) == list(whole["name"])
    assert set(FORMULAS[:4]) <= set(table["name"])
    assert list(table["value"]) == pytest.approx(list(whole["value"]), nan_ok=True)
    assert (table["value"] < 0).any()  # numbers stay numbers


def test_a_markers_name_comes_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    for name in (*FORMULAS, "plain"):
        if name.strip() != name:
            continue
        frame = {"frame": [0, 1], "t_s": [0.0, 0.1], "marker": name, "u_px": [-1.0, 2.0], "v_px": [3.0, 4.0]}
        write_table(path, pd.DataFrame(frame))
        assert list(read_tracks(path)["marker"]) == [name] * 2
        assert f",{name}," not in path.read_text() or name == "plain"
        assert ",-1," in path.read_text()
    for name in FORMULAS:
        assert as_meant(no_formula(name)) == name


# signals -------------------------------------------------------------------------------------------------------------

SLOW = (
    "import time\nfrom towline.pipeline.executor.processes import in_parallel\n"
    "if __name__ == '__main__':\n"
    "    try: list(in_parallel(time.sleep, [(0.0,), (0.0,), (60.0,), (60.0,), (60.0,)], 2))\n"
    "    except KeyboardInterrupt: raise SystemExit(130)\n"
)


@pytest.mark.once
@LINUX
@pytest.mark.parametrize("after_s", [0.35, 0.5, 0.7, 3.0])
def test_workers_say_nothing_of_an_interrupt(after_s: float) -> None:
    process = subprocess.Popen([sys.executable, "-c", SLOW], stderr=subprocess.PIPE, text=True, start_new_session=True)
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=SOON_S)[1]
    if process.returncode != 130:  # it had not come to its own code yet
        assert "in_parallel(time.sleep" not in said
        return
    assert said == ""


@pytest.mark.slow
@LINUX
def test_an_interrupted_campaign_is_whole_and_goes_on(
    cases: ModuleType,
    write_runs: Callable[[list, Path], list[Path]],
    files_of: Callable[[Path], dict[str, bytes]],
    tmp_path: Path,
) -> None:
    whole = cases.campaign("none", np.random.default_rng(8)).runs[:2]
    short = [(run, tracks[tracks["t_s"] < 20.0], static) for run, tracks, static in whole]
    write_runs(short, tmp_path / "a" / "hall")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    interrupted = 0
    for after_s in (1.0, 1.6, 2.4):
        process = command_line([*quick("campaign", tmp_path / "a" / "hall"), "--workers", "2"])
        time.sleep(after_s)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        said = process.communicate(timeout=SOON_S)[1]
        if process.returncode == 130:
            interrupted += 1
            one_line(said, "interrupted; what was finished is kept")
        assert not [path for path in files_of(tmp_path / "a") if ".tmp" in path]
    assert interrupted
    for folder in ("a", "b"):
        assert main(quick("campaign", tmp_path / folder / "hall")) == 0
    assert files_of(tmp_path / "a") == files_of(tmp_path / "b")


@pytest.mark.usefixtures("two_cores")
@pytest.mark.parametrize("busy", ["time.sleep(600)", "pass"])
def test_a_killed_diagnosis_leaves_no_copy(busy: str) -> None:
    """Not while the copy works, and not when it has its answer, larger than a pipe, and nobody reads it."""
    code = (
        "import os, time\nfrom towline.pipeline.executor.copies import side_by_side\nhere = os.getpid()\n"
        "def work(item):\n    if os.getpid() == here: time.sleep(600)\n"
        f"    print(os.getpid(), flush=True)\n    {busy}\n    return bytes(1 << 22)\n"
        "side_by_side(work, range(2))\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        copy = int(process.stdout.readline())
        process.kill()
        process.wait()
        assert ends_soon(copy)


# memory and disk -----------------------------------------------------------------------------------------------------


def test_memory_that_runs_out_is_one_line(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def none_left(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 9.00 GiB")

    monkeypatch.setattr(pd, "read_csv", none_left)
    assert main(quick("identify", run)) == 1
    one_line(capsys.readouterr().err, "out of memory (Unable to allocate 9.00 GiB)", "shorter runs")
    assert main([*quick("identify", run), "--json"]) == 1
    assert "out of memory" in json.loads(capsys.readouterr().out)["error"]


@pytest.mark.once
@LINUX
@pytest.mark.parametrize("limit_mib", [80, 400, 660, 760])
def test_short_memory_is_one_line_or_enough(run: Path, limit_mib: int) -> None:
    process = command_line([*quick("identify", run), "--no-page"], limit_mib)
    said = process.communicate(timeout=120)[1]
    assert "Traceback" not in said
    if process.returncode:
        assert process.returncode == 1, said
        assert len([line for line in said.splitlines() if line.startswith("towline: error: ")]) == 1, said


def test_a_full_disk_is_named_with_its_file(tmp_path: Path) -> None:
    path = tmp_path / "modes.npy"
    write_array(path, np.zeros(3))
    before = path.read_bytes()
    for raised in (OSError("47994 requested and 12784 written"), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))):
        with pytest.raises(OSError, match=raised.strerror or "47994") as caught, replacing(path):
            raise raised
        assert caught.value.filename == str(path)
        assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@LINUX
def test_an_array_on_a_full_disk(tmp_path: Path) -> None:
    code = (
        "import resource, signal, sys\nimport numpy as np\nfrom towline.record.files import write_array\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\nresource.setrlimit(resource.RLIMIT_FSIZE, (9999, 9999))\n"
        "try: write_array(sys.argv[1], np.zeros(100000))\n"
        "except OSError as error: print(error.errno, error.filename)\n"
    )
    path = tmp_path / "modes.npy"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(errno.EFBIG), str(path)]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize("words", [["doctor"], ["doctor", "--json"], ["completion", "bash"]])
def test_standard_output_that_is_full(words: list[str]) -> None:
    with open("/dev/full", "w") as full:
        process = command_line(words, stdout=full)
        said = process.communicate(timeout=60)[1]
    assert process.returncode == 1
    one_line(said, "standard output", os.strerror(errno.ENOSPC))


@LINUX
def test_standard_output_that_nobody_reads() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        process = command_line(["completion", "bash"], stdout=closed)
        said = process.communicate(timeout=60)[1]
    assert "Traceback" not in said
    assert "Exception ignored" not in said


# the diagnosis -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("planted", ["none", "crossflow_drag"])
def test_one_run_is_diagnosed_with_what_it_cannot_tell(
    cases: ModuleType,
    write_runs: Callable[[list, Path], list[Path]],
    planted: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (folder,) = write_runs(cases.campaign(planted, np.random.default_rng([11, 5])).runs[:1], tmp_path)
    assert main(["diagnose", str(folder)]) == 0
    assert "No other run was there to be kept aside" in capsys.readouterr().out
    gap = json.loads((folder / "out" / "gap.json").read_text())
    assert gap["kept_aside"] is False
    assert all(row["gap_after"] <= row["gap_before"] + 1e-6 for row in gap["ranking"][:1])
    assert "the fitted run itself" in (folder / "out" / "gap.html").read_text()


def test_what_runs_code_says_so(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["diagnose", "--help"])
    assert "RUNS the file as a program" in " ".join(capsys.readouterr().out.split())
    assert "runs the file as a program" in (root / "docs" / "diagnose.md").read_text()
