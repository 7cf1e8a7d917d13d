"""The hull of the towing simulator as an FMU, on campaigns of a blind check: the verdict that towline's own equations give?

    towline blind OUT --cases 40 --nulls 8 --seed 1 --only-write
    python benchmarks/tow_fmu.py OUT [--workers 2] > benchmarks/tow_fmu.txt

The FMU is ``examples/hull_fmu.py``'s: equations in C that share nothing with towline's but theory.md. Each campaign is diagnosed by
both; the same verdict with the same effects first counts as the same. The built-in answers are OUT/answers, as ``towline blind``
writes them, so that it can score them. Started again, it goes on. Needs fmpy and a C compiler.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from towline.blind.run import answered
from towline.pipeline.diagnosing import diagnose_folders
from towline.pipeline.executor.processes import in_parallel
from towline.record.errors import TowlineError

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
import hull_fmu
from fmu_of_c import make


def by_fmu(name: str, folders: list[Path], to: Path, hull: Path) -> str:
    """Answer one campaign with the FMU's hull."""
    began, found = time.perf_counter(), dict[str, Any]()
    try:
        found["gap"] = diagnose_folders(folders, hull=hull).diagnosis.file.model_dump(mode="json", by_alias=True)
    except TowlineError as error:
        found["error"] = str(error)
    found["seconds"] = round(time.perf_counter() - began, 2)
    to.write_text(json.dumps(found, indent=1) + "\n")
    return name


def said(answer: dict[str, Any]) -> tuple[str, list[str], float]:
    """Verdict, what is named first, and its log evidence."""
    if "gap" not in answer:
        return "no answer", [], 0.0
    gap = answer["gap"]
    named = gap["verdict"] in ("effect", "form_not_exact")
    first = gap["ranking"][0] if gap["ranking"] else {"effects": [], "log_evidence": 0.0}
    return gap["verdict"], first["effects"] if named else [], first["log_evidence"]


def main() -> None:
    """All campaigns, a line each, and how many are the same."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    hull, answers = given.out / "hull.fmu", given.out / "answers-fmu"
    make(hull, "hull", hull_fmu.EQUATIONS, hull_fmu.VARIABLES, len(hull_fmu.STATES))
    answers.mkdir(exist_ok=True)
    cases = sorted((given.out / "cases").iterdir())
    runs = {case.name: sorted(case.glob("run-*")) for case in cases}
    (given.out / "answers").mkdir(exist_ok=True)
    jobs = [(name, folders, answers / f"{name}.json", hull) for name, folders in runs.items()]
    answered([(name, folders, given.out / "answers" / f"{name}.json") for name, folders in runs.items()], given.workers)
    for _ in in_parallel(by_fmu, [job for job in jobs if not job[2].is_file()], given.workers):
        pass
    for name in runs:
        _print(given.out, name)
    both = [
        [said(json.loads((given.out / of / f"{n}.json").read_text())) for of in ("answers", "answers-fmu")]
        for n in runs
    ]
    same = sum(one[:2] == other[:2] for one, other in both)
    print(f"the same verdict and effects in {same} of {len(both)}")


def _print(out: Path, name: str) -> None:
    one, other = (json.loads((out / of / f"{name}.json").read_text()) for of in ("answers", "answers-fmu"))
    (verdict, effects, log), (there, named, far) = said(one), said(other)
    word = "same" if (verdict, effects) == (there, named) else f"FMU: {there} {' + '.join(named)}"
    print(
        f"{name} {verdict:15}{' + '.join(effects) or '-':44}log evidence {log:9.2f} / {far:9.2f}"
        f"{one['seconds']:7.1f} s / {other['seconds']:6.1f} s  {word}",
        flush=True,
    )


if __name__ == "__main__":
    main()
