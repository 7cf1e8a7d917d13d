"""A camera that was knocked or shakes: its turn in every frame from datum points that are re-found there.

A camera that turns by R moves the picture of everything alike, whatever its distance: a ray d is seen at K R d. (What a camera
shifts by matters less by the ratio of the shift to the distance; it is left in the residual.) The marks are turned back to the
camera of the picked frame, so that the datum's one fit serves all frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import rq
from scipy.spatial.transform import Rotation

from ..record.schema import DatumPoint
from .camera import Array
from .mapping import ProjectiveMapping

LEAST_POINTS = 2
"""Two points fix the three angles of a turn."""
STEPS = 6
"""Gauss-Newton steps from no turn, always all of them: turns are small, and each step squares the error."""
STILL = 1.5
"""A turn whose mean chi-square per degree of freedom stays below this is the points' noise."""


@dataclass(frozen=True)
class Shake:
    """The camera's turn against the picked frame.

    Attributes
    ----------
    frames : (n,) frame numbers
    turn_rad : (n, 3) rotation vectors in camera axes (right, down, ahead); NaN where too few points were seen
    covariance : (n, 3, 3) rad^2
    residual_px : root mean square of what the turn leaves of the points' motion
    still : the turns are no larger than their noise
    """

    frames: Array
    turn_rad: Array
    covariance: Array
    residual_px: float
    still: bool


def camera_shake(tracks: pd.DataFrame, points: Sequence[DatumPoint], mapping: ProjectiveMapping) -> Shake:
    """Fit the camera's turn to re-found datum points.

    Parameters
    ----------
    tracks : frame, marker (the point's name), u_px, v_px, sigma_u_px, sigma_v_px, status
    points : the datum, by name; a point's picked place is where it was in the picked frame
    mapping : of the datum
    """
    named = {p.name or f"point {i + 1}": p for i, p in enumerate(points)}
    rows = tracks[(tracks["status"] == "measured") & tracks["marker"].isin(list(named))]
    frames = np.unique(tracks["frame"].to_numpy())
    row = np.searchsorted(frames, rows["frame"].to_numpy())
    inner = _inner(mapping)
    picked = np.array([named[name].pixel_px for name in rows["marker"]]).reshape(-1, 2)
    rays = _rays(mapping, inner, picked)
    pixel_px, sigma_px = rows[["u_px", "v_px"]].to_numpy(), rows[["sigma_u_px", "sigma_v_px"]].to_numpy()
    return _fitted(frames, row, inner, rays, pixel_px, sigma_px, mapping)


class StillView:
    """Points that are looked at again and again: their rays are worked out once.

    Parameters
    ----------
    points : the datum
    mapping : of the datum
    """

    def __init__(self, points: Sequence[DatumPoint], mapping: ProjectiveMapping) -> None:
        self._mapping, self._inner = mapping, _inner(mapping)
        picked = np.array([point.pixel_px for point in points], dtype=float).reshape(-1, 2)
        self._rays = _rays(mapping, self._inner, picked)

    def turn(self, which: Array, pixel_px: Array, sigma_px: Array) -> Shake:
        """The camera's turn in one frame, as ``camera_shake`` has it.

        Parameters
        ----------
        which : (k,) numbers of the points that are seen
        pixel_px, sigma_px : (k, 2), where, and how well that is known
        """
        row = np.zeros(len(which), dtype=int)
        return _fitted(np.zeros(1, int), row, self._inner, self._rays[which], pixel_px, sigma_px, self._mapping)


def _fitted(
    frames: Array, row: Array, inner: Array, rays: Array, pixel_px: Array, sigma_px: Array, mapping: ProjectiveMapping
) -> Shake:
    """The turns of ``frames``, whose points stand in ``row``."""
    seen, per_px = mapping.lens.normalise(pixel_px)
    spread = per_px * sigma_px[:, None, :]
    weight = np.linalg.inv(spread @ spread.swapaxes(1, 2))
    turn = np.zeros((len(frames), 3))
    normal = np.zeros((len(frames), 3, 3))
    gap = np.zeros((len(row), 2))
    for _ in range(STEPS):
        gap, slope = _linearised(turn[row], rays, inner, seen)
        normal = np.zeros((len(frames), 3, 3))
        right = np.zeros((len(frames), 3))
        np.add.at(normal, row, np.einsum("nia,nij,njb->nab", slope, weight, slope))
        np.add.at(right, row, np.einsum("nia,nij,nj->na", slope, weight, gap))
        known = np.bincount(row, minlength=len(frames)) >= LEAST_POINTS
        turn[known] += np.linalg.solve(normal[known], right[known][:, :, None])[:, :, 0]
    count = np.bincount(row, minlength=len(frames))
    known = count >= LEAST_POINTS
    covariance = np.full((len(frames), 3, 3), np.nan)
    covariance[known] = np.linalg.inv(normal[known])
    chi_square = np.zeros(len(frames))
    np.add.at(chi_square, row, np.einsum("ni,nij,nj->n", gap, weight, gap))
    freedom = 2 * count[known].sum() - 3 * known.sum()
    scale = max(chi_square[known].sum() / freedom, 1.0) if freedom > 0 else 1.0
    covariance *= scale
    turn[~known] = np.nan
    residual = np.sqrt(np.mean((gap @ np.linalg.inv(per_px.mean(axis=0))) ** 2)) if len(gap) else 0.0
    return Shake(frames, turn, covariance, float(residual), _still(turn[known], normal[known] / scale))


def _still(turn: Array, information: Array) -> bool:
    if not len(turn):
        return True
    square = np.einsum("na,nab,nb->n", turn, information, turn) / 3
    return bool(np.mean(square) < STILL)


def turned_back(shake: Shake, frames: Array, pixel_px: Array, mapping: ProjectiveMapping) -> tuple[Array, Array]:
    """Marks' pixels as the camera of the picked frame would have seen them.

    Parameters
    ----------
    shake : from the datum points of every frame
    frames : (n,) frame numbers
    pixel_px : (n, m, 2)
    mapping : pixel -> tank

    Returns
    -------
    pixel_px : (n, m, 2); NaN where the camera's turn is not known
    variance : (n, m, 2) px^2 that the turn's uncertainty adds
    """
    row = np.clip(np.searchsorted(shake.frames, frames), 0, max(len(shake.frames) - 1, 0))
    turn = np.where((shake.frames[row] == frames)[:, None], shake.turn_rad[row], np.nan)
    flat = pixel_px.reshape(-1, 2)
    marks = pixel_px.shape[1]
    each = np.repeat(row, marks)
    inner = _inner(mapping)
    answer, variance = np.full_like(flat, np.nan), np.full_like(flat, np.nan)
    good = np.isfinite(flat).all(axis=1) & np.isfinite(np.repeat(turn, marks, axis=0)).all(axis=1)
    if good.any():
        rays = _rays(mapping, inner, flat[good])
        back = Rotation.from_rotvec(-shake.turn_rad[each[good]]).apply(rays)
        ideal, slope = _projected(back, inner)
        answer[good] = mapping.lens.distort(ideal)
        _, per_px = mapping.lens.normalise(answer[good])
        by_turn = np.linalg.inv(per_px) @ slope
        variance[good] = np.einsum("nia,nab,nib->ni", by_turn, shake.covariance[each[good]], by_turn)
    return answer.reshape(pixel_px.shape), variance.reshape(pixel_px.shape)


def _inner(mapping: ProjectiveMapping) -> Array:
    """K of the camera matrix in the lens's ideal coordinates, (3, 3); near the unit matrix where the lens is known."""
    upper, _ = rq(mapping.matrix[:, :3])
    signs = np.sign(np.diag(upper))
    upper = upper * np.where(signs == 0, 1.0, signs)[None, :]
    return upper / upper[2, 2]


def _rays(mapping: ProjectiveMapping, inner: Array, pixel_px: Array) -> Array:
    """Directions ``(n, 3)`` in camera axes."""
    ideal, _ = mapping.lens.normalise(pixel_px)
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ np.linalg.inv(inner).T
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _projected(rays: Array, inner: Array) -> tuple[Array, Array]:
    """Ideal coordinates ``(n, 2)`` of rays, and their slope by a small further turn ``(n, 2, 3)``."""
    seen = rays @ inner.T
    ideal = seen[:, :2] / seen[:, 2:]
    cross = np.zeros((len(rays), 3, 3))  # d(w x ray)/dw = -[ray]x
    x, y, z = rays.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 0] = z, -y, -z
    cross[:, 1, 2], cross[:, 2, 0], cross[:, 2, 1] = x, y, -x
    moved = np.einsum("ij,nja->nia", inner, cross)
    return ideal, (moved[:, :2] - ideal[:, :, None] * moved[:, 2:]) / seen[:, 2, None, None]


def _linearised(turn: Array, rays: Array, inner: Array, seen: Array) -> tuple[Array, Array]:
    """What the turn leaves ``(n, 2)`` and its slope ``(n, 2, 3)``."""
    ideal, slope = _projected(Rotation.from_rotvec(turn).apply(rays), inner)
    return seen - ideal, slope
