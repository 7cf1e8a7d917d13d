"""A body that may roll, heave and pitch, frame by frame, from marks at unlike places: six numbers instead of three.

A mark that stands dz lower than its depth says is seen at another place of its plane, by dz times what its ray goes aside for a
metre of depth. Three marks that stand on no one line give six numbers a frame. One camera tells some mixtures of these badly (a
roll looks like a heave and a shift); that stands in the covariance, and a second camera from another side tells them.

Angles: heading, then pitch, then roll about the body's own axes (x ahead, y to starboard, z down): bow up and starboard down are
positive. x, y and heave are of the point of the LCG at the depth of the lowest mark.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ...record.run import Run
from ..camera import Array
from ..mapping import Mapping, ray_slopes
from ..poses import Poses
from .view import View, pulls_of, shared_modes

NUMBERS = 6
"""Of a pose: x, y, heading, heave, roll, pitch."""
ROOM = (0.1, 0.2, 0.1)
"""Heave m, roll rad, pitch rad of a towed model, standard deviations: wide, so that what a camera does not tell stays finite."""
FLATTEST = 0.03
"""Marks whose spread across their common line is less than this share of that along it stand on one line: 6 cm of 2 m."""
STEPS = 8
"""Of Gauss-Newton from the pose without roll: angles are small, and three or four do."""
SMALLEST = 1e-11
"""m and rad: the next step would be its square."""


def tells_roll(run: Run) -> str | None:
    """Why the marks of a run cannot tell roll and heave, in words; None where they can.

    Parameters
    ----------
    run : its marks
    """
    if any(m.on == "post" for m in run.file.marker):
        return "roll and heave are not told with a camera fixed to the tank"
    body = np.array([(*m.body_m, m.depth_m) for m in run.file.marker])
    if len(body) < 3:
        return "roll and heave are not told by two marks: a third one beside the line through them, or on a mast, would tell them"
    spread = np.linalg.svd(body - body.mean(axis=0), compute_uv=False)
    if spread[1] < FLATTEST * spread[0]:
        return "roll and heave are not told by marks on one line: one beside it, or on a mast, would tell them"
    return None


def afloat_view(run: Run, poses: Poses, mapping: Mapping) -> View:
    """Poses with heave, roll and pitch as one camera sees them, (n, 6), where it sees three marks at least.

    Parameters
    ----------
    run : as that camera sees it, whose marks tell roll (``tells_roll``)
    poses : ``poses_from_tracks``'s
    mapping : the camera's
    """
    body = np.array([(*m.body_m, m.depth_m) for m in poses.markers])
    lowest = body[:, 2].max()
    own = body - [0.0, 0.0, lowest]
    seen = np.asarray(np.isfinite(poses.place_m).all(axis=2) & np.isfinite(poses.covariance_m2).all(axis=(2, 3)))
    used = np.asarray((seen.sum(axis=1) >= 3) & np.isfinite(poses.rigid.pose).all(axis=1))
    n = len(seen)
    pose, covariance = np.full((n, NUMBERS), np.nan), np.full((n, NUMBERS, NUMBERS), np.nan)
    modes = np.zeros((len(poses.modes_m), n, NUMBERS))
    answer = View(poses.t_s, pose, covariance, modes, poses.lags, pulls_of(run, poses), shared_modes(run))
    if not used.any():
        return answer
    mask = seen[used]
    place = np.where(mask[..., None], poses.place_m[used], 0.0)
    weight = (
        np.linalg.inv(np.where(mask[..., None, None], poses.covariance_m2[used], np.eye(2))) * mask[..., None, None]
    )
    aside = np.where(mask[..., None], _aside(poses.pixel_px[used], mapping, body[:, 2]), 0.0)
    prior = np.zeros((NUMBERS, NUMBERS))
    prior[[3, 4, 5], [3, 4, 5]] = 1 / np.square(ROOM)
    state = np.column_stack([poses.rigid.pose[used], np.zeros((int(used.sum()), 3))])
    for _ in range(STEPS):
        normal, pull, gap = _normal(state, place, own, aside, weight, prior)
        step = np.linalg.solve(normal, (pull @ gap[..., None])[..., 0:1] - (state @ prior)[..., None])[..., 0]
        state = state + step
        if np.abs(step).max() < SMALLEST:
            break
    normal, pull, _ = _normal(state, place, own, aside, weight, prior)
    inverse = np.linalg.inv(normal)
    gain = inverse @ pull
    pose[used], covariance[used] = state, inverse
    flat = np.nan_to_num(poses.modes_m[:, used])
    if answer.shared:
        flat[answer.own :] += _leaning(run, poses.rigid.pose[used, 2], state, aside) * mask[..., None]
    modes[:, used] = np.einsum("nif,knf->kni", gain, flat.reshape(len(modes), int(used.sum()), -1))
    return answer


def _aside(pixel: Array, mapping: Mapping, depth: Array) -> Array:
    """(n, m, 2) how far a mark's ray goes aside for a metre of depth."""
    return np.stack([ray_slopes(mapping, pixel[:, index], at) for index, at in enumerate(depth)], axis=1)


def _normal(
    state: Array, place: Array, own: Array, aside: Array, weight: Array, prior: Array
) -> tuple[Array, Array, Array]:
    """Normal matrix (n, 6, 6), weighted slopes (n, 6, 2m) and gaps (n, 2m)."""
    turned, slopes = _turned(state[:, 2], state[:, 4], state[:, 5], own)
    n, m = place.shape[:2]
    lower = state[:, 3, None] + turned[..., 2] - own[:, 2]  # than each mark's depth says
    gap = place - (state[:, None, :2] + turned[..., :2] - aside * lower[..., None])
    slope = np.zeros((n, m, 2, NUMBERS))
    slope[..., 0, 0] = slope[..., 1, 1] = 1.0
    slope[..., 3] = -aside
    for column, by in zip((2, 4, 5), slopes, strict=True):
        slope[..., column] = by[..., :2] - aside * by[..., 2:]
    pull = (weight @ slope).reshape(n, 2 * m, NUMBERS).transpose(0, 2, 1)
    return pull @ slope.reshape(n, 2 * m, NUMBERS) + prior, pull, gap.reshape(n, 2 * m)


def _leaning(run: Run, level: Array, state: Array, aside: Array) -> Array:
    """What the marks' own errors move besides when the body leans: (shared, n, m, 2), in the order of ``shared_modes``.

    ``poses`` has them of a level body: a mark off its depth is seen on another plane, one off its place is turned by the heading
    ``level (n,)`` that such a body has. Roll and pitch carry the first aside, and the second up and down.
    """
    priors, (n, m) = run.file.priors, aside.shape[:2]
    unit, _ = _turned(state[:, 2], state[:, 4], state[:, 5], np.eye(3))
    # (n, 3, 3), by an error ahead, to starboard, down
    more = unit.transpose(0, 2, 1) - _about(2, level)[0]
    moved = -(more[:, None, :2] - aside[..., None] * more[:, None, 2:])  # (n, m, 2, 3)
    found = []
    for sd, axes in ((priors.marker_depth_sd_m, (2,)), (priors.marker_place_sd_m, (0, 1))):
        for mark, axis in product(range(m), axes if sd else ()):
            mode = np.zeros((n, m, 2))
            mode[:, mark] = (sd or 0.0) * moved[:, mark, :, axis]
            found.append(mode)
    return np.array(found)


def _turned(heading: Array, roll: Array, pitch: Array, own: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Marks (n, m, 3) turned by heading, pitch and roll, and their slopes by heading, roll, pitch."""
    yaw, yaw_slope = _about(2, heading)
    nod, nod_slope = _about(1, pitch)
    lean, lean_slope = _about(0, roll)
    spin = [yaw @ nod @ lean, yaw_slope @ nod @ lean, yaw @ nod @ lean_slope, yaw @ nod_slope @ lean]
    whole, *slopes = (np.einsum("nij,mj->nmi", one, own) for one in spin)
    return whole, (slopes[0], slopes[1], slopes[2])


def _about(axis: int, angle: Array) -> tuple[Array, Array]:
    """Right-handed turns (n, 3, 3) about an axis, and their slopes by the angle."""
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    turn, slope = np.zeros((len(angle), 3, 3)), np.zeros((len(angle), 3, 3))
    turn[:, axis, axis] = 1.0
    turn[:, i, i] = turn[:, j, j] = slope[:, j, i] = np.cos(angle)
    turn[:, j, i] = np.sin(angle)
    turn[:, i, j] = -np.sin(angle)
    slope[:, i, i] = slope[:, j, j] = -np.sin(angle)
    slope[:, i, j] = -np.cos(angle)
    return turn, slope


__all__ = ["NUMBERS", "afloat_view", "tells_roll"]
