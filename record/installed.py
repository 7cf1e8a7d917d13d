"""What other installed packages bring: their modules are imported, and register themselves, when first asked for."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from .errors import TowlineError


@cache
def load_installed(group: str) -> None:
    """Import every entry point of ``group`` ("towline.looks", "towline.sources"), once a process.

    Raises
    ------
    TowlineError : one of them cannot be imported
    """
    for entry in entry_points(group=group):
        try:
            entry.load()
        except Exception as error:
            raise TowlineError(f"entry point {group} {entry.name}: {type(error).__name__}: {error}") from error


__all__ = ["load_installed"]
