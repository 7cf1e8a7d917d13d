"""The whole blind check: draw and seal, write folders, diagnose, open the seal, score. Every step goes on where it was stopped."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..pipeline.executor.processes import in_parallel
from ..record.files import JSON_BYTES, read_text, write_text
from .baselines import baseline_calls
from .draw import Wanted
from .judge import Judged, judged
from .measure import write_measured
from .progress import Progress, counted
from .run import answers, read_answers
from .scores import Bin, Score, calibration, scores
from .seal import ANSWERS, CASES, kept_digest, opened, sealed, write_cases
from .truth.cases import Case

MEASURED = "sealed/measured"
SCORE_JSON, SCORE_TEXT, PAGE = "score.json", "score.txt", "reliability.html"


@dataclass(frozen=True)
class Outcome:
    """Of a blind check.

    Attributes
    ----------
    digest : SHA-256 of the truth
    cases : judged ones
    table : scores
    bins : of the reliability diagram
    missing : cases without an answer yet
    """

    digest: str
    cases: list[Judged]
    table: list[Score]
    bins: list[Bin]
    missing: list[str]


def prepare(
    out: Path, wanted: Wanted, say: Callable[[str], None], workers: int = 1, progress: Progress | None = None
) -> str:
    """Draw, seal (the digests are said before anything else is written), write the folders; returns the truth's digest.

    Parameters
    ----------
    out : folder of the check
    wanted : what the check is to hold
    say : is told in a sentence what is done
    workers : processes
    progress : is told (what, done, of how many)
    """
    cases, digest = sealed(out, wanted, workers, progress)
    if wanted.forms != "classic":
        say(f"sha256 of the forms kept out: {kept_digest(wanted.keep_seed)}")
    say(f"sha256 of the truth: {digest}")
    write_cases(out, cases, workers, progress)
    return digest


def diagnose(out: Path, workers: int, progress: Progress | None = None) -> int:
    """Answer what has no answer yet; returns how many.

    Parameters
    ----------
    out : folder of the check
    workers : processes
    progress : is told (what, done, of how many)
    """
    return answers(out, workers, progress)


def score(out: Path, workers: int = 1, progress: Progress | None = None) -> Outcome:
    """Open the seal, measure the truth (kept in sealed/measured), score what is answered, write score.json.

    Parameters
    ----------
    out : folder of the check
    workers : processes
    progress : is told (what, done, of how many)

    Raises
    ------
    InputError : the truth does not fit its seal
    """
    cases, digest = opened(out)
    given = read_answers(out / ANSWERS)
    here = [case for case in cases if case.name in given]
    measures = measured_cases(out, here, workers, progress)
    found = [judged(case, given[case.name], measures[case.name], _calls(out, case, given[case.name])) for case in here]
    table = scores(found)
    bins = calibration([c for c in found if c.said != frozenset({"no answer"})])[1] if found else []
    outcome = Outcome(digest, found, table, bins, [case.name for case in cases if case.name not in given])
    write_text(out / SCORE_JSON, json.dumps(_plain(outcome), indent=1, sort_keys=True, default=_sorted) + "\n")
    return outcome


def measured_cases(
    out: Path, cases: Sequence[Case], workers: int, progress: Progress | None = None
) -> dict[str, dict[str, Any]]:
    """Case -> ``measure.measured``, from files where they stand already.

    Parameters
    ----------
    out : folder of the check
    cases : of the check
    workers : processes
    progress : is told (what, done, of how many)
    """
    todo = [case for case in cases if not (out / MEASURED / f"{case.name}.json").is_file()]
    jobs = [(case.to_json(), out / MEASURED / f"{case.name}.json") for case in todo]
    measured = in_parallel(write_measured, jobs, workers)
    for _ in counted(measured, "measuring what can be told apart", len(jobs), progress):
        pass
    files = {case.name: out / MEASURED / f"{case.name}.json" for case in cases}
    return {name: json.loads(read_text(path, JSON_BYTES)) for name, path in files.items()}


def _calls(out: Path, case: Case, answer: dict[str, Any]) -> dict[str, frozenset[str]]:
    return baseline_calls(sorted((out / CASES / case.name).glob("run-*")), answer)


def _plain(outcome: Outcome) -> dict[str, Any]:
    return {
        "schema": "towline/blind",
        "truth_sha256": outcome.digest,
        "scores": [asdict(s) for s in outcome.table],
        "reliability": [asdict(b) for b in outcome.bins],
        "cases": [asdict(c) for c in outcome.cases],
        "without_answer": outcome.missing,
    }


def _sorted(value: object) -> list[str]:
    assert isinstance(value, frozenset)
    return sorted(value)
