"""What stands where in a filmed tow: camera, marks, hull outline, tank. Tank axes, metres, z down (theory.md 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..geometry.camera import Camera, Lens
from ..record.errors import GeometryError
from ..record.scenario import FilmTable, ScenarioFile
from .model import Array
from .scenario import tow_from_table

DEFAULT_WIDTH_M = 1.8
"""Of a tank whose scenario states none: a choice."""
STRING_MARK_M = 0.30
"""Distance of the marks on the reference strings: a choice."""
_HULL_BEAM = 0.135
"""Beam over the drawn hull's length where the scenario states none."""
_MIN_FREEBOARD_M = 0.01
"""The deck is drawn above the water by this at least."""


@dataclass(frozen=True)
class Stage:
    """The fixed things around the model.

    Attributes
    ----------
    width_m : between the tank's walls
    water_m : depth of the water line below the tank top (z = 0)
    string_x_m : where the two reference strings cross the tank, (near the stern, near the bow)
    girder_x_m : the carriage's cross girder
    deck_m : depth of the hull's deck
    """

    width_m: float
    water_m: float
    string_x_m: tuple[float, float]
    girder_x_m: float
    deck_m: float


@dataclass(frozen=True)
class Outline:
    """The hull's plan: ``deck`` and ``water``, each ``(n, 2)`` m in body axes, the same n, from the bow clockwise."""

    deck: Array
    water: Array


def film_of(file: ScenarioFile) -> FilmTable:
    """The [film] table; GeometryError without one."""
    if file.film is None:
        raise GeometryError("film: missing table; a scenario without it cannot be filmed")
    return file.film


def camera_of(file: ScenarioFile) -> Camera:
    """The camera of a scenario's [film]."""
    film = film_of(file)
    place, target = np.array(film.pose.place_m), np.array(film.pose.look_at_m)
    return Camera.looking_at(Lens.from_table(film.camera), place, target, film.pose.roll_rad)


def stage_of(file: ScenarioFile) -> Stage:
    """Walls, strings, girder and deck of a scenario."""
    film = film_of(file)
    datum = np.array([point.tank_m for point in film.datum])
    depths = [marker.depth_m for marker in file.marker if marker.on == "model"]
    strings = float(datum[:, 0].min()), float(datum[:, 0].max())
    return Stage(
        width_m=file.water.tank_width_m or DEFAULT_WIDTH_M,
        water_m=film.water_depth_m,
        string_x_m=strings,
        girder_x_m=max(strings[1], file.tow.post_m[0]) + 0.08,
        # the lowest mark stands on the deck, the others on masts: no light shines up through the deck and what lies on it
        deck_m=min(max(depths), film.water_depth_m - _MIN_FREEBOARD_M),
    )


def to_tank(body_m: Array, x_cg_m: Array, y_cg_m: Array, beta_rad: Array) -> tuple[Array, Array]:
    """Body places (ahead of LCG, to starboard) -> tank x, y; everything broadcasts (theory.md 9.1).

    Parameters
    ----------
    body_m : (..., 2) ahead of LCG, to starboard
    x_cg_m : of LCG, tank axes
    y_cg_m : of LCG, tank axes
    beta_rad : heading
    """
    ahead, side = np.asarray(body_m, dtype=float)[..., 0], np.asarray(body_m, dtype=float)[..., 1]
    cosine, sine = np.cos(beta_rad), np.sin(beta_rad)
    return x_cg_m + ahead * cosine - side * sine, y_cg_m + ahead * sine + side * cosine


def post_places(file: ScenarioFile, t_s: Array) -> Array:
    """The tow post over time, ``(n, 2)`` m.

    Parameters
    ----------
    file : the scenario as read
    t_s : (n,) times, s
    """
    tow = tow_from_table(file.tow)
    moved, _ = tow.post_motion(np.asarray(t_s, dtype=float))
    return np.column_stack([np.full(len(t_s), tow.post_m[0]), tow.post_m[1] + np.broadcast_to(moved, len(t_s))])


def mark_places(file: ScenarioFile, motion: pd.DataFrame) -> Array:
    """Every mark's place at every sample, ``(n, marks, 3)`` m in tank axes.

    Parameters
    ----------
    file : the scenario as read
    motion : t_s, x_cg_m, y_cg_m, beta_rad; where there, roll_rad (starboard down), pitch_rad (bow up) and heave_m (down), of a
        body that turns by heading, then pitch, then roll about the point of its LCG at the water line
    """
    x, y, beta = (motion[name].to_numpy(dtype=float) for name in ("x_cg_m", "y_cg_m", "beta_rad"))
    post = post_places(file, motion["t_s"].to_numpy(dtype=float))
    water_m = film_of(file).water_depth_m
    tilts = tilts_of(motion).T
    places = np.empty((len(motion), len(file.marker), 3))
    for i, marker in enumerate(file.marker):
        if marker.on == "post":
            places[:, i, :2] = post + np.array(marker.body_m)
            places[:, i, 2] = marker.depth_m
            continue
        body_m = np.array([*marker.body_m, marker.depth_m - water_m])
        ahead, side, down = afloat(body_m, *tilts).T
        places[:, i, 0], places[:, i, 1] = to_tank(np.column_stack([ahead, side]), x, y, beta)
        places[:, i, 2] = down + water_m
    return places


def tilts_of(motion: pd.DataFrame) -> Array:
    """Roll, pitch (rad) and heave (m) of a motion, (n, 3); 0 where it has none.

    Parameters
    ----------
    motion : as of ``mark_places``
    """
    nothing = np.zeros(len(motion))
    names = ("roll_rad", "pitch_rad", "heave_m")
    return np.column_stack([motion[name].to_numpy(dtype=float) if name in motion else nothing for name in names])


def afloat(body_m: Array, roll_rad: Array | float, pitch_rad: Array | float, heave_m: Array | float) -> Array:
    """Points of the body as it rolls, pitches and heaves, (..., 3) m ahead, to starboard, down of the point that it turns about.

    Parameters
    ----------
    body_m : (..., 3), where they are at rest; everything broadcasts
    roll_rad, pitch_rad, heave_m : starboard down, bow up, down
    """
    ahead, side, down = np.moveaxis(np.asarray(body_m, dtype=float), -1, 0)
    aside = side * np.cos(roll_rad) - down * np.sin(roll_rad)
    low = side * np.sin(roll_rad) + down * np.cos(roll_rad)
    along = ahead * np.cos(pitch_rad) + low * np.sin(pitch_rad)
    below = low * np.cos(pitch_rad) - ahead * np.sin(pitch_rad) + heave_m
    return np.stack(np.broadcast_arrays(along, aside, below), axis=-1)


def shown(file: ScenarioFile, t_s: Array, pixel_px: Array) -> NDArray[np.bool_]:
    """Which marks can be seen, ``(n, marks)`` bool: inside the picture and not hidden by [film] occlusion.

    Parameters
    ----------
    file : the scenario as read
    t_s : (n,) s
    pixel_px : (n, marks, 2)
    """
    film = film_of(file)
    size = np.array(film.camera.image_size_px)
    with np.errstate(invalid="ignore"):
        seen = np.all((pixel_px >= -0.5) & (pixel_px < size - 0.5), axis=2)
    for start, end, name in film.occlusion:
        for i, marker in enumerate(file.marker):
            if marker.name == name:
                seen[(t_s >= start) & (t_s <= end), i] = False
    return seen


def true_tracks(file: ScenarioFile, motion: pd.DataFrame, camera: Camera) -> pd.DataFrame:
    """Where every mark's centre truly is in every frame.

    Parameters
    ----------
    file : the scenario as read
    motion : t_s, x_cg_m, y_cg_m, beta_rad
    camera : of the scenario

    Returns
    -------
    tracks : frame, t_s, marker, u_px, v_px, status; ``lost`` where a mark is hidden or outside the picture (its
        coordinates still say where it is; NaN behind the camera)
    """
    places = mark_places(file, motion)
    samples, marks = places.shape[:2]
    t_s = motion["t_s"].to_numpy(dtype=float)
    pixel = camera.project(places.reshape(-1, 3)).reshape(samples, marks, 2)
    seen = shown(file, t_s, pixel)
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(samples), marks),
            "t_s": np.repeat(t_s, marks),
            "marker": np.tile([marker.name for marker in file.marker], samples),
            "u_px": pixel[..., 0].ravel(),
            "v_px": pixel[..., 1].ravel(),
            "status": np.where(seen.ravel(), "measured", "lost"),
        }
    )


def outline_of(file: ScenarioFile) -> Outline:
    """The drawn hull: pointed bow, parallel middle body, rounded stern; a little flare and rake above the water."""
    film = film_of(file)
    length = film.hull_length_m or file.model.length_pp_m
    beam = film.hull_beam_m or _HULL_BEAM * length
    return Outline(deck=_plan(length, beam, 0.0), water=_plan(0.97 * length, 0.93 * beam, -0.008 * length))


def _plan(length_m: float, beam_m: float, shift_m: float) -> Array:
    """A closed ship-shaped line, ``(n, 2)`` m."""
    along = 0.5 * np.cos(np.linspace(0.0, np.pi, 49))  # dense at the ends, bow first
    bow = np.clip((along - 0.16) / 0.34, 0.0, 1.0)
    stern = np.clip((-0.22 - along) / 0.28, 0.0, 1.0)
    round_off = np.sqrt(np.clip(1 - np.clip((-0.455 - along) / 0.045, 0.0, 1.0) ** 2, 0.0, 1.0))
    half = 0.5 * (1 - bow**2.5) * (1 - 0.42 * stern**2.2) * round_off
    side = np.column_stack([length_m * along + shift_m, beam_m * half])
    mirrored = side[-2:0:-1] * [1.0, -1.0]
    return np.concatenate([side, mirrored])
