"""Recordings as people have them: trimmed, joined, with gaps; each frame carries its number, so its time is known."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from clips import HEIGHT, WIDTH, drawn, film, notes_of, number_of, remux

from towline.pipeline.stages import track_run
from towline.record import read_run
from towline.record.tables import notes_of as table_notes
from towline.vision import Frame, clip_info, read_frames

RATE_HZ, FRAMES = 30, 72
TICK_S = 1.01e-3
"""Matroska counts in milliseconds: half of one for a frame, half for the first."""
KEPT_FROM = 17
"""Lies in the middle of a group of pictures: an editor that copies has to keep the pictures before it, and hides them."""


@pytest.fixture(scope="module", params=[0, 2], ids=["plain", "b-frames"])
def clip(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film(tmp_path_factory.mktemp("film") / "clip.mp4", range(FRAMES), b_frames=request.param)


def times_are_their_own(frames: Iterable[Frame], begins: int, rate_hz: float = RATE_HZ) -> list[int]:
    """Every frame shows the picture of its time, when the recording begins with picture ``begins``; the pictures' numbers."""
    shown = []
    for frame in frames:
        assert not frame.damaged
        shown.append(number_of(frame.luma))
        assert frame.t_s == pytest.approx((shown[-1] - begins) / rate_hz, abs=TICK_S)
    return shown


def trimmed(source: Path, target: Path, begins: int, ends: int) -> Path:
    """Copied from the key frame before ``begins`` on, whose pictures before ``begins`` stand before time zero; up to ``ends``."""
    with av.open(str(source)) as container, av.open(str(target), "w") as copy:
        video = container.streams.video[0]
        assert video.time_base is not None
        first = round(Fraction(begins, RATE_HZ) / video.time_base) + (video.start_time or 0)
        last = round(Fraction(ends, RATE_HZ) / video.time_base) + (video.start_time or 0)
        stream = copy.add_stream_from_template(video)
        packets = [p for p in container.demux(video) if p.size and p.dts is not None]
        keys = [p.pts for p in packets if p.is_keyframe and p.pts is not None and p.pts <= first]
        for packet in packets:
            assert packet.pts is not None
            assert packet.dts is not None
            if packet.pts >= max(keys) and packet.dts < last:
                packet.pts, packet.dts, packet.stream = packet.pts - first, packet.dts - first, stream
                copy.mux(packet)
    return target


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv", ".ts", ".avi"])
def test_a_trimmed_copy_opens_with_its_own_times(clip: Path, tmp_path: Path, suffix: str) -> None:
    path = trimmed(clip, tmp_path / f"trimmed{suffix}", KEPT_FROM, 60)
    frames = list(read_frames(path))
    begins = KEPT_FROM if suffix in (".mp4", ".mov") else 12  # without an edit list nothing can be hidden
    shown = times_are_their_own((f for f in frames if suffix != ".avi" or number_of(f.luma) < 57), begins)
    assert shown[0] == begins
    assert shown[:40] == list(range(begins, begins + 40))
    assert not notes_of(frames)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".ts", ".avi"])
def test_a_span_may_end_early(tmp_path: Path, suffix: str) -> None:
    frames = list(read_frames(film(tmp_path / f"clip{suffix}", range(FRAMES), b_frames=2), (0.5, 1.0)))
    assert times_are_their_own(frames, 0) == list(range(15, 31))
    assert not notes_of(frames)


def test_an_edit_list_holds_where_frames_are_counted(clip: Path, tmp_path: Path) -> None:
    path = trimmed(clip, tmp_path / "trimmed.mp4", KEPT_FROM, 60)
    shown = times_are_their_own(read_frames(path, (0.0, 0.8), 50.0), KEPT_FROM, 50.0)
    assert shown == list(range(KEPT_FROM, KEPT_FROM + 41))


def test_what_an_editor_took_from_the_last_group_is_said_where_frames_are_counted(clip: Path, tmp_path: Path) -> None:
    """Cut by copying, the last group may lose pictures that are shown between those it keeps; of plain pictures it loses none."""
    path = trimmed(clip, tmp_path / "trimmed.mp4", KEPT_FROM, 60)
    own = [number_of(frame.luma) for frame in read_frames(path)]
    said = notes_of(list(read_frames(path, frame_rate_hz=float(RATE_HZ))))
    if (np.diff(own) > 1).any():
        assert f"in {(np.diff(own) > 1).sum()} places its own times leave one out" in said
    else:
        assert own == list(range(KEPT_FROM, 60))
        assert not said


def test_transport_streams_put_one_behind_the_other(clip: Path, tmp_path: Path) -> None:
    """The second one's clock begins anew; its frames follow the first one's, and that is said."""
    part = remux(clip, tmp_path / "part.ts", lambda *_: None)
    path = tmp_path / "joined.ts"
    path.write_bytes(part.read_bytes() * 2)
    frames = list(read_frames(path))
    assert [number_of(frame.luma) for frame in frames] == [*range(FRAMES), *range(FRAMES)]
    np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(2 * FRAMES) / RATE_HZ, atol=1e-6)
    # the stream's own count of packets breaks at the join: what stands just before it cannot be told from a loss
    assert all(FRAMES - 3 <= frame.index < FRAMES for frame in frames if frame.damaged)
    assert notes_of(frames).count("its clock begins again near frame 72") == 1


def test_recordings_joined_by_copying_keep_the_times_they_were_given(clip: Path, tmp_path: Path) -> None:
    path = tmp_path / "joined.mp4"
    with av.open(str(path), "w") as copy:
        stream = None
        for part in (0, 1):
            with av.open(str(clip)) as container:
                video = container.streams.video[0]
                assert video.time_base is not None
                stream = stream or copy.add_stream_from_template(video)
                later = round(Fraction(part * (FRAMES + 2), RATE_HZ) / video.time_base)
                for packet in container.demux(video):
                    if packet.size and packet.pts is not None and packet.dts is not None:
                        packet.pts, packet.dts, packet.stream = packet.pts + later, packet.dts + later, stream
                        copy.mux(packet)
    for rate_hz, gap in ((None, 2), (float(RATE_HZ), 0)):
        frames = list(read_frames(path, frame_rate_hz=rate_hz))
        assert not any(frame.damaged for frame in frames)
        wanted = [*range(FRAMES), *range(FRAMES + gap, 2 * FRAMES + gap)]
        np.testing.assert_allclose([frame.t_s for frame in frames], np.array(wanted) / RATE_HZ, atol=1e-9)
    assert "in 1 places its own times leave one out" in notes_of(frames)


def test_an_avi_that_leaves_pictures_out_keeps_their_places(tmp_path: Path) -> None:
    """A camera program that drops a picture writes an empty one in its place."""
    kept = [n for n in range(40) if n not in (9, 20, 21)]
    path = tmp_path / "drops.avi"
    with av.open(str(path), "w") as target:
        stream = target.add_stream("mpeg4", rate=RATE_HZ)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"qscale": "2"}
        for number in kept:
            frame = av.VideoFrame.from_ndarray(drawn(number), format="yuv420p")
            frame.pts, frame.time_base = number, Fraction(1, RATE_HZ)
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))
    assert times_are_their_own(read_frames(path), 0) == kept


def test_pictures_without_an_order_of_their_own_take_their_places(tmp_path: Path) -> None:
    """A muxer that knew no presentation times wrote the decoding ones, as is common in remuxed AVIs."""
    source = film(tmp_path / "clip.mp4", range(FRAMES), b_frames=2)

    def unordered(index, packet):
        packet.pts = packet.dts

    frames = list(read_frames(remux(source, tmp_path / "unordered.mkv", unordered)))
    assert [number_of(frame.luma) for frame in frames] == list(range(FRAMES))
    np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(FRAMES) / RATE_HZ, atol=TICK_S)
    assert "each picture takes the time of its place" in notes_of(frames)


def test_open_groups_of_pictures(tmp_path: Path) -> None:
    """Begun at a key frame that earlier-shown pictures reach across: those cannot be drawn, all others have their times."""
    source = film(
        tmp_path / "open.mp4",
        range(FRAMES),
        **{"x264-params": "open-gop=1:scenecut=0:b-adapt=0:keyint=12:min-keyint=12:threads=1:bframes=2"},
    )
    assert times_are_their_own(read_frames(source), 0) == list(range(FRAMES))
    path = remux(source, tmp_path / "begun.mkv", lambda index, _: index >= 24)
    good = [frame for frame in read_frames(path) if not frame.damaged]
    first = number_of(good[0].luma)
    assert [number_of(frame.luma) for frame in good] == list(range(first, FRAMES))
    np.testing.assert_allclose(np.diff([frame.t_s for frame in good]), 1 / RATE_HZ, atol=1.1e-3)


def test_interlaced_pictures_are_named(tmp_path: Path) -> None:
    source = film(tmp_path / "clip.mp4", range(12), **{"x264-params": "tff=1:threads=1:bframes=0"})
    frames = list(read_frames(source))
    assert notes_of(frames).count("its pictures are interlaced") == 1


@pytest.mark.parametrize("transfer", [None, 16], ids=["ten-bit", "hdr"])
def test_ten_bits_are_read(tmp_path: Path, transfer: int | None) -> None:
    """HEVC, 10 bit, as phones film; with HDR's curve (PQ) the values are as coded all the same."""
    path = tmp_path / "deep.mp4"
    with av.open(str(path), "w") as target:
        stream = target.add_stream("libx265", rate=RATE_HZ)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p10le"
        stream.options = {"crf": "10", "preset": "ultrafast", "x265-params": "log-level=none"}
        if transfer is not None:
            stream.codec_context.color_trc = transfer
        for number in range(12):
            frame = av.VideoFrame.from_ndarray(drawn(number).astype(np.uint16) * 4, format="yuv420p10le")
            frame.pts, frame.time_base = number, Fraction(1, RATE_HZ)
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))
    frames = list(read_frames(path))
    assert times_are_their_own(frames, 0) == list(range(12))
    assert clip_info(path).codec == "hevc"
    assert abs(float(frames[5].luma[45:65, 40:55].mean()) - 180) < 3


def test_what_is_doubtful_is_said_with_the_tracks_and_stays_said(run_folder: Path) -> None:
    """In tracks.csv, and again when they are read from there."""
    source = run_folder / "video.mp4"
    part = remux(source, run_folder / "part.ts", lambda index, _: index < 120)
    source.unlink()
    (run_folder / "joined.ts").write_bytes(part.read_bytes() * 2)
    text = (run_folder / "run.toml").read_text()
    (run_folder / "run.toml").write_text(text.replace('"video.mp4"', '"joined.ts"'))
    run = read_run(run_folder)
    for anew in (True, False):
        found = track_run(run)
        assert found.anew == anew
        assert any("its clock begins again near frame 120" in note for note in found.notes)
    assert table_notes(run.out / "tracks.csv") == found.notes
    shutil.rmtree(run.out)
