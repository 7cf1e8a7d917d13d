"""Laws that no library holds, drawn from a grammar of their own, and what the search writes down for them.

    python benchmarks/laws.py OUT [--cases 20] [--nulls 10] [--seed 1]

Each case is a campaign of the blind check's reality (surge in full, coloured forces in half of them) with a force of one or two
terms (blind/truth/laws.py), made so large that D, after the derivatives are refitted, is drawn evenly in its logarithm from 50 to
5000. Started again, it goes on. What is scored: the variables of the law, and the force over the range seen (linear parts in v and
r left out), told against true.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from towline.blind.draw import CASES, case_of, gentle, write_cases
from towline.blind.signature import distances_of, linear
from towline.blind.truth.cases import Case, lane_of
from towline.blind.truth.lanes import Lanes
from towline.blind.truth.laws import KINDS, TERMS, law_force
from towline.blind.truth.now import Now
from towline.diagnose.law.search import force_of, seen_by, without_linear
from towline.diagnose.law.terms import term
from towline.pipeline.diagnosing import diagnose_folders
from towline.pipeline.laws import law_of

LOW_D, HIGH_D = 50.0, 5000.0
"""Of the laws, after the derivatives are refitted."""
VARIABLES = {0: "v", 1: "r", 2: "v r", 3: "v", 4: "v", 5: "y", 6: "beta", 7: "v y", 8: "v r", 9: "r", 10: "y"}
SIDE_N = 0.02
"""First size of a term; D then says how large it is."""


def drawn(name: str, seed: list[int], null: bool) -> Case:
    """A campaign, with a law unless it is a null."""
    case = case_of(name, "null", [], seed, coloured=bool(seed[-1] % 2))
    if null:
        return gentle(case)
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
    case = gentle(replace(case, kind="unknown", effects=["law"], numbers=numbers))
    target = float(np.exp(rng.uniform(np.log(LOW_D), np.log(HIGH_D))))
    by = float(np.sqrt(target / max(distances_of(case, linear(case)).strength, 1e-9)))
    sized = {n: v * by if n[4:8] in ("side", "turn") else v for n, v in case.numbers.items()}
    case = gentle(replace(case, numbers=sized))
    return replace(case, extra={"d": distances_of(case, linear(case)).strength})


def true_force(case: Case, states: object, speed: float) -> np.ndarray:
    """(2, n) side force and moment over measured states, N and N m."""
    s = states
    lane = lane_of(case, 0)
    n = len(s.v)
    q = Lanes([lane] * n)
    length, zero = lane["length_pp"], np.zeros(n)
    now = Now(
        0.0, s.y * lane["tank_width"] / 2, s.beta, s.v * speed, s.r * speed / length, np.full(n, speed), zero,
        s.turn * speed / length, np.zeros((4, n)), zero,
    )  # fmt: skip
    return np.array(law_force(q, now))


def answered(out: Path, case: Case) -> dict:
    """What diagnosis and search say."""
    began = time.process_time()
    found = diagnose_folders(sorted((out / CASES / case.name).glob("run-*")))
    base = time.process_time() - began
    law = law_of(found)
    answer = {
        "name": case.name, "d": case.extra.get("d", 0.0), "coloured": case.noise["coloured"],
        "diagnosis": found.diagnosis.file.verdict,
        "said": found.diagnosis.file.ranking[0].effects if found.diagnosis.file.ranking else [],
        "seconds": base, "seconds_law": time.process_time() - began - base, "verdict": law.verdict, "why": law.why,
        "p_law": law.searched.p_law if law.searched else 0.0,
        "laws": [(one.text, one.probability, one.shrink) for one in law.searched.laws] if law.searched else [],
    }  # fmt: skip
    simulator = found.diagnosis.inference.simulator
    states, _ = seen_by(simulator)
    if case.effects:
        kinds = [int(case.numbers[f"law.kind{k}"]) for k in range(TERMS) if f"law.kind{k}" in case.numbers]
        answer["true"] = sorted({v for kind in kinds for v in VARIABLES[kind].split()})
        answer["kinds"] = kinds
        if law.searched and law.searched.laws:
            best = law.searched.laws[0]
            answer["told"] = sorted({v for text, _ in best.terms for v in term(text).variables})
            first = simulator.runs[0]
            size = 0.5 * first.density_kg_m3 * simulator.speed_m_s**2 * first.length_pp_m**2
            told = size * force_of(best.effects, best.numbers, states)
            true = true_force(case, states, simulator.speed_m_s)
            true[1] /= first.length_pp_m
            one, two = (without_linear(f, states) for f in (told, true))
            answer["force_error"] = float(np.linalg.norm(one - two) / np.linalg.norm(two))
    return answer


def main() -> None:
    """Draw, answer, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "answers.jsonl"
    done = (
        {json.loads(line)["name"]: json.loads(line) for line in path.read_text().splitlines()} if path.is_file() else {}
    )
    for k in range(given.cases + given.nulls):
        name = f"law-{k:03d}" if k < given.cases else f"null-{k - given.cases:03d}"
        if name in done:
            continue
        case = drawn(name, [given.seed, k], k >= given.cases)
        write_cases(given.out, [case])
        done[name] = answered(given.out, case)
        with path.open("a") as file:
            file.write(json.dumps(done[name]) + "\n")
        print(json.dumps(done[name]), flush=True)
    laws = [a for a in done.values() if "true" in a]
    nulls = [a for a in done.values() if "true" not in a]
    told = [a for a in laws if a["laws"]]
    errors = sorted(a["force_error"] for a in told)
    print(f"laws {len(laws)}: a law told {len(told)}, variables right {sum(a['told'] == a['true'] for a in told)}")
    if errors:
        print(
            f"force error over the range seen: median {errors[len(errors) // 2]:.3f}, below 0.03: {sum(e < 0.03 for e in errors)}"
        )
    print(f"nulls {len(nulls)}: a law told {sum(bool(a['laws']) for a in nulls)}")
    print(f"seconds of CPU beside the diagnosis: {np.median([a['seconds_law'] for a in done.values()]):.1f} median")


if __name__ == "__main__":
    main()
