"""A tow while it is filmed: heard, recorded, seen, watched, fitted. Films are fed as fast as they are read."""

from __future__ import annotations

import json
import queue
import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from clips import drawn, film, number_of, remux

from towline.cli import main
from towline.geometry import DatumFit
from towline.live.arrivals import Arrival, ArrivalWatch
from towline.live.clock import OneClock
from towline.live.decoding import Decoding
from towline.live.event import Event, Lasting
from towline.live.folder import make_folder, next_of, tows_of
from towline.live.pieces import ARRIVAL_BASE, Ended, Opened, Packet
from towline.live.recorder import Recorder
from towline.live.session import Looking
from towline.live.source import Hearing, camera_pieces, kind_of
from towline.live.stamped import Stamped
from towline.pipeline.stages import fit_run_datum
from towline.record.errors import InputError
from towline.record.run import Run, read_run
from towline.record.tables import read_motion
from towline.vision import Frame, read_frames

FED_S = 4.5
BEGINS_S = 2.5
NAMED_S = 2.0


@pytest.fixture(scope="module")
def tow(samples: Path) -> tuple[Run, DatumFit, list[Frame]]:
    """The first seconds of a sample film, decoded."""
    run = read_run(samples / "mariner" / "x1446")
    return run, fit_run_datum(run), list(read_frames(run.source_path, (0.0, FED_S)))


def fed(
    run: Run, fit: DatumFit, frames: list[Frame], change: Callable[[Frame], Frame] = lambda f: f
) -> tuple[list[Any], list[Event]]:
    """Frames through all that looks at them; each arrives when it is stamped."""
    looking = Looking(run, fit, "h264")
    seen, events = [], []
    for frame in map(change, frames):
        one, named = looking.step(Stamped(frame, frame.t_s))
        looking.settle()
        seen.append(one)
        events += named
    return seen, events


def from_then_on(change: Callable[[Frame], np.ndarray]) -> Callable[[Frame], Frame]:
    return lambda frame: frame if frame.t_s < BEGINS_S else replace(frame, luma=change(frame))


# what is seen ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def clean(tow: tuple[Run, DatumFit, list[Frame]]) -> tuple[list[Any], list[Event]]:
    return fed(*tow)


def test_values_of_each_frame_are_the_truth_within_what_they_state(clean: Any, samples: Path) -> None:
    """z of the last 75 frames, whose errors a codec's lag relates over some 10 frames: sd about sqrt(1 / (2 * 7.5)) = 0.26."""
    truth = read_motion(samples / "mariner" / "x1446" / "truth" / "motion.csv")
    for name in ("y_cg_m", "beta_rad", "alpha_rad"):
        values = [getattr(seen, name) for seen in clean[0]]
        off = np.array([v.value for v in values]) - truth[name].to_numpy()[: len(values)]
        sd = np.array([np.hypot(v.sd, v.common_sd) for v in values])
        assert np.isfinite(off).all()
        assert np.sqrt(np.mean((off[60:] / sd[60:]) ** 2)) < 1 + 3 * 0.26, name


@pytest.mark.slow
def test_before_a_path_has_told_of_the_codec_values_state_enough_too(samples: Path) -> None:
    """z of the first 24 frames of four films, the errors of a film's frames as good as one: 1 with a standard deviation of
    sqrt(1 / (2 * 4)) = 0.35."""
    squares: dict[str, list[np.ndarray]] = {}
    for name in ("x1446", "x1548", "x1649", "x1751"):
        run = read_run(samples / "mariner" / name)
        truth = read_motion(run.folder / "truth" / "motion.csv")
        seen, _ = fed(run, fit_run_datum(run), list(read_frames(run.source_path, (0.0, 0.79))))
        for which in ("y_cg_m", "beta_rad", "alpha_rad"):
            values = [getattr(one, which) for one in seen]
            sd = np.array([np.hypot(v.sd, v.common_sd) for v in values])
            off = np.array([v.value for v in values]) - truth[which].to_numpy()[: len(values)]
            squares.setdefault(which, []).append((off / sd) ** 2)
    for which, of_films in squares.items():
        assert np.shape(of_films) == (4, 24)
        assert np.sqrt(np.mean(of_films)) < 1 + 0.35, which


def test_nothing_is_named_in_a_clean_tow(clean: Any) -> None:
    assert clean[1] == []


def test_when_it_settles_changes_no_value(tow: tuple[Run, DatumFit, list[Frame]], clean: Any) -> None:
    run, fit, frames = tow
    looking = Looking(run, fit, "h264")
    lazy = [looking.step(Stamped(frame, frame.t_s))[0] for frame in frames[:45]]
    assert [s.y_cg_m for s in lazy if s] == [s.y_cg_m for s in clean[0][:45]]


@pytest.mark.slow
def test_ready_says_what_is_in_order_and_what_is_not(tow: tuple[Run, DatumFit, list[Frame]]) -> None:
    run, fit, frames = tow

    def lines(change: Callable[[Frame], Frame], count: int = 31) -> dict[str, Any]:
        looking = Looking(run, fit, "h264")
        for frame in map(change, frames[:count]):
            looking.step(Stamped(frame, frame.t_s))
        return {line.what: line for line in looking.ready.lines(looking.arrivals)}

    good = lines(lambda frame: frame, 75)
    assert set(good) == {"bow", "stern", "precision", "datum", "camera", "line", "clock"}
    assert all(line.good for line in good.values())
    assert "30.00 frames/s" in good["clock"].words
    clipped = lines(lambda f: replace(f, luma=np.where(f.luma > 120, f.white_dn, f.luma).astype(np.uint8)))
    assert "clipped" in clipped["bow"].words
    assert not clipped["bow"].good
    assert "not known yet" in clipped["camera"].words  # 31 frames are too few to know it by
    without = lines(lambda f: replace(f, luma=covered(f.luma, "bow", f)))
    assert not without["bow"].good
    assert not without["precision"].good


# what is named --------------------------------------------------------------------------------------------------------


def covered(luma: np.ndarray, marker: str, frame: Frame) -> np.ndarray:
    import cv2
    import pandas as pd

    rows = TRUTH.setdefault("x1446", pd.read_csv(SAMPLE / "truth" / "tracks.csv", comment="#"))
    at = rows[(rows["marker"] == marker) & (rows["frame"] == frame.index)][["u_px", "v_px"]].iloc[0]
    picture = luma.copy()
    cv2.circle(picture, (round(at.iloc[0]), round(at.iloc[1])), 12, float(np.median(luma)), -1)
    return picture


TRUTH: dict[str, Any] = {}
SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446"


def within_time(events: list[Event], kind: str, begins_s: float = BEGINS_S) -> Event:
    [event] = [e for e in events if e.level != "good"]
    assert event.kind == kind
    assert begins_s <= event.t_s <= begins_s + NAMED_S
    return event


@pytest.mark.slow
def test_a_covered_mark_is_named(tow: tuple[Run, DatumFit, list[Frame]]) -> None:
    _, events = fed(*tow, from_then_on(lambda frame: covered(frame.luma, "stern", frame)))
    assert within_time(events, "mark").words.startswith("stern is lost")


@pytest.mark.slow
def test_a_nudged_camera_is_named_by_its_angle_and_not_as_a_slack_line(tow: tuple[Run, DatumFit, list[Frame]]) -> None:
    """3.2 px at 920 px of focal length are 0.2 degrees in the picture's middle; the line seems shorter by as much as that moves."""
    import cv2

    shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 3.2]])

    def moved(frame: Frame) -> np.ndarray:
        rows, columns = frame.luma.shape
        return np.asarray(cv2.warpAffine(frame.luma, shift, (columns, rows), borderMode=cv2.BORDER_REPLICATE))

    _, events = fed(*tow, from_then_on(moved))
    said = re.search(r"turned by ([\d.]+) \+-", within_time(events, "camera").words)
    assert said is not None
    assert float(said[1]) == pytest.approx(
        np.degrees(3.2 / 920), rel=0.1
    )  # the lens bends by 5 % at the picture's edge


def test_a_slack_line_and_a_near_wall_are_named_of_what_is_seen(
    tow: tuple[Run, DatumFit, list[Frame]], clean: Any
) -> None:
    from towline.live.watch import CameraWatch, LineWatch, WallWatch

    line, near = LineWatch(CameraWatch()), []
    for seen in clean[0]:
        slack = seen.slack_m
        if BEGINS_S <= seen.t_s < BEGINS_S + 1:
            slack = replace(slack, value=slack.value + 0.02 * np.sin(np.pi * (seen.t_s - BEGINS_S)))
        near += line.step(replace(seen, slack_m=slack))
    assert [e.level for e in near] == ["fault", "good"]
    assert BEGINS_S < near[0].t_s < BEGINS_S + NAMED_S

    run, _, _ = tow
    assert run.file.water is not None
    assert run.file.model is not None
    most = max(abs(s.y_cg_m.value) for s in clean[0])
    narrow = run.file.water.model_copy(
        update={"tank_width_m": 2 * (most + 0.19 + 0.04)}
    )  # 0.19 m: half its beam, Lpp / 14
    wall = WallWatch(Run(run.folder, run.file.model_copy(update={"water": narrow})), 0.05)
    named = [e for seen in clean[0] for e in wall.step(seen)]
    assert named[0].kind == "wall"
    assert named[0].words.endswith("(less than 50 mm)")
    assert [e for seen in clean[0] for e in WallWatch(run, 0.05).step(seen)] == []


def frames_at(times: list[float], arrived: list[float] | None = None, by_source: bool = True) -> Iterator[Arrival]:
    for t_s, here in zip(times, arrived or times, strict=True):
        yield Arrival(t_s, here, by_source)


def arrivals(frames: Iterator[Arrival]) -> tuple[ArrivalWatch, list[Event]]:
    watch = ArrivalWatch()
    return watch, [event for frame in frames for event in watch.step(frame)]


EVEN = [k / 30 for k in range(150)]


def test_even_frames_name_nothing_whoever_stamps_them() -> None:
    jitter = np.random.default_rng(3).uniform(0, 0.02, len(EVEN))
    assert arrivals(frames_at(EVEN, [t + j for t, j in zip(EVEN, jitter, strict=True)]))[1] == []
    late = [t + j for t, j in zip(EVEN, jitter, strict=True)]
    assert arrivals(frames_at(late, late, by_source=False))[1] == []


def test_missing_frames_are_counted_and_a_stepping_clock_is_told_from_them() -> None:
    gone = [t for k, t in enumerate(EVEN) if k not in (70, 71, 72)]
    watch, events = arrivals(frames_at(gone))
    assert (watch.missing, [e.kind for e in events]) == (3, ["missing"])
    assert events[0].words.startswith("3 frames are missing")
    stepped = [t + (0.4 if k >= 70 else 0.0) for k, t in enumerate(EVEN)]
    watch, events = arrivals(frames_at(stepped, EVEN))
    assert (watch.missing, [e.kind for e in events]) == (0, ["clock"])
    assert "+0.400 s" in events[0].words
    uneven = [t + (0.012 if k == 70 else 0.0) for k, t in enumerate(EVEN)]
    assert [e.kind for e in arrivals(frames_at(uneven))[1]] == ["clock"]


def test_a_source_that_stops_comes_back_and_is_slow_is_named() -> None:
    watch, events = arrivals(frames_at(EVEN))
    assert list(watch.tick(EVEN[-1] + 0.3)) == []
    [stopped] = watch.tick(EVEN[-1] + 0.7)
    assert (stopped.kind, stopped.level) == ("source", "fault")
    assert list(watch.tick(EVEN[-1] + 1.0)) == []
    back = EVEN[-1] + 5.0
    [event] = [e for f in frames_at([back]) for e in watch.step(f)]
    assert "back after 5.0 s" in event.words
    slow = [*EVEN, *(EVEN[-1] + k / 15 for k in range(1, 60))]
    events = arrivals(frames_at([k / 30 for k in range(len(slow))], slow))[1]
    assert [e.kind for e in events] == ["source"]
    assert "15." in events[0].words or "slow" in events[0].words
    assert slow[149] < slow[round(events[0].t_s * 30)] < slow[149] + NAMED_S


def test_what_lasts_is_named_once_and_once_when_it_is_over() -> None:
    lasting = Lasting(0.5)
    said = [(t / 10, lasting.step(t / 10, 10 <= t < 30 or t == 3)) for t in range(60)]
    assert [(t, s) for t, s in said if s is not None] == [(1.5, True), (3.5, False)]


# what is recorded -----------------------------------------------------------------------------------------------------


def heard(source: str, folder: Path, seconds: float = 60.0) -> tuple[Recorder, list[Stamped], Any]:
    """A source, to its end or for some seconds: what was recorded, the frames, how it ended."""
    folder.mkdir()
    recorder = Recorder(folder)
    hearing = Hearing(source, recorder.take)
    hearing.start()
    frames: list[Stamped] = []
    decoding, until = None, time.monotonic() + seconds
    while True:
        if time.monotonic() > until:
            hearing.stop()
        try:
            piece, times = hearing.pieces.get(timeout=0.1)
        except queue.Empty:
            continue
        if isinstance(piece, Ended):
            hearing.join()
            return recorder, frames, piece
        if isinstance(piece, Opened):
            decoding = decoding or Decoding(piece)
            if piece.again:
                decoding.again(piece)
        else:
            assert decoding is not None
            assert times is not None
            frames += decoding.step(piece, times.t_s)


def test_what_a_source_is() -> None:
    assert [kind_of(s) for s in ("0", "/dev/video1", "rtsp://x/y", "udp://0.0.0.0:5", "tow.mp4")] == [
        "camera",
        "camera",
        "stream",
        "stream",
        "file",
    ]


def test_a_film_at_its_own_rate_is_recorded_as_it_is(tmp_path: Path) -> None:
    """Forty pictures that carry their number, at 80 a second: half a second; frame by frame the same as in the recording."""
    source = film(tmp_path / "film.mp4", range(40), Fraction(1, 80), Fraction(80))
    recorder, frames, ended = heard(str(source), tmp_path / "run")
    assert (ended.error, recorder.packets, recorder.name) == ("", 40, "film.ts")
    assert [number_of(s.frame.luma) for s in frames] == list(range(40))
    there = list(read_frames(tmp_path / "run" / recorder.name))
    original = list(read_frames(source))
    for live, now, before in zip(frames, there, original, strict=True):
        assert np.array_equal(live.frame.luma, now.luma)
        assert np.array_equal(now.luma, before.luma)
        assert live.frame.t_s == pytest.approx(now.t_s, abs=float(ARRIVAL_BASE))
        assert now.t_s == pytest.approx(before.t_s, abs=float(ARRIVAL_BASE))
    steps = [b.arrived_s - a.arrived_s for a, b in pairwise(frames)]
    assert sum(steps) > 39 / 80 - 0.01  # not before their time


def test_a_camera_is_recorded_without_loss(tmp_path: Path) -> None:
    """OpenCV opens a film as it opens a camera; the pictures, stamped on arrival, are those that it gave."""
    source = film(tmp_path / "film.mp4", range(20), Fraction(1, 30))
    recorder = Recorder(tmp_path)
    frames: list[Stamped] = []
    decoding = None
    for piece in camera_pieces(str(source), threading.Event()):
        times = recorder.take(piece)
        if isinstance(piece, Opened):
            decoding = Decoding(piece)
        elif decoding is not None and isinstance(piece, Packet) and times is not None:
            frames += decoding.step(piece, times.t_s)
    recorder.close()
    there = list(read_frames(tmp_path / "film.mkv"))
    assert [number_of(f.luma) for f in there] == list(range(20))
    assert not any(f.damaged for f in there)
    for live, now in zip(frames, there, strict=True):
        assert np.array_equal(live.frame.luma, now.luma)
        assert live.frame.t_s == pytest.approx(now.t_s, abs=1e-3)
        assert not live.by_source


def test_a_clock_that_begins_anew_goes_on_and_gaps_stay_as_long_as_they_were() -> None:
    clock, step = OneClock(), Fraction(1, 30)

    def at(number: int, arrived_s: float) -> float:
        return clock.step(Packet(b"", number, number, step, True, False, arrived_s)).t_s

    assert [at(900 + k, k / 30) for k in range(3)] == pytest.approx([0, 1 / 30, 2 / 30], abs=1e-4)
    clock.opened_again()
    assert at(900 + 150, 150 / 30) == pytest.approx(5.0, abs=1e-4)  # the same clock went on
    assert clock.begun_anew == 0
    clock.opened_again()
    assert at(7, 151 / 30 + 4) == pytest.approx(151 / 30 + 4, abs=1e-3)
    assert at(8, 152 / 30 + 4) == pytest.approx(152 / 30 + 4, abs=1e-3)
    assert clock.begun_anew == 1
    assert at(2, 153 / 30 + 4) > 152 / 30 + 4  # it fell without a word


@pytest.mark.slow
def test_mjpeg_over_http_is_heard_cut_and_back(live_senders: ModuleType, tmp_path: Path) -> None:
    """Numbered pictures, 30 a second; the line is cut from 0.5 s on and back at 1.2 s: what was sent is there, the gap as well."""
    import cv2

    pictures = [cv2.imencode(".jpg", drawn(k)[:96], [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes() for k in range(60)]
    sent: list[int] = []
    server = live_senders.serve_jpegs(pictures, 30.0, 0, 2.0, sent.append, ((0.5, 1.2),))
    recorder, frames, _ = heard(f"http://127.0.0.1:{server.server_port}/", tmp_path / "run", 2.6)
    server.shutdown()
    assert [number_of(s.frame.luma) for s in frames] == sent
    assert len(sent) == recorder.packets
    assert not any(s.by_source or s.frame.damaged for s in frames)
    there = list(read_frames(tmp_path / "run" / recorder.name))
    assert [number_of(f.luma) for f in there] == sent
    assert not any(f.damaged for f in there)
    gap = max(b.frame.t_s - a.frame.t_s for a, b in pairwise(frames))
    assert 0.6 < gap < 1.5


def test_a_source_that_does_not_answer_is_one_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towline.live.source.OPEN_S", 0.3)
    _, frames, ended = heard("http://127.0.0.1:9/", tmp_path / "run")
    assert frames == []
    assert ended.error.startswith("http://127.0.0.1:9/: does not answer")


# the command ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def day(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some seconds of a sample film, filmed live."""
    scratch = tmp_path_factory.mktemp("live")
    setup = samples / "mariner" / "x1446"
    short = remux(setup / "video.mp4", scratch / "short.mp4", lambda index, _: index < 130)
    assert main(["live", str(short), str(scratch / "day"), "--like", str(setup), "--no-fit"]) == 0
    return scratch / "day"


@pytest.mark.slow
def test_a_live_tow_is_an_ordinary_run(day: Path, tmp_path: Path) -> None:
    run = read_run(day / "tow-01")
    assert run.file.source.video == "film.ts"
    assert run.file.marker == read_run(SAMPLE).file.marker
    log = [json.loads(line) for line in (run.out / "live.jsonl").read_text().splitlines()]
    frames = [r for r in log if "frame" in r]
    at = np.array([r["frame"] for r in frames])  # on a busy machine some may be passed by
    assert (np.diff(at) > 0).all()
    assert {r["ready"] for r in log if "ready" in r} >= {
        "bow",
        "stern",
        "precision",
        "datum",
        "camera",
        "line",
        "clock",
    }
    assert main(["motion", str(run.folder)]) == 0
    later = read_motion(run.out / "motion.csv")
    assert len(later) == 130
    live = np.array([r["y_cg_m"][:2] for r in frames])
    off = ((live[:, 0] - later["y_cg_m"].to_numpy()[at]) / live[:, 1])[at >= 30]
    assert np.sqrt(np.mean(off**2)) < 1.0  # of the same pixels: no further off than what it states


@pytest.mark.slow
def test_tracks_made_while_the_film_grows_are_those_of_track(day: Path, tmp_path: Path) -> None:
    """The recording appears piece by piece while it is tracked; the table is the same to the byte."""
    import shutil

    from towline.pipeline.stages.tracks import track_growing

    whole = (day / "tow-01" / "film.ts").read_bytes()
    folder = tmp_path / "tow"
    folder.mkdir()
    shutil.copy(day / "tow-01" / "run.toml", folder)
    first = len(whole) // 2
    (folder / "film.ts").write_bytes(whole[:first])
    done = threading.Event()

    def grow() -> None:
        with (folder / "film.ts").open("ab") as target:
            for at in range(first, len(whole), 40_000):
                time.sleep(0.02)
                target.write(whole[at : at + 40_000])
                target.flush()
        done.set()

    thread = threading.Thread(target=grow)
    thread.start()
    track_growing(read_run(folder), done.is_set)
    thread.join()
    growing = (folder / "out" / "tracks.csv").read_bytes()
    assert main(["track", str(folder), "--fresh", "--no-overlay"]) == 0
    assert (folder / "out" / "tracks.csv").read_bytes() == growing


def test_folders_are_numbered_on_and_hold_what_the_setup_names(samples: Path, tmp_path: Path) -> None:
    setup = read_run(samples / "mariner" / "x1446")
    assert next_of(tmp_path).name == "tow-01"
    made = make_folder(setup, next_of(tmp_path), "film.ts")
    assert made.file.name == "mariner-x1446 tow-01"
    assert [p.name for p in tows_of(tmp_path)] == ["tow-01"]
    assert next_of(tmp_path).name == "tow-02"
    assert "# " in (setup.folder / "run.toml").read_text() or made.file.datum == setup.file.datum


def test_bad_set_ups_are_one_line(
    samples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], run_folder: Path
) -> None:
    video = str(samples / "mariner" / "x1446" / "video.mp4")
    text = (run_folder / "run.toml").read_text()
    (run_folder / "run.toml").write_text(text.replace("image_size_px = [800, 600]", "image_size_px = [1280, 720]"))
    assert main(["live", video, str(tmp_path / "day"), "--like", str(run_folder)]) == 1
    assert "the source's picture is 800 x 600" in capsys.readouterr().err
    assert not (tmp_path / "day").exists()
    assert main(["live", str(tmp_path / "none.mp4"), str(tmp_path / "day"), "--like", str(SAMPLE)]) == 1
    assert "none.mp4: no such file" in capsys.readouterr().err


def test_a_template_cannot_be_followed_live(tow: tuple[Run, DatumFit, list[Frame]]) -> None:
    run, fit, _ = tow
    marker = run.file.marker[0].model_copy(update={"look": "template", "seen_at_px": (100.0, 100.0)})
    other = Run(run.folder, run.file.model_copy(update={"marker": (marker, run.file.marker[1])}))
    with pytest.raises(InputError, match="cannot be followed live"):
        Looking(other, fit, "h264")
