"""run.toml and tables: what is read, and what every fault is called."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from towline.record import InputError, TowlineError, read_motion, read_run, read_tracks, write_table
from towline.record.files import replacing
from towline.record.scenario import ScenarioFile
from towline.record.tables import input_hash_of, read_history
from towline.record.toml import read_toml

GOOD = """\
name = "t"
kind = "tow"

[source]
tracks = "tracks.csv"

[[datum]]
name = "a"
pixel_px = [0.0, 0.0]
tank_m = [0.0, -0.7, 0.0]

[[datum]]
name = "b"
pixel_px = [100.0, 0.0]
tank_m = [0.0, 0.7, 0.0]

[[datum]]
name = "c"
pixel_px = [0.0, 100.0]
tank_m = [-3.0, -0.7, 0.0]

[[datum]]
name = "d"
pixel_px = [100.0, 100.0]
tank_m = [-3.0, 0.7, 0.0]

[[marker]]
name = "bow"
body_m = [1.2, 0.0]
depth_m = 0.1

[[marker]]
name = "stern"
body_m = [-1.1, 0.0]
depth_m = 0.1

[tow]
speed_m_s = 1.28
line_length_m = 0.91
tow_point_m = 1.548
tension_n = 3.96

[model]
length_pp_m = 2.66
mass_kg = 78.0

[water]
density_kg_m3 = 1000.0
"""
TRACKS = "frame,t_s,marker,u_px,v_px\n0,0.0,bow,10,20\n0,0.0,stern,30,40\n1,0.1,bow,11,21\n1,0.1,stern,31,41\n"


def folder(tmp_path: Path, text: str = GOOD, tracks: str | None = TRACKS) -> Path:
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    if tracks is not None:
        (tmp_path / "tracks.csv").write_text(tracks, encoding="utf-8")
    return tmp_path


def test_a_good_run_is_read(tmp_path: Path) -> None:
    run = read_run(folder(tmp_path))
    assert run.name == "t"
    assert run.tow.post_m == (0.0, 0.0)
    assert run.model.x_delta_m == pytest.approx(-0.45 * 2.66)


def test_every_run_of_the_samples_is_read(samples: Path) -> None:
    paths = sorted(samples.glob("*/*/run.toml"))
    assert len(paths) == 8
    for path in paths:
        assert len(read_run(path).file.marker) == 2
        read_toml(path.parent / "scenario.toml", ScenarioFile)


def test_every_run_of_the_reference_data_is_read(shared: Path) -> None:
    paths = [*sorted(shared.glob("blind/*/*/run.toml")), shared / "film" / "run.toml"]
    assert len(paths) == 240 + 1
    for path in paths:
        assert len(read_run(path).file.marker) == 2


@pytest.mark.parametrize(
    ("old", "new", "where", "words"),
    [
        ("speed_m_s = 1.28", "speed_mm_s = 1280", "tow.speed_mm_s", "unknown key; did you mean 'speed_m_s'?"),
        ("speed_m_s = 1.28\n", "", "tow.speed_m_s", "missing key"),
        ("line_length_m = 0.91\n", "", "", "tow.line_length_m: missing key"),
        ("line_length_m = 0.91", "line_length_m = 9100", "tow.line_length_m", "is it in mm?"),
        ("tension_n = 3.96", "tension_n = 3.96\nrudder_rad = 20", "tow.rudder_rad", "is it in degrees?"),
        ("tension_n = 3.96", 'tension_n = "4"', "tow.tension_n", "valid number"),
        ("tension_n = 3.96", 'tension_n = 4.0\ntension = "t.csv"', "tow", "both given"),
        ("density_kg_m3 = 1000.0", "density_kg_m3 = 1.0", "water.density_kg_m3", "is it in g/cm3?"),
        ('tracks = "tracks.csv"', 'tracks = "none.csv"', "source.tracks", "no such file"),
        ('tracks = "tracks.csv"', 'tracks = "tracks.csv"\nvideo = "v.mp4"', "source", "exactly one of"),
        ('tracks = "tracks.csv"', 'tracks = "tracks.csv"\nspan_s = [3.0, 1.0]', "source", "must rise"),
        ("tank_m = [-3.0, 0.7, 0.0]", "tank_m = [-3.0, 0.7, -0.1]", 'datum[4 "d"]', "above the datum plane"),
        ("tank_m = [-3.0, 0.7, 0.0]", "tank_m = [-3.0, 0.7]", 'datum[4 "d"].tank_m', "missing key"),
        ("tank_m = [-3.0, 0.7, 0.0]", "tank_m = [-3.0, -0.7, 0.0]", "", "'c' and 'd' stand at one place"),
        ("body_m = [-1.1, 0.0]", "body_m = [1.2, 0.0]", "", "'bow' and 'stern' stand at one place"),
        ('name = "stern"', 'name = "bow"', "", "two are called 'bow'"),
        ("depth_m = 0.1\n\n[tow]", 'depth_m = 0.1\nlook = "lamp"\n\n[tow]', 'marker[2 "stern"]', "expected led, disc"),
        ("[water]\ndensity_kg_m3 = 1000.0\n", "", "", "water: missing table"),
        ('kind = "tow"', 'kind = "towed"', "kind", "input should be"),
        ("mass_kg = 78.0", "mass_kg = nan", "model.mass_kg", "finite"),
        ('name = "t"', 'name = "t', "name", 'line 1, `name = "t`: its closing " is missing'),
    ],
)
def test_faults_name_file_key_and_value(tmp_path: Path, old: str, new: str, where: str, words: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        read_run(folder(tmp_path, GOOD.replace(old, new)))
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "run.toml"))
    assert caught.value.where.startswith(where)
    assert words in message
    assert "\n" not in message


def test_too_few_and_collinear_datum_points(tmp_path: Path) -> None:
    three = GOOD.replace(GOOD[GOOD.index('[[datum]]\nname = "d"') : GOOD.index("[[marker]]")], "")
    with pytest.raises(InputError, match="3 points, at least 4"):
        read_run(folder(tmp_path, three))
    line = GOOD.replace("-0.7, 0.0]", "-3.0, 0.0]").replace("tank_m = [0.0, 0.7", "tank_m = [-1.0, -3.0")
    line = line.replace("tank_m = [-3.0, 0.7", "tank_m = [-2.0, -3.0")
    with pytest.raises(InputError, match="collinear"):
        read_run(folder(tmp_path, line))


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such run folder"):
        read_run(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("# a comment only\n", "is empty"),
        ("frame,t_s,marker,u_px\n0,0,bow,1\n", "column v_px: missing"),
        (TRACKS.replace("11,21", "eleven,21"), "row 3, u_px: 'eleven' is not a finite number"),
        (TRACKS.replace("1,0.1,bow", "1,0.0,bow"), "row 3, t_s: repeats"),
        (TRACKS.replace("1,0.1,bow", "1,-1.0,bow"), "row 3, t_s: falls"),
        (TRACKS.replace("1,0.1,stern", "1,0.2,stern"), "stands at two times"),
        (TRACKS.replace("0,0.0,stern", "0,,stern"), "row 2, t_s: is empty"),
        (TRACKS.replace("11,21", "inf,21"), "not a finite number"),
    ],
)
def test_faulty_tracks_name_the_row(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_tracks(path)
    assert words in str(caught.value)


def test_a_point_without_a_place_is_lost_and_comments_are_skipped(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    path.write_text("# made by hand\n" + TRACKS.replace("11,21", ",21"))
    assert list(read_tracks(path)["status"]) == ["measured", "measured", "lost", "measured"]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_tables_survive_a_round_trip(tmp_path: Path, suffix: str) -> None:
    table = pd.DataFrame({"t_s": [0.0, 1 / 3], "y_cg_m": [0.1, np.nan], "beta_rad": [1e-9, 2.0], "note": ["é", "b"]})
    path = tmp_path / f"motion.{suffix}"
    write_table(path, table, "abc")
    back = read_motion(path)
    np.testing.assert_allclose(back["t_s"], table["t_s"], rtol=1e-9)
    assert list(back["status"]) == ["measured", "lost"]
    assert list(back["note"]) == ["é", "b"]
    assert input_hash_of(path) == ("abc" if suffix == "csv" else None)


def test_a_broken_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")

    def break_off() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        break_off()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_history_must_rise(tmp_path: Path) -> None:
    path = tmp_path / "tension.csv"
    path.write_text("t_s,tension_n\n0,4\n0,4.1\n")
    with pytest.raises(InputError, match="row 2, t_s: repeats"):
        read_history(path, "tension_n")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    cells=st.lists(
        st.lists(st.one_of(st.floats(), st.text(max_size=6), st.integers(), st.none()), min_size=5, max_size=5),
        max_size=6,
    )
)
def test_any_table_is_read_or_refused_in_one_line(tmp_path: Path, cells: list[list[Any]]) -> None:
    path = tmp_path / "tracks.csv"
    pd.DataFrame(cells, columns=pd.Index(["frame", "t_s", "marker", "u_px", "v_px"])).to_csv(path, index=False)
    try:
        table = read_tracks(path)
    except TowlineError:  # anything else fails the test
        return
    assert np.isfinite(table["t_s"]).all()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, len(GOOD)), junk=st.text(max_size=12))
def test_any_run_toml_is_read_or_refused_in_one_line(tmp_path: Path, cut: int, junk: str) -> None:
    run = folder(tmp_path, "")
    (run / "run.toml").write_text(GOOD[:cut] + junk + GOOD[cut:], encoding="utf-8", errors="replace")
    with contextlib.suppress(TowlineError):  # anything else fails the test
        read_run(run)
