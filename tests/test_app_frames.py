"""Frames of the page, clicks that snap, the camera as it stands, corrections and clicks by hand; without a browser."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from towline.app.byhand import FILE, ByHand, begun
from towline.app.document import Document
from towline.app.frames import EXACT, Frames
from towline.app.jumps import losses, next_of
from towline.app.playing import Player, other_speed
from towline.app.session import Session
from towline.app.sight import detected, sight
from towline.app.snap import CLICK_SIGMA_PX, snapped
from towline.record import InputError, read_motion, read_run, read_tracks
from towline.record.corrections import read_corrections, text_of
from towline.vision.recording import Frame, read_frames

NOISE_DN = 3.0
BLUR_PX = 0.7
AT_THE_BOUND = {"_dot": 1.33, "_corner": 1.50}
"""Times the Cramer-Rao bound: 1.09 and 1.22 over 200 clicks (a corner is fitted in a smaller window than the bound takes), and
three times the 8 % by which the rms of 80 coordinates scatters."""
CODEC_PX = 0.15
"""Four times the 0.04 px rms that a mark of the samples lies off in the decoded picture."""


# frames and snapping --------------------------------------------------------------------------------------------------


@pytest.mark.slow
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


@pytest.mark.once
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


@pytest.mark.slow
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
