"""Does the record that towline gap proposes settle what was left open? Sealed cases of larger noise; the truth makes the record.

    python benchmarks/any_simulator_next.py --kept next.jsonl [--seed 1] [--cases 30] > benchmarks/any_simulator_next.txt

Open is what holds less than 95 % of the probability by one hypothesis. Beside the proposed record, for comparison, one
that stands in the middle of what was tried is made. What is done stands in the file of --kept, and is not done again.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from any_simulator import Case, Made, cases, drawn, record_of, truth

from towline.diagnose.own.designs import Design, box_of
from towline.diagnose.own.gap import own_gap
from towline.diagnose.own.records import Record, together
from towline.record.own_data import OwnClock, OwnColumn, OwnData, OwnNext

NOISY = (4.0, 16.0)
"""The noise of the other benchmark, times a factor between these."""
BOXES = {
    "pendulum": OwnNext(state="angle", range=(0.2, 2.2)),
    "drive": OwnNext(input="volt", amplitude=(0.5, 6.0), frequency_hz=(0.1, 3.0)),
    "Duffing": OwnNext(input="u", amplitude=(3.0, 40.0), frequency_hz=(0.2, 3.0)),
    "two tanks": OwnNext(input="pump", amplitude=(0.1, 0.9), frequency_hz=(0.001, 0.03), offset=1.0),
    "ship yaw": OwnNext(input="rudder", amplitude=(0.1, 0.6), frequency_hz=(0.003, 0.06)),
}
RELATIVE = ("saturation",)
"""Truths whose size is told by the records' own inputs: they have none in another record."""


def answer(made: Made, records: list[Record], designs: list[Design]) -> Any:
    """The engine's gap.json, and the design that it proposes."""
    rng = np.random.default_rng(0)
    return own_gap(made.case.model, together(records), "benchmark", {}, rng=rng, designs=designs)


def recorded(made: Made, design: Design, rng: np.random.Generator, name: str) -> Record:
    """The design, made by the truth."""
    case = made.case
    names = [s.name for s in case.model.states]
    start = np.median(made.starts, axis=0)
    for state, value in design.start.items():
        start[names.index(state)] = value
    drive = design.record.inputs[:, 0] if case.drive is not None else np.zeros(case.count)
    clean = truth(case, made.p, start, drive, made.largest, made.sizes)
    return record_of(case, name, drive, clean + np.array(case.noise) * rng.normal(size=clean.shape))


def case_of(case: Case, effect: str, seed: list[int]) -> dict[str, Any]:
    """One: what was open, what was proposed, what it told."""
    rng = np.random.default_rng(seed)
    factor = float(np.exp(rng.uniform(*np.log(NOISY))))
    made = drawn(replace(case, noise=tuple(factor * n for n in case.noise)), effect, rng)
    records = [
        record_of(made.case, f"record {k + 1}", d, v)
        for k, (d, v) in enumerate(zip(made.drives, made.values, strict=True))
    ]
    out = case.model.outputs[0].name
    file = OwnData(
        clock=OwnClock(rate_hz=1 / case.step_s), column=(OwnColumn(name=out, role="output"),), next=(BOXES[case.name],)
    )
    designs = box_of(case.model, together(records).records[0], file, Path("box"))
    first = answer(made, records, designs)
    row = {"system": case.name, "effect": effect, "noise": factor, **_called(first.file, effect, "before")}
    row["open"] = max([first.file.p_no_gap, first.file.p_unknown, *(r.named for r in first.file.ranking)]) < 0.95
    if not row["open"] or first.file.next_experiment is None:
        return row
    tried = first.file.next_experiment.tried
    by_name = {d.name: d for d in designs}
    row |= {"proposed": tried[0].name, "told": tried[0].told, "distance": tried[0].distance}
    for key, chosen in (("after", tried[0]), ("middle", tried[len(tried) // 2])):
        more = recorded(made, by_name[chosen.name], np.random.default_rng([*seed, 1]), "next")
        row |= _called(answer(made, [*records, more], []).file, effect, key)
    return row


def _called(file: Any, effect: str, key: str) -> dict[str, Any]:
    named = file.ranking[0].effects if file.verdict in ("effect", "form_not_exact") else []
    sure = float(file.ranking[0].named) if named else max(file.p_no_gap, file.p_unknown)
    right = named == [effect] if effect else file.verdict == "no_gap"
    what = " + ".join(named) or file.verdict
    return {key: what, f"{key}_sure": sure, f"{key}_settled": bool(right and sure >= 0.95), f"{key}_right": bool(right)}


def main() -> None:
    """Every case, a line each, and the count."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    lines = given.kept.read_text().splitlines() if given.kept.is_file() else []
    rows: dict[str, Any] = {row["key"]: row for row in map(json.loads, lines)}
    systems = cases()
    for k in range(given.cases):
        index = k % len(systems)
        case = systems[index]
        # the complete model among them
        names = ["", *(n for n, (kind, _) in case.effects.items() if kind not in RELATIVE)]
        effect = names[(1 + k // len(systems)) % len(names)]
        key = f"{given.seed} {case.name} {k // len(systems)}"
        if key in rows:
            continue
        rows[key] = {"key": key, **case_of(case, effect, [given.seed, index, k // len(systems), 7])}
        with given.kept.open("a") as file:
            file.write(json.dumps(rows[key]) + "\n")
    _table(list(rows.values()))


def _table(rows: list[dict[str, Any]]) -> None:
    asked = [r for r in rows if "after" in r]
    for r in asked:
        print(f"{r['system']:10} {r['effect'] or 'nothing missing':24} before {r['before']:36} {r['before_sure']:.2f}")
        for key, what in (
            ("after", f"{r['proposed']} (told {r['told']:.2f}, D {r['distance']:.0f})"),
            ("middle", "the middle one"),
        ):
            settled = "settled" if r[f"{key}_settled"] else "right" if r[f"{key}_right"] else "WRONG"
            print(f"{'':10} {what:60} {r[key]:36} {r[f'{key}_sure']:.2f} {settled}")
    print()
    print(f"{len(rows)} cases, {len(asked)} open.", end=" ")
    for key, what in (("after", "the proposed record"), ("middle", "one in the middle of what was tried")):
        print(
            f"With {what} settled (the truth at 0.95 or more): {sum(r[f'{key}_settled'] for r in asked)} of {len(asked)}.",
            end=" ",
        )
    expected = [r for r in asked if r["told"] >= 0.9]
    print(f"Of {len(expected)} of which 0.9 or more was promised: {sum(r['after_settled'] for r in expected)}.")


if __name__ == "__main__":
    main()
