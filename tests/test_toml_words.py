"""What people type into a run.toml that is no TOML: one line that names the key and how it is written."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from towline.record import InputError, read_run

GOOD = """\
name = "t"

[source]
tracks = "tracks.csv"

[[datum]]
name = "a"
pixel_px = [100.0, 100.0]
tank_m = [-1.0, -0.7, 0.0]

[[datum]]
name = "b"
pixel_px = [500.0, 100.0]
tank_m = [-1.0, 0.7, 0.0]

[[datum]]
name = "c"
pixel_px = [50.0, 400.0]
tank_m = [-3.0, -0.7, 0.0]

[[datum]]
name = "d"
pixel_px = [550.0, 400.0]
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
TRACKS = "frame,t_s,marker,u_px,v_px\n0,0.0,bow,10,20\n0,0.0,stern,30,40\n"


def folder(tmp_path: Path, text: str | bytes) -> Path:
    (tmp_path / "run.toml").write_bytes(text.encode("utf-8") if isinstance(text, str) else text)
    (tmp_path / "tracks.csv").write_text(TRACKS, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("old", "new", "where", "words"),
    [
        ("length_m = 0.91", "length_m = 1,25", "tow.line_length_m", "decimal comma; TOML wants a point: line_length_m = 1.25"),
        ("length_m = 0.91", "length_m = 1,25  # to the eye", "tow.line_length_m", "line_length_m = 1.25"),
        ("[-1.1, 0.0]", "[-1,1, 0,0]", 'marker[2 "stern"].body_m', "decimal commas? TOML wants points: body_m = [-1.1, 0.0]"),
        ('"tracks.csv"', r'"C:\users\a.csv"', "source.tracks", r"write \"C:/users/a.csv\" with /, or"),
        ('"tracks.csv"', r'"D:\film\a.csv"', "source.tracks", r"between single quotes: 'D:\film\a.csv'"),
        ('"tracks.csv"', r'"C:\tank\new.csv"', "source.tracks", "write 'C:/tank/new.csv' with /"),
        ('"tracks.csv"', "\u201ctracks.csv\u201d", "source.tracks", "\u201c is no quote of TOML's"),
        ('"tracks.csv"', "tracks.csv", "source.tracks", 'text stands between quotes: tracks = "tracks.csv"'),
        ('"tracks.csv"', '"tracks.csv', "source.tracks", 'its closing " is missing'),
        ("[-3.0, -0.7, 0.0]", "[-3.0, -0.7, 0.0", "datum[3].tank_m", "its closing ] is missing"),
        ("tension_n = 3.96", "tension_n = 3.96\nspeed_m_s = 1.3", "tow.speed_m_s", "stands in line 37 already"),
        ("[water]", "[tow]\nrudder_rad = 0.1\n\n[water]", "tow", "[tow] stands in line 36 already"),
        ("[[datum]]", "[datum]", "datum", "or write [[datum]] each time"),
        ("[tow]", "[[tow]]", "tow", "there is one: write [tow] with one bracket"),
        ("tension_n = 3.96", "tension_n: 3.96", "tow.tension_n", "a key and its value are joined by ="),
        ("= 1.28", "= 1.28 m/s", "tow.speed_m_s", "a number stands alone, its unit is in the key's name: speed_m_s = 1.28"),
        ("= 1.28", "= .28", "tow.speed_m_s", "a number needs digits before and behind its point"),
        ("= 1.28", "= 5.", "tow.speed_m_s", "a number needs digits before and behind its point"),
        ("= 1.28", "= 01.28", "tow.speed_m_s", "a number must not begin with 0"),
        ("= 1.28", "= \u22121.28", "tow.speed_m_s", "the minus is a dash of a word processor"),
        ("= 1.28", "=", "tow.speed_m_s", "its value is missing"),
        ("= 1.28", "= 1.28,", "tow.speed_m_s", "no comma stands at the end of a line"),
        ('name = "t"', 'name = "t"\noutside = True', "outside", "write true or false: outside = true"),
        ('name = "t"', 'name = "t"\n// a remark', "", "a comment begins with #"),
        ('name = "t"', 'name = "t"\nkind', "", "a line is `key = value`, [table] or # comment"),
        ("[water]", "[water", "", "a table's name stands between brackets"),
        ("mass_kg = 78.0", "mass_kg = 78.0\nline_length_m = 0.9", "model.line_length_m", "did you mean it in [tow]?"),
        ("[tow]", "[tow]\ndepth_m = 0.1", "tow.depth_m", "did you mean it in [[marker]]?"),
        ("[water]", '[water]\nkind = "tow"', "water.kind", "did you mean it at the top, before the first table?"),
    ],
)  # fmt: skip
def test_what_people_type_is_named_with_its_key(tmp_path: Path, old: str, new: str, where: str, words: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        read_run(folder(tmp_path, GOOD.replace(old, new)))
    assert caught.value.where == where
    assert words.replace('\\"', '"') in caught.value.message
    assert str(caught.value).startswith(str(tmp_path / "run.toml"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: b"\xef\xbb\xbf" + text.encode(),  # Notepad's byte order mark
        lambda text: text.replace("\n", "\r\n").encode(),
        lambda text: text.replace(" = ", "\t=\t").replace("\nline", "\n\tline").encode(),
        lambda text: text.replace('"tracks.csv"', "'tracks.csv'").encode(),
    ],
)
def test_what_editors_do_is_simply_read(tmp_path: Path, change) -> None:
    assert read_run(folder(tmp_path, change(GOOD))).file == read_run(folder(tmp_path, GOOD)).file


def test_other_encodings_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="UTF-16; save it as UTF-8"):
        read_run(folder(tmp_path, GOOD.encode("utf-16")))
    with pytest.raises(InputError, match=r"run.toml: line 2: is not UTF-8 text; save the file as UTF-8"):
        read_run(folder(tmp_path, GOOD.replace('"t"', '"t"\nnotes = "Kanal 3, gr\u00fcn"').encode("latin-1")))


def test_words_never_hide_what_is_valid() -> None:
    """Each sample of the table above is really no TOML, or no run: the text without the change is read (first test's own GOOD)."""
    assert tomllib.loads(GOOD)["tow"]["line_length_m"] == 0.91
