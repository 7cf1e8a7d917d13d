"""Output-error least squares for methods with an outside input: predicted against measured (y, beta), noise whitened.

The joint fit of tows has its own (``identify.fit``), with camera modes and priors of T and X_T; this is the plain one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..data import ASSUMED_SIGMA_BETA_RAD, ASSUMED_SIGMA_Y_M
from ..noise import measured, stated

Weight = Callable[[Array], Array]
"""Whitens (n, 2) or (n, 2, k) of one run."""
Predict = Callable[[Array], tuple[list[Array], list[Array]]]
"""theta (k,) -> per run the response (n, 2) and its slope (n, 2, k)."""
SIGMA = (ASSUMED_SIGMA_Y_M, float(ASSUMED_SIGMA_BETA_RAD))
REWEIGHTINGS = 2
"""Fits after the first, with the noise measured from what the last one left: a choice."""
TOLERANCE = 1e-9
"""Of scipy's least_squares, for cost, step and slope alike: far below any standard deviation."""
MAX_STEPS = 60
"""Evaluations of scipy's least_squares at most."""
FAR = 1e12
"""A whitened residual counts as no more than this, so that a trial gone astray is refused and not an overflow."""


@dataclass(frozen=True)
class OutputError:
    """Result of ``output_error``.

    Attributes
    ----------
    theta, covariance : (k,), (k, k); the covariance holds the residuals' measured scatter and colour
    residual : per run (n, 2), measured minus predicted
    converged : bool
    """

    theta: Array
    covariance: Array
    residual: list[Array]
    converged: bool


def output_error(
    predict: Predict,
    seen: list[Array],
    t_s: list[Array],
    start: Array,
    *,
    prior: Array | None = None,
    sigma: tuple[float, float] = SIGMA,
    whiten: list[Weight] | None = None,
    sample_covariance: Sequence[Array | None] | None = None,
) -> OutputError:
    """Fit theta to the records ``seen``, per run (n, 2).

    Parameters
    ----------
    predict : theta -> of each run its motion (n, 2) and the slope of it (n, 2, k)
    seen : of each run (n, 2)
    t_s : of each run (n,), s
    start : (k,), in units where a step of 1 is large
    prior : (k,), 1 / sd about 0 of each parameter, 0 = free; None = all free
    sigma : of y and beta to begin with; scatter and colour are then measured
    sample_covariance : per run (n, 2, 2) of its samples, instead of sigma; None: sigma
    whiten : fixed whiteners instead; the covariance then holds only the scatter measured against them

    Raises
    ------
    EstimationError : the start's motion is not finite
    """
    usual = np.diag(np.square(sigma))
    own = [None] * len(t_s) if sample_covariance is None else sample_covariance
    plain = [
        stated(np.broadcast_to(usual, (len(t), 2, 2)) if c is None else c, t) for c, t in zip(own, t_s, strict=True)
    ]
    weight: list[Weight] = list(plain) if whiten is None else whiten
    from scipy.optimize import least_squares  # takes long to load, and the joint fit does without

    pull = np.zeros(len(start)) if prior is None else np.asarray(prior, dtype=float)
    held = np.diag(pull)[pull > 0]
    theta = np.asarray(start, dtype=float)
    converged = False
    memory: dict[bytes, tuple[list[Array], list[Array]]] = {}

    def answer(x: Array) -> tuple[list[Array], list[Array]]:
        key = x.tobytes()
        if key not in memory:
            memory.clear()
            with np.errstate(all="ignore"):
                memory[key] = predict(x)
        return memory[key]

    def residual(x: Array) -> Array:
        response = answer(x)[0]
        parts = [w(s - p).ravel() for w, s, p in zip(weight, seen, response, strict=True)]
        whole = np.concatenate([*parts, -held @ x])
        return np.clip(np.nan_to_num(whole, nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR)

    def slope(x: Array) -> Array:
        rows = [-w(s).reshape(-1, len(x)) for w, s in zip(weight, answer(x)[1], strict=True)]
        whole = np.concatenate([*rows, -held])
        return np.nan_to_num(whole, nan=0.0, posinf=0.0, neginf=0.0)

    if not all(np.isfinite(r).all() for r in answer(theta)[0]):
        raise EstimationError("the motion of the start values grows beyond bounds; give others")
    rest: list[Array] = []
    turns = REWEIGHTINGS + 1 if whiten is None else 1
    for turn in range(turns):
        found = least_squares(
            residual,
            theta,
            jac=slope,  # pyright: ignore[reportArgumentType]
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
            max_nfev=MAX_STEPS,
        )
        theta, converged = found.x, bool(found.status > 0)
        rest = [s - p for s, p in zip(seen, answer(theta)[0], strict=True)]
        if turn < turns - 1:
            plain = [measured(r, w) for r, w in zip(rest, plain, strict=True)]
            weight = list(plain)
    rows = slope(theta)
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    inverse = np.linalg.pinv((rows / size).T @ (rows / size), rcond=1e-14, hermitian=True)
    covariance = inverse / size[:, None] / size
    samples, parameters = sum(s.size for s in seen), int((pull == 0).sum())
    if whiten is None:
        covariance = covariance * samples / max(samples - parameters, 1)
    else:
        final = residual(theta)
        covariance = covariance * float(final @ final) / max(samples - parameters, 1)
    return OutputError(theta, covariance, rest, converged)
