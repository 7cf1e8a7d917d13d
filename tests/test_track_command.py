"""`towline track` around the tracker: overlay, contact sheet, progress, what is done again and what is said."""

from __future__ import annotations

import io
import re
import shutil
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from towline.cli import main
from towline.pipeline import stages
from towline.pipeline.progress import PlainLines, Rate, throttled
from towline.record import VideoError, read_run, read_tracks
from towline.vision import Frame, read_frames
from towline.vision.overlay import COLOURS, plain, write_overlay
from towline.vision.sheet import APART_S, CROP_PX, SCALE, Pick, Sheet, draw_sheet, worst_frames, write_sheet

SPAN_S = (2.0, 3.5)
FRAMES = 46


def short_run(samples: Path, folder: Path) -> Path:
    """A second and a half of a sample, to write into."""
    shutil.copytree(samples / "mariner" / "x1446", folder, ignore=shutil.ignore_patterns("out"))
    text = (folder / "run.toml").read_text()
    old = 'video = "video.mp4"'
    assert old in text
    (folder / "run.toml").write_text(text.replace(old, f"{old}\nspan_s = {list(SPAN_S)}"))
    return folder


@pytest.fixture(scope="module")
def followed(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was tracked and drawn."""
    run = short_run(samples, tmp_path_factory.mktemp("followed") / "run")
    assert main(["track", str(run)]) == 0
    return run


@pytest.fixture
def copy(followed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(followed, tmp_path / "run", copy_function=shutil.copy2))


def no_tracking(*_: object, **__: object) -> None:
    raise AssertionError("tracked again")


# overlay --------------------------------------------------------------------------------------------------------------


def test_the_overlay_has_the_frames_and_times_that_were_tracked(followed: Path) -> None:
    tracks = read_tracks(followed / "out" / "tracks.csv")
    times = np.array([frame.t_s for frame in read_frames(followed / "out" / "overlay.mp4")])
    assert len(times) == tracks["frame"].nunique() == FRAMES
    np.testing.assert_allclose(times, np.unique(tracks["t_s"]) - SPAN_S[0], atol=1e-4)
    assert not list((followed / "out").glob(".*"))


def test_the_overlay_shows_a_circle_at_each_mark_and_not_at_a_lost_one(followed: Path, tmp_path: Path) -> None:
    run = read_run(followed)
    table = read_tracks(run.out / "tracks.csv")
    gone = (table["marker"] == "stern") & (table["frame"] == table["frame"].max())
    table.loc[gone, ["u_px", "v_px"]] = np.nan
    table.loc[gone, "status"] = "lost"
    counts: list[int] = []
    path = tmp_path / "o.mp4"
    written = write_overlay(path, read_frames(run.source_path, SPAN_S), table, (), 30.0, counts.append)
    assert written == FRAMES
    assert counts == list(range(1, FRAMES + 1))
    plain_frames = list(read_frames(run.source_path, SPAN_S))
    last = list(read_frames(path))[-1]
    rows = read_tracks(run.out / "tracks.csv").set_index(["frame", "marker"]).loc[plain_frames[-1].index]
    changed = {name: ring_change(last, plain_frames[-1], rows.loc[name]) for name in ("bow", "stern")}
    assert changed["bow"] > 25
    assert changed["stern"] < 8  # what is left is the codec


def ring_change(drawn: Frame, bare: Frame, row: pd.Series) -> float:
    """Mean change on the circle that the overlay draws, 9 px about a place."""
    turn = np.linspace(0, 2 * np.pi, 60)
    u, v = (np.rint(row[c] + 9 * f(turn)).astype(int) for c, f in (("u_px", np.cos), ("v_px", np.sin)))
    return float(np.abs(drawn.bgr()[v, u].astype(float) - bare.bgr()[v, u]).mean())


def test_an_overlay_is_whole_or_absent(followed: Path, tmp_path: Path) -> None:
    run = read_run(followed)
    table = read_tracks(run.out / "tracks.csv")

    def broken():
        yield from list(read_frames(run.source_path, SPAN_S))[:3]
        raise VideoError("torn")

    with pytest.raises(VideoError, match="torn"):
        write_overlay(tmp_path / "o.mp4", broken(), table, (), 30.0)
    with pytest.raises(VideoError, match="no frame"):
        write_overlay(tmp_path / "o.mp4", [], table, (), 30.0)
    assert not list(tmp_path.iterdir())


def test_text_that_the_letters_lack_is_said_without_accents() -> None:
    assert plain("Bücker β") == "Bucker ?"


# what is done again -----------------------------------------------------------------------------------------------------


def test_an_overlay_wanted_later_does_not_track_again(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = copy / "out"
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert set(before) == {"tracks.csv", "overlay.mp4", "worst.png"}
    monkeypatch.setattr("towline.vision.track", no_tracking)
    assert main(["track", str(copy)]) == 0
    assert {path.name: path.stat().st_mtime_ns for path in out.iterdir()} == before  # nothing is drawn again either
    said = capsys.readouterr().out
    assert "up to date: " in said
    assert "wrote" not in said
    (out / "overlay.mp4").unlink()
    assert main(["track", str(copy)]) == 0
    assert f"wrote {out / 'overlay.mp4'}\n" in capsys.readouterr().out
    assert (out / "tracks.csv").stat().st_mtime_ns == before["tracks.csv"]
    assert len(list(read_frames(out / "overlay.mp4"))) == FRAMES
    with pytest.raises(AssertionError, match="tracked again"):
        main(["track", str(copy), "--fresh"])


def test_a_drawing_older_than_its_tracks_is_drawn_again(copy: Path) -> None:
    import os

    sheet = copy / "out" / "worst.png"
    tracks_ns = (copy / "out" / "tracks.csv").stat().st_mtime_ns
    os.utime(sheet, ns=(tracks_ns - 1, tracks_ns - 1))
    assert main(["track", str(copy), "--no-overlay", "--sheet"]) == 0
    assert sheet.stat().st_mtime_ns > tracks_ns


def test_without_an_overlay_there_is_a_sheet_only_where_asked(samples: Path, tmp_path: Path) -> None:
    run = short_run(samples, tmp_path / "run")
    assert main(["track", str(run), "--no-overlay"]) == 0
    assert [path.name for path in (run / "out").iterdir()] == ["tracks.csv"]
    assert main(["track", str(run), "--no-overlay", "--sheet"]) == 0
    assert {path.name for path in (run / "out").iterdir()} == {"tracks.csv", "worst.png"}


def test_tracks_read_back_are_those_that_were_found(copy: Path) -> None:
    run = read_run(copy)
    found = stages.track_run(run, fresh=True)
    again = stages.track_run(run)
    assert found.anew
    assert not again.anew
    pd.testing.assert_frame_equal(
        found.table.drop(columns="reason"), again.table.drop(columns="reason"), check_dtype=False, rtol=1e-9
    )


def test_a_run_toml_edited_while_it_is_tracked_does_not_vouch_for_the_tracks(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from towline.vision import track

    def slow(*arguments, **options):
        found = track(*arguments, **options)
        (copy / "run.toml").write_text((copy / "run.toml").read_text() + "\n# edited\n")
        return found

    monkeypatch.setattr("towline.vision.track", slow)
    stages.track_run(read_run(copy), fresh=True)
    monkeypatch.undo()
    assert stages.track_run(read_run(copy)).anew


@pytest.mark.once
@pytest.mark.parametrize(
    ("codec", "lossy", "linked"),
    [
        ("h264", True, True),
        ("hevc", True, True),
        ("mjpeg", True, False),
        ("ffv1", False, False),
        ("rawvideo", False, False),
    ],
)
def test_the_tracker_is_told_what_the_codec_does(
    copy: Path, monkeypatch: pytest.MonkeyPatch, codec: str, lossy: bool, linked: bool
) -> None:
    """Whether it keeps every pixel, and whether its pictures are made from others; the tracks then say how far a mark may lag."""
    from dataclasses import replace

    from towline.vision import clip_info, track

    told: list[tuple[bool, bool]] = []

    def spy(run, frames, mapping, progress, backend, lossy, linked, *more):
        told.append((lossy, linked))
        return track(run, frames, mapping, progress, backend, lossy, linked, *more)

    monkeypatch.setattr("towline.vision.track", spy)
    monkeypatch.setattr("towline.vision.clip_info", lambda path: replace(clip_info(path), codec=codec))
    table = stages.track_run(read_run(copy), fresh=True).table
    assert told == [(lossy, linked)]
    assert ("sigma_lag_px" in table) == linked
    if linked:
        ratio = table["sigma_lag_px"] / table[["sigma_u_px", "sigma_v_px"]].mean(axis=1).groupby(
            table["marker"]
        ).transform("median")
        assert ratio.between(0.5, 1.5).all()


# what is said -----------------------------------------------------------------------------------------------------------


def test_losses_are_summed_up_by_reason() -> None:
    from towline.cli.track import markers_in_words

    table = hand_made({"bow": {3: "covered", 4: "covered", 9: "brightness"}, "stern": {}}, frames=30)
    assert markers_in_words(table) == (
        "bow measured in 90.00 % of 30 frames (sigma 0.025 px); lost: 2 covered, 1 brightness; "
        "stern measured in 100.00 % of 30 frames (sigma 0.025 px)"
    )
    assert "lost" not in markers_in_words(table.drop(columns="reason"))
    table["reason"] = np.nan
    assert "lost: 3 no reason given" in markers_in_words(table)


def test_an_ambiguous_start_is_said_with_its_remedy(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    from towline.vision import track

    monkeypatch.setattr("towline.vision.track", lambda *a, **k: replace(track(*a, **k), ambiguous=True))
    assert main(["track", str(copy), "--no-overlay", "--fresh"]) == 0
    assert re.search(r"^note: .*marker\.seen_at_px", capsys.readouterr().out, re.MULTILINE)


def test_a_device_that_is_not_there_is_one_line(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        import torch

        if torch.cuda.is_available():
            pytest.skip("there is a CUDA device here")
    except ImportError:
        pass
    before = (copy / "out" / "tracks.csv").stat().st_mtime_ns
    assert main(["track", str(copy), "--device", "cuda", "--fresh"]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("towline: error: --device: cuda")
    assert (copy / "out" / "tracks.csv").stat().st_mtime_ns == before
    with pytest.raises(SystemExit) as caught:
        main(["track", str(copy), "--device", "abacus"])
    assert caught.value.code == 2


def test_follow_says_lines_where_there_is_no_terminal(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["track", str(copy), "--no-overlay", "--fresh", "--follow"]) == 0
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines
    pattern = r"mariner-x1446: tracking, 0 lost, frame \d+ of 4\d, \d+ frames/s(, \d+ s left)?"
    assert all(re.fullmatch(pattern, line) for line in lines), lines
    assert f"frame {FRAMES} of {FRAMES}" in lines[-1]
    assert main(["track", str(copy), "--no-overlay", "--fresh"]) == 0
    assert capsys.readouterr().err == ""


def test_plain_lines_come_once_a_second_and_at_the_end_of_each_stage() -> None:
    stream, now = io.StringIO(), [0.0]
    lines = PlainLines(stream, clock=lambda: now[0])
    for step in range(36):  # tenths of a second at 200 frames/s
        now[0] = step / 10
        lines.show("run: tracking, 1 lost", 20 * step, 1000)
    lines.show("run: drawing", 0, 1000)
    now[0] += 0.1
    lines.show("run: drawing", 5, 1000)
    lines.finish()
    lines.finish()
    said = stream.getvalue().splitlines()
    assert [re.sub(r", \d+ s left", "", line) for line in said] == [
        "run: tracking, 1 lost, frame 200 of 1000, 200 frames/s",
        "run: tracking, 1 lost, frame 400 of 1000, 200 frames/s",
        "run: tracking, 1 lost, frame 600 of 1000, 200 frames/s",
        "run: tracking, 1 lost, frame 700 of 1000, 200 frames/s",
        "run: drawing, frame 5 of 1000, 50 frames/s",
    ]
    assert said[0].endswith(", 4 s left")


def test_the_rate_follows_the_last_seconds() -> None:
    rate = Rate(over_s=2.0)
    done = 0
    for second in range(10):
        done += 100 if second < 5 else 20
        hertz = rate.at(float(second), done)
    assert hertz == pytest.approx(20)
    assert rate.at(11.0, 3) is None  # something else has begun


def test_progress_is_throttled_and_costs_next_to_nothing() -> None:
    """Tracking takes 2 to 3 ms a frame; a call between two reports may take 2 us."""
    calls: list[tuple[int, int]] = []
    tell = throttled(lambda done, lost: calls.append((done, lost)), every_s=0.05)
    times = []
    for _ in range(5):
        begin_s = time.perf_counter()
        for k in range(20_000):
            tell(k, 0)
        times.append((time.perf_counter() - begin_s) / 20_000)
    spent_s = sum(times) * 20_000
    assert min(times) < 2e-6
    assert len(calls) <= spent_s / 0.05 + 1
    time.sleep(0.06)
    tell(7, 3)
    assert calls[-1] == (7, 3)


def test_without_a_terminal_rich_is_not_loaded(copy: Path) -> None:
    import subprocess

    code = "import sys, towline.cli; sys.exit(towline.cli.main(sys.argv[1:]) or 'rich' in sys.modules)"
    arguments = ["track", str(copy), "--no-overlay", "--follow"]
    assert subprocess.run([sys.executable, "-c", code, *arguments], check=False, capture_output=True).returncode == 0


# which frames the sheet shows -------------------------------------------------------------------------------------------


def hand_made(lost: dict[str, dict[int, str]], frames: int = 300, rate_hz: float = 30.0) -> pd.DataFrame:
    """Tracks of marks that move 1 px a frame with a sigma of 0.03 px; ``lost``: marker -> frame -> reason."""
    rows = []
    for k in range(frames):
        for n, (name, gone) in enumerate(lost.items()):
            reason = gone.get(k, "")
            place = (np.nan,) * 4 if k in gone else (100.0 + k, 50.0 + 100 * n, 0.03, 0.02)
            rows.append((k, k / rate_hz, name, *place, "lost" if k in gone else "measured", reason))
    names = ["frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status", "reason"]
    return pd.DataFrame(rows, columns=pd.Index(names))


def spell(first: int, last: int, reason: str) -> dict[int, str]:
    return dict.fromkeys(range(first, last + 1), reason)


def test_losses_come_first_by_both_ends_of_each() -> None:
    table = hand_made({"bow": spell(50, 79, "covered") | {80: "brightness"}, "stern": spell(200, 201, "jumped")})
    picks = worst_frames(table, 5)
    assert [(p.frame, p.marker, p.lost) for p in picks[:4]] == [
        (50, "bow", "covered"),
        (79, "bow", "covered"),
        (80, "bow", "brightness"),
        (200, "stern", "jumped"),
    ]  # 201 stands 1/30 s from 200: it tells the same
    assert picks[0].verdict == "lost: covered"
    assert picks[0].place_px == pytest.approx((150.0, 50.0))  # between frames 49 and 81
    assert picks[4].lost is None


def test_the_longest_losses_are_shown_when_there_is_no_room_for_all() -> None:
    gone: dict[int, str] = {}
    for k in range(10):  # of 1 to 10 frames
        gone |= spell(30 * k, 30 * k + k, "covered")
    picks = worst_frames(hand_made({"bow": gone}), 4)
    assert [p.frame for p in picks] == [180, 210, 240, 270]
    everything = worst_frames(hand_made({"bow": gone}), 12)
    assert sum(p.lost is not None for p in everything) == 10
    assert sum(p.lost is None for p in everything) == 2


def test_a_mark_not_found_yet_is_shown_just_before_it_is_found() -> None:
    picks = worst_frames(hand_made({"bow": spell(0, 99, "not found yet"), "stern": {}}), 1)
    assert (picks[0].frame, picks[0].place_px) == (99, (200.0, 50.0))
    never = worst_frames(hand_made({"bow": spell(0, 299, "not found yet"), "stern": {}}), 1)
    assert never[0].place_px is None


def test_then_the_largest_sigmas_apart_in_time() -> None:
    table = hand_made({"bow": {}, "stern": {}})
    bow = table["marker"] == "bow"
    for frame, sigma in ((100, 0.21), (101, 0.20), (130, 0.12), (250, 0.09)):
        table.loc[bow & (table["frame"] == frame), "sigma_v_px"] = sigma
    table.loc[~bow & (table["frame"] == 100), "sigma_u_px"] = 0.15
    picks = worst_frames(table, 6)
    assert [(p.frame, p.marker) for p in picks[:4]] == [(100, "bow"), (100, "stern"), (130, "bow"), (250, "bow")]
    assert picks[0].verdict == "sigma 0.21 px (7.0 x usual)"
    assert picks[0].ratio == pytest.approx(7)
    for marker in ("bow", "stern"):
        times = sorted(p.t_s for p in picks if p.marker == marker)
        assert all(np.diff(times) >= APART_S)
    assert all(p.ratio == pytest.approx(1) for p in picks[4:])  # ordinary ones fill the sheet


def test_tracks_from_elsewhere_need_no_sigma_and_no_reason() -> None:
    table = hand_made({"bow": spell(10, 40, "")}).drop(columns="reason")
    table[["sigma_u_px", "sigma_v_px"]] = np.nan
    assert [(p.frame, p.verdict) for p in worst_frames(table)] == [(10, "lost"), (40, "lost")]
    assert worst_frames(hand_made({"bow": {}}).assign(sigma_u_px=np.nan, sigma_v_px=np.nan)) == []


# the sheet itself -------------------------------------------------------------------------------------------------------


class Picture:
    """Stands in for the decoder's frame."""

    rotation = 0

    def __init__(self, picture: np.ndarray) -> None:
        self._picture = picture

    def to_ndarray(self, format: str) -> np.ndarray:
        assert format == "bgr24"
        return self._picture.copy()


def picture_frames(count: int):
    """Black pictures of 320 x 240 with one white pixel at (100 + index, 50)."""
    for index in range(count):
        picture = np.zeros((240, 320, 3), np.uint8)
        picture[50, 100 + index] = 255
        yield Frame(index, index / 30, picture[:, :, 0], Picture(picture))


def tiles_of(sheet: np.ndarray) -> np.ndarray:
    """The first tile."""
    top, left = 40, 12
    return sheet[top : top + CROP_PX[1] * SCALE, left : left + CROP_PX[0] * SCALE]


def has_the_marker_colour(tile: np.ndarray) -> bool:
    """Smoothed lines come near it."""
    return bool((np.abs(tile - np.array(COLOURS[0], dtype=float)) < 40).all(axis=2).sum() > 20)


def test_a_tile_magnifies_the_surroundings_of_its_mark() -> None:
    table = hand_made({"bow": {}}, frames=60)
    pick = Pick(40, 40 / 30, "bow", None, (140.0, 50.0), (0.03, 0.02), 1.0)
    tile = tiles_of(draw_sheet(picture_frames(60), table, [pick]))
    u, v = (size // 2 * SCALE for size in CROP_PX)
    inside, outside = (0, SCALE - 1), (-1, SCALE)  # the white pixel's corners, clear of the cross, are sharp
    assert all((tile[v + dv, u + du] == 255).all() for dv in inside for du in inside)
    assert all((tile[v + dv, u + du] == 0).all() for dv in outside for du in outside)
    assert has_the_marker_colour(tile)
    large = Pick(40, 40 / 30, "bow", None, (140.0, 50.0), (2.0, 1.0), 66.0)
    assert (tiles_of(draw_sheet(picture_frames(60), table, [large])) != tile).any()  # 3 sigma are seen


def test_a_lost_mark_is_not_drawn_as_measured() -> None:
    table = hand_made({"bow": {40: "covered"}}, frames=60)
    (pick,) = worst_frames(table, 1)
    tile = tiles_of(draw_sheet(picture_frames(60), table, [pick]))
    assert not has_the_marker_colour(tile)


def test_the_sheet_reads_no_further_than_it_must_and_says_what_it_lacks(tmp_path: Path) -> None:
    table = hand_made({"bow": {}}, frames=60)
    picks = [Pick(k, k / 30, "bow", None, (100.0 + k, 50.0), (0.03, 0.02), 1.0) for k in (3, 5)]
    sheet = Sheet(table, picks)
    assert [sheet.look(frame) for frame in picture_frames(7)] == [False] * 5 + [True] * 2
    unread = draw_sheet([], table, picks)
    assert unread.shape == sheet.picture().shape
    assert draw_sheet([], table, []).ndim == 3
    write_sheet(tmp_path / "worst.png", unread)
    assert (tmp_path / "worst.png").read_bytes().startswith(b"\x89PNG")


def test_marks_at_and_beyond_the_edge_have_a_tile() -> None:
    table = hand_made({"bow": {}}, frames=2)
    for place in ((0.0, 0.0), (319.0, 239.0), (5000.0, -5000.0)):
        pick = Pick(1, 1 / 30, "bow", None, place, (0.1, 0.1), 1.0)
        assert draw_sheet(picture_frames(2), table, [pick]).any()
    never = Pick(1, 1 / 30, "bow", "not found yet", None)
    assert draw_sheet(picture_frames(2), table, [never]).any()
