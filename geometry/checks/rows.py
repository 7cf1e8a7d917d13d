"""Whitened residuals of the bundle and their slopes, by the parameters and by the model's pose: datum picks, marks, taut line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..camera import Array, Lens
from .filmed import Film, Rig
from .layout import Layout
from .seen import SeenCamera

LEAST_SEEN = 4
"""Rows that a frame needs: with fewer of its marks' coordinates seen its pose is not determined."""


@dataclass(frozen=True)
class State:
    """Where the bundle is linearised.

    Attributes
    ----------
    theta : (p,) parameters, departures from what is stated; extras last
    rotation, translation : the camera's, with its turn and shift
    poses : per film (n, 3)
    """

    theta: Array
    rotation: Array
    translation: Array
    poses: Sequence[Array]


@dataclass(frozen=True)
class Setting:
    """What is the same for all rows at one state.

    Attributes
    ----------
    rig : what is stated
    layout : of theta
    theta : (p,)
    camera : at theta
    mark_scale, line_weight : factor on the marks' sigmas; one over the line's standard deviation, 1/m
    """

    rig: Rig
    layout: Layout
    theta: Array
    camera: SeenCamera
    mark_scale: float
    line_weight: float

    @staticmethod
    def at(state: State, rig: Rig, layout: Layout, line_sd_m: float, inflation: float) -> Setting:
        """The setting at a state; ``inflation`` of the marks' and the line's variances."""
        theta, scale = state.theta, float(np.sqrt(inflation))
        lens = Lens.from_vector(rig.lens.vector + theta[layout.lens])
        camera = SeenCamera(lens, rig.skew + theta[layout.skew], state.rotation, state.translation)
        return Setting(rig, layout, theta, camera, scale, 1.0 / (line_sd_m * scale))


@dataclass(frozen=True)
class Rows:
    """A film's frames; the marks' u and v, then the line. 0 where nothing is seen.

    Attributes
    ----------
    residual : (n, 2m+1)
    by_pose : (n, 2m+1, 3)
    by_theta : (n, 2m+1, p)
    seen : (n,) how many rows say something
    """

    residual: Array
    by_pose: Array
    by_theta: Array
    seen: NDArray[np.int64]


@dataclass(frozen=True)
class _Poses:
    """A film's poses, and their turn."""

    pose: Array
    cosine: Array
    sine: Array

    @staticmethod
    def of(pose: Array) -> _Poses:
        return _Poses(pose, np.cos(pose[:, 2]), np.sin(pose[:, 2]))


def datum_rows(setting: Setting) -> tuple[Array, Array]:
    """Residuals of the datum picks (2k,), picked minus projected, and their slopes (2k, p)."""
    rig, layout, theta = setting.rig, setting.layout, setting.theta
    length, width = theta[layout.datum_length], theta[layout.datum_width]
    pixel, per_camera, per_tank = setting.camera.project(rig.datum_m * np.array([1 + length, 1 + width, 1.0]))
    points = layout.extras_of("point")
    ours = [(extra, at, np.arange(len(pixel)) == extra.index) for extra, at in points]
    off = sum((own[:, None] * theta[at] for _, at, own in ours), np.zeros_like(pixel))
    slope = layout.columns(
        (layout.camera, per_camera),
        (layout.datum_length, per_tank[:, :, 0] * rig.datum_m[:, None, 0]),
        (layout.datum_width, per_tank[:, :, 1] * rig.datum_m[:, None, 1]),
        *((at, own[:, None, None] * np.eye(2)) for _, at, own in ours),
    )
    weight = 1.0 / rig.datum_sigma_px[:, None]
    gap = (rig.datum_px - pixel - off) * weight
    return gap.ravel(), (slope * weight[:, :, None]).reshape(-1, layout.size)


def frame_rows(setting: Setting, index: int, film: Film, pose: Array) -> Rows:
    """Residuals of a film's frames.

    Parameters
    ----------
    index : the film's, among the bundle's
    pose : (n, 3)
    """
    poses = _Poses.of(pose)
    marks = _mark_rows(setting, index, film, poses)
    if film.line_m is None:
        n, wide = len(film.t_s), setting.layout.size
        line, taut = (np.zeros((n, 1)), np.zeros((n, 1, 3)), np.zeros((n, 1, wide))), np.zeros(n, dtype=bool)
    else:
        line, taut = _line_row(setting, index, film, film.line_m, poses), marks.seen >= LEAST_SEEN
    own = (marks.residual, marks.by_pose, marks.by_theta)
    residual, by_pose, by_theta = (np.concatenate(pair, axis=1) for pair in zip(own, line, strict=True))
    few = marks.seen < LEAST_SEEN
    return Rows(
        np.where(few[:, None], 0.0, residual),
        np.where(few[:, None, None], 0.0, by_pose),
        np.where(few[:, None, None], 0.0, by_theta),
        np.where(few, 0, marks.seen + taut),
    )


def _mark_rows(setting: Setting, index: int, film: Film, poses: _Poses) -> Rows:
    """The marks' own rows, 2m of a frame."""
    rig, layout, theta = setting.rig, setting.layout, setting.theta
    n, m, pose = len(film.t_s), len(rig.depth_m), poses.pose
    cosine, sine = poses.cosine[:, None], poses.sine[:, None]
    depth = rig.depth_m + theta[layout.deck_height] + theta[layout.depth]
    body = rig.body_m + np.column_stack([theta[layout.ahead], theta[layout.aside]])
    along = cosine * body[:, 0] - sine * body[:, 1]
    across = sine * body[:, 0] + cosine * body[:, 1]
    tank = np.stack([pose[:, :1] + along, pose[:, 1:2] + across, np.broadcast_to(depth, along.shape)], axis=2)
    turns = [(at, extra.shape(film.t_s)) for extra, at in layout.extras_of("turn", index)]
    turn = sum((course[:, None] * theta[at] for at, course in turns), np.zeros((n, 3)))
    seen = setting.camera.project(tank.reshape(-1, 3), np.repeat(turn, m, axis=0))
    pixel, per_camera, per_tank = (values.reshape(n, m, *values.shape[1:]) for values in seen)
    ok = np.asarray(np.isfinite(film.pixel_px).all(axis=2) & np.isfinite(pixel).all(axis=2))
    weight = np.where(ok[:, :, None], 1.0 / (film.sigma_px * setting.mark_scale), 0.0)
    gap = np.where(ok[:, :, None], film.pixel_px - pixel, 0.0) * weight
    per_tank, per_camera = (
        np.where(ok[:, :, None, None], slope, 0.0) * weight[..., None] for slope in (per_tank, per_camera)
    )
    by_x, by_y, by_depth = per_tank[..., 0], per_tank[..., 1], per_tank[..., 2]
    by_turn = -by_x * across[:, :, None] + by_y * along[:, :, None]
    own = np.eye(m, dtype=bool)[:, None, :]  # a mark's place moves that mark alone
    by_theta = layout.columns(
        (layout.camera, per_camera),
        (layout.deck_height, by_depth),
        (layout.depth, np.where(own, by_depth[..., None], 0.0)),
        (layout.ahead, np.where(own, (by_x * cosine[..., None] + by_y * sine[..., None])[..., None], 0.0)),
        (layout.aside, np.where(own, (-by_x * sine[..., None] + by_y * cosine[..., None])[..., None], 0.0)),
        *((at, per_camera[..., layout.turn] * course[:, None, None, None]) for at, course in turns),
    )
    return Rows(
        gap.reshape(n, -1),
        np.stack([by_x, by_y, by_turn], axis=3).reshape(n, -1, 3),
        by_theta.reshape(n, -1, layout.size),
        2 * ok.sum(axis=1),
    )


def _line_row(setting: Setting, index: int, film: Film, line_m: float, poses: _Poses) -> tuple[Array, Array, Array]:
    """The tow point keeps its distance from the post: L - radius, (n, 1), with slopes (n, 1, 3) and (n, 1, p)."""
    layout, theta, weight = setting.layout, setting.theta, setting.line_weight
    pose, cosine, sine = poses.pose, poses.cosine, poses.sine
    x_t, y_t = film.tow_point_m[0] + theta[layout.tow_point], film.tow_point_m[1]
    arm_x, arm_y = x_t * cosine - y_t * sine, x_t * sine + y_t * cosine
    off_x = pose[:, 0] + arm_x - film.post_m[0] - theta[layout.post_ahead]
    off_y = pose[:, 1] + arm_y - film.post_m[1]
    radius = np.hypot(off_x, off_y)
    e_x, e_y = off_x / radius * weight, off_y / radius * weight
    slacks = [(at.start, extra.shape(film.t_s)) for extra, at in layout.extras_of("slack", index)]
    missing = sum((theta[at] * course * weight for at, course in slacks), np.zeros(len(radius)))
    by_pose = np.column_stack([e_x, e_y, -e_x * arm_y + e_y * arm_x])
    by_theta = layout.columns(
        (layout.line_length, np.full(len(radius), -weight)),
        (layout.tow_point, e_x * cosine + e_y * sine),
        (layout.post_ahead, -e_x),
        *((at, course * weight) for at, course in slacks),
    )
    residual = (line_m + theta[layout.line_length] - radius) * weight - missing
    return residual[:, None], by_pose[:, None], by_theta[:, None]


__all__ = ["Rows", "Setting", "State", "datum_rows", "frame_rows"]
