"""Many jobs over several processes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

from ..record.errors import TowlineError


def in_parallel(call: Callable[..., Any], jobs: Sequence[tuple], workers: int) -> Iterable[Any]:
    """Results of ``call(*job)`` as they come; without processes where one worker is asked for.

    Raises
    ------
    TowlineError : a worker was killed (what it had not finished is done when started again)
    """
    if workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            yield call(*job)
        return
    # one thread each: the workers share the cores
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            for future in as_completed([pool.submit(call, *job) for job in jobs]):
                yield future.result()
        except BrokenProcessPool as error:
            raise TowlineError(f"a worker ended before its time ({error}); start again to go on") from None
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
