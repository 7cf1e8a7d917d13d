"""What a person typed is kept: over a power cut and a kill, with its permissions, through a link, beside what another wrote."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from towline.app.document import Document
from towline.app.session import Session
from towline.record import InputError, read_run
from towline.record.files import replacing, write_text
from towline.record.typed import LEFT_OVER_S, write_typed

posix = pytest.mark.skipif(os.name != "posix", reason="permissions and links of POSIX")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def faster(folder: Path) -> Document:
    """The run, with another speed typed in."""
    document = Document.open(folder)
    document.set(("tow", "speed_m_s"), 1.31)
    return document


@posix
@pytest.mark.parametrize("wanted", [0o600, 0o640, 0o664])
def test_a_file_keeps_its_permissions(run_folder: Path, wanted: int) -> None:
    path = run_folder / "run.toml"
    path.chmod(wanted)
    faster(run_folder).save()
    assert read_run(run_folder).tow.speed_m_s == 1.31
    assert mode(path) == wanted
    other = run_folder / "result.json"
    write_text(other, "{}")
    other.chmod(wanted)
    write_text(other, "{ }")
    assert mode(other) == wanted


@posix
def test_nobody_else_reads_it_while_it_is_written(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.txt") as temporary:
        assert mode(temporary) == 0o600


def test_text_and_folder_are_on_the_disk_before_and_after_the_rename(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    sync, rename = os.fsync, os.replace

    def synced(handle: int) -> None:
        done.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        sync(handle)

    def renamed(old: Path, new: Path) -> None:
        done.append("rename")
        rename(old, new)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    write_typed(tmp_path / "run.toml", "x = 1\n")
    assert done == (["file", "rename", "folder"] if os.name == "posix" else ["file", "rename"])


@posix
def test_a_link_is_written_through(run_folder: Path) -> None:
    (run_folder / "kept").mkdir()
    target = run_folder / "kept" / "settings.toml"
    (run_folder / "run.toml").rename(target)
    (run_folder / "run.toml").symlink_to("kept/settings.toml")
    faster(run_folder).save()
    assert (run_folder / "run.toml").is_symlink()
    assert "1.31" in target.read_text()
    assert sorted(p.name for p in (run_folder / "kept").iterdir()) == ["settings.toml"]


@posix
def test_a_link_out_of_the_folder_is_written_where_run_toml_allows_it(run_folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "settings.toml"
    (run_folder / "run.toml").rename(target)
    (run_folder / "run.toml").symlink_to(target)
    before = target.read_text()
    with pytest.raises(InputError, match=r"run\.toml: is a link to .*settings\.toml, out of its folder"):
        faster(run_folder).save()
    assert target.read_text() == before
    target.write_text("outside = true\n" + before)
    faster(run_folder).save()
    assert "1.31" in target.read_text()
    assert (run_folder / "run.toml").is_symlink()


@posix
def test_a_result_never_goes_through_a_link(tmp_path: Path) -> None:
    """A link in another's out/ must not overwrite what it points to."""
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "derivatives.json").symlink_to(tmp_path / "mine.txt")
    write_text(tmp_path / "out" / "derivatives.json", "{}")
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert not (tmp_path / "out" / "derivatives.json").is_symlink()


KILLED = """
import os, signal, sys
from pathlib import Path
from towline.app.document import Document
document = Document.open(Path(sys.argv[1]))
document.set(("tow", "speed_m_s"), 1.31)
os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
document.save()
"""


@posix
@pytest.mark.parametrize("then", ["opened", "saved"])
def test_what_a_killed_writer_left_goes(run_folder: Path, then: str) -> None:
    before = (run_folder / "run.toml").read_bytes()
    subprocess.run([sys.executable, "-c", KILLED, str(run_folder)], check=False, timeout=60)
    left = list(run_folder.glob(".run-*.tmp.toml"))
    assert len(left) == 1
    assert (run_folder / "run.toml").read_bytes() == before
    mine = run_folder / ".run-notes.tmp.toml"  # named by a person
    mine.write_text("")
    document = faster(run_folder)
    document.save()
    assert left[0].exists()  # it may be another's that is at work this moment
    for path in (left[0], mine):
        os.utime(path, (time.time() - LEFT_OVER_S - 1,) * 2)
    if then == "opened":
        Document.open(run_folder)
    else:
        document.set(("tow", "speed_m_s"), 1.32)
        document.save()
    assert not left[0].exists()
    assert mine.exists()


# what may be opened ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("named", ["relative", "absolute", "comment"])
def test_a_recording_outside_needs_the_same_word_in_the_app(run_folder: Path, tmp_path: Path, named: str) -> None:
    (run_folder / "video.mp4").rename(tmp_path / "other.mp4")
    path = run_folder / "run.toml"
    name = "../other.mp4" if named == "relative" else str(tmp_path / "other.mp4")
    line = f'video = "{name}"' if named != "comment" else f'tracks = "t.csv"\n# video = "{name}"'
    path.write_text(path.read_text().replace('video = "video.mp4"', line))
    session = Session(run_folder)
    try:
        session.open(run_folder)
        assert session.frames is None
        if named != "comment":
            with pytest.raises(InputError) as refused:
                read_run(run_folder)
            assert session.video_problem == str(refused.value)
            assert "leads out of the run folder; outside = true" in session.video_problem
        session.doc.set(("outside",), True)
        assert session.refresh_video()
        assert session.frames is not None
        assert session.frames.count > 1
        session.doc.set(("outside",), None)
        assert session.refresh_video()
        assert session.frames is None
    finally:
        session.close()


def _fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _endless(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def _sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(3 << 30)


@posix
@pytest.mark.parametrize("made", [_fifo, _endless, _sparse])
def test_a_run_toml_that_is_no_plain_file_is_one_line(run_folder: Path, made: Callable[[Path], None]) -> None:
    made(run_folder / "run.toml")
    with pytest.raises(InputError, match=r"run\.toml: (is a (named pipe|device); a plain file|has 3072 MiB)"):
        Document.open(run_folder)


@pytest.mark.parametrize(
    "text", ["x = " + "9" * 5000, "x = " + "[" * 9000, "name = 'a'\n[tow]\nspeed_m_s = " + "9" * 400]
)
def test_an_absurd_run_toml_is_one_line(run_folder: Path, text: str) -> None:
    (run_folder / "run.toml").write_text(text)
    with pytest.raises(InputError) as refused:
        Document.open(run_folder).run()
    assert "\n" not in str(refused.value)
    with suppress(InputError):
        assert Document.open(run_folder).faults()
