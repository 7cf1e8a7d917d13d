"""Questions on the terminal, each of which a flag or a default can answer instead."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def numbers(text: str, count: int = 1) -> list[float]:
    """``count`` finite numbers out of ``text``, between commas or spaces.

    Raises
    ------
    ValueError : says what was expected
    """
    expected = "a number, like 1.28" if count == 1 else f"{count} numbers, like {', '.join(['1.28', '0'][:count])}"
    words = [text.strip()] if count == 1 else [word for word in re.split(r"[,\s]+", text) if word]
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ValueError(f"{expected}, is expected")
    return found


class Asker:
    """Gets an answer from a flag, else from the terminal, else the default.

    Parameters
    ----------
    path : the file that the answers are for; errors name it
    take_defaults : ask nothing
    read : a line of the terminal without its end; None: there is no terminal
    say : what to ask with

    Attributes
    ----------
    assumed : keys whose default nobody confirmed
    """

    def __init__(
        self, path: Path, take_defaults: bool, read: Callable[[], str] | None, say: Callable[[str], None]
    ) -> None:
        self.assumed: list[str] = []
        self._path, self._take_defaults, self._read, self._say = path, take_defaults, read, say

    def answer(
        self,
        key: str,
        flag: str,
        given: str | None,
        words: str,
        default: str | None,
        parse: Callable[[str], T],
        guess: bool = True,
    ) -> T:
        """The answer for ``key``.

        Parameters
        ----------
        flag, given : the flag that answers it, and what it said
        words : what is asked
        default : what an empty answer stands for; None: there is none
        parse : text to value; its ValueError says what was expected, and the question is asked again
        guess : the default, where nobody confirms it, is one

        Raises
        ------
        InputError : the flag's value cannot be used; nothing answers and nobody can be asked; the input ended
        """
        from ..record.errors import InputError

        if given is not None:
            try:
                return parse(given)
            except ValueError as error:
                raise InputError(self._path, key, f"{flag} {given}: {error}") from None
        if self._take_defaults:
            if default is None:
                raise InputError(self._path, key, f"there is no default; give {flag}")
            if guess:
                self.assumed.append(key)
            return parse(default)
        if self._read is None:
            way = "" if default is None else f", or take the default {default!r} with --yes"
            raise InputError(self._path, key, f"no answer, and no terminal to ask on; give {flag}{way}")
        return self._asked(key, words, default, parse)

    def _asked(self, key: str, words: str, default: str | None, parse: Callable[[str], T]) -> T:
        from ..record.errors import InputError

        assert self._read is not None
        while True:
            self._say(f"{words}{'' if default is None else f' [{default}]'}: ")
            try:
                said = self._read().strip()
            except EOFError:
                raise InputError(self._path, key, "the input ended before this was answered; nothing written") from None
            if not said and default is None:
                self._say("  an answer is needed here\n")
                continue
            try:
                return parse(said or str(default))
            except ValueError as error:
                self._say(f"  {said!r}: {error}\n")


def terminal_line() -> str:
    """A line typed on the terminal; EOFError at its end."""
    line = sys.stdin.readline()
    if not line:
        raise EOFError
    return line.rstrip("\r\n")


def say(text: str) -> None:
    """To standard error, so that standard output stays the result's."""
    print(text, end="", file=sys.stderr, flush=True)


def terminal() -> Callable[[], str] | None:
    """What reads a line of the terminal, if there is one."""
    there: Any = sys.stdin
    return terminal_line if there is not None and there.isatty() else None
