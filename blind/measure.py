"""What the truth itself measures of a case, once the seal is open: D to the nearest rival, and the shrink an oracle reaches.

The oracle puts the effect in exactly as reality has it and knows the noise: on runs kept aside in turn, what is left is noise.
The gap
is that of gap.json: the root mean square of the whitened residual of y and heading.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from ..record.files import write_text
from .signature import STEP_S, Sensed, block_means, distances_of, linear, pictured
from .truth.cases import Case, filmed, lane_of, swum
from .truth.lanes import Array
from .truth.motion import swim

FLAT = 4
"""Numbers of a start, free on each run."""


def measured(case: Case) -> dict[str, Any]:
    """D and the oracle's shrink of a case: plain values."""
    if not case.effects:
        return {}
    sensed = linear(case)
    d = distances_of(case, sensed)
    before, after = oracle(case, sensed)
    excess = max(before**2 - 1, 0.0)
    shrink = 1 - max(after**2 - 1, 0.0) / excess if excess > 0 else 0.0
    return {
        "strength": d.strength,
        "nearest": d.nearest,
        "rival": d.rival,
        "rivals": d.rivals,
        "oracle_before": before,
        "oracle_after": after,
        "oracle_shrink": shrink,
    }


def oracle(case: Case, sensed: Sensed) -> tuple[float, float]:
    """Root mean square of whitened y and heading on runs kept aside in turn: without the effect (derivatives and camera fitted to
    the other runs), and with the truth put in.

    Parameters
    ----------
    case : as drawn
    sensed : signatures of the case
    """
    path = swum(case)
    runs = range(len(case.runs))
    with np.errstate(all="ignore"):
        plain = swim([lane_of(case, i, effects=False) for i in runs], case.duration_s + 1.5, None, STEP_S)
        true = swim([lane_of(case, i) for i in runs], case.duration_s + 1.5, None, STEP_S)
    missing, noise = [], []
    for i in runs:
        film = filmed(case, path, i)
        # the picked datum's own error is part of the camera's pose, whose prior is in ``common``
        data = block_means(case, film.pixel)
        without = pictured(case, lane_of(case, i, effects=False), plain, i, i)
        within = pictured(case, lane_of(case, i), true, i, i)
        exact = _exact(case, true, i)
        factor = sensed.whiteners[i]
        left = data - exact
        noise.append(solve_triangular(factor, left, lower=True))
        missing.append(solve_triangular(factor, left + within - without, lower=True))
    return _held_out(sensed, missing, True), _held_out(sensed, noise, False)


def _exact(case: Case, true, index: int) -> Array:
    """The truth's picture without random forces or noise."""
    return block_means(case, filmed(case, true, index, noisy=False).clean)


def _held_out(sensed: Sensed, left: list[Array], fit: bool) -> float:
    total, count = 0.0, 0
    for i, rows in enumerate(sensed.rows):
        rest = left[i]
        if fit:
            others = [k for k in range(len(sensed.rows)) if k != i]
            a = np.vstack([sensed.common[sensed.rows[k]] for k in others])
            b = np.concatenate([left[k] for k in others])
            scale = np.sqrt((a**2).sum(axis=0) + sensed.prior)
            system = np.vstack([a / scale, np.diag(np.sqrt(sensed.prior) / scale)])
            solved = np.linalg.lstsq(system, np.concatenate([b, np.zeros(len(scale))]), rcond=1e-9)[0] / scale
            rest = rest - sensed.common[rows] @ solved
        white = _seen_white(sensed, i, rest)
        total += float(white @ white)
        count += len(white) - FLAT
    return float(np.sqrt(total / count))


def _seen_white(sensed: Sensed, run: int, white: Array) -> Array:
    """A run's whitened pixels to whitened y and heading, each length or angle in its own noise."""
    factor, eye = sensed.whiteners[run], sensed.eyes[run]
    n = len(eye)
    both = np.einsum("bij,bjk->bik", eye, factor.reshape(n, 4, 4 * n)).reshape(2 * n, 4 * n)
    return solve_triangular(np.linalg.cholesky(both @ both.T), both @ white, lower=True)


def write_measured(case_json: dict[str, Any], to: Path) -> str:
    """Measure a case and write it (for a pool of processes)."""
    case = Case.from_json(case_json)
    try:
        found = measured(case)
    except ValueError as error:  # a rival turned the tow over: its D is not known, and the case is in no stratum
        found = {"error": str(error)}
    write_text(to, json.dumps(found, indent=1, sort_keys=True) + "\n")
    return case.name
