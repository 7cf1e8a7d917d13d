"""The laws' benchmark by others: weak sparse regression (pysindy), a Gaussian process (scikit-learn), symbolic ones (pyoperon).

    python benchmarks/laws_peers.py OUT --seed 1 --cases 20 --python PEERS/bin/python

Same cases as ``laws.py`` (OUT is its folder, where its answers lie) of forces in sway and yaw, same judge. The peers run in an
interpreter of their own that has them (laws_peers_fit.py); only tables are exchanged. They are given what ``laws.py`` is, and the
line's true tension besides, as of a perfect load cell: what a line that keeps its length pulls with is no part of their models.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from laws import simulator_of
from laws_cases import law_case
from laws_truth import apart, seen_by, true_force, true_variables

from towline.blind.seal import CASES, write_cases
from towline.blind.truth.cases import Case, lane_of, swum
from towline.diagnose.tow.towed import TowSimulator

LONGEST_S = 600
"""A case's peers may take so long."""
PEERS = ("pysindy", "GP", "pyoperon")


def tables_of(case: Case, simulator: TowSimulator) -> dict[str, Any]:
    """What the peers are given."""
    runs, path = simulator.runs, swum(case)
    count = min(len(run.centre_s) for run in runs)
    seen = seen_by(case, range(len(runs)))
    first = runs[0]
    pulls = [
        np.interp(run.centre_s[:count] + run.start_s, path.t_s, path.tension_n[:, k]) for k, run in enumerate(runs)
    ]
    return {
        "t": first.centre_s[:count] - first.centre_s[0], "y": np.array([run.values[:count, 0] for run in runs]),
        "beta": np.array([run.values[:count, 1] for run in runs]), "tension": np.array(pulls),
        "speed": np.array([lane_of(case, k)["speed"] for k in range(len(runs))]),
        "line": np.array([lane_of(case, k)["line"] for k in range(len(runs))]),
        "x_t": np.array([lane_of(case, k)["x_t"] for k in range(len(runs))]), "length": case.hull["length_pp"],
        "density": case.hull["density"], "half_width": first.half_width_m,
        "asked": np.array([seen.of[name] for name in ("v", "r", "y", "beta")]),
    }  # fmt: skip


def answered(out: Path, case: Case, python: str) -> dict[str, Any]:
    """What the peers say of a case, and how right they are."""
    folders = [out / CASES / case.name / f"run-{k + 1}" for k in range(len(case.runs))]
    if not all((folder / "run.toml").is_file() for folder in folders):
        write_cases(out, [case])
    given, found = out / f"{case.name}.npz", out / f"{case.name}-peers.json"
    np.savez(given, **tables_of(case, simulator_of(folders)))
    script = Path(__file__).with_name("laws_peers_fit.py")
    subprocess.run([python, "-W", "ignore", str(script), str(given), str(found)], check=True, timeout=LONGEST_S)
    seen = seen_by(case, range(len(folders)))
    true, variables = true_force(seen), true_variables(case, seen)
    rows: dict[str, Any] = {}
    for name, one in json.loads(found.read_text()).items():
        if "why" in one:
            rows[name] = one
            continue
        rows[name] = {
            "error": apart(np.array(one["force"]), true, seen), "variables": one["variables"], "text": one["text"],
            "right": one["variables"] == variables, "seconds": one["seconds"],
        }  # fmt: skip
    return {"name": case.name, "true": variables, "d": case.extra["d"], "peers": rows}


def main() -> None:
    """Answer, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--python", default="python", help="an interpreter with pysindy, scikit-learn and pyoperon")
    given = parser.parse_args()
    asked = subprocess.run(
        [given.python, "-c", "import pysindy, sklearn, pyoperon"], check=False, capture_output=True, text=True
    )
    if asked.returncode:
        print(f"skipped: {given.python} has not all the peers ({asked.stderr.strip().splitlines()[-1]})")
        return
    answers = given.out / "answers.jsonl"
    lines = answers.read_text().splitlines() if answers.is_file() else []
    ours = {a["name"]: a for a in map(json.loads, lines)}
    path, done = given.out / "peers.jsonl", {}
    if path.is_file():
        done = {a["name"]: a for a in map(json.loads, path.read_text().splitlines())}
    rows = []
    for k in range(given.cases):
        name = f"law-{k:03d}"
        if name not in done:
            case = law_case(name, [given.seed, k])
            if any(case.numbers.get(f"law.along{j}") for j in (0, 1)):
                continue
            done[name] = answered(given.out, case, given.python)
            with path.open("a") as file:
                file.write(json.dumps(done[name]) + "\n")
        rows.append(done[name])
        print(line_of(done[name], ours.get(name)), flush=True)
    print("\n".join(["", *summary(rows, ours)]))


def line_of(a: dict[str, Any], ours: dict[str, Any] | None) -> str:
    """One case in the table."""
    text = f"{a['name']}  D {a['d']:6.0f}  true {' '.join(a['true']):9}"
    if ours is not None:
        error = f"{ours['force_error']:.3f}" if "force_error" in ours else "-"
        text += f"towline {error:6} ({' '.join(ours.get('told', ['-']))})  "
    for name in PEERS:
        one = a["peers"][name]
        variables = "" if one.get("variables") is None else f" ({' '.join(one['variables'])})"
        text += f"{name} {one['error']:.3f}{variables}  " if "error" in one else f"{name}: {one['why']}  "
    return text


def summary(rows: list[dict[str, Any]], ours: dict[str, Any]) -> list[str]:
    """Medians over the cases that all have answered."""
    lines = []
    for name in PEERS:
        there = [a["peers"][name] for a in rows if "error" in a["peers"][name]]
        if not there:
            continue
        errors = np.array([one["error"] for one in there])
        right = "" if there[0]["variables"] is None else f", variables right {sum(one['right'] for one in there)}"
        seconds = np.median([one["seconds"] for one in there])
        lines.append(
            f"{name}: {len(there)} cases, force error median {np.median(errors):.2f}, below 0.3 in {sum(errors < 0.3)}"
            f"{right}; {seconds:.0f} s"
        )
    both = [ours[a["name"]] for a in rows if a["name"] in ours]
    told = [a for a in both if "force_error" in a]
    if told:
        errors = np.array([a["force_error"] for a in told])
        right = sum(a["told"] == a["true"] for a in told)
        lines.append(
            f"towline: {len(both)} of these cases, a law told in {len(told)}: force error median {np.median(errors):.2f}, "
            f"below 0.3 in {sum(errors < 0.3)}, variables right {right}"
        )
    return lines


if __name__ == "__main__":
    main()
