"""A clock's offset and drift against the reference, with what is known of them: from events, or from a motion that both saw.

t_reference = t + offset + drift (t - middle). Two records of one motion are matched by one smooth curve (cubic B-spline) fitted to
both at once, with the offset, the drift and a constant difference of the readings as unknowns: the maximum-likelihood estimate for
independent noise. Shifting a noisy record and minimising the difference is not: its noise, interpolated, pulls the offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from ..errors import EstimationError
from .channels import Array

ITERATIONS, SETTLED = 60, 1e-3
"""``SETTLED``: the fit ends with a step below this share of its sd and deviations that change by less than this share."""
ALIKE = 0.5
"""Records whose best match leaves more than this share of their variance show different things."""
AMBIGUOUS = 0.02
"""Two matches that differ by less than this share of the variance cannot be told apart (a swing of constant amplitude)."""
RIDGE = 1e-9
"""Keeps a scaled normal matrix invertible where the data leave a number open: of the size of its rounding."""


@dataclass(frozen=True)
class Clock:
    """How a clock runs.

    Attributes
    ----------
    offset_s, drift : at ``middle_s`` of its own time; drift in s/s
    middle_s : own time at which offset and drift are nearly independent
    covariance : (2, 2) of offset and drift
    """

    offset_s: float
    drift: float
    middle_s: float
    covariance: Array

    def to_reference(self, t_s: Array) -> Array:
        """Own times -> the reference's."""
        t_s = np.asarray(t_s, dtype=float)
        return t_s + self.offset_s + self.drift * (t_s - self.middle_s)

    @property
    def sd(self) -> tuple[float, float]:
        """Standard deviations of offset and drift."""
        return float(np.sqrt(self.covariance[0, 0])), float(np.sqrt(self.covariance[1, 1]))

    def time_sd(self, t_s: Array) -> Array:
        """Standard deviation of ``to_reference`` at own times, s."""
        lever = np.asarray(t_s, dtype=float) - self.middle_s
        c = self.covariance
        return np.sqrt(np.maximum(c[0, 0] + 2 * lever * c[0, 1] + lever**2 * c[1, 1], 0.0))


def clock_from_events(own_s: Array, reference_s: Array, sd_s: float, drift_sd: float) -> Clock:
    """Offset and drift from events that both clocks saw; one is enough for the offset, the drift then stays as known.

    Parameters
    ----------
    own_s, reference_s : (n,) s
    sd_s : of a difference of times
    drift_sd : prior of the drift about 0
    """
    own_s, reference_s = np.asarray(own_s, dtype=float), np.asarray(reference_s, dtype=float)
    middle = float(own_s.mean())
    design = np.stack([np.ones_like(own_s), own_s - middle], axis=1) / sd_s
    information = design.T @ design + np.diag([0.0, drift_sd**-2])
    covariance = np.linalg.inv(information)
    offset, drift = covariance @ design.T @ ((reference_s - own_s) / sd_s)
    return Clock(float(offset), float(drift), middle, covariance)


def clock_from_match(
    own: tuple[Array, Array],
    reference: tuple[Array, Array],
    *,
    search_s: tuple[float, float] = (-60.0, 60.0),
    detail_s: float = 0.5,
    drift_sd: float = 1e-4,
) -> Clock:
    """Offset and drift from two records of one thing.

    Parameters
    ----------
    own, reference : times (n,) and readings (n,) in one unit; NaN readings are left out; a constant difference is allowed
    search_s : where the offset is looked for
    detail_s : spacing of the curve's knots
    drift_sd : prior of the drift about 0

    Raises
    ------
    EstimationError : the records show different things, do not overlap, or match equally well at two offsets
    """
    t_a, a = _clean(own)
    t_b, b = _clean(reference)
    start = _coarse(t_a, a, t_b, b, search_s, detail_s)
    return _fine(t_a, a, t_b, b, start, detail_s, drift_sd)


def _clean(record: tuple[Array, Array]) -> tuple[Array, Array]:
    t_s, value = (np.asarray(part, dtype=float) for part in record)
    good = np.isfinite(value)
    return t_s[good], value[good]


def _coarse(t_a: Array, a: Array, t_b: Array, b: Array, search_s: tuple[float, float], detail_s: float) -> float:
    """The offset whose shifted record leaves least variance beside a constant."""
    step = detail_s / 4
    raster = np.arange(t_b[0], t_b[-1], step)
    target = np.interp(raster, t_b, b)
    offsets = np.arange(search_s[0], search_s[1] + step, step)
    needed = max(0.5 * min(t_a[-1] - t_a[0], t_b[-1] - t_b[0]) / step, 8)
    left, size = np.full(len(offsets), np.inf), np.full(len(offsets), np.nan)
    for index, offset in enumerate(offsets):
        inside = (raster >= t_a[0] + offset) & (raster <= t_a[-1] + offset)
        if inside.sum() >= needed:
            shifted = np.interp(raster[inside] - offset, t_a, a)
            left[index] = np.var(target[inside] - shifted)
            size[index] = 0.5 * (np.var(target[inside]) + np.var(shifted))
    if not np.isfinite(left).any():
        raise EstimationError(
            f"no offset between {search_s[0]:g} and {search_s[1]:g} s lets the two records overlap by half"
        )
    share = np.where(np.isfinite(left), left / np.where(size > 0, size, np.nan), np.inf)
    share = np.where(np.isnan(share), np.inf, share)
    best = int(np.argmin(share))
    if share[best] > ALIKE:
        raise EstimationError(
            f"the two records do not look alike: the best match, {offsets[best]:+.2f} s, leaves {100 * share[best]:.0f} % of the "
            "variance; check sign and scale, or give events_s"
        )
    padded = np.concatenate([[np.inf], share, [np.inf]])
    valley = (share <= padded[:-2]) & (share <= padded[2:]) & (np.abs(offsets - offsets[best]) > 2 * detail_s)
    rivals = np.flatnonzero(valley & (share < share[best] + AMBIGUOUS))
    if len(rivals):
        raise EstimationError(
            f"the records match at {offsets[best]:+.2f} s and at {offsets[rivals[0]]:+.2f} s alike; narrow search_s or give "
            "events_s"
        )
    return float(offsets[best])


def _fine(t_a: Array, a: Array, t_b: Array, b: Array, offset: float, detail_s: float, drift_sd: float) -> Clock:
    """Gauss-Newton on curve, difference, offset and drift at once; both records' deviations from their own residuals."""
    middle = float(0.5 * (max(t_a[0], t_b[0] - offset) + min(t_a[-1], t_b[-1] - offset)))
    # room for the steps that the offset takes
    low, high = min(t_a[0] + offset, t_b[0]) - 2 * detail_s, max(t_a[-1] + offset, t_b[-1]) + 2 * detail_s
    knots: Array = low + detail_s * np.arange(-3, int(np.ceil((high - low) / detail_s)) + 4)
    size: int = len(knots) - 4
    rows_b: Array = BSpline.design_matrix(t_b, knots, 3).toarray()
    normal_b, right_b = rows_b.T @ rows_b, rows_b.T @ b
    sd_a = sd_b = float(np.std(np.concatenate([a, b]))) or 1.0
    floor = 1e-12 * sd_b
    spent: float = np.sqrt((len(a) + len(b)) / max(len(a) + len(b) - size - 3, 1))
    drift, lever = 0.0, t_a - middle
    # stated, as a type checker takes long to find what a loop does to each
    rows: Array
    left_a: Array
    left_b: Array
    covariance: Array
    linear: Array
    right: Array
    slope: Array
    moved: Array
    step: Array
    for _ in range(ITERATIONS):
        mapped: Array = np.clip(t_a + offset + drift * lever, knots[3], knots[-4])
        rows = np.column_stack([BSpline.design_matrix(mapped, knots, 3).toarray(), np.ones(len(a))])
        linear = rows.T @ rows / sd_a**2
        right = rows.T @ a / sd_a**2
        linear[:size, :size] += normal_b / sd_b**2
        right[:size] += right_b / sd_b**2
        inverse = _inverse(linear)
        coefficients: Array = inverse @ right
        slope = BSpline(knots, coefficients[:size], 3).derivative()(mapped)
        moved = np.stack([slope, slope * lever], axis=1) / sd_a
        left_a, left_b = a - rows @ coefficients, b - rows_b @ coefficients[:size]
        # the curve is at its best for this offset, so that its own gradient is 0
        across: Array = moved.T @ rows / sd_a
        information: Array = moved.T @ moved + np.diag([0.0, drift_sd**-2]) - across @ inverse @ across.T
        covariance = _inverse(information)
        step = covariance @ (moved.T @ left_a / sd_a - np.array([0.0, drift / drift_sd**2]))
        offset, drift = offset + float(np.clip(step[0], -detail_s, detail_s)), drift + float(step[1])
        before = sd_a, sd_b
        sd_a, sd_b = (max(float(np.sqrt(np.mean(left**2)) * spent), floor) for left in (left_a, left_b))
        steady = abs(sd_a / before[0] - 1) < SETTLED and abs(sd_b / before[1] - 1) < SETTLED
        if steady and (np.abs(step) < SETTLED * np.sqrt(np.diag(covariance))).all():
            return Clock(offset, drift, middle, covariance)
    raise EstimationError("the match of the two records does not settle; give events_s")


def _inverse(matrix: Array) -> Array:
    """Inverse of a normal matrix whose unknowns have sizes of their own; one that nothing fixes stays at 0."""
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    outer = np.outer(scale, scale)
    return np.linalg.inv(matrix / outer + RIDGE * np.eye(len(matrix))) / outer
