"""The long jobs, as the commands do them: each takes folders and options, writes into out/, and says what it found.

They run in a process of their own (``worker``); what they return travels back, so it is plain: words, numbers, paths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..pipeline.progress import Progress


@dataclass(frozen=True)
class Found:
    """What a job ended with.

    Attributes
    ----------
    title : what was done
    sentences : for the user
    rows : name, value with its uncertainty, unit
    pages : HTML pages written
    files : other files written
    failed : run -> why
    """

    title: str
    sentences: tuple[str, ...] = ()
    rows: tuple[tuple[str, str, str], ...] = ()
    pages: tuple[Path, ...] = ()
    files: tuple[Path, ...] = ()
    failed: dict[str, str] = field(default_factory=dict)


def track(folders: Sequence[Path], tell: Progress, fresh: bool = False) -> Found:
    """Track the marks and work the motion out: ``towline motion``.

    Parameters
    ----------
    folders : run folders
    tell : is told (what, done, of how many)
    fresh : make it anew even where out/ is up to date
    """
    from ..pipeline.stages import CAMERA, MARKS, MOTION, TRACKS, compute_run_motion, track_run
    from ..record.run import read_run
    from ..record.tables import BY_HAND

    (folder,) = folders
    run = read_run(folder)
    notes: tuple[str, ...] = ()
    if run.file.source.motion is None:
        notes = track_run(run, tell, fresh).notes
    made = compute_run_motion(run, "exact", tell)
    table, said = made.motion, list(notes)
    good = int((table["status"] != "lost").sum())
    said.insert(
        0, f"motion in {good} of {len(table)} frames, {table['t_s'].iloc[0]:.2f} to {table['t_s'].iloc[-1]:.2f} s"
    )
    if made.tracks is not None:
        for name, rows in made.tracks.groupby("marker", sort=False):
            lost = rows[rows["status"] == "lost"]
            why = ""
            if len(lost) and "reason" in rows:
                why = f" ({', '.join(f'{reason}: {n}' for reason, n in lost['reason'].value_counts().items())})"
            by_hand = int((rows["status"] == BY_HAND).sum())
            said.append(
                f"{name}: measured in {int((rows['status'] == 'measured').sum())} frames, "
                + (f"set by hand in {by_hand}, " if by_hand else "")
                + f"lost in {len(lost)}{why}"
            )
    files = tuple(path for name in (TRACKS, MARKS, MOTION, CAMERA) if (path := run.out / name).is_file())
    return Found("Track", tuple(said), (), (), files)


def check(folders: Sequence[Path], tell: Progress, effects: bool = True) -> Found:
    """Is the camera right: ``towline check``.

    Parameters
    ----------
    folders : run folders
    tell : is told (what, done, of how many)
    effects : also say what each camera uncertainty does to the derivatives
    """
    from ..pipeline.analysis import output_folder
    from ..pipeline.checking import checked, filmed_runs, set_ups
    from ..record.results import write_result
    from ..report.check_page import write_check_page

    runs, tables, failed = filmed_runs(folders, tell)
    said: list[str] = []
    pages, files = [], []
    for stem, some, their in set_ups(runs, tables):
        found = checked(some, their, (), effects, lambda text: tell(text, 0, None))
        out = output_folder([r.folder for r in some])
        write_result(out / f"{stem}.json", found.file)
        write_check_page(out / f"{stem}.html", found)
        files.append(out / f"{stem}.json")
        pages.append(out / f"{stem}.html")
        said.append(f"{', '.join(found.file.runs)}: {found.file.verdict}")
        said += [*found.file.sentences, *found.file.notes]
    return Found("Check", tuple(said), (), tuple(pages), tuple(files), failed)


def identify(folders: Sequence[Path], tell: Progress, form: str = "full") -> Found:
    """The six derivatives: ``towline identify``.

    Parameters
    ----------
    folders : run folders
    tell : is told (what, done, of how many)
    form : "full" or "linear"
    """
    from ..pipeline.analysis import compute_motions, fit_page, identify_batch, output_folder
    from ..record.results import write_result
    from ..report.format import SYMBOLS_TEXT, plus_minus
    from ..report.identify_page import write_identify_page
    from ..simulate.model import DERIVATIVE_UNITS

    batch = compute_motions(folders, "exact", tell)
    _some(batch.runs, batch.failed)
    out = output_folder(folders)
    say: Callable[[str], None] = lambda text: tell(text, 0, None)  # noqa: E731
    answer = identify_batch(batch, form, None, None, say)
    write_result(out / "derivatives.json", answer.result)
    write_identify_page(out / "derivatives.html", fit_page(answer, None, say))
    rows = []
    for name, unit in DERIVATIVE_UNITS.items():
        value = answer.result.derivatives[name]
        rows.append((SYMBOLS_TEXT.get(name, name), plus_minus(value.value, value.std), unit))
    said = [*answer.result.not_identifiable, *answer.result.notes]
    said.insert(0, f"{len(answer.runs)} of {len(folders)} runs, {form} equations, at {answer.result.speed_m_s:.3g} m/s")
    return Found(
        "Identify",
        tuple(said),
        tuple(rows),
        (out / "derivatives.html",),
        (out / "derivatives.json",),
        answer.result.failed,
    )


def steady(folders: Sequence[Path], tell: Progress) -> Found:
    """The neutral point: ``towline steady``, with the page of ``towline run``.

    Parameters
    ----------
    folders : run folders
    tell : is told (what, done, of how many)
    """
    from ..pipeline.analysis import compute_motions, fit_steady_batch, output_folder
    from ..pipeline.stages import make_run_page
    from ..record.results import write_result
    from ..report import write_page
    from ..report.format import plus_minus

    batch = compute_motions(folders, "exact", tell)
    _some(batch.runs, batch.failed)
    result = fit_steady_batch(batch)
    out = output_folder(folders)
    write_result(out / "steady.json", result)
    tell("drawing", 0, None)
    pages = [make_run_page(m, None, result.failed.get(m.run.name)) for m in batch.runs]
    write_page(out / "steady.html", f"{len(pages)} steady tows", pages, None, result, list(result.notes))
    low, high = result.x_v_interval_m
    rows = (("X_v, ahead of LCG", plus_minus(result.x_v_m.value, result.x_v_m.std), "m"),)
    said = (f"95 % interval {low:.4g} to {high:.4g} m", *result.notes)
    return Found("Steady", said, rows, (out / "steady.html",), (out / "steady.json",), result.failed)


def diagnose(folders: Sequence[Path], tell: Progress) -> Found:
    """Where simulator and tank differ: ``towline diagnose``.

    Parameters
    ----------
    folders : run folders
    tell : is told (what, done, of how many)
    """
    from ..pipeline.analysis import output_folder
    from ..pipeline.diagnosing import diagnose_folders
    from ..record.results import write_result
    from ..report.gap_page import write_gap_page

    found = diagnose_folders(folders, progress=tell)
    file = found.diagnosis.file
    out = output_folder([run.folder for run in found.runs])
    write_result(out / "gap.json", file)
    write_gap_page(out / "gap.html", found)
    rows = [("nothing missing", f"{file.p_no_gap:.3f}", "")]
    rows += [(" + ".join(r.effects), f"{r.named:.3f}", "") for r in file.ranking[:4]]
    rows.append(("something in no library", f"{file.p_unknown:.3f}", ""))
    return Found(
        "Diagnose", tuple(file.sentences), tuple(rows), (out / "gap.html",), (out / "gap.json",), dict(found.failed)
    )


def _some(runs: Sequence[object], failed: dict[str, str]) -> None:
    from ..record.errors import TowlineError

    if not runs:
        raise TowlineError("; ".join(failed.values()) or "no run could be used")


JOBS: dict[str, Callable[..., Found]] = {
    "track": track,
    "check": check,
    "identify": identify,
    "steady": steady,
    "diagnose": diagnose,
}

__all__ = ["JOBS", "Found", "check", "diagnose", "identify", "steady", "track"]
