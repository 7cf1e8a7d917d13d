"""The one error that users see: a single line that names the file, the key or row, the value and what was expected."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .names import in_one_line, lines_joined


class TowlineError(Exception):
    """Something in the input, not in the program, is wrong; ``str(error)`` is one line for the user."""

    def __str__(self) -> str:
        return in_one_line(super().__str__())


class InputError(TowlineError):
    """A file holds something that cannot be used.

    Parameters
    ----------
    path : file that holds it
    where : key ("tow.speed_m_s") or row ("row 17"); empty when the file as a whole is meant
    message : what was found and what was expected
    """

    def __init__(self, path: str | Path, where: str, message: str) -> None:
        self.path = str(path)
        self.where = where
        self.message = message
        place = f"{path}: {where}" if where else str(path)
        super().__init__(f"{place}: {message}")


class VideoError(TowlineError):
    """The recording cannot be read, holds no frame, or ends too early."""


class TrackingError(TowlineError):
    """The marks were never found in the recording."""


class GeometryError(TowlineError):
    """The datum does not fix the camera well enough to give places."""


class EstimationError(TowlineError):
    """The record does not hold what was asked of it."""


@contextmanager
def solvable(error: type[TowlineError], words: str = "the record does not fix what was asked of it") -> Iterator[None]:
    """Numerics that break down (a matrix without inverse, an overflow) say ``words`` as ``error``; also a decorator.

    Parameters
    ----------
    error : class that is raised
    words : what is said
    """
    from numpy.linalg import LinAlgError

    try:
        yield
    except (LinAlgError, ArithmeticError) as fault:
        raise error(f"{words} ({lines_joined(str(fault)) or type(fault).__name__})") from None
