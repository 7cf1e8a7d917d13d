"""Simulated data for every estimator (methods_cases.py): tows, pushed tows, swinging posts, steady tows, free runs, a gyro."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from identify_cases import (
    HULL,
    LENGTH_M,
    POINTS_M,
    SIGMA_BETA_RAD,
    SIGMA_Y_M,
    TENSION_N,
    campaign,
    noisy,
    pushed_run,
    still_run,
    times,
)
from scipy.optimize import fsolve
from scipy.signal import lfilter

from towline.identify import RunData
from towline.identify.methods import FreeRecord, forced_response
from towline.identify.steady import SteadyState
from towline.identify.still import Still
from towline.record import Priors
from towline.simulate import Histories, Hull, Start, Tow, simulate_full
from towline.simulate.model import full_rates

SPEED_M_S = 1.28
RUDDER_RAD = float(np.radians(-15.0))
STEADY_HULL = replace(HULL, y_delta=-2.0, n_delta=2.4)
FREE_HULL = Hull(
    249.6448, 93.9161, -97.17078, -42.7710, -92.5523, -94.0412, speed_m_s=1.30, y_delta=-18.0, n_delta=25.5
)
"""Table 3.1's hull with a rudder at -1.417 m."""
FREE_HZ = 8.0
COLOURED_HZ, LASTING_S = 16.0, 2.0
THINNED = 8
"""Where a method takes long, every eighth sample."""
EVEN_POINTS_M = (1.751, 1.5985, 1.446)


@cache
def still() -> tuple[RunData, ...]:
    return tuple(still_run(x, times(), "modal", priors=Priors()) for x in POINTS_M)


@cache
def still_full() -> tuple[RunData, ...]:
    return tuple(still_run(x, times(), "full", priors=Priors()) for x in POINTS_M)


def tows(rng: np.random.Generator) -> list[RunData]:
    return campaign(list(still()), rng)


def full_tows(rng: np.random.Generator) -> list[RunData]:
    return campaign(list(still_full()), rng)


def lasting(rng: np.random.Generator, count: int) -> np.ndarray:
    """Measurement noise (count, 2) of the usual size: three tenths white, the rest lasting two seconds; 16 Hz."""
    a = np.exp(-1 / (COLOURED_HZ * LASTING_S))
    slow = np.asarray(lfilter([np.sqrt(1 - a**2)], [1, -a], rng.normal(size=(count + 1000, 2)), axis=0))[1000:]
    return (np.sqrt(0.7) * slow + np.sqrt(0.3) * rng.normal(size=(count, 2))) * [SIGMA_Y_M, SIGMA_BETA_RAD]


def coloured_tows(rng: np.random.Generator) -> list[RunData]:
    """Tows at 16 Hz under lasting noise, each with a minute of the model held still."""
    t, found = times(COLOURED_HZ), []
    for x in POINTS_M:
        run = still_run(x, t, "modal", priors=Priors())
        noise = lasting(rng, len(t))
        held = Still(t, lasting(rng, len(t)), run.covariance)
        found.append(
            replace(
                run, y_m=run.y_m + noise[:, 0], beta_rad=run.beta_rad + noise[:, 1], common_key="camera", still=held
            )
        )
    return found


def pushed(rng: np.random.Generator) -> list[RunData]:
    return [noisy(pushed_run(x, rng, times(), priors=Priors()), rng) for x in POINTS_M]


def even_tows(rng: np.random.Generator) -> list[RunData]:
    return [noisy(still_run(x, times(), "modal", priors=Priors()), rng) for x in EVEN_POINTS_M]


def difference_equation(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    u = rng.normal(size=2000)
    noise = lfilter([1.0], [1.0, 0.0, 0.5], 2 * rng.normal(size=2000))
    return np.asarray(lfilter([0, 1, 0.5], [1, -1.5, 0.7], u)) + lfilter([1], [1, -1.5, 0.7], noise), u


def swung(omegas: tuple[float, ...], post_m: float) -> Callable[[np.random.Generator], list[tuple[Tow, np.ndarray]]]:
    """Settled answers to a post that swings, (n, 3): post, y, beta; over whole periods of 60 s."""

    def make(rng: np.random.Generator) -> list[tuple[Tow, np.ndarray]]:
        t, found = times(), []
        for x in POINTS_M:
            tow = Tow(SPEED_M_S, LENGTH_M, x, TENSION_N)
            columns = np.zeros((len(t), 3))
            for k, w in enumerate(omegas):
                swing = forced_response(HULL, tow, w, post_m * np.exp(1j * k))
                wave = np.exp(1j * w * t)
                columns += np.real(wave[:, None] * [swing.post_m, swing.y_m, swing.beta_rad])
            columns[:, 1:] += rng.normal(size=(len(t), 2)) * [SIGMA_Y_M, SIGMA_BETA_RAD]
            found.append((tow, columns))
        return found

    return make


@cache
def equilibrium(x_t: float) -> tuple[float, float]:
    tow = Tow(SPEED_M_S, LENGTH_M, x_t, TENSION_N, rudder_rad=RUDDER_RAD)

    def rest(angles: np.ndarray) -> np.ndarray:
        state = np.array([angles[0], angles[1], -SPEED_M_S * np.sin(angles[1]), 0.0])
        return full_rates(0.0, state, STEADY_HULL, tow)[2:]

    alpha, beta = fsolve(rest, [0.3, 0.03], xtol=1e-13)
    return float(alpha), float(beta)


def steady_tows(rng: np.random.Generator) -> list[SteadyState]:
    """Means over 60 s: alpha holds the noise of y and of beta through the tow point."""
    found = []
    for x in POINTS_M:
        noise = rng.normal(size=(len(times()), 2)) * [SIGMA_Y_M, SIGMA_BETA_RAD]
        alpha, beta = equilibrium(x)
        moved = np.column_stack([(noise[:, 0] + x * noise[:, 1]) / (LENGTH_M * np.cos(alpha)), noise[:, 1]])
        mean = moved.mean(axis=0) + np.array([alpha, beta])
        covariance = np.cov(moved.T) / len(moved)
        found.append(SteadyState(f"{x}", x, mean[0], mean[1], covariance, speed_m_s=SPEED_M_S, tension_n=TENSION_N))
    return found


@cache
def zigzag() -> FreeRecord:
    t = np.arange(0, 60, 1 / FREE_HZ)
    at, values, side, here = [0.0, 1.0], [0.0, 0.0], 1.0, 1.0
    while here < 60:
        at += [here + (0.85 if len(at) == 2 else 1.7), here + 6.0]
        values += [side * 0.17] * 2
        side, here = -side, here + 6.0
    history = np.array(at), np.array(values)
    motion = simulate_full(
        FREE_HULL,
        Tow(1.30, 1.0, 0.0, None, resistance_n=0.0),
        Start(y_cg_m=0.1, beta_rad=0.01),
        t,
        free=True,
        histories=Histories(rudder_rad=lambda s: float(np.interp(s, *history))),
    )
    return FreeRecord(t, motion["y_cg_m"].to_numpy(), motion["beta_rad"].to_numpy(), *history, 1.30)


def free_run(rng: np.random.Generator) -> tuple[FreeRecord, Hull]:
    """A zigzag, and the six as tows would have told them: to 1 %."""
    clean = zigzag()
    noise = rng.normal(size=(len(clean.t_s), 2)) * [SIGMA_Y_M, SIGMA_BETA_RAD]
    run = replace(clean, y_m=clean.y_m + noise[:, 0], beta_rad=clean.beta_rad + noise[:, 1])
    return run, FREE_HULL.with_six(FREE_HULL.six * (1 + 0.01 * rng.normal(size=6)))


def gyro(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heading, and a gyro that reads 3 % long with a bias of 0.002 rad/s, thinned to 8 Hz."""
    clean = still()[2]
    take = slice(None, None, THINNED)
    t, beta = clean.t_s[take], clean.beta_rad[take]
    rate = 1.03 * np.gradient(clean.beta_rad, clean.t_s)[take] + 0.002 + 0.002 * rng.normal(size=len(t))
    return t, beta + SIGMA_BETA_RAD * rng.normal(size=len(t)), rate
