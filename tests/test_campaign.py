"""Campaigns: found, analysed side by side, failed runs kept with their reasons, resumed after a kill, on a cluster, on storage."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from towline.cli import EXIT_SOME_FAILED, main
from towline.pipeline.campaign.find import run_folders
from towline.pipeline.campaign.remote import cache_folder
from towline.pipeline.campaign.whole import campaign
from towline.pipeline.campaign.work import FIT, RECORD, Options
from towline.pipeline.campaign.workers import workers
from towline.record import InputError
from towline.record.errors import TowlineError
from towline.report.campaign_page import campaign_page

RUNS = 2
SPAN_S = 20.0
"""Of each run: what is kept, redone and said does not depend on how long a run is."""
QUICK = Options(form="linear", noise="output")
LIGHT = ("--form", "linear", "--noise", "output")
KILLS = 3
FilesOf = Callable[[Path], dict[str, bytes]]


@pytest.fixture(scope="module")
def made(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Good runs, one whose run.toml is broken, one whose tracks are cut off, and an empty folder."""
    folder = tmp_path_factory.mktemp("made") / "hall, Tuesday"
    whole = cases.campaign("none", np.random.default_rng(8)).runs[: RUNS + 2]
    short = [(run, tracks[tracks["t_s"] < SPAN_S], static) for run, tracks, static in whole]
    paths = write_runs(short, folder / "mariner")
    broken, cut = paths[-2:]
    (broken / "run.toml").write_text((broken / "run.toml").read_text().replace("speed_m_s", "speed_knots"))
    (cut / "tracks.csv").write_bytes((cut / "tracks.csv").read_bytes()[:2000])
    (folder / "empty").mkdir()
    return folder


def copied(made: Path, to: Path) -> Path:
    return Path(shutil.copytree(made, to / made.name))


@pytest.fixture(scope="module")
def undisturbed(
    made: Path, files_of: FilesOf, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, bytes]]:
    folder = copied(made, tmp_path_factory.mktemp("undisturbed"))
    with workers(1) as one:
        found = campaign(folder, one, QUICK)
    assert [a.redone for a in (*found.runs[:RUNS], *found.fits)] == [True] * (RUNS + 1)
    return folder, files_of(folder)


@pytest.fixture(scope="module")
def stopped(made: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Ctrl+C while the fit's page is drawn, and what was told until then."""
    folder = copied(made, tmp_path_factory.mktemp("stopped"))
    return folder, until_the_page(folder)


def until_the_page(folder: Path) -> list[str]:
    """What is told until Ctrl+C."""
    said: list[str] = []

    def stopping(text: str, done: int, total: int | None) -> None:
        said.append(text)
        if "page" in text:
            raise KeyboardInterrupt

    with workers(1) as one, pytest.raises(KeyboardInterrupt):
        campaign(folder, one, QUICK, progress=stopping)
    return said


def test_runs_are_found_and_what_is_none_is_said(made: Path, tmp_path: Path) -> None:
    found = run_folders(made)
    assert len(found.runs) == RUNS + 2
    assert all(run.startswith("mariner/") for run in found.runs)
    assert found.without == ["empty"]
    single = run_folders(made / found.runs[0])
    assert single.runs == ["."]
    with pytest.raises(InputError, match=r"no run\.toml in it or below it"):
        run_folders(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        run_folders(tmp_path / "nowhere")


@pytest.mark.slow
def test_failed_runs_have_their_reason_and_the_rest_is_done(
    undisturbed: tuple[Path, dict[str, bytes]], self_contained: Callable[[str], list[bytes]]
) -> None:
    folder, _ = undisturbed
    with workers(1) as one:
        again = campaign(folder, one, QUICK)
    assert [a.redone for a in again.runs if not a.reason] == [False] * RUNS
    assert [a.redone for a in again.fits] == [False]
    assert len(again.failed) == 3
    assert "speed_knots" in again.failed[again.runs[RUNS].job]
    assert "tracks.csv" in again.failed[again.runs[RUNS + 1].job]
    assert "no run.toml" in again.failed["empty"]
    table = pd.read_csv(folder / "out" / "campaign.csv")
    pd.testing.assert_frame_equal(
        table.fillna({"quantity": "", "unit": "", "reason": "", "folder": ""}),
        pd.read_parquet(folder / "out" / "campaign.parquet"),
        check_dtype=False,
    )
    fitted = table[table["level"] == "fit"].set_index("quantity")
    file = json.loads((folder / "out" / "derivatives" / "derivatives.json").read_text())
    for name, d in file["derivatives"].items():
        assert fitted.loc[name, "value"] == pytest.approx(d["value"])
        assert fitted.loc[name, "std"] == pytest.approx(d["std"])
    assert sorted(file["runs"]) == sorted(a.name for a in again.runs[:RUNS])
    assert table["reason"].notna().sum() == 3
    assert len(self_contained(campaign_page(again))) == 1


@pytest.mark.slow
def test_what_changed_is_redone_and_no_more(undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path) -> None:
    folder = copied(undisturbed[0], tmp_path)
    first = folder / run_folders(folder).runs[0] / "run.toml"
    first.write_text(f"# checked\n{first.read_text()}")
    with workers(1) as one:
        found = campaign(folder, one, QUICK)
    assert [a.redone for a in found.runs[:RUNS]] == [True] + [False] * (RUNS - 1)
    assert [a.redone for a in found.fits] == [True]


@pytest.mark.slow
def test_what_a_run_is_good_for_follows_what_is_known_of_it(
    undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path
) -> None:
    """Without its tension a tow on a line that keeps it gives no derivatives, whatever was found of it before."""
    folder = copied(undisturbed[0], tmp_path)
    first = folder / run_folders(folder).runs[0] / "run.toml"
    with workers(1) as one:
        before = campaign(folder, one, replace(QUICK, line="constant"))
        first.write_text(re.sub(r"(?m)^tension_n = .*\n", "", first.read_text()))
        after = campaign(folder, one, replace(QUICK, line="constant"))
    assert [a.wants for a in before.runs[:RUNS]] == ["derivatives"] * RUNS
    assert [a.wants for a in after.runs[:RUNS]] == ["steady"] + ["derivatives"] * (RUNS - 1)


@pytest.mark.slow
def test_two_workers_write_what_one_writes(
    made: Path, undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path, files_of: FilesOf
) -> None:
    folder = copied(made, tmp_path)
    with workers(2) as two:
        campaign(folder, two, QUICK)
    assert files_of(folder) == undisturbed[1]


@pytest.mark.slow
def test_a_killed_campaign_goes_on_to_the_same_end(
    made: Path, undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path, files_of: FilesOf
) -> None:
    """kill -9 at random moments; nothing that was finished is redone, and every byte is that of a campaign left alone."""
    folder = copied(made, tmp_path)
    code = (
        "import sys; from pathlib import Path; from towline.pipeline.campaign.whole import campaign; "
        "from towline.pipeline.campaign.work import RECORD, Options; from towline.pipeline.campaign.workers import workers\n"
        "if __name__ == '__main__':\n"
        "    with workers(1) as one: campaign(Path(sys.argv[1]), one, Options(form='linear', noise='output'))"
    )
    rng = np.random.default_rng(1)
    finished: dict[str, int] = {}
    for _ in range(KILLS):
        process = subprocess.Popen([sys.executable, "-c", code, str(folder)])
        time.sleep(rng.uniform(0.5, 5.0))
        process.send_signal(signal.SIGKILL)
        process.wait()
        for path in folder.rglob("out/motion.csv"):
            assert finished.setdefault(str(path), path.stat().st_mtime_ns) == path.stat().st_mtime_ns
    (folder / "out").mkdir(exist_ok=True)
    (folder / "out" / ".campaign-abc.tmp.csv").write_text("half a li")
    with workers(1) as one:
        campaign(folder, one, QUICK)
    for path, when in finished.items():
        assert os.stat(path).st_mtime_ns == when
    assert files_of(folder) == undisturbed[1]


@pytest.mark.slow
def test_what_is_stopped_after_the_fit_does_not_fit_again(
    stopped: tuple[Path, list[str]], undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path, files_of: FilesOf
) -> None:
    """The fit tells of its steps; Ctrl+C while its page is drawn, and what is told then tells of none."""
    assert sum("step" in text for text in stopped[1]) > 3
    folder = copied(stopped[0], tmp_path)
    said: list[str] = []
    with workers(1) as one:
        campaign(folder, one, QUICK, progress=lambda text, done, total: said.append(text))
    assert any("page" in text for text in said)
    assert not any("step" in text for text in said)
    assert files_of(folder) == undisturbed[1]


@pytest.mark.once
@pytest.mark.parametrize(
    "damage", [b"", b"x", b'{"is": "Fit", "holds": {}}', b'{"is": "array", "holds": 3}', b"[" * 10_000]
)
def test_a_damaged_fit_is_fitted_again(stopped: tuple[Path, list[str]], tmp_path: Path, damage: bytes) -> None:
    """And is what it was before; what comes of that is the test above."""
    folder = copied(stopped[0], tmp_path)
    kept = folder / "out" / "derivatives" / FIT
    before = kept.read_bytes()
    kept.write_bytes(before.partition(b"\n")[0] + b"\n" + damage)
    assert any("step" in text for text in until_the_page(folder))
    assert kept.read_bytes() == before


def test_only_one_campaign_at_a_time(undisturbed: tuple[Path, dict[str, bytes]]) -> None:
    fcntl = pytest.importorskip("fcntl", reason="this system has no such locks")
    folder, _ = undisturbed
    with open(folder / "out" / ".campaign.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(TowlineError, match="another campaign is at work here"), workers(1) as one:
            campaign(folder, one, QUICK)


@pytest.mark.slow
def test_the_command_on_storage(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files come from the storage, results go back to it; the second time nothing is fetched or worked out anew."""
    fsspec = pytest.importorskip("fsspec", reason="fsspec (extra 'remote') is not installed")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    storage = fsspec.filesystem("memory")
    storage.put(str(made), "/hall", recursive=True)
    url = "memory://hall"
    assert main(["campaign", url, *LIGHT, "--json"]) == EXIT_SOME_FAILED
    said = json.loads(capsys.readouterr().out)
    assert len(said["failed"]) == 2  # storage has no empty folders
    assert storage.exists("/hall/out/campaign.html")
    assert storage.cat("/hall/out/campaign.csv") == (cache_folder(url) / "out" / "campaign.csv").read_bytes()
    fetched: list[str] = []
    monkeypatch.setattr(type(storage), "get_file", lambda self, path, *a, **k: fetched.append(path))
    assert main(["campaign", url, *LIGHT]) == EXIT_SOME_FAILED
    assert f"{RUNS} of {RUNS + 2} runs, 0 worked out now" in capsys.readouterr().out
    assert fetched == []
    assert main(["campaign", "memory://nothing"]) == 1
    assert "no such folder, or nothing in it" in capsys.readouterr().err


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """A scheduler and two workers in processes of their own, each on its own port."""
    pytest.importorskip("distributed", reason="Dask (extra 'cluster') is not installed")
    start = [
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
    ]
    notes = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": str(tmp_path)}
    running = [subprocess.Popen([*start, "--scheduler-file", str(notes)], **quiet)]
    for _ in range(200):
        if notes.is_file() and notes.read_text().strip():
            break
        time.sleep(0.1)
    address = json.loads(notes.read_text())["address"]
    worker = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-dashboard",
        "--no-nanny",
    ]
    running += [subprocess.Popen([*worker, "--local-directory", str(tmp_path / str(k))], **quiet) for k in (1, 2)]
    yield address, running
    for process in running:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_cluster_gives_the_same_and_a_killed_worker_costs_its_own_work(
    made: Path,
    undisturbed: tuple[Path, dict[str, bytes]],
    tmp_path: Path,
    files_of: FilesOf,
    cluster: tuple[str, list[subprocess.Popen]],
) -> None:
    address, running = cluster
    folder = copied(made, tmp_path)
    killed: list[int] = []

    def tell(text: str, done: int, total: int | None) -> None:
        if done == 1 and not killed:
            running[1].kill()
            killed.append(running[1].pid)
            half = (
                folder / run_folders(folder).runs[0] / "out" / ".motion-abc.tmp.csv"
            )  # what a writer killed half-way leaves
            half.parent.mkdir(exist_ok=True)
            half.write_text("half a li")

    with workers(1, address) as both:
        found = campaign(folder, both, QUICK, progress=tell)
    assert killed
    assert len(found.failed) == 3
    assert files_of(folder) == undisturbed[1]
    with pytest.raises(TowlineError, match="no Dask scheduler at"), workers(1, "tcp://127.0.0.1:1"):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("damage", [f"derivatives/{RECORD}", f"*/out/{RECORD}", "motion_common.npy", "camera.json"])
def test_a_damaged_result_is_made_again(
    undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path, files_of: FilesOf, damage: str
) -> None:
    folder = copied(undisturbed[0], tmp_path)
    (path, *_) = sorted(folder.rglob(damage))
    record = path.read_bytes()
    path.write_bytes(json.dumps({"stamp": json.loads(record)["stamp"]}).encode() if RECORD in damage else record[:40])
    with workers(1) as one:
        campaign(folder, one, QUICK)
    assert path.read_bytes() == record
    assert files_of(folder) == undisturbed[1]
