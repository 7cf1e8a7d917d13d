"""The commands as a user types them: what they write, what they say, how they fail."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

from towline.cli import main
from towline.record import DerivativesFile, SteadyFile, read_motion, read_result, read_tracks

BARS = {"y_cg_m": 1e-3, "beta_deg": 0.1, "alpha_deg": 0.1}
"""The issue's: y_CG below 1 mm, beta and alpha below 0.1 degrees, root mean square."""


def copied(source: Path, target: Path) -> Path:
    """A run without its scenario's outputs, to write into."""
    shutil.copytree(source, target, ignore=shutil.ignore_patterns("out"))
    return target


@pytest.fixture(scope="module")
def mariner(worked: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Four runs that are tracked already, from their videos, in another folder."""
    folder, names = tmp_path_factory.mktemp("mariner é"), ("x1446", "x1548", "x1649", "x1751")
    return [Path(shutil.copytree(worked / "sample_videos" / "mariner" / name, folder / name)) for name in names]


def test_four_videos_become_six_derivatives(mariner: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    """From video: each derivative within 3 of its own standard deviations of the truth, none worse than 5 %."""
    from towline.diagnose import motion_error

    assert main(["run", *map(str, mariner)]) == 0
    out = mariner[0].parent / "out"
    result = read_result(out / "derivatives.json", DerivativesFile)
    assert len(result.derivatives) == 6
    for name, d in result.derivatives.items():
        assert d.true_value is not None
        assert abs(d.value - d.true_value) < 3 * d.std, name
        assert abs(d.value / d.true_value - 1) < 0.05, name
        assert 0 < d.std < 0.05 * abs(d.value), name
    assert not result.failed
    assert not result.straight_line_stable  # X_v 0.9175 > X_r 0.8684
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "mariner-x1446" in page
    said = capsys.readouterr().out
    assert str(out / "report.html") in said
    for run in mariner:
        error = motion_error(read_motion(run / "out" / "motion.csv"), read_motion(run / "truth" / "motion.csv"))
        assert error.samples == 1200
        for name, bar in BARS.items():
            assert getattr(error, name) < bar, (run.name, name)
        assert set(read_tracks(run / "out" / "tracks.csv")["marker"]) == {"bow", "stern"}
        marks = pd.read_csv(run / "out" / "marks.csv", comment="#")
        assert list(marks.columns) == ["t_s", "marker", "x_m", "y_m", "sigma_x_m", "sigma_y_m", "status"]


@pytest.mark.slow
def test_what_is_up_to_date_is_not_done_again(mariner: list[Path]) -> None:
    run = mariner[0]
    assert main(["motion", str(run)]) == 0
    before = (run / "out" / "tracks.csv").stat().st_mtime_ns
    assert main(["motion", str(run)]) == 0
    assert (run / "out" / "tracks.csv").stat().st_mtime_ns == before
    motion = (run / "out" / "motion.csv").read_bytes()
    assert main(["motion", str(run), "--method", "trapezoid"]) == 0
    assert (run / "out" / "motion.csv").read_bytes() != motion
    camera = json.loads((run / "out" / "camera.json").read_text())
    assert camera["schema"] == "towline/camera"
    assert camera["method"] == "trapezoid"
    assert main(["motion", str(run)]) == 0
    assert (run / "out" / "motion.csv").read_bytes() == motion
    (run / "run.toml").write_text((run / "run.toml").read_text().replace("depth_m = 0.13", "depth_m = 0.14"))
    assert main(["motion", str(run)]) == 0
    assert (run / "out" / "motion.csv").read_bytes() != motion


@pytest.mark.slow
def test_steady_videos_give_the_neutral_point_back(samples: Path, tmp_path: Path) -> None:
    runs = [copied(samples / "leander_steady" / name, tmp_path / name) for name in ("hole6", "hole5", "hole4", "hole3")]
    assert main(["run", *map(str, runs)]) == 0
    result = read_result(tmp_path / "out" / "steady.json", SteadyFile)
    low, high = result.x_v_interval_m
    assert low < 0.219 < high
    assert high - low < 0.05  # X_vv of a drifting hull is known as usual only: 2 to 4 % of F in these tows
    assert result.force_unit == "N"
    assert len(result.pairs) == 6
    assert all(tow.settled for tow in result.tows.values())
    six = read_result(tmp_path / "out" / "derivatives.json", DerivativesFile).derivatives  # from how the tows settle
    truth = json.loads((runs[0] / "truth" / "derivatives.json").read_text())["derivatives"]
    assert len(six) == 6
    for name in six:
        assert abs(six[name].value - truth[name]) < 3.3 * six[name].std, name
    # R unknown, too: X_v from the angles alone (4.9), of the same tracks
    for run in runs:
        (run / "out" / "tracks.csv").rename(run / "tracks.csv")
        text = (run / "run.toml").read_text().replace("tension_n = 0.5\n", "")
        assert 'video = "video.mp4"' in text
        (run / "run.toml").write_text(text.replace('video = "video.mp4"', 'tracks = "tracks.csv"'))
    assert main(["steady", *map(str, runs)]) == 0
    result = read_result(tmp_path / "out" / "steady.json", SteadyFile)
    low, high = result.x_v_interval_m
    assert low < 0.219 < high
    assert high - low < 0.1  # R is usual only, and X_vv U^2/R with it
    assert result.force_unit == "F/R"


def test_track_writes_an_overlay(samples: Path, tmp_path: Path) -> None:
    run = copied(samples / "mariner" / "x1446", tmp_path / "run")
    text = (run / "run.toml").read_text().replace('video = "video.mp4"', 'video = "video.mp4"\nspan_s = [2.0, 4.0]')
    (run / "run.toml").write_text(text)
    assert main(["track", str(run)]) == 0
    from towline.vision import read_frames

    times = [frame.t_s for frame in read_frames(run / "out" / "overlay.mp4")]
    assert len(times) == 61
    tracks = read_tracks(run / "out" / "tracks.csv")
    assert tracks["t_s"].min() == pytest.approx(2.0)
    assert tracks["frame"].min() == 60


def test_simulate_and_render(samples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "scenario.toml"
    text = (samples / "mariner" / "x1446" / "scenario.toml").read_text()
    scenario.write_text(text.replace("duration_s = 40.0", "duration_s = 0.5"))
    assert main(["simulate", str(scenario)]) == 0
    assert "oscillates at 0.3340 rad/s" in capsys.readouterr().out
    assert len(read_motion(tmp_path / "motion.csv")) == 15
    assert main(["render", str(scenario), "-o", str(tmp_path / "run")]) == 0
    assert main(["track", str(tmp_path / "run"), "--no-overlay"]) == 0


@pytest.mark.once
@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda run: (run / "video.mp4").write_bytes(b""), "is empty"),
        (lambda run: (run / "video.mp4").write_bytes(b"text" * 1000), "is not a video"),
        (
            lambda run: (run / "video.mp4").write_bytes((run / "video.mp4").read_bytes()[:300_000]),
            "is not a video|truncated",
        ),
        (lambda run: (run / "video.mp4").unlink(), "no such file: video.mp4"),
        (lambda run: edit(run, "line_length_m = 0.91\n", ""), "tow.line_length_m: missing key"),
        (lambda run: edit(run, "body_m = [1.2, 0.0]", "body_m = [0.31, 0.0]"), "markers never found"),
        (lambda run: edit(run, "image_size_px = [800, 600]", "image_size_px = [640, 480]"), "camera.image_size_px"),
        (lambda run: (run / "run.toml").unlink(), "no such file"),
    ],
)
def test_failures_are_one_line_and_leave_nothing(
    samples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage, words: str
) -> None:
    import re

    run = copied(samples / "mariner" / "x1446", tmp_path / "run")
    edit(run, 'video = "video.mp4"', 'video = "video.mp4"\nspan_s = [0.0, 3.0]')
    damage(run)
    before = sorted(run.rglob("*"))
    assert main(["run", str(run)]) == 1
    said = capsys.readouterr()
    lines = said.err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("towline: error: ")
    assert re.search(words, lines[0])
    assert sorted(run.rglob("*")) == before


def edit(run: Path, old: str, new: str) -> None:
    text = (run / "run.toml").read_text()
    assert old in text
    (run / "run.toml").write_text(text.replace(old, new))


@pytest.mark.slow
def test_one_bad_run_keeps_the_batch_alive(
    mariner: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = mariner[1:3]
    bad = tmp_path / "bad"
    bad.mkdir()
    assert main(["identify", *map(str, good), str(bad), "--no-page", "-o", str(tmp_path / "out")]) == 3
    result = read_result(tmp_path / "out" / "derivatives.json", DerivativesFile)
    assert set(result.runs) == {"mariner-x1548", "mariner-x1649"}
    assert "no such file" in next(iter(result.failed.values()))
    assert "towline: failed:" in capsys.readouterr().err


def test_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    with pytest.raises(SystemExit) as caught:
        main(["nonsense"])
    assert caught.value.code == 2
