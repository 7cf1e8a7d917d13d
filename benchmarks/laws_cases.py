"""Campaigns of the laws' benchmark: laws in no library, faults of camera, clock and single events, nulls; and tows beyond them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from towline.blind.draw import gentle
from towline.blind.one_case import case_of, tow_of
from towline.blind.signature import distances_of, linear
from towline.blind.truth.cases import Case
from towline.blind.truth.laws import KINDS

LOW_D, HIGH_D = 50.0, 5000.0
"""Of the laws, after the derivatives are refitted."""
AHEAD_SHARE, AHEAD_KINDS = 0.15, (0, 1, 5, 10)
"""So many laws are of surge: one term, an even power or something at a place, that holds the model back or pushes it."""
HEEL_SHARE, HEEL_KINDS = 0.12, (0, 1, 2, 3, 4, 8)
"""So many laws are of roll: one term of drift and yaw rate that heels the model; it has a roll of its own."""
SIDE_N = 0.02
"""First size of a term; D then says how large it is."""
FAULTS = (
    "lens_distortion", "deck_height", "camera_shift", "datum_scale", "datum_bias", "marker_roll", "frame_rate",
    "rolling_shutter", "kick", "new_mass", "slack_line", "vibration",
)  # fmt: skip
"""Faults of camera and clock, and what happens once; none of them is a force that goes with the hull's state."""
IN_NO_LIBRARY = ("kick", "new_mass", "vibration")
WIDER, FASTER = 1.5, 0.85
"""A tow beyond those that are fitted: its release, over the largest of them, and another's speed, over the usual one."""


SIZES = ("side", "turn", "alon", "lean")
"""How the names of a law's sizes begin."""


def law_case(name: str, seed: list[int]) -> Case:
    """A campaign with a law of one or two terms whose D is drawn evenly in its logarithm."""
    case = case_of(name, "null", [], seed, coloured=bool(seed[-1] % 2))
    rng = np.random.default_rng([*seed, 9])
    numbers: dict[str, float] = {}
    for k in range(1 if rng.random() < 0.6 else 2):
        kind = int(rng.integers(KINDS))
        where = rng.random()
        waves = (4.0, 30.0) if kind == 5 else (6.0, 30.0)
        numbers |= {
            f"law.kind{k}": kind,
            f"law.side{k}": SIDE_N * float(rng.choice([-1, 1])) if where < 0.7 else 0.0,
            f"law.turn{k}": SIDE_N * float(rng.uniform(-1.5, 1.5)) if where > 0.3 else 0.0,
            f"law.p{k}": float(rng.uniform(1.5, 4.0)) if kind != 2 else float(rng.choice([1.0, 2.0])),
            f"law.even{k}": float(rng.random() < 0.3),
            f"law.a{k}": float(rng.uniform(0.01, 0.06)) if kind in (3, 4) else float(rng.uniform(0.02, 0.08)),
            f"law.b{k}": float(rng.uniform(*waves)) if kind in (5, 6) else float(rng.choice([1.0, 2.0])) if kind == 2
            else float(rng.uniform(-0.5, 0.5)),
            f"law.phase{k}": float(rng.uniform(-np.pi, np.pi)) if kind in (5, 6) else float(rng.uniform(-0.1, 0.1)),
        }  # fmt: skip
    surge = np.random.default_rng([*seed, 10])
    if surge.random() < AHEAD_SHARE:
        kind = int(surge.choice(AHEAD_KINDS))
        numbers = {n: v for n, v in numbers.items() if n.endswith("0")} | {
            "law.kind0": kind, "law.side0": 0.0, "law.turn0": 0.0, "law.along0": SIDE_N * float(surge.choice([-1, 1])),
            "law.even0": 1.0, "law.a0": float(surge.uniform(0.02, 0.08)), "law.b0": float(surge.uniform(4.0, 30.0)),
            "law.phase0": float(surge.uniform(-np.pi, np.pi) if kind == 5 else surge.uniform(-0.1, 0.1)),
        }  # fmt: skip
    roll = np.random.default_rng([*seed, 13])
    if "law.along0" not in numbers and roll.random() < HEEL_SHARE:
        kind = int(roll.choice(HEEL_KINDS))
        numbers = {n: v for n, v in numbers.items() if n.endswith("0")} | {
            "law.kind0": kind, "law.side0": 0.0, "law.turn0": 0.0, "law.lean0": SIDE_N * float(roll.choice([-1, 1])),
            "law.p0": float(roll.choice([1.0, 2.0]) if kind == 2 else roll.uniform(1.5, 4.0)),
            "law.a0": float(roll.uniform(0.01, 0.06)),
            "law.b0": float(roll.choice([1.0, 2.0]) if kind == 2 else roll.uniform(-0.5, 0.5)),
            "marker_roll.period_s": float(roll.uniform(0.7, 1.8)),
            "marker_roll.damping": float(np.exp(roll.uniform(np.log(0.08), np.log(0.3)))),
        }  # fmt: skip
    case = gentle(replace(case, kind="unknown", effects=["law"], numbers=numbers))
    target = float(np.exp(rng.uniform(np.log(LOW_D), np.log(HIGH_D))))
    by = float(np.sqrt(target / max(distances_of(case, linear(case)).strength, 1e-9)))
    sized = {n: v * by if n[4:8] in SIZES else v for n, v in case.numbers.items()}
    case = gentle(replace(case, numbers=sized))
    # signatures are straight lines: D goes with the square of the size
    d = target if case.numbers == sized else distances_of(case, linear(case)).strength
    return replace(case, extra={"d": d})


def null_case(name: str, seed: list[int]) -> Case:
    """A campaign of nothing but noise; every second one with coloured forces."""
    return gentle(case_of(name, "null", [], seed, coloured=bool(seed[-1] % 2)))


def fault_case(name: str, seed: list[int]) -> Case:
    """A campaign with one of FAULTS, in turn, at a tank's size."""
    effect = FAULTS[seed[-1] % len(FAULTS)]
    kind = "unknown" if effect in IN_NO_LIBRARY else "effect"
    return gentle(case_of(name, kind, [effect], seed, coloured=bool(seed[-1] // len(FAULTS) % 2)))


def with_more(case: Case) -> Case:
    """The campaign with two tows more, for a look beyond: one released further out, one at another speed."""
    rng = np.random.default_rng([case.seed, 12])
    furthest = max(case.runs, key=lambda run: abs(run.stated["y_m"]))
    usual = min(case.runs, key=lambda run: abs(run.stated["line_m"] - case.hull["line"]))
    wide = {**furthest.stated, "y_m": round(WIDER * furthest.stated["y_m"], 4)}
    wide["beta_rad"] = WIDER * furthest.stated["beta_rad"]
    fast = {**usual.stated, "speed_m_s": round(FASTER * case.hull["speed_ref"], 4)}
    more = [tow_of(case.hull, {k: v for k, v in s.items() if k != "tension_n"}, rng) for s in (wide, fast)]
    return replace(case, runs=[*case.runs, *more])


__all__ = ["FAULTS", "fault_case", "law_case", "null_case", "with_more"]
