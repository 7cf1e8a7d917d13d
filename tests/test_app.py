"""The page's state and logic, without a browser: its document and form, folders and jobs."""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towline.app.document import Document
from towline.app.form import parsed, row_fields, tables
from towline.app.motion_view import curves, marks_at, value_at
from towline.app.places import inside, place, places_below
from towline.app.session import Session
from towline.app.worker import Worker
from towline.record import InputError, read_motion, read_run, read_tracks
from towline.record.schema import RunFile

# the document ---------------------------------------------------------------------------------------------------------


def test_edits_of_a_person_keep_what_stands_around_them(tmp_path: Path) -> None:
    text = (
        "# our tank\n"
        'name = "a"   # the afternoon\n'
        "\n[source] # where\n"
        'video = "v.mp4"\n'
        "\n[tow]\n"
        "speed_m_s = 1.2   # by the carriage's own display\n"
        "# rope bought in March\n"
        "line_length_m = 0.9\n"
        "\n# the hull\n[model]\nlength_pp_m = 2.0\n"
    )
    document = Document(tmp_path, text, text)
    document.set(("tow", "speed_m_s"), 1.25)
    document.set(("tow", "tow_point_m"), 1.1)
    document.set(("model", "mass_kg"), 78.0)
    document.add_row("datum", {"name": "far", "pixel_px": [1.5, 2.0], "tank_m": [0.0, 0.0, 0.0]})
    for comment in re.findall(r"#.*", text):
        assert comment in document.text
    assert document.content["tow"] == {"speed_m_s": 1.25, "line_length_m": 0.9, "tow_point_m": 1.1}
    assert document.content["datum"][0]["pixel_px"] == [1.5, 2.0]
    kept = [line for line in text.splitlines() if line and not line.startswith("speed_m_s")]
    assert [line for line in document.text.splitlines() if line in kept] == kept


def test_a_new_run_is_filled_in_where_the_template_has_its_comments(tmp_path: Path) -> None:
    document = Document.new(tmp_path, "video.mp4")
    before = document.text.splitlines()
    document.set(("tow", "speed_m_s"), 1.28)
    document.set(("camera", "fx_px"), 920.0)
    after = document.text.splitlines()
    assert len(after) == len(before)
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert [new.split()[0] for _, new in changed] == ["[camera]", "fx_px", "speed_m_s"]
    assert all(new.partition("#")[2].strip() in old for old, new in changed)
    document.set(("tow", "speed_m_s"), None)
    assert "speed_m_s" not in document.content["tow"]
    assert "# carriage speed U" in next(line for line in document.text.splitlines() if "# speed_m_s" in line)


@pytest.mark.slow
def test_any_edits_give_what_was_asked_for_and_are_taken_back_one_by_one(tmp_path: Path) -> None:
    """Random edits of random keys, against a plain dictionary."""
    fields = [field for table in tables() for field in table.fields if field.kind in ("number", "text")]
    for seed in range(20):
        rng = np.random.default_rng(seed)
        document = Document.new(tmp_path, "video.mp4")
        texts = [document.text]
        for _ in range(25):
            action = rng.integers(4)
            rows = document.rows("datum")
            if action == 0:
                document.add_row("datum", {"name": f"p{rng.integers(100)}", "pixel_px": rng.uniform(0, 99, 2).tolist()})
            elif action == 1 and rows:
                document.remove_row("datum", int(rng.integers(len(rows))))
                assert len(document.rows("datum")) == len(rows) - 1
            elif action == 2 and rows:
                number = int(rng.integers(len(rows)))
                document.set(("datum", number, "tank_m"), [0.5, 1.0, 0.0])
                assert document.get("datum", number, "tank_m") == [0.5, 1.0, 0.0]
            else:
                field = fields[rng.integers(len(fields))]
                value: Any = float(rng.uniform(0, 9)) if field.kind == "number" else 'a "b" # c'
                value = None if rng.random() < 0.3 and len(field.where) > 1 else value
                document.set(field.where, value)
                assert document.get(*field.where) == value
            assert tomllib.loads(document.text) == document.content
            if document.text != texts[-1]:
                texts.append(document.text)
        for text in reversed(texts[:-1]):
            assert document.undo()
            assert document.text == text
        assert document.undo() == ""
        for text in texts[1:]:
            assert document.redo()
            assert document.text == text


def test_saving_is_what_the_commands_read(run_folder: Path) -> None:
    document = Document.open(run_folder)
    before = (run_folder / "run.toml").read_text()
    assert not document.dirty
    document.set(("tow", "speed_m_s"), 1.3)
    assert document.dirty
    assert (run_folder / "run.toml").read_text() == before
    document.save()
    assert not document.dirty
    assert read_run(run_folder).tow.speed_m_s == 1.3
    assert sorted(path.name for path in run_folder.iterdir()) == ["run.toml", "video.mp4"]
    document.undo()
    assert document.dirty
    document.save()
    assert (run_folder / "run.toml").read_text() == before
    assert not document.changed_outside()
    (run_folder / "run.toml").write_text(before + "# somebody else\n")
    assert document.changed_outside()


def test_faults_carry_their_keys(run_folder: Path) -> None:
    document = Document.open(run_folder)
    assert document.faults() == {}
    document.set(("datum", 1, "tank_m"), None)
    document.set(("tow", "speed_m_s"), 1280.0)
    assert document.faults() == {
        'datum[2 "far_starboard"].tank_m': "missing key",
        "tow.speed_m_s": "1280 is outside 0 .. 30 m/s (carriage speed; is it in mm/s?)",
    }
    with pytest.raises(InputError, match=r"datum\[2"):
        document.run()
    new = Document.new(run_folder, "video.mp4").faults()
    assert set(new) == {
        "tow.speed_m_s",
        "tow.line_length_m",
        "tow.tow_point_m",
        "model.length_pp_m",
        "model.mass_kg",
        "datum",
        "marker",
    }
    assert new["datum"] == "0 points, at least 4 are needed"


# the form -------------------------------------------------------------------------------------------------------------


def test_the_form_has_every_key_of_the_schema(table_in: Callable[[Any], Any]) -> None:
    """Walked anew here: every leaf of RunFile is a field with words."""

    def leaves(model: Any, prefix: str) -> set[str]:
        found = set()
        for name, field in model.model_fields.items():
            inner = table_in(field.annotation)
            found |= {prefix + name} if inner is None else leaves(inner, f"{prefix}{name}.")
        return found

    fields = [field for table in tables() for field in table.fields]
    fields += [field for array in ("datum", "marker") for field in row_fields(array)]
    assert {field.key for field in fields} == leaves(RunFile, "")
    assert all(field.words for field in fields)
    units = {field.key: field.unit for field in fields}
    assert units["tow.speed_m_s"] == "m/s"
    assert units["water.density_kg_m3"] == "kg/m³"
    assert units["priors.derivatives.y_v.value"] == "N s/m"


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("tow.speed_m_s", "1280", "is it in mm/s?"),
        ("tow.speed_m_s", "1,28", "a point stands before the decimals"),
        ("model.mass_kg", "-2", "greater than 0"),
        ("tow.rudder_rad", "10", "is it in degrees?"),
        ("source.span_s", "3", "2 are expected"),
        ("camera.image_size_px", "800.5, 600", "whole number"),
        ("tow.tension_n", "nan", "not a finite number"),
    ],
)
def test_wrong_texts_are_refused_in_the_schemas_words(key: str, text: str, said: str) -> None:
    field = next(f for table in tables() for f in table.fields if f.key == key)
    with pytest.raises(ValueError, match=re.escape(said)):
        parsed(field, text)


def test_what_is_shown_is_parsed_back(run_folder: Path) -> None:
    from towline.app.form import shown

    document = Document.open(run_folder)
    for table in tables():
        for field in table.fields:
            value = document.get(*field.where)
            assert parsed(field, shown(value)) == value, field.key


# folders and files ----------------------------------------------------------------------------------------------------


def test_paths_stay_inside_the_folder(tmp_path: Path) -> None:
    (tmp_path / "run" / "out").mkdir(parents=True)
    (tmp_path / "secret.txt").write_text("no")
    (tmp_path / "run" / "out" / "page.html").write_text("yes")
    (tmp_path / "run" / "link.txt").symlink_to(tmp_path / "secret.txt")
    (tmp_path / "run" / "door").symlink_to(tmp_path)
    folder = tmp_path / "run"
    assert inside(folder, "out/page.html").read_text() == "yes"
    assert inside(folder, "out/../out/page.html").read_text() == "yes"
    for name in (
        "../secret.txt",
        "link.txt",
        "door/secret.txt",
        str(tmp_path / "secret.txt"),
        "",
        "a\0b",
        "nothing.txt",
        "out",
    ):
        with pytest.raises(InputError):
            inside(folder, name)


def test_folders_are_found_and_named(tmp_path: Path, run_folder: Path) -> None:
    (tmp_path / "fresh").mkdir()
    (tmp_path / "fresh" / "tow.MP4").write_bytes(b"x")
    (tmp_path / "empty").mkdir()
    (run_folder / "out").mkdir()
    (run_folder / "out" / "overlay.mp4").write_bytes(b"x")
    found = {p.folder.name: (p.has_run, p.videos) for p in places_below(tmp_path)}
    assert found == {"fresh": (False, ("tow.MP4",)), "x1446": (True, ("video.mp4",))}
    assert place(str(run_folder / "run.toml")).has_run
    for wrong in (tmp_path / "empty", tmp_path / "nowhere", ""):
        with pytest.raises(InputError):
            place(wrong)


def test_a_desk_begins_a_run_where_there_is_only_a_video(session: Session, run_folder: Path) -> None:
    (run_folder / "run.toml").unlink()
    session.open(run_folder)
    assert session.dirty
    assert session.doc.get("source", "video") == "video.mp4"
    assert not (run_folder / "run.toml").exists()
    found = session.snap(0, (261.5, 133.0))
    assert found.found
    assert session.pick_datum(found) == 0
    assert "tank_m" not in session.doc.rows("datum")[0]  # nobody measured it yet
    session.selected["datum"] = 0
    session.pick_datum(session.snap(0, (559.0, 142.0)))
    assert len(session.doc.rows("datum")) == 1
    session.doc.undo()
    assert session.doc.rows("datum")[0]["pixel_px"] == pytest.approx(found.pixel_px, abs=1e-3)


# jobs -----------------------------------------------------------------------------------------------------------------


def _wait(worker: Worker, until_s: float = 40.0) -> Any:
    end = time.monotonic() + until_s
    while worker.poll().running:
        assert time.monotonic() < end
        time.sleep(0.02)
    return worker.poll()


@pytest.mark.slow
def test_jobs_run_beside_the_page_and_can_be_stopped(session: Session, run_folder: Path, tmp_path: Path) -> None:
    worker = Worker()
    try:
        assert worker.start("track", [tmp_path / "nowhere"])
        assert not worker.start("track", [run_folder])  # one at a time
        assert "no such run folder" in _wait(worker).error
        assert worker.start("track", [run_folder])
        seen = []
        while len(seen) < 2:
            status = worker.poll()
            assert status.running
            if status.total and status.done not in seen:
                seen.append(status.done)
        worker.stop()
        status = _wait(worker, 10.0)
        assert status.stopped
        assert not (run_folder / "out" / "motion.csv").exists()
        assert worker.start("track", [run_folder])
        status = _wait(worker)
        assert status.error == ""
        assert "motion in 1200 of 1200 frames" in status.found.sentences[0]
    finally:
        worker.close()
    motion = read_motion(run_folder / "out" / "motion.csv")
    data = curves(motion)
    assert [panel["unit"] for panel in data["panels"]] == ["deg", "deg", "mm"]
    assert len(data["t"]) == len(data["panels"][0]["y"]) == 1200
    assert data["panels"][2]["y"][0] == pytest.approx(1e3 * motion["y_cg_m"].iloc[0], abs=0.01)
    assert f"{1e3 * motion['y_cg_m'].iloc[30]:+.1f} mm" in value_at(motion, 1.0)
    assert value_at(motion, 99.0) == "not analysed at this time"
    places, trails = marks_at(read_tracks(run_folder / "out" / "tracks.csv"), 50)
    assert set(places) == {"bow", "stern"}
    assert all(len(trail) == 40 for trail in trails.values())
    assert session.shown().current
    session.doc.set(("tow", "tow_point_m"), 1.4)
    session.save()
    assert not session.shown().current
    assert "track again" in session.shown().words
