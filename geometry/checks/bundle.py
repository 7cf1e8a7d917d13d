"""All that the recording says of its own geometry in one least-squares fit: datum picks, marks in every frame, the taut line.

A bundle adjustment whose unknowns are the camera, the heights and places of the marks, the datum's scales, the line - each with
what is known of it beforehand - and the model's pose in every frame, which is eliminated. No hydrodynamics: it rests on the two
facts that hold whatever the water does, constant marker distances and the taut-line circle (theory.md 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...record.errors import GeometryError
from ..camera import Array, Lens
from ..normal import inverse_of_normal

LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
TURN = ("camera turn right", "camera turn down", "camera turn ahead")
SHIFT = ("camera shift right", "camera shift down", "camera shift ahead")
CAMERA = (*LENS, "skew", *TURN, *SHIFT)
_ROTATION, _TRANSLATION = slice(10, 13), slice(13, 16)
DATUM = ("deck height", "datum length", "datum width")
LINE = ("line length", "tow point", "post ahead")
STEPS = 12
SETTLED = 1e-4
"""A step that changes no parameter by more than this share of its standard deviation ends the iteration."""


def half_sine(t_s: Array, begin_s: Array | float, end_s: Array | float) -> Array:
    """The usual course of a line that goes slack and tautens again: 0 outside, 1 in the middle."""
    share = (t_s - begin_s) / (end_s - begin_s)
    return np.where((share > 0) & (share < 1), np.sin(np.pi * np.clip(share, 0, 1)), 0.0)


@dataclass(frozen=True)
class Film:
    """One run's frames.

    Attributes
    ----------
    t_s : (n,)
    pixel_px, sigma_px : (n, m, 2); NaN where a mark is lost
    line_m : line length, or None: no taut line (free, forced, post not still)
    tow_point_m : (X_T, Y_T)
    post_m : (2,)
    """

    t_s: Array
    pixel_px: Array
    sigma_px: Array
    line_m: float | None
    tow_point_m: Array
    post_m: Array

    def only(self, kept: slice) -> Film:
        """With some of its frames."""
        return replace(self, t_s=self.t_s[kept], pixel_px=self.pixel_px[kept], sigma_px=self.sigma_px[kept])


@dataclass(frozen=True)
class Rig:
    """What was filmed and what is stated of it.

    Attributes
    ----------
    lens, skew, rotation, translation : camera; skew in px
    datum_px, datum_m, datum_sigma_px : (k, 2), (k, 3), (k,)
    body_m, depth_m : (m, 2), (m,)
    """

    lens: Lens
    skew: float
    rotation: Array
    translation: Array
    datum_px: Array
    datum_m: Array
    datum_sigma_px: Array
    body_m: Array
    depth_m: Array

    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of every vector here."""
        marks = range(len(self.depth_m))
        each = [f"{what} {i}" for what in ("depth", "ahead", "aside") for i in marks]
        return (*CAMERA, *DATUM, *LINE, *each)


@dataclass(frozen=True)
class Extra:
    """A fault that is no number of the rig: a badly picked datum point, a camera turned mid-run, a slack line.

    Attributes
    ----------
    kind : "point" (2 numbers, px), "turn" (3, rad), "slack" (1, m)
    index : datum point, or run
    span_s : turn: (first time after it, inf); slack: its begin and end
    """

    kind: str
    index: int
    span_s: tuple[float, float] = (0.0, 0.0)

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return {"point": 2, "turn": 3, "slack": 1}[self.kind]

    def shape(self, t_s: Array) -> Array:
        """Its course over time, (n,): a step, or half a sine."""
        begin, end = self.span_s
        if self.kind == "turn":
            return (t_s >= begin).astype(float)
        return half_sine(t_s, begin, end)


@dataclass(frozen=True)
class Normal:
    """Normal equations with the poses eliminated.

    Attributes
    ----------
    matrix, right : (p, p), (p,): of the parameters, whitened, without priors
    chi_square : of all residuals at the best poses near the given ones
    degrees : residuals minus poses
    left : per film (n, 2m+1): whitened residuals with the poses' share taken out; 0 where nothing was seen
    slopes : per film (n, 2m+1, p), whitened
    project : per film (n, 2m+1, 2m+1), takes the poses' share out
    steps : per film (n, 3) and (n, 3, p): best step of the pose, and its change with the parameters
    """

    matrix: Array
    right: Array
    chi_square: float
    degrees: int
    left: list[Array]
    slopes: list[Array]
    project: list[Array]
    steps: list[tuple[Array, Array]]


@dataclass(frozen=True)
class Solution:
    """A fitted bundle.

    Attributes
    ----------
    theta : (p,) parameters, departures from what is stated; extras last
    covariance : (p, p); rows of fixed parameters are 0
    chi_square : of residuals and priors
    degrees : residuals minus free parameters without a prior
    poses : per film (n, 3)
    rotation, translation : the camera's, with its turn and shift
    normal : at the solution
    log_evidence : of the data, Laplace's approximation, up to what is common to all fits of the same data
    """

    theta: Array
    covariance: Array
    chi_square: float
    degrees: int
    poses: list[Array]
    rotation: Array
    translation: Array
    normal: Normal
    log_evidence: float


class Bundle:
    """The fit of one camera set-up over its runs.

    Parameters
    ----------
    rig : what is stated
    films : runs of this set-up
    poses : per film (n, 3), start; NaN where too few marks were seen
    line_sd_m : how exactly a taut line keeps its length from frame to frame
    inflation : factor on the marks' and the line's variances (noise that is not independent from frame to frame)
    close : the films with more of their frames, for what happens between two; None: the films themselves
    """

    def __init__(
        self,
        rig: Rig,
        films: Sequence[Film],
        poses: Sequence[Array],
        line_sd_m: float,
        inflation: float = 1.0,
        close: Sequence[Film] | None = None,
    ) -> None:
        self.rig, self.films = rig, list(films)
        self.close = self.films if close is None else list(close)
        self.start = [np.array(p, dtype=float) for p in poses]
        self.line_sd_m, self.inflation = line_sd_m, inflation
        self.names = rig.names()

    def with_inflation(self, factor: float) -> Bundle:
        """The same with another factor on the marks' variances."""
        return Bundle(self.rig, self.films, self.start, self.line_sd_m, factor, self.close)

    def solve(self, sd: Array, extras: Sequence[tuple[Extra, Array]] = (), first: Solution | None = None) -> Solution:
        """Gauss-Newton.

        Parameters
        ----------
        sd : (p,) prior standard deviations; 0 = fixed, inf = free
        extras : faults with the prior standard deviations of their numbers
        first : a solution without extras to start from

        Raises
        ------
        GeometryError : it does not settle
        """
        count = len(self.names)
        kinds = [extra for extra, _ in extras]
        sds = np.concatenate([sd, *[s for _, s in extras]])
        theta = np.zeros(len(sds))
        rotation, translation, poses = self.rig.rotation, self.rig.translation, [p.copy() for p in self.start]
        if first is not None:
            theta[:count] = first.theta[:count]
            rotation, translation, poses = first.rotation, first.translation, [p.copy() for p in first.poses]
        free = sds > 0
        precision = np.zeros(len(sds))
        precision[free] = 1.0 / sds[free] ** 2
        covariance = np.zeros((len(sds), len(sds)))
        inner = np.zeros((0, 0))
        best, chi_square = np.inf, np.inf
        normal = self.normal(theta, rotation, translation, poses, kinds)
        for _ in range(STEPS):
            normal = self.normal(theta, rotation, translation, poses, kinds)
            inner = normal.matrix[np.ix_(free, free)] + np.diag(precision[free])
            covariance[np.ix_(free, free)] = inverse_of_normal(inner)
            gradient = normal.right - precision * theta
            step = covariance @ gradient
            chi_square = normal.chi_square + float((precision * theta**2).sum())
            gain = float(gradient @ step)
            if gain < SETTLED and chi_square <= best + SETTLED:
                break
            best = min(best, chi_square)
            theta = theta + step
            # turns and shifts of the camera are composed, not added; they have no prior
            turn = Rotation.from_rotvec(step[_ROTATION]).as_matrix()
            rotation, translation = turn @ rotation, turn @ translation + step[_TRANSLATION]
            for pose, (alone, along) in zip(poses, normal.steps, strict=True):
                pose += alone - along @ step
        if not np.isfinite(theta).all():
            raise GeometryError(
                "the joint fit of camera and marks does not settle; the camera or the marks are far off"
            )
        degrees = normal.degrees - int((np.isinf(sds)).sum())
        known = np.isfinite(sds[free])
        volume = -np.linalg.slogdet(inner)[1] - 2 * float(np.log(sds[free][known]).sum())
        return Solution(
            theta,
            covariance,
            chi_square,
            degrees,
            poses,
            rotation,
            translation,
            normal,
            0.5 * (volume - chi_square),
        )

    def normal(
        self,
        theta: Array,
        rotation: Array,
        translation: Array,
        poses: Sequence[Array],
        extras: Sequence[Extra] = (),
    ) -> Normal:
        """Linearise at parameters and poses and eliminate the poses."""
        camera, offsets = self._seen(theta, rotation, translation), self._offsets(extras)
        wide = int(offsets[-1])
        gap, slope = self._datum(theta, camera, extras, offsets, wide)
        matrix, right = slope.T @ slope, slope.T @ gap
        chi_square, degrees = float(gap @ gap), len(gap)
        lefts, slopes, projects, steps = [], [], [], []
        for index, film in enumerate(self.films):
            rows, by_pose, by_theta, seen = self._frames(
                index, film, theta, camera, poses[index], extras, offsets, wide
            )
            inner = np.einsum("nia,nib->nab", by_pose, by_pose)
            usable = seen >= 3
            inner[~usable] = np.eye(3)
            inverse = np.linalg.inv(inner) * usable[:, None, None]
            gain = np.einsum("nab,nib->nai", inverse, by_pose)
            project = np.eye(rows.shape[1]) - np.einsum("nia,naj->nij", by_pose, gain)
            project = project * usable[:, None, None]
            left = np.einsum("nij,nj->ni", project, rows)
            moved = np.einsum("nij,njp->nip", project, by_theta)
            matrix = matrix + np.einsum("nip,niq->pq", moved, moved)
            right = right + np.einsum("nip,ni->p", moved, left)
            chi_square += float((left**2).sum())
            degrees += int((seen[usable] - 3).sum())
            lefts.append(left)
            slopes.append(by_theta)
            projects.append(project)
            steps.append((np.einsum("nai,ni->na", gain, rows), np.einsum("nai,nip->nap", gain, by_theta)))
        return Normal(matrix, right, chi_square, degrees, lefts, slopes, projects, steps)

    def linear(
        self,
        index: int,
        theta: Array,
        rotation: Array,
        translation: Array,
        poses: Sequence[Array],
        extras: Sequence[Extra] = (),
    ) -> tuple[Array, Array, Array]:
        """Whitened residuals of a film's frames (n, 2m+1), and their slopes by the pose (n, 2m+1, 3) and the parameters."""
        camera, offsets = self._seen(theta, rotation, translation), self._offsets(extras)
        film = self.films[index]
        return self._frames(index, film, theta, camera, poses[index], extras, offsets, int(offsets[-1]))[:3]

    def _seen(self, theta: Array, rotation: Array, translation: Array) -> _Seen:
        lens = Lens.from_vector(self.rig.lens.vector + theta[:9])
        return _Seen(lens, self.rig.skew + theta[9], rotation, translation)

    def _offsets(self, extras: Sequence[Extra]) -> Array:
        return np.cumsum([len(self.names), *[extra.size for extra in extras]])

    def datum_rows(self, solution: Solution) -> tuple[Array, Array]:
        """Whitened residuals of the datum picks at a solution without extras (2k,), and their slopes (2k, p)."""
        camera = self._seen(solution.theta, solution.rotation, solution.translation)
        return self._datum(solution.theta, camera, (), self._offsets(()), len(self.names))

    def _datum(self, theta: Array, camera: _Seen, extras: Sequence[Extra], offsets: Array, wide: int):
        rig = self.rig
        length, width = theta[17], theta[18]
        tank = rig.datum_m * np.array([1 + length, 1 + width, 1.0])
        pixel, per_camera, per_tank = camera.project(tank)
        gap = rig.datum_px - pixel
        slope = np.zeros((len(tank), 2, wide))
        slope[:, :, :16] = per_camera
        slope[:, :, 17] = per_tank[:, :, 0] * rig.datum_m[:, None, 0]
        slope[:, :, 18] = per_tank[:, :, 1] * rig.datum_m[:, None, 1]
        for extra, at in zip(extras, offsets, strict=False):
            if extra.kind == "point":
                slope[extra.index, :, at : at + 2] = np.eye(2)
                gap[extra.index] -= theta[at : at + 2]
        weight = 1.0 / rig.datum_sigma_px[:, None]
        return (gap * weight).ravel(), (slope * weight[:, :, None]).reshape(-1, wide)

    def _frames(self, index, film: Film, theta, camera: _Seen, pose, extras, offsets, wide):
        """Whitened residuals (n, 2m+1), slopes by pose (n, 2m+1, 3) and parameters, and how many rows are seen (n,)."""
        rig, n, m = self.rig, len(film.t_s), len(self.rig.depth_m)
        depth = rig.depth_m + theta[16] + theta[22 : 22 + m]
        body = rig.body_m + np.column_stack([theta[22 + m : 22 + 2 * m], theta[22 + 2 * m : 22 + 3 * m]])
        cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        along = cosine[:, None] * body[:, 0] - sine[:, None] * body[:, 1]
        across = sine[:, None] * body[:, 0] + cosine[:, None] * body[:, 1]
        tank = np.stack([pose[:, :1] + along, pose[:, 1:2] + across, np.broadcast_to(depth, along.shape)], axis=2)
        turned = [(e, at) for e, at in zip(extras, offsets, strict=False) if e.kind == "turn" and e.index == index]
        turns = sum((e.shape(film.t_s)[:, None] * theta[at : at + 3] for e, at in turned), np.zeros((n, 3)))
        pixel, per_camera, per_tank = camera.project(tank.reshape(-1, 3), np.repeat(turns, m, axis=0))
        pixel, per_camera, per_tank = (a.reshape(n, m, *a.shape[1:]) for a in (pixel, per_camera, per_tank))
        rows = np.zeros((n, 2 * m + 1))
        by_pose = np.zeros((n, 2 * m + 1, 3))
        by_theta = np.zeros((n, 2 * m + 1, wide))
        ok = np.asarray(np.isfinite(film.pixel_px).all(axis=2) & np.isfinite(pixel).all(axis=2))
        weight = np.where(ok[:, :, None], 1.0 / (film.sigma_px * np.sqrt(self.inflation)), 0.0)
        gap = np.where(ok[:, :, None], film.pixel_px - pixel, 0.0) * weight
        per_tank, per_camera = (
            np.where(ok[:, :, None, None], a, 0.0) * weight[..., None] for a in (per_tank, per_camera)
        )
        rows[:, : 2 * m] = gap.reshape(n, -1)
        turn = -per_tank[..., 0] * across[:, :, None] + per_tank[..., 1] * along[:, :, None]
        by_pose[:, : 2 * m] = np.stack([per_tank[..., 0], per_tank[..., 1], turn], axis=3).reshape(n, -1, 3)
        marks = by_theta[:, : 2 * m].reshape(n, m, 2, wide)
        marks[..., :16] = per_camera
        marks[..., 16] = per_tank[..., 2]
        ahead = per_tank[..., 0] * cosine[:, None, None] + per_tank[..., 1] * sine[:, None, None]
        aside = -per_tank[..., 0] * sine[:, None, None] + per_tank[..., 1] * cosine[:, None, None]
        for i in range(m):
            marks[:, i, :, 22 + i] = per_tank[:, i, :, 2]
            marks[:, i, :, 22 + m + i] = ahead[:, i]
            marks[:, i, :, 22 + 2 * m + i] = aside[:, i]
        for extra, at in turned:
            marks[..., at : at + 3] = per_camera[..., _ROTATION] * extra.shape(film.t_s)[:, None, None, None]
        seen = 2 * ok.sum(axis=1)
        if film.line_m is not None:
            self._line(index, film, theta, pose, cosine, sine, extras, offsets, rows, by_pose, by_theta)
            seen = seen + (seen >= 4)
        few = seen < 4
        rows[few], by_pose[few], by_theta[few] = 0.0, 0.0, 0.0
        return rows, by_pose, by_theta, np.where(few, 0, seen)

    def _line(self, index, film: Film, theta, pose, cosine, sine, extras, offsets, rows, by_pose, by_theta) -> None:
        """The tow point keeps its distance from the post: L - radius, in the last row."""
        x_t, y_t = film.tow_point_m[0] + theta[20], film.tow_point_m[1]
        arm_x, arm_y = x_t * cosine - y_t * sine, x_t * sine + y_t * cosine
        off_x = pose[:, 0] + arm_x - film.post_m[0] - theta[21]
        off_y = pose[:, 1] + arm_y - film.post_m[1]
        radius = np.hypot(off_x, off_y)
        weight = 1.0 / (self.line_sd_m * np.sqrt(self.inflation))
        e_x, e_y = off_x / radius * weight, off_y / radius * weight
        row = (film.line_m + theta[19] - radius) * weight
        by_pose[:, -1] = np.column_stack([e_x, e_y, -e_x * arm_y + e_y * arm_x])
        by_theta[:, -1, 19] = -weight
        by_theta[:, -1, 20] = e_x * cosine + e_y * sine
        by_theta[:, -1, 21] = -e_x
        for extra, at in zip(extras, offsets, strict=False):
            if extra.kind == "slack" and extra.index == index:
                shape = extra.shape(film.t_s)
                row = row - theta[at] * shape * weight
                by_theta[:, -1, at] = shape * weight
        rows[:, -1] = row


@dataclass(frozen=True)
class _Seen:
    """A camera that gives slopes by all of its numbers."""

    lens: Lens
    skew: float
    rotation: Array
    translation: Array

    def project(self, tank: Array, turn: Array | None = None) -> tuple[Array, Array, Array]:
        """Pixels (k, 2), slopes by CAMERA's numbers (k, 2, 16) and by the tank point (k, 2, 3)."""
        turned = tank @ self.rotation.T
        if turn is not None and turn.any():
            turned = Rotation.from_rotvec(turn).apply(turned + self.translation) - self.translation
        seen = turned + self.translation
        ahead = np.where(seen[:, 2] > 1e-6, seen[:, 2], np.nan)
        ideal = seen[:, :2] / ahead[:, None]
        pixel, per_ideal, per_lens = self.lens.slopes(ideal)
        if self.skew:
            share = self.skew / self.lens.fy_px
            pixel[:, 0] += share * (pixel[:, 1] - self.lens.cy_px)
            per_ideal[:, 0] += share * per_ideal[:, 1]
        per_seen = np.zeros((len(tank), 2, 3))
        per_seen[:, 0, 0] = per_seen[:, 1, 1] = 1.0 / ahead
        per_seen[:, :, 2] = -ideal / ahead[:, None]
        per_seen = per_ideal @ per_seen
        per_camera = np.zeros((len(tank), 2, 16))
        per_camera[:, :, :9] = per_lens
        per_camera[:, 0, 9] = (pixel[:, 1] - self.lens.cy_px) / self.lens.fy_px
        x, y, z = seen.T
        zero = np.zeros_like(x)
        cross = np.stack([np.stack([zero, z, -y], -1), np.stack([-z, zero, x], -1), np.stack([y, -x, zero], -1)], -2)
        per_camera[:, :, 10:13] = per_seen @ cross
        per_camera[:, :, 13:16] = per_seen
        return pixel, per_camera, per_seen @ self.rotation
