"""Tables that grow: looks, trackers, sources. What is registered stands there by its name until the process ends."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from .errors import TowlineError
from .files import sha256_of_texts

T = TypeVar("T")


class Registry(Generic[T]):
    """Things by name, in the order of their registration.

    Parameters
    ----------
    group : entry point by which installed packages bring theirs: their modules are imported, and register, when first asked for;
        "": by none
    """

    def __init__(self, group: str = "") -> None:
        self._group, self._loaded = group, not group
        self._things: dict[str, T] = {}

    def add(self, name: str, thing: T) -> None:
        """Register; what has the same name is replaced, in its place."""
        self._things[name] = thing

    def here(self) -> tuple[T, ...]:
        """What is registered so far."""
        return tuple(self._things.values())

    def all(self) -> tuple[T, ...]:
        """What is registered, by installed packages as well.

        Raises
        ------
        TowlineError : one of them cannot be imported
        """
        if not self._loaded:
            self._loaded = True
            for entry in entry_points(group=self._group):
                try:
                    entry.load()
                except Exception as error:
                    said = f"entry point {self._group} {entry.name}: {type(error).__name__}: {error}"
                    raise TowlineError(said) from error
        return self.here()

    def get(self, name: str) -> T | None:
        """What has this name; None: nothing."""
        return self._things.get(name)

    @contextmanager
    def kept(self) -> Iterator[None]:
        """What is registered in the block is forgotten behind it; for tests."""
        before, loaded = dict(self._things), self._loaded
        try:
            yield
        finally:
            self._things, self._loaded = before, loaded


def code_stamp(thing: object) -> str:
    """SHA-256 of the source of the module that defines a class or function; "": it is towline's own, or there is no source."""
    module = inspect.getmodule(thing)
    if module is None or module.__name__.partition(".")[0] == __name__.partition(".")[0]:
        return ""
    try:
        return sha256_of_texts(inspect.getsource(module))
    except (OSError, TypeError):
        return ""


__all__ = ["Registry", "code_stamp"]
