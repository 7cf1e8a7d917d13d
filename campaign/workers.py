"""Where jobs are done: in this process, in several on this machine, or on a Dask cluster. The jobs are the same."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from ..record.errors import TowlineError

Job = tuple[Callable[..., dict[str, Any]], tuple[Any, ...]]
Workers = Callable[[Sequence[Job]], Iterator[dict[str, Any]]]
"""Jobs -> answers, as they come."""
ORPHAN_S = 0.5
RETRIES = 3
"""A job whose worker is killed so often is to blame itself."""


@contextmanager
def workers(count: int, scheduler: str | None = None) -> Iterator[Workers]:
    """Workers for the block.

    Parameters
    ----------
    count : processes on this machine; 1: this one
    scheduler : address of a Dask scheduler whose workers have towline and see the same folders

    Raises
    ------
    TowlineError : Dask is not installed, or there is no scheduler at that address
    """
    if scheduler is not None:
        with _cluster(scheduler) as found:
            yield found
    elif count <= 1:
        yield lambda jobs: (call(*arguments) for call, arguments in jobs)
    else:
        with _processes(count) as found:
            yield found


@contextmanager
def _processes(count: int) -> Iterator[Workers]:
    # one thread each: the workers share the cores
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_end_with, initargs=(os.getpid(),))

    def done(jobs: Sequence[Job]) -> Iterator[dict[str, Any]]:
        try:
            for future in as_completed([pool.submit(call, *arguments) for call, arguments in jobs]):
                yield future.result()
        except BrokenProcessPool as error:
            raise TowlineError(f"a worker ended before its time ({error}); start again to go on") from None

    try:
        yield done
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _end_with(parent: int) -> None:
    """A worker whose campaign was killed ends, too: nobody waits for it, and the next campaign does its work."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(ORPHAN_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _cluster(address: str) -> Iterator[Workers]:
    try:
        from distributed import Client
        from distributed import as_completed as completed
    except ImportError:
        raise TowlineError("--scheduler needs Dask: install towline with its extra 'cluster' (distributed)") from None
    try:
        client = Client(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise TowlineError(f"no Dask scheduler at {address} ({error})") from None

    def done(jobs: Sequence[Job]) -> Iterator[dict[str, Any]]:
        futures = [client.submit(call, *arguments, pure=False, retries=RETRIES) for call, arguments in jobs]
        for future in completed(futures):
            yield future.result()

    with client:
        yield done


__all__ = ["Job", "Workers", "workers"]
