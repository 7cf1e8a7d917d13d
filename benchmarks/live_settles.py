"""X_v of a steady tow as it settles: simulated settles, looked at again and again, against the truth.

Each of them is a campaign: two to four tow points of a hull that tows stably there, the rudder over; the tows before the last have
been filmed whole; the last is let go aside of its rest and asked for X_v every few seconds. Rig and gauge err as run.toml states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import fsolve
from scipy.signal import lfilter

from towline.identify.settling import neutral_point, settling
from towline.identify.steady import SteadyState, UnsettledError, steady_state
from towline.record.errors import TowlineError
from towline.record.run import Run
from towline.record.schema import RunFile
from towline.record.toml import check_tables
from towline.simulate import Hull, Start, Tow, linear_system, simulate_full
from towline.simulate.model import full_rates

Array = np.ndarray
HULLS = {
    "frigate": (
        Hull(4.655, 0.3519, -6.804, -1.00, -1.490076, -0.9457, speed_m_s=0.725, y_delta=0.5, n_delta=-0.25425),
        Tow(0.725, 0.71, 0.5, None, 0.50),
        1.13,
        (0.36, 0.70),
    ),
    "MARINER": (
        Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, y_delta=-2.0, n_delta=2.4),
        Tow(1.28, 0.91, 1.5, 3.96),
        2.66,
        (1.5, 2.2),
    ),
}
"""Of sample_videos, with a rudder; the tow they are on; LBP; tow points."""
PRIORS = {"tension_sd_rel": 0.002, "tow_point_sd_m": 5e-4}
RATE_HZ, LONGEST_S = 25.0, 60.0
ASKED_S = (8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)
WIDEST_RAD = 0.6
"""A tow that rests farther out stands half across the tank."""
LEAST_DECAY = 0.02
"""1/s; what decays slower comes to no rest on a tank's length."""


@dataclass(frozen=True)
class Asked:
    """An answer: when, X_v's error over its standard deviation and in it, whether settled, whether it stands."""

    t_s: float
    z: float
    std_m: float
    inside: bool
    settled: bool
    stands: bool


def rest_of(hull: Hull, tow: Tow) -> Array:
    """Steady alpha and beta, (2,), rad."""

    def rates(angles: Array) -> Array:
        return full_rates(0.0, np.array([*angles, -tow.speed_m_s * np.sin(angles[1]), 0.0]), hull, tow)[2:]

    return fsolve(rates, [0.3, 0.03], xtol=1e-13)


def decays(hull: Hull, tow: Tow) -> float:
    """Of the slowest root, 1/s."""
    pulled = replace(tow, tension_n=tow.tension_n or tow.resistance_n)
    return -float(np.linalg.eigvals(linear_system(hull, pulled)[0]).real.max())


def swum(hull: Hull, tow: Tow, aside_rad: float, t_s: Array) -> Array:
    """alpha, beta (n, 2) of a tow let go aside of its rest."""
    alpha, beta = rest_of(hull, tow)
    start = Start(alpha_rad=alpha + aside_rad, beta_rad=beta, v_m_s=-tow.speed_m_s * float(np.sin(beta)))
    return simulate_full(hull, tow, start, t_s)[["alpha_rad", "beta_rad"]].to_numpy()


def noise(rng: np.random.Generator, n: int) -> Array:
    """Errors of alpha and beta, (n, 2), rad: white, and of 0.1 to 2 s."""
    sd = np.radians(10 ** rng.uniform(-2, -0.7))
    fall = np.exp(-1 / RATE_HZ / 10 ** rng.uniform(-1, 0.3))
    fresh = rng.normal(size=(n, 2)) * np.sqrt(1 - fall**2)
    fresh[0] /= np.sqrt(1 - fall**2)
    share = rng.uniform(0, 1)
    return sd * (
        np.sqrt(share) * rng.normal(size=(n, 2)) + np.sqrt(1 - share) * lfilter([1.0], [1.0, -fall], fresh, axis=0)
    )


def run_of(name: str, tow: Tow, length_m: float) -> Run:
    """A run that comes with its motion."""
    rig = {"speed_m_s": tow.speed_m_s, "line_length_m": tow.line_length_m, "tow_point_m": tow.tow_point_m}
    rig |= {"line": tow.line, "rudder_rad": tow.rudder_rad}
    if tow.tension_n is not None:
        rig["tension_n"] = tow.tension_n
    tables = {
        "name": name, "source": {"motion": "motion.csv"}, "tow": rig, "water": {},
        "model": {"length_pp_m": length_m, "mass_kg": 78.0}, "priors": PRIORS,
    }  # fmt: skip
    return Run(Path(), check_tables(tables, RunFile, Path("run.toml")))


def motion_of(t_s: Array, angles: Array) -> pd.DataFrame:
    """As ``record.read_motion`` gives it."""
    alpha, beta = angles.T
    return pd.DataFrame({"t_s": t_s, "y_cg_m": 0.1, "alpha_rad": alpha, "beta_rad": beta, "status": "measured"})


def settle(rng: np.random.Generator) -> list[Asked]:
    """One campaign; [] where the earlier tows did not settle."""
    hull, usual, length, ahead = HULLS[("frigate", "MARINER")[int(rng.integers(2))]]
    usual = replace(usual, rudder_rad=float(np.radians(rng.uniform(4, 20)) * rng.choice([-1, 1])))
    t_s = np.arange(0, LONGEST_S, 1 / RATE_HZ)
    points = np.sort(rng.uniform(*ahead, 40))
    points = [p for p in points if decays(hull, replace(usual, tow_point_m=float(p))) > LEAST_DECAY]
    points = [p for p in points if np.abs(rest_of(hull, replace(usual, tow_point_m=float(p)))).max() < WIDEST_RAD]
    many = int(rng.integers(2, 5))
    if len(points) < many:
        return []
    chosen = rng.permutation(np.array(points)[np.linspace(0, len(points) - 1, many).astype(int)])
    before: list[SteadyState] = []
    asked: list[Asked] = []
    for number, point in enumerate(chosen):
        stated = replace(usual, tow_point_m=float(point))
        run = run_of(f"tow-{number}", stated, length)
        priors = run.file.priors
        true = replace(stated, tow_point_m=float(point + priors.tow_point_sd_m * rng.normal()))
        if true.tension_n is not None:
            true = replace(true, tension_n=true.tension_n * (1 + priors.tension_sd_rel * rng.normal()))
        elif true.resistance_n is not None:
            true = replace(true, resistance_n=true.resistance_n * (1 + priors.tension_sd_rel * rng.normal()))
        last = number == many - 1
        aside = np.radians(rng.uniform(1, 10)) * rng.choice([-1, 1]) if last else 0.0
        try:
            angles = swum(hull, true, float(aside), t_s) + noise(rng, len(t_s))
        except TowlineError:  # let go so far aside that the line no longer steers it
            return []
        if not last:
            try:
                before.append(steady_state(run, motion_of(t_s, angles), None))
            except UnsettledError:
                return []
            continue
        for until_s in ASKED_S:
            part = t_s < until_s
            now = settling(run, motion_of(t_s[part], angles[part]), None)
            found = neutral_point(now, before)
            if found.x_v_m is None or found.interval_m is None:
                continue
            x_v = hull.n_v / hull.y_v
            off, (low, high) = found.x_v_m.value - x_v, found.interval_m
            asked.append(
                Asked(until_s, off / found.x_v_m.std, found.x_v_m.std, low <= x_v <= high, now.settled, found.stands)
            )
    return asked


def settles(count: int, seed: int) -> None:
    """Print the table."""
    made = [settle(np.random.default_rng([seed, number])) for number in range(count)]
    made = [one for one in made if one]
    every = [a for one in made for a in one]
    print(
        f"X_v of {len(made)} steady tows as they settle, by simulated tows (two to four tow points, noise of 0.01 to 0.2"
    )
    print("degrees, 0.1 to 2 s), asked again and again while they settle")
    print(f"{'':26}{'answers':>8}{'z rms':>7}{'95 %':>7}{'median sd, mm':>15}")

    def row(name: str, some: list[Asked]) -> None:
        if some:
            z, inside = np.array([a.z for a in some]), np.mean([a.inside for a in some])
            sd = 1e3 * np.median([a.std_m for a in some])
            print(f"{name:26}{len(some):8d}{np.sqrt(np.mean(z**2)):7.2f}{100 * inside:6.0f}%{sd:15.2f}")

    for t_s in ASKED_S:
        row(f"after {t_s:.0f} s, settling", [a for a in every if a.t_s == t_s and not a.settled])
        row(f"after {t_s:.0f} s, settled", [a for a in every if a.t_s == t_s and a.settled])
    row("settling", [a for a in every if not a.settled])
    row("settled", [a for a in every if a.settled])
    first = [next((a for a in one if a.stands), None) for one in made]
    row("when first said to stand", [a for a in first if a is not None])
    stood = [a.t_s for a in first if a is not None]
    print(f"said to stand in {len(stood)} of {len(made)}, after {np.median(stood):.0f} s (median)")
    shrunk = [one[-1].std_m / a.std_m for one, a in zip(made, first, strict=True) if a is not None]
    print(
        f"what was left of the sd at 60 s where it had been said to stand: least {min(shrunk):.2f}, median {np.median(shrunk):.2f}"
    )


__all__ = ["settle", "settles"]
