"""What people in the tank hall type first: init, doctor, completion; and what their scripts read: --json."""

from __future__ import annotations

import argparse
import importlib.metadata
import io
import json
import math
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from towline.cli import command_parser, machine, main
from towline.cli.ask import numbers
from towline.cli.outcome import Outcome, plain
from towline.record import RunFile, read_run
from towline.record.template import ASSUMED, EXAMPLE, PLACEHOLDER, checked_value, field_of, run_text

HELP_S = 0.3
"""``towline --help`` answers within this time."""
OUTCOME_KEYS = {"command", "exit_code", "wrote", "failed", "result"}
MARINER = ["--speed", "1.28", "--line-length", "0.91", "--tow-point", "1.446", "--tension", "3.96"]
MARINER += ["--length", "2.66", "--mass", "78", "--tank-width", "4.6"]
MARKS = ["--mark", "bow", "1.2", "0", "0.12", "--mark", "stern", "-1.1", "0", "0.13"]


def commands() -> dict[str, argparse.ArgumentParser]:
    return next(a.choices for a in command_parser()._actions if isinstance(a, argparse._SubParsersAction))


def said_as_json(capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    """The one object on standard output, and standard error."""
    said = capsys.readouterr()
    assert said.out.count("\n") == 1
    return json.loads(said.out), said.err


@pytest.fixture
def filmed(samples: Path, tmp_path: Path) -> Path:
    """A folder with a video, 800 x 600, and nothing else."""
    folder = tmp_path / "hall é"
    folder.mkdir()
    shutil.copy(samples / "mariner" / "x1446" / "video.mp4", folder / "video.mp4")
    return folder


@pytest.fixture
def tracked(tmp_path: Path) -> Path:
    """A folder with tracks of two marks that stand still in a picture of 400 x 300."""
    folder = tmp_path / "tracks"
    folder.mkdir()
    lines = ["frame,t_s,marker,u_px,v_px,sigma_u_px,sigma_v_px,status"]
    for k in range(40):
        for name, u, v in (("bow", 200.0, 80.0), ("stern", 200.0, 220.0)):
            lines.append(f"{k},{k / 30:.6f},{name},{u},{v},0.05,0.05,measured")
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture
def moved(samples: Path, tmp_path: Path) -> Path:
    """A folder with a simulated motion of 40 s."""
    folder = tmp_path / "moved"
    assert (
        main(
            [
                "simulate",
                str(samples / "mariner" / "x1446" / "scenario.toml"),
                "-o",
                str(folder / "motion.csv"),
                "--line",
                "surge",
            ]
        )
        == 0
    )
    return folder


class Terminal(io.StringIO):
    """Somebody who types these lines."""

    def isatty(self) -> bool:
        return True


def typed(monkeypatch: pytest.MonkeyPatch, *lines: str) -> Terminal:
    terminal = Terminal("".join(f"{line}\n" for line in lines))
    monkeypatch.setattr(sys, "stdin", terminal)
    return terminal


def picked(folder: Path) -> None:
    """The template's datum points as somebody leaves them who has picked them: other pixels, names and no spread."""
    path = folder / "run.toml"
    text = re.sub(r"^(sigma_px|tank_sd_m) = .*\n", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    text = re.sub(r"^pixel_px = \[(\S+), ", lambda m: f"pixel_px = [{float(m[1]) + 3.5}, ", text, flags=re.MULTILINE)
    path.write_text(text.replace(PLACEHOLDER, ""), encoding="utf-8")


# --json ----------------------------------------------------------------------------------------------------------


def test_every_command_takes_json_before_and_after_its_name() -> None:
    for name, sub in commands().items():
        option = next(a for a in sub._actions if "--json" in a.option_strings)
        assert option.default is argparse.SUPPRESS, f"{name} would undo towline --json {name}"
    assert command_parser().parse_args(["--json", "doctor"]).json
    assert command_parser().parse_args(["doctor", "--json"]).json
    assert not command_parser().parse_args(["doctor"]).json


def test_a_summary_becomes_one_object(samples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = str(samples / "mariner" / "x1446" / "scenario.toml")
    target = tmp_path / "motion é.csv"
    found = []
    for arguments in (["--json", "simulate"], ["simulate", "--json"]):
        assert main([*arguments, scenario, "-o", str(target)]) == 0
        found.append(said_as_json(capsys)[0])
    assert found[0] == found[1]
    assert set(found[0]) == OUTCOME_KEYS
    assert found[0]["command"] == "simulate"
    assert found[0]["exit_code"] == 0
    assert found[0]["failed"] == {}
    assert found[0]["wrote"] == [str(target)]
    assert target.is_file()
    assert found[0]["result"]["samples"] == 1200
    assert not found[0]["result"]["stability"]["stable"]
    assert main(["simulate", scenario, "-o", str(target)]) == 0
    assert f"wrote {target}: 1200 samples" in capsys.readouterr().out


@pytest.mark.slow
def test_the_derivatives_are_those_of_the_file_and_a_bad_run_is_named(
    moved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """init, then identify: the object holds what derivatives.json holds, and why the empty folder failed."""
    assert main(["init", str(moved), "--yes", *MARINER]) == 0
    bad = tmp_path / "bad"
    bad.mkdir()
    capsys.readouterr()
    out = tmp_path / "out"
    assert main(["identify", str(moved), str(bad), "-o", str(out), "--no-page", "--json"]) == 3
    found, errors = said_as_json(capsys)
    assert found["exit_code"] == 3
    assert list(found["failed"]) == [str(bad)]
    assert "no such file" in found["failed"][str(bad)]
    assert f"towline: failed: {bad}" in errors
    assert found["wrote"] == [str(out / "derivatives.json")]
    assert found["result"]["derivatives"] == json.loads((out / "derivatives.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("command", ["track", "motion"])
def test_a_run_is_found_by_its_name(tracked: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(tracked), "--yes", "--name", "still", "--kind", "free", "--size", "400x300"]) == 0
    picked(tracked)
    capsys.readouterr()
    assert main([command, str(tracked), "--json"]) == 0
    found, _ = said_as_json(capsys)
    assert list(found["result"]) == ["still"]
    if command == "track":  # tracks of another program's are only read
        assert found["wrote"] == []
        seen = found["result"]["still"]["markers"]
        assert [(m["marker"], m["frames"], m["measured"], m["lost"]) for m in seen] == [
            ("bow", 40, 40, {}),
            ("stern", 40, 40, {}),
        ]
    else:
        assert [Path(path).name for path in found["wrote"]] == ["marks.csv", "motion.csv", "camera.json"]
        assert all(Path(path).is_file() for path in found["wrote"])
        assert found["result"]["still"]["measured"] == 40
        camera = json.loads((tracked / "out" / "camera.json").read_text(encoding="utf-8"))
        assert found["result"]["still"]["camera"] == camera


def test_errors_are_objects_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(tmp_path / "none.json"), "--reference", "ittc", "--json"]) == 1
    found, errors = said_as_json(capsys)
    assert found == {"command": "compare", "exit_code": 1, "error": f"{tmp_path / 'none.json'}: no such file"}
    assert errors == f"towline: error: {found['error']}\n"
    # all runs failed: why each one did
    assert main(["motion", str(tmp_path / "a"), str(tmp_path / "b"), "--json"]) == 1
    found, errors = said_as_json(capsys)
    assert set(found["failed"]) == {str(tmp_path / "a"), str(tmp_path / "b")}
    with pytest.raises(SystemExit) as caught:
        main(["identify", "--json"])
    assert caught.value.code == 2
    found, errors = said_as_json(capsys)
    assert found == {"command": "identify", "exit_code": 2, "error": "the following arguments are required: RUN"}
    assert "usage: towline identify" in errors
    assert main(["--json"]) == 2
    assert said_as_json(capsys)[0]["exit_code"] == 2
    with pytest.raises(SystemExit):
        main(["identify"])
    assert capsys.readouterr().out == ""


def test_a_fault_of_the_program_is_an_object_and_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(folder: Path) -> list[machine.Item]:
        print("half a line", end="")
        raise ValueError(f"of two\nlines in {folder}")

    monkeypatch.setattr(machine, "looked_at", fails)
    with pytest.raises(ValueError, match="of two"):
        main(["doctor", "--json"])
    found, _ = said_as_json(capsys)
    assert found == {"command": "doctor", "exit_code": 1, "error": "ValueError: of two lines in ."}


def test_no_command_says_what_it_wrote_by_itself(root: Path) -> None:
    """Else the object of --json would not name the file: ``options.outcome.wrote`` says it both ways."""
    for path in (root / "cli").glob("*.py"):
        assert not re.search(r"print\(f?[\"'](wrote|page:)", path.read_text(encoding="utf-8")), path.name


def test_words_go_nowhere_with_json(capsys: pytest.CaptureFixture[str]) -> None:
    for as_json, words in ((True, ""), (False, "for people\nwrote a, b\n")):
        outcome = Outcome("x", as_json)
        with outcome.speaking():
            print("for people")
            outcome.wrote("a", Path("b"))
        assert capsys.readouterr().out == words
        outcome.close(0)
        said = capsys.readouterr().out
        assert (json.loads(said)["wrote"] == ["a", "b"]) if as_json else said == ""


@dataclass(frozen=True)
class Found:
    name: str
    values: np.ndarray


def test_everything_has_its_json() -> None:
    nan = math.nan
    given = {
        "path": Path("a/b"),
        "numbers": (1, 2.5, nan, math.inf, True, None),
        "numpy": [np.float64(1.5), np.int64(3), np.bool_(True), np.float64(nan)],
        "object": Found("x", np.array([[1.0, nan], [2.0, 3.0]])),
        "set": frozenset({"b", "a"}),
        "complex": np.array([1 + 2j]),
        7: "a number as key",
    }
    found = json.loads(json.dumps(plain(given), allow_nan=False))
    assert found == {
        "path": "a/b",
        "numbers": [1, 2.5, None, None, True, None],
        "numpy": [1.5, 3, True, None],
        "object": {"name": "x", "values": [[1.0, None], [2.0, 3.0]]},
        "set": ["a", "b"],
        "complex": [[1.0, 2.0]],
        "7": "a number as key",
    }
    with pytest.raises(TypeError, match="no JSON for object"):
        plain(object())


# init ------------------------------------------------------------------------------------------------------------


def test_a_towed_video(filmed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(filmed), "--yes", *MARINER, *MARKS, "--json"]) == 0
    said, errors = said_as_json(capsys)
    assert errors == ""
    assert said["wrote"] == [str(filmed / "run.toml")]
    run = read_run(filmed)
    file, tow = run.file, run.tow
    assert (file.name, file.kind, file.source.video) == ("hall é", "tow", "video.mp4")
    assert (tow.speed_m_s, tow.line_length_m, tow.tow_point_m, tow.tension_n) == (1.28, 0.91, 1.446, 3.96)
    assert (run.model.length_pp_m, run.model.mass_kg, run.water.tank_width_m) == (2.66, 78.0, 4.6)
    assert [(m.name, m.body_m, m.depth_m) for m in file.marker] == [
        ("bow", (1.2, 0.0), 0.12),
        ("stern", (-1.1, 0.0), 0.13),
    ]
    # the picture is 800 x 600, found in the video; the points stand at 0.3 and 0.1 of its width, 0.2 and 0.9 of its height
    assert [p.pixel_px for p in file.datum] == [(240.0, 120.0), (560.0, 120.0), (80.0, 540.0), (720.0, 540.0)]
    assert all(p.name.startswith(PLACEHOLDER) for p in file.datum)
    assert said["result"]["run"]["tow"]["tension_n"] == 3.96
    assert any("datum" in line for line in said["result"]["todo"])
    # what nobody gave is marked in the file, and only that
    text = (filmed / "run.toml").read_text(encoding="utf-8")
    marked = [line.split(" =")[0] for line in text.splitlines() if ASSUMED in line]
    assert marked == ["kind", "density_kg_m3"]
    assert "kind, water.density_kg_m3" in said["result"]["todo"][1]


@pytest.mark.parametrize("kind", ["tow", "free", "forced"])
@pytest.mark.parametrize("source", ["filmed", "tracked", "moved"])
def test_defaults_alone_make_a_file_that_can_be_read(source: str, kind: str, request: pytest.FixtureRequest) -> None:
    folder: Path = request.getfixturevalue(source)
    assert main(["init", str(folder), "--yes", "--kind", kind]) == 0
    run = read_run(folder)
    assert run.file.kind == kind
    wanted = {"filmed": "video.mp4", "tracked": "tracks.csv", "moved": "motion.csv"}[source]
    assert run.file.source.file == wanted
    assert (run.file.source.motion is None) == (source != "moved")
    assert len(run.file.datum) == (0 if source == "moved" else 4)
    assert len(run.file.marker) == (0 if source == "moved" else 2)
    assert (run.tow.line_length_m is None) == (kind == "free")
    assert (run.tow.post_frequency_hz > 0) == (kind == "forced")
    assert not [path for path in folder.iterdir() if path.name not in ("run.toml", wanted)]


@pytest.mark.parametrize("kind", ["tow", "free"])
def test_every_key_stands_in_the_file_with_the_schemas_words(
    table_in: Callable[[Any], Any], filmed: Path, kind: str
) -> None:
    assert main(["init", str(filmed), "--yes", "--kind", kind]) == 0
    text = (filmed / "run.toml").read_text(encoding="utf-8")
    for name, field in of_one_camera().items():
        model = table_in(field.annotation)
        for key, inner in {name: field}.items() if model is None else model.model_fields.items():
            if table_in(inner.annotation) is None:
                line = rf"^(# )?{key} = .*{re.escape(str(inner.description))}$"
                assert re.search(line, text, re.MULTILINE), f"{name}.{key}"


def test_a_comment_taken_out_changes_nothing(filmed: Path) -> None:
    """What stands as `# key = value` in a table that is there is the default itself."""
    assert main(["init", str(filmed), "--yes", *MARINER]) == 0
    path = filmed / "run.toml"
    before = read_run(filmed).file
    lines, out, taken = path.read_text(encoding="utf-8").splitlines(), [], 0
    inside = True
    for line in lines:
        if re.match(r"(# )?\[", line):
            inside = not line.startswith("#")
        if inside and EXAMPLE not in line and (match := re.match(r"# (\w+ = .*)", line)):
            line = match[1]
            taken += 1
        out.append(line)
    assert taken > 10
    path.write_text("\n".join(out), encoding="utf-8")
    assert read_run(filmed).file == before


ONE_OF = {
    "source": "exactly one of video, tracks, motion is needed",
    "tow": "tension_n and tension are both given",
    "model": "yaw_inertia_kg_m2 and gyration_k2_m2 are both given",
}
"""Keys of which one is expected: the only faults of a template whose every key is put in force."""


def of_one_camera() -> dict[str, Any]:
    """The tables of run.toml that ``towline init`` writes of one recording; two cameras stand instead of some of them."""
    return {name: field for name, field in RunFile.model_fields.items() if name != "cameras"}


def in_force(text: str) -> str:
    """The text with one ``#`` taken off every line, as an editor does it to a selection."""
    return re.sub(r"^# ?", "", text, flags=re.MULTILINE)


def tupled(value: Any) -> Any:
    """Lists as the tuples that the schema's strict tables hold."""
    if isinstance(value, dict):
        return {key: tupled(inner) for key, inner in value.items()}
    return tuple(map(tupled, value)) if isinstance(value, list) else value


def faults_of(content: dict[str, Any]) -> dict[str, str]:
    """What the schema has against the tables, by the place."""
    try:
        RunFile.model_validate(tupled(content))
    except ValidationError as error:
        return {".".join(map(str, fault["loc"])): fault["msg"] for fault in error.errors(include_url=False)}
    return {}


@pytest.mark.parametrize("kind", ["tow", "free", "forced"])
@pytest.mark.parametrize("source", ["filmed", "tracked", "moved"])
def test_the_template_with_every_comment_taken_out_is_a_run_toml(
    source: str, kind: str, table_in: Callable[[Any], Any], request: pytest.FixtureRequest
) -> None:
    """It parses, holds every table and key of the schema, and nothing is wrong with it but keys that exclude one another."""
    folder: Path = request.getfixturevalue(source)
    assert main(["init", str(folder), "--yes", "--kind", kind]) == 0
    text = (folder / "run.toml").read_text(encoding="utf-8")
    content = tomllib.loads(in_force(text))
    faults = faults_of(content)
    assert set(faults) == set(ONE_OF)
    assert all(ONE_OF[where] in said for where, said in faults.items())
    for name, field in of_one_camera().items():
        model, rows = table_in(field.annotation), content[name]
        if model is not None:
            first = rows[0] if field.default == () else rows
            assert set(first) == set(model.model_fields), name


def test_each_key_of_the_template_can_be_put_in_force_alone(filmed: Path) -> None:
    """With its table's header and what that needs: the file as a whole holds, but for a second source."""
    assert main(["init", str(filmed), "--yes", *MARINER]) == 0
    lines = (filmed / "run.toml").read_text(encoding="utf-8").splitlines()
    header, tried = "", 0
    for number, line in enumerate(lines):
        if re.match(r"(# )?\[", line):
            header = line
        if not re.match(r"# \w+ = ", line):
            continue
        new = list(lines)
        new[number] = line[2:]
        if header.startswith("# "):  # a table that was left out is put in force whole
            at = lines.index(header)
            end = next(i for i in range(at, len(lines) + 1) if i == len(lines) or not lines[i].strip())
            new[at:end] = [row.removeprefix("# ") for row in lines[at:end]]
        faults = faults_of(tomllib.loads("\n".join(new)))
        expected = {"source"} if re.match(r"# (tracks|motion) =", line) else set()
        expected |= {"tow"} if re.match(r"# tension =", line) else set()  # MARINER gives tension_n
        assert set(faults) == expected, line
        tried += 1
    assert tried > 40


@pytest.mark.parametrize("command", ["track", "motion", "check", "identify", "run", "rectify", "diagnose", "steady"])
def test_an_untouched_datum_is_named_before_anything_is_computed(
    filmed: Path, command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line: file, point and key, what was expected; no frame is read for it."""

    def reads(*_: object) -> None:
        raise AssertionError("a frame was read")

    assert main(["init", str(filmed), "--yes", *MARINER]) == 0
    capsys.readouterr()
    monkeypatch.setattr("towline.pipeline.stages.tracks.frames_of", reads)
    monkeypatch.setattr("towline.report.rectify.rectify", reads)
    assert main([command, str(filmed)]) == 1
    assert capsys.readouterr().err.splitlines() == [
        f'towline: error: {filmed / "run.toml"}: datum[1 "TODO_far_port"].name: is still the example of towline init, which '
        "nobody picked; expected: the point's own name, pixel_px picked in the picture and tank_m measured in the tank, "
        "without sigma_px = 100 and tank_sd_m = 1"
    ]
    assert not (filmed / "out").exists()


def test_a_datum_half_touched_is_named_by_what_was_left(tracked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(tracked), "--yes", "--size", "400x300"]) == 0
    path = tracked / "run.toml"
    path.write_text(path.read_text(encoding="utf-8").replace(PLACEHOLDER, ""), encoding="utf-8")
    capsys.readouterr()
    assert main(["motion", str(tracked)]) == 1
    assert 'datum[1 "far_port"].sigma_px: 100, and tank_sd_m = 1, are still' in capsys.readouterr().err
    picked(tracked)
    assert main(["motion", str(tracked)]) == 0


def test_names_with_any_letters(filmed: Path) -> None:
    for name in ('a "quoted" \\ name', "Modell Nr. 7 – Überführung", "tab\tand # hash", "'''", "船"):
        assert main(["init", str(filmed), "--yes", "--force", f"--name={name}"]) == 0
        assert read_run(filmed).name == name


def test_what_is_there_stays(filmed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = filmed / "run.toml"
    path.write_text("mine")
    assert main(["init", str(filmed), "--yes"]) == 1
    assert "is there already; --force replaces it" in capsys.readouterr().err
    assert path.read_text() == "mine"
    # an answer that cannot be used leaves it as it was, too
    for words, message in (
        (["--speed", "1280"], "tow.speed_m_s: --speed 1280: 1280 is outside 0 .. 30 m/s"),
        (["--speed", "fast"], "--speed fast: a number, like 1.28, is expected"),
        (["--speed", "nan"], "--speed nan: a number, like 1.28, is expected"),
        (["--line-length=-1"], "a positive length; is it in mm?"),
        (["--kind", "sailed"], "kind: --kind sailed: "),
        (["--tension", "cell.csv"], "tow.tension_n: --tension cell.csv: a file is expected"),
        (["--video", "other.mp4"], "source.video: --video other.mp4: a file is expected"),
        (["--size", "800"], "2 numbers"),
        (["--size", "800.5 600"], "two whole numbers above 0"),
        (["--mark", "a", "1", "0", "0", "--mark", "a", "0", "0", "0"], "marker: two are called 'a'"),
        (["--mark", "a", "x", "0", "0", "--mark", "b", "0", "0", "0"], "marker.1.body_m: --mark x 0: 2 numbers"),
    ):
        assert main(["init", str(filmed), "--yes", "--force", *words]) == 1
        said = capsys.readouterr().err
        assert message in said, words
        assert said.count("\n") == 1
        assert path.read_text() == "mine"
    assert sorted(p.name for p in filmed.iterdir()) == ["run.toml", "video.mp4"]
    assert main(["init", str(filmed), "--yes", "--force"]) == 0
    assert read_run(filmed).name == "hall é"


def test_files_lie_in_the_folder_or_where_they_are_named(
    filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (filmed / "tension.csv").write_text("t_s,tension_n\n0,4\n1,4\n")
    monkeypatch.chdir(tmp_path)
    assert main(["init", "hall é", "--yes"]) == 0
    assert read_run(filmed).tow.tension == "tension.csv"
    assert main(["init", "second", "--yes", "--video", "hall é/video.mp4", "--tension", "hall é/tension.csv"]) == 0
    run = read_run(tmp_path / "second")
    assert run.file.source.video == "../hall é/video.mp4"
    assert run.tow.tension == "../hall é/tension.csv"
    assert run.tow.tension_n is None


def test_without_a_terminal_every_answer_must_be_there(
    filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("1.28\n"))
    given = ["--name", "n", "--kind", "free", "--video", "video.mp4", "--length", "2", "--mass", "30"]
    given += ["--density", "1000", "--tank-width", "none", *MARKS]
    assert main(["init", str(filmed), *given]) == 1
    assert capsys.readouterr().err == (
        f"towline: error: {filmed / 'run.toml'}: tow.speed_m_s: no answer, and no terminal to ask on; "
        "give --speed, or take the default '1' with --yes\n"
    )
    assert not (filmed / "run.toml").exists()
    assert main(["init", str(filmed), *given, "--speed", "1.28"]) == 0
    assert ASSUMED not in (filmed / "run.toml").read_text(encoding="utf-8")
    empty = tmp_path / "empty"
    empty.mkdir()
    capsys.readouterr()
    assert main(["init", str(empty), "--yes"]) == 1
    assert "source: there is no default; give --video, --tracks or --motion FILE" in capsys.readouterr().err
    assert list(empty.iterdir()) == []


def test_a_talk_on_the_terminal(
    filmed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = typed(
        monkeypatch,
        "",  # name
        "towed",  # no kind
        "tow",
        "film.mp4",  # not there
        "",  # video.mp4
        "2.66",
        "78 kg",  # no number
        "1,28",  # no number either: a point is expected
        "78",
        "",  # density
        "none",
        "1280",  # out of range: mm/s
        "1.28",
        "0.91",
        "1.446",
        "3.96",
        "",  # bow
        "1.2",  # two numbers are asked for
        "1.2, 0",
        "0.12",
        "aft",
        "-1.1 0",
        "0.13",
    )
    assert main(["init", str(filmed)]) == 0
    assert terminal.read() == ""
    said = capsys.readouterr()
    assert said.err.count("kind of run") == 2
    assert said.err.count("carriage speed, m/s [1]: ") == 2
    assert "'1280': 1280 is outside 0 .. 30 m/s (carriage speed; is it in mm/s?)" in said.err
    assert "'1,28': a number, like 1.28, is expected" in said.err
    assert "'78 kg': a number, like 1.28, is expected" in said.err
    assert "'film.mp4': a file is expected; there is none of this name in" in said.err
    assert "'1.2': 2 numbers, like 1.28, 0, is expected" in said.err
    assert said.out.startswith(f"wrote {filmed / 'run.toml'}\n")
    run = read_run(filmed)
    assert (run.name, run.tow.speed_m_s, run.model.mass_kg, run.tow.tension_n) == ("hall é", 1.28, 78.0, 3.96)
    assert [(m.name, m.body_m) for m in run.file.marker] == [("bow", (1.2, 0.0)), ("aft", (-1.1, 0.0))]
    # an empty answer on the terminal confirms the default: nothing is marked
    assert ASSUMED not in (filmed / "run.toml").read_text(encoding="utf-8")


def test_a_talk_that_ends_early_writes_nothing(
    filmed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typed(monkeypatch, "n", "tow")
    assert main(["init", str(filmed)]) == 1
    assert "source: the input ended before this was answered; nothing written" in capsys.readouterr().err
    assert [path.name for path in filmed.iterdir()] == ["video.mp4"]


def test_the_example_datum_gives_no_sure_number(tracked: Path) -> None:
    """Points that nobody picked, each known to a metre: y_CG's common error exceeds half of that."""
    from towline.geometry import motion_from_tracks, run_datum
    from towline.record import read_tracks

    for depth in ("0", "0.12"):
        words = ["--mark", "bow", "0.4", "0", depth, "--mark", "stern", "-0.4", "0", depth]
        assert main(["init", str(tracked), "--yes", "--force", "--size", "400,300", *words]) == 0
        run = read_run(tracked)
        found = motion_from_tracks(run, read_tracks(run.source_path), run_datum(run, (400, 300)))
        assert float(found.motion["common_y_cg_m"].median()) > 0.5


def test_numbers_and_the_schema_check_an_answer() -> None:
    assert numbers(" 1.28 ") == [1.28]
    assert numbers("1, -2", 2) == numbers("1 -2", 2) == numbers("1,-2", 2) == [1.0, -2.0]
    for text in ("", "1 2", "1,2", "inf", "nan", "x", "1.2.3"):
        with pytest.raises(ValueError, match=r"a number, like 1\.28, is expected"):
            numbers(text)
    assert checked_value("marker.body_m", (1.0, 0.0)) == (1.0, 0.0)
    assert field_of("tow.speed_m_s").description == "carriage speed U"
    with pytest.raises(ValueError, match="is it in mm"):
        checked_value("marker.body_m", (1200.0, 0.0))
    with pytest.raises(KeyError):
        field_of("tow.sped")
    assert tomllib.loads(run_text({"name": "x", "source": {"motion": "m.csv"}}, [])) == {
        "name": "x",
        "source": {"motion": "m.csv"},
    }


# doctor ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def no_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    """torch takes seconds to import; one test looks for it in earnest."""
    monkeypatch.setattr(machine, "_cuda", lambda: machine.Item("CUDA device", "-", "missing", False, "x", "y"))


@pytest.mark.usefixtures("no_cuda")
def test_a_machine_that_has_all(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(tmp_path), "--json"]) == 0
    found, _ = said_as_json(capsys)
    items = {item["name"]: item for item in found["result"]["items"]}
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    for line in project["dependencies"]:
        name = re.split(r"[>=]", line)[0]
        assert items[name]["needed"], name
        assert items[name]["status"] == "ok", name
        assert items[name]["found"] == importlib.metadata.version(name)
    optional = {r.name for r in machine.requirements() if r.extra}
    assert {"torch", "kornia", "dask", "nicegui"} <= optional
    assert "pytest" not in optional
    assert not any(items[name]["needed"] for name in optional)
    assert all(items[f"codec {name}"]["status"] == "ok" for name in ("h264", "hevc"))
    assert all(item["purpose"] for item in items.values())
    assert all(item["todo"] for item in items.values() if item["status"] != "ok")
    assert list(tmp_path.iterdir()) == []
    assert main(["doctor", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "ready"
    assert {line.split()[0] for line in lines[:-1]} <= {"ok", "missing", "old", "low"}


@pytest.mark.usefixtures("no_cuda")
@pytest.mark.parametrize(
    ("name", "version", "status", "code"),
    [
        ("numpy", None, "missing", 1),
        ("numpy", "1.26.4", "old", 1),
        ("numpy", "2.0", "ok", 0),
        ("torch", None, "missing", 0),
        ("torch", "2.12.1", "old", 0),
        ("torch", "2.13.0+cpu", "ok", 0),
    ],
)
def test_what_is_missing_is_said(
    name: str,
    version: str | None,
    status: str,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    real = machine._version
    monkeypatch.setattr(machine, "_version", lambda asked: version if asked == name else real(asked))
    assert main(["doctor", str(tmp_path), "--json"]) == code
    found, _ = said_as_json(capsys)
    item = next(item for item in found["result"]["items"] if item["name"] == name)
    assert item["status"] == status
    assert ("pip install" in item["todo"]) == (status != "ok")
    assert found["result"]["not_ready"] == ([name] if code else [])


@pytest.mark.usefixtures("no_cuda")
def test_a_folder_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(tmp_path / "none")]) == 1
    assert "not ready: free disk, folder" in capsys.readouterr().out


def test_another_opencv_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    versions = {"opencv-python": "5.0.0"}
    monkeypatch.setattr(machine, "_version", lambda name: versions.get(name))
    found = {item.name: item for item in machine._packages()}
    assert found["opencv-python-headless"].status == "ok"
    assert found["opencv-python-headless"].found == "5.0.0"
    assert found["av"].status == "missing"


@pytest.mark.parametrize(
    ("version", "wanted", "fits"),
    [
        ("2.10", ">=2.9", True),
        ("2.9", ">=2.10", False),
        ("2", ">=2.0.0", True),
        ("2.13.0+cpu", "==2.13.0", True),
        ("2.13.1", "==2.13.0", False),
        ("3.1", ">=2.0,<3", False),
        ("2.9.9", ">=2.0, <3", True),
        ("1.0", "", True),
        ("2.0rc1", ">=2.0", True),
    ],
)
def test_versions(version: str, wanted: str, fits: bool) -> None:
    assert machine.fits(version, wanted) is fits


def test_memory_is_below_what_the_machine_has() -> None:
    free = machine.free_memory_bytes()
    if free is None:
        pytest.skip("this system does not say how much memory is free")
    assert 0 < free < 1 << 50


def test_the_doctor_comes_where_packages_are_missing(tmp_path: Path) -> None:
    """Without any package at all it still answers; another command says in one line what is missing."""
    blocked = (
        "numpy",
        "pandas",
        "pydantic",
        "rich",
        "scipy",
        "cv2",
        "av",
        "torch",
        "tomlkit",
        "shtab",
        "pydantic_core",
    )
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({blocked!r})); from towline.cli import main; "
        "sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "doctor", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert done.returncode == 1
    assert "PyAV does not start" in done.stdout
    assert "not ready: codec h264, codec hevc" in done.stdout
    done = subprocess.run([sys.executable, "-c", code, "motion", "x"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert re.fullmatch(
        r"towline: error: the package \w+ is missing; towline doctor says what is needed\n", done.stderr
    )


# completion and help ---------------------------------------------------------------------------------------------

COMPLETE = r"""
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($#-1))
$(complete -p towline | sed 's/.*-F \([^ ]*\) .*/\1/') towline
printf '%s\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_knows_every_command(shell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for name in commands():
        assert re.search(rf"\b{name}\b", script), name
    assert "line-length" in script
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not here to read the script")
    path = tmp_path / "script"
    path.write_text(script, encoding="utf-8")
    option = "--no-execute" if shell == "fish" else "-n"
    assert subprocess.run([shell, option, str(path)], capture_output=True, check=False).returncode == 0


def test_bash_completes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if shutil.which("bash") is None:
        pytest.skip("bash is not here")
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "script"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    here = tmp_path / "here"
    (here / "run1").mkdir(parents=True)
    (here / "film.mp4").touch()

    def offered(*words: str) -> set[str]:
        done = subprocess.run(
            ["bash", "--norc", "-c", COMPLETE, "x", str(script), "towline", *words],
            cwd=here,
            capture_output=True,
            text=True,
            check=True,
        )
        return set(done.stdout.split())

    assert offered("") >= set(commands())
    assert offered("tra") == {"track"}
    assert offered("track", "--dev") == {"--device"}
    assert offered("track", "--device", "") == {"cpu", "cuda"}
    assert offered("track", "") >= {"run1"}
    assert "film.mp4" not in offered("track", "f")
    assert offered("init", "--video", "f") == {"film.mp4"}
    assert offered("completion", "") >= {"bash", "zsh", "fish"}


def test_help_is_quick_and_names_the_exit_codes() -> None:
    """The quickest of five: a busy machine may be slow, the program not."""
    took_s = []
    for _ in range(5):
        start_s = time.perf_counter()
        done = subprocess.run([sys.executable, "-m", "towline", "--help"], capture_output=True, text=True, check=True)
        took_s.append(time.perf_counter() - start_s)
    assert min(took_s) < HELP_S
    words = " ".join(done.stdout.split())
    assert "Exit codes: 0 done, 1 error, 2 wrong usage, 3 done but some runs failed, 130 interrupted." in words


def test_the_page_names_every_command(root: Path) -> None:
    page = (root / "docs" / "commands.md").read_text(encoding="utf-8")
    for name in commands():
        assert re.search(rf"^\| `towline {name}", page, re.MULTILINE), name
