"""The seal of a blind check: its truth is one JSON text, whose SHA-256 is made known before anything is diagnosed."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from ..pipeline.executor.processes import in_parallel
from ..record.errors import InputError
from ..record.files import JSON_BYTES, read_text, write_text
from .draw import Wanted, drawn
from .progress import Progress, counted
from .truth.cases import Case
from .truth.forms import KEEP_SEED, kept_out

TRUTH, SEAL, CASES, ANSWERS = "sealed/truth.json", "seal.txt", "cases", "answers"
"""Of a check, in its folder."""
BEFORE_FORMS = {"forms": "classic", "keep_seed": KEEP_SEED}
"""What a truth wanted that was drawn when every effect had one form."""


def truth_text(cases: list[Case], wanted: Wanted) -> str:
    """The truth file.

    Parameters
    ----------
    cases : of the check
    wanted : what the check is to hold
    """
    content = {"wanted": asdict(wanted), "cases": [case.to_json() for case in cases]}
    return json.dumps(content, indent=1, sort_keys=True) + "\n"


def sealed(out: Path, wanted: Wanted, workers: int = 1, progress: Progress | None = None) -> tuple[list[Case], str]:
    """Draw, write the seal, then the truth; what was drawn before is kept and checked.

    Parameters
    ----------
    out : folder of the check
    wanted : what the check is to hold
    workers : processes
    progress : is told (what, done, of how many)

    Returns
    -------
    The cases, and the SHA-256 of the truth file.

    Raises
    ------
    InputError : OUT holds a truth that its seal does not fit, or one drawn otherwise
    """
    if (out / TRUTH).is_file():
        kept, old = opened(out)
        before = BEFORE_FORMS | json.loads(read_text(out / TRUTH, JSON_BYTES))["wanted"]
        if before != json.loads(json.dumps(asdict(wanted))):
            raise InputError(out / TRUTH, "wanted", f"{before} was drawn here; give another folder or the same numbers")
        return kept, old
    cases = drawn(wanted, workers, progress)
    text = truth_text(cases, wanted)
    digest = sha256_of_text(text)
    write_text(out / SEAL, f"{digest}  {TRUTH}\n")
    write_text(out / TRUTH, text)
    return cases, digest


def opened(out: Path) -> tuple[list[Case], str]:
    """Break the seal: the cases, and the digest that the file has.

    Raises
    ------
    InputError : no truth, no seal, or they do not fit
    """
    for name in (SEAL, TRUTH):
        if not (out / name).is_file():
            raise InputError(out / name, "", "no such file")
    text = read_text(out / TRUTH, JSON_BYTES)
    digest, stated = sha256_of_text(text), read_text(out / SEAL, JSON_BYTES).split()[0]
    if digest != stated:
        raise InputError(out / TRUTH, "sha256", f"{digest[:12]}..., the seal says {stated[:12]}...")
    return [Case.from_json(values) for values in json.loads(text)["cases"]], digest


def kept_digest(keep_seed: int) -> str:
    """SHA-256 of the list of forms that a seed keeps out (JSON, effects in alphabetical order).

    Parameters
    ----------
    keep_seed : of ``Wanted``
    """
    return sha256_of_text(json.dumps(kept_out(keep_seed), sort_keys=True))


def sha256_of_text(text: str) -> str:
    """SHA-256 of a text as it stands in its file (what ``sha256sum`` prints)."""
    import hashlib

    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def write_cases(out: Path, cases: list[Case], workers: int = 1, progress: Progress | None = None) -> None:
    """Write every case's run folders; what is whole already is left alone.

    Parameters
    ----------
    out : folder of the check
    cases : of the check
    workers : processes
    progress : is told (what, done, of how many)
    """
    written = in_parallel(_write, [(out, case) for case in cases], workers)
    for _ in counted(written, "writing campaigns", len(cases), progress):
        pass


def _write(out: Path, case: Case) -> None:
    from .truth.folders import write_case

    folder = out / CASES / case.name
    if not all((folder / f"run-{i + 1}" / "run.toml").is_file() for i in range(len(case.runs))):
        write_case(folder, case)
