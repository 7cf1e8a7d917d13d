"""All that the recording says of its own geometry in one least-squares fit: datum picks, marks in every frame, the taut line.

A bundle adjustment whose unknowns are the camera, the heights and places of the marks, the datum's scales, the line - each with
what is known of it beforehand - and the model's pose in every frame, which is eliminated. No hydrodynamics: it rests on the two
facts that hold whatever the water does, constant marker distances and the taut-line circle (theory.md 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...record.errors import GeometryError
from ..camera import Array
from ..normal import inverse_of_normal
from .filmed import Extra, Film, Rig, half_sine
from .layout import Layout
from .rows import Rows, Setting, State, datum_rows, frame_rows

STEPS = 12
"""Gauss-Newton steps at most; a fit that has settled ends earlier."""
SETTLED = 1e-4
"""A step that changes no parameter by more than this share of its standard deviation ends the iteration."""


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
    left: tuple[Array, ...]
    slopes: tuple[Array, ...]
    project: tuple[Array, ...]
    steps: tuple[tuple[Array, Array], ...]


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
    poses: tuple[Array, ...]
    rotation: Array
    translation: Array
    normal: Normal
    log_evidence: float


@dataclass(frozen=True)
class Bundle:
    """The fit of one camera set-up over its runs.

    Attributes
    ----------
    rig : what is stated
    films : runs of this set-up
    start : per film poses (n, 3); finite
    line_sd_m : how exactly a taut line keeps its length from frame to frame
    close : the films with more of their frames, for what happens between two
    inflation : factor on the marks' and the line's variances (noise that is not independent from frame to frame)
    """

    rig: Rig
    films: tuple[Film, ...]
    start: tuple[Array, ...]
    line_sd_m: float
    close: tuple[Film, ...]
    inflation: float = 1.0

    @cached_property
    def layout(self) -> Layout:
        """Of the parameters without extras."""
        return Layout.of(len(self.rig.depth_m))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rig's parameters, in the order of every vector here."""
        return self.layout.names

    def with_inflation(self, factor: float) -> Bundle:
        """The same with another factor on the marks' variances."""
        return replace(self, inflation=factor)

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
        prior = _Prior(np.concatenate([sd, *[s for _, s in extras]]))
        layout = Layout.of(len(self.rig.depth_m), [extra for extra, _ in extras])
        if first is None:
            state = State(np.zeros(layout.size), self.rig.rotation, self.rig.translation, self.start)
        else:
            theta = np.concatenate([first.theta[: len(self.names)], np.zeros(layout.size - len(self.names))])
            state = State(theta, first.rotation, first.translation, first.poses)
        best, left = np.inf, STEPS
        while True:
            fit = _Fit.of(self._normal(state, layout), prior, state.theta)
            if fit.gain < SETTLED and fit.chi_square <= best + SETTLED:
                break
            state, best, left = _moved(state, layout, fit), min(best, fit.chi_square), left - 1
            if not left:
                break
        if not np.isfinite(state.theta).all():
            raise GeometryError(
                "the joint fit of camera and marks does not settle; the camera or the marks are far off"
            )
        return Solution(
            state.theta,
            fit.covariance,
            fit.chi_square,
            fit.normal.degrees - int(np.isinf(prior.sd).sum()),
            tuple(state.poses),
            state.rotation,
            state.translation,
            fit.normal,
            0.5 * (prior.log_volume(fit.inner) - fit.chi_square),
        )

    def linear(self, index: int, state: State, extras: Sequence[Extra] = ()) -> Rows:
        """Whitened residuals of a film's frames, with their slopes by the pose and the parameters."""
        setting = self._setting(state, Layout.of(len(self.rig.depth_m), extras))
        return frame_rows(setting, index, self.films[index], state.poses[index])

    def datum_rows(self, solution: Solution) -> tuple[Array, Array]:
        """Whitened residuals of the datum picks at a solution without extras (2k,), and their slopes (2k, p)."""
        state = State(solution.theta, solution.rotation, solution.translation, solution.poses)
        return datum_rows(self._setting(state, self.layout))

    def _setting(self, state: State, layout: Layout) -> Setting:
        return Setting.at(state, self.rig, layout, self.line_sd_m, self.inflation)

    def _normal(self, state: State, layout: Layout) -> Normal:
        """Linearise at parameters and poses and eliminate the poses."""
        setting = self._setting(state, layout)
        gap, slope = datum_rows(setting)
        films = [
            _Eliminated.of(frame_rows(setting, index, film, pose))
            for index, (film, pose) in enumerate(zip(self.films, state.poses, strict=True))
        ]
        matrix, right, chi_square = slope.T @ slope, slope.T @ gap, float(gap @ gap)
        for film in films:
            matrix = matrix + np.einsum("nip,niq->pq", film.moved, film.moved)
            right = right + np.einsum("nip,ni->p", film.moved, film.left)
            chi_square = chi_square + float((film.left**2).sum())
        return Normal(
            matrix,
            right,
            chi_square,
            len(gap) + sum(film.degrees for film in films),
            tuple(film.left for film in films),
            tuple(film.slopes for film in films),
            tuple(film.project for film in films),
            tuple(film.step for film in films),
        )


@dataclass(frozen=True)
class _Eliminated:
    """A film's rows with the poses' share taken out; fields as in ``Normal``, and ``moved`` (n, 2m+1, p), the slopes' rest."""

    left: Array
    slopes: Array
    project: Array
    moved: Array
    step: tuple[Array, Array]
    degrees: int

    @staticmethod
    def of(rows: Rows) -> _Eliminated:
        usable = rows.seen >= 3
        square = np.einsum("nia,nib->nab", rows.by_pose, rows.by_pose)
        inverse = np.linalg.inv(np.where(usable[:, None, None], square, np.eye(3))) * usable[:, None, None]
        gain = np.einsum("nab,nib->nai", inverse, rows.by_pose)
        project = np.eye(rows.residual.shape[1]) - np.einsum("nia,naj->nij", rows.by_pose, gain)
        project = project * usable[:, None, None]
        return _Eliminated(
            np.einsum("nij,nj->ni", project, rows.residual),
            rows.by_theta,
            project,
            np.einsum("nij,njp->nip", project, rows.by_theta),
            (np.einsum("nai,ni->na", gain, rows.residual), np.einsum("nai,nip->nap", gain, rows.by_theta)),
            int((rows.seen[usable] - 3).sum()),
        )


@dataclass(frozen=True)
class _Prior:
    """What is known of the parameters beforehand: ``sd`` (p,); 0 = fixed, inf = free."""

    sd: Array

    @property
    def free(self) -> NDArray[np.bool_]:
        """(p,) not fixed."""
        return self.sd > 0

    @property
    def precision(self) -> Array:
        """(p,) one over the variance; 0 where it is fixed or free."""
        return np.where(self.free, 1.0 / np.where(self.free, self.sd, 1.0) ** 2, 0.0)

    def log_volume(self, inner: Array) -> float:
        """Logarithm of the posterior's volume over the prior's, twice; ``inner`` of the parameters that are not fixed."""
        known = self.sd[self.free & np.isfinite(self.sd)]
        return -np.linalg.slogdet(inner)[1] - 2 * float(np.log(known).sum())


@dataclass(frozen=True)
class _Fit:
    """One linear step.

    Attributes
    ----------
    normal : equations it solves
    inner : their matrix with priors, of the parameters that are not fixed
    covariance : (p, p); 0 where fixed
    step : (p,)
    gain : drop of chi-square that it foresees, twice
    chi_square : before it, of residuals and priors
    """

    normal: Normal
    inner: Array
    covariance: Array
    step: Array
    gain: float
    chi_square: float

    @staticmethod
    def of(normal: Normal, prior: _Prior, theta: Array) -> _Fit:
        free, precision = np.flatnonzero(prior.free), prior.precision
        inner = normal.matrix[np.ix_(free, free)] + np.diag(precision[free])
        spread = np.eye(len(theta))[:, free]
        covariance = spread @ inverse_of_normal(inner) @ spread.T
        gradient = normal.right - precision * theta
        step = covariance @ gradient
        chi_square = normal.chi_square + float((precision * theta**2).sum())
        return _Fit(normal, inner, covariance, step, float(gradient @ step), chi_square)


def _moved(state: State, layout: Layout, fit: _Fit) -> State:
    """The state a step further; turns and shifts of the camera are composed, not added: they have no prior."""
    turn = Rotation.from_rotvec(fit.step[layout.turn]).as_matrix()
    return State(
        state.theta + fit.step,
        turn @ state.rotation,
        turn @ state.translation + fit.step[layout.shift],
        [pose + (alone - along @ fit.step) for pose, (alone, along) in zip(state.poses, fit.normal.steps, strict=True)],
    )


__all__ = ["Bundle", "Extra", "Film", "Normal", "Rig", "Solution", "State", "half_sine"]
