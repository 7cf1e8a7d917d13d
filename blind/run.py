"""Diagnoses every campaign of a blind check from its folders alone, in parallel, and goes on where it was stopped."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..pipeline.executor.processes import in_parallel
from ..record.errors import TowlineError
from ..record.files import JSON_BYTES, read_text, write_text
from .progress import Progress, counted
from .seal import ANSWERS, CASES


def answers(out: Path, workers: int = 1, progress: Progress | None = None) -> int:
    """Answer every case of OUT/cases that has no answer yet, one file each in OUT/answers.

    Parameters
    ----------
    out : of ``draw.sealed`` and ``draw.write_cases``; the truth is not read
    workers : processes
    progress : is told (what, done, of how many)

    Returns
    -------
    How many were answered now.
    """
    jobs = [(folder, sorted(folder.glob("run-*")), out / ANSWERS) for folder in sorted((out / CASES).iterdir())]
    return answered([(f.name, runs, to / f"{f.name}.json") for f, runs, to in jobs], workers, progress)


def answered(jobs: Sequence[tuple[str, list[Path], Path]], workers: int, progress: Progress | None = None) -> int:
    """Diagnose lists of run folders: (name, folders, answer file); a file that exists is an answer already.

    Parameters
    ----------
    jobs : name, run folders and answer file of each
    workers : processes
    progress : is told (what, done, of how many)
    """
    todo = [job for job in jobs if not job[2].is_file()]
    done = len(jobs) - len(todo)

    if progress is not None:
        progress("diagnosing campaigns", done, len(jobs))
    for _ in counted(in_parallel(_answer, todo, workers), "diagnosing campaigns", len(jobs), progress, done):
        pass
    return len(todo)


def _answer(name: str, folders: list[Path], to: Path) -> str:
    from ..pipeline.diagnosing import diagnose_folders

    began = time.perf_counter()
    found: dict[str, Any] = {"case": name, "runs": len(folders)}
    try:
        result = diagnose_folders(folders)
        found["gap"] = result.diagnosis.file.model_dump(mode="json", by_alias=True)
        found["failed"] = result.failed
    except TowlineError as error:
        found["error"] = str(error)
    except Exception as error:  # a defect: this case has no answer, and the score says so; the others go on
        found["error"] = f"{type(error).__name__}: {error}"
    found["seconds"] = round(time.perf_counter() - began, 2)
    write_text(to, json.dumps(found, indent=1, sort_keys=True) + "\n")
    return name


def read_answers(folder: Path) -> dict[str, dict[str, Any]]:
    """Case -> answer, of a folder of answer files."""
    return {p.stem: json.loads(read_text(p, JSON_BYTES)) for p in sorted(folder.glob("*.json"))}


__all__ = ["answered", "answers", "read_answers"]
