"""Slow noise under the whitened residuals: its meat in closed form, and intervals over many seeds with it and without."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.colour.leftover import CORNERS_HZ, Leftover, Whitened, leftover

STEP_S = 1 / 25
COUNT = 1000
SEEDS = 200
WITHIN = 4 * np.sqrt(2 / SEEDS)
"""Four standard errors of the mean square of z, as if the parameters of a seed were one."""
T_S = STEP_S * np.arange(COUNT)


def swing() -> np.ndarray:
    """Slopes (2, 6, n) as a tow's: its swing and how that grows and decays, a drift, a bias; of each another in each channel."""
    wave = 2 * np.pi * 0.05 * T_S
    rows = np.array([np.cos(wave), np.sin(wave), T_S * np.cos(wave) / 20, T_S * np.sin(wave) / 20, T_S / 20, T_S**0])
    return np.stack([rows, rows[::-1]])


def coloured(rng: np.random.Generator, size: float, corner_hz: float) -> np.ndarray:
    """(n,) of power 1 + size / (1 + (f / corner)^2), periodic over twice the record."""
    frequency = np.fft.rfftfreq(2 * COUNT, STEP_S)
    power = 1 + size / (1 + (frequency / corner_hz) ** 2)
    return np.fft.irfft(np.fft.rfft(rng.normal(size=2 * COUNT)) * np.sqrt(power))[:COUNT]


def regression(
    rng: np.random.Generator, size: float, runs: int = 4
) -> tuple[np.ndarray, Leftover, np.ndarray, np.ndarray]:
    """Parameters (6,) whose truth is 0, what is left over, and their covariance with it and without."""
    slope = swing()
    noise = [np.stack([coloured(rng, size, 0.3) for _ in range(2)]) for _ in range(runs)]
    inverse = np.linalg.inv(runs * (slope[0] @ slope[0].T + slope[1] @ slope[1].T))
    theta = inverse @ sum(slope[0] @ e[0] + slope[1] @ e[1] for e in noise)
    made = [Whitened(e - np.einsum("k,ckn->cn", theta, slope), slope, np.arange(6), STEP_S) for e in noise]
    found = leftover(made, [inverse] * runs)
    more = sum(found.meat(run) for run in made)
    return theta, found, inverse + inverse @ more @ inverse, inverse


def test_the_meat_is_the_slopes_with_the_excess_covariance() -> None:
    """J' C J with C's entries the Lorentzian's own: pi a f0 dt exp(-2 pi f0 |lag|)."""
    slope = swing()
    run = Whitened(np.zeros((2, COUNT)), slope, np.arange(6), STEP_S)
    for index, corner in enumerate(CORNERS_HZ):
        size = np.zeros(len(CORNERS_HZ))
        size[index] = 0.7
        lag = np.abs(T_S[:, None] - T_S)
        covariance = 0.7 * np.pi * corner * STEP_S * np.exp(-2 * np.pi * corner * lag)
        wanted = sum(rows @ covariance @ rows.T for rows in slope)
        # power beyond the Nyquist frequency is not folded back: at most a corner / (pi 12.5 Hz) of the whole, 2 %
        scale = np.sqrt(np.diag(wanted))
        assert np.abs((Leftover(size, 0.0).meat(run) - wanted) / np.outer(scale, scale)).max() < 0.02


def test_intervals_hold_where_slow_noise_is_left() -> None:
    z, plain = [], []
    for seed in range(SEEDS):
        theta, _, covariance, white = regression(np.random.default_rng([1, seed]), 0.8)
        z.append(theta / np.sqrt(np.diag(covariance)))
        plain.append(theta / np.sqrt(np.diag(white)))
    assert np.mean(np.square(z)) == pytest.approx(1, abs=WITHIN)
    assert np.mean(np.square(plain)) > 1 + WITHIN


@pytest.mark.slow
def test_white_noise_is_left_alone() -> None:
    """Its intervals stay true, and grow by less than 2 % on the mean."""
    z, wider, none = [], [], []
    for seed in range(SEEDS):
        theta, found, covariance, white = regression(np.random.default_rng([2, seed]), 0.0)
        z.append(theta / np.sqrt(np.diag(covariance)))
        wider.append(np.sqrt(np.diag(covariance) / np.diag(white)))
        none.append(found.none_p)
    assert np.mean(np.square(z)) == pytest.approx(1, abs=WITHIN)
    assert np.mean(wider) < 1.02
    assert np.median(none) > 0.5


def test_residuals_that_say_nothing_leave_what_was_believed() -> None:
    """Half a chance of none, a fifth of an excess in the mean: no runs, or one whose fit has taken all of it."""
    waves = np.fft.irfft(np.eye(COUNT // 2 + 1), axis=1) * np.sqrt(COUNT)
    taken = Whitened(np.ones((2, COUNT)), np.stack([waves, waves]), np.arange(len(waves)), STEP_S)
    for runs, spreads in (([], []), ([taken], [np.eye(len(waves))])):
        found = leftover(runs, spreads)
        assert found.none_p == pytest.approx(0.5)
        assert found.power(np.zeros(1))[0] == pytest.approx(0.22, abs=0.02)
