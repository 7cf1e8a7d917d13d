"""A source of one's own, registered here: a folder of numbered pictures, tracked as a lossless video of the same pictures is."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

import towline
from towline.cli import main
from towline.record import InputError, VideoError, read_run
from towline.vision import ClipInfo, Frame, clip_info, read_frames, register_source, timed_frames

RATE_HZ, FRAMES, SPAN_S = 30.0, 60, (0.5, 1.5)
NUMBERED = re.compile(r"\D*(\d+)\.png")


def pictures(folder: Path) -> list[Path]:
    """PNGs of a folder that have a number, in its order."""
    found = [path for path in folder.glob("*.png") if NUMBERED.fullmatch(path.name)] if folder.is_dir() else []
    return sorted(found, key=number)


def number(path: Path) -> int:
    match = NUMBERED.fullmatch(path.name)
    assert match is not None
    return int(match[1])


class PictureFolder:
    """Pictures have no times: run.toml's frame_rate_hz gives them."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def info(self) -> ClipInfo:
        files = pictures(self.path)
        height, width = self._read(files[0]).shape[:2]
        return ClipInfo(width, height, 25.0, len(files) / 25.0, "png")

    def frames(
        self, span_s: tuple[float, float] | None, frame_rate_hz: float | None, exposure_s: float
    ) -> Iterator[Frame]:
        if frame_rate_hz is None:
            raise VideoError(f"{self.path}: pictures have no times; source.frame_rate_hz is needed")
        files = pictures(self.path)
        numbered = ((number(file) - number(files[0]), lambda file=file: self._read(file)) for file in files)
        return timed_frames(numbered, frame_rate_hz, span_s, exposure_s)

    def _read(self, file: Path) -> np.ndarray:
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        if picture is None:
            raise VideoError(f"{file}: is no picture that can be read")
        return picture


@pytest.fixture
def registered(registries: None) -> None:
    register_source("folder of pictures", takes=lambda path: bool(pictures(path)), files=pictures)(PictureFolder)


@pytest.fixture(scope="module", params=["gray", "bgr0"])
def pair(request: pytest.FixtureRequest, samples: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same pictures of a sample tow, grey or in colour: as a lossless video's run, and as a run of a folder."""
    import av

    top = tmp_path_factory.mktemp(request.param)
    film, folder = top / "film", top / "folder"
    for run in (film, folder):
        run.mkdir()
    (folder / "shots").mkdir()
    colour = request.param == "bgr0"
    with av.open(str(film / "film.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=int(RATE_HZ))
        stream.width, stream.height, stream.pix_fmt = 800, 600, request.param
        for frame in read_frames(samples / "mariner" / "x1446" / "video.mp4", (0.0, (FRAMES - 0.5) / RATE_HZ)):
            picture = frame.bgr() if colour else frame.luma
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24" if colour else "gray")))
            cv2.imwrite(str(folder / "shots" / f"shot{frame.index + 98}.png"), picture)
        container.mux(stream.encode())
    text = (samples / "mariner" / "x1446" / "run.toml").read_text()
    for run, video in ((film, "film.mkv"), (folder, "shots")):
        named = text.replace(
            '"video.mp4"', f'"{video}"\nframe_rate_hz = {RATE_HZ}\nexposure_s = 0.004\nspan_s = {list(SPAN_S)}'
        )
        (run / "run.toml").write_text(named)
    return film, folder


@pytest.mark.slow
def test_a_folder_is_tracked_as_a_video_of_its_pictures(registered: None, pair: tuple[Path, Path]) -> None:
    """To the last bit: pictures, numbers, times, tracks; and the motion."""
    film, folder = pair
    frames, others = (
        list(read_frames(film / "film.mkv", None, RATE_HZ)),
        list(read_frames(folder / "shots", None, RATE_HZ)),
    )
    assert [f.index for f in others] == [f.index for f in frames] == list(range(FRAMES))
    for one, other in zip(frames, others, strict=True):
        np.testing.assert_array_equal(one.luma, other.luma)
        np.testing.assert_array_equal(one.bgr(), other.bgr())
        assert (one.t_s, one.white_dn, one.damaged) == (other.t_s, other.white_dn, other.damaged)
    tracks = towline.track(film)
    assert (tracks.status == "measured").mean() > 0.9
    pd.testing.assert_frame_equal(towline.track(folder), tracks)
    pd.testing.assert_frame_equal(towline.compute_motion(folder), towline.compute_motion(film))


@pytest.mark.slow
def test_the_commands_take_it(registered: None, pair: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    _, folder = pair
    assert main(["track", str(folder), "--fresh"]) == 0
    assert (folder / "out" / "overlay.mp4").is_file()
    assert len(list(read_frames(folder / "out" / "overlay.mp4"))) == round((SPAN_S[1] - SPAN_S[0]) * RATE_HZ) + 1
    assert main(["rectify", str(folder), "--depth", "0.12"]) == 0
    assert (folder / "out" / "top.png").is_file()


@pytest.mark.once
def test_a_changed_picture_is_tracked_anew(registered: None, pair: tuple[Path, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(pair[1], tmp_path / "run"))
    towline.track(folder)
    before, kept = read_run(folder).input_hash(), (folder / "out" / "tracks.csv").stat().st_mtime_ns
    towline.track(folder)
    assert (folder / "out" / "tracks.csv").stat().st_mtime_ns == kept
    file = folder / "shots" / "shot120.png"
    black = np.zeros_like(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))
    cv2.imwrite(str(file), black)
    assert read_run(folder).input_hash() != before
    tracks = towline.track(folder)
    assert (folder / "out" / "tracks.csv").stat().st_mtime_ns > kept
    assert (tracks[tracks.frame == 120 - 98].status == "lost").all()


def test_a_missing_number_keeps_its_gap(registered: None, pair: tuple[Path, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(pair[1] / "shots", tmp_path / "shots"))
    (folder / "shot100.png").unlink()
    assert [frame.index for frame in read_frames(folder, (0.0, 0.15), RATE_HZ)] == [0, 1, 3, 4]


def test_what_cannot_be_read_is_one_line(
    registered: None, pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(pair[1], tmp_path / "run"))
    path = folder / "run.toml"
    whole = path.read_text()
    path.write_text(whole.replace(f"frame_rate_hz = {RATE_HZ}\n", ""))
    with pytest.raises(VideoError, match="shots: pictures have no times"):
        towline.track(folder)
    path.write_text(whole)
    (folder / "shots" / "shot115.png").write_bytes(b"no picture")
    with pytest.raises(VideoError, match=r"shot115\.png: is no picture"):
        towline.track(folder)
    shutil.rmtree(folder / "shots")
    with pytest.raises(InputError, match=r"source\.video: no such file: shots"):
        towline.track(folder)


def test_a_folder_without_pictures_is_refused(pair: tuple[Path, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(pair[1], tmp_path / "run"))
    for file in (folder / "shots").iterdir():
        file.unlink()
    with pytest.raises(InputError, match="shots is a folder; a plain file is expected"):
        read_run(folder)
    with pytest.raises(VideoError, match="is a folder"):
        clip_info(folder / "shots")


def test_init_offers_it(registered: None, pair: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.copytree(pair[1] / "shots", tmp_path / "shots")
    assert main(["init", str(tmp_path), "--yes"]) == 0
    run = read_run(tmp_path)
    assert run.file.source.video == "shots"
    assert "image_size_px = [800, 600]" in (tmp_path / "run.toml").read_text()


def test_the_app_shows_it(registered: None, pair: tuple[Path, Path]) -> None:
    """Any frame, and its exact pixels, without timestamps to seek by."""
    from towline.app.frames import Frames

    _, folder = pair
    frames = Frames(folder / "shots", RATE_HZ)
    try:
        assert frames.wait(FRAMES - 1)
        picture = cv2.imread(str(folder / "shots" / "shot140.png"), cv2.IMREAD_COLOR)
        assert picture is not None
        np.testing.assert_array_equal(frames.exact(140 - 98).bgr(), picture)
        assert frames.jpeg(3)[1]
    finally:
        frames.close()
