"""The diagnosis without the effect that is there: the truth's whole class taken out of the library, or the truth alone.

    python benchmarks/left_out.py OUT [--each 3] [--clear 200]

OUT: a blind check that is scored (its seal is open). Of every effect the first cases in which it is there alone and clearly (D at
least --clear) are diagnosed anew without it and without all whose D from it is at most the check's own 20 (``--without``): what is
left explains nothing, and the answer shall be ``unknown``. Where such a twin exists, once more without the truth alone: the twin
shall be named, by either form. D is by one form of each rival, and the library has several: where another effect is named as exact,
it leaves nothing over, and these tows cannot tell the two apart. It belongs to the class, and is left out as well ("whole"), up to
ROUNDS times. Started again, it goes on.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

from towline.blind.judge import TOLD_APART
from towline.pipeline.diagnosing import diagnose_folders
from towline.record.errors import TowlineError

NAMED = ("effect", "form_not_exact")
"""Verdicts that name something."""
ROUNDS = 3
"""So many more effects (or pairs of them) are left out for leaving nothing over."""


def chosen(out: Path, each: int, clear: float) -> list[tuple[str, str, list[str]]]:
    """Case, its effect and the twins of that, the first ``each`` of every effect."""
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


def answer(out: Path, case: str, without: list[str]) -> tuple[str, list[str], float]:
    """Verdict, what is named first, and the probability of the unknown."""
    try:
        file = diagnose_folders(sorted((out / "cases" / case).glob("run-*")), without=without).diagnosis.file
    except TowlineError as error:
        return f"no answer: {error}"[:60], [], 0.0
    return file.verdict, list(file.ranking[0].effects) if file.verdict in NAMED else [], file.p_unknown


def main() -> None:
    """Ask all, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--each", type=int, default=3)
    parser.add_argument("--clear", type=float, default=200.0)
    given = parser.parse_args()
    kept = given.out / "left_out.json"
    known: dict[str, list] = json.loads(kept.read_text()) if kept.is_file() else {}

    def asked(case: str, kind: str, without: list[str]) -> tuple[str, list[str], float]:
        key = f"{case} {kind}"
        if key not in known:
            known[key] = list(answer(given.out, case, without))
            kept.write_text(json.dumps(known, indent=1) + "\n")
        verdict, named, p = known[key]
        words = ", ".join(without)
        print(f"{case:10}{kind:14}{words:70}{verdict:16}{p:10.3f}  {' + '.join(named)}", flush=True)
        return verdict, named, p

    first, whole, twin_named, twin_asked = Counter[str](), Counter[str](), 0, 0
    print(f"{'case':10}{'':14}{'left out':70}{'verdict':16}{'p unknown':>10}  named")
    for case, effect, twins in chosen(given.out, given.each, given.clear):
        without = [effect, *twins]
        verdict, named, _ = asked(case, "class", without)
        first[verdict] += 1
        for more in range(1, ROUNDS + 1):
            if verdict != "effect":
                break
            without = [*without, *named]
            verdict, named, _ = asked(case, f"whole {more}", without)
        whole[verdict] += 1
        if twins:
            _, named, _ = asked(case, "twin", [effect])
            twin_named, twin_asked = twin_named + bool(set(named) & set(twins)), twin_asked + 1
    for what, verdicts in (("the class", first), ("the class and what leaves nothing over", whole)):
        print(
            f"\n{what} left out, {verdicts.total()} cases: " + ", ".join(f"{n} {v}" for v, n in verdicts.most_common())
        )
    print(f"the truth alone left out: a twin named in {twin_named} of {twin_asked}")


if __name__ == "__main__":
    main()
