"""Pictures as a recording: a folder, a pattern, times in their names; tracked as a lossless video of them is."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

import towline
from towline.cli import main
from towline.record import InputError, VideoError, read_run
from towline.vision import clip_info, read_frames

RATE_HZ, FRAMES = 30.0, 60


@pytest.fixture(scope="module")
def shots(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of pictures of a sample tow, frames/img_0007.png and on."""
    run = tmp_path_factory.mktemp("shots")
    (run / "frames").mkdir()
    sample = samples / "mariner" / "x1446"
    for frame in read_frames(sample / "video.mp4", (0.0, (FRAMES - 0.5) / RATE_HZ)):
        cv2.imwrite(str(run / "frames" / f"img_{frame.index + 7:04d}.png"), frame.luma)
    text = (sample / "run.toml").read_text()
    (run / "run.toml").write_text(text.replace('"video.mp4"', f'"frames"\nframe_rate_hz = {RATE_HZ}'))
    return run


def film_of(run: Path, target: Path) -> Path:
    """The same pictures as a lossless video's run."""
    import av

    target.mkdir()
    with av.open(str(target / "film.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=int(RATE_HZ))
        stream.width, stream.height, stream.pix_fmt = 800, 600, "gray"
        for file in sorted((run / "frames").iterdir()):
            picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        container.mux(stream.encode())
    (target / "run.toml").write_text((run / "run.toml").read_text().replace('"frames"', '"film.mkv"'))
    return target


@pytest.mark.slow
@pytest.mark.parametrize("named", ["frames", "frames/img_%04d.png", "frames/*.png", "frames/img_00??.png"])
def test_pictures_are_tracked_as_a_video_of_them(shots: Path, tmp_path: Path, named: str) -> None:
    """To the last bit, however the series is named."""
    film = film_of(shots, tmp_path / "film")
    run = Path(shutil.copytree(shots, tmp_path / "run"))
    (run / "run.toml").write_text((run / "run.toml").read_text().replace('"frames"', f'"{named}"'))
    tracks = towline.track(run)
    assert (tracks.status == "measured").mean() > 0.9
    pd.testing.assert_frame_equal(tracks, towline.track(film))


def pictures(folder: Path, names: list[str], value: int = 100) -> Path:
    folder.mkdir(exist_ok=True)
    for place, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((8, 12), value + place, np.uint8))
    return folder


@pytest.mark.parametrize(
    ("pattern", "names", "times"),
    [
        ("{ms}.png", ["1000.png", "1040.png", "1090.5.png"], [0.0, 0.04, 0.0905]),
        ("cam1_{us}.png", ["cam1_999999.png", "cam1_1000000.png", "cam1_1500000.png"], [0.0, 1e-6, 0.500001]),
        ("t{s}s.png", ["t9.5s.png", "t10,25s.png", "t100s.png"], [0.0, 0.75, 90.5]),
        ("{ns}.png", ["1700000000000000000.png", "1700000000000000001.png"], [0.0, 1e-9]),
    ],
)
def test_times_are_read_from_names(tmp_path: Path, pattern: str, names: list[str], times: list[float]) -> None:
    """By their value, not their letters; whole numbers of nanoseconds since 1970 to the last one."""
    folder = pictures(tmp_path / "shots", names)
    frames = list(read_frames(folder / pattern))
    assert [frame.t_s for frame in frames] == times
    assert [int(frame.luma[0, 0]) for frame in frames] == [100 + n for n in range(len(names))]
    assert [frame.t_s for frame in read_frames(folder / pattern, None, 10.0)] == [n / 10 for n in range(len(names))]


def test_a_missing_number_keeps_its_gap_and_a_broken_picture_is_said(tmp_path: Path) -> None:
    folder = pictures(tmp_path / "shots", [f"s{n}.png" for n in (8, 9, 10, 12, 13, 14)])
    (folder / "s13.png").write_bytes(b"no picture")
    cv2.imwrite(str(folder / "s14.png"), np.zeros((9, 12), np.uint8))
    frames = list(read_frames(folder, None, 10.0))
    assert [(frame.index, frame.t_s) for frame in frames] == [(0, 0.0), (1, 0.1), (2, 0.2), (4, 0.4)]
    notes = [note for frame in frames for note in frame.notes]
    assert notes == ["s13.png: no picture that can be read; left out", "s14.png: is 12 x 9, the first 12 x 8; left out"]


def test_twelve_bits_in_sixteen_are_seen(tmp_path: Path) -> None:
    """A camera's 12 bits stand in the lower ones: half of white is half of white."""
    for n in range(3):
        cv2.imwrite(str(tmp_path / f"a{n}.tif"), np.full((8, 12), 2048, np.uint16))
    cv2.imwrite(str(tmp_path / "a3.tif"), np.full((8, 12), 5000, np.uint16))
    frames = list(read_frames(tmp_path / "a%d.tif", None, 10.0))
    assert [int(frame.luma[0, 0]) for frame in frames] == [128, 128, 128, 255]
    assert "taken as 12 bits" in frames[0].notes[0]
    assert clip_info(tmp_path / "*.tif").codec == "tiff"


def test_what_cannot_be_read_is_one_line(shots: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(shots, tmp_path / "run"))
    path = run / "run.toml"
    whole = path.read_text()
    path.write_text(whole.replace(f"frame_rate_hz = {RATE_HZ}\n", ""))
    with pytest.raises(
        VideoError, match=r"frames: pictures have no times; source\.frame_rate_hz is needed, or a pattern"
    ):
        towline.track(run)
    path.write_text(whole.replace('"frames"', '"frames/*.jpg"'))
    with pytest.raises(InputError, match=r"source\.video: no such file: frames/\*\.jpg"):
        read_run(run)
    double = pictures(tmp_path / "double", ["1.0.png", "1.png", "2.png"])
    with pytest.raises(VideoError, match="have the same time"):
        list(read_frames(double / "{s}.png"))


def test_init_offers_a_folder_of_pictures(shots: Path, tmp_path: Path) -> None:
    shutil.copytree(shots / "frames", tmp_path / "frames")
    assert main(["init", str(tmp_path), "--yes"]) == 0
    assert read_run(tmp_path).file.source.video == "frames"
    assert "image_size_px = [800, 600]" in (tmp_path / "run.toml").read_text()
