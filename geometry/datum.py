"""The datum: points of known place in the picture -> the camera matrix and its uncertainty, also with a badly picked point.

``datum_model`` says what is fitted. A point that the others contradict is left out, by name: the one without which all is well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from ..record.errors import GeometryError, solvable
from ..record.schema import CameraTable, DatumPoint
from .camera import Array
from .datum_model import DatumModel, datum_model
from .mapping import ProjectiveMapping

REJECTED_AT = 0.01
"""The stated picking errors are not believed when the residuals' chi-square is less probable than this."""
WORSE_BY = 13.8
"""Leaving out another point instead must raise chi-square by more (1 in 1000 for two numbers), or it is not known which is bad."""
LEAST_DEGREES = 2
"""Degrees of freedom that must remain to tell that all is well without a point."""
MOST_SUBSETS = 3000
"""Sets of four points that are tried for a consensus: all of them up to 17 points; beyond, the first ones."""
CONSENSUS_SIGMAS = 4.0
"""A point agrees with a set of four within this many of its picking errors: a choice, wide enough for errors of the
four."""
RANK_TOLERANCE = 1e-9
"""A smallest singular value below this share of the largest one is rounding: the points do not fix all parameters."""
_STEP = 1e-6
"""Of the central differences along the covariance's root, in standard deviations."""


@dataclass(frozen=True)
class DatumFit:
    """The camera over the datum.

    Attributes
    ----------
    mapping : pixel <-> tank
    residual_px : (n, 2), picked minus projected, of every point
    residual_m : (n, 2), where the pick says the point is, minus tank_m
    sigma_px : (n,), stated picking errors
    chi_square, degrees : of the weighted residuals of the points used
    excluded : points left out, by their place in the list
    notes : assumptions and warnings, for the user
    shares : what the mapping's modes come from, (k, k) each, together the unit matrix: "picks", "places" of the points themselves,
        "lens" (what was known of it beforehand)
    widened : the picking errors were not believed: the modes are so many times what was stated
    """

    mapping: ProjectiveMapping
    residual_px: Array
    residual_m: Array
    sigma_px: Array
    chi_square: float
    degrees: int
    excluded: tuple[int, ...]
    notes: tuple[str, ...]
    shares: dict[str, Array] = field(default_factory=dict)
    widened: float = 1.0

    @property
    def rms_px(self) -> float:
        """Root mean square of the used points' residuals per coordinate."""
        used = np.delete(self.residual_px, self.excluded, axis=0)
        return float(np.sqrt(np.mean(used**2)))


@dataclass(frozen=True)
class _Picks:
    """The datum points as arrays."""

    tank: Array
    pixel: Array
    sigma: Array
    place_sd: Array

    def without(self, out: Sequence[int]) -> _Picks:
        return _Picks(*(np.delete(a, out, axis=0) for a in (self.tank, self.pixel, self.sigma, self.place_sd)))


@dataclass(frozen=True)
class _Solved:
    """A model fitted to picks."""

    theta: Array
    covariance: Array
    chi_square: float
    degrees: int
    whitened: Array
    parts: dict[str, Array]


@solvable(GeometryError, "the datum does not fix the camera")
def fit_datum(
    points: Sequence[DatumPoint],
    camera: CameraTable | None,
    marker_depths_m: Sequence[float],
    image_size_px: tuple[int, int] | None = None,
    lens_covariance: Array | None = None,
    robust: bool = True,
) -> DatumFit:
    """Fit the camera to its datum points: linear start, then Levenberg-Marquardt through the lens.

    Parameters
    ----------
    points : at least 4, checked by ``record.schema.check_datum``
    camera : the lens, or None
    marker_depths_m : depths at which places will be asked for; they decide which model is needed
    image_size_px : width, height; needed for ``square_pixels``
    lens_covariance : (9, 9) of ``Lens.vector``; None: the lens is exact
    robust : leave out points that the others contradict

    Raises
    ------
    GeometryError : the points do not fix the camera
    """
    picks = _Picks(
        np.array([p.tank_m for p in points], dtype=float),
        np.array([p.pixel_px for p in points], dtype=float),
        np.array([p.sigma_px for p in points], dtype=float),
        np.array([p.tank_sd_m for p in points], dtype=float),
    )
    names = [p.name or f"point {i + 1}" for i, p in enumerate(points)]

    def model_of(some: _Picks) -> DatumModel:
        return datum_model(some.tank, some.pixel, camera, marker_depths_m, image_size_px, lens_covariance)

    model = model_of(picks)
    solved = _solve(model, picks)
    excluded: tuple[int, ...] = ()
    notes = list(model.notes)
    if robust and _rejected(solved):
        found = _without_bad_points(model_of, picks, solved)
        if found is not None:
            excluded, model, solved = found
    return _finish(model, solved, picks, excluded, names, notes)


def _solve(model: DatumModel, picks: _Picks) -> _Solved:
    """Levenberg-Marquardt from the model's start; the scale of a gauge is held."""
    homogeneous = np.column_stack([picks.tank, np.ones(len(picks.tank))])
    scale = np.maximum(np.abs(model.start), 1e-3 * np.abs(model.start).max())
    whiten = _whitening(model, picks)

    def whitened(scaled: Array) -> Array:
        theta = scaled * scale
        seen = homogeneous @ model.matrix(theta).T
        gap = picks.pixel - model.lens(theta).distort(seen[:, :2] / seen[:, 2:])
        return np.einsum("nij,nj->ni", whiten, gap)

    def cost(scaled: Array) -> Array:
        fixed = [np.linalg.norm(scaled) - np.linalg.norm(model.start / scale)] if model.gauge else []
        return np.concatenate([whitened(scaled).ravel(), model.prior(scaled * scale), fixed])

    answer = least_squares(cost, model.start / scale, method="lm", jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    values = np.linalg.svd(answer.jac, compute_uv=False)
    if not np.isfinite(values).all() or values[-1] < RANK_TOLERANCE * values[0]:
        raise GeometryError(
            f"datum: the {len(picks.tank)} points do not fix the camera ({model.method}): "
            "three of four on a line, or too few"
        )
    inverse = np.linalg.inv(answer.jac.T @ answer.jac)
    gap = whitened(answer.x)
    known = model.prior(model.start)
    chi_square = float((gap**2).sum() + (model.prior(answer.x * scale) ** 2).sum())
    degrees = 2 * len(picks.tank) + len(known) - (len(model.start) - model.gauge)
    parts = _parts(answer.jac, inverse, _pick_share(whiten, picks), len(known))
    both = np.outer(scale, scale)
    return _Solved(
        answer.x * scale, inverse * both, chi_square, degrees, gap, {name: part * both for name, part in parts.items()}
    )


def _pick_share(whiten: Array, picks: _Picks) -> Array:
    """(n, 2, 2): the picking errors' share in the whitened residuals' unit covariance; the rest is the points' own places'."""
    if not picks.place_sd.any():
        return np.tile(np.eye(2), (len(picks.sigma), 1, 1))
    return np.einsum("nij,nkj->nik", whiten, whiten) * picks.sigma[:, None, None] ** 2


def _parts(slope: Array, inverse: Array, pick_share: Array, known: int) -> dict[str, Array]:
    """What the covariance of the parameters is made of; a gauge, which moves nothing that is seen, goes with the picks."""
    n = len(pick_share)
    gain = inverse @ slope.T
    seen = gain[:, : 2 * n].reshape(-1, n, 2)
    places = np.einsum("ani,nij,bnj->ab", seen, np.eye(2) - pick_share, seen)
    lens = gain[:, 2 * n : 2 * n + known]
    found = {"picks": inverse - places - lens @ lens.T}
    if (pick_share != np.eye(2)).any():
        found["places"] = places
    if known:
        found["lens"] = lens @ lens.T
    return found


def _whitening(model: DatumModel, picks: _Picks) -> Array:
    """(n, 2, 2): picking errors, and errors of the points' own places as the picture shows them."""
    covariance = picks.sigma[:, None, None] ** 2 * np.eye(2)
    if picks.place_sd.any():
        step = 1e-4
        lens, matrix = model.lens(model.start), model.matrix(model.start)

        def project(tank: Array) -> Array:
            seen = np.column_stack([tank, np.ones(len(tank))]) @ matrix.T
            return lens.distort(seen[:, :2] / seen[:, 2:])

        slope = np.stack(
            [(project(picks.tank + e) - project(picks.tank - e)) / (2 * step) for e in step * np.eye(3)], 2
        )
        slope = slope * picks.place_sd[:, None, None]
        covariance = covariance + slope @ slope.transpose(0, 2, 1)
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _rejected(solved: _Solved) -> bool:
    return solved.degrees > 0 and bool(chdtrc(solved.degrees, solved.chi_square) < REJECTED_AT)


def _without_bad_points(model_of, picks: _Picks, solved: _Solved):
    """The points to leave out, with the fit of the rest; None where it cannot be told which are bad."""
    most = (solved.degrees - LEAST_DEGREES) // 2
    if most < 1:
        return None
    ways: list[tuple[float, tuple[int, ...], DatumModel, _Solved]] = []
    for out in [(i,) for i in range(len(picks.tank))]:
        way = _left_out(model_of, picks, out)
        if way is not None:
            ways.append((way[1].chi_square, out, *way))
    ways.sort(key=lambda way: way[0])
    if ways and not _rejected(ways[0][3]):
        told = len(ways) == 1 or ways[1][0] - ways[0][0] > WORSE_BY
        return ways[0][1:] if told else None
    out = _consensus_misses(picks)
    if not 1 < len(out) <= most:
        return None
    way = _left_out(model_of, picks, out)
    return (out, *way) if way is not None and not _rejected(way[1]) else None


def _left_out(model_of, picks: _Picks, out: tuple[int, ...]) -> tuple[DatumModel, _Solved] | None:
    rest = picks.without(out)
    try:
        model = model_of(rest)
        return model, _solve(model, rest)
    except (GeometryError, np.linalg.LinAlgError):
        return None


def _consensus_misses(picks: _Picks) -> tuple[int, ...]:
    """Points of the plane with most points that the largest consensus of four leaves aside (RANSAC over all fours).

    scikit-image's projective transform, without a lens: the tolerance holds its largest bend, as the best four themselves show it.
    """
    from skimage.transform import ProjectiveTransform

    depths, count = np.unique(picks.tank[:, 2], return_counts=True)
    plane = np.flatnonzero(picks.tank[:, 2] == depths[np.argmax(count)])
    if len(plane) < 6:
        return ()
    source, target = picks.tank[plane, :2], picks.pixel[plane]
    best: tuple[int, float, Array] | None = None
    for index, four in enumerate(combinations(range(len(plane)), 4)):
        if index >= MOST_SUBSETS:
            break
        transform = ProjectiveTransform.from_estimate(source[list(four)], target[list(four)])
        if not transform:
            continue
        apart = np.linalg.norm(transform(source) - target, axis=1) / picks.sigma[plane]
        near = apart < CONSENSUS_SIGMAS
        key = (int(near.sum()), -float((apart[near] ** 2).sum()))
        if best is None or key > best[:2]:
            best = (*key, near)
    return () if best is None else tuple(int(i) for i in plane[~best[2]])


def _finish(
    model: DatumModel,
    solved: _Solved,
    picks: _Picks,
    excluded: tuple[int, ...],
    names: Sequence[str],
    notes: list[str],
) -> DatumFit:
    widen = 1.0
    theta = solved.theta
    if _rejected(solved):
        widen = np.sqrt(solved.chi_square / solved.degrees)
    root = np.linalg.cholesky(solved.covariance)
    back = np.linalg.inv(root)
    shares = {name: back @ part @ back.T for name, part in solved.parts.items()}
    root = root * widen
    ends = [(theta + _STEP * column, theta - _STEP * column) for column in root.T]
    modes = np.array([model.matrix(a) - model.matrix(b) for a, b in ends]) / (2 * _STEP)
    lens_modes = np.array([model.lens(a).vector - model.lens(b).vector for a, b in ends]) / (2 * _STEP)
    lens = model.lens(theta)
    mapping = ProjectiveMapping(
        model.method, lens, model.matrix(theta), modes, lens_modes if lens_modes.any() else np.zeros((0, 9))
    )
    residual = picks.pixel - mapping.to_pixel(picks.tank)
    stands = np.array([_stands(mapping, p, z) for p, z in zip(picks.pixel, picks.tank[:, 2], strict=True)])
    apart = stands - picks.tank[:, :2]

    def size(i: int) -> str:
        return f"{np.linalg.norm(residual[i]):.2f} px ({1e3 * np.linalg.norm(apart[i]):.1f} mm)"

    if widen > 1.0:
        used = np.delete(np.arange(len(names)), excluded)
        worst = int(used[np.argmax((solved.whitened**2).sum(axis=1))])
        notes.append(
            f"the datum does not fit its stated picking errors (chi-square {solved.chi_square:.1f} of {solved.degrees}): "
            f"largest at {names[worst]}, {size(worst)}; the camera's uncertainty is widened {widen:.1f} times"
        )
    elif solved.degrees == 0:
        notes.append("the datum has no point to spare: its picks cannot be checked; a fifth point would")
    for i in excluded:
        notes.append(
            f"datum point {names[i]} is left out: it lies {size(i)} from where all the others put it; pick it again, or check "
            "its tank_m"
        )
    return DatumFit(
        mapping, residual, apart, picks.sigma, solved.chi_square, solved.degrees, excluded, tuple(notes), shares,
        float(widen),
    )  # fmt: skip


def _stands(mapping: ProjectiveMapping, pixel: Array, depth_m: float) -> Array:
    try:
        return mapping.to_tank(pixel[None], depth_m).xy_m[0]
    except GeometryError:
        return np.full(2, np.nan)
