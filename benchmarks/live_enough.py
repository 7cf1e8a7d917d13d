"""Days of simulated tows with a wish: does "enough" come when it is true?

Each day has a hull of its own (within +- 20 % of what plan.toml guesses, even) and a wish between 1.4 and 4 %. The tows are those
that ``Day`` names as the ones that help most; their motions come from ``surge_cases``, which shares nothing with the product, with
white noise, datum biases, and every stated number wrong by what is stated of it. True is: the standard deviations of the six by
the Cramer-Rao bound at the true numbers, from slopes by finite differences of those motions, are within the wish.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from surge_cases import (
    GROWTH_1_S,
    LENGTH_M,
    LINE_M,
    MARINER,
    MASS_KG,
    NAMES,
    POINTS_M,
    RESISTANCE_N,
    SPEED_M_S,
    Array,
    growth,
    rigid_tows,
)

from towline.identify.plan import TowPlan
from towline.live.tows import Day

RATE_HZ, WAY_M, WIDTH_M, MOST = 30.0, 60.0, 4.6, 8
Y_SD_M, BETA_SD_RAD = 1e-3, float(np.radians(0.1))
BIAS_M, BIAS_RAD = 2e-3, float(np.radians(0.2))
COMMON = {"tension": 0.003, "line": 5e-4, "speed": 1e-3}
OWN = {"tension": 0.002, "point": 5e-4}
ALONG = {
    "x_udot": (-0.05 * MASS_KG, 0.03 * MASS_KG),
    "x_vr": (0.45 * MASS_KG, 0.26 * MASS_KG),
    "x_vv": (-0.4 * MASS_KG / LENGTH_M, 1.2 * MASS_KG / LENGTH_M),
    "x_rr": (0.0, 0.02 * MASS_KG * LENGTH_M),
    "power": (1.85, 0.1),
}
"""Mean and standard deviation, as [priors.surge] of run.toml has them where nothing is said."""
NORMAL_95 = 1.959964
WISHES = (1.4, 4.0)

PLAN = """
[tank]
length_m = {length}
lost_m = 17.0
width_m = {width}
speeds_m_s = [{speed}]
[model]
length_pp_m = {lbp}
mass_kg = {mass}
[guess.dimensional]
speed_m_s = {speed}
{guess}
[choices]
tension_n = {tension}
tension_speed_m_s = {speed}
tow_points_m = {points}
line_lengths_m = [{line}]
releases_y_m = [0.12, 0.2]
releases_beta_rad = [0.0]
[wish]
percent = {percent:.3f}
[priors]
{priors}
"""
RUN = """
name = "{name}"
[source]
motion = "motion.csv"
[tow]
speed_m_s = {speed}
line_length_m = {line}
tow_point_m = {point}
tension_n = {tension:.5f}
[model]
length_pp_m = {lbp}
mass_kg = {mass}
[water]
density_kg_m3 = 1000.0
[priors]
{priors}
"""
PRIORS = "\n".join(
    f"{key} = {value}"
    for key, value in (
        ("tension_common_sd_rel", COMMON["tension"]),
        ("tension_sd_rel", OWN["tension"]),
        ("tow_point_sd_m", OWN["point"]),
        ("line_length_sd_m", COMMON["line"]),
        ("speed_sd_rel", COMMON["speed"]),
    )
)


@dataclass
class Hall:
    """What is true of a day.

    Attributes
    ----------
    true : numbers of ``rigid_tows`` that all tows share
    gauge : the tension's reading over what is there, common to all
    information : (13, 13) that the tows so far hold on the six and on what is common, both relative or in standard deviations
    """

    rng: np.random.Generator
    true: dict[str, float]
    gauge: float
    information: Array = field(default_factory=lambda: np.diag([0.0] * 6 + [1.0] * (len(COMMON) + len(ALONG))))


@dataclass(frozen=True)
class Sequence:
    """How a day went.

    Attributes
    ----------
    wish : percent
    true_at : tows after which it was true; None: not within the day
    said_at : tows after which it was said
    off : of each derivative, in percent of it, when it was said
    bound, stated : half-widths in percent when it was said, largest of the six: true, and as the fit has it
    seconds : of the judgement after a tow, longest
    """

    wish: float
    true_at: int | None
    said_at: int | None
    off: Array
    bound: float
    stated: float
    seconds: float


def hall_of(rng: np.random.Generator) -> Hall:
    """A hull, what is true of line and carriage, and a gauge."""
    while True:
        six = {name: value * (1 + 0.2 * float(rng.uniform(-1, 1))) for name, value in MARINER.items()}
        if max(growth(six, x) for x in (POINTS_M[0], POINTS_M[-1])) < GROWTH_1_S:
            break
    while True:
        along = {name: mean + sd * float(rng.normal()) for name, (mean, sd) in ALONG.items()}
        if along["x_udot"] < 0:
            break
    true = {
        **six,
        **along,
        "speed_ref": SPEED_M_S,
        "mass_kg": MASS_KG,
        "resistance_n": RESISTANCE_N * (1 + 0.05 * float(rng.normal())),
        "speed_m_s": SPEED_M_S * (1 + COMMON["speed"] * float(rng.normal())),
        "line_m": LINE_M + COMMON["line"] * float(rng.normal()),
    }
    return Hall(rng, true, 1 + COMMON["tension"] * float(rng.normal()))


def times_s() -> Array:
    """Of a tow's samples."""
    return np.arange(round(RATE_HZ * WAY_M / SPEED_M_S)) / RATE_HZ


def towed(numbers: list[Mapping[str, float]]) -> Array:
    """Motions (n, samples, 2): y and beta."""
    found = rigid_tows({name: np.array([n[name] for n in numbers]) for name in numbers[0]}, times_s())
    return np.stack([found.y_m, found.beta_rad], axis=2)


def tow(hall: Hall, plan: TowPlan, folder: Path) -> None:
    """Tow as planned, write the run folder, and add to what is known by the truth's own slopes."""
    rng, true = hall.rng, hall.true
    point = plan.tow_point_m + OWN["point"] * float(rng.normal())
    release = float(np.arcsin(plan.release_y_m / plan.line_length_m))
    numbers = {**true, "tow_point_m": point, "release_rad": release}
    numbers |= {"release_beta_rad": 0.0, "release_v_m_s": 0.0, "release_r_rad_s": 0.0}
    steps = steps_of(true)
    moved = [numbers]
    for name, step in steps.items():
        moved += [{**numbers, name: numbers[name] + step}, {**numbers, name: numbers[name] - step}]
    motions = towed(moved)
    motion = motions[0] + rng.normal(size=(len(motions[0]), 2)) * [Y_SD_M, BETA_SD_RAD]
    motion += rng.normal(size=2) * [BIAS_M, BIAS_RAD]
    slopes = {name: (motions[1 + 2 * i] - motions[2 + 2 * i]) / (2 * s) for i, (name, s) in enumerate(steps.items())}
    hall.information = hall.information + told(true, slopes)
    straight = true["resistance_n"] * (true["speed_m_s"] / SPEED_M_S) ** true["power"]
    tension = straight * hall.gauge * (1 + OWN["tension"] * float(rng.normal()))
    folder.mkdir(parents=True)
    text = RUN.format(
        name=folder.name,
        speed=SPEED_M_S,
        line=LINE_M,
        point=plan.tow_point_m,
        tension=tension,
        lbp=LENGTH_M,
        mass=MASS_KG,
        priors=PRIORS,
    )
    (folder / "run.toml").write_text(text, encoding="utf-8")
    table = {"t_s": times_s(), "y_cg_m": motion[:, 0], "beta_rad": motion[:, 1]}
    table |= {"sigma_y_cg_m": Y_SD_M, "sigma_beta_rad": BETA_SD_RAD}
    pd.DataFrame(table).to_csv(folder / "motion.csv", index=False, float_format="%.9g")


def steps_of(true: Mapping[str, float]) -> dict[str, float]:
    """Of the finite differences: small against what bends, large against the integrator's own error (1e-8 m)."""
    steps = {name: 3e-3 * abs(true[name]) for name in NAMES}
    steps |= {"resistance_n": 3e-3 * true["resistance_n"], "line_m": 1e-3, "speed_m_s": 2e-3}
    steps |= {name: 0.1 * sd for name, (_, sd) in ALONG.items()}
    return steps | {
        "tow_point_m": 1e-3,
        "release_rad": 2e-3,
        "release_beta_rad": 2e-3,
        "release_v_m_s": 1e-3,
        "release_r_rad_s": 1e-3,
    }


def told(true: Mapping[str, float], slopes: Mapping[str, Array]) -> Array:
    """Information of a tow on the six (relative) and on what is common (in its standard deviations); its own numbers are unknown,
    or known as is stated of them."""
    common = {"resistance_n": COMMON["tension"] * true["resistance_n"], "line_m": COMMON["line"]}
    common |= {"speed_m_s": COMMON["speed"] * SPEED_M_S} | {name: sd for name, (_, sd) in ALONG.items()}
    # the gauge reads what is there at the true speed: with another speed the same reading is another R
    with_speed = slopes["speed_m_s"] - true["power"] * true["resistance_n"] / SPEED_M_S * slopes["resistance_n"]
    moved = {**slopes, "speed_m_s": with_speed}
    rows = [slopes[name] * true[name] for name in NAMES] + [moved[name] * sd for name, sd in common.items()]
    own = [slopes["resistance_n"] * true["resistance_n"] * OWN["tension"], slopes["tow_point_m"] * OWN["point"]]
    free = [slopes[f"release{name}"] for name in ("_rad", "_beta_rad", "_v_m_s", "_r_rad_s")]
    ones = [np.broadcast_to(unit, rows[0].shape) for unit in np.eye(2)]
    whole = np.array([*rows, *own, *free, *ones]) / [Y_SD_M, BETA_SD_RAD]
    flat = whole.reshape(len(whole), -1)
    matrix = flat @ flat.T
    known, beside = len(rows), len(rows) + len(own)
    matrix[range(known, beside), range(known, beside)] += 1.0
    cross = matrix[:known, known:]
    return matrix[:known, :known] - cross @ np.linalg.solve(matrix[known:, known:], cross.T)


def half_widths(hall: Hall) -> Array:
    """Of the six by the bound, in percent, (6,)."""
    return 100 * NORMAL_95 * np.sqrt(np.diag(np.linalg.inv(hall.information)))[:6]


def sequence(folder: Path, seed: int, number: int) -> Sequence:
    """A day: tow, be judged, tow what helps most, until it is enough, or the tank is closed."""
    rng = np.random.default_rng([seed, number])
    hall = hall_of(rng)
    wish = float(np.exp(rng.uniform(*np.log(WISHES))))
    plan = folder / "plan.toml"
    folder.mkdir(parents=True)
    numbers: dict[str, Any] = {"length": WAY_M + 17.0, "width": WIDTH_M, "speed": SPEED_M_S, "lbp": LENGTH_M}
    numbers |= {"mass": MASS_KG, "tension": RESISTANCE_N, "points": list(POINTS_M), "line": LINE_M, "priors": PRIORS}
    guess = "\n".join(f"{name} = {value}" for name, value in MARINER.items())
    plan.write_text(PLAN.format(guess=guess, percent=wish, **numbers), encoding="utf-8")
    day = Day(plan)
    day.prepare()
    ahead, true_at, longest = day.after([]).next_tow, None, 0.0
    true = np.array([hall.true[name] for name in NAMES])
    folders: list[Path] = []
    while len(folders) < MOST and ahead is not None:
        folders.append(folder / f"tow-{len(folders) + 1:02d}")
        tow(hall, ahead.plan, folders[-1])
        widths = half_widths(hall)
        if true_at is None and (widths <= wish).all():
            true_at = len(folders)
        began = time.perf_counter()
        standing = day.after(folders)
        longest = max(longest, time.perf_counter() - began)
        if standing.enough and standing.result is not None:
            found = np.array([standing.result.derivatives[name].value for name in NAMES])
            stated = max(float(w.percent or np.inf) for w in standing.wishes)
            off = 100 * np.abs(found / true - 1)
            return Sequence(wish, true_at, len(folders), off, float(widths.max()), stated, longest)
        ahead = standing.next_tow
    return Sequence(wish, true_at, None, np.full(6, np.nan), float(half_widths(hall).max()), np.nan, longest)


def judge(scratch: Path, count: int, seed: int) -> None:
    """Print the table."""
    print(
        f'"enough" in {count} days of simulated tows, each with a wish (half-width of the 95 % interval of all six, %)'
    )
    print(f"{'day':>4}{'wish':>7}{'true after':>11}{'said after':>11}{'bound':>7}{'stated':>7}{'largest error':>14}  s")
    made: list[Sequence] = []
    for number in range(count):
        one = sequence(scratch / f"day-{number:02d}", seed, number)
        made.append(one)
        print(
            f"{number:4d}{one.wish:7.2f}{one.true_at or '-':>11}{one.said_at or '-':>11}{one.bound:7.2f}{one.stated:7.2f}"
            f"{one.off.max():14.2f}{one.seconds:5.1f}",
            flush=True,
        )
    said = [one for one in made if one.said_at is not None]
    never = MOST + 1
    early = [one for one in said if one.true_at is None]
    late = [(one.said_at or never) - (one.true_at or never) for one in made if one not in early]
    print("after it is true, tows:", ", ".join(f"{d}: {late.count(d)}" for d in sorted(set(late))), end="; ")
    print(f"before it is true by the bound: {len(early)} ({', '.join(map(_over, early))})")
    print(f"at most one tow after it is true: {sum(d <= 1 for d in late) + len(early)} of {count}")
    off = [one for one in said if (one.off > one.wish).any()]
    print(f"said while one of the six is off by more than the wish, by the truth: {len(off)} of {len(said)}; ", end="")
    print(f"of those said before it is true by the bound: {sum((one.off > one.wish).any() for one in early)}")
    each = np.concatenate([one.off / one.wish for one in said])
    print(f"of the derivatives, {(each > 1).sum()} of {len(each)}")


def _over(one: Sequence) -> str:
    return f"{one.bound:.2f} %, wished {one.wish:.2f} %"


__all__ = ["judge", "sequence"]
