"""Jobs over several processes of this machine, one thread each; a process whose parent is gone ends, too."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from ...record.each import Each, Tell
from ...record.errors import TowlineError
from .memory import reserve

Job = tuple[Callable[..., Any], tuple[Any, ...]]
"""What to call, and with which arguments; both must travel between processes."""
Done = Callable[[Iterable[Job]], Iterator[Any]]
"""Jobs -> results, as they come."""
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What tells the linear algebra how many threads to use."""
ORPHAN_S = 0.5
"""So often a process looks whether its parent is still there."""
GRACE_S = 3.0
"""How long a worker that is told to end may take to clear up."""


@contextmanager
def processes(count: int) -> Iterator[Done]:
    """``count`` processes for the block; 1: this one.

    Raises
    ------
    TowlineError : a process was killed (what it had not finished is done when started again)
    """
    if count <= 1:
        yield _here
        return
    # one thread each: they share the cores
    for name in THREADS:
        os.environ.setdefault(name, "1")
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(),))

    def done(jobs: Iterable[Job]) -> Iterator[Any]:
        with undisturbed():  # a worker is started here
            futures = [pool.submit(_job, call, *arguments) for call, arguments in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool as error:
            raise TowlineError(f"a worker ended before its time ({error}); start again to go on") from None

    try:
        yield done
    except BaseException:
        _end(pool)
        raise
    pool.shutdown()


@contextmanager
def undisturbed() -> Iterator[None]:
    """Ctrl+C waits until the block ends; processes that are started in it never hear it: who started them ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end(pool: ProcessPoolExecutor) -> None:
    """End the workers now: each is told to, and clears up; who does not within ``GRACE_S`` is killed."""
    with undisturbed():
        left = list((pool._processes or {}).values())
        for process in left:
            process.terminate()
        until_s = time.monotonic() + GRACE_S
        for process in left:
            process.join(max(0.0, until_s - time.monotonic()))
            process.kill()
        # waited for: the pool's thread closes its pipe, which the interpreter's end would write to at the same moment
        pool.shutdown(wait=True, cancel_futures=True)


def _job(call: Callable[..., Any], *arguments: Any) -> Any:
    _AT_WORK.append(True)
    try:
        return call(*arguments)
    finally:
        _AT_WORK.clear()
        if _ENDING:  # what the job wrote is cleared up by now, and nobody waits for its answer
            os._exit(1)


def _begin(parent: int) -> None:
    """In a worker, first: it ends when it is told to, or when its parent is gone, and says nothing of either."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _told_to_end)
    end_with(parent)
    reserve()


_AT_WORK: list[bool] = []
"""Not empty while a worker has a job."""
_ENDING: list[bool] = []
"""Not empty once a worker at work was told to end."""


def _told_to_end(*_: object) -> None:
    """Between jobs at once; in a job by way of its own end, so that what writes removes its temporary file."""
    if not _AT_WORK:
        os._exit(1)
    _ENDING.append(True)
    sys.unraisablehook = lambda _: None
    raise SystemExit(1)


def _here(jobs: Iterable[Job]) -> Iterator[Any]:
    return (call(*arguments) for call, arguments in jobs)


def each_of(done: Done) -> Each:
    """``Each`` by workers."""

    def each(call: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], tell: Tell | None = None) -> list[Any]:
        found: dict[int, Any] = {}
        work = done if len(arguments) > 1 else _here
        for number, result in work((_numbered, (k, call, *one)) for k, one in enumerate(arguments)):
            found[number] = result
            if tell is not None:
                tell(len(found))
        return [found[k] for k in range(len(arguments))]

    return each


def _numbered(number: int, call: Callable[..., Any], *arguments: Any) -> tuple[int, Any]:
    return number, call(*arguments)


def end_with(parent: int) -> None:
    """End this process soon after its parent: nobody waits for it then, and the next start does its work."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(ORPHAN_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def in_parallel(call: Callable[..., Any], arguments: Iterable[tuple[Any, ...]], count: int) -> Iterator[Any]:
    """Results of ``call`` with each of ``arguments``, as they come.

    Parameters
    ----------
    call : what is called
    arguments : of each call
    count : of processes
    """
    jobs = [(call, each) for each in arguments]
    with processes(min(count, len(jobs))) as done:
        yield from done(jobs)


__all__ = [
    "THREADS",
    "Done",
    "Job",
    "each_of",
    "end_with",
    "in_parallel",
    "processes",
    "undisturbed",
]
