"""Import: tracks written in each program's own format from a known truth and read back; holes stay holes; wrong files say where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from towline.cli import main
from towline.record.errors import InputError
from towline.record.imported import Convention, Wanted, import_tracks, program_of
from towline.record.tables import read_tracks

RATE, HEIGHT, FRAMES = 25.0, 720, 40
EXACT_PX = 1e-9
"""The files hold 17 digits; the conversions add and subtract numbers below 2,000."""
NAMES = ("bow", "stern")


class Truth:
    """Two marks in towline's pixels, (frames, 2): a swing, with holes where the mark was not seen."""

    def __init__(self, seed: int = 1) -> None:
        draw = np.random.default_rng(seed)
        t_s = np.arange(FRAMES) / RATE
        self.frame, self.t_s = np.arange(FRAMES), t_s
        start = draw.uniform(200, 500, (2, 2))
        self.u = start[0] + 40 * np.sin(0.7 * t_s)[:, None] + draw.normal(0, 0.1, (FRAMES, 2))
        self.v = start[1] + 30 * np.cos(0.5 * t_s)[:, None] + draw.normal(0, 0.1, (FRAMES, 2))
        self.hole = np.zeros((FRAMES, 2), dtype=bool)
        self.hole[7:10, 0] = self.hole[9:15, 1] = True  # frame 9: none of both
        self.hole[3, 1] = True
        self.u[self.hole], self.v[self.hole] = np.nan, np.nan


def text(value: float, decimal: str = ".") -> str:
    return "" if np.isnan(value) else repr(float(value)).replace(".", decimal)


def write_trackpy(path: Path, truth: Truth) -> Wanted:
    """Index column, columns in trackpy's order, no row for a hole."""
    lines = [",y,x,mass,size,ecc,signal,raw_mass,ep,frame,particle"]
    for count, (row, column) in enumerate(np.argwhere(~truth.hole)):
        y, x = text(truth.v[row, column]), text(truth.u[row, column])
        lines.append(f"{count},{y},{x},900.1,2.2,0.1,80.0,1200.0,0.03,{row},{4 - column}")
    path.write_text("\n".join(lines))
    return Wanted(rate_hz=RATE, markers={"bow": "4", "stern": "3"})


def write_trackpy_parquet(path: Path, truth: Truth) -> Wanted:
    rows = np.argwhere(~truth.hole)
    pd.DataFrame(
        {
            "y": truth.v[~truth.hole],
            "x": truth.u[~truth.hole],
            "ep": 0.03,
            "frame": rows[:, 0],
            "particle": rows[:, 1],
        }
    ).to_parquet(path)
    return Wanted(rate_hz=RATE, markers={"bow": "0", "stern": "1"})


def write_dltdv5(path: Path, truth: Truth) -> Wanted:
    """MATLAB's first pixel is 1, y from the lower edge: the lowest row of pixels has y = 1."""
    lines = ["pt1_cam1_X,pt1_cam1_Y,pt1_cam2_X,pt1_cam2_Y,pt2_cam1_X,pt2_cam1_Y,pt2_cam2_X,pt2_cam2_Y"]
    for u, v in zip(truth.u, truth.v, strict=True):
        values = (u[0] + 1, HEIGHT - v[0], np.nan, np.nan, u[1] + 1, HEIGHT - v[1], np.nan, np.nan)
        lines.append(",".join(text(value) or "NaN" for value in values))
    path.write_text("\n".join(lines) + "\n")
    return Wanted(RATE, {"bow": "pt1", "stern": "pt2"}, image_height_px=HEIGHT, y="up", camera=1)


def write_dltdv8(path: Path, truth: Truth) -> Wanted:
    lines = ["pt1_cam1_X,pt1_cam1_Y,pt2_cam1_X,pt2_cam1_Y"]
    for u, v in zip(truth.u, truth.v, strict=True):
        lines.append(",".join(text(c) or "NaN" for c in (u[0] + 1, v[0] + 1, u[1] + 1, v[1] + 1)))
    path.write_text("\n".join(lines) + "\n")
    return Wanted(RATE, {"bow": "pt1", "stern": "pt2"}, y="down")


def write_kinovea_csv(path: Path, truth: Truth) -> Wanted:
    """One table, everything quoted, decimal commas and semicolons, ms; the axes stand at (640, 360), y upward."""
    lines = ['"Time";"bow/0/X";"bow/0/Y";"aft/0/X";"aft/0/Y"']
    for row in range(FRAMES):
        values = [truth.u[row, 0] - 640, 360 - truth.v[row, 0], truth.u[row, 1] - 640, 360 - truth.v[row, 1]]
        if np.isnan(values).all():
            continue
        cells = [text(1000 * truth.t_s[row], ","), *(text(value, ",") for value in values)]
        lines.append(";".join(f'"{cell}"' if cell else "" for cell in cells))
    path.write_text("﻿" + "\r\n".join(lines), encoding="utf-8")
    return Wanted(RATE, {"bow": "bow", "stern": "aft"}, origin_px=(640, 360))


def write_kinovea_text(path: Path, truth: Truth) -> Wanted:
    """A block per trajectory, times as h:mm:ss:cc, which are exact at 25 frames/s."""
    lines = ["#Kinovea Trajectory data export", "#T X Y", ""]
    for column, name in enumerate(("bow", "aft")):
        lines.append(f"# {name}")
        for row in np.flatnonzero(~truth.hole[:, column]):
            hundredths = 4 * int(row)
            clock = f"0:00:{hundredths // 100:02d}:{hundredths % 100:02d}"
            lines.append(f"{clock} {text(truth.u[row, column], ',')} {text(HEIGHT - truth.v[row, column], ',')} ")
        lines += ["", ""]
    path.write_text("\n".join(lines))
    return Wanted(RATE, {"bow": "bow", "stern": "aft"}, origin_px=(0, HEIGHT), image_height_px=HEIGHT)


def write_kva(path: Path, truth: Truth) -> Wanted:
    """Kinovea's own XML: x;y;time stamp in pixels, y down; 512 stamps a frame from stamp 1000 on."""
    parts = ['<?xml version="1.0" encoding="utf-8"?>', "<KinoveaVideoAnalysis>", "<FormatVersion>2.0</FormatVersion>"]
    parts += ["<AverageTimeStampsPerFrame>512</AverageTimeStampsPerFrame>", "<FirstTimeStamp>1000</FirstTimeStamp>"]
    parts += [f"<CaptureFramerate>{RATE}</CaptureFramerate>", "<Tracks>"]
    for column, name in enumerate(("bow", "aft")):
        parts.append(f'<Track id="{column}"><TrackPointList Count="9" UserUnitLength="px">')
        for row in np.flatnonzero(~truth.hole[:, column]):
            place = f"{text(truth.u[row, column])};{text(truth.v[row, column])};{1000 + 512 * row}"
            parts.append(f'<TrackPoint UserX="1,50" UserXInvariant="1.50" UserTime="0:00">{place}</TrackPoint>')
        parts.append(f'</TrackPointList><MainLabel Text="{name}" /></Track>')
    path.write_text("\n".join([*parts, "</Tracks>", "</KinoveaVideoAnalysis>"]))
    return Wanted(markers={"bow": "bow", "stern": "aft"})


def write_tracker(path: Path, truth: Truth) -> Wanted:
    """Axes at image position (640, 360) whose corner is 0, so pixel centres are at halves; 80 pixels a metre, y upward."""
    lines = ["\tmass_A\t\t\tmass_B\t\t", "t\tx\ty\tv_x\tx\ty\tv_x"]
    for row, t in enumerate(truth.t_s):
        cells = [text(t)]
        for column in range(2):
            cells += [
                text((truth.u[row, column] + 0.5 - 640) / 80),
                text((360 - truth.v[row, column] - 0.5) / 80),
                "1.0",
            ]
        lines.append("\t".join(cells))
    path.write_text("\n".join(lines))
    return Wanted(markers={"bow": "mass_A", "stern": "mass_B"}, origin_px=(640, 360), pixels_per_unit=80)


def write_tracker_pixels(path: Path, truth: Truth) -> Wanted:
    lines = ["#mass_A;;;mass_B;", "t;pixelx;pixely;pixelx;pixely"]
    for row, t in enumerate(truth.t_s):
        pairs = [
            text(value + 0.5, ",") for column in range(2) for value in (truth.u[row, column], truth.v[row, column])
        ]
        lines.append(";".join([text(t, ","), *pairs]))
    path.write_text("\n".join(lines))
    return Wanted(markers={"bow": "mass_A", "stern": "mass_B"})


FORMATS: dict[str, tuple[str, str, Callable[[Path, Truth], Wanted]]] = {
    "trackpy": ("trackpy", "a.csv", write_trackpy),
    "trackpy parquet": ("trackpy", "a.parquet", write_trackpy_parquet),
    "dltdv 5": ("dltdv", "a_xypts.csv", write_dltdv5),
    "dltdv 8": ("dltdv", "a_xypts.csv", write_dltdv8),
    "kinovea csv": ("kinovea", "a.csv", write_kinovea_csv),
    "kinovea text": ("kinovea", "a.txt", write_kinovea_text),
    "kinovea kva": ("kinovea", "a.kva", write_kva),
    "tracker": ("tracker", "a.txt", write_tracker),
    "tracker pixels": ("tracker", "a.csv", write_tracker_pixels),
}


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("seed", [1, 2])
def test_tracks_come_back_as_they_were(tmp_path: Path, kind: str, seed: int) -> None:
    program, name, write = FORMATS[kind]
    truth = Truth(seed)
    wanted = write(tmp_path / name, truth)
    found = import_tracks(tmp_path / name, "auto", wanted)
    assert found.program == program
    table = found.table
    assert len(table) == 2 * FRAMES
    for column, marker in enumerate(NAMES):
        rows = table[table["marker"] == marker]
        assert rows["frame"].tolist() == list(range(FRAMES))
        assert np.abs(rows["t_s"] - truth.t_s).max() < 1e-12
        assert rows["status"].tolist() == ["lost" if hole else "measured" for hole in truth.hole[:, column]]
        u, v = rows["u_px"].to_numpy(), rows["v_px"].to_numpy()
        assert np.array_equal(np.isnan(u), truth.hole[:, column])
        assert np.array_equal(np.isnan(v), truth.hole[:, column])
        assert np.nanmax(np.abs(u - truth.u[:, column])) < EXACT_PX
        assert np.nanmax(np.abs(v - truth.v[:, column])) < EXACT_PX


@pytest.mark.parametrize("kind", FORMATS)
def test_towline_reads_the_written_table(tmp_path: Path, kind: str) -> None:
    """Parquet keeps every bit; CSV ten digits, 5e-8 of a pixel below 1,000."""
    _, name, write = FORMATS[kind]
    truth = Truth()
    found = import_tracks(tmp_path / name, "auto", write(tmp_path / name, truth)).table
    from towline.record.tables import write_table

    for suffix, tolerance in (("parquet", 0.0), ("csv", 1e-7)):
        write_table(tmp_path / f"tracks.{suffix}", found)
        table = read_tracks(tmp_path / f"tracks.{suffix}")
        assert np.nanmax(np.abs(table["u_px"] - found["u_px"])) <= tolerance
        assert table["status"].tolist() == found["status"].tolist()


def test_conventions_turn_back_into_themselves() -> None:
    u, v = np.random.default_rng(0).uniform(0, 700, (2, 50))
    for convention in (
        Convention(),
        Convention(1.0, True, HEIGHT),
        Convention(0.5, True, None, (640, 360), 37.5),
        Convention(0.5, False, None, (10, 20), 2.0),
    ):
        back = convention.to_pixels(*convention.from_pixels(u, v))
        assert np.abs(np.array(back) - np.array([u, v])).max() < EXACT_PX


def test_the_corners_of_a_picture_are_where_each_program_says() -> None:
    """The middle of the upper left pixel, 720 px high: (0, 0) here, (1, 720) in DLTdv 5, (0.5, 719.5) from the lower corner."""
    assert Convention(1.0, True, HEIGHT).from_pixels(np.zeros(1), np.zeros(1)) == (1.0, 720.0)
    assert Convention(0.5, True, HEIGHT).from_pixels(np.zeros(1), np.zeros(1)) == (0.5, 719.5)
    assert Convention(0.5, True, None, (0, HEIGHT)).from_pixels(np.zeros(1), np.zeros(1)) == (0.5, 719.5)


def test_a_stated_position_error_becomes_sigma(tmp_path: Path) -> None:
    wanted = write_trackpy(tmp_path / "a.csv", Truth())
    table = import_tracks(tmp_path / "a.csv", "trackpy", wanted).table
    measured = table["status"] == "measured"
    assert (table.loc[measured, ["sigma_u_px", "sigma_v_px"]] == 0.03).all(axis=None)
    assert table.loc[~measured, ["sigma_u_px", "sigma_v_px"]].isna().all(axis=None)


def test_a_frame_that_no_row_names_is_a_hole_also_at_every_second_frame(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame,x,y,particle\n10,1,2,0\n12,1,2,0\n18,1,2,0\n")
    table = import_tracks(tmp_path / "a.csv", wanted=Wanted(rate_hz=50)).table
    assert table["frame"].tolist() == [10, 12, 14, 16, 18]
    assert table["status"].tolist() == ["measured", "measured", "lost", "lost", "measured"]
    assert np.allclose(table["t_s"], [0.2, 0.24, 0.28, 0.32, 0.36], atol=1e-15)


def test_half_a_point_is_a_hole(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("pt1_cam1_X,pt1_cam1_Y\n10,20\n10,NaN\nNaN,20\n")
    table = import_tracks(tmp_path / "a.csv", wanted=Wanted(rate_hz=50, y="down")).table
    assert table["status"].tolist() == ["measured", "lost", "lost"]
    assert table.loc[1:, ["u_px", "v_px"]].isna().all(axis=None)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e3), ("µs", 1e6), ("frames", RATE)])
def test_an_unstated_time_unit_is_told_from_the_rate(tmp_path: Path, unit: str, factor: float) -> None:
    lines = ["Time;x;y", *(f"{factor * k / RATE!r};1,5;2,5" for k in range(5))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    found = import_tracks(tmp_path / "a.csv", wanted=Wanted(RATE, origin_px=(100, 100)))
    assert found.table["frame"].tolist() == [0, 1, 2, 3, 4]
    assert any(f"as {unit}" in note for note in found.notes)
    assert found.table["u_px"].tolist() == [101.5] * 5
    assert found.table["v_px"].tolist() == [97.5] * 5


WRONG = {
    "a cell that is no number": ("frame,x,y,particle\n0,1,2,0\n1,abc,2,0\n", {}, "line 3, column x: 'abc' is not a"),
    "a thousands mark": ("frame;x;y;particle\n0;1.234,5;2;0\n", {}, "line 2, column x: '1.234,5' is not a"),
    "infinity": ("frame,x,y,particle\n0,inf,2,0\n", {}, "line 2, column x: 'inf' is not a finite"),
    "a missing column": ("frame,x,particle\n0,1,0\n", {"program": "trackpy"}, "column y: missing; found frame, x"),
    "a row too short": ("frame,x,y,particle\n0,1,2,0\n1,1\n", {}, "line 3: 2 cells; the header has 4"),
    "a particle twice": ("frame,x,y,particle\n0,1,2,5\n0,1,2,5\n", {}, "line 3: particle 5 stands twice in frame 0"),
    "half a frame": ("frame,x,y,particle\n0.5,1,2,5\n", {}, "line 2, column frame: 0.5; an integer"),
    "no rate": ("frame,x,y,particle\n0,1,2,5\n", {"rate_hz": None}, "frame rate is needed"),
    "y not said": ("pt1_cam1_X,pt1_cam1_Y\n1,2\n", {}, "--y up for DLTdv 1-7"),
    "no height": ("pt1_cam1_X,pt1_cam1_Y\n1,2\n", {"y": "up"}, "--image-height PX"),
    "an X without Y": ("pt1_cam1_X,pt2_cam1_Y\n1,2\n", {"y": "down"}, "column pt1_cam1_Y: missing"),
    "two cameras": ("p_cam1_X,p_cam1_Y,p_cam2_X,p_cam2_Y\n1,2,3,4\n", {"y": "down"}, "holds cameras 1, 2"),
    "below the picture": (
        "p_cam1_X,p_cam1_Y\n1,2\n1,900\n",
        {"y": "down", "image_height_px": 720},
        "frame 1, p: u = 0.0, v = 899.0 px lies outside a picture 720 px high",
    ),
    "above the picture": ("p_cam1_X,p_cam1_Y\n1,-9\n", {"y": "down"}, "v = -10.0 px lies outside the picture"),
    "no origin": ("mass_A\nt\tx\ty\n0\t1\t2\n0.1\t1\t2\n", {}, "image position is needed"),
    "times that fall": (
        "mass_A\nt\tx\ty\n0\t1\t2\n0.2\t1\t2\n0.1\t1\t2\n",
        {"origin_px": (5, 5)},
        "line 5, time: 0.1 s after 0.2 s",
    ),
    "uneven times": (
        "mass_A\nt\tx\ty\n0\t1\t2\n0.08\t1\t2\n0.25\t1\t2\n0.4\t1\t2\n",
        {"origin_px": (5, 5), "rate_hz": None},
        "beside even steps",
    ),
    "two rows in a frame": (
        "mass_A\nt\tx\ty\n0\t1\t2\n0.04\t1\t2\n0.05\t1\t2\n",
        {"origin_px": (5, 5)},
        "line 5, time: 0.05 s falls into frame 1",
    ),
    "an x without y": ("m\nt\tx\ty\tx\n0\t1\t2\t3\n", {"origin_px": (5, 5)}, "column 4: x without its y"),
    "a broken time": (
        "#Kinovea Trajectory data export\n#T X Y\n0:00:00:00 1 2\n0:0x:00:04 1 2\n",
        {"origin_px": (5, 5)},
        "line 4, column Time: '0:0x:00:04'",
    ),
    "no unit": ("Time,x,y\n0,1,2\n40,1,2\n", {"origin_px": (5, 5), "rate_hz": None}, "states no unit"),
    "another program": ("a,b\n1,2\n", {}, "is none of trackpy, dltdv"),
    "nothing": ("", {}, "is empty"),
    "no XML": ("<KinoveaVideoAnalysis><Tracks>", {}, "is no XML"),
    "a spreadsheet": ('<?xml version="1.0"?><Workbook/>', {}, "Workbook: is not Kinovea's KVA"),
    "entities": ('<!DOCTYPE x [<!ENTITY a "b">]><KinoveaVideoAnalysis/>', {}, "declares entities"),
    "a broken point": (
        "<KinoveaVideoAnalysis><Track name='bow'><TrackPoint>1;2;0</TrackPoint><TrackPoint>1;b;1</TrackPoint></Track>"
        "</KinoveaVideoAnalysis>",
        {},
        "track 'bow', point 2: 'b' is not",
    ),
    "only holes": ("p_cam1_X,p_cam1_Y\nNaN,NaN\n", {"y": "down"}, "holds no measured point"),
    "an unknown marker": (
        "frame,x,y,particle\n0,1,2,5\n",
        {"markers": {"bow": "7"}},
        "marker 7: no such point; found 5",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_one_sentence_that_says_where(tmp_path: Path, case: str) -> None:
    content, options, said = WRONG[case]
    options = dict(options)
    program = options.pop("program", "auto")
    (tmp_path / "wrong.csv").write_text(content)
    with pytest.raises(InputError) as caught:
        import_tracks(tmp_path / "wrong.csv", program, replace(Wanted(rate_hz=RATE), **options))
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "wrong.csv"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.pkl", "a.pickle", "a.csv"])
def test_a_pickle_is_never_opened(tmp_path: Path, name: str) -> None:
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    import pickle

    (tmp_path / name).write_bytes(pickle.dumps(Trap(), protocol=5) + b"\0")
    with pytest.raises(InputError, match=r"pickle|no text"):
        import_tracks(tmp_path / name, "trackpy", Wanted(rate_hz=RATE))
    assert not (tmp_path / "sprung").exists()


def test_the_command_writes_tracks_with_run_tomls_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = Truth()
    write_dltdv5(tmp_path / "a_xypts.csv", truth)
    source, out = str(tmp_path / "a_xypts.csv"), str(tmp_path / "tracks.csv")
    common = ["--rate", "25", "--image-height", "720", "--camera", "1"]
    points = ["--marker", "bow=pt1", "--marker", "stern=pt2"]
    assert main(["import", source, *common, *points, "-o", out]) == 1
    assert "--y up for DLTdv 1-7" in capsys.readouterr().err
    assert not Path(out).exists()
    assert main(["import", source, *common, *points, "--y", "up", "-o", out]) == 0
    assert "bow measured in 37 of 40 frames" in capsys.readouterr().out
    table = read_tracks(out)
    assert set(table["marker"]) == set(NAMES)
    assert np.nanmax(np.abs(table.loc[table["marker"] == "bow", "u_px"].to_numpy() - truth.u[:, 0])) < 1e-7
    assert main(["import", source, *common, *points, "--y", "up", "--between", "25", "-o", out]) == 0
    filled = read_tracks(out)
    assert set(filled["status"]) == {"measured", "predicted"}
    assert (filled["status"] == "measured").sum() == (table["status"] == "measured").sum()
    assert (filled["marker"] == "bow").sum() == 40
    assert (
        main(["import", source, *common, *points, "--y", "up", "--between", "25", "--largest-gap", "0", "-o", out]) == 1
    )
    assert "--largest-gap 0: a number above 0" in capsys.readouterr().err
    assert main(["import", source, *common, "--y", "up", "--marker", "bow", "-o", out]) == 1
    assert "NAME=ID is expected" in capsys.readouterr().err
    assert main(["import", source, "--from", "instruments", "-o", out]) == 1
    assert "--setup" in capsys.readouterr().err


def test_programs_are_told_apart(tmp_path: Path) -> None:
    truth = Truth()
    for program, name, write in FORMATS.values():
        write(tmp_path / name, truth)
        assert program_of(tmp_path / name) == program
