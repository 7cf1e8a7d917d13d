"""Simulated campaigns whose derivatives are known: the ITTC MARINER hull (Table 8.2) at four tow points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from towline.identify import RunData
from towline.record import Priors
from towline.simulate import Hull, Start, Tow, linear_system, simulate_full, simulate_linear

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)
POINTS_M = (1.446, 1.548, 1.649, 1.751)
LENGTH_M, TENSION_N = 0.91, 3.96
RELEASED_M = 0.15
RATE_HZ, SPAN_S = 64.0, 60.0
SIGMA_Y_M, SIGMA_BETA_RAD = 1e-3, np.radians(0.1)
LARGE_STARTS_RAD = np.radians([28.0, 30.0, 32.0, 38.5])
"""Released there, the four tows swing to 48-50 degrees within a minute."""
NUISANCE = Priors(tension_sd_rel=0.01, tow_point_sd_m=1e-3, y_bias_sd_m=2e-3, beta_bias_sd_rad=float(np.radians(0.2)))
EXACT = Priors(y_bias_sd_m=0.0, beta_bias_sd_rad=0.0)
FORCE_N, FORCE_TIME_S = 0.02, 0.5
"""A coloured disturbance: sd of the force (N) and of the moment (N m), and its correlation time."""


def times(rate_hz: float = RATE_HZ, span_s: float = SPAN_S) -> np.ndarray:
    return np.arange(round(rate_hz * span_s)) / rate_hz


def still_run(
    tow_point_m: float,
    t_s: np.ndarray,
    form: str = "linear",
    start: Start | None = None,
    tension_n: float = TENSION_N,
    stated_point_m: float | None = None,
    stated_tension_n: float = TENSION_N,
    priors: Priors = EXACT,
) -> RunData:
    """A run without noise; the stated tow point and tension may differ from those it was made with."""
    tow = Tow(1.28, LENGTH_M, tow_point_m, tension_n)
    if form == "modal":
        y, beta = modal_motion(tow, t_s)
    else:
        simulate = simulate_full if form == "full" else simulate_linear
        motion = simulate(HULL, tow, start or Start(y_cg_m=RELEASED_M), t_s)
        y, beta = motion["y_cg_m"].to_numpy(), motion["beta_rad"].to_numpy()
    known = tow_point_m if stated_point_m is None else stated_point_m
    covariance = np.zeros((len(t_s), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = SIGMA_Y_M**2, SIGMA_BETA_RAD**2
    return RunData(
        name=f"x{known:.3f}",
        t_s=t_s,
        y_m=y,
        beta_rad=beta,
        covariance=covariance,
        common=np.zeros((0, len(t_s), 2)),
        common_key="",
        tow=replace(tow, tow_point_m=known, tension_n=stated_tension_n),
        tension=None,
        speed=None,
        priors=priors,
        assumed_sigma=False,
    )


def modal_motion(tow: Tow, t_s: np.ndarray) -> np.ndarray:
    """(y, beta) of the linear form released at rest, (2, n), from its four modes: much faster than ``simulate_linear``."""
    roots, shapes = np.linalg.eig(linear_system(HULL, tow)[0])
    sizes = np.linalg.solve(shapes, np.array([RELEASED_M, 0, 0, 0], dtype=complex))
    return np.real((shapes[:2] * sizes) @ np.exp(roots[:, None] * (t_s - t_s[0])))


def noisy(run: RunData, rng: np.random.Generator, bias: tuple[float, float] = (0.0, 0.0)) -> RunData:
    """White noise and datum biases on top."""
    count = len(run.t_s)
    return replace(
        run,
        y_m=run.y_m + rng.normal(0, SIGMA_Y_M, count) + bias[0],
        beta_rad=run.beta_rad + rng.normal(0, SIGMA_BETA_RAD, count) + bias[1],
    )


def campaign(still: list[RunData], rng: np.random.Generator) -> list[RunData]:
    return [noisy(run, rng) for run in still]


def nuisance_campaign(rng: np.random.Generator, t_s: np.ndarray) -> list[RunData]:
    """T_i, X_T,i, y_b and beta_b drawn from their priors; what is stated stays at the nominal value."""
    runs = []
    for point in POINTS_M:
        tension = TENSION_N * (1 + NUISANCE.tension_sd_rel * rng.normal())
        true_point = point + NUISANCE.tow_point_sd_m * rng.normal()
        bias = (2e-3 * rng.normal(), float(np.radians(0.2)) * rng.normal())
        made = still_run(true_point, t_s, tension_n=tension, stated_point_m=point, priors=NUISANCE, form="modal")
        runs.append(noisy(made, rng, bias))
    return runs


def unaware(run: RunData) -> RunData:
    """The same run with nothing allowed to move but the start."""
    return replace(run, priors=EXACT)


def pushed_run(
    tow_point_m: float,
    rng: np.random.Generator,
    t_s: np.ndarray,
    force_n: float = FORCE_N,
    moment_n_m: float = FORCE_N,
    time_s: float = FORCE_TIME_S,
    priors: Priors = EXACT,
) -> RunData:
    """A tow under a coloured side force and moment on the hull (linear form), without measurement noise.

    The disturbed state is stepped exactly: hull and disturbance are one linear system, driven by white noise.
    """
    made = still_run(tow_point_m, t_s, "modal", priors=priors)

    matrix, _ = linear_system(HULL, made.tow)
    step = float(t_s[1] - t_s[0])
    whole = np.zeros((6, 6))
    whole[:4, :4] = matrix
    whole[2, 4], whole[3, 5] = 1 / SIX[0], 1 / SIX[1]
    whole[4, 4] = whole[5, 5] = -1 / time_s
    driven = np.zeros((6, 6))
    driven[4, 4], driven[5, 5] = 2 * force_n**2 / time_s, 2 * moment_n_m**2 / time_s
    # van Loan: the covariance of what the white drive adds in a step
    block = np.zeros((12, 12))
    block[:6, :6], block[:6, 6:], block[6:, 6:] = -whole, driven, whole.T
    power = expm(block * step)
    transition = power[6:, 6:].T
    added = transition @ power[:6, 6:]
    values, vectors = np.linalg.eigh((added + added.T) / 2)
    root = vectors * np.sqrt(np.maximum(values, 0))
    state = np.zeros(6)
    state[4:] = rng.normal(size=2) * [force_n, moment_n_m]
    kicks = rng.normal(size=(len(t_s), 6)) @ root.T
    path = np.empty((len(t_s), 2))
    for k in range(len(t_s)):
        path[k] = state[:2]
        state = transition @ state + kicks[k]
    return replace(made, y_m=made.y_m + path[:, 0], beta_rad=made.beta_rad + path[:, 1])
