"""Pictures that were stamped when they came: their times are those of the camera's beat, where it has one."""

from __future__ import annotations

import dataclasses
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest

from towline.live.pieces import Packet
from towline.live.recorder import Recorder
from towline.live.source import camera_pieces
from towline.pipeline.stages.tracks import track_run
from towline.record.run import read_run
from towline.vision.flash import brightness
from towline.vision.recording import read_frames
from towline.vision.recording.beat import on_beat

RATE_HZ, COUNT = 30.0, 600
STEP_S = 1 / RATE_HZ
SOON_S = 2e-4
"""Of the earliest of fifteen pictures that are late by 3 ms on average a beat is told to 0.2 / sqrt(40) ms: six of that."""


def late_by(draw: str, rng: np.random.Generator, count: int) -> np.ndarray:
    """What pictures' ways here take, some 3 ms on average, less the shortest."""
    if draw == "exponential":
        return rng.exponential(0.003, count)
    if draw == "a tenth much":
        return np.where(rng.random(count) < 0.1, rng.uniform(0.0, 0.06, count), rng.uniform(0, 0.0015, count))
    return np.repeat(rng.exponential(0.003, count // 3), 3)  # in threes, as of a sender that is busy now and then


def came(taken_s: np.ndarray, late_s: np.ndarray) -> np.ndarray:
    """When they came: none before the one before it."""
    return np.maximum.accumulate(taken_s + late_s) + 1e-6 * np.arange(len(taken_s))


@pytest.mark.parametrize("draw", ["exponential", "a tenth much", "in threes"])
@pytest.mark.parametrize("seed", range(5))
def test_times_are_those_of_taking_but_for_a_constant(draw: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    taken_s = np.arange(COUNT) * STEP_S * (1 + 1e-4 * rng.normal())
    beat = on_beat(came(taken_s, late_by(draw, rng, COUNT)))
    assert beat.even.all()
    off = beat.t_s - taken_s
    assert np.ptp(off) < 2 * SOON_S + 1e-6 * COUNT
    assert beat.rate_hz == pytest.approx(1 / np.diff(taken_s)[0], rel=1e-4)
    assert beat.wavers_s < 0.001


def test_left_out_pictures_and_a_burst_after_a_halt_keep_their_places() -> None:
    """A tenth of the pictures never came; for 0.4 s all waited and came at once: nothing is told of when one of those was left out,
    all others are where they were taken."""
    rng = np.random.default_rng(3)
    number = np.flatnonzero(rng.random(COUNT) > 0.1)
    taken_s = number * STEP_S
    halted = (taken_s > 8.0) & (taken_s < 8.4)
    arrived_s = came(taken_s, np.where(halted, 8.4 - taken_s, rng.exponential(0.002, len(taken_s))))
    off = on_beat(arrived_s).t_s - taken_s
    off -= np.median(off)
    assert np.abs(off[~halted]).max() < 2 * SOON_S + 1e-6 * COUNT
    assert np.abs(off[halted]).max() < np.abs(arrived_s - taken_s).max()


def test_a_source_that_came_back_has_a_beat_of_its_own() -> None:
    rng = np.random.default_rng(4)
    before = np.arange(COUNT // 2) * STEP_S
    taken_s = np.concatenate([before, before + before[-1] + 5.0137])
    beat = on_beat(came(taken_s, rng.exponential(0.002, COUNT)))
    off = beat.t_s - taken_s
    assert beat.even.all()
    assert np.ptp(off) < 3 * SOON_S + 1e-6 * COUNT


@pytest.mark.parametrize(
    "steps_s",
    [
        pytest.param(np.random.default_rng(1).choice([1 / 30, 1 / 25], COUNT), id="of two steps"),
        pytest.param(np.random.default_rng(2).uniform(0.02, 0.05, COUNT), id="of any step"),
        pytest.param(np.where(np.arange(COUNT) < COUNT // 2, 1 / 30, 1 / 24), id="another rate from the middle on"),
        pytest.param(STEP_S * (1 + 0.01 * np.sin(np.arange(COUNT) / 50)), id="a rate that wanders"),
    ],
)
def test_a_camera_without_an_even_beat_keeps_when_its_pictures_came(steps_s: np.ndarray) -> None:
    arrived_s = np.cumsum(steps_s)
    beat = on_beat(arrived_s)
    assert np.array_equal(beat.t_s, arrived_s)
    assert not beat.even.any()
    assert "no even beat" in beat.words


@pytest.mark.parametrize("count", [0, 1, 2, 59])
def test_too_few_pictures_show_no_beat(count: int) -> None:
    arrived_s = np.arange(count) * STEP_S
    assert np.array_equal(on_beat(arrived_s).t_s, arrived_s)


def test_the_next_picture_is_put_on_the_beat_while_none_is_after_it() -> None:
    """Told one by one, as while a tow is filmed: rising, and where they came on time to a fifth of a millisecond."""
    rng = np.random.default_rng(6)
    taken_s = np.arange(2 * COUNT) * STEP_S
    late_s = late_by("a tenth much", rng, 2 * COUNT)
    arrived_s = came(taken_s, late_s)
    beat = on_beat(arrived_s[:COUNT])
    times = [float(beat.t_s[-1])]
    for one in arrived_s[COUNT:]:
        times.append(beat.after(float(one), times[-1]))
    off = np.array(times[1:]) - taken_s[COUNT:]
    assert (np.diff(times) > 0).all()
    soon = arrived_s[COUNT:] - taken_s[COUNT:] < STEP_S / 2
    assert np.mean(np.abs(off[soon] - np.median(off)) < 2 * SOON_S + 1e-6 * COUNT) > 0.9  # others came after a late one


@pytest.fixture(scope="module")
def filmed(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The first 6 s of a sample film, and the same by a camera that stamps nothing, each picture late by up to 40 ms."""
    before = tmp_path_factory.mktemp("film") / "x1446"
    shutil.copytree(samples / "mariner" / "x1446", before, ignore=shutil.ignore_patterns("out"))
    folder = tmp_path_factory.mktemp("arrival")
    recorder, rng = Recorder(folder), np.random.default_rng(7)
    rate_hz = 1 / float(np.median(np.diff([f.t_s for f in read_frames(read_run(before).source_path, (0.0, 1.0))])))
    count, last_s = 0, 0.0
    for piece in camera_pieces(str(read_run(before).source_path), threading.Event()):
        if isinstance(piece, Packet):
            late_s = rng.exponential(0.003) + (rng.uniform(0, 0.04) if rng.random() < 0.15 else 0.0)
            last_s = max(count / rate_hz + late_s, last_s + 1e-3)
            piece = dataclasses.replace(piece, pts=None, dts=None, arrived_s=100.0 + last_s)
            count += 1
        recorder.take(piece)
        if count == round(6 * rate_hz):
            break
    recorder.close()
    text = (before / "run.toml").read_text()
    (folder / "run.toml").write_text(text.replace("video.mp4", recorder.name))
    return before, folder


@pytest.mark.slow
def test_tracks_of_a_camera_that_stamps_nothing_are_on_its_beat(filmed: tuple[Path, Path]) -> None:
    """As of the film itself: times, and what paths show of a mark's error, which a wavering clock would make larger."""
    before, folder = filmed
    found = track_run(read_run(folder))
    table = found.table
    other = track_run(read_run(before)).table
    other = other[other["frame"] <= table["frame"].max()]
    off = table["t_s"].to_numpy() - other["t_s"].to_numpy()
    came_s = np.array([frame.t_s for frame in read_frames(read_run(folder).source_path)])
    assert np.ptp(came_s - np.unique(other["t_s"])) > 0.02
    assert np.ptp(off) < 2 * SOON_S + 1e-3  # Matroska keeps whole milliseconds
    assert "stamped when they came" in "".join(found.notes)
    seen = (table["status"] == "measured") & (other["status"].to_numpy() == "measured")
    sigma, usual = (t[["sigma_u_px", "sigma_v_px"]].to_numpy()[seen.to_numpy()] for t in (table, other))
    assert np.median(sigma / usual) < 1.5


@pytest.mark.slow
def test_a_flash_has_the_same_time(filmed: tuple[Path, Path]) -> None:
    _, folder = filmed
    t_s, _ = brightness(read_frames(read_run(folder).source_path))
    assert np.ptp(np.diff(t_s)) < 1e-9
