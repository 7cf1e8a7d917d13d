"""Decoding: every frame its own picture, number and time; damage told, never passed over; threads that end."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
from clips import HEIGHT, WIDTH, film, notes_of, number_of, remux

from towline.record import read_run
from towline.vision import clip_info, read_frames
from towline.vision.recording.ahead import Ahead
from towline.vision.recording.clock import Clock
from towline.vision.recording.ledger import Picture
from towline.vision.recording.pictures import Doubt, Stream
from towline.vision.recording.slices import holds_forbidden


def packets(path: Path) -> list[tuple[bytes, int, int]]:
    """Payload, place in the file and presentation timestamp of each packet."""
    import av

    with av.open(str(path)) as source:
        return [(bytes(p), p.pos, p.pts) for p in source.demux(video=0) if p.size]


def spoil(path: Path, number: int, share: float = 0.4, length: int = 3) -> Path:
    """Overwrite some bytes of the packet ``number`` (decoding order)."""
    data = bytearray(path.read_bytes())
    payload, place, _ = packets(path)[number]
    start = data.index(payload, place) + int(share * len(payload))
    data[start : start + length] = bytes(value ^ 0x5A for value in data[start : start + length])
    path.write_bytes(data)
    return path


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """48 frames with two B frames between the others, a key frame every 12."""
    return film(tmp_path_factory.mktemp("film") / "clip.mp4", range(48), b_frames=2)


@pytest.fixture(scope="module")
def plain_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without B frames, in Matroska."""
    return film(tmp_path_factory.mktemp("film") / "clip.mkv", range(48))


# time -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".ts", ".avi", ".mov"])
def test_b_frames_come_in_their_order_each_with_its_time(tmp_path: Path, suffix: str) -> None:
    frames = list(read_frames(film(tmp_path / f"clip{suffix}", range(30), b_frames=2)))
    assert [number_of(frame.luma) for frame in frames] == list(range(30))
    assert [frame.index for frame in frames] == list(range(30))
    np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(30) / 30, atol=1e-12)
    assert not any(frame.damaged for frame in frames)


@pytest.mark.parametrize(("suffix", "tick_s"), [(".mp4", 1e-12), (".mkv", 5e-4)])
def test_a_variable_rate_keeps_its_own_times(tmp_path: Path, suffix: str, tick_s: float) -> None:
    steps = np.random.default_rng(3).choice([2700, 3000, 3100, 6000, 9100], 40)
    stamps = np.concatenate([[0], np.cumsum(steps)])
    path = film(tmp_path / f"clip{suffix}", [int(s) for s in stamps], Fraction(1, 90000), b_frames=2)
    frames = list(read_frames(path))
    np.testing.assert_allclose([frame.t_s for frame in frames], stamps / 90000, atol=tick_s)
    assert not any(frame.damaged for frame in frames)


@pytest.mark.parametrize("suffix", [".ts", ".mkv"])
def test_ntsc_rate_hours_after_the_clocks_zero(tmp_path: Path, suffix: str) -> None:
    """30000/1001 Hz, stamped from 3 h on: times count from the recording's start, exact to the bit of a float."""
    step = Fraction(1001, 30000)
    offset = round(Fraction(3 * 3600) / step)
    path = film(tmp_path / f"clip{suffix}", [offset + n for n in range(20)], step, 1 / step)
    frames = list(read_frames(path))
    assert [frame.t_s for frame in frames] == [float(n * step) for n in range(20)]
    assert clip_info(path).rate_hz == pytest.approx(30000 / 1001, rel=1e-6)


def test_the_clock_does_not_drift() -> None:
    """Stamped from before zero on, and after 30 h of 30000/1001 Hz in ticks of 1/90000, the time is still the right float."""
    clock = Clock("f", *stands_for(Fraction(1, 90000), Fraction(30000, 1001), start=-3003), None, None)
    last = 30 * 3600 * 30000 // 1001
    indices = [*range(5), *range(250, last, 250)]
    pictures = [Picture(n, 3003 * n - 3003, None, index=n) for n in indices]
    assert [t_s for _, t_s in clock.timed(pictures)] == [n * 1001 / 30000 for n in indices]


def stands_for(base: Fraction, rate: Fraction, start: int):
    """A container and a stream, as far as the clock asks them."""
    video = SimpleNamespace(
        average_rate=rate, guessed_rate=rate, time_base=base, start_time=start, frames=0, index_entries=[]
    )
    kind = SimpleNamespace(name="mpegts", flags=0)
    container = SimpleNamespace(streams=SimpleNamespace(video=[video]), format=kind, metadata={})
    return container, SimpleNamespace(by_place=False, first_stamp=start, last_stamp=None, packets=0)


def test_without_timestamps_frames_are_counted(tmp_path: Path) -> None:
    frames = list(read_frames(film(tmp_path / "clip.h264", range(20), b_frames=2), frame_rate_hz=50.0))
    assert [number_of(frame.luma) for frame in frames] == list(range(20))
    np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(20) / 50)


def test_exposure_moves_the_time_but_not_the_span(clip: Path) -> None:
    frames = list(read_frames(clip, (0.2, 0.5), exposure_s=0.02))
    assert [frame.index for frame in frames] == list(range(6, 16))
    np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(6, 16) / 30 + 0.01, atol=1e-12)
    assert next(iter(read_frames(clip, frame_rate_hz=10.0, exposure_s=0.05))).t_s == 0.025


def test_exposure_is_a_key_of_the_run(samples: Path, tmp_path: Path) -> None:
    text = (samples / "mariner" / "x1446" / "run.toml").read_text()
    (tmp_path / "run.toml").write_text(text.replace('video = "video.mp4"', 'video = "video.mp4"\nexposure_s = 0.004'))
    (tmp_path / "video.mp4").write_bytes(b"")
    assert read_run(tmp_path).file.source.exposure_s == 0.004


# times that cannot be true --------------------------------------------------------------------------------------------


def own_times(frames, step_s: float = 1 / 30) -> None:
    """Every frame that is handed out as good shows the picture of its time."""
    for frame in frames:
        if not frame.damaged:
            assert frame.t_s == pytest.approx(number_of(frame.luma) * step_s, abs=1e-9)


def test_a_time_that_falls_is_left_out_and_said(plain_clip: Path, tmp_path: Path) -> None:
    def falls(index, packet):
        packet.pts += 900 if index == 20 else 1000
        packet.dts -= 500

    falling = remux(plain_clip, tmp_path / "falls.mkv", falls)
    frames = list(read_frames(falling))
    assert [frame.index for frame in frames] == [n for n in range(48) if n != 20]
    own_times(frames)
    assert "time of frame 20, 0.567 s, is not after 0.633 s" in notes_of(frames)
    assert not notes_of(read_frames(falling, (0.0, 0.5)))
    assert [number_of(f.luma) for f in read_frames(falling, frame_rate_hz=30.0)] == list(range(48))


def test_a_time_that_leaps_is_left_out_and_said(plain_clip: Path, tmp_path: Path) -> None:
    def leaps(index, packet):
        packet.pts += 400 if index == 20 else 0

    frames = list(read_frames(remux(plain_clip, tmp_path / "leaps.mkv", leaps)))
    assert [frame.index for frame in frames if not frame.damaged] == [n for n in range(48) if n != 20]
    own_times(frames)
    assert "time of frame 20, 1.067 s, lies after the next one's 0.700 s" in notes_of(frames)


def test_a_pause_of_the_recording_is_said(plain_clip: Path, tmp_path: Path) -> None:
    def jumps(index, packet):
        packet.pts += 11_000 if index >= 20 else 0
        packet.dts = packet.pts

    frames = list(read_frames(remux(plain_clip, tmp_path / "jumps.mkv", jumps)))
    assert [frame.t_s for frame in frames] == pytest.approx([n / 30 + 11 * (n >= 20) for n in range(48)], abs=6e-4)
    assert re.search(r"frame 20 has time 11\.66.* more than 10 s later", notes_of(frames))


def test_one_time_off_an_even_beat_is_not_believed(tmp_path: Path) -> None:
    """A flipped bit in mp4's table of shifts: one frame 2 ms late."""
    stamps = [3000 * n + (180 if n == 21 else 0) for n in range(40)]
    frames = list(read_frames(film(tmp_path / "clip.mp4", stamps, Fraction(1, 90000))))
    assert [frame.index for frame in frames if frame.damaged] == [21]


def test_an_index_that_contradicts_itself_is_said(clip: Path, tmp_path: Path) -> None:
    for table, at, words in (
        (b"stts", 15, "stts is about"),
        (b"stts", 18, "stts adds up|multiples"),
        (b"ctts", 15, "ctts is"),
    ):
        data = bytearray(clip.read_bytes())
        data[data.index(table) + at] ^= 0x20
        path = tmp_path / "bad.mp4"
        path.write_bytes(data)
        first = next(iter(read_frames(path)))
        assert re.search(f"index is doubtful.*({words}).*frame_rate_hz would count frames", notes_of([first]))
        counted = list(read_frames(path, frame_rate_hz=30.0))
        assert counted
        assert all(number_of(frame.luma) == frame.index for frame in counted)


# damage ---------------------------------------------------------------------------------------------------------------


def good_ones_are_right(frames) -> None:
    for frame in frames:
        if not frame.damaged:
            assert frame.t_s == pytest.approx(frame.index / 30, abs=1e-9)
            assert number_of(frame.luma) == frame.index


@pytest.mark.parametrize("decode_threads", [None, 4])
@pytest.mark.parametrize("b_frames", [0, 2])
def test_damage_lasts_until_the_next_key_frame(tmp_path: Path, b_frames: int, decode_threads: int | None) -> None:
    """However many threads: with B frames, ffmpeg's own frame and slice threads would hide it."""
    path = film(tmp_path / "bad.mp4", range(48), b_frames=b_frames)
    order = [stamp for _, _, stamp in packets(path)]
    number = 16
    first = sorted(order).index(order[number])
    frames = list(read_frames(spoil(path, number), decode_threads=decode_threads))
    damaged, good = ({frame.index for frame in frames if frame.damaged is state} for state in (True, False))
    assert first not in good
    assert damaged | {first} <= set(range(12, 24))
    assert good >= set(range(12)) | set(range(24, 48))
    assert len(good) < 48 - 4  # and what follows the damage is not called good
    good_ones_are_right(frames)


@pytest.mark.parametrize("b_frames", [0, 2])
def test_threads_give_what_one_thread_gives(tmp_path: Path, b_frames: int) -> None:
    path = film(tmp_path / "clip.mp4", range(60), b_frames=b_frames)
    with av.open(str(path)) as container:
        assert Stream(container, 3, haste=True).in_haste == bool(b_frames)
    one, three = (list(read_frames(path, decode_threads=n)) for n in (1, 3))
    assert [(f.index, f.t_s, f.damaged) for f in one] == [(f.index, f.t_s, f.damaged) for f in three]
    assert all((a.luma == b.luma).all() for a, b in zip(one, three, strict=True))


def test_doubt_in_haste_goes_on_where_it_came_to(tmp_path: Path) -> None:
    """The first sign of damage comes late in the clip: every picture once, the rest as one thread reads it."""
    path = film(tmp_path / "bad.mp4", range(72), b_frames=2)
    spoiled = spoil(path, 50)
    with av.open(str(spoiled)) as container, pytest.raises(Doubt):
        list(Stream(container, 3, haste=True))
    one, three = (list(read_frames(spoiled, decode_threads=n)) for n in (1, 3))
    assert [(f.index, f.t_s, f.damaged) for f in one] == [(f.index, f.t_s, f.damaged) for f in three]
    assert any(f.damaged for f in three)
    good_ones_are_right(three)


def test_damage_in_one_picture_of_many_key_frames_stays_there(tmp_path: Path) -> None:
    path = film(tmp_path / "clip.mp4", range(12), **{"x264-params": "keyint=1:threads=1"})
    frames = list(read_frames(spoil(path, 5)))
    assert {frame.index for frame in frames if not frame.damaged} == set(range(12)) - {5}
    good_ones_are_right(frames)


@pytest.mark.parametrize("missing", [{17}, {12}, {15, 16, 17, 18, 19}])
def test_what_predicts_from_packets_left_out_is_damaged(plain_clip: Path, tmp_path: Path, missing: set[int]) -> None:
    """Nothing in the file is broken, and the decoder reports nothing; only the encoder's own count shows it."""
    path = remux(plain_clip, tmp_path / "cut.mkv", lambda index, _: index not in missing)
    frames = list(read_frames(path))
    good = {number_of(frame.luma) for frame in frames if not frame.damaged}
    assert good == set(range(min(missing))) | set(range(24, 48))
    for frame in frames:
        if not frame.damaged:
            assert frame.t_s == pytest.approx(number_of(frame.luma) / 30, abs=1e-9)


def test_a_wiped_stretch_of_a_picture_is_seen(clip: Path, tmp_path: Path) -> None:
    payload, place, _ = packets(clip)[12]
    data = bytearray(clip.read_bytes())
    start = data.index(payload, place)
    assert not holds_forbidden(payload, 4)
    data[start + len(payload) // 2 : start + len(payload) // 2 + 16] = bytes(16)
    assert holds_forbidden(data[start : start + len(payload)], 4)
    path = tmp_path / "wiped.mp4"
    path.write_bytes(data)
    frames = list(read_frames(path))
    assert {frame.index for frame in frames if not frame.damaged} == set(range(12)) | set(range(24, 48))


def test_a_cluster_that_does_not_match_its_checksum_is_damaged(plain_clip: Path, tmp_path: Path) -> None:
    payload, place, _ = packets(plain_clip)[30]
    data = bytearray(plain_clip.read_bytes())
    start = data.index(payload, place)
    data[start - 2] ^= 1  # a bit of the timestamp in the block's head: one millisecond
    path = tmp_path / "bad.mkv"
    path.write_bytes(data)
    frames = list(read_frames(path))
    assert len(frames) == 48
    assert frames[30].damaged
    good_ones_are_right(frames)


def test_a_recording_cut_short_says_so_unless_the_span_ends_before(
    clip: Path, plain_clip: Path, tmp_path: Path
) -> None:
    for source in (clip, plain_clip):
        path = tmp_path / f"cut{source.suffix}"
        path.write_bytes(source.read_bytes()[: int(0.7 * source.stat().st_size)])
        frames = list(read_frames(path))
        assert 24 < len(frames) < 48
        own_times(frames)
        assert re.search(r"ends after frame \d+ at .* of 1\.60 s: truncated or damaged", notes_of(frames))
        frames = list(read_frames(path, (0.0, 0.5)))
        assert len(frames) == 16
        assert not any(frame.damaged or frame.notes for frame in frames)


@pytest.mark.slow
def test_two_hundred_broken_copies_in_small(root: Path) -> None:
    """A slice of benchmarks/fuzz.py: no crash, no hang, no wrong time, no wrong picture."""
    command = [sys.executable, str(root / "benchmarks" / "fuzz.py"), "--copies", "20", "--seed", "9"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    last = done.stdout.splitlines()[-1]
    assert "of them 0 with a wrong time and 0 with a wrong picture" in last


# picture --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("turned", "corner"), [(0, (0, 0)), (90, (-1, 0)), (180, (-1, -1)), (-90, (0, -1))])
def test_pictures_stand_upright(tmp_path: Path, turned: int, corner: tuple[int, int]) -> None:
    """Turned by ``turned`` degrees counter-clockwise the first frame's top left lies in ``corner``."""
    path = film(tmp_path / "clip.mp4", range(3), turned=turned)
    frame = list(read_frames(path))[-1]
    upright = (WIDTH, HEIGHT) if turned in (0, 180) else (HEIGHT, WIDTH)
    info = clip_info(path)
    assert (info.width_px, info.height_px) == upright
    assert frame.luma.shape == frame.bgr().shape[:2] == upright[::-1]
    back = np.rot90(frame.luma, -round(turned / 90))
    assert number_of(back) == 2
    assert np.all(np.rot90(np.pad([[1]], ((0, 1), (0, 1))), round(turned / 90))[corner] == 1)


def test_white_is_what_the_range_says(tmp_path: Path) -> None:
    import av

    level = {}
    for name, form, colour_range in (("limited", "yuv420p", 1), ("full", "yuv420p", 2), ("deep", "yuv420p10le", 1)):
        path = tmp_path / f"{name}.mkv"
        with av.open(str(path), "w") as target:
            stream = target.add_stream("ffv1", rate=30)
            stream.width, stream.height, stream.pix_fmt = 128, 96, form
            stream.codec_context.color_range = colour_range
            frame = av.VideoFrame(128, 96, form)
            for index, plane in enumerate(frame.planes):
                value = 100 if index == 0 else 128
                kind = np.uint16 if name == "deep" else np.uint8
                np.frombuffer(plane, kind)[:] = 4 * value if name == "deep" else value
            frame.color_range, frame.pts = colour_range, 0
            target.mux(stream.encode(frame))
            target.mux(stream.encode(None))
        read = next(iter(read_frames(path)))
        level[name] = read.white_dn
        assert read.luma.dtype == np.uint8
        assert np.all(read.luma == 100), name  # as decoded, never stretched
    assert level == {"limited": 235, "full": 255, "deep": 235}


def test_luma_is_a_view_that_outlives_the_reader(clip: Path) -> None:
    frames = list(read_frames(clip))
    assert [number_of(frame.luma) for frame in frames] == list(range(48))
    assert not frames[0].luma.flags.owndata
    assert not frames[0].luma.flags.writeable


# the thread -----------------------------------------------------------------------------------------------------------


def decoding_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "towline-decode"]


def test_closing_early_ends_the_thread_and_closes_the_file(clip: Path) -> None:
    frames = read_frames(clip)
    assert next(frames).index == 0
    assert decoding_threads()
    frames.close()  # type: ignore[attr-defined]
    assert not decoding_threads()
    held = Path("/proc/self/fd")
    if held.is_dir():
        assert str(clip) not in {str(link.resolve()) for link in held.iterdir()}


def test_leaving_a_loop_by_an_error_ends_the_thread(clip: Path) -> None:
    def use() -> None:
        for frame in read_frames(clip):
            if frame.index == 3:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        use()
    assert not decoding_threads()


def test_a_program_may_end_while_frames_wait(clip: Path) -> None:
    code = f"from towline.vision import read_frames; frames = read_frames({str(clip)!r}); print(next(frames).index)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "0"
    assert done.stderr == ""


def test_errors_come_after_the_items_before_them() -> None:
    closed = []

    def items():
        try:
            yield from range(5)
            raise ValueError("five")
        finally:
            closed.append(threading.current_thread().name)

    ahead = Ahead(items, 2, 1 << 20, lambda _: 1)
    seen = []
    with pytest.raises(ValueError, match="five"):
        seen.extend(item for item in ahead)
    ahead.close()
    assert seen == [0, 1, 2, 3, 4]
    assert closed == ["towline-decode"]


def test_what_waits_is_bounded() -> None:
    made = []

    def items():
        for index in range(100):
            made.append(index)
            yield index

    for most_items, most_bytes in ((4, 1 << 20), (100, 40)):
        made.clear()
        ahead = Ahead(items, most_items, most_bytes, lambda _: 10)
        threading.Event().wait(0.05)
        assert len(made) == 5  # four wait, one is about to
        assert list(ahead) == list(range(100))
        ahead.close()


def test_memory_stays_small(tmp_path: Path) -> None:
    """1280 x 720, the whole process, with all that towline loads."""
    import av

    if not Path("/proc/self/status").is_file():
        pytest.skip("peak memory is read from /proc")
    path = tmp_path / "large.mp4"
    with av.open(str(path), "w") as target:
        stream = target.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 1280, 720, "yuv420p"
        stream.options = {"preset": "ultrafast", "bf": "0"}
        for number in range(60):
            frame = av.VideoFrame.from_ndarray(np.full((1080, 1280), 60 + number, np.uint8), format="yuv420p")
            frame.pts = number
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))
    code = (
        "from pathlib import Path; from towline.vision import read_frames\n"
        f"for frame in read_frames({str(path)!r}, decode_threads=8): pass\n"
        "print([line for line in Path('/proc/self/status').read_text().splitlines() if line.startswith('VmHWM')][0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert int(done.stdout.split()[1]) / 1024 < 400
