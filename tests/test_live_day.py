"""After a live tow: what the day's tows tell, what is kept of it, static records."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from towline.live.folder import STATIC, make_folder, next_of, static_of, tows_of
from towline.live.kept import keep_day, kept_day, neutral_point
from towline.live.log import LogReader, spoiling
from towline.live.tows import Day, Standing, Wish, standing_lines
from towline.record.results import Derivative, DerivativesFile
from towline.record.run import read_run
from towline.record.tables import read_motion

SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446"


# after the tow --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_days_tows_against_the_wish(samples: Path, tmp_path: Path) -> None:
    """Of one tow the wish of 1 % is not met and a tow is named that may be done; of a wish of 50 % it is enough."""
    folder = tmp_path / "tow-01"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("out"))
    text = (folder / "run.toml").read_text()
    motion = 'motion = "truth/motion.csv"'
    (folder / "run.toml").write_text(text.replace('video = "video.mp4"', motion))
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.format(percent=0.05))
    standing = Day(plan).after([folder])
    assert not standing.enough
    assert standing.next_tow is not None
    assert standing.next_tow.plan.tow_point_m in (1.446, 1.751)
    assert standing.result is not None
    for wish in standing.wishes:
        known = standing.result.derivatives[wish.name]
        assert wish.percent == pytest.approx(195.9964 * known.std / abs(known.value), rel=1e-5)
    assert "next, the tow that helps most: X_T" in "\n".join(standing_lines(standing))
    plan.write_text(PLAN.format(percent=50.0))
    enough = Day(plan).after([folder])
    assert enough.enough
    assert enough.next_tow is None
    assert standing_lines(enough)[-1] == "enough: every wish is met"
    alone = Day().after([folder])
    assert alone.wishes == ()
    assert not alone.enough


def test_a_wish_for_what_is_not_determined_is_not_met() -> None:
    assert not Standing((), None, "", {}, (Wish("y_v", None, 5.0),)).enough
    assert "not determined" in "\n".join(standing_lines(Standing((), None, "none", {}, (Wish("y_v", None, 5.0),))))


PLAN = """
[tank]
length_m = 77.0
lost_m = 17.0
width_m = 4.6
speeds_m_s = [1.28]
[model]
length_pp_m = 2.66
mass_kg = 78.0
[guess.dimensional]
speed_m_s = 1.28
m_minus_y_vdot = 149.19
i_minus_n_rdot = 62.11
y_v = -52.87
y_r_minus_mu = -66.33
n_v = -48.51
n_r = -57.60
[choices]
tension_n = 3.96
tension_speed_m_s = 1.28
tow_points_m = [1.446, 1.751]
line_lengths_m = [0.91]
releases_y_m = [0.2]
releases_beta_rad = [0.0]
[wish]
percent = {percent}
"""


# what is kept of a day ------------------------------------------------------------------------------------------------


def test_the_log_is_read_as_it_grows_and_half_a_line_waits(tmp_path: Path) -> None:
    path = tmp_path / "live.jsonl"
    reader = LogReader(path)
    assert list(reader.records()) == []
    with path.open("w") as stream:
        stream.write('{"frame": 0}\n{"event": "line", "t_s": 3.21, "level": "warning", "words": "slack"}\n{"fra')
    assert [next(iter(r)) for r in reader.records()] == ["frame", "event"]
    with path.open("a") as stream:
        stream.write('me": 1}\n{"frame": 2, "x\n{"event": "line", "t_s": 4.0, "level": "good", "words": "taut"}\n')
    assert [r.get("frame", "event") for r in reader.records()] == [1, "event"]
    assert spoiling(path) == ["3.2 s: slack"]
    assert spoiling(tmp_path / "none.jsonl") == []


def test_a_day_without_a_tow_names_the_first_one(tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.format(percent=1.0))
    standing = Day(plan).after([])
    assert not standing.enough
    assert standing.next_tow is not None
    assert [wish.percent for wish in standing.wishes] == [None] * 6


def test_where_the_day_stands_is_kept_and_read_again(samples: Path, tmp_path: Path) -> None:
    """Two tows, their motions noisy; in one the camera was named to have moved: it is fitted, and said to be looked at.
    X_v against the truth, by its own standard deviation (5 of them: one in two million is farther)."""
    folders, rng = [], np.random.default_rng(30)
    for number, name in enumerate(("x1446", "x1751"), 1):
        folder = tmp_path / f"tow-{number:02d}"
        shutil.copytree(samples / "mariner" / name, folder, ignore=shutil.ignore_patterns("out", "video.mp4"))
        text = (folder / "run.toml").read_text()
        (folder / "run.toml").write_text(text.replace('video = "video.mp4"', 'motion = "motion.csv"'))
        motion = read_motion(folder / "truth" / "motion.csv").iloc[::3][["t_s", "y_cg_m", "beta_rad"]]
        motion["y_cg_m"] += 1e-3 * rng.normal(size=len(motion))
        motion["beta_rad"] += 2e-3 * rng.normal(size=len(motion))
        motion.to_csv(folder / "motion.csv", index=False)
        folders.append(folder)
    (folders[1] / "out").mkdir()
    event = {"event": "camera", "t_s": 7.0, "level": "warning", "words": "the camera has moved"}
    (folders[1] / "out" / "live.jsonl").write_text(json.dumps(event) + "\n")
    assert kept_day(tmp_path) is None
    keep_day(tmp_path, Day().after(folders))
    kept = kept_day(tmp_path)
    assert kept is not None
    assert kept.tows == ["mariner-x1446", "mariner-x1751"]
    assert kept.named == {"mariner-x1751": ["7.0 s: the camera has moved"]}
    assert kept.x_v_m is not None
    assert kept.x_v_m.value == pytest.approx(-48.51 / -52.87, abs=5 * kept.x_v_m.std)
    assert 0 < kept.x_v_m.std < 0.1
    assert any("look at mariner-x1751" in line for line in kept.words)
    wish = kept.derivatives["y_v"]
    assert (wish.wished_percent, wish.met, wish.unit) == (None, None, "N s/m")


def test_neutral_points_spread_is_that_of_draws() -> None:
    """200 000 draws of (Y_v, N_v): sd of N_v / Y_v to 1 %."""
    sd, together = np.array([1.0, 0.8]), 0.6
    known = {
        name: Derivative(value=value, std=s, unit="", prime=0.0, prime_std=0.0)
        for name, value, s in zip(("y_v", "n_v"), (-52.87, -48.51), sd, strict=True)
    }
    result = DerivativesFile.model_construct(derivatives=known, correlation=[[1.0, together], [together, 1.0]])
    covariance = np.array([[sd[0] ** 2, together * sd.prod()], [together * sd.prod(), sd[1] ** 2]])
    y_v, n_v = np.random.default_rng(1).multivariate_normal([-52.87, -48.51], covariance, 200_000).T
    found = neutral_point(result)
    assert found is not None
    assert found.value == pytest.approx(48.51 / 52.87)
    assert found.std == pytest.approx(np.std(n_v / y_v), rel=0.01)


def test_a_static_record_serves_the_tows_that_come(samples: Path, tmp_path: Path) -> None:
    """Its tracks stand in the next tow's folder, named in [noise] static, over what the set-up names."""
    setup = read_run(samples / "mariner" / "x1446")
    static = make_folder(setup, next_of(tmp_path, STATIC), "film.ts")
    assert static.folder.name == "static-01"
    assert static_of(tmp_path) is None  # not tracked yet
    static.out.mkdir()
    (static.out / "tracks.csv").write_text("frame,t_s\n")
    made = make_folder(setup, next_of(tmp_path), "film.ts", static_of(tmp_path))
    assert made.file.noise is not None
    assert (made.folder / made.file.noise.static).read_text() == "frame,t_s\n"
    assert [path.name for path in tows_of(tmp_path)] == ["tow-01"]
    assert make_folder(setup, next_of(tmp_path), "film.ts").file.noise is None
