"""Run folders with a known truth for the vision benchmark: two marks of a towed model, filmed under one condition each.

Everything is drawn from the constants below; the same seed gives the same clip. Uncompressed clips are Ut Video
(lossless, yuv420p, luma as drawn); the others H.264 by libx264, preset veryfast, yuv420p.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from towline.geometry.camera import Camera, Lens

SEED = 20240611
TEXTURE_SEED = 5
PATCH_SEED = 11
VERSION = 5
"""Raise it when what is drawn changes: kept clips of another version are made again."""
RATE_HZ = 30
AMPLITUDE_DN, GROUND_DN, READ_DN, ELECTRONS_PER_DN = 160.0, 20.0, 3.0, 20.0
PRESET = "veryfast"
NAMES = ("bow", "stern")
BODY_M = ((1.2, 0.0), (-1.2, 0.0))
DEPTH_M = (0.12, 0.13)
LINE_M, TOW_POINT_M = 0.91, 1.446
ALPHA = ((0.30, 10.0, 0.0),)
BETA = ((0.05, 12.0, 0.7), (0.015, 7.5, 2.0))
"""Swings: amplitude rad, period s, phase rad. Every period divides 60 s, so that a minute repeats itself."""
PLACE_M, TARGET_M = (-7.0, 0.6, -3.0), (-2.4, 0.05, 0.1)
FOCAL_PX = 1350.0
DISTORTION = (-0.05, 0.0, 0.0, 0.0, 0.0)
DATUM_M = tuple((x, y, z) for z in (0.0, 0.25) for x in (-0.6, -4.2) for y in (-1.1, 1.1))
REACH = 5.5
"""A light is drawn this many widths around its centre."""
HIDDEN_SHARE, RAIL_AFTER, RAIL_DN, CLEAR = 0.05, 30, 60.0, 2.5
"""A mark is hidden or visible when its centre lies this many widths inside or outside the rail's edge."""
DRIFT_PX, DRIFT_GAIN, DRIFT_GROUND_DN = (3.0, -2.0), 0.7, 15.0
WATER_PX, WATER_PERIOD_PX, WATER_DN, HULL_DN = 5.3, 954, 3.0, 2.5
"""Flow of the water's blobs down the picture in a frame (it comes round after WATER_PERIOD_PX; a minute is ten rounds);
standard deviation of the blobs on the water and on the hull."""
WATER_SWAY_PX, WATER_SWAY_S = 10.0, 20.0
PATCH_SIZE_PX, PATCH_BLUR_PX, PATCH_DN, LIT_GROUND_DN = 30, 0.8, ((165.0, 30.0), (45.0, 18.0)), 90.0
"""Unlit marks: side of the patch, blur of the lens; per mark the mean and standard deviation of its texture; the ground then."""


@dataclass(frozen=True)
class Ghost:
    """A mirror image moving along with its mark.

    Attributes
    ----------
    away_px : (u, v) from the mark
    width_px : standard deviations along u and v
    share : amplitude over the mark's
    wobble_px : amplitude of its own small motion
    """

    away_px: tuple[float, float]
    width_px: tuple[float, float]
    share: float
    wobble_px: float


@dataclass(frozen=True)
class Condition:
    """How a clip is filmed.

    Attributes
    ----------
    name : also the run folder's
    width_px : standard deviation of a mark's image
    ghost : reflection, or None
    rail : a rail hides the first mark in ``HIDDEN_SHARE`` of the frames
    drift : exposure, ground and camera drift over the clip
    noise : factor on read and shot noise
    texture : blobs move with the water and with the hull
    crf : of H.264; None = lossless
    size_px : width, height
    patch : unlit textured patches instead of lights
    twin : the uncompressed clip of the same scene
    """

    name: str
    width_px: float = 1.5
    ghost: Ghost | None = None
    rail: bool = False
    drift: bool = False
    noise: float = 1.0
    texture: bool = False
    crf: int | None = None
    size_px: tuple[int, int] = (1280, 720)
    patch: bool = False
    twin: str | None = None


CONDITIONS = (
    Condition("easy"),
    Condition("wide", width_px=2.5),
    Condition("beside", ghost=Ghost((1.0, 12.0), (1.7, 2.6), 0.4, 0.6)),
    Condition("over", width_px=2.5, ghost=Ghost((0.5, 5.5), (2.5, 4.0), 0.45, 0.4)),
    Condition("occlusion", rail=True),
    Condition("drift", drift=True),
    Condition("noise3", noise=3.0),
    Condition("texture", texture=True),
    Condition("crf18", crf=18, twin="easy"),
    Condition("crf23", crf=23, twin="easy"),
    Condition("crf28", crf=28, twin="easy"),
    Condition("texture23", texture=True, crf=23, twin="texture"),
    Condition("1080p", size_px=(1920, 1080)),
)
MINUTE = Condition("minute", noise=0.5, texture=True, crf=18)
"""For speed and memory; with noise 1 and crf 18 the codec would spend 20 Mbit/s on noise and decoding would take all the time."""
PATCHES = Condition("patches", texture=True, patch=True)


@dataclass(frozen=True)
class Light:
    """A Gaussian in the picture: centre (u, v) px, standard deviations px, amplitude DN."""

    centre_px: tuple[float, float]
    width_px: tuple[float, float]
    amplitude_dn: float

    def bell(self, u_px: np.ndarray, v_px: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values ``(v, u)`` with unit amplitude, and the offsets over the widths along u (row) and v (column)."""
        across = ((u_px - self.centre_px[0]) / self.width_px[0])[None, :]
        down = ((v_px - self.centre_px[1]) / self.width_px[1])[:, None]
        return np.exp(-0.5 * across**2) * np.exp(-0.5 * down**2), across, down


class Scene:
    """A condition over ``frames`` frames: where everything is, and what the sensor sees.

    Attributes
    ----------
    t_s : (n,)
    places_px : (n, 2, 2), true centre of each mark in each frame
    rail_px : first and last column of the rail and its rows, or None
    """

    def __init__(self, condition: Condition, frames: int) -> None:
        self.condition, self.frames = condition, frames
        self.t_s = np.arange(frames) / RATE_HZ
        self.share = np.arange(frames) / max(frames - 1, 1)
        self.camera = camera_of(condition.size_px)
        marks = mark_places(self.t_s)
        self.places_px = self.camera.project(marks.reshape(-1, 3)).reshape(frames, 2, 2)
        if condition.drift:
            self.places_px = self.places_px + self.share[:, None, None] * np.array(DRIFT_PX)
        self.rail_px = self._rail() if condition.rail else None

    # what is where ----------------------------------------------------------------------------------------------

    def gain(self, index: int) -> float:
        """Exposure in a frame."""
        return 1 + (DRIFT_GAIN - 1) * self.share[index] if self.condition.drift else 1.0

    def ground_dn(self, index: int) -> float:
        """Mean ground in a frame."""
        return (LIT_GROUND_DN if self.condition.patch else GROUND_DN) + (
            DRIFT_GROUND_DN * self.share[index] if self.condition.drift else 0.0
        )

    def lights(self, index: int, mark: int) -> list[Light]:
        """The mark, then its reflection where there is one."""
        place, width = self.places_px[index, mark], self.condition.width_px
        amplitude = AMPLITUDE_DN * self.gain(index)
        lights = [Light((place[0], place[1]), (width, width), amplitude)]
        ghost = self.condition.ghost
        if ghost is not None:
            t = self.t_s[index]
            wobble = ghost.wobble_px * np.array(
                [np.sin(2 * np.pi * t / 3 + mark), np.sin(2 * np.pi * t / 2 + 2 * mark)]
            )
            centre = place + ghost.away_px + wobble
            share = ghost.share * (1 + 0.1 * np.sin(2 * np.pi * t / 2.5 + mark))
            lights.append(Light((centre[0], centre[1]), ghost.width_px, share * amplitude))
        return lights

    def variance(self, mean_dn: np.ndarray) -> np.ndarray:
        """Of a pixel before rounding, DN^2."""
        return self.condition.noise**2 * (READ_DN**2 + np.maximum(mean_dn, 0.0) / ELECTRONS_PER_DN)

    @cached_property
    def status(self) -> np.ndarray:
        """(n, 2) of ``visible``, ``partial`` (the rail cuts the mark), ``hidden``."""
        status = np.full((self.frames, 2), "visible", dtype=object)
        if self.rail_px is not None:
            first, last, _, _ = self.rail_px
            inside = np.minimum(self.places_px[:, 0, 0] - (first - 0.5), last + 0.5 - self.places_px[:, 0, 0])
            clear = CLEAR * self.condition.width_px
            status[inside > -clear, 0] = "partial"
            status[inside > clear, 0] = "hidden"
        return status

    def _rail(self) -> tuple[int, int, int, int]:
        """Where the mark crosses fastest, clear of it at first, so wide that ``HIDDEN_SHARE`` of the frames are hidden."""
        u = self.places_px[:, 0, 0]
        half = np.array([np.quantile(np.abs(u - centre), HIDDEN_SHARE) for centre in u])
        start = np.abs(u[:RAIL_AFTER, None] - u[None, :]).min(axis=0)
        half = np.where(start > half + (2 * CLEAR + 1) * self.condition.width_px, half, 0.0)
        middle = u[int(np.argmax(half))]
        reach = half.max() + CLEAR * self.condition.width_px
        rows = self.places_px[:, 0, 1]
        return round(middle - reach), round(middle + reach), int(rows.min()) - 60, int(rows.max()) + 60

    def truth(self) -> pd.DataFrame:
        """frame, t_s, marker, u_px, v_px, status."""
        return pd.DataFrame(
            {
                "frame": np.repeat(np.arange(self.frames), 2),
                "t_s": np.repeat(self.t_s, 2),
                "marker": np.tile(NAMES, self.frames),
                "u_px": self.places_px[..., 0].ravel(),
                "v_px": self.places_px[..., 1].ravel(),
                "status": self.status.ravel(),
            }
        )

    # what the sensor sees ---------------------------------------------------------------------------------------

    def pictures(self) -> Iterator[np.ndarray]:
        """Frames (h, w) uint8.

        The ground's noise is cut from a pool at a random place in each frame; the marks' surroundings get noise of their own.
        """
        width, height = self.condition.size_px
        rng = np.random.default_rng(SEED)
        pool = rng.standard_normal(3 * width * height, dtype=np.float32)
        texture = _Texture(self) if self.condition.texture else None
        patches = _Patches(self) if self.condition.patch else None
        for index in range(self.frames):
            mean = np.full((height, width), self.ground_dn(index), dtype=np.float32)
            if texture is not None:
                texture.add(mean, index)
            start = int(rng.integers(2 * width * height))
            noise = pool[start : start + width * height].reshape(height, width)
            boxes = []
            if patches is not None:
                patches.put(mean, index)
            else:
                boxes = [self._add_lights(mean, index, mark) for mark in range(2)]
            if self.rail_px is not None:
                first, last, top, bottom = self.rail_px
                mean[top : bottom + 1, first : last + 1] = RAIL_DN
            seen = mean + noise * np.sqrt(self.variance(mean))
            for box in boxes:
                part = mean[box]
                seen[box] = part + rng.standard_normal(part.shape) * np.sqrt(self.variance(part))
            yield np.clip(np.rint(seen), 0, 255).astype(np.uint8)

    def _add_lights(self, mean: np.ndarray, index: int, mark: int) -> tuple[slice, slice]:
        lights = self.lights(index, mark)
        low = np.min([np.array(m.centre_px) - REACH * np.array(m.width_px) for m in lights], axis=0)
        high = np.max([np.array(m.centre_px) + REACH * np.array(m.width_px) for m in lights], axis=0)
        u0, v0 = np.maximum(np.floor(low).astype(int), 0)
        u1, v1 = np.ceil(high).astype(int) + 1
        box = (slice(v0, v1), slice(u0, u1))
        rows, columns = mean[box].shape
        u, v = np.arange(u0, u0 + columns, dtype=float), np.arange(v0, v0 + rows, dtype=float)
        for light in lights:
            mean[box] += light.amplitude_dn * light.bell(u, v)[0]
        return box

    # what can be known ------------------------------------------------------------------------------------------

    def bounds(self, every: int = 7) -> Bounds:
        """Cramer-Rao bounds over every ``every``-th frame's visible marks."""
        frame, known, alone = [], [], []
        patches = _Patches(self) if self.condition.patch else None
        for index in range(0, self.frames, every):
            noise, ground = self.condition.noise, self.ground_dn(index)
            for mark in range(2):
                if self.status[index, mark] != "visible":
                    continue
                if patches is not None:
                    frame.append(patches.bound(index, mark))
                    continue
                lights = self.lights(index, mark)
                frame.append(cramer_rao(lights, ground, noise))
                known.append(cramer_rao(lights, ground, noise, shapes_known=True))
                alone.append(cramer_rao(lights[:1], ground, noise))
        return Bounds(*(float(np.sqrt(np.mean(np.square(values or frame)))) for values in (frame, known, alone)))


@dataclass(frozen=True)
class Bounds:
    """Cramer-Rao standard deviation of one coordinate of one mark in one frame, px, rms over visible marks.

    Attributes
    ----------
    frame_px : from the frame by itself; a reflection and all shapes are unknown
    known_px : widths known (from other frames); places and amplitudes of mark and reflection unknown
    alone_px : as ``frame_px`` if no reflection were there
    """

    frame_px: float
    known_px: float
    alone_px: float


def cramer_rao(lights: list[Light], ground_dn: float, noise: float = 1.0, shapes_known: bool = False) -> np.ndarray:
    """Cramer-Rao bound of the first light's centre in one frame, (2,) px along u and v.

    Fisher information of independent Gaussian pixel values, mean = ground + sum of Gaussians sampled at pixel centres,
    variance = noise^2 (read^2 + mean/20) + 1/12 (rounding). Unknown with the centre: the ground, and of every light its
    centre, amplitude and (unless ``shapes_known``) both widths. What the variance itself tells of the parameters is left
    out (below 0.1 %). A tracker that carries the place itself from frame to frame may do better than any of these.
    """
    reach = max(REACH * max(m.width_px) for m in lights) + 1
    centres = np.array([m.centre_px for m in lights])
    u = np.arange(np.floor(centres[:, 0].min() - reach), np.ceil(centres[:, 0].max() + reach) + 1)
    v = np.arange(np.floor(centres[:, 1].min() - reach), np.ceil(centres[:, 1].max() + reach) + 1)
    mean = np.full((len(v), len(u)), ground_dn)
    slopes = [np.ones_like(mean)]
    for light in lights:
        bell, across, down = light.bell(u, v)
        value = light.amplitude_dn * bell
        wide, high = light.width_px
        mean = mean + value
        slopes += [value * across / wide, value * down / high, bell]
        if not shapes_known:
            slopes += [value * across**2 / wide, value * down**2 / high]
    variance = noise**2 * (READ_DN**2 + mean / ELECTRONS_PER_DN) + 1 / 12
    rows = np.array([(s / np.sqrt(variance)).ravel() for s in slopes])
    scale = np.linalg.norm(rows, axis=1)
    covariance = np.linalg.inv((rows @ rows.T) / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.sqrt(np.diag(covariance)[1:3])


class _Texture:
    """Low-contrast blobs that move with the water, and others that move with the hull between the marks."""

    def __init__(self, scene: Scene) -> None:
        width, height = scene.condition.size_px
        rng = np.random.default_rng(TEXTURE_SEED)
        self.scene = scene
        rim = 64
        water = _blobs(rng, (WATER_PERIOD_PX, width + 4 * rim), WATER_DN, rows_wrap=True)
        self.water = np.concatenate([water] * (2 + height // WATER_PERIOD_PX))
        self.hull = _blobs(rng, (200, 1000), HULL_DN)

    def add(self, mean: np.ndarray, index: int) -> None:
        """Add the blobs of a frame to ``mean`` (h, w)."""
        import cv2

        height, width = mean.shape
        v0 = (-WATER_PX * index) % WATER_PERIOD_PX
        u0 = WATER_SWAY_PX * np.sin(2 * np.pi * self.scene.t_s[index] / WATER_SWAY_S)
        middle = (self.water.shape[1] / 2 + u0, v0 + (height - 1) / 2)
        mean += cv2.getRectSubPix(self.water, (width, height), middle)
        bow, stern = self.scene.places_px[index]
        matrix = similarity(np.array([[850.0, 100.0], [150.0, 100.0]]), np.array([bow, stern]))
        low = np.floor(np.minimum(bow, stern)).astype(int) - 70
        high = np.ceil(np.maximum(bow, stern)).astype(int) + 70
        low, high = np.maximum(low, 0), np.minimum(high, [width, height])
        matrix[:, 2] -= low
        box = (slice(low[1], high[1]), slice(low[0], high[0]))
        size = (int(high[0] - low[0]), int(high[1] - low[1]))
        deck = cv2.warpAffine(self.hull, matrix, size, flags=cv2.INTER_LINEAR, borderValue=np.nan)
        mean[box] = np.where(np.isfinite(deck), self.scene.ground_dn(index) + deck, mean[box])


class _Patches:
    """Unlit marks: square textured patches fixed to the hull, turning with it; drawn finer than the pixels, then averaged."""

    def __init__(self, scene: Scene) -> None:
        import cv2

        rng = np.random.default_rng(PATCH_SEED)
        self.scene, self.fine = scene, 4
        side, rim = PATCH_SIZE_PX * self.fine, 4 * self.fine
        cover = np.pad(np.ones((side, side), dtype=np.float32), rim)
        self.cover = cv2.GaussianBlur(cover, (0, 0), PATCH_BLUR_PX * self.fine)
        self.patches = []
        for mean, sd in PATCH_DN:
            blobs = np.clip(mean + _blobs(rng, (side, side), sd, (1.2 * self.fine, 2.5 * self.fine)), 5, 240)
            self.patches.append(cv2.GaussianBlur(np.pad(blobs, rim), (0, 0), PATCH_BLUR_PX * self.fine))

    def put(self, mean: np.ndarray, index: int) -> None:
        """Paste both patches into ``mean`` (h, w)."""
        for mark in range(2):
            box, cover, drawn = self.drawn(index, mark)
            mean[box] = mean[box] * (1 - cover) + drawn

    def drawn(
        self, index: int, mark: int, shift_px: tuple[float, float] = (0.0, 0.0), more_rad: float = 0.0
    ) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
        """Box of a patch in the picture, its cover 0 .. 1 and its light there, both (s, s); moved a little if wanted."""
        arm = self.scene.places_px[:, 0] - self.scene.places_px[:, 1]
        turned = np.arctan2(arm[index, 1], arm[index, 0]) - np.arctan2(arm[0, 1], arm[0, 0]) + more_rad
        cosine, sine = np.cos(turned) / self.fine, np.sin(turned) / self.fine
        turn = np.array([[cosine, -sine], [sine, cosine]])
        size = 2 * PATCH_SIZE_PX + 1
        middle = (np.array(self.cover.shape[::-1]) - 1) / 2
        place = self.scene.places_px[index, mark]
        low = np.rint(place).astype(int) - PATCH_SIZE_PX
        matrix = np.column_stack([turn, place + shift_px - low - turn @ middle])
        box = (slice(low[1], low[1] + size), slice(low[0], low[0] + size))
        return box, _warp_averaged(self.cover, matrix, size), _warp_averaged(self.patches[mark], matrix, size)

    def bound(self, index: int, mark: int) -> np.ndarray:
        """Cramer-Rao bound of a patch's centre against a noiseless template, (2,) px.

        Unknown with the centre: its turn, gain and offset of the grey values.
        """

        def value(shift_px=(0.0, 0.0), more_rad=0.0):
            _, cover, light = self.drawn(index, mark, shift_px, more_rad)
            return self.scene.ground_dn(index) * (1 - cover) + light

        mean, h = value(), 0.2
        slopes = [(value((h, 0)) - value((-h, 0))) / (2 * h), (value((0, h)) - value((0, -h))) / (2 * h)]
        slopes += [(value(more_rad=0.01) - value(more_rad=-0.01)) / 0.02, mean, np.ones_like(mean)]
        variance = self.scene.variance(mean) + 1 / 12
        rows = np.array([(s / np.sqrt(variance)).ravel() for s in slopes], dtype=float)
        return np.sqrt(np.diag(np.linalg.inv(rows @ rows.T))[:2])


def _warp_averaged(picture: np.ndarray, matrix: np.ndarray, size: int, parts: int = 3) -> np.ndarray:
    """``picture`` through ``matrix`` (2, 3) into ``(size, size)``, the mean of ``parts``^2 places in each pixel."""
    import cv2

    total = np.zeros((size, size), dtype=np.float32)
    steps = (np.arange(parts) - (parts - 1) / 2) / parts
    for down in steps:
        for across in steps:
            shifted = matrix.copy()
            shifted[:, 2] -= [across, down]
            total += cv2.warpAffine(picture, shifted, (size, size), flags=cv2.INTER_LINEAR, borderValue=0.0)
    return total / parts**2


def _blobs(
    rng: np.random.Generator,
    shape: tuple[int, int],
    sd: float,
    widths_px: tuple[float, ...] = (2.5, 7.0),
    rows_wrap: bool = False,
) -> np.ndarray:
    """Smooth random field ``shape`` float32 of several blob sizes, standard deviation ``sd``; its last row may join its first."""
    import cv2

    field = np.zeros(shape, dtype=np.float32)
    rim = 64 if rows_wrap else 0
    for width in widths_px:
        white = rng.standard_normal(shape, dtype=np.float32)
        layer = cv2.GaussianBlur(np.pad(white, ((rim, rim), (0, 0)), mode="wrap"), (0, 0), width)
        layer = layer[rim : rim + shape[0]]
        field += layer / layer.std()
    return (sd * field / field.std()).astype(np.float32)


def similarity(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Turn, scale and shift (2, 3) that takes two points (2, 2) onto two others."""
    a, b = source[0] - source[1], target[0] - target[1]
    ratio = complex(b[0], b[1]) / complex(a[0], a[1])
    turn = np.array([[ratio.real, -ratio.imag], [ratio.imag, ratio.real]])
    return np.column_stack([turn, target[0] - turn @ source[0]])


# the model and the camera -----------------------------------------------------------------------------------------


def camera_of(size_px: tuple[int, int]) -> Camera:
    """The camera behind and above the model; its lens grows with the picture."""
    width, height = size_px
    focal = FOCAL_PX * width / 1280
    lens = Lens(focal, focal, (width - 1) / 2, (height - 1) / 2, np.array(DISTORTION))
    return Camera.looking_at(lens, np.array(PLACE_M), np.array(TARGET_M))


def mark_places(t_s: np.ndarray) -> np.ndarray:
    """Every mark in tank axes, (n, 2, 3) m: the model swings on its taut line, post at the origin."""
    alpha, beta = (sum(a * np.sin(2 * np.pi * t_s / period + p) for a, period, p in swing) for swing in (ALPHA, BETA))
    x_tow, y_tow = -LINE_M * np.cos(alpha), LINE_M * np.sin(alpha)
    cosine, sine = np.cos(beta), np.sin(beta)
    places = np.empty((len(t_s), 2, 3))
    for mark, (body, depth) in enumerate(zip(BODY_M, DEPTH_M, strict=True)):
        ahead, side = body[0] - TOW_POINT_M, body[1]
        places[:, mark, 0] = x_tow + ahead * cosine - side * sine
        places[:, mark, 1] = y_tow + ahead * sine + side * cosine
        places[:, mark, 2] = depth
    return places


def run_toml(scene: Scene, video: str) -> str:
    """run.toml of a clip; the datum's pixels are exact."""
    condition, lens = scene.condition, scene.camera.lens
    pixels = scene.camera.project(np.array(DATUM_M))
    lines = [f'name = "{condition.name}"', 'kind = "tow"', "", "[source]", f'video = "{video}"', "", "[camera]"]
    lines += [f"image_size_px = [{condition.size_px[0]}, {condition.size_px[1]}]"]
    lines += [f"{key} = {getattr(lens, key)}" for key in ("fx_px", "fy_px", "cx_px", "cy_px")]
    lines += [f"distortion = {list(DISTORTION)}"]
    for number, (tank, pixel) in enumerate(zip(DATUM_M, pixels, strict=True), start=1):
        lines += ["", "[[datum]]", f'name = "d{number}"', f"pixel_px = [{pixel[0]:.6f}, {pixel[1]:.6f}]"]
        lines += [f"tank_m = {list(tank)}", "sigma_px = 0.1"]
    for mark, name in enumerate(NAMES):
        lines += ["", "[[marker]]", f'name = "{name}"', f"body_m = {list(BODY_M[mark])}", f"depth_m = {DEPTH_M[mark]}"]
        if condition.patch:
            u, v = scene.places_px[0, mark]
            lines += ['look = "template"', f"seen_at_px = [{u:.4f}, {v:.4f}]"]
    lines += ["", "[tow]", "speed_m_s = 1.28", f"line_length_m = {LINE_M}", f"tow_point_m = {TOW_POINT_M}"]
    lines += ["tension_n = 3.96", "", "[model]", "length_pp_m = 2.66", "mass_kg = 78.0"]
    lines += ["", "[water]", "density_kg_m3 = 1000.0", ""]
    return "\n".join(lines)


# files --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Clip:
    """A run folder on disk, and the scene that it shows."""

    folder: Path
    scene: Scene

    @property
    def video(self) -> Path:
        return self.folder / video_name(self.scene.condition)

    def truth(self) -> pd.DataFrame:
        """truth.csv."""
        return pd.read_csv(self.folder / "truth.csv")


def video_name(condition: Condition) -> str:
    """Container by codec."""
    return "video.avi" if condition.crf is None else "video.mp4"


def clip(condition: Condition, frames: int, under: Path) -> Clip:
    """The condition's run folder below ``under``, made unless it stands there already."""
    scene = Scene(condition, frames)
    folder = Path(under) / f"{condition.name}-{frames}"
    made = {"version": VERSION, "seed": SEED, "frames": frames, **asdict(condition)}
    stamp = folder / "made.json"
    if stamp.is_file() and json.loads(stamp.read_text()) == json.loads(json.dumps(made)):
        return Clip(folder, scene)
    for old in (folder, *folder.parent.glob(f"{folder.name}-x*")):
        shutil.rmtree(old, ignore_errors=True)
    folder.mkdir(parents=True)
    write_video(folder / video_name(condition), scene.pictures(), condition)
    (folder / "run.toml").write_text(run_toml(scene, video_name(condition)), encoding="utf-8")
    scene.truth().to_csv(folder / "truth.csv", index=False, float_format="%.6f")
    stamp.write_text(json.dumps(made))
    return Clip(folder, scene)


def write_video(path: Path, pictures: Iterator[np.ndarray], condition: Condition) -> None:
    """Encode luma pictures (h, w) uint8; the colour planes are grey."""
    import av

    options = {} if condition.crf is None else {"crf": str(condition.crf), "preset": PRESET}
    with av.open(str(path), "w") as container:
        stream = container.add_stream("utvideo" if condition.crf is None else "libx264", rate=RATE_HZ, options=options)
        stream.width, stream.height = condition.size_px
        stream.pix_fmt = "yuv420p"
        for index, picture in enumerate(pictures):
            frame = av.VideoFrame(*condition.size_px, "yuv420p")
            _fill(frame.planes[0], picture)
            for plane in frame.planes[1:]:
                plane.update(b"\x80" * plane.buffer_size)
            frame.pts, frame.time_base = index, Fraction(1, RATE_HZ)
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


def _fill(plane, picture: np.ndarray) -> None:
    padded = np.zeros((plane.height, plane.line_size), dtype=np.uint8)
    padded[:, : picture.shape[1]] = picture
    plane.update(padded.tobytes())


def repeated(clip: Clip, times: int) -> Path:
    """The clip ``times`` times after itself, in a run folder beside it; packets are copied, nothing is encoded again."""
    import av

    folder = clip.folder.with_name(f"{clip.folder.name}-x{times}")
    target = folder / clip.video.name
    if (folder / "run.toml").is_file():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    with av.open(str(clip.video)) as source:
        stream = source.streams.video[0]
        packets = [(bytes(p), p.pts, p.dts, p.is_keyframe) for p in source.demux(stream) if p.dts is not None]
        step = round(1 / (RATE_HZ * stream.time_base))
        length = step * len(packets)
        with av.open(str(target), "w") as out:
            copy = out.add_stream_from_template(stream)
            for turn in range(times):
                for data, pts, dts, key in packets:
                    packet = av.Packet(data)
                    packet.pts, packet.dts = pts + turn * length, dts + turn * length
                    packet.time_base, packet.stream, packet.is_keyframe = stream.time_base, copy, key
                    out.mux(packet)
    shutil.copyfile(clip.folder / "run.toml", folder / "run.toml")
    return folder


def named(name: str) -> Condition:
    """The condition called ``name``."""
    for condition in (*CONDITIONS, MINUTE, PATCHES):
        if condition.name == name:
            return condition
    raise KeyError(name)
