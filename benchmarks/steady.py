"""Is a tow steady? Swinging and settled tows under coloured noise, by two simulators; X_v from swings that are let pass; stability.

    python benchmarks/steady.py [--tows 100] [--only swinging settled passed stability]

Writes a table to standard output; benchmarks/steady.txt is a run of it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import fsolve
from scipy.signal import lfilter

from towline.blind.truth.hulls import MARINER as TOWED
from towline.blind.truth.motion import swim
from towline.identify.bracket import bracket_words, neutral_bracket
from towline.identify.report import tow_stability
from towline.identify.settled import SMALL_FORCE, SMALL_SHARE, tail_mean
from towline.identify.steady import UnsettledError, fit_steady, judged_tow, stands_off, steady_state
from towline.record import EstimationError
from towline.record.run import Run
from towline.record.schema import RunFile
from towline.record.toml import check_tables
from towline.simulate import Hull, Start, Tow, linear_system, simulate_full
from towline.simulate.model import full_rates

MARINER = Hull(
    149.19,
    62.11,
    -52.87,
    -66.33,
    -48.51,
    -57.60,
    speed_m_s=1.28,
    y_delta=-2.0,
    n_delta=2.4,
    mass_kg=78.0,
    x_udot_kg=-4.0,
)
"""The ITTC derivatives of Table 8.2; the rudder's are ours."""
FRIGATE = Hull(4.655, 0.3519, -6.804, -1.00, -1.490076, -0.9457, speed_m_s=0.725, y_delta=0.5, n_delta=-0.25425)
"""Of sample_videos/leander_steady: it settles."""
TOW = Tow(1.28, 0.91, 1.5, 3.96, rudder_rad=np.radians(-15.0))
FRIGATE_TOW = Tow(0.725, 0.71, 0.5, None, 0.50, rudder_rad=-0.28)
TAUT = {name: TOWED[name] for name in ("surge_mass", "power", "stiffness_n_m", "line_damping")}
POINTS_M = (1.446, 1.548, 1.649, 1.751)
LENGTH_M = {MARINER: 2.66, FRIGATE: 1.13}
RATE_HZ = 25.0
KINDS = ("white", "0.2-1 s", "1-3 s", "shake", "repeated")
LET_PASS = 0.6
BINS = (0.0, 0.5, 1.0, 2.0, 4.0, np.inf)


def noise(rng: np.random.Generator, t_s: np.ndarray) -> tuple[np.ndarray, str]:
    """Errors of alpha and beta (n, 2), rad: 0.01 to 0.2 degrees, of one of five colours."""
    n, sd = len(t_s), np.radians(10 ** rng.uniform(-2, -0.7))
    kind = KINDS[rng.integers(5)]
    white = rng.normal(size=(n, 2))
    if kind == "0.2-1 s":
        found = coloured(rng, n, rng.uniform(0.2, 1))
    elif kind == "1-3 s":
        found = 0.7 * white + 0.7 * coloured(rng, n, rng.uniform(1, 3))
    elif kind == "shake":
        phase = 2 * np.pi * rng.uniform(0.6, 3) * t_s + coloured(rng, n, 5.0)[:, 0]
        found = 0.5 * white + np.sin(phase)[:, None]
    elif kind == "repeated":  # a codec repeats a mark's picture and its error
        hold = int(rng.integers(4, 12))
        found = 0.8 * white[(np.arange(n) // hold) * hold] + 0.3 * rng.normal(size=(n, 2))
    else:
        found = white
    return sd * found * [1.0, 0.5], kind


def coloured(rng: np.random.Generator, n: int, time_s: float) -> np.ndarray:
    """First-order noise of unit variance, (n, 2)."""
    fall = np.exp(-1 / RATE_HZ / time_s)
    fresh = rng.normal(size=(n, 2)) * np.sqrt(1 - fall**2)
    fresh[0] /= np.sqrt(1 - fall**2)
    return lfilter([1.0], [1.0, -fall], fresh, axis=0)


def at_rest(hull: Hull, tow: Tow) -> np.ndarray:
    """Steady alpha and beta, (2,), rad."""

    def rates(angles: np.ndarray) -> np.ndarray:
        return full_rates(0.0, np.array([*angles, -tow.speed_m_s * np.sin(angles[1]), 0.0]), hull, tow)[2:]

    return fsolve(rates, [0.3, 0.03], xtol=1e-13)


def angles_of(hull: Hull, tow: Tow, aside_rad: float, t_s: np.ndarray, other_code: bool) -> np.ndarray:
    """alpha and beta (n, 2) of a tow let go ``aside_rad`` of alpha off its rest."""
    rest = at_rest(hull, tow)
    alpha, beta = rest[0] + aside_rad, rest[1]
    if not other_code:
        start = Start(alpha_rad=alpha, beta_rad=beta, v_m_s=-tow.speed_m_s * np.sin(beta))
        return simulate_full(hull, tow, start, t_s)[["alpha_rad", "beta_rad"]].to_numpy()
    assert tow.tension_n is not None
    lane = {
        **TAUT, "x_t": tow.tow_point_m, "line": tow.line_length_m, "tension": tow.tension_n, "speed": tow.speed_m_s,
        "speed_ref": tow.speed_m_s,
        "m": hull.m_minus_y_vdot, "i": hull.i_minus_n_rdot, "y_v": hull.y_v, "y_r": hull.y_r_minus_mu,
        "n_v": hull.n_v, "n_r": hull.n_r, "duration": t_s[-1], "beta_release": beta,
        "y_release": tow.line_length_m * np.sin(alpha) - tow.tow_point_m * np.sin(beta),
    }  # fmt: skip
    step = 0.02
    force = np.array([hull.y_delta, hull.n_delta]) * tow.rudder_rad
    steady = np.broadcast_to(force[None, :, None], (2 * int(np.ceil(t_s[-1] / step)) + 3, 2, 1))
    x, y, found = swim([lane], float(t_s[-1]), steady, step).at(t_s, 0, (0, 1, 2)).T
    return np.column_stack(
        [
            np.arctan2(y + tow.tow_point_m * np.sin(found), -x - tow.tow_point_m * np.cos(found)),
            found,
        ]
    )


def run_of(hull: Hull, tow: Tow, name: str = "tow") -> Run:
    """A run that comes with its motion."""
    table = {
        "speed_m_s": tow.speed_m_s,
        "line_length_m": tow.line_length_m,
        "tow_point_m": tow.tow_point_m,
        "line": tow.line,
    }
    if tow.tension_n is not None:
        table["tension_n"] = tow.tension_n
    tables = {
        "name": name, "source": {"motion": "motion.csv"}, "tow": table, "water": {},
        "model": {"length_pp_m": LENGTH_M[hull], "mass_kg": 78.0},
    }  # fmt: skip
    return Run(Path(), check_tables(tables, RunFile, Path("run.toml")))


def motion_of(t_s: np.ndarray, angles: np.ndarray) -> pd.DataFrame:
    """As ``record.read_motion`` gives it."""
    alpha, beta = angles.T
    return pd.DataFrame({"t_s": t_s, "y_cg_m": 0.1, "alpha_rad": alpha, "beta_rad": beta, "status": "measured"})


@dataclass(frozen=True)
class Swung:
    """A tow that swings: its motion, and its swing's size over the smallest that matters."""

    run: Run
    motion: pd.DataFrame
    matters: float
    kind: str
    size_rad: float
    root: complex


def smallest(slope: float, force: float, error: np.ndarray, omega: float, span_s: float) -> float:
    """Amplitude of alpha + beta, rad, whose mean over the record may move F by what a steady tow allows, at the worst phase.

    A mean of A cos(w t + p) over W is 2 A/(w W) at most. F may move by half of its standard deviation, or by a thousandth: n tows
    that each err so much in F move X_v by half of its own standard deviation times the square root of n at most.
    """
    _, covariance = tail_mean(error)
    sd = slope * np.sqrt(covariance.sum())
    return max(SMALL_SHARE * sd, SMALL_FORCE * abs(force)) / slope * omega * span_s / 2


def swung(seed: int, other_code: bool, low: float, high: float) -> Swung:
    """A random swinging MARINER tow; size log-uniform from ``low`` to ``high`` times what matters, 12 degrees at most."""
    rng = np.random.default_rng([seed, int(other_code)])
    point, rudder = float(rng.choice(POINTS_M)), float(np.radians(rng.uniform(-20, -4)))
    # the other program's lines keep their length
    tow = replace(TOW, tow_point_m=point, rudder_rad=rudder, line="surge" if other_code else TOW.line)
    t_s = np.arange(0.0, rng.uniform(25, 60), 1 / RATE_HZ)
    root = swing_root(MARINER, tow)
    error, kind = noise(rng, t_s)
    rest = at_rest(MARINER, tow).sum()
    least = smallest(np.cos(rest), np.sin(rest), error, root.imag, t_s[-1])
    trial = angles_of(MARINER, tow, 0.01, t_s, False).sum(axis=1)
    # what is let go aside swings by less: the slow and the fast root take their share
    per_rad = float(np.sqrt(2) * np.std(trial[t_s > t_s[-1] - 2 * np.pi / root.imag])) / 0.01
    size = min(least * np.exp(rng.uniform(np.log(low), np.log(high))), np.radians(12.0))
    angles = angles_of(MARINER, tow, size / per_rad, t_s, other_code)
    motion = motion_of(t_s, angles + error)
    return Swung(run_of(MARINER, tow), motion, size / least, kind, size, root)


def swing_root(hull: Hull, tow: Tow) -> complex:
    """The oscillatory root about the tow's own rest, imaginary part above 0, 1/s."""
    alpha, beta = at_rest(hull, tow)
    rest = np.array([alpha, beta, -tow.speed_m_s * np.sin(beta), 0.0])
    steps = 1e-6 * np.eye(4)
    columns = [full_rates(0.0, rest + d, hull, tow) - full_rates(0.0, rest - d, hull, tow) for d in steps]
    roots = np.linalg.eigvals(np.column_stack(columns) / 2e-6)
    return complex(max(roots, key=lambda s: s.imag))


def swinging(tows: int) -> None:
    """How many are refused, by their size over the smallest swing that matters."""
    print(f"\n== swinging: MARINER, rudder 4-20 degrees, 25-60 s, noise of {', '.join(KINDS)}, 0.01-0.2 degrees")
    print("refused of tows, by the swing over the smallest that matters")
    print(f"{'':24}" + "".join(f"{f'{a:g}-{b:g}':>14}" for a, b in pairwise(BINS)))
    for other_code in (False, True):
        name = "blind/truth/motion.swim" if other_code else "simulate_full"
        counts = np.zeros((len(BINS) - 1, 2), dtype=int)
        sizes = []
        for seed in range(tows):
            tow = swung(seed, other_code, 2.0, 200.0)
            sizes.append(np.degrees(tow.size_rad))
            tell(counts, tow)
        for seed in range(tows, tows + tows // 2):
            tell(counts, swung(seed, other_code, 0.25, 2.0))
        print(f"{name:24}" + "".join(f"{f'{a} of {b}':>14}" for a, b in counts))
        bad = counts[-2:].sum(axis=0)
        print(
            f"{'':24}swings of {min(sizes):.3f}-{max(sizes):.1f} degrees that matter twofold and more: {bad[0]} of {bad[1]} refused"
        )


def tell(counts: np.ndarray, tow: Swung) -> None:
    """Count one."""
    place = int(np.searchsorted(BINS, tow.matters, side="right")) - 1
    try:
        steady_state(tow.run, tow.motion, None)
    except UnsettledError:
        counts[place, 0] += 1
    counts[place, 1] += 1


def settled(tows: int) -> None:
    """How many at rest are refused: from the first frame on, and after a swing that has died out; are their means true?"""
    print("\n== settled, the same noise")
    for name in ("MARINER at rest", "frigate let go 3-12 degrees off"):
        refused, z = {}, []
        for seed in range(tows):
            rng = np.random.default_rng([seed, 2])
            mariner = name.startswith("MARINER")
            t_s = np.arange(0.0, rng.uniform(25, 60) if mariner else rng.uniform(60, 90), 1 / RATE_HZ)
            hull, base = (MARINER, TOW) if mariner else (FRIGATE, FRIGATE_TOW)
            points = POINTS_M if mariner else (0.44, 0.48, 0.52, 0.56)
            tow = replace(base, tow_point_m=float(rng.choice(points)))
            aside = 0.0 if mariner else -np.radians(rng.uniform(3, 12))
            error, kind = noise(rng, t_s)
            angles = angles_of(hull, tow, aside, t_s, False)
            try:
                found = steady_state(run_of(hull, tow), motion_of(t_s, angles + error), None)
            except UnsettledError:
                refused[kind] = refused.get(kind, 0) + 1
                continue
            truth = at_rest(hull, tow)
            z.append((np.array([found.alpha_rad, found.beta_rad]) - truth) / np.sqrt(np.diag(found.covariance)))
        spread = np.sqrt(np.mean(np.square(z), axis=0))
        print(
            f"{name:36}{sum(refused.values())} of {tows} refused {refused or ''}; z of alpha, beta rms {spread.round(2)}"
        )


def passed(tows: int) -> None:
    """X_v from four tows that swing by less than what matters and are let pass: do its intervals hold?"""
    z = []
    refused = 0
    for seed in range(tows // 2):
        states = []
        for k, point in enumerate(POINTS_M):
            rng = np.random.default_rng([seed, k, 3])
            tow = replace(TOW, tow_point_m=point)
            t_s = np.arange(0.0, 45.0, 1 / RATE_HZ)
            error = np.radians(0.1) * coloured(rng, len(t_s), 0.5) * [1.0, 0.5]
            rest = at_rest(MARINER, tow)
            omega = swing_root(MARINER, tow).imag
            size = LET_PASS * smallest(np.cos(rest.sum()), np.sin(rest.sum()), error, omega, t_s[-1])
            # beta swings against alpha by a quarter: alpha + beta by ``size``
            wave = np.cos(omega * t_s + rng.uniform(0, 2 * np.pi))[:, None] * size / 0.75 * [1.0, -0.25]
            try:
                found = steady_state(run_of(MARINER, tow, f"x{point}"), motion_of(t_s, rest + wave + error), None)
            except UnsettledError:
                refused += 1
                continue
            states.append(found)
        try:
            x_v = fit_steady(states).x_v_m
        except EstimationError:
            continue
        z.append((x_v.value - MARINER.x_v_m) / x_v.std)
    print(f"\n== swings of {LET_PASS} times the size that matters, noise 0.1 degrees of 0.5 s: X_v of four tows")
    share = 100 * np.mean(np.abs(z) < 1.96)
    print(f"{refused} of {4 * (tows // 2)} tows refused; {len(z)} campaigns: z rms {np.sqrt(np.mean(np.square(z))):.2f}, "
          f"{share:.0f} % of 95 % intervals hold")  # fmt: skip


def stability(tows: int) -> None:
    """lambda against the truth, and the bracket of X_v."""
    z = []
    for seed in range(tows):
        tow = swung(seed, False, 10.0, 30.0)
        if tow.size_rad > np.radians(5.0):
            continue
        found = judged_tow(tow.run, tow.motion, None).stability
        if found.lambda_per_s is not None and found.lambda_sd_per_s:
            z.append((found.lambda_per_s - tow.root.real) / found.lambda_sd_per_s)
    print("\n== stability from the record alone")
    print(f"lambda of {len(z)} MARINER tows that swing by 5 degrees or less: z median {np.median(z):+.2f}, "
          f"{100 * np.mean(np.abs(z) < 2):.0f} % within 2 sd, {100 * np.mean(np.abs(z) < 3):.0f} % within 3")  # fmt: skip
    print(f"a frigate (X_v {FRIGATE.x_v_m:.3f} m) without rudder, let go 3 degrees aside, 0.03 degrees of noise:")
    seen, standing = {}, []
    for point in (0.10, 0.14, 0.18, 0.20, 0.26, 0.32, 0.38, 0.44):
        rng = np.random.default_rng([int(1000 * point), 4])
        tow = replace(FRIGATE_TOW, tow_point_m=point, rudder_rad=-0.28 if point > 0.4 else 0.0)
        t_s = np.arange(0.0, 60.0, 1 / RATE_HZ)
        angles = until(tow, t_s)
        angles = angles + np.radians(0.03) * rng.normal(size=angles.shape)
        run = run_of(FRIGATE, tow, f"x{point:g}")
        found = judged_tow(run, motion_of(t_s[: len(angles)], angles), None)
        true = np.linalg.eigvals(linear_system(FRIGATE, replace(tow, tension_n=0.5, resistance_n=None))[0]).real.max()
        print(
            f"  X_T {point:.2f} m, {len(angles) / RATE_HZ:5.1f} s: {found.stability.words} (largest root {true:+.4f})"
        )
        seen[run.name] = tow_stability(run, found.stability)
        try:
            state = steady_state(run, motion_of(t_s[: len(angles)], angles), None)
            standing += [state.name] if stands_off(state) else []
        except UnsettledError:
            pass
    bracket = neutral_bracket(seen, standing_off=standing)
    print(f"  {bracket_words(bracket)}" if bracket is not None else "  no bracket")


def until(tow: Tow, t_s: np.ndarray) -> np.ndarray:
    """The frigate's angles until alpha passes 60 degrees."""
    while True:
        try:
            found = simulate_full(FRIGATE, tow, Start(alpha_rad=np.radians(3.0)), t_s)[
                ["alpha_rad", "beta_rad"]
            ].to_numpy()
        except Exception:
            t_s = t_s[: int(0.95 * len(t_s))]
            continue
        past = np.flatnonzero(np.abs(found[:, 0]) > np.radians(60))
        return found[: past[0]] if len(past) else found


PARTS = {"swinging": swinging, "settled": settled, "passed": passed, "stability": stability}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tows", type=int, default=100)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    given = parser.parse_args()
    for name in given.only:
        PARTS[name](given.tows)


if __name__ == "__main__":
    main()
