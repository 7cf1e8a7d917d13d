"""A template and where it lies in a frame: Gauss-Newton of place, linear shape, gain and offset.

The template (a cubic spline) is carried onto the frame's own pixels, not the frame onto the template: the pixels' noise
stays white, nothing is blurred, and the fit reaches the Cramer-Rao bound. OpenCV's findTransformECC carries the frame
onto the template; docs/bare_hull.md compares both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

PAD_PX = 5
"""The template is kept this far beyond the patch, so that its spline and a patch that has grown stay inside."""
FINE = 4
"""Nodes of the looked-up table per pixel: with its slope, the nearest node is exact to a few hundredths of a level."""
SOFT_PX = 2.0
"""The patch's weight falls to 0 over this width at its rim, so that pixels come and go smoothly."""
STEPS = 14
SETTLED_PX, NEARLY_SETTLED_PX = 2e-3, 0.05
"""A fit ends after a step below the first; after the last step the second will do."""
LONGEST_STEP_PX = 1.0
FARTHEST_PX = 4.0
"""A fit that leaves its start by more is another place's."""
LEAST_INSIDE = 1 / 3
LARGEST_GROWTH = 1.8
SOLID_WEIGHT = 0.5
MAD_TO_SD = 1.4826
INLIER_SD, OUTLIER_SD = 3.0, 6.0
"""A pixel counts in full up to the first residual and not at all beyond the second."""
SLOPE_ERROR_PX = 0.1
"""Where the picture is steep, sampling and compression leave residuals of this times the slope, without being outliers."""
LEAST_SCALE_DN = 0.3
"""Rounding to whole levels alone scatters by this."""
CLIP_SD = 2.0
"""Pixels predicted this near to the sensor's limit are left out (chosen by the prediction: choosing by the data biases)."""
SLOPE_NOISE = 2.14
"""Variance of a cubic spline's slope through unit white noise at its nodes, 1/px2 (mean over the cell, Monte Carlo)."""
TRUSTED_SD = 5.0
"""A direction whose gradient energy exceeds what noise alone would give by fewer standard deviations tells nothing."""
LEAST_SHARE = 0.04
"""... as does one with less than this share of the other direction's energy: a sampled edge has steps that feign texture."""
CLEAR_RATIO = 40.0
PIECE_PX = 6
NEAR_PX = 4
"""Residuals count as related over this many pixels (triangle)."""
TURN_SD, SIZE_SD, SHEAR_SD = 0.03, 0.004, 0.0015
"""Rotation, scale and shear change by about this from frame to frame at most."""
_PARAMETERS = 8
_TURN = 0.5 * np.array([[0, 0, 0, 0], [0, 1, -1, 0], [0, -1, 1, 0], [0, 0, 0, 0.0]])
_SIZE = 0.5 * np.array([[1, 0, 0, 1], [0, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 1.0]])
_SHEAR = np.eye(4) - _TURN - _SIZE
"""Projectors of a 2 x 2 matrix's entries on rotation, scale and shear (a rotation by e has two entries of e, and so on)."""
_DIAGONAL = np.arange(_PARAMETERS)


@dataclass(frozen=True)
class Pose:
    """Where a patch lies: x = centre + shape @ xi, brightness gain * T(xi) + offset.

    Attributes
    ----------
    centre_px : (2,), of the picked point
    shape : (2, 2), rotation, scale and shear
    gain, offset_dn : against the template
    """

    centre_px: Array
    shape: Array
    gain: float = 1.0
    offset_dn: float = 0.0


@dataclass(frozen=True)
class Patch:
    """A template.

    Attributes
    ----------
    mean_dn : (n, n), at nodes one pixel apart
    trust : (n, n), 0 .. 1, how much of a pixel's scatter is plain noise (background behind an edge: near 0)
    origin_px : (2,), place of the first node seen from the picked point
    radius_px : of the round patch
    noise_dn : standard deviation of one node's mean
    slope_noise : variance of the slopes from that noise, DN2/px2
    table : (m, m, 4), mean, its slopes along u and v, and the weight, FINE nodes a pixel
    blind : (2,), unit direction along which the patch tells nothing (a straight edge); zeros where there is none
    clear : its gradients are CLEAR_RATIO times those of its own noise along both axes
    """

    mean_dn: Array
    trust: Array
    origin_px: Array
    radius_px: int
    noise_dn: float
    slope_noise: float
    table: Array
    blind: Array
    clear: bool

    def seen_from(self, xi: Array) -> Patch:
        """The same template, ``xi (2,)`` its new picked point."""
        return make_patch(self.mean_dn, self.trust, self.origin_px - xi, self.radius_px, self.noise_dn, self.slope_noise)

    def with_trust(self, trust: Array) -> Patch:
        """The same template, its pixels weighed anew."""
        table = self.table.copy()
        table[:, :, 3] = _weights(trust, self.origin_px, self.radius_px)
        blind, clear = _told(table, self.slope_noise)
        return replace(self, trust=trust, table=table, blind=blind, clear=clear)


@dataclass(frozen=True)
class Registration:
    """A fitted patch.

    Attributes
    ----------
    pose : fitted
    covariance_px2 : (2, 2) of the centre, residuals taken as independent
    correlation : of the pixels that fit
    inlier_share : share of the patch that fits, half by area, half by gradient
    visible_share : share of the patch's weight inside the picture
    noise_dn : root mean square residual of the pixels that fit
    spread : (2, 2), the centre's variance from the residuals as they are related over pixels, and as if independent
        (columns), u and v (rows); their ratio, pooled over frames, widens the covariance; ones where not asked for
    pieces : (2,), the centre's variance where pieces of PIECE_PX of the picture scatter in place by 1 px; ones likewise
    """

    pose: Pose
    covariance_px2: Array
    correlation: float
    inlier_share: float
    visible_share: float
    noise_dn: float
    spread: Array
    pieces: Array


def make_patch(
    mean_dn: Array, trust: Array, origin_px: Array, radius_px: int, noise_dn: float, slope_noise: float | None = None
) -> Patch:
    """Build a template and its table from node values ``(n, n)``; without ``slope_noise`` their noise is white."""
    from scipy.ndimage import spline_filter

    value, slope = _splines(len(mean_dn))
    nodes = spline_filter(mean_dn, order=3, mode="mirror")
    # einsum on purpose: at this size BLAS would wake all cores, which costs more than the product
    across = [np.einsum("ij,kj->ik", nodes, along) for along in (value, slope, value)]
    channels = [np.einsum("ij,jk->ik", down, part) for down, part in zip((value, value, slope), across, strict=True)]
    table = np.stack([*channels, _weights(trust, origin_px, radius_px)], axis=2)
    slope_noise = max(SLOPE_NOISE * noise_dn**2 if slope_noise is None else slope_noise, 1e-6)
    return Patch(mean_dn, trust, origin_px, radius_px, noise_dn, slope_noise, table, *_told(table, slope_noise))


@lru_cache(maxsize=8)
def _splines(n: int) -> tuple[Array, Array]:
    """Cubic B-splines of ``n`` nodes and their slopes at the fine nodes, mirrored at the ends: ((n-1) FINE + 1, n) each."""
    place = np.arange((n - 1) * FINE + 1) / FINE
    value, slope = np.zeros((len(place), n)), np.zeros((len(place), n))
    for node in range(-2, n + 2):
        x = place - node
        a = np.abs(x)
        at = abs(node) if node < n else 2 * (n - 1) - node
        value[:, at] += np.where(a < 1, 2 / 3 - a**2 + a**3 / 2, np.maximum(2 - a, 0.0) ** 3 / 6)
        slope[:, at] += np.where(a < 1, -2 * x + 1.5 * x * a, -np.sign(x) * np.maximum(2 - a, 0.0) ** 2 / 2)
    return value, slope


def _weights(trust: Array, origin_px: Array, radius_px: int) -> Array:
    """Soft round rim times ``trust``, at the fine nodes."""
    fine = np.arange((len(trust) - 1) * FINE + 1) / FINE
    apart = np.hypot(fine[None, :] + origin_px[0], fine[:, None] + origin_px[1])
    return np.clip((radius_px + 0.5 * SOFT_PX - apart) / SOFT_PX, 0.0, 1.0) * _finer(_finer(trust).T).T


def _finer(rows: Array) -> Array:
    """Rows (n, k) at FINE steps, linearly: ((n-1) FINE + 1, k)."""
    step = (np.arange(FINE) / FINE)[None, :, None]
    between = rows[:-1, None] + step * (rows[1:] - rows[:-1])[:, None]
    return np.concatenate([between.reshape(-1, rows.shape[1]), rows[-1:]])


def slope_energy(table: Array, slope_noise: float) -> tuple[Array, Array, float]:
    """Gradient energy of a patch along its two axes over what noise alone would give.

    Returns
    -------
    ratios : (2,), rising
    axes : (2, 2), columns
    trusted : least ratio that noise alone does not reach (its slopes are related over about two pixels)
    """
    along_u, along_v, weight = table[:, :, 1], table[:, :, 2], table[:, :, 3]
    weighted = along_u * weight
    off = float((weighted * along_v).sum())
    tensor = np.array([[(weighted * along_u).sum(), off], [off, (along_v**2 * weight).sum()]])
    total = max(float(weight.sum()), 1e-9)
    ratios, axes = np.linalg.eigh(tensor / total / slope_noise)
    return ratios, axes, _trusted(total / FINE**2)


def _trusted(pixels: float) -> float:
    return 1.0 + TRUSTED_SD * 2.0 / float(np.sqrt(max(pixels, 1.0)))


def _told(table: Array, slope_noise: float) -> tuple[Array, bool]:
    """``Patch.blind`` and ``Patch.clear``."""
    ratios, axes, trusted = slope_energy(table, slope_noise)
    return axes[:, 0] * (ratios[0] < max(trusted, LEAST_SHARE * ratios[1])), bool(ratios[0] > CLEAR_RATIO)


def look_up(patch: Patch, xi: Array) -> Array:
    """Template, its slopes along u and v, and its weight at ``xi (2, m)``: (4, m)."""
    size = patch.table.shape[0]
    fine = (xi - patch.origin_px[:, None]) * FINE
    node = np.rint(fine)
    fine -= node
    column, row = np.clip(node, 0, size - 1, out=node)
    index = (row * size + column).astype(np.intp)
    found = np.ascontiguousarray(patch.table.reshape(-1, 4).take(index, axis=0).T)
    fine *= found[1:3]
    fine *= 1.0 / FINE
    found[0] += fine[0]
    found[0] += fine[1]
    return found


def inverse(shape: Array) -> Array:
    """Inverse of a (2, 2); numpy's own spends most of its time on getting started."""
    (a, b), (c, d) = shape.tolist()
    scale = 1.0 / (a * d - b * c)
    return np.array([[d * scale, -b * scale], [-c * scale, a * scale]])


def determinant(shape: Array) -> float:
    """Determinant of a (2, 2)."""
    (a, b), (c, d) = shape.tolist()
    return a * d - b * c


def axes_of(shape: Array) -> tuple[float, float]:
    """Singular values of a (2, 2), larger first."""
    total, area = float((shape**2).sum()), abs(determinant(shape))
    root = np.sqrt(max(total**2 - 4 * area**2, 0.0))
    large = float(np.sqrt((total + root) / 2))
    return large, area / max(large, 1e-12)


@lru_cache(maxsize=32)
def _disc(radius: int) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Pixels (2, m) of a disc about 0, u then v, as floats and as integers."""
    axis = np.arange(-radius, radius + 1)
    v, u = np.meshgrid(axis, axis, indexing="ij")
    inside = u**2 + v**2 <= radius**2
    whole = np.stack([u[inside], v[inside]])
    return whole.astype(float), whole


def _median(values: Array) -> float:
    """The upper median; np.median asks more questions than the sorting takes."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


@dataclass(frozen=True)
class _Cut:
    """The frame's pixels under a patch: places (2, m) from the corner, values (m,), weight share inside the picture."""

    place: Array
    data: Array
    corner: NDArray[np.intp]
    visible: float


def _cut(luma: Array, patch: Patch, start: Pose) -> _Cut | None:
    height, width = luma.shape
    grown = min(axes_of(start.shape)[0], LARGEST_GROWTH)
    disc, whole = _disc(int(np.ceil((patch.radius_px + 0.5 * SOFT_PX) * grown + 0.5)))
    corner = np.rint(start.centre_px).astype(np.intp)
    u, v = whole + corner[:, None]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    if inside.all():
        return _Cut(disc, luma[v, u].astype(float), corner, 1.0)
    if inside.mean() < LEAST_INSIDE:
        return None
    weight = look_up(patch, inverse(start.shape) @ (disc - (start.centre_px - corner)[:, None]))[3]
    visible = float(weight[inside].sum() / max(weight.sum(), 1e-9))
    return _Cut(disc[:, inside], luma[v[inside], u[inside]].astype(float), corner, visible)


@dataclass(frozen=True)
class _Linear:
    """The model about a pose: Jacobian and, below it, the residual (9, m), weights before and after regard to it (m,), their
    scale, the template and its squared slope (m,)."""

    whole: Array
    weight: Array
    used: Array
    scale_dn: float
    template: Array
    steep: Array

    @property
    def jacobian(self) -> Array:
        return self.whole[:_PARAMETERS]

    @property
    def residual(self) -> Array:
        return self.whole[_PARAMETERS]


def _linearise(patch: Patch, cut: _Cut, pose: Pose, white_dn: float, scale_dn: float) -> _Linear | None:
    """Unknowns: centre, the entries of E radius_px in shape (1 + E), gain, offset."""
    turn = inverse(pose.shape)
    xi = turn @ (cut.place - (pose.centre_px - cut.corner)[:, None])
    template, slope_u, slope_v, weight = look_up(patch, xi)
    model = pose.gain * template + pose.offset_dn
    weight *= (model < white_dn - CLIP_SD * scale_dn) & (model > 0.5 * scale_dn)
    solid = weight > SOLID_WEIGHT
    if np.count_nonzero(solid) < 3 * _PARAMETERS:
        return None
    residual = cut.data - model
    scale = max(MAD_TO_SD * _median(np.abs(residual[solid])), LEAST_SCALE_DN)
    slope_u *= -pose.gain
    slope_v *= -pose.gain
    steep = slope_u**2 + slope_v**2
    sizes = np.abs(residual) / np.sqrt(scale**2 + SLOPE_ERROR_PX**2 * steep)
    used = weight * np.clip((OUTLIER_SD - sizes) / (OUTLIER_SD - INLIER_SD), 0.0, 1.0)
    jacobian = np.empty((_PARAMETERS + 1, len(residual)))
    jacobian[0] = turn[0, 0] * slope_u + turn[1, 0] * slope_v
    jacobian[1] = turn[0, 1] * slope_u + turn[1, 1] * slope_v
    xi *= 1.0 / patch.radius_px
    np.multiply(slope_u, xi, out=jacobian[2:4])
    np.multiply(slope_v, xi, out=jacobian[4:6])
    jacobian[6], jacobian[7], jacobian[8] = template, 1.0, residual
    return _Linear(jacobian, weight, used, scale, template, steep)


def register(
    luma: Array,
    patch: Patch,
    start: Pose,
    shape_sd: tuple[float, float, float] = (TURN_SD, SIZE_SD, SHEAR_SD),
    white_dn: float = 255.0,
    related: bool = False,
    as_one: float = 1.0,
) -> Registration | None:
    """Fit ``patch`` to ``luma (h, w)`` from ``start`` (to a pixel or so; its brightness is not used).

    Parameters
    ----------
    shape_sd : prior standard deviations of rotation, scale and shear against start's; they hold what a poor texture does
        not show
    white_dn : the sensor's upper limit
    related : also work out ``spread`` and ``pieces``
    as_one : so many pixels' residuals vary as one; the prior weighs by that much more

    Returns
    -------
    None where less than LEAST_INSIDE of the patch lies in the picture, nothing is left to fit, or the fit runs away
    """
    cut = _cut(luma, patch, start)
    if cut is None:
        return None
    pose = _with_first_brightness(patch, cut, start)
    scale, settled = 1.0, False
    back = inverse(start.shape)
    firm = sum(part / (2 * sd**2) for part, sd in zip((_TURN, _SIZE, _SHEAR), shape_sd, strict=True))
    for number in range(STEPS):
        linear = _linearise(patch, cut, pose, white_dn, scale)
        if linear is None:
            return None
        scale = linear.scale_dn
        weighted = linear.jacobian * linear.used
        both = weighted @ linear.whole.T
        normal, right = both[:, :_PARAMETERS], both[:, _PARAMETERS]
        prior = as_one * (scale / patch.radius_px) ** 2 * firm
        normal[2:6, 2:6] += prior
        right[2:6] -= patch.radius_px * prior @ (back @ pose.shape - np.eye(2)).ravel()
        normal[_DIAGONAL, _DIAGONAL] = normal[_DIAGONAL, _DIAGONAL] * (1.0 + 1e-9) + 1e-9
        if settled:
            return _answer(patch, cut, pose, linear, weighted, normal, related)
        step = np.linalg.solve(normal, right)
        pose, length = _moved(patch, pose, step)
        if not (np.hypot(*(pose.centre_px - start.centre_px)) < FARTHEST_PX and determinant(pose.shape) > 0.1):
            return None
        settled = length < (SETTLED_PX if number < STEPS - 2 else NEARLY_SETTLED_PX)
    return None


def matching_share(luma: Array, patch: Patch, pose: Pose, noise_dn: float, white_dn: float = 255.0) -> float:
    """Share of the patch's weight whose pixels agree with ``pose`` (brightness too) within INLIER_SD of ``noise_dn``."""
    cut = _cut(luma, patch, pose)
    linear = None if cut is None else _linearise(patch, cut, pose, white_dn, noise_dn)
    if linear is None:
        return 0.0
    allowed = noise_dn**2 + SLOPE_ERROR_PX**2 * linear.steep
    return _told_share(replace(linear, used=linear.weight * (linear.residual**2 < INLIER_SD**2 * allowed)))


def _moved(patch: Patch, pose: Pose, step: Array) -> tuple[Pose, float]:
    """The pose after a step, not along the blind direction, and the step's length in px."""
    away = step[:2] - pose.shape @ patch.blind * float(patch.blind @ inverse(pose.shape) @ step[:2])
    length = float(np.hypot(*away))
    short = min(1.0, LONGEST_STEP_PX / max(length, 1e-12))
    shape = pose.shape @ (np.eye(2) + short / patch.radius_px * step[2:6].reshape(2, 2))
    return Pose(pose.centre_px + short * away, shape, pose.gain + step[6], pose.offset_dn + step[7]), length


def _with_first_brightness(patch: Patch, cut: _Cut, start: Pose) -> Pose:
    """Gain and offset of a straight line through the pixels at the start."""
    xi = inverse(start.shape) @ (cut.place - (start.centre_px - cut.corner)[:, None])
    template, _, _, weight = look_up(patch, xi)
    total = max(float(weight.sum()), 1e-9)
    middle, level = weight @ template / total, weight @ cut.data / total
    energy = weight @ (template - middle) ** 2
    gain = float(np.clip(weight @ ((template - middle) * (cut.data - level)) / max(energy, 1e-9), 0.3, 3.0))
    return Pose(start.centre_px, start.shape, gain, float(level - gain * middle))


def _answer(
    patch: Patch, cut: _Cut, pose: Pose, linear: _Linear, weighted: Array, normal: Array, related: bool
) -> Registration:
    used, residual = linear.used, linear.residual
    total = float(used.sum())
    noise = max(float(np.sqrt(used @ residual**2 / max(total - _PARAMETERS, 1.0))), LEAST_SCALE_DN)
    solved = np.linalg.inv(normal)
    influence = solved[:2] @ weighted
    white = noise**2 * (influence @ influence.T)
    middle, level = used @ linear.template / total, used @ cut.data / total
    one, two = linear.template - middle, cut.data - level
    correlation = float(used @ (one * two) / np.sqrt((used @ one**2) * (used @ two**2) + 1e-12))
    return Registration(
        pose,
        _without_feigned(patch, pose, white, solved, total),
        correlation,
        _told_share(linear),
        cut.visible,
        noise,
        _spread(cut, linear, influence, weighted, solved, noise) if related else np.ones((2, 2)),
        _pieces(cut, linear, influence) if related else np.ones(2),
    )


def _told_share(linear: _Linear) -> float:
    """Share of the pixels that fit, half by area, half by what they tell (a small mark on plain ground is few pixels)."""
    told = 0.5 / max(float(linear.weight.sum()), 1e-9)
    told = told + 0.5 * linear.steep / max(float(linear.weight @ linear.steep), 1e-9)
    return float(linear.used @ told)


def _without_feigned(patch: Patch, pose: Pose, white: Array, solved: Array, total: float) -> Array:
    """Covariance (2, 2) of the centre, where the template's own noise feigns a gradient along an edge.

    The information S about the centre is compared with that of a patch of noise alone, N. Errors in variables: the score
    keeps its noise, the true slope is smaller, so the variance is white (S / (S - N))^2; of S near N nothing is known: the
    patch's radius then stands for the standard deviation, as along its blind direction.
    """
    if patch.clear:
        return white
    along = pose.shape @ patch.blind
    length = float(np.hypot(*along))
    if length > 0:
        across = np.eye(2) - np.outer(along, along) / length**2
        return across @ white @ across + (patch.radius_px / length) ** 2 * np.outer(along, along)
    turn = inverse(pose.shape)
    feigned = pose.gain**2 * patch.slope_noise * total * (turn.T @ turn)
    root = np.linalg.cholesky(feigned + 1e-12 * np.eye(2))
    back = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(back @ np.linalg.inv(solved[:2, :2]) @ back.T)
    growth = ratio / np.where(ratio > _trusted(total), ratio - 1.0, 1e-3)
    mixing = back.T @ (axes * growth) @ axes.T @ root.T
    values, vectors = np.linalg.eigh(mixing @ white @ mixing.T)
    return (vectors * np.clip(values, 0.0, patch.radius_px**2)) @ vectors.T


def _spread(
    cut: _Cut, linear: _Linear, influence: Array, weighted: Array, solved: Array, noise_dn: float
) -> Array:
    """Variance (2,) of the centre by sums over pairs of near residuals, beside what white noise would give: (2, 2).

    The fit takes from the residuals what it can explain, I - J (J'WJ)^-1 J'W, so that white noise leaves related residuals;
    that share is taken off the second column too.
    """
    found = np.empty((2, 2))
    for row in range(2):
        own = influence[row]
        sums = _box_sums(cut, np.vstack([own * linear.residual, own * linear.jacobian, own * weighted]))
        explained = (solved * (sums[1 : 1 + _PARAMETERS] @ sums[1 + _PARAMETERS :].T)).sum()
        found[row] = sums[0] @ sums[0], noise_dn**2 * (NEAR_PX**2 * float(own @ own) - explained)
    return found / NEAR_PX**2


def _pieces(cut: _Cut, linear: _Linear, influence: Array) -> Array:
    """Variance (2,) of the centre if every square of PIECE_PX were displaced by itself, 1 px along u and along v."""
    reach = int(np.abs(cut.place).max()) + PIECE_PX
    column, row = ((cut.place + reach) // PIECE_PX).astype(np.intp)
    cell = row * (int(column.max()) + 1) + column
    moved = [np.bincount(cell, own * slope) for own in influence for slope in linear.jacobian[:2]]
    return np.array([(moved[2 * k] ** 2).sum() + (moved[2 * k + 1] ** 2).sum() for k in (0, 1)])


def _box_sums(cut: _Cut, fields: Array) -> Array:
    """Sums of ``fields (k, m)`` over all boxes of NEAR_PX pixels: (k, b). Their products make Bartlett's triangle."""
    import cv2

    reach = int(np.abs(cut.place).max()) + NEAR_PX
    size = 2 * reach + 1
    plane = np.zeros((len(fields), size * size))
    plane[:, ((cut.place[1] + reach) * size + cut.place[0] + reach).astype(np.intp)] = fields
    box = (NEAR_PX, NEAR_PX)
    return np.stack([cv2.boxFilter(p.reshape(size, size), -1, box, normalize=False).ravel() for p in plane])
