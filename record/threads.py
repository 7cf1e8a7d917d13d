"""One thread for linear algebra: matrices here are small, and threads that wait for one another cost more than they save.

The commands say so in their environment before numpy is there (``OPENBLAS_NUM_THREADS``); a program has numpy already.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """Let numpy's and scipy's linear algebra run on one thread; afterwards on as many as before. Also put over a function.

    Examples
    --------
    >>> with one_thread():
    ...     pass
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


__all__ = ["one_thread"]
