"""Marks on any ground: found, told apart and held; refused with a reason where nothing tells them apart.

The scenes are the footage benchmark's: photographs that nobody here made as deck and tank, marks of known places.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pandas as pd
import pytest

from towline.geometry import run_datum
from towline.pipeline.stages import track_run
from towline.record import read_run
from towline.record.errors import TrackingError
from towline.vision import track
from towline.vision.recording import Frame
from towline.vision.spots.ring import stands_out
from towline.vision.spots.scales import find_spots

WIDTH_PX = 3.0
MIDDLE_PX = np.array([160.0, 120.0])
FPS = 30000 / 1001
"""Of the rolling cylinder's recording."""
START_PX = (251.9, 106.4), (247.7, 129.1)
"""Its dots in frame 120."""
BLOB_PX = 0.135
"""Rigid scatter that OpenCV's blob detector leaves there, the largest of nine starts."""


def picture(dark: bool = False) -> np.ndarray:
    """A light plate (its rim at u = 40) on a dark ground, with a spot of 3 px at (70, 50)."""
    v, u = np.indices((100, 120), dtype=np.float32)
    ground = 60 + 120 / (1 + np.exp(-(u - 40)))
    spot = np.exp(-((u - 70) ** 2 + (v - 50) ** 2) / (2 * WIDTH_PX**2))
    return ground + (-80 if dark else 50) * spot


@pytest.mark.parametrize("dark", [False, True])
def test_a_mark_stands_out_and_the_rim_of_its_plate_does_not(dark: bool) -> None:
    """The ground beyond the rim is darker than the dark mark; yet it is the mark that stands out."""
    values = picture(dark)
    rise, rim = stands_out(-values if dark else values, WIDTH_PX)
    v, u = np.unravel_index(rise.argmax(), rise.shape)
    assert (u + rim, v + rim) == (70, 50)
    assert rise.max() > 0.6 * (80 if dark else 50)
    away = np.ones(rise.shape, dtype=bool)
    away[v - 12 : v + 13, u - 12 : u + 13] = False
    assert rise[away].max() < 1e-3


def test_a_lamp_beside_a_mark_does_not_hide_it() -> None:
    """Twice as bright, five widths away: the mark still rises by nearly all that it does alone."""
    v, u = np.indices((100, 120), dtype=np.float32)
    lamp = 100 * np.exp(-((u - 85) ** 2 + (v - 50) ** 2) / (2 * WIDTH_PX**2))
    alone, rim = stands_out(picture(), WIDTH_PX)
    beside, _ = stands_out(picture() + lamp, WIDTH_PX)
    assert beside[50 - rim, 70 - rim] > 0.9 * alone[50 - rim, 70 - rim]


@pytest.mark.parametrize("diameter_px", [2.5, 5.0, 10.0, 20.0, 30.0])
@pytest.mark.parametrize("dark", [False, True])
def test_spots_of_all_sizes_are_found_with_their_width(
    footage_scenes: ModuleType, diameter_px: float, dark: bool
) -> None:
    """A disc on a textured photograph; its width is that of a Gaussian of the same area at half height."""
    sign = -1.0 if dark else 1.0
    ground = footage_scenes.photograph("gravel.png", 120.0, 3.0, (240, 200)).copy()
    footage_scenes.cover_by_disc(ground, np.array([121.3, 98.6]), diameter_px, 0.8, 120.0 + sign * 60.0)
    noisy = ground + np.random.default_rng(1).normal(0, 1.0, ground.shape)
    found = find_spots(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), dark)
    away = np.hypot(*(found.centre_px - (121.3, 98.6)).T)
    best = int(np.argmin(away))
    assert away[best] < 0.5 + 0.05 * diameter_px
    width = np.hypot(diameter_px / 2 / 1.18, 0.8)
    assert 0.6 < found.width_px[best] / width < 1.5


def followed(footage: ModuleType, footage_scenes: ModuleType, seed: int) -> dict:
    """What is right, wrong and lost of a scene's marks."""
    one = footage_scenes.scene(seed)
    return footage.ours(one, list(one.frames()))


@pytest.mark.parametrize("seed", [*range(2000, 2012), 2013, 2048, 2049, 7028, 7127, 7200, 9165, 9263, 9284])
def test_marks_on_photographs_are_acquired_and_held(footage: ModuleType, footage_scenes: ModuleType, seed: int) -> None:
    """No mark in the wrong place, and at least 95 of 100 of all places found.

    Of the last ones 2013, 2048 have marks of 1.3 and 1.5 px whose shape cannot be told, 2049 dots on a moon whose craters fit
    nearly as well; small marks of 7028 move by half of their distance in a frame; 7127, 7200 are wide, with bumps of noise on their
    rims; in 9263 the puck is darker than the mark on it, in 9165, 9284 a free shape holds a part of the plate.
    """
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.95


@pytest.mark.parametrize("seed", [4013, 9038, 9141])
def test_a_mark_whose_ground_may_move_it_too_far_is_nowhere_rather_than_elsewhere(
    footage: ModuleType, footage_scenes: ModuleType, seed: int
) -> None:
    """Marks of 1 to 2 px on a plate's corner, whose places were more than a pixel off."""
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.95 or found["reasons"]


@pytest.mark.parametrize("seed", [7132, 20062, 20416, 20830, 21193, 21528])
def test_a_mark_on_its_plates_corner_is_taken_for_one_like_its_fellows(
    footage: ModuleType, footage_scenes: ModuleType, seed: int
) -> None:
    """It looks half as wide again as the others at first, or more, and was up to 3 px off, or lost for its ground."""
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.98


@pytest.mark.parametrize("seed", [20050, 21022, 21188, 21627])
def test_marks_of_a_pixel_or_two_are_judged_by_pixels_enough(
    footage: ModuleType, footage_scenes: ModuleType, seed: int
) -> None:
    """Within 2.6 of the widths that their fits gave lay five pixels, which four parameters fit nearly without a residual."""
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.98


@pytest.mark.parametrize("seed", [20005, 21000, 21053, 21226])
def test_marks_before_strong_print_or_gravel_are_found(
    footage: ModuleType, footage_scenes: ModuleType, seed: int
) -> None:
    """Weaker than what stands behind: before more noise than their plate has, or best but by their contrast."""
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.95


def turning(count: int, seeded: bool) -> tuple[str, list[Frame]]:
    """Two like discs that turn about their middle, seen straight from above; run.toml and pictures."""
    lines = ['name = "pair"', 'kind = "free"', "[source]", 'video = "v.mp4"']
    for name, u, v in (("a", 0, 0), ("b", 319, 0), ("c", 0, 239), ("d", 319, 239)):
        lines += ["[[datum]]", f'name = "{name}"', f"pixel_px = [{u}, {v}]", f"tank_m = [{-v / 250}, {u / 250}, 0.0]"]
    frames = []
    for index in range(count):
        turn = 0.05 * index
        luma = np.full((240, 320), 90, np.uint8)
        arm = 40 * np.array([np.cos(turn), np.sin(turn)])
        for place in (MIDDLE_PX + arm, MIDDLE_PX - arm):
            cv2.circle(luma, tuple(int(x) for x in np.rint(place * 16)), 5 * 16, 200, -1, cv2.LINE_AA, 4)
        frames.append(Frame(index, index / 30, cv2.GaussianBlur(luma, (0, 0), 0.8), None))
    for name, x, u in (("bow", 0.16, 200.0), ("stern", -0.16, 120.0)):
        lines += ["[[marker]]", f'name = "{name}"', f"body_m = [{x}, 0.0]", "depth_m = 0.0", 'look = "disc"']
        lines += ['colour = "bright"'] + ([f"seen_at_px = [{u + 2}, 118.0]"] if seeded else [])
    return "\n".join(lines) + "\n", frames


def tracked(folder: Path, text: str, frames: list[Frame]) -> pd.DataFrame:
    (folder / "run.toml").write_text(text)
    (folder / "v.mp4").touch()
    run = read_run(folder)
    return track(run, frames, run_datum(run, (320, 240)).mapping, lossy=False).table


def test_marks_that_nothing_tells_apart_are_refused_and_the_cure_is_said(tmp_path: Path) -> None:
    with pytest.raises(TrackingError, match=r"nothing tells them apart.*seen_at_px.*third mark"):
        tracked(tmp_path, *turning(30, seeded=False))


def test_what_was_wrong_with_spots_that_did_not_hold_is_said(tmp_path: Path) -> None:
    """Two discs that are gone after two frames were not the marks: the message says when they were seen, and what was missing."""
    text, frames = turning(2, seeded=True)
    frames += [Frame(k, k / 30, np.full((240, 320), 90, np.uint8), None) for k in range(2, 30)]
    with pytest.raises(
        TrackingError, match=r"never found.*t = 0\.00 s did not hold \(bow: .*no spot in \d of \d frames; stern: "
    ):
        tracked(tmp_path, text, frames)


def test_with_a_seed_the_same_marks_keep_their_names(tmp_path: Path) -> None:
    table = tracked(tmp_path, *turning(90, seeded=True))
    assert (table["status"] == "measured").all()
    bow = table[table["marker"] == "bow"]
    turn = 0.05 * bow["frame"].to_numpy()
    gap = bow[["u_px", "v_px"]].to_numpy() - MIDDLE_PX - 40 * np.column_stack([np.cos(turn), np.sin(turn)])
    assert np.abs(gap).max() < 0.1


def blob(path: Path, first: int, last: int) -> np.ndarray:
    """(frames, 2, 2) places of the dark dots by OpenCV's blob detector, linked to the nearest."""
    wanted = cv2.SimpleBlobDetector_Params()
    wanted.filterByColor, wanted.blobColor, wanted.filterByArea, wanted.minArea, wanted.maxArea = True, 0, True, 3, 60
    wanted.filterByCircularity = wanted.filterByConvexity = wanted.filterByInertia = False
    wanted.minThreshold, wanted.maxThreshold, wanted.thresholdStep = 20, 240, 10
    wanted.minDistBetweenBlobs, wanted.minRepeatability = 3, 2
    detector, clip, last_px, rows = (
        cv2.SimpleBlobDetector.create(wanted),
        cv2.VideoCapture(str(path)),
        np.array(START_PX),
        [],
    )
    for index in range(last):
        _, frame = clip.read()
        if index < first:
            continue
        seen = np.array([k.pt for k in detector.detect(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))])
        last_px = np.array([seen[np.argmin(np.hypot(*(seen - place).T))] for place in last_px])
        rows.append(last_px)
    return np.array(rows)


def rigid_scatter(place: np.ndarray) -> float:
    """Sd of the pair's distance about what its place and its turning explain (perspective), px."""
    middle, arm = place.mean(axis=1), place[:, 0] - place[:, 1]
    twice = 2 * np.arctan2(arm[:, 1], arm[:, 0])
    basis = np.column_stack([np.ones(len(arm)), middle, np.cos(twice), np.sin(twice)])
    distance = np.hypot(*arm.T)
    return float(np.std(distance - basis @ np.linalg.lstsq(basis, distance, rcond=None)[0]))


@pytest.mark.parametrize("start", [120, 140, 160, 180, 200])
def test_dots_on_a_small_disc_of_a_real_recording(shared: Path, tmp_path: Path, start: int) -> None:
    """Two dark dots on a white disc that rolls over darker ground, from several frames of its way."""
    source = shared / "real" / "rolling_cylinder" / "RollingCylinder.MP4"
    reference = blob(source, 120, 263)
    shutil.copy(source, tmp_path / "v.mp4")
    lines = ['name = "r"', 'kind = "free"', "[source]", 'video = "v.mp4"']
    lines += [f"span_s = [{(start - 0.5) / FPS:.3f}, {262.5 / FPS:.3f}]"]
    for name, u, v in (("a", 10, 10), ("b", 310, 10), ("c", 10, 230), ("d", 310, 230)):
        lines += ["[[datum]]", f'name = "{name}"', f"pixel_px = [{u}, {v}]"]
        lines += [f"tank_m = [{(120 - v) * 0.003:.3f}, {(u - 160) * 0.003:.3f}, 0.0]"]
    for name, x, (u, v) in zip(("m1", "m2"), (0.03465, -0.03465), reference[start - 120], strict=True):
        lines += ["[[marker]]", f'name = "{name}"', f"body_m = [{x}, 0]", "depth_m = 0.0", 'look = "disc"']
        lines += ['colour = "dark"', f"seen_at_px = [{u:.1f}, {v:.1f}]"]
    (tmp_path / "run.toml").write_text("\n".join(lines) + "\n")
    table = track_run(read_run(tmp_path)).table
    place = np.stack([table[table["marker"] == m][["u_px", "v_px"]].to_numpy() for m in ("m1", "m2")], axis=1)
    seen = np.isfinite(place).all(axis=(1, 2))
    assert np.isfinite(place).mean() > 0.99
    their = reference[start - 120 :][: len(place)]
    assert np.hypot(*(place - their)[seen].T).max() < 1.0  # none swapped, none elsewhere
    assert rigid_scatter(place[seen]) <= rigid_scatter(their[seen])
