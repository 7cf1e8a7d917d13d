"""Where jobs are done: in this process, in several on this machine, or on a Dask cluster. The jobs are the same."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from ...record.errors import TowlineError
from ..executor.processes import Done, Job, processes

RETRIES = 3
"""A job whose worker is killed so often is to blame itself."""


@contextmanager
def workers(count: int, scheduler: str | None = None) -> Iterator[Done]:
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
    else:
        with processes(count) as found:
            yield found


@contextmanager
def _cluster(address: str) -> Iterator[Done]:
    try:
        from distributed import Client
        from distributed import as_completed as completed
    except ImportError:
        raise TowlineError("--scheduler needs Dask: install towline with its extra 'cluster' (distributed)") from None
    try:
        client = Client(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise TowlineError(f"no Dask scheduler at {address} ({error})") from None

    def done(jobs: Iterable[Job]) -> Iterator[Any]:
        futures = [client.submit(call, *arguments, pure=False, retries=RETRIES) for call, arguments in jobs]
        for future in completed(futures):
            yield future.result()

    with client:
        yield done


__all__ = ["workers"]
