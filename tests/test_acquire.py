"""Marks on any ground: found, told apart and held; refused with a reason where nothing tells them apart.

The scenes are the footage benchmark's: photographs that nobody here made as deck and tank, marks of known places.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
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


@pytest.mark.once
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


@pytest.mark.once
@pytest.mark.parametrize("seed", [4013, 9038, 9141])
def test_a_mark_whose_ground_may_move_it_too_far_is_nowhere_rather_than_elsewhere(
    footage: ModuleType, footage_scenes: ModuleType, seed: int
) -> None:
    """Marks of 1 to 2 px on a plate's corner, whose places were more than a pixel off."""
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.95 or found["reasons"]


@pytest.mark.once
@pytest.mark.parametrize("seed", [7132, 20062, 20416, 20830, 21193, 21528])
def test_a_mark_on_its_plates_corner_is_taken_for_one_like_its_fellows(
    footage: ModuleType, footage_scenes: ModuleType, seed: int
) -> None:
    """It looks half as wide again as the others at first, or more, and was up to 3 px off, or lost for its ground."""
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.98


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20050, 21022, 21188, 21627])
def test_marks_of_a_pixel_or_two_are_judged_by_pixels_enough(
    footage: ModuleType, footage_scenes: ModuleType, seed: int
) -> None:
    """Within 2.6 of the widths that their fits gave lay five pixels, which four parameters fit nearly without a residual."""
    found = followed(footage, footage_scenes, seed)
    assert found["wrong"] == 0
    assert found["held"] > 0.98


@pytest.mark.once
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


def tracked(folder: Path, text: str, frames: list[Frame], size_px: tuple[int, int] = (320, 240)) -> pd.DataFrame:
    (folder / "run.toml").write_text(text)
    (folder / "v.mp4").touch()
    run = read_run(folder)
    return track(run, frames, run_datum(run, size_px).mapping, lossy=False).table


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


WEAK_M_PX, WEAK_SIZE = 0.004, (640, 240)
"""Metres to a pixel, seen straight from above, and the picture's size."""
TAUT_M = {"line": 0.35, "tow_point": 0.9, "bow": 0.7, "stern": -0.7}


def towed(count: int, bar_level: float, rng: np.random.Generator) -> tuple[str, list[Frame], np.ndarray]:
    """A light deck on a line, a mark of a pixel on a dark bar and one on the bare deck, among brighter lamps and foam.

    run.toml, pictures, and the marks' pixels (count, 2, 2).
    """
    wide, high = WEAK_SIZE
    middle = high / 2

    def pixel(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([wide - 1 + x / WEAK_M_PX, middle + y / WEAK_M_PX], axis=-1)

    lines = ['name = "tow"', 'kind = "tow"', "[source]", 'video = "v.mp4"']
    for name, u, v in (("a", 0, 0), ("b", wide - 1, 0), ("c", 0, high - 1), ("d", wide - 1, high - 1)):
        x, y = (u - wide + 1) * WEAK_M_PX, (v - middle) * WEAK_M_PX
        lines += ["[[datum]]", f'name = "{name}"', f"pixel_px = [{u}, {v}]", f"tank_m = [{x}, {y}, 0.0]"]
    for name in ("bow", "stern"):
        lines += ["[[marker]]", f'name = "{name}"', f"body_m = [{TAUT_M[name]}, 0.0]", "depth_m = 0.0"]
    lines += ["[tow]", "speed_m_s = 1.0", f"line_length_m = {TAUT_M['line']}", f"tow_point_m = {TAUT_M['tow_point']}"]
    lines += ["[model]", "length_pp_m = 1.6", "mass_kg = 20.0", "[water]", "density_kg_m3 = 1000.0"]
    lamps = np.column_stack([rng.uniform(20, wide - 20, 4), np.where(rng.random(4) < 0.5, 20.0, high - 20.0)])
    axis = np.indices((high, wide), dtype=np.float32)
    still = np.full((high, wide), 30.0)
    for u, v in rng.uniform((5, 5), (wide - 5, high - 5), (400, 2)):  # foam
        still += 25 * np.exp(-((axis[1] - u) ** 2 + (axis[0] - v) ** 2) / (2 * 0.8**2))
    for u, v in lamps:
        still += 110 * np.exp(-((axis[1] - u) ** 2 + (axis[0] - v) ** 2) / (2 * 2.5**2))
    frames, places = [], []
    for index in range(count):
        t_s = index / 25
        line, heading = 0.10 * np.sin(0.8 * t_s + 0.5), 0.06 * np.cos(0.6 * t_s)
        hook = TAUT_M["line"] * np.array([-np.cos(line), np.sin(line)])
        ahead, across = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        centre = hook - TAUT_M["tow_point"] * ahead
        marks = np.array([pixel(*(centre + TAUT_M[name] * ahead)) for name in ("bow", "stern")])
        picture = still.copy()
        deck = centre + np.array([[0.8, 0], [0.4, 0.16], [-0.8, 0.16], [-0.8, -0.16], [0.4, -0.16]]) @ np.stack(
            [ahead, across]
        )
        bar = centre + np.array([[0.8, 0.006], [0.55, 0.006], [0.55, -0.006], [0.8, -0.006]]) @ np.stack(
            [ahead, across]
        )
        for corners, level in ((deck, 120.0), (bar, bar_level)):
            cv2.fillConvexPoly(picture, np.rint(16 * pixel(*corners.T)).astype(np.int32), level, cv2.LINE_AA, 4)
        for (u, v), height, width in zip(marks, (130.0, 130.0), (0.6, 1.0), strict=True):
            picture += height * np.exp(-((axis[1] - u) ** 2 + (axis[0] - v) ** 2) / (2 * width**2))
        noisy = picture + rng.normal(0, 4.0, picture.shape)
        frames.append(Frame(index, t_s, np.clip(np.rint(noisy), 0, 255).astype(np.uint8), None))
        places.append(marks)
    return "\n".join(lines) + "\n", frames, np.array(places)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "bar"), [(1, 70.0), (2, 70.0), (3, 20.0)])
def test_a_weak_mark_on_a_dark_bar_is_found_where_the_taut_line_leads(tmp_path: Path, seed: int, bar: float) -> None:
    """It is least significant of hundreds of spots, and lies where a model on its line has it: no lamp and no foam is taken."""
    text, frames, places = towed(20, bar, np.random.default_rng(seed))
    table = tracked(tmp_path, text, frames, WEAK_SIZE)
    seen = table[table["status"] == "measured"]
    assert len(seen) >= 0.5 * len(table)  # from when it is clear what moves with what
    true = places[seen["frame"], seen["marker"].map({"bow": 0, "stern": 1})]
    off = np.hypot(*(seen[["u_px", "v_px"]].to_numpy() - true).T)
    assert off.max() < 1.0
    # the one on the bare deck is not taken for one as narrow as its fellow, whose own fit the bar's rims disturb: it is known as
    # well as noise allows, sqrt(2 / pi) of noise over height for a Gaussian spot
    stern = seen["marker"].to_numpy() == "stern"
    bound_px = np.sqrt(2 / np.pi) * 4.0 / 130.0
    assert seen["sigma_u_px"][stern].median() < 1.5 * bound_px
    assert np.abs(off[stern]).mean() < 2 * bound_px


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 5])
def test_glints_that_were_soon_gone_are_taken_back_whole(tmp_path: Path, count: int) -> None:
    """Two that lie as the marks would, in the first frames: none of them stays measured, and the marks are found afterwards."""
    text, frames, places = towed(40, 70.0, np.random.default_rng(1))
    axis = np.indices(frames[0].luma.shape)
    for index in range(count):
        luma = np.full(frames[index].luma.shape, 30.0)
        for u, v in places[index] + np.array([0.0, 30.0]):
            luma += 130 * np.exp(-((axis[1] - u) ** 2 + (axis[0] - v) ** 2) / 2)
        frames[index] = replace(frames[index], luma=np.rint(luma).astype(np.uint8))
    table = tracked(tmp_path, text, frames, WEAK_SIZE)
    early = table[table["frame"] < count]
    assert early["reason"].str.startswith("not confirmed").all()
    assert early[["u_px", "v_px", "sigma_u_px"]].isna().all(axis=None)
    assert (table[table["frame"] >= 30]["status"] == "measured").all()


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


@pytest.mark.once
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
