"""A whole campaign: every run, then every fit, one table, one page."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path
from typing import Any

from ...record.campaigns import TRIM, Answer, Campaign
from ...record.errors import InputError, TowlineError
from ...record.names import shown
from ...record.run import RUN_FILE
from ..executor.processes import Done, each_of, processes
from ..progress import Progress
from .find import OUT, run_folders
from .table import tidy, write_tidy
from .work import WANTS, Options, Tell, fit_job, restored, run_job

LOCK = ".campaign.lock"


def campaign(
    folder: Path,
    workers: Done,
    options: Options | None = None,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Campaign:
    """Analyse every run below ``folder``; what is up to date is kept.

    Parameters
    ----------
    folder : that holds the runs
    workers : of ``workers.workers``
    options : None: the usual ones
    out : where results of several runs go; default: folder/out
    progress : is told what is done

    Raises
    ------
    TowlineError : there is no run, or another campaign is at work in ``out``
    """
    say = progress or (lambda text, done, total: None)
    found = run_folders(folder)
    target = out or folder / OUT
    chosen = asdict(options or Options())
    with _alone(target):
        places = [folder / run / OUT for run in found.runs]
        _swept(*places, *_below(target))
        jobs = [(run_job, (run, str((folder / run).resolve()), chosen)) for run in found.runs]
        runs = _answers(workers, jobs, found.runs, "runs", say)
        runs += [Answer(name, name, f"no {RUN_FILE} in this folder; towline init writes one") for name in found.without]
        plan = _fits(runs, folder, target)
        # a fit is one job of this process; what it does run by run is spread over the workers
        jobs = [(fit_job, (name, *rest, chosen, each_of(workers), _telling(say, name))) for name, *rest in plan]
        with processes(1) as here:
            fits = _answers(here, jobs, [name for name, *_ in plan], "fits", say)
        runs, fits = ([_from_here(a, folder) for a in answers] for answers in (runs, fits))
        wrote = write_tidy(target, tidy(runs, fits))
        _swept(*places, *_below(target))  # a worker of the cluster may have been killed while others went on
    return Campaign(folder, target, runs, fits, wrote)


def _answers(workers: Done, jobs: Sequence[Any], order: Sequence[str], what: str, say: Progress) -> list[Answer]:
    found: dict[str, Answer] = {}
    failed = 0
    say(f"{what}: 0 failed", 0, len(jobs))
    for plain in workers(jobs):
        answer = restored(plain)
        found[answer.job] = answer
        failed += bool(answer.reason)
        say(f"{what}: {failed} failed", len(found), len(jobs))
    return [found[job] for job in order]


def _telling(say: Progress, name: str) -> Tell:
    """What a fit tells, said with how often it told something: nobody knows how many steps it takes."""
    steps = count(1)
    return lambda said: say(f"{name}: {said}", next(steps), None)


def _from_here(answer: Answer, folder: Path) -> Answer:
    """Its reason names files from the campaign's folder, wherever that stands."""
    return replace(answer, reason=answer.reason.replace(f"{shown(str(folder.resolve()))}{os.sep}", ""))


def _fits(runs: Sequence[Answer], folder: Path, out: Path) -> list[tuple[str, str, list[str], str]]:
    """Name, kind, folders and place of every fit: one of each kind for each hull, at each of its trims."""
    groups: dict[tuple[str, tuple[float, ...]], list[Answer]] = {}
    for a in runs:
        for kind in a.wants.split(WANTS) if a.wants and not a.reason else ():
            groups.setdefault((kind, a.hull), []).append(a)
    plan = []
    for kind in ("derivatives", "steady", "free_run"):
        own = [part for (k, _), members in groups.items() if k == kind for part in _at_each_trim(members)]
        for k, members in enumerate(own, 1):
            name = kind if len(own) == 1 else f"{kind}-hull-{k}"
            plan.append((name, kind, [str((folder / m).resolve()) for m in members], str((out / name).resolve())))
    return plan


def _at_each_trim(runs: Sequence[Answer]) -> list[list[str]]:
    """Jobs of runs whose model floated alike (``identify.trim_groups``)."""
    from ...identify.trim import trim_groups

    trims = [next((value for name, value, *_ in a.numbers if name == TRIM), None) for a in runs]
    return [[runs[k].job for k in group] for group in trim_groups(trims)]


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Only one campaign works on a folder; the lock goes with its process, however that ends."""
    out.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    try:
        # neither a link's target nor a named pipe's reader has anything to do with it
        lock = os.open(out / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError as error:
        raise InputError(out / LOCK, "", f"cannot be locked ({error.strerror}); a plain file is expected") from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise TowlineError(f"{out}: another campaign is at work here") from None
        yield
    finally:
        os.close(lock)


def _below(out: Path) -> list[Path]:
    return [out, *(p for p in sorted(out.iterdir()) if p.is_dir() and not p.is_symlink())]


def _swept(*folders: Path) -> None:
    """Remove what a killed writer left unfinished."""
    for folder in folders:
        for path in folder.glob(".*.tmp*"):
            if path.is_symlink() or not path.is_dir():
                path.unlink(missing_ok=True)


__all__ = ["campaign"]
