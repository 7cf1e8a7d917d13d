"""What people use instead, on the same clips: trackpy, OpenCV's blob detector and optical flow, scikit-image's regions.

Peers are helped: they get the part of the picture where the marks will be, settings by the marks' true width, and which
spot is which mark from the truth of the frame before. They are not timed for deciding that.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from vision_clips import AMPLITUDE_DN, GROUND_DN, NAMES, Clip, Scene

from towline.vision import read_frames

MARGIN_PX = 40
"""Peers see the marks' whole path and this much around it."""
GATE_PX = 8.0
"""A spot farther than this from the mark's true place in the frame before is not taken for it."""
KLT_WINDOW_PX = 31
TRACKPY_PATCH_PX = 51
"""Wider than the patch: the smallest at which its centroid stands still."""
COLUMNS = ("frame", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status")

Spots = np.ndarray
"""(k, 3): u px, v px, stated standard deviation px (NaN = none)."""
Peer = Callable[[np.ndarray, Scene], Spots]


@dataclass(frozen=True)
class Answer:
    """What a method says of a clip.

    Attributes
    ----------
    table : frame, marker, u_px, v_px, sigma_u_px, sigma_v_px, status
    frames : looked at
    cpu_s : without decoding for the peers, with it for towline
    """

    table: pd.DataFrame
    frames: int
    cpu_s: float


def trackpy(picture: np.ndarray, scene: Scene) -> Spots:
    """trackpy.locate: diameter five widths, the brightest 2 % of the pixels as candidates, about a fifth of a mark's mass."""
    import trackpy as tp

    width = scene.condition.width_px
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = tp.locate(picture, 2 * round(2.5 * width) + 1, minmass=90 * width**2, percentile=98)
    return _trackpy_spots(found)


def _trackpy_spots(found: pd.DataFrame) -> Spots:
    if not len(found):
        return np.empty((0, 3))
    stated = found["ep"].to_numpy(dtype=float) if "ep" in found else np.full(len(found), np.nan)
    stated = np.where(np.isfinite(stated) & (stated > 0), stated, np.nan)
    return np.column_stack([found["x"], found["y"], stated])


def blob(picture: np.ndarray, scene: Scene) -> Spots:
    """OpenCV's SimpleBlobDetector: a threshold every 5 DN from 15 DN above the ground, no filter but the area."""
    import cv2

    settings = cv2.SimpleBlobDetector.Params()
    settings.blobColor, settings.filterByArea, settings.minArea, settings.maxArea = 255, True, 4.0, 400.0
    settings.filterByCircularity = settings.filterByConvexity = settings.filterByInertia = False
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = GROUND_DN + 15, 200, 5
    points = cv2.SimpleBlobDetector.create(settings).detect(np.ascontiguousarray(picture))
    return np.array([[*p.pt, np.nan] for p in points]).reshape(-1, 3)


def regions(picture: np.ndarray, scene: Scene) -> Spots:
    """scikit-image: a low threshold (above noise, rail and reflection beside), centroid weighted with the height above ground.

    Lower is better while nothing else stands above it: at half height the error is twice as large.
    """
    from skimage.measure import label, regionprops

    ground = float(np.median(picture))
    noise = 1.4826 * float(np.median(np.abs(picture - ground)))
    share = 0.4 if scene.condition.rail else 0.15
    labels = label(picture > ground + max(share * AMPLITUDE_DN, 5 * noise))
    above = np.maximum(picture.astype(float) - ground, 0.0)
    places = [r.centroid_weighted[::-1] for r in regionprops(labels, intensity_image=above) if r.area >= 4]
    return np.array([[*p, np.nan] for p in places]).reshape(-1, 3)


PEERS: dict[str, Peer] = {"trackpy": trackpy, "OpenCV blob": blob, "skimage": regions}


def path_box(scene: Scene) -> tuple[slice, slice]:
    """Rows and columns of the marks' path with its margin."""
    low = np.floor(scene.places_px.min(axis=(0, 1))).astype(int) - MARGIN_PX
    high = np.ceil(scene.places_px.max(axis=(0, 1))).astype(int) + MARGIN_PX
    low = np.maximum(low, 0)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def answers(clip: Clip, every: int, peers: dict[str, Peer] = PEERS) -> dict[str, Answer]:
    """All peers over every ``every``-th frame of a clip, decoded once."""
    scene = clip.scene
    box = path_box(scene)
    corner = np.array([box[1].start, box[0].start, 0.0])
    rows: dict[str, list[tuple]] = {name: [] for name in peers}
    spent = dict.fromkeys(peers, 0.0)
    count = 0
    for frame in read_frames(clip.video):
        if frame.index % every:
            continue
        count += 1
        picture = np.ascontiguousarray(frame.luma[box])
        for name, peer in peers.items():
            began = time.process_time()
            spots = peer(picture, scene)
            spent[name] += time.process_time() - began
            rows[name] += _named(frame.index, spots + corner, scene)
    return {name: Answer(pd.DataFrame(rows[name], columns=list(COLUMNS)), count, spent[name]) for name in peers}


def _named(index: int, spots: Spots, scene: Scene) -> Iterator[tuple]:
    """Rows of one frame: the spot nearest to each mark's true place in the frame before."""
    before = scene.places_px[max(index - 1, 0)]
    for mark, name in enumerate(NAMES):
        gap = np.hypot(*(spots[:, :2] - before[mark]).T) if len(spots) else np.array([np.inf])
        best = int(np.argmin(gap))
        if gap[best] < GATE_PX:
            u, v, sd = spots[best]
            yield (index, name, u, v, sd, sd, "measured")
        else:
            yield (index, name, np.nan, np.nan, np.nan, np.nan, "lost")


def whole_frame_rates(clip: Clip, frames: int = 4) -> dict[str, float]:
    """Frames per CPU-second of each peer on the whole picture."""
    rates = {}
    pictures = []
    for frame in read_frames(clip.video):
        pictures.append(frame.luma.copy())
        if len(pictures) == frames:
            break
    for name, peer in PEERS.items():
        began = time.process_time()
        for picture in pictures:
            peer(picture, clip.scene)
        rates[name] = frames / max(time.process_time() - began, 1e-9)
    return rates


# unlit marks ----------------------------------------------------------------------------------------------------------


def patch_answers(clip: Clip, every: int) -> dict[str, Answer]:
    """Textured patches: trackpy on their whole blob, and OpenCV's pyramidal Lucas-Kanade in two ways.

    ``KLT chained`` follows from frame to frame, so its errors add up; ``KLT to first`` compares every frame with the first,
    starting at the truth of the frame before.
    """
    scene = clip.scene
    names = ("trackpy", "KLT chained", "KLT to first")
    rows: dict[str, list[tuple]] = {name: [] for name in names}
    spent = dict.fromkeys(names, 0.0)
    first = before = None
    chained = scene.places_px[0].astype(np.float32)
    count = tracked = 0
    for frame in read_frames(clip.video):
        picture = frame.luma.copy()
        count += 1
        if first is None or before is None:
            first = before = picture
        began = time.process_time()
        chained = _flow(before, picture, chained, chained)
        spent["KLT chained"] += time.process_time() - began
        began = time.process_time()
        guess = scene.places_px[max(frame.index - 1, 0)].astype(np.float32)
        direct = _flow(first, picture, scene.places_px[0].astype(np.float32), guess)
        spent["KLT to first"] += time.process_time() - began
        before = picture
        for name, places in (("KLT chained", chained), ("KLT to first", direct)):
            rows[name] += [_row(frame.index, mark, place) for mark, place in enumerate(places)]
        if frame.index % every == 0:
            tracked += 1
            began = time.process_time()
            spots = _patch_spots(picture, scene)
            spent["trackpy"] += time.process_time() - began
            for mark, found in enumerate(spots):
                name_row = list(_named(frame.index, found, scene))[mark]
                rows["trackpy"].append(name_row)
    looked = {"trackpy": tracked, "KLT chained": count, "KLT to first": count}
    return {n: Answer(pd.DataFrame(rows[n], columns=list(COLUMNS)), looked[n], spent[n]) for n in names}


def _row(index: int, mark: int, place: np.ndarray) -> tuple:
    status = "measured" if np.isfinite(place).all() else "lost"
    return (index, NAMES[mark], float(place[0]), float(place[1]), np.nan, np.nan, status)


def _flow(before: np.ndarray, after: np.ndarray, places: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Places (2, 2) after the step; NaN where the flow gives up."""
    import cv2

    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    moved, good, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        places[:, None],
        guess[:, None].copy(),
        winSize=(KLT_WINDOW_PX, KLT_WINDOW_PX),
        maxLevel=2,
        criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.where(good.reshape(-1, 1) == 1, moved.reshape(-1, 2), np.nan).astype(np.float32)


def _patch_spots(picture: np.ndarray, scene: Scene) -> list[Spots]:
    """The bright patch, then the dark one, as one blob each."""
    import trackpy as tp

    box = path_box(scene)
    found = []
    for dark in (False, True):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            table = tp.locate(
                np.ascontiguousarray(picture[box]), TRACKPY_PATCH_PX, invert=dark, topn=3, percentile=97, separation=15
            )
        found.append(_trackpy_spots(table) + np.array([box[1].start, box[0].start, 0.0]))
    return found


__all__ = ["PEERS", "Answer", "answers", "patch_answers", "path_box", "whole_frame_rates"]
