"""Frames of a filmed tow, one after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..geometry.camera import Camera
from ..record.scenario import FilmTable, ScenarioFile
from .picture_hull import Pose, Rig, paint_hull, paint_line, paint_mirror_image, paint_post, rig_of
from .picture_light import Sensor, add_light, add_reflection
from .picture_strings import Strings, paint_strings
from .picture_tank import Ripples, make_ripples, paint_tank
from .picture_tools import Picture
from .scene import camera_of, film_of, mark_places, post_places, shown, stage_of, tilts_of

RIPPLE_SEED, NOISE_SEED, PICK_SEED = 1, 2, 3
"""Streams drawn from the scenario's seed."""
_MIRROR_STRETCH = 1.9
"""A light's mirror image in rippled water is this much longer than wide: a choice."""


@dataclass(frozen=True)
class Set:
    """Everything that stays the same from frame to frame. ``still`` (h, w, 3) is the empty tank with its strings."""

    file: ScenarioFile
    film: FilmTable
    camera: Camera
    rig: Rig
    still: Picture
    strings: Strings
    ripples: Ripples | None


def build_set(file: ScenarioFile) -> Set:
    """Paint what does not move."""
    film, camera, stage = film_of(file), camera_of(file), stage_of(file)
    size = film.camera.image_size_px
    still, wet = paint_tank(camera, stage, size)
    still *= np.float32(film.exposure)
    strings = paint_strings(camera, stage, film.datum, size, film.exposure)
    strings.over(still, (slice(None), slice(None)))
    open_water = wet * (1 - strings.cover[..., 0])
    rng = np.random.default_rng([file.seed, RIPPLE_SEED])
    ripples = make_ripples(camera, stage, open_water, file.tow.speed_m_s, film.ripple * film.exposure, rng)
    return Set(file, film, camera, rig_of(file, stage), still, strings, ripples)


def film_frames(file: ScenarioFile, motion: pd.DataFrame) -> Iterator[tuple[int, float, NDArray[np.uint8]]]:
    """Film a motion.

    Parameters
    ----------
    file : the scenario as read
    motion : t_s, x_cg_m, y_cg_m, beta_rad, as ``simulate_scenario`` returns it; marks follow roll_rad, pitch_rad and heave_m, too,
        where these are there (``mark_places``), and so does the hull; its water line stays

    Yields
    ------
    index, t_s, frame : frame (h, w, 3) uint8, blue green red, before any coding
    """
    scenery = build_set(file)
    film = scenery.film
    sensor = Sensor.of(film, np.random.default_rng([file.seed, NOISE_SEED]))
    t_s = motion["t_s"].to_numpy(dtype=float)
    places = mark_places(file, motion)
    pixel = scenery.camera.project(places.reshape(-1, 3)).reshape(*places.shape[:2], 2)
    seen = shown(file, t_s, pixel)
    mirrored = places * [1.0, 1.0, -1.0] + [0.0, 0.0, 2 * film.water_depth_m]
    mirrored_px = scenery.camera.project(mirrored.reshape(-1, 3)).reshape(pixel.shape)
    posts = post_places(file, t_s)
    body, tilts = motion[["x_cg_m", "y_cg_m", "beta_rad"]].to_numpy(dtype=float), tilts_of(motion)
    for index in range(len(motion)):
        x_m, y_m, beta_rad = body[index].tolist()
        pose = Pose(x_m, y_m, beta_rad, posts[index], tilts[index])
        picture = _compose(scenery, pose, float(t_s[index]), pixel[index], mirrored_px[index], seen[index])
        yield index, float(t_s[index]), sensor.expose(picture)


def _compose(scenery: Set, pose: Pose, t_s: float, pixel, mirrored_px, seen) -> Picture:
    """One picture in light, before the sensor: painted from the back to the front."""
    import cv2

    film, camera, rig = scenery.film, scenery.camera, scenery.rig
    exposure = film.exposure
    if scenery.ripples is None:
        picture, ripple = scenery.still.copy(), None
    else:
        ripple = scenery.ripples.at(t_s, film.camera.image_size_px)
        picture = np.asarray(cv2.add(scenery.still, cv2.merge([ripple, ripple, ripple])), dtype=np.float32)
    paint_mirror_image(picture, camera, rig, pose, exposure)
    for marker, place, visible in zip(scenery.file.marker, mirrored_px, seen, strict=True):
        if visible and marker.on == "model":
            strength = film.reflection * marker.peak_dn * exposure * _flicker(ripple, place)
            add_reflection(picture, place, marker, strength, _MIRROR_STRETCH)
    paint_post(picture, camera, rig, pose, exposure)
    box = paint_hull(picture, camera, rig, pose, exposure)
    paint_line(picture, camera, rig, pose, exposure)
    if box is not None:
        scenery.strings.over(picture, box)
    for marker, place, visible in zip(scenery.file.marker, pixel, seen, strict=True):
        if visible:
            add_light(picture, place, marker, exposure)
    return picture


def _flicker(ripple: NDArray[np.float32] | None, place_px) -> float:
    """A mirror image brightens and fades with the ripple that carries it."""
    if ripple is None or not np.isfinite(place_px).all():
        return 1.0
    column, row = np.round(place_px).astype(int)
    if not (0 <= row < ripple.shape[0] and 0 <= column < ripple.shape[1]):
        return 1.0
    return float(np.clip(1.0 + 0.12 * ripple[row, column], 0.3, 1.7))
