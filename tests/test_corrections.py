"""What a person sets right in tracks: seeds, points, removed points. The truth is drawn; without the correction it is missed."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from towline.cli import main
from towline.pipeline.stages import compute_run_motion, track_run
from towline.record import InputError, read_run, read_tracks
from towline.record.corrections import (
    HAND_SIGMA_PX,
    REMOVED,
    Corrections,
    Placed,
    Removed,
    read_corrections,
    text_of,
    write_corrections,
)
from towline.record.tables import write_table

WIDTH, HEIGHT, RATE_HZ, FRAMES = 240, 180, 25.0, 80
RADIUS_PX, BLUR_PX, GROUND_DN, RISE_DN, NOISE_DN = 3.0, 0.8, 60.0, 120.0, 2.0
BODY_M = {"bow": (0.06, 0.0), "stern": (-0.06, 0.0)}
"""A pixel is a millimetre: the camera looks straight down."""
HIDDEN = range(30, 42)
"""Frames in which something stands over the model; meanwhile it turns half round, so that its two like marks change places."""
SEED = HIDDEN.stop
PULLS = 5.0
"""A place lies within so many of its own standard deviations of the truth: in 200 places it is farther by chance once in 10000."""
LARGEST_SIGMA_PX = 0.05
"""The marks' bound (Cramer-Rao) is near 0.01 px in this noise; a path that jumps to another mark must not widen it."""
LEAST_PX = 0.02
"""What is left beside sigma: pixels of the drawing (a fifth of a pixel) and of the picture (a grey value)."""


def true_px(name: str, frame: int) -> NDArray:
    """(2,) where a mark is."""
    t_s = frame / RATE_HZ
    beta = 0.3 * np.sin(2.0 * t_s) + (np.pi if frame >= SEED else 0.0)
    x, y = 1e3 * np.array(BODY_M[name])
    middle = np.array([120.0 + 3 * np.sin(1.3 * t_s), 90.0 + 25 * np.sin(1.7 * t_s)])
    return middle + np.array([np.cos(beta) * x - np.sin(beta) * y, np.sin(beta) * x + np.cos(beta) * y])


def write_film(path: Path) -> None:
    """Two like discs, without loss, each pixel the mean of 5 x 5 points."""
    import av
    import cv2

    rng = np.random.default_rng(11)
    v, u = (np.mgrid[0 : 5 * HEIGHT, 0 : 5 * WIDTH] - 2) / 5
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=int(RATE_HZ))
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "gray"
        for frame in range(FRAMES):
            fine = np.full(u.shape, GROUND_DN, np.float32)
            for name in BODY_M if frame not in HIDDEN else ():
                at = true_px(name, frame)
                fine[np.hypot(u - at[0], v - at[1]) < RADIUS_PX] += RISE_DN
            fine = cv2.GaussianBlur(fine, (0, 0), 5 * BLUR_PX)
            picture = fine.reshape(HEIGHT, 5, WIDTH, 5).mean(axis=(1, 3)) + rng.normal(0, NOISE_DN, (HEIGHT, WIDTH))
            shown = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(shown, format="gray")))
        container.mux(stream.encode())


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("discs") / "discs.mkv"
    write_film(path)
    return path.read_bytes()


@pytest.fixture
def run(film: bytes, tmp_path: Path) -> Path:
    """A free model, its marks named in the first frame."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "discs.mkv").write_bytes(film)
    text = 'name = "discs"\nkind = "free"\n[source]\nvideo = "discs.mkv"\n'
    for px, py in ((10, 10), (230, 10), (10, 170), (230, 170)):
        text += f"[[datum]]\npixel_px = [{px}.0, {py}.0]\ntank_m = [{px / 1000}, {py / 1000}, 0.0]\nsigma_px = 0.05\n"
    for name, body in BODY_M.items():
        u, v = np.rint(true_px(name, 0))
        text += f'[[marker]]\nname = "{name}"\nbody_m = {list(body)}\ndepth_m = 0.0\nlook = "disc"\nseen_at_px = [{u}, {v}]\n'
    (folder / "run.toml").write_text(text)
    return folder


def seeds(frame: int = SEED, off_px: float = 2.0) -> list[str]:
    """Arguments of the command: the marks as a person sees them, some way off."""
    found = ["--from", str(frame)]
    for name in BODY_M:
        u, v = true_px(name, frame) + off_px / np.sqrt(2)
        found += ["--seed", f"{name}={u:.1f},{v:.1f}"]
    return found


def error_px(table: pd.DataFrame) -> NDArray:
    """(n, 2) of rows with a place."""
    truth = np.array([true_px(m, int(f)) for m, f in zip(table["marker"], table["frame"], strict=True)]).reshape(-1, 2)
    return table[["u_px", "v_px"]].to_numpy() - truth


def meets_the_truth(table: pd.DataFrame) -> bool:
    """All rows are measured, surely, and where their sigma says."""
    error = np.abs(error_px(table))
    return bool(
        (table["status"] == "measured").all()
        and table[["sigma_u_px", "sigma_v_px"]].to_numpy().max() < LARGEST_SIGMA_PX
        and (error < PULLS * table[["sigma_u_px", "sigma_v_px"]].to_numpy() + LEAST_PX).all()
    )


def put(folder: Path, corrections: Corrections) -> None:
    write_corrections(folder, corrections)


# seeds ----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_seed_sets_swapped_marks_right_from_its_frame_on(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["track", str(run), "--no-overlay"]) == 0
    before = read_tracks(run / "out" / "tracks.csv")
    late = before[(before["frame"] >= SEED) & (before["status"] == "measured")]
    assert np.abs(error_px(late)).max() > 50  # the marks are taken for each other: else nothing is shown by this test
    assert main(["track", str(run), "--no-overlay", *seeds()]) == 0
    assert f"corrected by hand ({run / 'corrections.toml'}): seeds in frame {SEED}" in capsys.readouterr().out
    after = read_tracks(run / "out" / "tracks.csv")
    assert meets_the_truth(after[after["frame"] >= SEED])
    assert meets_the_truth(after[after["frame"] < HIDDEN.start])
    assert (after[after["frame"].isin(HIDDEN)]["status"] == "lost").all()
    early = [t[t["frame"] < HIDDEN.start][["u_px", "v_px", "status"]].reset_index(drop=True) for t in (before, after)]
    pd.testing.assert_frame_equal(*early)


@pytest.mark.slow
def test_one_seed_is_enough_where_the_other_mark_follows_from_it(run: Path) -> None:
    assert main(["track", str(run), "--no-overlay", *seeds()[:4]]) == 0
    after = read_tracks(run / "out" / "tracks.csv")
    assert meets_the_truth(after[after["frame"] >= SEED])


@pytest.mark.slow
def test_a_correction_is_applied_again_whenever_the_run_is_tracked(run: Path) -> None:
    assert main(["track", str(run), "--no-overlay", *seeds()]) == 0
    put(run, read_corrections(read_run(run)).model_copy(update={"removed": (Removed(frame=3, marker="bow"),)}))
    text = (run / "run.toml").read_text()
    for again in ("fresh", "other options"):
        if again == "fresh":
            assert main(["track", str(run), "--no-overlay", "--fresh"]) == 0
        else:
            (run / "run.toml").write_text(text.replace("[source]\n", "[source]\nspan_s = [0.0, 2.8]\n"))
            assert main(["track", str(run), "--no-overlay"]) == 0
        table = read_tracks(run / "out" / "tracks.csv")
        assert meets_the_truth(table[table["frame"] >= SEED]), again
        gone = table[(table["frame"] == 3) & (table["marker"] == "bow")].iloc[0]
        assert (gone["status"], gone["reason"]) == ("lost", REMOVED), again


@pytest.mark.slow
def test_marks_that_nothing_tells_apart_at_first_are_followed_from_a_seed_on(run: Path) -> None:
    """Without a name in the first frame the command stops; a later seed names them, and what came before stays lost."""
    text = (run / "run.toml").read_text()
    (run / "run.toml").write_text("\n".join(line for line in text.splitlines() if not line.startswith("seen_at_px")))
    assert main(["track", str(run), "--no-overlay"]) == 1
    assert main(["track", str(run), "--no-overlay", *seeds(20)]) == 0
    table = read_tracks(run / "out" / "tracks.csv")
    assert (table[table["frame"] < 20]["status"] == "lost").all()
    assert meets_the_truth(table[table["frame"].between(20, HIDDEN.start - 1)])


def write_patches(folder: Path, cut: int, other: bool) -> dict[int, NDArray]:
    """A run of two templates on textured ground, and where the first is: from ``cut`` on 60 px farther, or on other ground."""
    import av
    import cv2

    rng = np.random.default_rng(5)
    grounds = []
    for _ in range(2):
        ground = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT + 200, WIDTH + 200)).astype(np.float32), (0, 0), 2.0)
        grounds.append(120 + 40 * ground / ground.std())
    place = {
        frame: np.array([100.0, 80.0]) + (np.array([60.0, 10.0]) if frame >= cut else 0.0) for frame in range(2 * cut)
    }
    with av.open(str(folder / "film.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=int(RATE_HZ))
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "gray"
        for frame, at in place.items():
            u, v = np.rint(at).astype(int)
            ground = grounds[int(other and frame >= cut)]
            part = ground[180 - v : 180 - v + HEIGHT, 200 - u : 200 - u + WIDTH] + rng.normal(0, 2, (HEIGHT, WIDTH))
            shown = np.clip(np.rint(part), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(shown, format="gray")))
        container.mux(stream.encode())
    text = 'name = "patch"\nkind = "free"\n[source]\nvideo = "film.mkv"\n'
    for px, py in ((10, 10), (230, 10), (10, 170), (230, 170)):
        text += f"[[datum]]\npixel_px = [{px}.0, {py}.0]\ntank_m = [{px / 1000}, {py / 1000}, 0.0]\nsigma_px = 0.05\n"
    for name, u, x in (("bow", 100.0, 0.04), ("stern", 60.0, 0.0)):
        text += f'[[marker]]\nname = "{name}"\nbody_m = [{x}, 0.0]\ndepth_m = 0.0\nlook = "template"\nseen_at_px = [{u}, 80.0]\n'
    (folder / "run.toml").write_text(text)
    return place


@pytest.mark.slow
def test_a_template_is_found_again_where_it_is_seeded(tmp_path: Path) -> None:
    """The camera is knocked by 60 px in frame 40; the point stays the same point of the body, to what its sigma says."""
    place = write_patches(tmp_path, 40, other=False)
    arguments = ["track", str(tmp_path), "--no-overlay"]
    assert main(arguments) == 0
    table = read_tracks(tmp_path / "out" / "tracks.csv")
    bow = table[table["marker"] == "bow"].set_index("frame")
    assert (bow["status"][41:] == "lost").any(), "nothing is shown by this test"
    assert main([*arguments, "--from", "40", "--seed", "bow=162,88", "--seed", "stern=118,92"]) == 0
    table = read_tracks(tmp_path / "out" / "tracks.csv")
    assert (table["status"] == "measured").all()
    bow = table[table["marker"] == "bow"].set_index("frame")
    error = bow[["u_px", "v_px"]].to_numpy() - np.array([place[frame] for frame in bow.index])
    assert np.abs(error).max() < 0.1  # a pick of its own would be off by the two pixels of the seed
    assert bow["sigma_u_px"].max() < 0.1


def test_a_template_that_is_not_there_any_more_is_cut_out_anew_and_says_how_well_it_was_picked(tmp_path: Path) -> None:
    """Other ground from frame 40 on: the new point is where the person saw it, to the pixel that a pick is taken to be off by."""
    place = write_patches(tmp_path, 40, other=True)
    arguments = ["--from", "40", "--seed", "bow=160.6,89.5", "--seed", "stern=120,90"]
    assert main(["track", str(tmp_path), "--no-overlay", *arguments]) == 0
    table = read_tracks(tmp_path / "out" / "tracks.csv")
    bow = table[table["marker"] == "bow"].set_index("frame")
    assert (bow["status"] == "measured").all()
    late = bow.loc[40:]
    error = late[["u_px", "v_px"]].to_numpy() - np.array([place[frame] for frame in late.index])
    np.testing.assert_allclose(error, np.broadcast_to([0.6, -0.5], error.shape), atol=0.1)
    assert (late[["sigma_u_px", "sigma_v_px"]].to_numpy() >= HAND_SIGMA_PX).all()
    assert (bow.loc[:39, "sigma_u_px"] < 0.1).all()


# points ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_points_by_hand_and_removed_ones_stand_in_the_table_and_nothing_is_lost(run: Path) -> None:
    track_run(read_run(run))
    written = (run / "out" / "tracks.csv").read_bytes()
    before = read_tracks(run / "out" / "tracks.csv")
    put(
        run,
        Corrections(
            point=(
                Placed(frame=5, marker="bow", pixel_px=(100.5, 60.25), sigma_px=0.7),
                Placed(frame=35, marker="stern", pixel_px=(60.0, 90.0)),
            ),
            removed=(Removed(frame=10, last_frame=12, marker="stern"),),
        ),
    )
    track_run(read_run(run))
    table = read_tracks(run / "out" / "tracks.csv").set_index(["marker", "frame"])
    was = before.set_index(["marker", "frame"])
    moved = table.loc[("bow", 5)]
    assert (moved["status"], moved["u_px"], moved["v_px"]) == ("by_hand", 100.5, 60.25)
    assert moved["sigma_u_px"] == moved["sigma_v_px"] == 0.7
    assert table.loc[("stern", 35), "sigma_u_px"] == HAND_SIGMA_PX  # nobody said how well it was set
    assert was.loc[("stern", 35), "status"] == "lost"
    for frame in (10, 11, 12):
        assert table.loc[("stern", frame), "status"] == "lost"
        assert table.loc[("stern", frame), "reason"] == REMOVED
        assert np.isnan(table.loc[("stern", frame), "u_px"])
    for key in (("bow", 5), ("stern", 11)):
        for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px"):
            assert table.loc[key, f"auto_{name}"] == pytest.approx(was.loc[key, name], rel=1e-9)
    touched = [("bow", 5), ("stern", 35), *(("stern", f) for f in (10, 11, 12))]
    same = ["t_s", "u_px", "v_px", "sigma_u_px", "status"]
    pd.testing.assert_frame_equal(table.drop(touched)[same], was.drop(touched)[same])
    put(run, Corrections())
    assert not (run / "corrections.toml").exists()
    track_run(read_run(run))
    assert (run / "out" / "tracks.csv").read_bytes() == written


@pytest.mark.slow
def test_moving_a_point_tracks_nothing_again(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    track_run(read_run(run))
    written = (run / "out" / "tracks.csv").read_bytes()

    def no_tracking(*_: object, **__: object) -> None:
        raise AssertionError("tracked again")

    monkeypatch.setattr("towline.vision.track", no_tracking)
    for u_px in (100.0, 101.0):
        put(run, Corrections(point=(Placed(frame=5, marker="bow", pixel_px=(u_px, 60.0)),)))
        table = track_run(read_run(run)).table
        assert table[(table["frame"] == 5) & (table["marker"] == "bow")]["u_px"].item() == u_px
    put(run, Corrections())
    track_run(read_run(run))
    assert (run / "out" / "tracks.csv").read_bytes() == written


@pytest.mark.slow
def test_notes_are_those_of_the_tracks_they_were_written_with(run: Path) -> None:
    """What other tracks left in automatic.csv, a note with them, says nothing of these."""
    plain = track_run(read_run(run))
    write_table(run / "out" / "automatic.csv", plain.table, "of another recording", ("it was interlaced",))
    put(run, Corrections(point=(Placed(frame=5, marker="bow", pixel_px=(100.5, 60.25)),)))
    assert track_run(read_run(run)).notes == plain.notes


@pytest.mark.slow
def test_the_motion_has_the_hands_sigma(run: Path) -> None:
    """Straight down at a millimetre a pixel: beta of one mark set by hand is as sure as sigma over the marks' distance."""
    u, v = true_px("bow", 5)
    before = compute_run_motion(read_run(run)).motion.set_index("t_s")
    put(run, Corrections(point=(Placed(frame=5, marker="bow", pixel_px=(u, v), sigma_px=2.0),)))
    after = compute_run_motion(read_run(run)).motion.set_index("t_s")
    at = after.index[np.argmin(np.abs(after.index.to_numpy() - 5 / RATE_HZ))]
    assert after.loc[at, "status"] == "measured"
    assert after.loc[at, "sigma_beta_rad"] == pytest.approx(2e-3 / 0.12, rel=0.05)
    assert before.loc[at, "sigma_beta_rad"] < 0.1 * after.loc[at, "sigma_beta_rad"]
    others = after.drop(at)["sigma_beta_rad"].dropna()
    np.testing.assert_allclose(others, before.drop(at)["sigma_beta_rad"].dropna(), rtol=0.2)


# the file -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--from", "900", "--seed", "bow=60,90"], "frame 900 is none of the analysed frames 0 to 79"),
        (["--from", "-3", "--seed", "bow=60,90"], "--from -3: a frame's number is 0 or above"),
        (["--from", "5", "--seed", "bov=60,90"], "'bov' is none of the run's markers bow, stern"),
        (["--from", "5", "--seed", "bow=260,90"], "(260, 90) lies outside the picture of 240 x 180 pixels"),
        (["--from", "5", "--seed", "bow=60;90"], "--seed bow=60;90: NAME=U,V is expected, two numbers in pixels"),
        (["--from", "5", "--seed", "bow=60,nan"], "NAME=U,V is expected"),
        (["--from", "5", "--seed", "bow=6,9", "--seed", "bow=7,9"], "'bow' is given twice"),
        (["--from", "5"], "--from FRAME and --seed NAME=U,V go together"),
        (["--seed", "bow=60,90"], "--from FRAME and --seed NAME=U,V go together"),
        (["--from", "5", "--seed", "bow=20,20", "--seed", "stern=220,20"], "from the seed in frame 5 on"),
    ],
)
def test_a_wrong_seed_is_one_line_and_changes_nothing(
    run: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["track", str(run), "--no-overlay", *arguments]) == 1
    line = capsys.readouterr().err.strip()
    assert said in line
    assert "\n" not in line
    assert not (run / "corrections.toml").exists()
    assert not (run / "out" / "tracks.csv").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("version = 2\n", "version: 2"),
        ("[[points]]\nframe = 1\n", "points: unknown key; did you mean 'point'?"),
        ('[[point]]\nframe = 1.5\nmarker = "bow"\npixel_px = [1.0, 2.0]\n', "point[1].frame: 1.5"),
        ('[[point]]\nframe = 1\nmarker = "bow"\npixel_px = [1.0]\n', "point[1].pixel_px"),
        ('[[point]]\nframe = 1\nmarker = "bow"\npixel_px = [1.0, 2.0]\nsigma_px = 0.0\n', "point[1].sigma_px: 0.0"),
        (
            '[[point]]\nframe = 1\nmarker = "bug"\npixel_px = [1.0, 2.0]\n',
            "point[1].marker: 'bug' is none of the run's",
        ),
        ('[[point]]\nframe = 99\nmarker = "bow"\npixel_px = [1.0, 2.0]\n', "point[1].frame: frame 99 is none of"),
        ('[[point]]\nframe = 1\nmarker = "bow"\npixel_px = [1.0, 999.0]\n', "(1, 999) lies outside the picture"),
        ('[[removed]]\nframe = 9\nlast_frame = 3\nmarker = "bow"\n', "last_frame 3 comes before frame 9"),
        (
            '[[removed]]\nframe = 1\nlast_frame = 9\nmarker = "bow"\n[[point]]\nframe = 5\nmarker = "bow"\npixel_px = [1.0, 2.0]\n',
            "frame 5 of 'bow' stands there twice",
        ),
        ("[[point]\n", "a table's name stands between brackets"),
    ],
)
def test_a_wrong_file_is_one_line(run: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "corrections.toml").write_text(text)
    assert main(["track", str(run), "--no-overlay"]) == 1
    line = capsys.readouterr().err.strip()
    assert str(run / "corrections.toml") in line
    assert said in line
    assert "\n" not in line


@pytest.mark.slow
def test_a_correction_outside_a_narrower_span_waits(run: Path) -> None:
    put(run, Corrections(point=(Placed(frame=70, marker="bow", pixel_px=(60.0, 90.0)),)))
    text = (run / "run.toml").read_text()
    (run / "run.toml").write_text(text.replace("[source]\n", "[source]\nspan_s = [0.0, 1.0]\n"))
    found = track_run(read_run(run))
    assert any("frame 70 is none of the analysed frames 0 to 25" in note for note in found.notes)
    (run / "run.toml").write_text(text)
    table = track_run(read_run(run)).table
    assert table[(table["frame"] == 70) & (table["marker"] == "bow")]["status"].item() == "by_hand"


def test_tags_and_runs_without_video_take_no_seed(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (run / "run.toml").read_text()
    (run / "run.toml").write_text(text.replace('look = "disc"', 'look = "aruco:0"', 1))
    assert main(["track", str(run), *seeds()[:4]]) == 1
    assert "'bow' (aruco:0) is known by its number and takes no seed" in capsys.readouterr().err
    track_run_table = run / "own.csv"
    track_run_table.write_text("frame,t_s,marker,u_px,v_px\n0,0.0,bow,1,2\n1,0.1,bow,1,2\n")
    (run / "run.toml").write_text(text.replace('video = "discs.mkv"', 'tracks = "own.csv"'))
    assert main(["track", str(run), *seeds()]) == 1
    assert "the run comes with its tracks" in capsys.readouterr().err


def test_the_file_keeps_its_permissions_and_links(run: Path, tmp_path: Path) -> None:
    made = Corrections(point=(Placed(frame=1, marker='b"o\\w', pixel_px=(1.0, 2.25)),))
    put(run, made)
    path = run / "corrections.toml"
    os.chmod(path, 0o640)
    more = made.model_copy(update={"removed": (Removed(frame=4, marker="stern"),)})
    put(run, more)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    inside = run / "kept.toml"
    path.rename(inside)
    path.symlink_to(inside)
    put(run, made)
    assert path.is_symlink()
    assert inside.read_text() == text_of(made)
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere.toml")
    with pytest.raises(InputError, match="out of its folder"):
        put(run, made)
    assert not (tmp_path / "elsewhere.toml").exists()
    assert [p.name for p in run.iterdir() if p.name.startswith(".")] == []


def test_what_is_written_is_what_is_read(run: Path) -> None:
    made = Corrections(
        seed=(Placed(frame=4, marker="bow", pixel_px=(0.1 + 0.2, 1e-7)),),
        point=(Placed(frame=5, marker="stern", pixel_px=(1.0, 2.0), sigma_px=0.125),),
        removed=(Removed(frame=6, last_frame=8, marker="bow"), Removed(frame=9, marker="bow")),
    )
    put(run, made)
    assert read_corrections(read_run(run)) == made


@pytest.mark.slow
def test_corrections_are_an_input_of_all_that_follows(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = read_run(run).input_hash()
    put(run, Corrections(point=(Placed(frame=5, marker="bow", pixel_px=(60.0, 90.0)),)))
    assert read_run(run).input_hash() != before
    assert "corrections.toml" in read_run(run).input_hashes()
    assert main(["--json", "track", str(run), "--no-overlay"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert "by_hand" in json.dumps(said)
