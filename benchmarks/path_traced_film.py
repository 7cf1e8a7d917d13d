"""Frames of a path-traced tow: light, sensor, codec; and what is true of each."""

from __future__ import annotations

import json
import os
import time
from fractions import Fraction
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any

import numpy as np
import pandas as pd
from path_traced_bodies import line_body, moved
from path_traced_cases import TOWS, Array, marks_px, motion_of, placed, told, truth_of
from path_traced_scene import (
    EVERY,
    GLOW_PX,
    GLOW_RAYS,
    HULL_RAYS,
    LOOP,
    NEAR_PX,
    NEAR_RAYS,
    SPOT_PX,
    STATIC_RAYS,
    WATER_RAYS,
    Tank,
    pixels_of,
)
from scipy.special import ndtr

GAMMA, BANDS, MOST = 2.2, 4, 1.0
"""Of the picture's values; the whole picture is rendered in so many bands, for the memory's sake; a single ray brings no more than
so many of the sensor's full wells (what a mark shows directly does not come this way)."""
ROW = 1 << 24
"""Normal numbers that are drawn for the sensor's noise."""
SMOOTH, SMOOTH_PX = ("water", "deck", "sides", "room", "iron", "bar"), 2.0
"""Bodies whose light is evened out, away from the marks, and how wide (standard deviation): few rays make grains as bright as a
mark, which no camera sees."""
AHEAD = 4
"""Frames that wait for the codec."""
EMPTY = "empty.npy"
"""The empty tank's pictures in a campaign's folder, for a campaign that was stopped; gone once it is filmed."""


def scattered(tank: Tank, hits: Array, share: float, steps_px: Array, middle: Array) -> Array:
    """Light of a mark's rays, of unit radiance, through blur and square pixels: (2 SPOT_PX + 1, same), rows first."""
    blur, at = tank.case["camera"]["blur_px"], np.arange(-SPOT_PX, SPOT_PX + 1)
    total = np.zeros((len(at), len(at)))
    for step in steps_px:
        where = hits + step - middle
        across, down = (
            ndtr((at + 0.5 - where[:, axis, None]) / blur) - ndtr((at - 0.5 - where[:, axis, None]) / blur)
            for axis in (0, 1)
        )
        total += down.T @ across
    return total * share / len(steps_px)


class Studio:
    """A campaign's tank with its empty pictures and its exposure."""

    def __init__(self, case: dict[str, Any], seed: int, home: Path | None = None) -> None:
        self.case, self.tank = case, Tank(case, case["rate_hz"])
        self.rng = np.random.default_rng([seed, case["number"], 2])
        self.width, self.height = self.tank.camera.size_px
        self.most, self.row = 1e9, None
        first = motion_of(case, 0)
        state = states(first)[0]
        self.tank.put(0, state, case["tows"][0]["tow_point_m"])
        deck = pixels_of(self.tank.camera, [moved(self.tank.body["deck"][0], state)], 0)
        seen = self._evenly(deck[:: max(len(deck) // 3000, 1)], 16).mean()
        self.exposure = case["light"]["deck_level"] / seen
        self.most = MOST / self.exposure
        place = placed(first, [case["marks"][0]["body_m"]], [case["marks"][0]["depth_m"]])[0, 0]
        hits, share = self.tank.seen(0, place, self.rng)
        spot = scattered(self.tank, hits, share, np.zeros((1, 2)), np.round(self.tank.camera.pixel(place)))
        self.radiance = case["light"]["peak_level"] / (self.exposure * spot.max())
        self.empty = self._kept(home / EMPTY) if home is not None else self._empty()

    def _kept(self, path: Path) -> Array:
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = path.with_suffix(".unfinished.npy")
            np.save(unfinished, self._empty().astype(np.float16))
            os.replace(unfinished, path)
        everywhere = np.stack(np.meshgrid(np.arange(self.width), np.arange(self.height)), -1).reshape(-1, 2)
        self.tank.put(0, None)
        self.behind = self.tank.bodies(everywhere, SMOOTH).reshape(self.height, self.width)
        return np.load(path).astype(np.float32)

    def _empty(self) -> Array:
        """The tank without the hull, for each of the water's frames: (LOOP, height, width, 3), light."""
        tank = self.tank
        everywhere = np.stack(np.meshgrid(np.arange(self.width), np.arange(self.height)), -1).reshape(-1, 2)
        tank.put(0, None)
        self.behind = tank.bodies(everywhere, SMOOTH).reshape(self.height, self.width)
        wet = self.behind == SMOOTH.index("water") + 1
        kept = np.zeros((self.height, self.width, 3), dtype=np.float32)
        for some in np.array_split(everywhere, 4 * BANDS):
            kept[some[:, 1], some[:, 0]] = self._evenly(some, STATIC_RAYS)
        # a pixel at the water's edge sees both
        edge = pixels_of_mask(wet, 3)
        pictures = np.repeat(smoothed(kept, self.behind)[None], LOOP, axis=0)
        for frame in range(LOOP):
            tank.put(frame, None)
            for some in np.array_split(edge, BANDS):
                pictures[frame, some[:, 1], some[:, 0]] = self._evenly(some, WATER_RAYS)
            pictures[frame][wet] = smoothed(pictures[frame], np.where(wet, self.behind, 0))[wet]
        return pictures

    def _evenly(self, pixels: Array, rays: int) -> Array:
        """The lamps' light of pixels, so many rays each."""
        return self.tank.light(self.tank.lamps, pixels, np.full(len(pixels), rays), self.rng, self.most)

    def light(
        self, frame: int, state: tuple[float, float, float], tow_point_m: float, places: Array, speed_px_s: Array
    ) -> Array:
        """The light of a frame, (height, width, 3), 1 = the sensor's full well."""
        tank, case = self.tank, self.case
        whole = frame % EVERY == 0
        tank.put(frame, state, tow_point_m, whole)
        marks = tank.camera.pixel(places)
        picture = self.empty[frame % LOOP].copy()
        if whole:
            around = self._around(state, tow_point_m)
            around = around[_from_marks(around, marks) > NEAR_PX]
            self.lit = around, self._smooth(picture, around)
        put_into(picture, *self.lit)
        at = np.arange(-GLOW_PX, GLOW_PX + 1)
        window = np.stack(np.meshgrid(at, at), -1).reshape(-1, 2)
        glows = np.unique((np.round(marks).astype(int)[:, None] + window).reshape(-1, 2), axis=0)
        far = _from_marks(glows, marks)
        put_into(picture, glows[far <= NEAR_PX], self._evenly(glows[far <= NEAR_PX], NEAR_RAYS))
        rays = np.where(far <= NEAR_PX, NEAR_RAYS, GLOW_RAYS)
        glow = tank.light(tank.glow, glows, rays, self.rng, self.most / self.radiance)
        picture[glows[:, 1], glows[:, 0]] += self.radiance * glow
        colour = np.array(case["light"]["led_colour"])
        for k, place in enumerate(places):
            hits, share = tank.seen(k, place, self.rng)
            middle = np.round(marks[k]).astype(int)
            steps = np.array([[-0.25], [0.25]]) * case["camera"]["exposure_s"] * speed_px_s[k]
            spot = scattered(tank, hits, share, steps, middle)
            rows, columns = (slice(middle[axis] - SPOT_PX, middle[axis] + SPOT_PX + 1) for axis in (1, 0))
            picture[rows, columns] += self.radiance * spot[..., None] * colour
        return np.float32(self.exposure) * picture

    def _smooth(self, picture: Array, pixels: Array) -> Array:
        """The lamps' light of pixels, of few rays each, evened out over each body."""
        low, high = pixels.min(axis=0), pixels.max(axis=0) + 1
        values, behind = (a[low[1] : high[1], low[0] : high[0]].copy() for a in (picture, self.behind))
        inside = pixels - low
        put_into(values, inside, self._evenly(pixels, HULL_RAYS))
        put_into(behind, inside, self.tank.bodies(pixels, SMOOTH))
        return smoothed(values, behind)[inside[:, 1], inside[:, 0]]

    def _around(self, state: tuple[float, float, float], tow_point_m: float) -> Array:
        """Pixels that the hull, its mirror image, its bar or its line may reach, (n, 2)."""
        tank = self.tank
        deck = moved(np.concatenate([tank.body["deck"][0], tank.body["sides"][0][len(tank.body["deck"][0]) :]]), state)
        deck[:, 2] = np.minimum(deck[:, 2], tank.water.z_m)
        mirrored = deck * (1, 1, -1) + (0, 0, 2 * tank.water.z_m)
        bar = moved(tank.body["bar"][0], state)
        line = line_body(self.case, tow_point_m, state)[0]
        return pixels_of(tank.camera, [np.concatenate([deck, bar]), np.concatenate([mirrored, deck]), line], 4)

    def _noise(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        """Normal numbers out of a long row of them, from another place each time."""
        if self.row is None:
            self.row = rng.standard_normal(ROW, dtype=np.float32)
        count = int(np.prod(shape))
        first = int(rng.integers(ROW - count))
        return self.row[first : first + count].reshape(shape)

    def sensed(self, light: Array, depth: int, rng: np.random.Generator) -> Array:
        """The sensor's numbers of a frame: shot and read noise, gamma, ``depth`` bits."""
        camera = self.case["camera"]
        sd = np.sqrt(light / np.float32(camera["full_well"]) + np.float32(camera["read_noise"] ** 2))
        value = np.clip(light + sd * self._noise(light.shape, rng), 0, 1) ** (1 / GAMMA)
        top = 2**depth - 1
        return np.round(value * top).astype(np.uint8 if depth == 8 else np.uint16)


def _from_marks(pixels: Array, marks: Array) -> Array:
    """The larger of the distances along both axes to the nearest mark, px."""
    return np.abs(pixels[:, None, :] - marks[None]).max(axis=-1).min(axis=1)


def put_into(picture: Array, pixels: Array, light: Array) -> None:
    """Pixels' light."""
    picture[pixels[:, 1], pixels[:, 0]] = light


def smoothed(picture: Array, behind: Array) -> Array:
    """A picture whose few rays a pixel are evened out (``SMOOTH_PX``) over each of its bodies, and never across their edges."""
    import cv2

    done = picture.copy()
    for number in range(1, len(SMOOTH) + 1):
        here = behind == number
        if here.any():
            share = here.astype(np.float32)
            total = cv2.GaussianBlur(picture * share[..., None], (0, 0), SMOOTH_PX)
            done[here] = (total / np.maximum(cv2.GaussianBlur(share, (0, 0), SMOOTH_PX), 1e-6)[..., None])[here]
    return done


def pixels_of_mask(mask: Array, grow_px: int) -> Array:
    """Whole-number pixels of a mask, grown: (n, 2)."""
    import cv2

    size = 2 * grow_px + 1
    rows, columns = np.nonzero(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), dtype=np.uint8)))
    return np.stack([columns, rows], -1)


def states(motion: pd.DataFrame) -> list[tuple[float, float, float]]:
    """x_cg_m, y_cg_m, beta_rad of every frame."""
    return [tuple(row) for row in motion[["x_cg_m", "y_cg_m", "beta_rad"]].to_numpy()]


class Writer:
    """A video that has its name once it is whole; sensor and codec work beside the renderer."""

    def __init__(self, path: Path, studio: Studio, seed: list[int]) -> None:
        import av

        case = studio.case
        self.path, self.deep, self.studio = path, case["codec"].endswith("10"), studio
        self.rng = np.random.default_rng(seed)
        self.unfinished = path.with_name("unfinished-" + path.name)
        self.file = av.open(str(self.unfinished), "w")
        x265 = case["codec"].startswith("hevc")
        options = {"crf": str(case["crf"]), "preset": "superfast" if x265 else "medium"}
        if x265:
            options["x265-params"] = "log-level=error:pools=1"
        self.stream: Any = self.file.add_stream(
            "libx265" if x265 else "libx264", rate=Fraction(case["rate_hz"]), options=options
        )
        self.stream.width, self.stream.height = studio.width, studio.height
        self.stream.pix_fmt = "yuv420p10le" if self.deep else "yuv420p"
        self.stream.thread_count = 1
        self.waiting: Queue[Array | None] = Queue(AHEAD)
        self.failed: list[BaseException] = []
        self.thread = Thread(target=self._work)
        self.thread.start()

    def put(self, light: Array) -> None:
        """The light of the next frame."""
        if self.failed:
            raise self.failed[0]
        self.waiting.put(light)

    def done(self) -> None:
        """The last frames, and the name."""
        self.waiting.put(None)
        self.thread.join()
        if self.failed:
            raise self.failed[0]
        os.replace(self.unfinished, self.path)

    def _work(self) -> None:
        while (light := self.waiting.get()) is not None:
            try:
                if not self.failed:
                    self._encode(self._frame(self.studio.sensed(light, 10 if self.deep else 8, self.rng)))
            except BaseException as error:  # told by the next put
                self.failed.append(error)
        self._encode(None)
        self.file.close()

    def _frame(self, values: Array) -> Any:
        import av

        if self.deep:
            return av.VideoFrame.from_ndarray(np.ascontiguousarray(values << 6), format="rgb48le")
        return av.VideoFrame.from_ndarray(values, format="rgb24")

    def _encode(self, frame: Any) -> None:
        for packet in self.stream.encode(frame):
            self.file.mux(packet)


def film(studio: Studio, folder: Path, k: int, said: str, frames: int | None = None) -> float:
    """Film tow ``k`` into a run folder; one that stands already is left alone. Seconds that it took."""
    if (folder / "video.mp4").is_file():
        return 0.0
    case, began = studio.case, time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    studio.rng = np.random.default_rng([int(studio.case["water"]["seed"]), k])
    motion = motion_of(case, k)
    pixels = marks_px(case, motion)
    places = placed(motion, [m["body_m"] for m in case["marks"]], [m["depth_m"] for m in case["marks"]])
    speeds = np.gradient(pixels, motion["t_s"].to_numpy(), axis=0)
    truth = motion[["t_s", "y_cg_m", "beta_rad", "alpha_rad", "x_cg_m", "tension_n"]].copy()
    for i, mark in enumerate(case["marks"]):
        truth[f"{mark['name']}_u"], truth[f"{mark['name']}_v"] = pixels[:, i].T
    truth.to_csv(folder / "truth.csv", index=False)
    (folder / "run.toml").write_text(said, encoding="utf-8")
    writer = Writer(folder / "video.mp4", studio, [case["water"]["seed"], k, 1])
    for i, state in list(enumerate(states(motion)))[:frames]:
        writer.put(studio.light(i, state, case["tows"][k]["tow_point_m"], places[i], speeds[i]))
    writer.done()
    return time.perf_counter() - began


def filmed(case: dict[str, Any], out: Path, seed: int, say: Any = print) -> list[Path]:
    """The films of a campaign, those that are not there yet: OUT/NN/run-K."""
    parent = out / f"{case['number']:02d}"
    folders = [parent / f"run-{k + 1}" for k in range(TOWS)]
    missing = [k for k, folder in enumerate(folders) if not (folder / "video.mp4").is_file()]
    if missing:
        began = time.perf_counter()
        studio = Studio(case, seed, parent)
        say(f"campaign {case['number']}: empty tank {time.perf_counter() - began:.0f} s")
        for k in missing:
            say(f"campaign {case['number']} run {k + 1}: {film(studio, folders[k], k, told(case, seed)[k]):.0f} s")
    (parent / "truth.json").write_text(json.dumps(truth_of(case), indent=1) + "\n", encoding="utf-8")
    (parent / "case.json").write_text(json.dumps(case, indent=1) + "\n", encoding="utf-8")
    (parent / EMPTY).unlink(missing_ok=True)
    return folders
