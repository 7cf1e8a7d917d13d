"""The model, its line and the tow post, painted frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Camera
from ..record.scenario import ScenarioFile
from .picture_tools import Picture, bar_outline, box_of, paint, paint_polygon, polygon_mask
from .scene import Outline, Stage, afloat, film_of, outline_of, to_tank

Array = NDArray[np.float64]
PAINT_BGR = {
    "red": (44.0, 40.0, 128.0),
    "green": (52.0, 92.0, 40.0),
    "blue": (120.0, 66.0, 34.0),
    "white": (150.0, 152.0, 152.0),
    "yellow": (36.0, 128.0, 142.0),
    "bright": (150.0, 152.0, 152.0),
    "dark": (44.0, 42.0, 42.0),
}
"""Colours of the hull that a scenario may name, DN: dark enough that a light stands out on it. Choices, for looks."""
# Colours of what is on and about the model, blue green red, DN at exposure 1: choices, for looks only.
_DECK = np.array([42.0, 47.0, 49.0])
_HATCH = np.array([62.0, 72.0, 76.0])
_BOOT = np.array([22.0, 22.0, 24.0])
_BAR = np.array([54.0, 59.0, 61.0])
_LINE = np.array([60.0, 66.0, 68.0])
_POST = np.array([120.0, 122.0, 122.0])
_REFLECTED = np.array([20.0, 17.0, 16.0])
_SUN = np.array([-0.35, 0.45])
"""Direction to the light along and across the model, for shading."""
# Sizes of bar, line, post and hatches, and the post's upper end (z down): choices, for looks; the hatches in hull
# lengths.
_BAR_M = 0.018
_LINE_M = 0.0015
_POST_M = 0.022
_POST_TOP_M = -0.60
_HATCHES = ((-0.24, -0.12), (-0.10, 0.02), (0.04, 0.16))


@dataclass(frozen=True)
class Rig:
    """What is painted: outline, heights and attachments of one scenario.

    Attributes
    ----------
    bar_m : (2, 2) ends of the tow bar in body axes
    tow_m : (2,) tow point in body axes; None without a line
    line_z_m : depth of bar and line
    """

    outline: Outline
    stage: Stage
    length_m: float
    beam_m: float
    paint_bgr: Array
    bar_m: Array
    tow_m: Array | None
    line_z_m: float


def rig_of(file: ScenarioFile, stage: Stage) -> Rig:
    """The rig of a scenario; the bar lies at the foremost mark's height so that it passes under it symmetrically.

    Parameters
    ----------
    file : the scenario as read
    stage : walls, strings, girder and deck
    """
    film = film_of(file)
    length = film.hull_length_m or file.model.length_pp_m
    outline = outline_of(file)
    marks = [marker for marker in file.marker if marker.on == "model"]
    foremost = max(marks, key=lambda marker: marker.body_m[0])
    tow = None
    tip = foremost.body_m[0] + 0.03 * length
    if file.kind != "free" and file.tow.tow_point_m is not None:
        tow = np.array([file.tow.tow_point_m, file.tow.tow_point_offset_m])
        tip = max(tip, tow[0] + 0.008 * length)
    bar = np.array([[min(0.20 * length, foremost.body_m[0] - 0.1 * length), 0.0], [tip, 0.0]])
    return Rig(
        outline=outline,
        stage=stage,
        length_m=length,
        beam_m=float(np.ptp(outline.deck[:, 1])),
        paint_bgr=np.array(PAINT_BGR[film.hull_colour]),
        bar_m=bar,
        tow_m=tow,
        line_z_m=min(foremost.depth_m, stage.deck_m),
    )


@dataclass(frozen=True)
class Pose:
    """Where the model and the post are in one frame: m and rad; ``tilt`` : (3,) roll, pitch, heave (``scene.afloat``)."""

    x_cg_m: float
    y_cg_m: float
    beta_rad: float
    post_m: Array
    tilt: Array


def _project(camera: Camera, rig: Rig, body_m: Array, pose: Pose, depth_m: float, mirrored: bool = False) -> Array:
    """Body points ``(n, 2)`` at a depth, of the model at rest -> pixels ``(n, 2)`` of them now, or of their mirror images."""
    water_m = rig.stage.water_m
    at_rest = np.column_stack([body_m, np.full(len(body_m), depth_m - water_m)])
    now = afloat(at_rest, *pose.tilt)
    x, y = to_tank(now[:, :2], np.array(pose.x_cg_m), np.array(pose.y_cg_m), np.array(pose.beta_rad))
    z = depth_m + (now[:, 2] - at_rest[:, 2])
    return camera.project(np.column_stack([x, y, 2 * water_m - z if mirrored else z]))


def _at_water(camera: Camera, rig: Rig, pose: Pose) -> Array:
    """The water line (n, 2) px: of a model that tilts by a few degrees it stays about where it was."""
    return _project(camera, rig, rig.outline.water, replace(pose, tilt=np.zeros(3)), rig.stage.water_m)


def width_on_picture(camera: Camera, place_m: Array, width_m: float) -> float:
    """How many pixels a width at a tank place ``(3,)`` takes up.

    Parameters
    ----------
    camera : of the scenario
    place_m : (3,) in the tank
    width_m : of the thing
    """
    ahead = (camera.rotation @ place_m + camera.translation)[2]
    return float(camera.lens.fx_px * width_m / max(ahead, 1e-3))


def paint_mirror_image(picture: Picture, camera: Camera, rig: Rig, pose: Pose, exposure: float) -> None:
    """The hull's dark mirror image and its shade on the water (before the marks' mirror images and the hull).

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    camera : of the scenario
    rig : what is painted of the model
    pose : x, y, heading of the model
    exposure : factor on all brightness
    """
    import cv2

    stage = rig.stage
    water = _at_water(camera, rig, pose)
    mirrored = _project(camera, rig, rig.outline.deck, pose, stage.deck_m, mirrored=True)
    points = np.concatenate([water, mirrored])
    box = box_of(points, picture.shape, margin_px=8)
    if box is None:
        return
    silhouette = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2).astype(float)
    mask = cv2.blur(polygon_mask(silhouette, box), (5, 5))
    colour = (0.75 * _REFLECTED + 0.10 * rig.paint_bgr) * exposure
    paint(picture, box, mask * np.float32(0.62), colour)


def paint_hull(picture: Picture, camera: Camera, rig: Rig, pose: Pose, exposure: float) -> tuple[slice, slice] | None:
    """Sides, deck, fittings and tow bar. Returns the box that was painted.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    camera : of the scenario
    rig : what is painted of the model
    pose : x, y, heading of the model
    exposure : factor on all brightness
    """
    import cv2

    stage = rig.stage
    deck = _project(camera, rig, rig.outline.deck, pose, stage.deck_m)
    water = _at_water(camera, rig, pose)
    everything = np.concatenate([deck, water])
    box = box_of(everything, picture.shape)
    if box is None:
        return None
    silhouette = cv2.convexHull(everything.astype(np.float32)).reshape(-1, 2).astype(float)
    sides = _sides(rig, box, deck, water) * np.float32(exposure)
    paint(picture, box, polygon_mask(silhouette, box), sides)
    shade = _deck_light(rig, camera, pose, box)
    paint(picture, box, polygon_mask(deck, box), _DECK.astype(np.float32) * shade[..., None] * exposure)
    inner = _project(camera, rig, rig.outline.deck * [0.985, 0.93], pose, stage.deck_m)
    _edge(picture, deck, inner, box, (0.45 * rig.paint_bgr + 0.55 * _DECK) * exposure)
    for aft, fore in _HATCHES:
        half = 0.27 * rig.beam_m
        corners = np.array([[aft, -half], [fore, -half], [fore, half], [aft, half]]) * [rig.length_m, 1.0]
        paint_polygon(picture, _project(camera, rig, corners, pose, stage.deck_m), _HATCH * exposure)
    _bar(picture, camera, rig, pose, exposure)
    return box


def _edge(picture: Picture, outer: Array, inner: Array, box, colour: Array) -> None:
    """A painted strip along the deck's edge."""
    mask = np.maximum(polygon_mask(outer, box) - polygon_mask(inner, box), np.float32(0))
    paint(picture, box, mask, colour)


def _deck_light(rig: Rig, camera: Camera, pose: Pose, box) -> NDArray[np.float32]:
    """A gentle fall of light from bow to stern along the picture's rows, (h, w)."""
    ends = _project(camera, rig, np.array([[0.5, 0.0], [-0.5, 0.0]]) * rig.length_m, pose, rig.stage.deck_m)
    rows = np.arange(box[0].start, box[0].stop, dtype=np.float32)
    along = np.clip((rows - ends[0, 1]) / max(abs(ends[1, 1] - ends[0, 1]), 1.0), -0.2, 1.2)
    level = (0.90 + 0.16 * along).astype(np.float32)
    return np.broadcast_to(level[:, None], (len(rows), box[1].stop - box[1].start))


def _sides(rig: Rig, box, deck: Array, water: Array) -> Picture:
    """The sides' colours over the box: panels lit by their direction, a dark boot top at the water line."""
    import cv2

    rows, columns = box
    side = np.empty((rows.stop - rows.start, columns.stop - columns.start, 3), dtype=np.float32)
    side[:] = 0.55 * rig.paint_bgr
    corner = np.array([columns.start, rows.start])
    plan = rig.outline.deck
    nearer = np.roll(plan, -1, axis=0) - plan
    normal = np.column_stack([-nearer[:, 1], nearer[:, 0]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    facing = normal @ (_SUN / np.linalg.norm(_SUN))
    boot = deck + (water - deck) * 0.72
    level = 0.66 + 0.30 * facing[:, None]
    quads = np.stack([_panels(deck, boot), _panels(boot, water)], axis=1) - corner
    colours = np.stack([rig.paint_bgr * level, _BOOT * (0.8 + 0.4 * level)], axis=1)
    for i, band in np.argwhere(_turn_clockwise(quads)):
        fixed = np.round(quads[i, band] * 16).astype(np.int32)
        cv2.fillConvexPoly(side, fixed, colours[i, band].tolist(), cv2.LINE_8, 4)
    return side


def _panels(above: Array, below: Array) -> Array:
    """(n, 4, 2) corners of the panels between two outlines (n, 2)."""
    return np.stack([above, np.roll(above, -1, axis=0), np.roll(below, -1, axis=0), below], axis=1)


def _turn_clockwise(quads: Array) -> NDArray[np.bool_]:
    """Which panels (..., 4, 2) show the camera their outside."""
    x, y = quads[..., 0], quads[..., 1]
    return (x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)).sum(axis=-1) > 0


def _bar(picture: Picture, camera: Camera, rig: Rig, pose: Pose, exposure: float) -> None:
    """The tow bar on the centre line, light on dark by little."""
    half = np.array([0.0, _BAR_M / 2 * max(rig.length_m / 2.66, 0.5)])
    corners = np.stack([rig.bar_m[0] - half, rig.bar_m[1] - half, rig.bar_m[1] + half, rig.bar_m[0] + half])
    paint_polygon(picture, _project(camera, rig, corners, pose, rig.line_z_m), _BAR * exposure)


def paint_post(picture: Picture, camera: Camera, rig: Rig, pose: Pose, exposure: float) -> None:
    """The tow post hanging from the carriage, with its mirror image below the line's ring.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    camera : of the scenario
    rig : what is painted of the model
    pose : x, y, heading of the model
    exposure : factor on all brightness
    """
    if rig.tow_m is None:
        return
    x, y = pose.post_m
    places = np.array([[x, y, _POST_TOP_M], [x, y, rig.line_z_m]])
    ends = camera.project(places)
    width = [width_on_picture(camera, place, _POST_M) for place in places]
    mirrored_z = 2 * rig.stage.water_m - np.array([rig.line_z_m, -0.3])
    below = camera.project(np.array([[x, y, z] for z in mirrored_z]))
    quad, strength = bar_outline(below, width[1])
    paint_polygon(picture, quad, _REFLECTED * 0.6 * exposure, 0.35 * strength)
    quad, strength = bar_outline(ends, width)
    paint_polygon(picture, quad, _POST * exposure, strength)
    shade, strength = bar_outline(ends + np.array([0.28 * width[0], 0.0]), np.array(width) * 0.4)
    paint_polygon(picture, shade, _POST * 0.6 * exposure, strength)


def paint_line(picture: Picture, camera: Camera, rig: Rig, pose: Pose, exposure: float) -> None:
    """The tow line from the tow point to the post.

    Parameters
    ----------
    picture : (h, w, 3) float32, BGR, DN, painted on
    camera : of the scenario
    rig : what is painted of the model
    pose : x, y, heading of the model
    exposure : factor on all brightness
    """
    if rig.tow_m is None:
        return
    start = _project(camera, rig, rig.tow_m[None, :], pose, rig.line_z_m)[0]
    post = np.array([*pose.post_m, rig.line_z_m])
    quad, strength = bar_outline(np.stack([start, camera.project(post)[0]]), width_on_picture(camera, post, _LINE_M))
    paint_polygon(picture, quad, _LINE * exposure, max(strength, 0.35))
