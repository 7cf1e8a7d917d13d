"""The diagnosis without the effect that is there: the truth's whole class taken out of the library, or the truth alone.

    python benchmarks/left_out.py OUT [--each 3] [--clear 200] [--workers 2]

OUT: a blind check that is scored (its seal is open). Of every effect the first cases in which it is there alone and clearly (D at
least --clear) are diagnosed anew without it and without all whose D from it is at most the check's own 20 (``--without``): what is
left explains nothing, and the answer shall be ``unknown``. Where such a twin exists, once more without the truth alone: the twin
shall be named, by either form. D is by one form of each rival, and the library has several: where another effect is named as exact,
it leaves nothing over, and these tows cannot tell the two apart. It belongs to the class, and is left out as well ("whole"), up to
ROUNDS times. What is named as form not exact leaves something over, and stays in: "shrink" says how much of the gap of runs kept
aside it takes. Started again, it goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from towline.blind.judge import TOLD_APART
from towline.blind.scores import interval
from towline.diagnose.gap import NAMED
from towline.pipeline.diagnosing import diagnose_folders
from towline.pipeline.executor.processes import THREADS, in_parallel
from towline.record.errors import TowlineError
from towline.record.files import write_text

ROUNDS = 3
"""So many more effects (or pairs of them) are left out for leaving nothing over."""
MOST = 0.5
"""An effect that takes this share of a gap mostly explains it."""

Chosen = tuple[str, str, list[str]]
"""Case, its effect, the twins of that."""


def chosen(out: Path, each: int, clear: float) -> list[Chosen]:
    """The first ``each`` cases of every effect."""
    scored = json.loads((out / "score.json").read_text())["cases"]
    taken: Counter[str] = Counter()
    found = []
    for case in scored:
        if case["kind"] != "effect":
            continue
        (effect,) = case["held"]
        twins = sorted(name for name, apart in case["rivals"].items() if apart <= TOLD_APART)
        apart = min((d for name, d in case["rivals"].items() if name not in twins), default=case["nearest"])
        if apart >= clear and taken[effect] < each:
            taken[effect] += 1
            found.append((case["name"], effect, twins))
    return found


def answer(out: Path, case: str, kind: str, without: list[str]) -> dict[str, Any]:
    """Verdict, what is named first and how much of the gap it takes, and the probability of the unknown."""
    told: dict[str, Any] = {"kind": kind, "without": without, "named": [], "p_unknown": 0.0, "shrink": None}
    try:
        file = diagnose_folders(sorted((out / "cases" / case).glob("run-*")), without=without).diagnosis.file
    except TowlineError as error:
        return told | {"verdict": f"no answer: {error}"[:60]}
    told |= {"verdict": file.verdict, "p_unknown": file.p_unknown}
    if file.verdict in NAMED:
        told |= {"named": list(file.ranking[0].effects), "shrink": file.ranking[0].shrink}
    return told


def asked(out: Path, case: str, effect: str, twins: list[str]) -> None:
    """All that is asked of a case: without the class, without what leaves nothing over, and without the truth alone."""
    kept = out / "left_out" / f"{case}.json"
    if kept.is_file():
        return
    answers = [answer(out, case, "class", [effect, *twins])]
    for more in range(1, ROUNDS + 1):
        if answers[-1]["verdict"] != "effect":
            break
        answers.append(answer(out, case, f"whole {more}", [*answers[-1]["without"], *answers[-1]["named"]]))
    if twins:
        answers.append(answer(out, case, "twin", [effect]))
    write_text(kept, json.dumps(answers, indent=1) + "\n")


def table(out: Path, cases: list[Chosen]) -> str:
    """Every answer, and how many were which."""
    lines = [f"{'case':10}{'':9}{'left out':70}{'verdict':16}{'p unknown':>10}{'shrink':>8}  named"]
    first, whole = Counter[str](), Counter[str]()
    small, twin_named, twin_asked = Counter[str](), 0, 0
    for case, _, twins in cases:
        answers = json.loads((out / "left_out" / f"{case}.json").read_text())
        for a in answers:
            shrink = "" if a["shrink"] is None else f"{a['shrink']:.3f}"
            lines.append(
                f"{case:10}{a['kind']:9}{', '.join(a['without']):70}{a['verdict']:16}{a['p_unknown']:10.3f}{shrink:>8}  "
                f"{' + '.join(a['named'])}".rstrip()
            )
        last = [a for a in answers if a["kind"] != "twin"][-1]
        first[answers[0]["verdict"]] += 1
        whole[last["verdict"]] += 1
        if last["shrink"] is None or last["shrink"] < MOST:
            small[last["verdict"]] += 1
        if twins:
            twin_named, twin_asked = twin_named + bool(set(answers[-1]["named"]) & set(twins)), twin_asked + 1
    for what, verdicts in (
        ("the class left out", first),
        ("the class and what leaves nothing over left out", whole),
        (f"of these where what is named takes less than {MOST} of the gap, or nothing is", small),
    ):
        told = ", ".join(f"{n} {v}" for v, n in verdicts.most_common())
        low, high = interval(verdicts["unknown"], verdicts.total())
        lines.append(f"{what}, {verdicts.total()} cases: {told}; unknown {100 * low:.0f}-{100 * high:.0f} %")
    lines.append(f"the truth alone left out: a twin named in {twin_named} of {twin_asked}")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Ask all, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--each", type=int, default=3)
    parser.add_argument("--clear", type=float, default=200.0)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    for name in THREADS:
        os.environ.setdefault(name, "1")
    (given.out / "left_out").mkdir(exist_ok=True)
    cases = chosen(given.out, given.each, given.clear)
    for done, _ in enumerate(in_parallel(asked, [(given.out, *case) for case in cases], given.workers), 1):
        print(f"{done} of {len(cases)}", file=sys.stderr, flush=True)
    print(table(given.out, cases))


if __name__ == "__main__":
    main()
