"""The joint least squares of lens, board poses and the board's own shape, and what its normal matrix says about the lens.

Each view adds its corners' residuals; its pose is eliminated (Schur complement), so that a view is left with an information
matrix H_i and a score g_i about what all views share: the lens, and where the board's corners really are. Sums of these give the
step, the covariance, and every leave-one-out answer.

No board is flat. Its corners lie off their places by offsets that all views share, normally distributed about zero, with one
variance within the board and one across it; both variances, and that of the corners' noise, are those of the greatest marginal
likelihood (MacKay, Neural Computation 4 (1992) 415, fixed point). On a flat board they vanish and so does the shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...record.errors import GeometryError
from ..camera import Array
from .boards import BoardView
from .model import Corners, Poses, residuals, slopes

_STEPS = 60
"""Gauss-Newton steps at most, damped ones included."""
_CONVERGED = 1e-4
"""A step that moves every parameter by less than this share of its standard deviation ends the fit."""
_ROUNDING = 1e-9
"""Nor can a sum of squares be told to fall by less than this share of it."""
_SHAPE_ROUNDS, _VARIANCE_STEPS = 8, 60
"""Rounds of fit and variances, and steps of the variances within each, at most; both end earlier when nothing
changes."""
_STARTING_SHAPE = 1e-3
"""Offsets of the corners to begin with, in board sizes: a thousandth is a bent board."""
_SMALLEST_SHAPE = 1e-7
"""In board sizes: nothing that any picture could show."""
_VARIANCE_CONVERGED = 0.01
"""A change of the variances' logarithms below this ends the rounds; a tenth of it ends the steps within one."""
_TOO_WEAK = (
    "the views do not fix the lens: more of them are needed, tilted against each other and near the picture's edges"
)


@dataclass(frozen=True)
class JointFit:
    """What all views share, and the poses, at the least sum of squares.

    Attributes
    ----------
    theta : (9,), in the order of ``PARAMETERS``
    basis : (9, m), what was free: theta moves along its columns
    poses : Poses
    corners : Corners
    residual_px : (n, 2), measured minus projected, in the order of the corners
    shape_m : (k, 3), how far the board's corners are from their places; zeros where it was taken as flat
    shape_sd_m : (2,), standard deviations of these offsets within and across the board, 0 = taken as flat
    information : (v, d, d), H_i, 1/px^2 in units of the free parameters and, behind them, of the shape
    score : (v, d), g_i
    prior : (d,), the diagonal that the shape's variances add to the summed information
    variance_px2 : variance of a corner's coordinate, from the residuals less what was fitted
    """

    theta: Array
    basis: Array
    poses: Poses
    corners: Corners
    residual_px: Array
    shape_m: Array
    shape_sd_m: Array
    information: Array
    score: Array
    prior: Array
    variance_px2: float

    @property
    def total(self) -> Array:
        """H, (d, d): all views' information and the prior."""
        return self.information.sum(0) + np.diag(self.prior)

    @property
    def rms_px(self) -> Array:
        """Per view, root mean square distance of measured and projected corners (OpenCV's reprojection error)."""
        return np.sqrt(self.corners.sums((self.residual_px**2).sum(1)) / self.corners.counts)

    @property
    def covariance(self) -> Array:
        """(9, 9), if the corners' errors are independent: their variance times the lens's block of the inverse of H."""
        size = self.basis.shape[1]
        return self.basis @ np.linalg.inv(self.total)[:size, :size] @ self.basis.T * self.variance_px2

    def without(self, view: int) -> tuple[Array, Array]:
        """theta (9,) and shape (k, 3) m, had ``view`` not been there: by one Gauss-Newton step."""
        size = self.basis.shape[1]
        step = np.linalg.solve(self.total - self.information[view], self.score[view])
        shape = self.shape_m if len(step) == size else self.shape_m - step[size:].reshape(-1, 3)
        return self.theta - self.basis @ step[:size], shape


def joint_fit(views: Sequence[BoardView], theta: Array, basis: Array, poses: Poses, shaped: bool = False) -> JointFit:
    """Least squares from a start.

    Parameters
    ----------
    views : of the board
    theta : (9,) start
    basis : (9, m), what is free
    poses : of the board in each view, to start from
    shaped : the board's shape is fitted too; else it is flat and true

    Raises
    ------
    GeometryError : the views do not fix the lens, or the fit does not settle.
    """
    corners = Corners.of(views)
    shape = np.zeros((len(corners.point_ids), 3))
    prior = np.zeros(0)
    fit = _descended(corners, theta, basis, poses, shape, prior)
    if not shaped:
        return fit
    board = float(np.ptp(corners.board_m, axis=0).max())
    sd = np.full(2, _STARTING_SHAPE * board)
    variance = fit.variance_px2
    for _ in range(_SHAPE_ROUNDS):
        before = np.array([*sd**2, variance])
        fit = _descended(corners, fit.theta, basis, fit.poses, fit.shape_m, offset_weights(sd, variance, len(shape)))
        sd, variance = _variances(fit, sd, variance, _SMALLEST_SHAPE * board)
        change = np.abs(np.log(np.array([*sd**2, variance]) / before))
        gone = np.array([*(sd < 10 * _SMALLEST_SHAPE * board), False])
        if (change[~gone] < _VARIANCE_CONVERGED).all():
            break
    fit = _descended(corners, fit.theta, basis, fit.poses, fit.shape_m, offset_weights(sd, variance, len(shape)))
    return JointFit(
        fit.theta,
        basis,
        fit.poses,
        corners,
        fit.residual_px,
        fit.shape_m,
        sd,
        fit.information,
        fit.score,
        fit.prior,
        variance,
    )


def offset_weights(sd_m: Array, variance_px2: float, points: int) -> Array:
    """Weights of the corners' offsets from the board, from how far these usually are.

    Parameters
    ----------
    sd_m : (2,) standard deviations of the offsets within the board and across it
    variance_px2 : of a corner's coordinate in the picture
    points : corners of the board

    Returns
    -------
    weights : (3 points,), per corner along both sides and across, in the units of the information, px^2/m^2
    """
    return np.tile(variance_px2 / sd_m[[0, 0, 1]] ** 2, points)


def _variances(fit: JointFit, sd_m: Array, variance_px2: float, least_m: float) -> tuple[Array, float]:
    """Variances of the greatest marginal likelihood with the model held linear: of the offsets, and of a coordinate."""
    size = fit.basis.shape[1]
    data = fit.information.sum(0)
    shape = fit.shape_m.ravel()
    now = np.concatenate([np.zeros(size), shape])
    side = data @ now + fit.score.sum(0)
    squares = float((fit.residual_px**2).sum())
    fixed = 6 * len(fit.score) + size
    kind = np.tile([0, 0, 1], len(fit.shape_m))
    gap = fit.score.sum(0)
    for _ in range(_VARIANCE_STEPS):
        prior = np.concatenate([np.zeros(size), offset_weights(sd_m, variance_px2, len(fit.shape_m))])
        inverse = np.linalg.inv(data + np.diag(prior))
        moved = inverse @ side - now
        offset = (now + moved)[size:]
        known = 1 - np.diag(inverse)[size:] * prior[size:]
        told = np.array([known[kind == each].sum() for each in (0, 1)])
        found = np.array([(offset[kind == each] ** 2).sum() for each in (0, 1)])
        rest = squares - 2 * float(gap @ moved) + float(moved @ data @ moved)
        new = np.maximum(np.sqrt(found / np.maximum(told, 1e-9)), least_m)
        variance_new = rest / max(fit.residual_px.size - fixed - told.sum(), 1.0)
        change = max(abs(np.log(variance_new / variance_px2)), float(np.abs(np.log(new / sd_m)).max()))
        sd_m, variance_px2 = new, variance_new
        if change < 0.1 * _VARIANCE_CONVERGED:
            break
    return sd_m, variance_px2


def _descended(
    corners: Corners, theta: Array, basis: Array, poses: Poses, shape_m: Array, shape_prior: Array
) -> JointFit:
    """Gauss-Newton; steps that climb are damped (Levenberg-Marquardt). An empty ``shape_prior`` holds the shape."""
    size = basis.shape[1]
    prior = np.concatenate([np.zeros(size), shape_prior])
    residual = residuals(theta, poses, corners, shape_m)
    cost = _cost(residual, shape_m, shape_prior)
    damping, done = 0.0, False
    for _ in range(_STEPS):
        normal = _Normal.of(corners, theta, basis, poses, shape_m, residual, bool(len(shape_prior)))
        information, score = normal.eliminated()
        pull = np.concatenate([np.zeros(size), -shape_prior * shape_m.ravel()]) if len(prior) > size else 0.0
        total = information.sum(0) + np.diag(prior)
        scale = np.diag(total)
        if not np.isfinite(total).all() or (scale[:size] <= 0).any():
            raise GeometryError(_TOO_WEAK)
        try:
            inverse = np.linalg.inv(total + damping * np.diag(scale))
        except np.linalg.LinAlgError:
            raise GeometryError(_TOO_WEAK) from None
        free = max(residual.size - 6 * len(score) - size, 1)
        variance = max(cost, 1e-12) / free
        step = inverse @ (score.sum(0) + pull)
        small = bool((np.abs(step) < _CONVERGED * np.sqrt(np.diag(inverse) * variance)).all())
        if done or small:
            return JointFit(
                theta, basis, poses, corners, residual, shape_m, np.zeros(2), information, score, prior, variance
            )
        pose_step = normal.pose_step(step)
        trial, trial_poses = theta + basis @ step[:size], poses.moved(pose_step[:, :3], pose_step[:, 3:])
        trial_shape = shape_m + step[size:].reshape(-1, 3) if len(step) > size else shape_m
        trial_residual = residuals(trial, trial_poses, corners, trial_shape)
        trial_cost = _cost(trial_residual, trial_shape, shape_prior)
        if trial_cost <= cost * (1 + _ROUNDING):
            theta, poses, shape_m, residual, cost = trial, trial_poses, trial_shape, trial_residual, trial_cost
            damping = 0.2 * damping if damping > 1e-9 else 0.0
        elif damping > 1e6:
            break
        else:
            damping = max(10 * damping, 1e-4)
    raise GeometryError(f"the fit of the lens does not settle: {_TOO_WEAK}")


def _cost(residual: Array, shape_m: Array, shape_prior: Array) -> float:
    total = float((residual**2).sum())
    if len(shape_prior):
        total += float((shape_prior * shape_m.ravel() ** 2).sum())
    return total if np.isfinite(total) else np.inf


@dataclass(frozen=True)
class _Normal:
    """Normal equations per view: shared by shared, shared by pose, pose by pose, and the two right-hand sides."""

    shared: Array
    mixed: Array
    pose: Array
    shared_side: Array
    pose_side: Array

    @classmethod
    def of(
        cls, corners: Corners, theta: Array, basis: Array, poses: Poses, shape_m: Array, residual: Array, shaped: bool
    ) -> _Normal:
        by_lens, by_pose, by_place = slopes(theta, poses, corners, shape_m)
        by_lens = by_lens @ basis
        size = by_lens.shape[2]
        width = size + (3 * len(corners.point_ids) if shaped else 0)
        count = len(corners.start)
        shared, mixed = np.zeros((count, width, width)), np.zeros((count, width, 6))
        side = np.zeros((count, width))
        for i, (first, number) in enumerate(zip(corners.start, corners.counts, strict=True)):
            part = slice(first, first + number)
            whole = np.zeros((number, 2, width))
            whole[:, :, :size] = by_lens[part]
            if shaped:
                at = size + 3 * corners.point[part]
                row = np.arange(number)
                for axis in range(3):
                    whole[row, :, at + axis] = by_place[part][:, :, axis]
            flat = whole.reshape(-1, width)
            shared[i] = flat.T @ flat
            mixed[i] = flat.T @ by_pose[part].reshape(-1, 6)
            side[i] = flat.T @ residual[part].ravel()
        pose = corners.sums(np.einsum("nka,nkb->nab", by_pose, by_pose))
        return cls(shared, mixed, pose, side, corners.sums(np.einsum("nka,nk->na", by_pose, residual)))

    def eliminated(self) -> tuple[Array, Array]:
        """H_i (v, d, d) and g_i (v, d)."""
        across = np.linalg.solve(self.pose, np.swapaxes(self.mixed, 1, 2))
        information = self.shared - self.mixed @ across
        score = self.shared_side - np.einsum("vpa,vp->va", across, self.pose_side)
        return (information + np.swapaxes(information, 1, 2)) / 2, score

    def pose_step(self, shared_step: Array) -> Array:
        """Steps of the poses, (v, 6), that go with a step of the rest."""
        side = self.pose_side - np.einsum("vap,a->vp", self.mixed, shared_step)
        return np.linalg.solve(self.pose, side[:, :, None])[:, :, 0]


def posed(
    theta: Array, poses: Poses, corners: Corners, shape_m: Array | None = None, steps: int = 4
) -> tuple[Poses, Array]:
    """Poses and residuals (n, 2) px with the lens held; ``theta`` is (9,), or (v, 9) with a lens of its own for each view.

    Parameters
    ----------
    theta : (9,) lens, or (v, 9)
    poses : of the board in each view
    corners : of all views, in one list
    shape_m : (k, 3), how far the board's corners lie from where they should be; None: nowhere
    steps : Gauss-Newton steps
    """
    residual = residuals(theta, poses, corners, shape_m)
    for _ in range(steps):
        _, by_pose, _ = slopes(theta, poses, corners, shape_m)
        weight = corners.sums(np.einsum("nka,nkb->nab", by_pose, by_pose))
        pull = corners.sums(np.einsum("nka,nk->na", by_pose, residual))
        step = np.linalg.solve(weight, pull[:, :, None])[:, :, 0]
        poses = poses.moved(step[:, :3], step[:, 3:])
        residual = residuals(theta, poses, corners, shape_m)
    return poses, residual
