"""The page's state and logic, without a browser."""

from __future__ import annotations

import ast
import asyncio
import os
import re
import socket
import stat
import subprocess
import sys
import time
import tomllib
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from towline.app.address import WaysIn
from towline.app.byhand import FILE, ByHand, begun
from towline.app.document import Document
from towline.app.form import parsed, row_fields, tables
from towline.app.frames import EXACT, Frames
from towline.app.guard import MOST_BODY, Guard
from towline.app.jumps import losses, next_of
from towline.app.motion_view import curves, marks_at, value_at
from towline.app.places import inside, page_file, place, places_below
from towline.app.playing import Player, other_speed
from towline.app.session import Session
from towline.app.sight import detected, sight
from towline.app.snap import CLICK_SIGMA_PX, snapped
from towline.app.worker import Worker
from towline.record import InputError, read_motion, read_run, read_tracks
from towline.record.corrections import read_corrections, text_of
from towline.record.schema import RunFile
from towline.vision.recording import Frame, read_frames

NOISE_DN = 3.0
BLUR_PX = 0.7
AT_THE_BOUND = {"_dot": 1.33, "_corner": 1.50}
"""Times the Cramer-Rao bound: 1.09 and 1.22 over 200 clicks (a corner is fitted in a smaller window than the bound takes), and
three times the 8 % by which the rms of 80 coordinates scatters."""
CODEC_PX = 0.15
"""Four times the 0.04 px rms that a mark of the samples lies off in the decoded picture."""


@pytest.fixture
def session(run_folder: Path) -> Iterator[Session]:
    """With that run open."""
    made = Session(run_folder)
    made.open(run_folder)
    yield made
    made.close()


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


# frames and snapping --------------------------------------------------------------------------------------------------


def test_every_frame_is_the_decoders(run_folder: Path) -> None:
    frames = Frames(run_folder / "video.mp4")
    try:
        early, sure = frames.jpeg(1150)  # before it was read
        assert early[:2] == b"\xff\xd8"
        assert not sure or frames.known(1150)
        # back from key frames; on from where the decoder stands, over frames that nothing else is made from, and next to them
        wanted = (440, 300, 299, 1, 0, 20, 21, 22, 23, 24, 61, 62, 121, 125, 299)
        truth = {f.index: (f.t_s, f.luma.copy()) for f in read_frames(run_folder / "video.mp4") if f.index in wanted}
        assert frames.wait(440, 60.0)
        for index in wanted:
            frame = frames.exact(index)
            assert frame.t_s == truth[index][0]
            assert np.array_equal(frame.luma, truth[index][1])
            assert frames.at_time(frame.t_s) == index
        assert frames.jpeg(440)[1]
    finally:
        frames.close()


def test_a_frame_may_be_looked_at_by_many_at_once(run_folder: Path) -> None:
    """The decoder's own conversion brings the process down when two threads do it at a time."""
    code = (
        "import sys, threading\nfrom pathlib import Path\nfrom towline.app.frames import Frames\n"
        f"frames = Frames(Path({str(run_folder / 'video.mp4')!r}))\n"
        "seen = []\n"
        "def look(index):\n"
        "    for _ in range(40):\n"
        "        seen.append(frames.exact(index).bgr().mean())\n"
        "looks = [threading.Thread(target=look, args=(k % 2,)) for k in range(8)]\n"
        "[t.start() for t in looks]; [t.join() for t in looks]; frames.close()\n"
        "assert len(seen) == 320 and len(set(seen)) == 2"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_the_bounded_store_still_answers(run_folder: Path) -> None:
    frames = Frames(run_folder / "video.mp4", most_bytes=200_000)
    try:
        assert frames.wait(1199, 60.0)
        assert frames.count == 1200
        import cv2

        for index in (0, 900):
            picture = cv2.imdecode(np.frombuffer(frames.jpeg(index)[0], np.uint8), cv2.IMREAD_COLOR)
            assert picture.shape == (600, 800, 3)
            exact = frames.exact(index).bgr().astype(float)
            assert np.abs(picture - exact).mean() < 3.0  # JPEG at quality 90
    finally:
        frames.close()


def _seen(fine: np.ndarray) -> np.ndarray:
    """A scene drawn 7-fold, through a lens that blurs by BLUR_PX, summed over pixels."""
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(fine, 7 * BLUR_PX, mode="nearest").reshape(64, 7, 64, 7).mean(axis=(1, 3))


def _dot(centre: np.ndarray, radius: float = 3.0) -> np.ndarray:
    """A disc of 140 DN."""
    fine = (np.arange(64 * 7) + 0.5) / 7 - 0.5
    u, v = np.meshgrid(fine, fine)
    return 60 + 140 * _seen(np.clip((radius - np.hypot(u - centre[0], v - centre[1])) * 7 + 0.5, 0, 1))


def _corner(centre: np.ndarray) -> np.ndarray:
    """The corner of a chessboard."""
    fine = (np.arange(64 * 7) + 0.5) / 7 - 0.5
    u, v = (np.clip((fine - c) * 7 + 0.5, 0, 1) * 2 - 1 for c in centre)
    return 60 + 140 * _seen((np.outer(v, u) + 1) / 2)


def _bound_px(draw: Any) -> float:
    """Cramer-Rao bound of a coordinate, known template, noise of NOISE_DN."""
    step = 0.05
    centre = np.array([31.3, 30.6])
    slope = (draw(centre + np.array([step, 0])) - draw(centre - np.array([step, 0]))) / (2 * step)
    return NOISE_DN / float(np.sqrt((slope[20:43, 20:43] ** 2).sum()))


@pytest.mark.parametrize("draw", [_dot, _corner])
def test_a_click_snaps_to_the_rendered_truth(draw: Any) -> None:
    """40 clicks up to 2 px beside the mark."""
    errors, z = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        centre = 31 + rng.uniform(-1, 1, 2)
        noisy = np.clip(np.rint(draw(centre) + rng.normal(0, NOISE_DN, (64, 64))), 0, 255).astype(np.uint8)
        found = snapped(Frame(0, 0.0, noisy, None), tuple(centre + rng.uniform(-2, 2, 2)), lossy=False)
        assert found.found
        errors.append(np.array(found.pixel_px) - centre)
        z.append(errors[-1] / found.sigma_px)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert rms < AT_THE_BOUND[draw.__name__] * _bound_px(draw)
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_a_click_beside_everything_stays_where_it_is() -> None:
    rng = np.random.default_rng(0)
    plain = np.clip(rng.normal(90, NOISE_DN, (80, 80)), 0, 255).astype(np.uint8)
    found = snapped(Frame(0, 0.0, plain, None), (40.25, 41.75), lossy=False)
    assert (found.pixel_px, found.sigma_px, found.found) == ((40.25, 41.75), CLICK_SIGMA_PX, False)


def test_clicks_on_a_sample_land_on_its_truth(session: Session, samples: Path) -> None:
    truth = read_tracks(samples / "mariner" / "x1446" / "truth" / "tracks.csv")
    for frame in (0, 250):
        assert session.frames is not None
        assert session.frames.wait(frame, 60.0)
        for row in truth[truth["frame"] == frame].itertuples():
            found = session.snap(frame, (row.u_px + 1.3, row.v_px - 0.9))  # pyright: ignore
            assert np.hypot(found.pixel_px[0] - row.u_px, found.pixel_px[1] - row.v_px) < CODEC_PX  # pyright: ignore


def test_a_click_belongs_to_the_frame_it_was_made_in(session: Session) -> None:
    """The person goes on to another frame while the mark next to the click is looked for."""
    pytest.importorskip("nicegui", reason="nicegui is not installed (the extra app)")
    from types import SimpleNamespace

    from towline.app.page_hand import HandStep
    from towline.app.snap import as_clicked

    assert session.frames is not None
    assert session.frames.wait(60, 60.0)
    snapped_in = []

    async def slowly(u_px: float, v_px: float, zoom: float, to_mark: bool) -> Any:
        snapped_in.append(session.index)
        session.hand().frame = session.go(40)  # as HandStep.moved does
        return as_clicked((u_px, v_px), zoom)

    window: Any = SimpleNamespace(
        session=session, snapped=slowly, go=session.go, state=lambda: None, overlay=lambda: None, tell=lambda *_: None
    )
    step: Any = HandStep(window)
    step._snapping = True
    step._what, step._said, step._count, step._use, step._source = (SimpleNamespace(text="") for _ in range(5))
    session.go(15)
    asyncio.run(step.pick(430.0, 188.0, 1.0))
    assert snapped_in == [15]
    assert [(c.frame, c.marker) for c in session.hand().clicks] == [(15, "bow")]
    assert session.index == 15  # where the next click, the stern's, is expected


# camera and detector --------------------------------------------------------------------------------------------------


def test_the_camera_shows_as_soon_as_there_are_points_for_it(run_folder: Path) -> None:
    """Point by point: none before four, then residuals; a misplaced one is named and left out."""
    content = tomllib.loads((run_folder / "run.toml").read_text())
    rows = content["datum"]
    for count in range(len(rows) + 1):
        seen = sight({**content, "datum": rows[:count]}, (800, 600))
        assert (seen.fit is not None) == (count >= 4), count
    seen = sight(content, (800, 600))
    assert seen.fit is not None
    assert seen.fit.rms_px < 0.3  # picks scatter by 0.15 px
    moved = [dict(row) for row in rows]
    moved[2]["tank_m"] = [-4.30, -1.2, 0.0]
    worse = sight({**content, "datum": moved}, (800, 600))
    assert worse.fit is not None
    assert worse.fit.excluded == (2,)
    assert any("near_port" in word for word in worse.words)
    unplaced = [*rows, {"name": "new", "pixel_px": [300.0, 300.0]}]
    assert sight({**content, "datum": unplaced}, (800, 600)).numbers == tuple(range(8))


def test_the_detector_shows_what_tracking_will_take(run_folder: Path, samples: Path) -> None:
    document = Document.open(run_folder)
    frames = Frames(run_folder / "video.mp4")
    try:
        frame = frames.exact(0)
    finally:
        frames.close()
    found = detected(frame, sight(document.content, (800, 600)), document.run())
    truth = read_tracks(samples / "mariner" / "x1446" / "truth" / "tracks.csv")
    for row in truth[truth["frame"] == 0].itertuples():
        u, v = found.marks_px[str(row.marker)]
        assert np.hypot(u - row.u_px, v - row.v_px) < 0.5  # pyright: ignore - a centroid, before the fit
    assert len(found.spots_px) >= 2
    nothing = detected(frame, sight({"datum": []}, (800, 600)), None)
    assert nothing.marks_px == {}
    assert "not complete" in nothing.words


def test_a_look_ahead_is_a_look_at_that_frame(session: Session) -> None:
    """Whatever frame is on the screen; kept until run.toml changes, and a few at most."""
    assert session.frames is not None
    ahead = session.detect(7)
    there = detected(session.frames.exact(7), session.sight(), session.run_or_none())
    assert ahead.marks_px == there.marks_px != session.detect(session.index).marks_px
    session.go(7)
    assert session.detect(7) is ahead
    session.doc.set_all([(("marker", 0, "depth_m"), 0.4)], "deeper")
    assert session.detect(7) is not ahead
    for index in range(EXACT + 1):
        session.detect(index)
    assert len(session._detected) == EXACT


# by hand --------------------------------------------------------------------------------------------------------------


def test_corrections_are_made_taken_back_and_written(session: Session, run_folder: Path) -> None:
    made = session.correcting()
    assert not session.dirty
    made.move(5, "bow", (100.126, 50.0), 1.0)
    made.move(5, "bow", (101.0, 50.0), 0.7)  # the second click is the one
    made.remove(6, "stern")
    made.seed(9, "bow", (90.0, 40.0), 1.0)
    assert session.dirty
    assert [(p.frame, p.marker, p.pixel_px, p.sigma_px) for p in made.made.point] == [(5, "bow", (101.0, 50.0), 0.7)]
    assert made.removed(6, "stern")
    assert made.undo() == "seed bow"
    assert made.undo() == "remove stern"
    assert not made.removed(6, "stern")
    assert made.redo() == "remove stern"
    made.remove(5, "bow")  # instead of the point
    assert made.point(5, "bow") is None
    assert made.redo() == ""  # another change came after what was taken back
    session.save()
    assert not session.dirty
    assert text_of(read_corrections(read_run(run_folder))) == text_of(made.made)
    with pytest.raises(InputError, match="'mast' is none of the run's markers"):
        made.move(5, "mast", (1.0, 2.0), 1.0)
    assert made.release(5, "bow")
    assert made.release(6, "stern")
    assert not made.release(6, "stern")
    session.save()
    assert not (run_folder / "corrections.toml").exists()


def test_a_range_of_removed_points_is_parted_by_what_is_set_in_it(session: Session, run_folder: Path) -> None:
    text = '[[removed]]\nframe = 10\nlast_frame = 20\nmarker = "bow"\n'
    (run_folder / "corrections.toml").write_text(text)
    made = session.correcting()
    made.move(15, "bow", (1.0, 2.0), 1.0)
    assert [frame for frame in range(8, 23) if made.removed(frame, "bow")] == [*range(10, 15), *range(16, 21)]
    made.undo()
    assert [frame for frame in range(8, 23) if made.removed(frame, "bow")] == list(range(10, 21))


def test_corrections_of_another_program_are_read_or_kept_beside(session: Session, run_folder: Path) -> None:
    path = run_folder / "corrections.toml"
    assert not session.correcting().made
    theirs = '[[point]]\nframe = 3\nmarker = "bow"\npixel_px = [1.0, 2.0]\n'
    path.write_text(theirs)
    assert session.correcting().point(3, "bow") is not None  # nothing of one's own: theirs is shown
    session.correcting().remove(4, "stern")
    path.write_text(theirs.replace("3", "7"))
    path.chmod(0o600)
    written = session.save()
    assert [p.name for p in written] == ["corrections.toml", "corrections.theirs1.toml"]
    assert written[1].read_text() == theirs.replace("3", "7")
    assert written[1].stat().st_mode & 0o777 == 0o600  # what was private stays so
    path.write_text("[[point]]\nframe = 1\n")
    with pytest.raises(InputError, match="missing key"):
        session.correcting()


def test_tracks_that_come_from_elsewhere_are_not_corrected(session: Session) -> None:
    session.correcting()
    session.doc.set_all([(("source", "video"), None), (("source", "tracks"), "own.csv")], "own tracks")
    with pytest.raises(InputError, match="corrections are of tracks that towline makes of a video"):
        session.correcting()


def test_losses_are_gone_through_one_by_one() -> None:
    rows = [(frame, frame / 30, name, 1.0, 2.0, "measured", "") for frame in range(10) for name in ("bow", "stern")]
    tracks = pd.DataFrame(rows, columns=["frame", "t_s", "marker", "u_px", "v_px", "status", "reason"])
    gone = tracks["frame"].isin([2, 3, 4, 8]) & (tracks["marker"] == "stern") | (tracks["frame"] == 0) & (
        tracks["marker"] == "bow"
    )
    tracks.loc[gone, ["status", "reason"]] = "lost", "covered"
    found = losses(tracks)
    assert found == [
        (0, "bow lost for 1 frame: covered"),
        (2, "stern lost for 3 frames: covered"),
        (8, "stern lost for 1 frame: covered"),
    ]
    assert next_of(found, 2, 1) == found[2]
    assert next_of(found, 2, -1) == found[0]
    assert next_of(found, 8, 1) is None


def test_playing_keeps_the_clock_at_any_speed_and_stops_at_the_end() -> None:
    player = Player()
    for speed in (0.25, 1.0, 4.0):
        player.speed = speed
        player.start(10, 100.0)
        frame = 10
        for turn in range(1, 40):
            frame = player.due(frame, 100.0 + turn / 37, 25.0, 1000)
            assert frame == 10 + int(turn / 37 * 25 * speed + 1e-9)
    player.start(10, 100.0)
    player.speed = 1.0
    assert player.due(500, 101.0, 25.0, 1000) == 500  # the person has gone elsewhere: on from there
    assert player.due(500, 102.0, 25.0, 1000) == 525
    assert player.due(525, 300.0, 25.0, 1000) == 999
    assert not player.running
    assert [other_speed(1.0, way) for way in (1, -1)] == [2.0, 0.5]
    assert other_speed(4.0, 1) == 4.0


def test_clicks_go_on_by_n_and_are_taken_back() -> None:
    hand = ByHand(["bow", "stern"], every=10)
    assert hand.wanted == "bow"
    assert not hand.click(1.0, 2.0)
    assert hand.wanted == "stern"
    assert hand.click(3.0, 4.0)
    with pytest.raises(ValueError, match="all of its marks"):
        hand.click(5.0, 6.0)
    assert hand.next_frame(last=15)
    assert hand.frame == 10
    assert not hand.next_frame(last=15)
    hand.click(7.0, 8.0)
    assert hand.undo() is not None
    gone = hand.undo()
    assert gone is not None
    assert (gone.marker, gone.frame, hand.frame, hand.wanted) == ("stern", 0, 0, "stern")
    assert hand.redo() == gone
    assert hand.frames == [0]
    hand.frame = 0
    hand.click(9.0, 9.0, marker="bow")  # clicked again
    assert hand.undo() is not None
    bow = next(c for c in hand.clicks if c.marker == "bow")
    assert (bow.u_px, bow.v_px) == (1.0, 2.0)
    while hand.undo() is not None:
        pass
    assert hand.clicks == []
    with pytest.raises(ValueError, match="nothing"):
        hand.table(float)


def test_clicks_become_tracks_and_tracks_motion(session: Session, run_folder: Path, samples: Path) -> None:
    """Places of the truth clicked on every 10th frame with 0.5 px of scatter: the motion is off by what it says it is."""
    from towline.pipeline.stages import compute_run_motion

    truth = samples / "mariner" / "x1446" / "truth"
    places = read_tracks(truth / "tracks.csv")
    rng = np.random.default_rng(5)
    hand = session.hand()
    hand.every, hand.frame = 10, 0
    assert session.frames is not None
    while True:
        rows = places[places["frame"] == hand.frame].set_index("marker")
        for name in ("bow", "stern"):
            u, v = rows.loc[name, ["u_px", "v_px"]] + rng.normal(0, 0.5, 2)
            hand.click(u, v, 0.5)
        if not hand.next_frame(1199):
            break
    assert session.dirty
    session.use_hand_tracks()
    assert "tracks" in session.doc.content["source"]
    assert "video" not in session.doc.content["source"]
    assert session.video_name() == "video.mp4"
    session.save()
    assert not session.dirty
    again = begun(run_folder, ["bow", "stern"])
    assert (len(again.clicks), again.every, again.frame) == (240, 10, 1200)
    made = compute_run_motion(read_run(run_folder))
    table = read_tracks(run_folder / FILE)
    assert set(table["status"]) == {"measured"}
    assert (table[["sigma_u_px", "sigma_v_px"]] == 0.5).all(axis=None)
    true = read_motion(truth / "motion.csv")
    assert len(made.motion) == 120
    for name in ("y_cg_m", "beta_rad"):
        apart = made.motion[name] - np.interp(made.motion["t_s"], true["t_s"], true[name])
        z = apart / np.hypot(made.motion[f"sigma_{name}"], made.motion[f"common_{name}"])
        assert 0.7 < np.sqrt(np.mean(z**2)) < 1.35, name  # 120 numbers: 6.5 % of scatter, and the common part
    document = Document.open(run_folder)
    assert 'video = "video.mp4"' in document.text


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


# who may talk to it ---------------------------------------------------------------------------------------------------

HERE = "127.0.0.1:8123"


async def _served(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    taken = 0
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        taken += len(message.get("body", b""))
        if not message.get("more_body"):
            break
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": str(taken).encode()})


class Asks:
    """A guard and one who asks it."""

    def __init__(self) -> None:
        self.tokens = ["right"]
        self.guard = Guard(_served, self.taken, 8123)
        self.place = ""

    def taken(self, token: str) -> bool:
        """As ``WaysIn``: each token lets in once."""
        if token in self.tokens:
            self.tokens.remove(token)
            return True
        return False

    def page(self, path: str = "/", kind: str = "GET", body: list[bytes] | None = None, **head: str) -> Any:
        """Ask below the page's own place."""
        return self(self.place + path, kind, body, **head)

    def __call__(
        self, path: str = "/", kind: str = "GET", body: list[bytes] | None = None, **head: str
    ) -> tuple[int, dict[str, str]]:
        """Status (101: a web socket was accepted) and headers."""
        path, _, query = path.partition("?")
        names = {"host": HERE} | {name.replace("_", "-"): value for name, value in head.items()}
        scope = {
            "type": "websocket" if kind == "WS" else "http",
            "method": kind,
            "path": path,
            "query_string": query.encode(),
            "headers": [(name.encode(), value.encode()) for name, value in names.items() if value],
        }
        parts, sent = [*(body or [b""])], []

        async def receive() -> Any:
            if not parts:
                return {"type": "http.disconnect"}
            return {"type": "http.request", "body": parts.pop(0), "more_body": bool(parts)}

        async def send(message: Any) -> None:
            sent.append(message)

        asyncio.run(self.guard(scope, receive, send))
        if not sent:
            return 0, {}
        if sent[0]["type"] == "websocket.accept":
            return 101, {}
        if sent[0]["type"] == "websocket.close":
            return 403, {}
        found = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
        on = re.search(r"url=(/[\w-]+)/", sent[1].get("body", b"").decode())
        return sent[0]["status"], found | ({"goes on to": on.group(1)} if on else {})

    def cookie(self) -> str:
        status, head = self("/?token=right")
        assert status == 200
        self.place = head["goes on to"]
        assert re.fullmatch(r"/[\w-]{43}", self.place)
        assert "HttpOnly" in head["set-cookie"]
        assert "SameSite=Strict" in head["set-cookie"]
        return head["set-cookie"].partition(";")[0]


def test_only_the_session_is_answered() -> None:
    asks = Asks()
    cookie, origin = asks.cookie(), f"http://{HERE}"
    assert asks.page("/", cookie=cookie)[0] == 200
    assert asks.page("/frame/1/2.jpg", cookie=f"other=1; {cookie}")[0] == 200
    assert asks.page("/", cookie=f"towline_8123=set by another port; {cookie}")[0] == 200
    assert asks.page("/", kind="WS", cookie=cookie, origin=origin)[0] == 101
    assert asks.page("/x", kind="POST", cookie=cookie, origin=origin)[0] == 200
    for path, kind, head in [  # with the cookie alone, as another port gets it
        ("/", "GET", {"cookie": cookie}),
        ("/frame/1/2.jpg", "GET", {"cookie": cookie}),
        ("/_nicegui_ws/socket.io/", "WS", {"cookie": cookie, "origin": origin}),
        ("/?token=right", "GET", {"cookie": cookie}),  # it was used
        (f"/{'x' * 43}/", "GET", {"cookie": cookie}),
        (asks.place[:-1] + "/", "GET", {"cookie": cookie}),
        ("//", "GET", {"cookie": cookie}),
    ]:
        assert asks(path, kind, **head)[0] == 403, (path, kind, head)
    for path, kind, head in [
        ("/", "GET", {}),
        ("/", "GET", {"cookie": "towline_8123=guess"}),
        ("/", "GET", {"cookie": "towline_8123=right"}),  # the token is no cookie
        ("/?token=wrong", "GET", {}),
        ("/frame/1/2.jpg?token=right", "GET", {}),
        ("/", "WS", {"origin": origin}),
        ("/", "WS", {"cookie": cookie}),
        ("/", "WS", {"cookie": cookie, "origin": "http://evil.example"}),
        ("/", "WS", {"cookie": cookie, "origin": "http://127.0.0.1:8124"}),
        ("/", "WS", {"cookie": cookie, "origin": "null"}),
        ("/x", "POST", {"cookie": cookie}),
        ("/x", "POST", {"cookie": cookie, "origin": "http://evil.example"}),
        ("/", "GET", {"cookie": cookie, "origin": "http://evil.example"}),
        ("/", "GET", {"cookie": cookie, "host": "evil.example:8123"}),
        ("/?token=right", "GET", {"host": "evil.example"}),
        ("/?token=right", "POST", {"origin": origin}),
        ("/result/key/page.html", "GET", {}),
    ]:
        assert asks.page(path, kind, **head)[0] == 403, (path, kind, head)
    other = Asks()
    other.cookie()
    assert other.page("/", cookie=cookie)[0] == 403  # another session's


def test_requests_are_bounded_and_pages_stay_at_home() -> None:
    asks = Asks()
    mine = {"cookie": asks.cookie(), "origin": f"http://{HERE}"}
    assert asks.page("/x", "POST", content_length=str(MOST_BODY + 1), **mine)[0] == 413
    assert asks.page("/x", "POST", content_length="-5", **mine)[0] == 413
    half = b"x" * (MOST_BODY // 2 + 1)
    assert asks.page("/x", "POST", body=[half], **mine)[0] == 200
    assert asks.page("/x", "POST", body=[half, half], **mine)[0] == 0  # cut off
    head = asks.page("/", **mine)[1]
    policy = head["content-security-policy"]
    assert "default-src 'self'" in policy
    assert not re.search(r"https?://(?!127\.0\.0\.1:8123|localhost:8123)", policy)
    assert head["x-content-type-options"] == "nosniff"


def test_a_token_may_come_by_a_form_of_the_private_file() -> None:
    asks = Asks()
    assert asks("/", "POST", body=[b"token=wrong"], origin="null")[0] == 403
    assert asks("/", "POST", body=[b"token=right", b"x" * MOST_BODY], origin="null")[0] == 403
    assert asks("/", "POST", body=[b"token=right"], content_length=str(MOST_BODY), origin="null")[0] == 403
    assert asks("/", "POST", body=[b"&" * 2000 + b"token=right"], origin="null")[0] == 403
    status, head = asks("/", "POST", body=[b"token=", b"right"], origin="null")
    assert status == 200
    assert "SameSite=Strict" in head["set-cookie"]
    assert asks("/", "POST", body=[b"token=right"], origin="null")[0] == 403  # once


def test_the_private_file_opens_the_page_each_time() -> None:
    ways = WaysIn(8123)
    try:
        if os.name == "posix":
            assert stat.S_IMODE(ways.file.stat().st_mode) == 0o600
            assert stat.S_IMODE(ways.file.parent.stat().st_mode) == 0o700
        tokens = []
        for _ in range(3):
            page = ways.file.read_text()
            assert 'action="http://127.0.0.1:8123/"' in page
            tokens += re.findall(r'value="([\w-]{43})"', page)
            assert not ways.taken("")
            assert ways.taken(tokens[-1])
            assert not ways.taken(tokens[-1])
        assert len(set(tokens)) == 3
        printed = ways.link.partition("token=")[2]
        assert printed not in tokens
        assert ways.taken(printed)
        assert not ways.taken(printed)
    finally:
        ways.close()
    assert not ways.file.parent.exists()


def test_results_stand_alone() -> None:
    """Their address is all that they need; they may nothing, and the page's secrets are in nothing that they see."""
    asks = Asks()
    asks.cookie()
    status, head = asks("/result/key/report.html")
    assert status == 200
    policy = head["content-security-policy"].split("; ")
    assert "sandbox" in policy  # no script, no origin, no form, no window of its own
    assert {"default-src 'none'", "connect-src 'none'", "form-action 'none'", "base-uri 'none'"} <= set(policy)
    assert not any("script" in rule for rule in policy)
    assert "set-cookie" not in head
    assert asks("/result/key/report.html", "POST", origin=f"http://{HERE}")[0] == 405
    assert asks("/result/key/report.html", host="evil.example")[0] == 403
    assert asks("/result/key/report.html", kind="WS", origin=f"http://{HERE}")[0] == 403


def test_only_known_parts_of_a_result_are_shown(tmp_path: Path) -> None:
    out = tmp_path / "run" / "out"
    (out / "report_figures").mkdir(parents=True)
    (tmp_path / "secret.csv").write_text("no")
    for name in ("report.html", "report_figures/motion.csv", "motion.csv", "other.html"):
        (out / name).write_text("yes")
    page = out / "report.html"
    assert page_file(page, "report.html").read_text() == "yes"
    assert page_file(page, "report_figures/motion.csv").read_text() == "yes"
    names = [
        "other.html",
        "motion.csv",
        "../run.toml",
        "../out/x.csv",
        "/etc/passwd",
        "a/b/c.csv",
        "x\0/y.csv",
        "",
        ".",
        "a\\b/c.csv",
    ]
    try:
        (out / "notes.html").symlink_to(tmp_path / "secret.csv")
        (out / "report_figures" / "link.csv").symlink_to(tmp_path / "secret.csv")
        (out / "door").symlink_to(tmp_path)
        names += ["report_figures/link.csv", "door/secret.csv"]
        with pytest.raises(InputError, match="leads out"):
            page_file(out / "notes.html", "notes.html")
        (tmp_path / "run2").mkdir()
        (tmp_path / "run2" / "out").symlink_to(out)
        with pytest.raises(InputError, match="leads out"):
            page_file(tmp_path / "run2" / "out" / "report.html", "report.html")
    except OSError:
        pass  # links cannot be made here
    for name in names:
        with pytest.raises(InputError):
            page_file(page, name)


def test_the_served_page_refuses_strangers(run_folder: Path) -> None:
    pytest.importorskip("nicegui", reason="nicegui is not installed (the extra app)")
    process = subprocess.Popen(
        [sys.executable, "-m", "towline", "app", str(run_folder), "--no-browser"],
        stdout=subprocess.PIPE,
        text=True,
        env={k: v for k, v in os.environ.items() if not k.startswith("PYTEST")},
    )
    try:
        assert process.stdout is not None
        address = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)", process.stdout.readline())
        assert address
        port = int(address.group(1))
        base = f"http://127.0.0.1:{port}"

        def status(path: str, **head: str) -> int:
            request = urllib.request.Request(base + path, headers={k.replace("_", "-"): v for k, v in head.items()})
            try:
                return urllib.request.build_opener(_Stay()).open(request, timeout=10).status
            except urllib.error.HTTPError as error:
                return error.code

        assert status("/") == 403
        assert status("/frame/1/0.jpg") == 403
        assert status("/_nicegui_ws/socket.io/?EIO=4&transport=polling") == 403
        door = urllib.request.urlopen(f"{base}/?token={address.group(2)}", timeout=10)
        cookie = door.headers["set-cookie"].partition(";")[0]
        place = re.search(r"url=(/[\w-]+)/", door.read().decode()).group(1)  # pyright: ignore
        assert status(f"/?token={address.group(2)}") == 403  # good once
        assert status(f"{place}/", Cookie=cookie) == 200
        assert status(f"{place}/frame/1/0.jpg", Cookie=cookie) == 200
        assert status(f"{place}/frame/1/0.jpg", Cookie=cookie, Origin="http://evil.example") == 403
        for path in ("/", "/frame/1/0.jpg", f"{place[:-1]}/"):
            assert status(path, Cookie=cookie) == 403, path
        assert status("/result/1/report.html") == 404
        for number in ("-3", "1" * 21, "9" * 5000):
            assert 400 <= status(f"{place}/frame/1/{number}.jpg", Cookie=cookie) < 500, number
            assert 400 <= status(f"{place}/top/1/0/{number}.jpg", Cookie=cookie) < 500, number
        assert status(f"{place}/frame/7/0.jpg", Cookie=cookie) == 404
        for path in (
            "/result/../run.toml",
            f"{place}/frame/1/..%2f..%2frun.toml",
            f"{place}/run.toml",
            f"{place}/_nicegui/3/static/../../run.toml",
        ):
            request = urllib.request.Request(base + path, headers={"Cookie": cookie})
            try:
                answer = urllib.request.urlopen(request, timeout=10).read()
            except urllib.error.HTTPError as error:
                answer = error.read()
            assert b"cx_px = 399.5" not in answer, path
        for origin, wanted in ((base, b"101"), ("http://evil.example", b"403"), ("", b"403")):
            assert wanted in _upgrade(port, cookie, origin, place), origin
        assert b"403" in _upgrade(port, "", base, place)
        assert b"403" in _upgrade(port, cookie, base, "")
        with socket.socket() as outside:  # on this machine's other addresses nobody listens
            outside.settimeout(2)
            with pytest.raises(OSError):
                outside.connect(("127.0.0.2", port))
    finally:
        process.terminate()
        process.wait(15)


class _Stay(urllib.request.HTTPRedirectHandler):
    """Redirections are not followed."""

    def redirect_request(self, *_: Any) -> None:
        return None


def _upgrade(port: int, cookie: str, origin: str, place: str) -> bytes:
    """First line that answers the wish for a web socket."""
    lines = [
        f"GET {place}/_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1",
        f"Host: 127.0.0.1:{port}",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    ]
    lines += [f"Cookie: {cookie}"] if cookie else []
    lines += [f"Origin: {origin}"] if origin else []
    with socket.create_connection(("127.0.0.1", port), 10) as wire:
        wire.sendall("\r\n".join([*lines, "", ""]).encode())
        return wire.recv(200).partition(b"\r\n")[0]


def test_only_pages_stand_on_nicegui(root: Path) -> None:
    for path in (root / "app").glob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            heavy = {n.split(".")[0] for n in names} & {"nicegui", "cv2", "av", "matplotlib", "fastapi", "starlette"}
            assert not heavy or (heavy == {"nicegui"} and path.name.startswith("page_")), path.name


def test_without_nicegui_the_command_says_so(run_folder: Path) -> None:
    code = (
        "import sys; sys.modules['nicegui'] = None\n"
        "from towline.cli import main\n"
        f"sys.exit(main(['app', {str(run_folder)!r}, '--no-browser']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "pip install 'towline[app]'" in done.stderr
    assert "Traceback" not in done.stderr
