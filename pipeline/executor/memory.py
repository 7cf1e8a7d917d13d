"""A limit on the memory of a process (``ulimit -v``): said before work begins where it is too small, met by the libraries early."""

from __future__ import annotations

LEAST_BYTES = 640 << 20
"""Of address space, which is more than what is used."""


def limit_bytes() -> int | None:
    """The limit on this process's address space; None: none, or the system knows no such limits."""
    try:
        import resource
    except ImportError:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def too_little() -> str | None:
    """Why it is no use to begin: with less than ``LEAST_BYTES`` libraries do not load, and some hang instead of saying so."""
    limit = limit_bytes()
    if limit is None or limit >= LEAST_BYTES:
        return None
    return (
        f"out of memory: ulimit -v allows {limit >> 20} MiB; {LEAST_BYTES >> 20} MiB is the least that any work takes"
    )


def reserve() -> None:
    """Under a limit, have the linear algebra take its buffers now: where it gets none later it ends the process by itself."""
    if limit_bytes() is None:
        return
    import numpy as np
    from scipy.linalg import cholesky  # scipy brings its own

    square = np.ones((128, 128)) + 128 * np.eye(128)
    cholesky(square @ square)


__all__ = ["LEAST_BYTES", "limit_bytes", "reserve", "too_little"]
