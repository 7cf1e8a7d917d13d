"""Where a fit of free runs begins: the ratios of the hull's forces to its masses by weighted integrals, no start needed.

v' = a11 v + a12 r + b1 delta + c1 and r' = a21 v + a22 r + b2 delta + c2 are multiplied by bumps that vanish at their ends and
integrated over the record; the rates on the left go over to the bumps (weak form), so that nothing is differentiated twice.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array

SMOOTHED_S = 1.0
"""Length of the parabola that gives y' and beta'."""
LARGEST_HEADING_RAD = np.radians(60.0)
"""Beyond it y' says little of v, which then points along the tank."""
OVERLAP = 4
"""Bumps begin a fourth of their length apart."""
LEAST = 8
"""Fewer bumps than this leave nothing to fit four numbers to."""


def ratios_by_integrals(records: Sequence, bump_s: float, speed_m_s: float) -> Array:
    """Ratios of free runs, (2, 4): rows sway, yaw; columns by v, r, delta, 1; at ``speed_m_s``.

    Parameters
    ----------
    records : ``FreeRecord`` each
    bump_s : length of the bumps; about as long as the hull takes to answer its rudder
    speed_m_s : at which they are quoted; a run's own damping goes with its U, rudder and asymmetry with U^2

    Raises
    ------
    EstimationError : the records hold fewer than 8 bumps, or no motion

    Errors: 5-20 % at 1 mm and 0.1 degree; good enough to begin with, not to report.
    """
    rows: list[Array] = []
    left: list[Array] = []
    for record in records:
        step = float(np.median(np.diff(record.t_s)))
        grid = np.arange(record.t_s[0], record.t_s[-1], step)
        ratio = record.speed_m_s / speed_m_s
        y, beta = (np.interp(grid, record.t_s, x) for x in (record.y_m, record.beta_rad))
        wide = max(2, round(SMOOTHED_S / step / 2))
        r, y_rate = _slope(beta, step, wide), _slope(y, step, wide)
        seen = np.abs(beta) < LARGEST_HEADING_RAD
        cosine = np.where(seen, np.cos(beta), 1.0)
        v = (y_rate - record.speeds(grid) * np.sin(beta)) / cosine
        columns = np.column_stack([ratio * v, ratio * r, ratio**2 * record.rudder(grid), ratio**2 * np.ones_like(grid)])
        size = max(6, round(bump_s / step))
        x = np.arange(size + 1) / size
        bump, slope = 16 * (x * (1 - x)) ** 2, 32 * x * (1 - x) * (1 - 2 * x) / (size * step)
        for first in range(wide, len(grid) - size - wide, max(1, size // OVERLAP)):
            at = slice(first, first + size + 1)
            if seen[at].all():
                rows.append(bump @ columns[at] * step)
                left.append(-np.array([slope @ v[at], slope @ r[at]]) * step)
    if len(rows) < LEAST:
        raise EstimationError("the free runs are too short, or head too far round, to begin a fit from")
    matrix, right = np.array(rows), np.array(left)
    size = np.linalg.norm(matrix, axis=0)
    if not (size > 0).all() or not np.isfinite(right).all():
        raise EstimationError("the free runs hold no motion that a fit could begin from")
    return np.linalg.lstsq(matrix / size, right, rcond=1e-6)[0].T / size


def _slope(values: Array, step: float, wide: int) -> Array:
    """Rate by a parabola over ``2 wide + 1`` samples."""
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(values, 2 * wide + 1, 2, deriv=1, delta=step, mode="interp"))
