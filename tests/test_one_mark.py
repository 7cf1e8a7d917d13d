"""One mark or one tag alone: tracked as well as one of several; what then cannot be computed is said by `track` and `motion`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from towline.cli import main
from towline.geometry import run_datum
from towline.record import TrackingError, read_run
from towline.vision import Frame, track

SIZE = (320, 240)
RATE_HZ = 30.0
SIGMA_PX, HEIGHT_DN, NOISE_DN, GROUND_DN = 2.0, 120.0, 2.0, 70.0
"""Of each spot, and of the picture's noise."""
FIRST_PX, RATE_PX = np.array([80.3, 100.7]), np.array([1.6, 0.5])
"""Where the mark is at first, and how far it goes from frame to frame."""
LAMPS_PX = ((60.0, 180.0), (200.0, 60.0), (260.0, 200.0))
"""Spots like the mark that stand still."""


def run_toml(look: str = "led", seen: bool = False, marks: int = 1) -> str:
    """A run whose pixels are 2 mm."""
    lines = ['name = "one"', 'kind = "free"', "[source]", 'video = "video.avi"']
    for u, v in ((0, 0), (319, 0), (0, 239), (319, 239)):
        lines += ["[[datum]]", f"pixel_px = [{u}, {v}]", f"tank_m = [{-v / 500}, {u / 500}, 0.0]"]
    for number in range(marks):
        lines += ["[[marker]]", f'name = "mark{number}"', f"body_m = [{number}.0, 0.0]", "depth_m = 0.0"]
        lines += [f'look = "{look}"'] + ([f"seen_at_px = [{FIRST_PX[0] + 2}, {FIRST_PX[1] - 1}]"] if seen else [])
    return "\n".join(lines) + "\n"


def pictures(count: int, lamps: bool = False, moves: bool = True, seed: int = 1) -> list[np.ndarray]:
    """The mark on its way, and lamps that stand."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    shown = []
    for index in range(count):
        picture = GROUND_DN + rng.normal(0, NOISE_DN, (SIZE[1], SIZE[0]))
        for place in (FIRST_PX + RATE_PX * index * moves, *(LAMPS_PX if lamps else ())):
            picture += HEIGHT_DN * np.exp(-((u - place[0]) ** 2 + (v - place[1]) ** 2) / (2 * SIGMA_PX**2))
        shown.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return shown


def tracked(folder: Path, text: str, shown: list[np.ndarray]) -> pd.DataFrame:
    (folder / "run.toml").write_text(text)
    (folder / "video.avi").touch()
    run = read_run(folder)
    frames = [Frame(index, index / RATE_HZ, luma, None) for index, luma in enumerate(shown)]
    return track(run, frames, run_datum(run, SIZE).mapping, lossy=False).table


def filmed(folder: Path, text: str, shown: list[np.ndarray]) -> Path:
    """A run folder with its video, without loss."""
    (folder / "run.toml").write_text(text)
    writer = cv2.VideoWriter(str(folder / "video.avi"), cv2.VideoWriter.fourcc(*"FFV1"), RATE_HZ, SIZE)
    for luma in shown:
        writer.write(cv2.cvtColor(luma, cv2.COLOR_GRAY2BGR))
    writer.release()
    return folder


def off_by(table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 2) px of what was measured, and how many sigmas they are."""
    seen = table[table["status"] == "measured"]
    gap = seen[["u_px", "v_px"]].to_numpy() - FIRST_PX - RATE_PX * seen["frame"].to_numpy()[:, None]
    return gap, gap / seen[["sigma_u_px", "sigma_v_px"]].to_numpy()


@pytest.mark.once
@pytest.mark.parametrize(("lamps", "seen"), [(False, False), (False, True), (True, True), (True, False)])
def test_one_mark_is_tracked_among_others_too_where_it_is_told_or_moves(
    tmp_path: Path, lamps: bool, seen: bool
) -> None:
    table = tracked(tmp_path, run_toml(seen=seen), pictures(90, lamps))
    assert (table["status"] == "measured").all()
    gap, ratio = off_by(table)
    assert np.abs(gap).max() < 0.2  # never a lamp
    # 180 numbers: their spread is known to 5 %
    assert 0.8 < ratio.std() < 1.2


@pytest.mark.slow
def test_one_of_several_that_nothing_tells_apart_is_not_guessed(tmp_path: Path) -> None:
    with pytest.raises(TrackingError, match=r"mark0.*several of which could be it; say where.*seen_at_px"):
        tracked(tmp_path, run_toml(), pictures(60, lamps=True, moves=False))


def tag_pictures(count: int) -> list[np.ndarray]:
    """A tag 41 px wide that goes its way by whole pixels, white around it."""
    tag = cv2.copyMakeBorder(
        cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 3, 42),
        8, 8, 8, 8, cv2.BORDER_CONSTANT, value=(220,),
    )  # fmt: skip
    rng, shown = np.random.default_rng(2), []
    for index in range(count):
        picture = np.full((SIZE[1], SIZE[0]), GROUND_DN)
        picture[90 : 90 + 58, 60 + index : 60 + index + 58] = np.clip(tag, 30, 220)
        picture = cv2.GaussianBlur(picture, (0, 0), 0.9) + rng.normal(0, NOISE_DN, picture.shape)
        shown.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return shown


def test_one_tag_alone_is_tracked(tmp_path: Path) -> None:
    table = tracked(tmp_path, run_toml("aruco:3"), tag_pictures(20))
    assert (table["status"] == "measured").all()
    middle = np.column_stack([60 + np.arange(20) + 28.5, np.full(20, 90 + 28.5)])
    assert np.abs(table[["u_px", "v_px"]].to_numpy() - middle).max() < 0.05


def test_what_one_mark_cannot_tell_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = filmed(tmp_path, run_toml(), pictures(40))
    missing = "the heading, with it the motion (y_CG, beta, alpha) and the derivatives, need a second [[marker]]"
    for _ in range(2):  # tracked anew, and kept
        assert main(["track", str(run), "--no-overlay"]) == 0
        said = capsys.readouterr()
        assert "mark0 measured in 100.00 %" in said.out
        assert missing in said.out + said.err
    for command in ("motion", "check", "run", "identify", "steady"):
        assert main([command, str(run)]) in (1, 3), command
        said = capsys.readouterr().err
        lines = [line for line in said.splitlines() if missing in line]
        assert len(lines) == 1, (command, said)
        assert "Traceback" not in said
    (run / "run.toml").write_text(run_toml(marks=0))
    assert main(["track", str(run)]) == 1
    assert "none on the model; a motion needs at least 2, tracks alone 1" in capsys.readouterr().err
