"""What one camera says of the model's pose, on its own clock, and what another camera would have said in between."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...record.run import Run
from ..camera import Array
from ..lag import OF_A_MARK, RATE_S, mark_rate
from ..local_fit import local_fit
from ..poses import Poses

POINTS = 4
"""A pose between frames is the cubic through so many of them: two before, two after. Its error is 3/128 of the fourth difference,
of a swing of 4 s and 0.3 m filmed 30 times a second 0.0002 mm."""
FRAMES_APART = 1.5
"""Such frames follow one another within so many usual steps: over a gap nothing is put."""
LEVEL, CUBIC = 3, 3
"""Numbers of a pose that neither rolls nor heaves; degree of the curve that tells rates of one that does."""
ON_EITHER_SIDE = 0.5
"""A cubic needs frames further away than this share of RATE_S before and after: a choice."""
ENOUGH_FRAMES = 60
"""Frames from which the fourth difference is judged against its noise: a choice."""


@dataclass(frozen=True)
class View:
    """Poses of the body as one camera sees them, D numbers each (x m, y m, heading rad, then heave m, roll rad, pitch rad or none).

    Attributes
    ----------
    t_s : (n,), its own clock, rising
    pose : (n, D); NaN where it does not see the model
    covariance : (n, D, D), of a frame
    modes : (k, n, D), change with each unit-variance common mode; 0 where not seen. The last ``shared`` ones are the marks' own
        places and depths, which are the same errors in every camera's view
    slow : so many of the modes, the first ones, are pulls and lags (``Poses.lags``)
    pulls : so many of those, the first ones, are pulls by what stands beside a mark and by its place in its pixel; the others
        are the codec's
    shared : see ``modes``
    """

    t_s: Array
    pose: Array
    covariance: Array
    modes: Array
    slow: int
    pulls: int
    shared: int

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(n,) frames in which the model was seen."""
        return np.asarray(np.isfinite(self.pose).all(axis=1))

    @cached_property
    def step_s(self) -> float:
        """The usual time from frame to frame."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else float("nan")

    @cached_property
    def rates(self) -> Array:
        """(n, D) of its own frames (``rates``): every step of a clock's search asks for them."""
        return rates(self, self.t_s)

    @property
    def own(self) -> int:
        """Modes that no other camera has."""
        return len(self.modes) - self.shared


@dataclass(frozen=True)
class Between:
    """A view at times of another clock.

    Attributes
    ----------
    told : (n,) of bool, times at which it can be said
    frame, weight : (n, 4), the frames it is made of and what each counts; 0 where not told
    """

    told: NDArray[np.bool_]
    frame: NDArray[np.int_]
    weight: Array

    def of(self, values: Array) -> Array:
        """Values ``(frames, ...)`` at the times, ``(n, ...)``; of no meaning where not told."""
        parts = np.nan_to_num(values[self.frame])
        return np.einsum("nf,nf...->n...", self.weight, parts)

    def covariance(self, covariance: Array) -> Array:
        """Frames' covariances ``(frames, D, D)`` -> those of the times, (n, D, D)."""
        return np.einsum("nf,nfij->nij", self.weight**2, np.nan_to_num(covariance[self.frame]))


def view_of(run: Run, poses: Poses) -> View:
    """The planar poses of a run as one camera sees it.

    Parameters
    ----------
    run : as one camera sees it
    poses : ``poses_from_tracks``'s
    """
    seen = np.asarray(np.isfinite(poses.rigid.pose).all(axis=1))
    modes = np.where(seen[None, :, None], poses.pose_modes, 0.0)
    return View(
        poses.t_s, poses.rigid.pose, poses.rigid.covariance, modes, poses.lags, pulls_of(run, poses), shared_modes(run)
    )


def pulls_of(run: Run, poses: Poses) -> int:
    """How many of the slow modes, the first ones, are pulls and no lags of the codec.

    Parameters
    ----------
    run : its marks
    poses : whose modes
    """
    codec = OF_A_MARK * len(run.file.marker)
    return poses.lags - codec if poses.lags >= codec else poses.lags


def shared_modes(run: Run) -> int:
    """How many of a view's modes, the last ones, are the marks' own depths and places (``poses_of``'s order).

    Parameters
    ----------
    run : its marks and priors
    """
    priors, marks = run.file.priors, run.file.marker
    depths = len(marks) if priors.marker_depth_sd_m else 0
    return depths + (2 * sum(m.on == "model" for m in marks) if priors.marker_place_sd_m else 0)


def between(view: View, at_s: Array) -> Between:
    """A view at times ``at_s (n,)`` of its own clock, rising: told between two frames that have another one on either side.

    Parameters
    ----------
    view : what is asked
    at_s : times
    """
    seen = np.flatnonzero(view.seen)
    n = len(at_s)
    if len(seen) < POINTS:
        return Between(np.zeros(n, dtype=bool), np.zeros((n, POINTS), dtype=int), np.zeros((n, POINTS)))
    times = view.t_s[seen]
    first = np.clip(np.searchsorted(times, at_s, side="right") - 2, 0, len(seen) - POINTS)
    places = first[:, None] + np.arange(POINTS)
    around = times[places]
    near = np.asarray((np.diff(around, axis=1) <= FRAMES_APART * view.step_s).all(axis=1))
    told = near & (at_s >= around[:, 1]) & (at_s <= around[:, 2])
    weight = np.ones((n, POINTS))
    for k in range(POINTS):
        for j in range(POINTS):
            if j != k:
                weight[:, k] *= (at_s - around[:, j]) / (around[:, k] - around[:, j])
    return Between(told, seen[places], np.where(told[:, None], weight, 0.0))


def rates(view: View, at_s: Array) -> Array:
    """(n, D) rates of all numbers about times ``at_s (n,)`` of the view's own clock, over some 0.6 s.

    Of x, y and heading alone by ``mark_rate``. A model that rolls or heaves does so within some two seconds: its rates are those
    of a cubic through the frames within 0.3 s, at a period of 1.7 s right to a hundredth, where a chord is a fifth too low.

    Parameters
    ----------
    view : whose
    at_s : times
    """
    seen = view.seen
    found = np.zeros((len(at_s), view.pose.shape[1]))
    if not seen.any():
        return found
    t_s, pose = view.t_s[seen], view.pose[seen]
    for column in range(found.shape[1]):
        found[:, column] = mark_rate(t_s, pose[:, column], at_s)
    if view.pose.shape[1] > LEVEL:
        found = _by_cubics(t_s, pose, at_s, found)
    return found


def _by_cubics(t_s: Array, pose: Array, at_s: Array, otherwise: Array) -> Array:
    """Rates (n, D) by cubics through what was seen within RATE_S; ``otherwise`` where that is too little, or on one side only."""
    found, told = local_fit(t_s, pose, at_s, RATE_S, CUBIC)
    first, early, late, last = (
        np.searchsorted(t_s, at_s + share * RATE_S) for share in (-1, -ON_EITHER_SIDE, ON_EITHER_SIDE, 1)
    )
    return np.where((told & (early > first) & (last > late))[:, None], found[:, 1] / RATE_S, otherwise)


def rate_noise(view: View) -> float:
    """Variance of a rate, 1/s^2, over that of a frame, where all frames about it are seen.

    Parameters
    ----------
    view : whose
    """
    if view.pose.shape[1] == LEVEL or not view.step_s < RATE_S / CUBIC:
        return 2 / (2 * RATE_S) ** 2
    half = int(RATE_S / view.step_s)
    away = np.arange(-half, half + 1) * view.step_s
    powers = away[:, None] ** np.arange(CUBIC + 1)
    return float(np.linalg.inv(powers.T @ powers)[1, 1])


def between_variance(view: View) -> Array:
    """(D,) variance of the cubic's own error halfway between frames, by the fourth differences of the poses beyond their noise.

    Parameters
    ----------
    view : evenly filmed, but for gaps
    """
    steps = np.diff(view.t_s)
    fives = (
        np.lib.stride_tricks.sliding_window_view(np.arange(len(view.t_s)), 5)
        if len(view.t_s) >= 5
        else np.zeros((0, 5), int)
    )
    even = [view.seen[f].all() and (np.abs(steps[f[:4]] - view.step_s) < 0.2 * view.step_s).all() for f in fives]
    fives = fives[np.array(even, dtype=bool)] if len(fives) else fives
    if len(fives) < ENOUGH_FRAMES:
        return np.zeros(view.pose.shape[1])
    binomial = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    fourth = np.einsum("f,nfd->nd", binomial, view.pose[fives]) ** 2
    noise = np.einsum("f,nfd->nd", binomial**2, np.einsum("nfdd->nfd", view.covariance[fives]))
    beyond = (fourth - noise).mean(axis=0)
    # squares of coloured noise: of five neighbours one is worth counting
    chance = 3.0 * (fourth - noise).std(axis=0) / np.sqrt(len(fives) / 5)
    return (3 / 128) ** 2 * np.where(beyond > chance, beyond, 0.0)


__all__ = [
    "POINTS",
    "Between",
    "View",
    "between",
    "between_variance",
    "pulls_of",
    "rate_noise",
    "rates",
    "shared_modes",
    "view_of",
]
