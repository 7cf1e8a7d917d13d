"""Answers to withheld campaigns: runs the diagnosis over every folder of campaigns and writes one JSON file.

    python benchmarks/blind.py CASES -o benchmarks/blind/answers-c.json [--workers 2] [--line constant]

CASES holds folders, each with run folders run-1, run-2, ... No truth is read or known. What was answered already is kept when the
command is started again with the same file; the commit that made it stands in the file. In set c (answers-c.json) lines keep
their length, as run.toml has it; set a (answers.json to answers-5.json) was made with T held constant, which ``--line constant``
says of its runs.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from towline.pipeline.diagnosing import diagnose_folders
from towline.record import TowlineError
from towline.simulate.model import Line


def answer(case: Path, line: Line | None = None) -> tuple[str, dict, float]:
    """One campaign's gap.json, or why there is none; ``line``: what its lines keep, instead of what run.toml states."""
    began = time.perf_counter()
    try:
        found = diagnose_folders(sorted(case.glob("run-*")), line=line)
        result = found.diagnosis.file.model_dump(mode="json", by_alias=True)
    except TowlineError as error:
        result = {"verdict": "unknown", "error": str(error)}
    return case.name, result, time.perf_counter() - began


def main() -> None:
    """Answer all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--line", choices=("surge", "constant"), help="what the lines keep, instead of what is stated")
    given = parser.parse_args()
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    answers: dict = json.loads(given.out.read_text()) if given.out.is_file() else {}
    if answers.get("commit", commit) != commit:
        raise SystemExit(f"{given.out} was made by commit {answers['commit']}; give another file for this one")
    answers["commit"] = commit
    todo = [c for c in sorted(given.cases.iterdir()) if c.is_dir() and c.name not in answers]
    given.out.parent.mkdir(parents=True, exist_ok=True)
    for name, result, spent in _each(todo, given.workers, given.line):
        answers[name] = result
        best = result["ranking"][0] if result.get("ranking") else {}
        words = f"{' + '.join(best.get('effects', []))} {best.get('probability', 0):.2f}"
        print(f"{name}: {result['verdict']:8} {words}, {spent:.1f} s", flush=True)
        given.out.write_text(json.dumps(answers, indent=1, sort_keys=True) + "\n")


def _each(todo: list[Path], workers: int, line: Line | None) -> Iterator[tuple[str, dict, float]]:
    """Answers as they come; one worker has all cores for each campaign."""
    if workers == 1:
        yield from (answer(case, line) for case in todo)
        return
    with ProcessPoolExecutor(workers) as pool:
        for job in as_completed([pool.submit(answer, case, line) for case in todo]):
            yield job.result()


if __name__ == "__main__":
    main()
