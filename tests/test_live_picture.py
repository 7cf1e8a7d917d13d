"""The small picture of a tow that is filmed: what is drawn into it, and that nobody waits for it."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from towline.live import picture as room
from towline.live.picture import DATUM_BGR, MARK_BGR, PICTURE, Pictures, drawn
from towline.record.run import Run, read_run
from towline.vision import Frame, read_frames
from towline.vision.follower import Glance

SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446"


@pytest.fixture(scope="module")
def film() -> tuple[Run, Frame]:
    run = read_run(SAMPLE)
    return run, next(iter(read_frames(run.source_path, (0.0, 0.1))))


def shown(data: bytes) -> NDArray[np.int_]:
    import cv2

    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert found is not None
    return found.astype(int)


def like(picture: NDArray[np.int_], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Pixels of about a colour: the JPEG halves the colours' resolution."""
    return (np.abs(picture - colour) < 70).all(axis=2)


def mark(name: str, u: float, v: float, reason: str = "") -> Glance:
    return Glance(name, u, v, 0.1, 0.1, reason)


def test_marks_and_datum_points_stand_where_they_are_seen(film: tuple[Run, Frame]) -> None:
    """800 pixels wide become 640: the ring's middle is at 0.8 of the place, less 0.1, to half a pixel; a lost mark has none."""
    _, frame = film
    marks = (mark("bow", 500.0, 300.0), mark("stern", np.nan, np.nan, "covered"))
    picture = shown(drawn(frame, marks, [(200.0, 400.0)]))
    assert picture.shape == (480, 640, 3)
    inside = np.zeros(picture.shape[:2], bool)
    inside[220:260, 380:412] = True  # less the name to its right
    rows, columns = np.nonzero(like(picture, MARK_BGR) & inside)
    assert len(rows) > 40
    assert (columns.min() + columns.max()) / 2 == pytest.approx(0.8 * 500.5 - 0.5, abs=1.0)
    assert (rows.min() + rows.max()) / 2 == pytest.approx(0.8 * 300.5 - 0.5, abs=1.0)
    rows, columns = np.nonzero(like(picture, DATUM_BGR))
    assert np.median(columns) == pytest.approx(160, abs=1.5)
    assert np.median(rows) == pytest.approx(320, abs=1.5)
    plain = shown(drawn(frame, (), []))
    assert not like(plain, MARK_BGR)[220:260, 380:420].any()
    changed = np.abs(picture - plain).max(axis=2) > 60
    assert changed[455:, :200].any()  # "not seen: stern"
    grey = shown(drawn(replace(frame, raw=None), (), []))
    assert np.abs(grey.mean(axis=2) - plain.mean(axis=2)).mean() < 12


def test_nobody_waits_for_a_picture(film: tuple[Run, Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes until it is let go: of a hundred frames that come meanwhile none waits, two are taken, and the rest dropped."""
    run, frame = film
    let_go = threading.Event()
    whole = room.drawn

    def slow(*given: object) -> bytes:
        assert let_go.wait(20)
        return whole(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(room, "drawn", slow)
    monkeypatch.setattr(room, "EVERY_S", 0.0)
    pictures = Pictures(replace(run, folder=tmp_path))
    began, taken = time.thread_time(), 0
    for _ in range(100):
        taken += pictures.offer(frame, ())
        time.sleep(0.001)
    assert time.thread_time() - began < 0.1
    assert taken == 2  # one that is drawn, one that waits
    assert not (tmp_path / "out" / PICTURE).exists()
    let_go.set()
    pictures.close()
    assert shown((tmp_path / "out" / PICTURE).read_bytes()).shape == (480, 640, 3)
    assert [path.name for path in (tmp_path / "out").iterdir()] == [PICTURE]


def test_pictures_are_drawn_a_few_times_a_second(film: tuple[Run, Frame], tmp_path: Path) -> None:
    run, frame = film
    pictures = Pictures(replace(run, folder=tmp_path))
    began = time.monotonic()
    taken = [pictures.offer(frame, ()) for _ in range(1000)]
    pictures.close()
    assert taken[0]
    assert sum(taken) <= 1 + (time.monotonic() - began) / room.EVERY_S


def test_a_camera_that_is_always_a_frame_behind_is_seen_all_the_same(
    film: tuple[Run, Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its pictures are fewer, and the first comes at once: nobody has to film without having seen what a camera sees."""
    run, frame = film
    monkeypatch.setattr(room, "SELDOM_S", 0.2)
    monkeypatch.setattr(room, "EVERY_S", 0.0)
    pictures = Pictures(replace(run, folder=tmp_path))
    began, taken = time.monotonic(), []
    while time.monotonic() - began < 0.5:
        taken.append(pictures.offer(frame, (), waiting=True))
        time.sleep(0.005)
    lasted_s = time.monotonic() - began
    pictures.close()
    assert taken[0]
    assert 2 <= sum(taken) <= 1 + lasted_s / room.SELDOM_S
    assert shown((tmp_path / "out" / PICTURE).read_bytes()).shape == (480, 640, 3)
