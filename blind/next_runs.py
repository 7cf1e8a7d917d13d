"""Does the proposed next run (or measurement) settle what was left open? Reality makes it, and the diagnosis is asked once more."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..record.files import TOML_BYTES, read_text, write_text
from .judge import Call, call_of, names_of, truth_of
from .one_case import tow_of
from .progress import Progress
from .run import answered, read_answers
from .scores import Score, share
from .seal import ANSWERS, CASES, opened
from .truth.apart import measured_apart
from .truth.cases import Case

NEXT, NEXT_ANSWERS = "next", "next-answers"


@dataclass(frozen=True)
class Settled:
    """A case with its next run.

    Attributes
    ----------
    name, truth : of the case
    before, after : calls by name, the form exact or not
    open_before, open_after : hypotheses in the 95 % set
    distance : D that was expected
    by : "tow", or the effect that was measured without one
    """

    name: str
    truth: Call
    before: Call
    after: Call
    open_before: int
    open_after: int
    distance: float
    by: str


def with_next_run(case: Case, proposed: dict[str, Any]) -> Case:
    """The case with one tow more, as proposed; the pull of a straight tow is the hull's at that speed, and read anew.

    Parameters
    ----------
    case : as drawn
    proposed : next run of gap.json
    """
    stated = {
        "tow_point_m": float(proposed["tow_point_m"]),
        "line_m": float(proposed["line_length_m"]),
        "speed_m_s": float(proposed["speed_m_s"]),
        "y_m": float(proposed["y_release_m"]),
        "beta_rad": float(proposed["beta_release_rad"]),
    }
    return replace(case, runs=[*case.runs, tow_of(case.hull, stated, np.random.default_rng([case.seed, 9]))])


def next_runs(out: Path, workers: int = 1, progress: Progress | None = None) -> list[Settled]:
    """Make and diagnose the next run of every case in which an effect is named and the 95 % set holds more than it.

    Parameters
    ----------
    out : folder of the check
    workers : processes
    progress : is told (what, done, of how many)
    """
    cases, _ = opened(out)
    given = read_answers(out / ANSWERS)
    jobs, chosen = [], []
    for case in cases:
        gap = given.get(case.name, {}).get("gap")
        if gap is None or gap["next_run"] is None or gap["verdict"] != "effect" or len(gap["set95"]) < 2:
            continue
        apart = gap.get("next_measurement")
        proposed = gap["next_run"]
        more = _towed
        if apart is not None and apart["distance"] > proposed["distance"]:
            proposed, more = apart, _measured
        made = sorted((out / CASES / case.name).glob("run-*"))
        try:
            runs = more(out / NEXT / case.name, case, proposed, made)
        except ValueError:  # the tow turned over: the run tells nothing
            continue
        jobs.append((case.name, runs, out / NEXT_ANSWERS / f"{case.name}.json"))
        chosen.append((case, proposed))
    answered(jobs, workers, progress)
    after = read_answers(out / NEXT_ANSWERS)
    found = []
    for case, proposed in chosen:
        before, then = given[case.name]["gap"], after[case.name].get("gap")
        if then is None:
            continue
        found.append(
            Settled(
                case.name,
                truth_of(case),
                names_of(call_of(before)[0]),
                names_of(call_of(then)[0]),
                len(before["set95"]),
                len(then["set95"]),
                float(proposed["distance"]),
                proposed.get("effect", "tow"),
            )
        )
    plain = [{**vars(s), "truth": sorted(s.truth), "before": sorted(s.before), "after": sorted(s.after)} for s in found]
    write_text(out / "next.json", json.dumps(plain, indent=1, sort_keys=True) + "\n")
    return found


def _towed(folder: Path, case: Case, proposed: dict[str, Any], made: list[Path]) -> list[Path]:
    """One tow more; raises ValueError where it turns over."""
    from .truth.folders import write_run

    more = folder / f"run-{len(case.runs) + 1}"
    if not (more / "run.toml").is_file():
        with np.errstate(all="ignore"):
            write_run(folder, with_next_run(case, proposed), len(case.runs))
    return [*made, more]


def _measured(folder: Path, case: Case, proposed: dict[str, Any], made: list[Path]) -> list[Path]:
    """The same tows; what was measured stands in the first one's run.toml."""
    rng = np.random.default_rng([case.seed, 10])
    first = folder / made[0].name
    if not (first / "run.toml").is_file():
        shutil.copytree(made[0], first, ignore=shutil.ignore_patterns("run.toml", "out"), dirs_exist_ok=True)
        text = read_text(made[0] / "run.toml", TOML_BYTES)
        for number, sd in sorted(proposed["numbers"].items()):
            value = measured_apart(case, number, sd, rng)
            text += f'\n[[measured]]\nnumber = "{number}"\nvalue = {value:.8g}\nsd = {sd:g}\n'
        write_text(first / "run.toml", text)
    return [first, *made[1:]]


def next_scores(found: list[Settled]) -> list[Score]:
    """Open sets that the run closed on the truth; how often it was right before and after."""
    strata = {
        "all open": found,
        "expected D > 20": [s for s in found if s.distance > 20],
        "by a tow": [s for s in found if s.by == "tow"],
        "measured": [s for s in found if s.by != "tow"],
    }
    rows = []
    for stratum, of in strata.items():
        if of:
            rows.append(share("right before", stratum, "towline", (s.before == s.truth for s in of)))
            rows.append(share("right after the next run", stratum, "towline", (s.after == s.truth for s in of)))
            rows.append(
                share("closed on the truth", stratum, "towline", (s.open_after == 1 and s.after == s.truth for s in of))
            )
    return rows


def next_text(found: list[Settled]) -> str:
    """The scores as lines."""
    rows = [
        f"{s.what:34}{s.stratum:16}{s.hits}/{s.of} ({100 * s.low:.0f}-{100 * s.high:.0f} %)" for s in next_scores(found)
    ]
    return "\n".join(["next runs", *(rows or ["none was open"])]) + "\n"


__all__ = ["Settled", "next_runs", "next_scores", "next_text", "with_next_run"]
