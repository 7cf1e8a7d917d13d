"""Laws that no library holds, drawn from a grammar of their own, and what the search writes down for them.

    python benchmarks/laws.py OUT [--cases 20] [--nulls 10] [--faults 12] [--seed 1]

Each case is a campaign of the blind check's reality (surge in full, coloured forces in half of them) with a force of one or two
terms (blind/truth/laws.py), made so large that D, after the derivatives are refitted, is drawn evenly in its logarithm from 50 to
5000. Started again, it goes on. Scored, by code that shares nothing with the search (laws_truth.py), over the truth's own motion
and with what is linear in v and r left out: the variables; the form (the truth's force is one of its functions up to 3 %); the
force's error, and that of the truth's own form refitted (laws_oracle.py: its coefficients alone, and all its numbers); and the gap
on two tows that were not fitted, one released 1.5 times as far out, one at 0.85 of the speed, against the oracle's.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from laws_cases import fault_case, law_case, null_case, with_more
from laws_oracle import gaps_beyond, oracle, reader, removed_share
from laws_truth import Seen, apart, right_form, seen_by, told, true_force, true_terms, true_variables, variables_of

from towline.blind.seal import CASES, write_cases
from towline.blind.truth.cases import Case
from towline.diagnose.tow.towed import TowSimulator
from towline.pipeline.diagnosing import diagnose_folders, tows_of
from towline.pipeline.laws import law_file, law_of
from towline.pipeline.stages import compute_run_motion
from towline.record.files import write_text
from towline.record.run import read_run
from towline.record.threads import one_thread

NULLS_FROM, FAULTS_FROM = 2000, 1000
"""Second numbers of their seeds begin here."""
SINGLE, PAIR = -5.9, -11.7
"""Log priors that the search gives a law of one term, and of two (what it competes with changes them by a tenth)."""
LONG_S = 60
"""A search takes no longer than this on two idle cores, or too long."""
FOLLOWED = 1.3
"""A gap on a tow that was not fitted is at most this, where the simulator holds there."""
OFF = 0.1
"""A gap that the oracle shrinks by less says nothing of shrinking."""


def simulator_of(folders: list[Path]) -> TowSimulator:
    """Run folders as a campaign."""
    runs = [read_run(folder) for folder in folders]
    return TowSimulator(tows_of(runs, [compute_run_motion(run) for run in runs]))


def answered(out: Path, case: Case, count: int) -> dict[str, Any]:
    """What diagnosis and search say of a campaign's first ``count`` tows, and how right they are."""
    folders = [out / CASES / case.name / f"run-{k + 1}" for k in range(len(case.runs))]
    began = time.monotonic()
    found = diagnose_folders(folders[:count])
    base = time.monotonic() - began
    law = law_of(found)
    file = law_file(law, {})
    answer: dict[str, Any] = {
        "name": case.name, "d": case.extra.get("d", 0.0), "coloured": case.noise["coloured"], "effects": case.effects,
        "diagnosis": found.diagnosis.file.verdict,
        "said": found.diagnosis.file.ranking[0].effects if found.diagnosis.file.ranking else [],
        "seconds": base, "seconds_law": time.monotonic() - began - base, "verdict": file.verdict, "why": file.why,
        "p_law": file.p_law, "laws": [(one.text, one.probability, one.shrink) for one in file.laws],
        "terms": [one.model_dump() for one in file.laws[0].terms] if file.laws else [],
        "goes_with": [(one.variables, one.share) for one in file.goes_with[:3]],
        "acts_with": sorted(law.searched.acts_with[0]) if law.searched else [],
        "worse_aside": law.searched.worse_aside if law.searched else None,
    }  # fmt: skip
    if case.effects != ["law"]:
        return answer
    seen = seen_by(case, range(count))
    true = true_force(seen)
    answer["true"] = true_variables(case, seen)
    answer["kinds"] = [int(v) for n, v in sorted(case.numbers.items()) if n.startswith("law.kind")]
    inference, ranking = found.diagnosis.inference, found.diagnosis.ranking
    with one_thread():
        fits, numbers = oracle(case, inference, ranking.base)
        terms_told, answer["reader_weight"] = reader(case, inference, ranking.base, fits["form"], SINGLE, PAIR)
    answer["reader"] = None if terms_told is None else variables_of(case, seen, terms_told)
    answer["reader_whole"] = terms_told is not None and set(true_terms(case, seen)) <= set(terms_told)
    answer["oracle"] = {name: apart(true_force(seen, n), true, seen) for name, n in numbers.items()}
    answer["oracle_log"] = {name: fit.log_evidence - ranking.base.log_evidence for name, fit in fits.items()}
    best = None
    if file.verdict == "law" and law.searched is not None:
        best = law.searched.laws[0]
        # without the price of writing it, which a reader of the true forms does not pay
        evidence = best.fitted.log_evidence + sum(effect.cost for effect in best.effects) - ranking.base.log_evidence
        answer["weight"] = evidence + (SINGLE if len(best.effects) == 1 else PAIR)
    answer |= judged(answer, seen, true)
    if len(folders) > count:
        chosen = [ranking.base, fits["form"], *([best.fitted] if best is not None else [])]
        with one_thread():
            gaps = gaps_beyond(simulator_of(folders), count, chosen, fits["form"].forces)
        answer["beyond"] = {
            what: dict(zip(("before", "oracle", "answer"), (float(g[k]) for g in gaps), strict=False))
            for k, what in enumerate(("wider", "slower"))
        }
    return answer


def judged(answer: dict[str, Any], seen: Seen, true: np.ndarray) -> dict[str, Any]:
    """How right an answer's first law is, told or a candidate: form; variables and the force's error where it is told."""
    try:
        terms = told(answer["terms"])
    except ValueError:  # with memory: no true law has any
        terms = []
    found: dict[str, Any] = {"form": bool(terms) and right_form(terms, seen, true)}
    if law_told(answer):
        found["told"] = sorted({v for one in terms for v in one.variables})
        found["force_error"] = apart(sum((one.force(seen) for one in terms), np.zeros_like(true)), true, seen)
    return found


def judged_again(out: Path, seed: int) -> None:
    """Judge the laws of answers that are there anew."""
    path = out / "answers.jsonl"
    answers = _kept(path)
    for name, answer in answers.items():
        if "true" in answer:
            case = law_case(name, [seed, int(name.removeprefix("law-"))])
            seen = seen_by(case, range(len(case.runs)))
            answer |= judged(answer, seen, true_force(seen))
    write_text(path, "".join(json.dumps(answer) + "\n" for answer in answers.values()))


def law_told(answer: dict[str, Any]) -> bool:
    """Whether a law was told, and not candidates only (answers from before candidates had a verdict: the same)."""
    return answer["verdict"] == "law"


def line_of(a: dict[str, Any]) -> str:
    """One answer in the table."""
    text = f"{a['name']:10} D {a['d']:6.0f}  {'coloured' if a['coloured'] else 'white':9}{a['diagnosis']:15}{a['verdict']:13}"
    if "true" not in a:
        return f"{text}{' '.join(a['effects']):18}" + (
            f"{a['laws'][0][1]:.2f} {a['laws'][0][0]}" if law_told(a) else ""
        )
    oracles = f"{a['oracle']['coefficients']:.3f}/{a['oracle']['form']:.3f}"
    error = f"{a['force_error']:.3f}" if law_told(a) else "-"
    form = "yes" if a.get("form") else "no"
    text += f"true {' '.join(a['true']):9} told {_told(a):9} form {form if law_told(a) else f'({form})':6}"
    text += f"error {error:6} oracle {oracles:13}"
    for what, gaps in a.get("beyond", {}).items():
        text += (
            f"{what} " + "/".join(f"{gaps[k]:.2f}" if k in gaps else "-" for k in ("before", "answer", "oracle")) + "  "
        )
    best = f"{a['laws'][0][1]:.2f} {a['laws'][0][0]}" if a["laws"] else ""
    return text + (best if law_told(a) or not best else f"({best})")


def _told(a: dict[str, Any]) -> str:
    """What it goes with; in brackets where no form is told."""
    if law_told(a):
        return " ".join(a["told"]) or "1"
    where = " ".join(a.get("acts_with", [])) if a["verdict"] in ("form_open", "field") else ""
    return f"({where})" if where else "-"


def summary(answers: list[dict[str, Any]]) -> list[str]:
    """The must-show lines."""
    laws = [a for a in answers if "true" in a]
    said = [a for a in laws if law_told(a)]
    where = [a for a in laws if a["verdict"] in ("form_open", "field")]
    lines = []
    if laws:
        lines.append(
            f"laws {len(laws)}: a law told {len(said)}, variables right {sum(a['told'] == a['true'] for a in said)}, "
            f"form right {sum(a['form'] for a in said)}"
        )
    if able := [a for a in laws if "reader" in a]:
        right = sum(a["reader"] == a["true"] for a in able)
        lines.append(f"one who knows the true forms tells the right variables of {right} of {len(able)}")
    if wrong := [a for a in said if not a["form"] and "weight" in a]:
        part = [a for a in wrong if not a["reader_whole"]]
        less = [a for a in wrong if a["reader_whole"] and a["weight"] >= a["reader_weight"]]
        lines.append(
            f"of {len(wrong)} forms told wrongly, one who knows the true forms would tell a part of the force in {len(part)}; in "
            f"{len(less)} more what was told has at least the evidence and prior of the truth; the search missed it in "
            f"{len(wrong) - len(part) - len(less)}"
        )
    if where:
        right = sum(a.get("acts_with") == a["true"] for a in where)
        lines.append(
            f"told without a form, or with candidates only: {len(where)}, variables right {right}, the first candidate's form "
            f"{sum(a.get('form', False) for a in where)}"
        )
    if said:
        errors = np.array([a["force_error"] for a in said])
        lines.append(f"force error over the range seen, where a law is told: median {np.median(errors):.3f}")
        for which, what in (("form", "all numbers of the true form"), ("coefficients", "its coefficients alone")):
            best = np.array([a["oracle"][which] for a in said])
            whole = np.array([a["oracle"][which] for a in laws])
            lines.append(
                f"of the oracle, {what}: median {np.median(best):.3f} (of all laws {np.median(whole):.3f}); "
                f"answer over oracle: median {np.median(errors / best):.2f}"
            )
        for what in ("wider", "slower"):
            gaps = [a["beyond"][what] for a in laws if what in a.get("beyond", {})]
            there = [g for g in gaps if "answer" in g]
            unchanged = [g["before"] for g in gaps if "answer" not in g]
            held = [sum(g[which] <= FOLLOWED for g in there) for which in ("answer", "oracle")]
            lines.append(
                f"beyond, {what}: gap at most {FOLLOWED} in {held[0]} of {len(there)} told (oracle {held[1]}); "
                f"where none was told, it is as before: {sum(gap <= FOLLOWED for gap in unchanged)} of {len(unchanged)}"
            )
            off = [
                abs(removed_share(g["before"], g["answer"]) - removed_share(g["before"], g["oracle"]))
                for g in there if np.isfinite(g["before"]) and removed_share(g["before"], g["oracle"]) > OFF
            ]  # fmt: skip
            if off:
                lines.append(f"beyond, {what}: shrink off the oracle's by {np.median(off):.3f} (median of {len(off)})")
    for what, part in (
        ("nulls", [a for a in answers if not a["effects"]]),
        ("faults", [a for a in answers if _fault(a)]),
    ):
        if part:
            lines.append(f"{what} {len(part)}: a law told {sum(map(law_told, part))}")
    if answers:
        times = [a["seconds_law"] for a in answers]
        lines.append(
            f"seconds beside the diagnosis: {np.median(times):.0f} median, {max(times):.0f} at most, above {LONG_S} in "
            f"{sum(s > LONG_S for s in times)}"
        )
    return lines


def _fault(answer: dict[str, Any]) -> bool:
    return bool(answer["effects"]) and answer["effects"] != ["law"]


def _kept(path: Path) -> dict[str, dict[str, Any]]:
    """Name -> answer, of a file that may not be there yet."""
    answers = map(json.loads, path.read_text().splitlines()) if path.is_file() else ()
    return {answer["name"]: answer for answer in answers}


def main() -> None:
    """Draw, answer, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--faults", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--part", type=int, nargs=2, default=(0, 1), metavar=("K", "N"), help="answer each Nth alone, from the Kth on"
    )
    parser.add_argument("--judge", action="store_true", help="first judge anew what is answered")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "answers.jsonl"
    if given.judge:
        judged_again(given.out, given.seed)
    done = _kept(path)
    wanted = [(law_case, f"law-{k:03d}", k) for k in range(given.cases)]
    wanted += [(null_case, f"null-{k:03d}", NULLS_FROM + k) for k in range(given.nulls)]
    wanted += [(fault_case, f"fault-{k:03d}", FAULTS_FROM + k) for k in range(given.faults)]
    first, every = given.part
    for draw, name, k in wanted[first::every]:
        if name in done:
            continue
        case = draw(name, [given.seed, k])
        count = len(case.runs)
        if draw is law_case:
            case = with_more(case)
        try:
            write_cases(given.out, [case])
        except ValueError:  # a tow further out turns over
            case.runs[count:] = []
            write_cases(given.out, [case])
        done[name] = answered(given.out, case, count)
        with path.open("a") as file:
            file.write(json.dumps(done[name]) + "\n")
        print(line_of(done[name]), flush=True)
    done = _kept(path)  # others may have answered the other parts
    print("\n".join(["", *summary([done[name] for _, name, _ in wanted if name in done])]))


if __name__ == "__main__":
    main()
