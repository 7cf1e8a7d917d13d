"""What one worker does: a run's motion, or a fit of several runs. Arguments and answers are plain, so that they travel."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...record.campaigns import TRIM, Answer, Number
from ...record.each import Each, in_turn
from ...record.errors import TowlineError
from ...record.files import JSON_BYTES, read_text, sha256_of_texts, write_text
from ...record.names import lines_joined
from ...record.schema import Line

if TYPE_CHECKING:
    from ...identify import Fit

RECORD = "campaign.json"
"""Beside a run's or a fit's results, written last: what they were made from, and the answer."""
FIT = ".fit.json"
"""Beside them while the page is not drawn: the fit."""
WANTS = ", "


@dataclass(frozen=True)
class Options:
    """How runs are analysed.

    Attributes
    ----------
    method : camera method of ``stages.compute_run_motion``
    form, speed_m_s, noise : of ``analysis.identify_batch``
    fresh : redo what is up to date
    line : what every tow line keeps, instead of what the runs say
    """

    method: str = "exact"
    form: str = "full"
    speed_m_s: float | None = None
    noise: str = "auto"
    fresh: bool = False
    line: Line | None = None


Tell = Callable[[str], None]


def silent(said: str) -> None:
    """Nobody is told."""


def run_job(job: str, folder: str, options: dict[str, Any]) -> dict[str, Any]:
    """Tracks and motion of one run; whatever goes wrong is its reason.

    Parameters
    ----------
    job : its name
    folder : of the run
    options : of the campaign
    """
    return _answered(job, "", lambda: _moved(job, Path(folder), Options(**options)))


def fit_job(
    job: str,
    kind: str,
    folders: Sequence[str],
    out: str,
    options: dict[str, Any],
    each: Each = in_turn,
    tell: Tell = silent,
) -> dict[str, Any]:
    """Derivatives or steady state of several runs, unless they stand in ``out`` already.

    Parameters
    ----------
    job : its name
    kind : of the fit
    folders : run folders
    out : folder of the results
    options : of the campaign
    each : does a run's share
    tell : hears what is going on
    """
    return _answered(job, job, lambda: _fit(job, kind, folders, Path(out), Options(**options), each, tell))


def _answered(job: str, name: str, work: Callable[[], Answer]) -> dict[str, Any]:
    try:
        answer = work()
    except TowlineError as error:
        answer = Answer(job, name, reason=lines_joined(str(error)))
    except Exception as error:  # a defect here must not cost the other runs
        answer = Answer(job, name, reason=f"{type(error).__name__}: {lines_joined(str(error))}")
    return asdict(answer)


def _fit(job: str, kind: str, folders: Sequence[str], out: Path, options: Options, each: Each, tell: Tell) -> Answer:
    stamp = _stamp(kind, folders, options)

    def worked_out() -> Answer:
        if kind == "derivatives":
            return _fitted(job, folders, out, options, stamp, each, tell)
        if kind == "free_run":
            return _freed(job, folders, out, options, stamp)
        return _settled(job, folders, out, options, stamp)

    answer = _once(out, stamp, options.fresh, worked_out)
    (out / FIT).unlink(missing_ok=True)
    return answer


def _moved(job: str, folder: Path, options: Options) -> Answer:
    from ...record.run import read_run
    from ...record.tables import input_hash_of
    from ..stages import MOTION, compute_run_motion
    from ..stages.versions import made_by

    run = read_run(folder, options.line)
    before = input_hash_of(run.out / MOTION) if (run.out / MOTION).is_file() else ""
    m = compute_run_motion(run, options.method, fresh=options.fresh)
    imported = run.file.source.motion is not None
    stamp = run.input_hash() if imported else input_hash_of(run.out / MOTION) or ""
    redone = not imported and (options.fresh or stamp != before)
    # whether a tow has settled takes longer to tell than all the rest of a run that is up to date
    made_from = sha256_of_texts(made_by("fit"), options.method, str(options.line), stamp)
    answer = _once(run.out, made_from, options.fresh, lambda: _looked_at(job, run, m, made_from))
    return replace(answer, job=job, stamp=stamp, redone=redone)


def _looked_at(job: str, run: Any, m: Any, stamp: str) -> Answer:
    """What a run is good for, and its numbers."""
    from ..analysis import good_for, has_rudder, hull_of

    wants = WANTS.join(good_for(m))
    wants = "free_run" if has_rudder(m) and run.file.model is not None else wants
    hull = hull_of(run) if run.file.model is not None and run.file.water is not None else ()
    if not hull and run.file.model is not None:
        hull = run.file.model.length_pp_m, run.file.model.mass_kg
    return Answer(job, run.name, "", wants, hull, _numbers(run, m), stamp=stamp)


def _numbers(run: Any, m: Any) -> tuple[Number, ...]:
    motion, tow = m.motion, run.file.tow
    good = (motion["status"] == "measured").to_numpy()
    t_s = motion["t_s"].to_numpy()
    found: list[Number] = [
        ("samples", float(len(motion)), None, ""),
        ("measured_share", float(good.mean()) if len(good) else math.nan, None, ""),
        ("duration", float(t_s[-1] - t_s[0]) if len(t_s) else math.nan, None, "s"),
    ]
    if tow is not None:
        for name, unit in (("speed_m_s", "m/s"), ("tow_point_m", "m"), ("line_length_m", "m"), ("tension_n", "N")):
            value = getattr(tow, name)
            if value is not None:
                found.append((name.rsplit("_m", 1)[0].removesuffix("_n"), float(value), None, unit))
    if run.file.model is not None and run.file.model.trim_rad is not None:
        found.append((TRIM, float(run.file.model.trim_rad), None, "rad"))
    for column, name, unit in (
        ("y_cg_m", "y_cg", "m"),
        ("beta_rad", "beta", "rad"),
        ("alpha_rad", "alpha", "rad"),
    ):
        values = motion[column].to_numpy(dtype=float)[good] if column in motion else np.zeros(0)
        values = values[np.isfinite(values)]
        if len(values):
            found.append((f"{name}_largest", float(np.abs(values).max()), None, unit))
    for column, name, unit in (("sigma_y_cg_m", "y_cg_sigma", "m"), ("sigma_beta_rad", "beta_sigma", "rad")):
        values = motion[column].to_numpy(dtype=float)[good] if column in motion else np.zeros(0)
        if np.isfinite(values).any():
            found.append((name, float(np.nanmedian(values)), None, unit))
    return tuple(found)


def _fitted(
    job: str, folders: Sequence[str], out: Path, options: Options, stamp: str, each: Each, tell: Tell
) -> Answer:
    from ...record.results import write_result
    from ...report.identify_page import write_identify_page
    from ..analysis import compute_motions, fit_page, identify_batch

    batch = compute_motions(folders, options.method, line=options.line)

    def kept(fit: Callable[[], Fit]) -> Fit:
        return _kept_fit(out / FIT, stamp, options.fresh, fit)

    answer = identify_batch(batch, options.form, options.speed_m_s, None, tell, options.noise, each, kept)
    write_result(out / "derivatives.json", answer.result)
    tell("drawing the page")
    write_identify_page(out / "derivatives.html", fit_page(answer, None, tell, each), each)
    result = answer.result
    numbers = [(name, d.value, d.std, d.unit) for name, d in result.derivatives.items()]
    numbers += [(f"{name}_prime", d.prime, d.prime_std, "") for name, d in result.derivatives.items()]
    wrote = ("derivatives.json", "derivatives.html")
    return Answer(job, job, "", "derivatives", (), tuple(numbers), result.failed, wrote, stamp)


def _freed(job: str, folders: Sequence[str], out: Path, options: Options, stamp: str) -> Answer:
    from ...record.results import write_result
    from ...report import write_page
    from ..analysis import compute_motions, identify_free_batch
    from ..stages import make_run_page

    answer = identify_free_batch(compute_motions(folders, options.method), options.speed_m_s)
    result = answer.result
    write_result(out / "derivatives.json", result)
    pages = [make_run_page(m, answer.fitted[m.run.name], None) for m in answer.runs]
    write_page(out / "derivatives.html", f"Free runs: {', '.join(answer.fitted)}", pages, result, None, [])
    numbers: list[Number] = [(name, d.value, d.std, d.unit) for name, d in result.derivatives.items()]
    numbers += [(f"{name}_prime", d.prime, d.prime_std, "") for name, d in result.derivatives.items()]
    wrote = ("derivatives.json", "derivatives.html")
    return Answer(job, job, "", "free_run", (), tuple(numbers), result.failed, wrote, stamp)


def _settled(job: str, folders: Sequence[str], out: Path, options: Options, stamp: str) -> Answer:
    from ...record.results import write_result
    from ..analysis import compute_motions, fit_steady_batch

    result = fit_steady_batch(compute_motions(folders, options.method, line=options.line))
    write_result(out / "steady.json", result)
    numbers: list[Number] = [("x_v", result.x_v_m.value, result.x_v_m.std, "m")]
    if result.y_v is not None:
        numbers.append(("y_v", result.y_v.value, result.y_v.std, "N s/m"))
    return Answer(job, job, "", "steady", (), tuple(numbers), result.failed, ("steady.json",), stamp)


def _stamp(kind: str, folders: Sequence[str], options: Options) -> str:
    from ...record.run import read_run
    from ..stages.versions import made_by, stamp_of

    runs = [stamp_of(read_run(folder), "fit", options.method) for folder in folders]
    words = (kind, options.form, str(options.speed_m_s), options.noise, str(options.line))
    return sha256_of_texts(made_by("fit"), *words, *runs)


def _once(out: Path, stamp: str, fresh: bool, work: Callable[[], Answer]) -> Answer:
    """What ``work`` gives, or gave before from the same; its record is written last."""
    answer = None if fresh else _kept(out / RECORD, stamp)
    if answer is not None:
        return replace(answer, redone=False)
    answer = work()
    write_text(out / RECORD, json.dumps(asdict(answer), indent=1, sort_keys=True) + "\n")
    return answer


def _kept(path: Path, stamp: str) -> Answer | None:
    """The answer of before, if it was made from the same, and its files are there."""
    try:
        record = json.loads(read_text(path, JSON_BYTES))
    except (ValueError, RecursionError, TowlineError):
        return None
    if not isinstance(record, dict) or record.get("stamp") != stamp:
        return None
    try:
        answer = restored(record)
        return answer if all((path.parent / name).is_file() for name in answer.wrote) else None
    except (KeyError, TypeError, ValueError):  # damaged: done again
        return None


def _kept_fit(path: Path, stamp: str, fresh: bool, fit: Callable[[], Fit]) -> Fit:
    """What ``fit`` gives, or gave before this was stopped on its way to the page."""
    from ...identify.stored import fit_as_text, fit_from_text

    try:
        said, _, text = read_text(path, JSON_BYTES).partition("\n")
        if said == stamp and not fresh:
            return fit_from_text(text)
    except (ValueError, TowlineError):
        pass
    text = fit_as_text(fit())
    write_text(path, f"{stamp}\n{text}")
    return fit_from_text(text)  # as it lies in memory then: sums of the same order give the same last digit


def restored(plain: dict[str, Any]) -> Answer:
    """An answer from its plain form."""
    numbers = tuple((q, v, s, u) for q, v, s, u in plain["numbers"])
    return Answer(**{**plain, "numbers": numbers, "hull": tuple(plain["hull"]), "wrote": tuple(plain["wrote"])})


__all__ = ["Options", "fit_job", "restored", "run_job"]
