"""Sparse regression (pysindy, weak form) for the benchmark of any simulator: run by an interpreter that has it.

    PEERS/bin/python benchmarks/any_simulator_sparse.py TABLES.npz ANSWER.json

Knows nothing of towline. TABLES.npz has a case's records as measured: x (runs, n) and x2 (the other output, where there is one),
u (runs, n), t, the system's name, its usual speed. Rates come from smoothing splines. What the model's own terms leave is given to
forward orthogonal least squares (FROLS), the number of terms by BIC. (An ensemble of thresholded least squares, as for the laws,
kept nearly all candidates of a pendulum: they go nearly with one another.) ANSWER.json: names of what it takes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import make_smoothing_spline

MOST_TERMS = 3
"""So many terms may be missing."""
SURE = 6.0
"""A term is taken where BIC falls by more: strong evidence by the usual words."""
ENDS = 4
"""Samples at either end that are left out: a spline's rates are worst there."""
SEED = 0
STICKS = 0.01
"""Dry friction turns within this share of the usual speed."""


def spline(t: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
    """Smoothed values (order 0) or rates (1), by generalised cross-validation."""
    made = make_smoothing_spline(t, x)
    return made(t) if order == 0 else made.derivative()(t)


def columns(system: str, x: np.ndarray, v: np.ndarray, u: np.ndarray, other: np.ndarray, speed: float):
    """The model's own terms, and candidates by the engine's names."""
    sign = np.tanh(v / (STICKS * speed))
    drags = {"constant": 1 + 0 * v, "dry_friction": sign, "quadratic_damping": v * np.abs(v), "cubic_damping": v**3}
    pulls = {
        "cubic_stiffness": x**3,
        "stiffness_above": np.maximum(x, 0),
    }
    if system == "pendulum":
        return [np.sin(x), v], {f"rate_{k}": c for k, c in (drags | pulls).items()}
    if system == "drive":
        del drags["dry_friction"]
        return [v, sign, u], {f"speed_{k}": c for k, c in drags.items()}
    if system == "Duffing":
        del pulls["cubic_stiffness"]
        return [x, v, x**3, u], {f"v_{k}": c for k, c in (drags | pulls).items()}
    if system == "two tanks":
        own = [np.sqrt(np.maximum(other, 1e-9)), np.sqrt(np.maximum(v, 1e-9))]
        return own, {f"h2_{k}": c for k, c in drags.items() if k != "dry_friction"}
    return [v, u], {f"turn_{k}": c for k, c in drags.items()}


def main() -> None:
    """Of one case."""
    import pysindy as ps

    d = dict(np.load(sys.argv[1]))
    system, t = str(d["system"]), d["t"]
    first_order = system in ("drive", "two tanks")
    rows, lefts, names, kept_always = [], [], [], 0
    for x, u, other in zip(d["x"], d["u"], d["x2"], strict=True):
        place = spline(t, x, 0)
        v = place if first_order else spline(t, x, 1)
        beside = spline(t, other, 0) if np.isfinite(other).all() else other
        own, more = columns(system, place, v, u, beside, float(d["speed"]))
        names, kept_always = list(more), len(own)
        table = np.column_stack([v, *own, *more.values()])[ENDS:-ENDS]
        library = ps.WeakPDELibrary(
            function_library=ps.PolynomialLibrary(degree=1, include_bias=False),
            spatiotemporal_grid=t[ENDS:-ENDS],
            K=100,
            H_xt=[(t[-1] - t[0]) / 16],
        )
        axes = {"ax_time": 0, "ax_coord": 1}
        # the same places of the test functions for all
        np.random.seed(SEED)  # noqa: NPY002
        library.fit([ps.AxesArray(table, axes)])
        rows.append(np.asarray(library.transform([ps.AxesArray(table, axes)])[0])[:, 1:])
        lefts.append(np.asarray(library.convert_u_dot_integral(ps.AxesArray(table[:, :1], axes)))[:, :1])
    table, left = np.concatenate(rows), np.concatenate(lefts)
    # what the model's own terms do not say already: candidates go nearly with them, and with one another
    own, more = table[:, :kept_always], table[:, kept_always:]
    left, more = (a - own @ np.linalg.lstsq(own, a, rcond=None)[0] for a in (left, more))
    size = more.std(axis=0)
    size[size == 0] = 1.0
    more = more / size
    count = len(left)
    best, found = count * np.log(float(np.sum(left**2)) / count), []
    for terms in range(1, min(MOST_TERMS, len(names)) + 1):
        optimizer = ps.FROLS(max_iter=terms, alpha=1e-6, normalize_columns=False)
        try:
            optimizer.fit(more, left)
        except ValueError:  # nothing independent is left
            break
        there = np.abs(np.asarray(optimizer.coef_)[0]) > 0
        fit = np.linalg.lstsq(more[:, there], left[:, 0], rcond=None)[0]
        rest = float(np.sum((left[:, 0] - more[:, there] @ fit) ** 2))
        bic = count * np.log(rest / count) + int(there.sum()) * np.log(count)
        if bic < best - SURE:
            best, found = bic, [name for name, one in zip(names, there, strict=True) if one]
    Path(sys.argv[2]).write_text(json.dumps(found))


if __name__ == "__main__":
    main()
