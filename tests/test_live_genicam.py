"""Industrial cameras by GenICam: against the producer of somebody else's that comes with genicam: balls that bounce."""

from __future__ import annotations

import os
import threading
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towline.live.coding import BASE, Coder
from towline.live.decoding import Decoding
from towline.live.genicam import PATHS, address_of, formats
from towline.live.pieces import Ended, Opened, Packet, opened_of
from towline.live.recorder import Recorder
from towline.live.source import Hearing, camera_pieces, kind_of
from towline.record.errors import VideoError
from towline.vision.recording import read_frames

RATE_HZ = 20.0
"""Of the balls."""


@pytest.fixture(scope="module")
def producer() -> Path:
    """The GenTL producer that comes with genicam, three cameras."""
    pytest.importorskip(
        "harvesters", reason="harvesters, which asks GenICam cameras, is not installed (the extra genicam)"
    )
    genicam = pytest.importorskip("genicam", reason="genicam is not installed (the extra genicam)")
    path = Path(genicam.__file__).parent / "viky.cti"
    if not path.is_file():
        pytest.skip("this build of genicam brings no producer")
    return path


def test_a_camera_of_somebody_elses_is_recorded_without_loss(producer: Path, tmp_path: Path) -> None:
    """The recording holds what was seen, frame by frame; a ball is there and moves on in small steps, at the camera's rate."""
    recorder, seen, stop = Recorder(tmp_path), [], threading.Event()
    decoding: Decoding | None = None
    for piece in camera_pieces(f"genicam:{producer}#1", stop):
        times = recorder.take(piece)
        if isinstance(piece, Opened):
            assert not piece.by_source  # this one says no time
            decoding = Decoding(piece)
        elif decoding is not None and isinstance(piece, Packet) and times is not None:
            seen += decoding.step(piece, times.t_s)
        if len(seen) == 20:
            stop.set()
    recorder.close()
    there = list(read_frames(tmp_path / "film.mkv"))
    assert len(there) == 20
    assert not any(frame.damaged for frame in there)
    for live, now in zip(seen, there, strict=True):
        assert np.array_equal(live.frame.luma, now.luma)
    steps = np.diff([frame.t_s for frame in there])
    assert np.median(steps) == pytest.approx(1 / RATE_HZ, rel=0.2)
    assert there[0].luma.shape == (400, 400)
    changed = [(a.luma != b.luma).mean() for a, b in pairwise(there)]
    assert min(changed) > 0
    assert max(changed) < 0.3


def test_a_source_is_heard_until_it_is_left(producer: Path) -> None:
    """As the command hears it: in a thread; stopped, the camera is free again for the next."""
    for _ in range(2):
        came = threading.Event()
        hearing = Hearing(f"genicam:{producer}#2", lambda piece: None, came)
        hearing.start()
        pieces: list[Any] = []
        while sum(isinstance(piece, Packet) for piece in pieces) < 3:
            pieces.append(hearing.pieces.get(timeout=20)[0])
        hearing.stop()
        hearing.join()
        while not isinstance(pieces[-1], Ended):
            pieces.append(hearing.pieces.get(timeout=5)[0])
        assert isinstance(pieces[0], Opened)
        assert pieces[0].size_px == (400, 400)
        assert pieces[-1] == Ended("")


def test_which_camera_is_asked_where_there_are_several(producer: Path) -> None:
    with pytest.raises(VideoError, match=r"several cameras; there are: 0, 1, 2"):
        next(camera_pieces(f"genicam:{producer}", threading.Event()))
    with pytest.raises(VideoError, match=r"no camera 4711; there are: 0, 1, 2"):
        next(camera_pieces(f"genicam:{producer}#4711", threading.Event()))


def test_producers_come_from_the_address_or_the_standards_variable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(PATHS, raising=False)
    with pytest.raises(VideoError, match=f"{PATHS} names no folder with one"):
        address_of("genicam:#7")
    with pytest.raises(VideoError, match=r"no GenTL producer .*none\.cti; expected the camera vendor's file"):
        address_of(f"genicam:{tmp_path / 'none.cti'}#7")
    one = tmp_path / "a.cti"
    one.touch()
    monkeypatch.setenv(PATHS, os.pathsep.join([str(tmp_path / "missing"), str(tmp_path)]))
    assert address_of("genicam:#7") == ([one], "7")
    assert address_of(f"genicam:{one}") == ([one], "")
    assert kind_of(f"genicam:{one}#7") == "genicam"


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_grey_values_keep_every_bit_and_are_seen_by_their_upper_eight(tmp_path: Path, bits: int) -> None:
    made = formats()[f"Mono{bits}"]
    rng = np.random.default_rng(bits)
    picture = rng.integers(0, 1 << bits, (48, 64)).astype(np.uint8 if bits == 8 else np.uint16)
    coder = Coder(64, 48, made.pixels, 25.0)
    recorder = Recorder(tmp_path)
    recorder.take(opened_of(coder.template, True))
    for packet in coder.packets(made.planes(picture), 1.0):
        recorder.take(Packet(bytes(packet), packet.pts, packet.dts, BASE, True, False, 1.0))
    recorder.close()
    coder.close()
    (frame,) = read_frames(tmp_path / "film.mkv")
    np.testing.assert_array_equal(frame.luma, picture >> (bits - 8))
    assert frame.white_dn == 255
    held = frame.raw.to_ndarray()
    np.testing.assert_array_equal(held, picture)


@pytest.mark.parametrize(
    ("name", "pixel"),
    [
        ("RGB8", (200, 100, 50)),
        ("BGR8", (50, 100, 200)),
        ("RGBa8", (200, 100, 50, 255)),
        ("BGRa8", (50, 100, 200, 255)),
    ],
)
def test_one_colour_has_one_luma_whatever_the_order_of_its_values(name: str, pixel: tuple[int, ...]) -> None:
    """BT.601, limited range: 16 + (65.738 R + 129.057 G + 25.064 B) / 256; a row and a column that chroma cannot halve are left."""
    made = formats()[name]
    planes = made.planes(np.tile(np.array(pixel, dtype=np.uint8), (7, 9, 1)))
    expected = 16 + (65.738 * 200 + 129.057 * 100 + 25.064 * 50) / 256
    assert planes.shape == (6 * 3 // 2, 8)
    np.testing.assert_allclose(planes[:6], expected, atol=1)


@pytest.mark.parametrize("first", ["RG", "BG", "GR", "GB"])
def test_a_mosaic_has_the_luma_of_its_colour(first: str) -> None:
    """A plain colour under the mosaic whose first row begins so."""
    level = {"R": 200, "G": 100, "B": 50}
    second = {"RG": "GB", "BG": "GR", "GR": "BG", "GB": "RG"}[first]
    cell = np.array([[level[c] for c in row] for row in (first, second)], dtype=np.uint8)
    planes = formats()[f"Bayer{first}8"].planes(np.tile(cell, (8, 8)))
    expected = 16 + (65.738 * 200 + 129.057 * 100 + 25.064 * 50) / 256
    np.testing.assert_allclose(planes[2:14, 2:14], expected, atol=1)
