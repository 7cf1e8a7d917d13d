"""Gross mistakes of a run.toml, planted one at a time in random set-ups: named or not, and what is named where there is none.

    python benchmarks/mistakes.py [--cases 400] [--clean 200] [--seed 7] > benchmarks/mistakes.txt

Right: refused with a line that names the key, or named by ``find_mistakes``, as the first or among those said to explain the
set-up as well, with its keys and its kind. Ordinary faults (benchmarks/geometry_cases.py) and clean set-ups must have none named.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from geometry_cases import FAULTS, film, random_scene
from mistakes_cases import MISTAKES, Planted, SetUp, planted, random_set_up

from towline.geometry.checks.mistakes import Mistake, find_mistakes
from towline.record import InputError, Run, RunFile
from towline.record.toml import check_tables

FAULTY = 25
"""Cameras a fault of benchmarks/geometry_cases.py."""


def named(set_up: SetUp) -> tuple[str, tuple[Mistake, ...]]:
    """The key and words that run.toml is refused with ("" where it is read), and the mistakes."""
    try:
        file = check_tables(set_up.content, RunFile, Path("run.toml"))
    except InputError as error:
        return f"{error.where}: {error.message}", ()
    return "", find_mistakes(Run(Path("case"), file), set_up.tracks, set_up.size_px)


def right(case: Planted, refused: str, found: tuple[Mistake, ...]) -> tuple[bool, int]:
    """Whether the mistake is named, and how many others are named beside it (0: it alone, or it was refused)."""
    if refused:
        return any(
            refused.startswith(key.partition("[")[0].partition(".")[0]) and _same(refused, key) for key in case.keys
        ), 0
    for mistake in found:
        everyone = (mistake, *mistake.instead)
        for one in everyone:
            if _says(case, one):
                return True, len(everyone) - 1 + len(found) - 1
    return False, 0


def _same(refused: str, key: str) -> bool:
    return key.split(".")[-1].split("[")[0] in refused


def _says(case: Planted, one: Mistake) -> bool:
    if case.kind and one.kind not in case.kind:
        return False
    if "exchanged" in case.kind:
        return set(case.keys) == set(one.keys)
    return any(said.startswith(key) for said in one.keys for key in case.keys)


def main() -> None:
    """Draw, judge, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=400)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--show", action="store_true", help="say what was named in those that were not right")
    given = parser.parse_args()
    names = list(MISTAKES)
    count: dict[str, int] = defaultdict(int)
    good: dict[str, int] = defaultdict(int)
    alone: dict[str, int] = defaultdict(int)
    refused_at: dict[str, int] = defaultdict(int)
    beside: list[int] = []
    for index in range(given.cases):
        case, turn = None, 0
        while case is None:
            rng = np.random.default_rng([given.seed, index, turn])
            case, turn = planted(rng, names[index % len(names)], random_set_up(rng)), turn + 1
        refused, found = named(case.set_up)
        told, others = right(case, refused, found)
        count[case.name] += 1
        good[case.name] += told
        alone[case.name] += told and not others
        refused_at[case.name] += bool(refused) and told
        beside += [others] if told else []
        if given.show and not told:
            print(index, case.name, case.keys, "->", refused or [m.line for m in found])
    print(f"seed {given.seed}; one mistake planted in each of {given.cases} random set-ups")
    print(f"{'':32}{'set-ups':>8}{'named':>8}{'alone':>8}{'refused':>9}")
    for name in names:
        print(f"{name:32}{count[name]:8d}{good[name]:8d}{alone[name]:8d}{refused_at[name]:9d}")
    total = sum(good.values())
    print(f"{'all':32}{given.cases:8d}{total:8d}{sum(alone.values()):8d}{sum(refused_at.values()):9d}")
    print(f"named in {100 * total / given.cases:.1f} %; at most {max(beside, default=0)} named beside the right one\n")
    false = 0
    for index in range(given.clean):
        refused, found = named(random_set_up(np.random.default_rng([given.seed, 1_000_000 + index])))
        false += bool(refused or found)
        if given.show and (refused or found):
            print("clean", index, "->", refused or [m.line for m in found])
    print(f"{'clean set-ups (false)':32}{given.clean:8d}{false:8d}")
    for fault in FAULTS[1:]:
        wrong = 0
        for index in range(FAULTY):
            rng = np.random.default_rng([given.seed, 2_000_000 + index])
            case = film(random_scene(rng, 60), rng, fault)
            found = find_mistakes(case.run, case.tracks)
            wrong += bool(found)
            if given.show and found:
                print(fault, index, "->", [m.line for m in found])
        print(f"{fault + ', an ordinary fault (false)':40}{FAULTY:4d}{wrong:4d}")


if __name__ == "__main__":
    main()
