"""What a command did: said in words on standard output, or, with ``--json``, as one JSON object and nothing else."""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from ..record.names import lines_joined, shown


class Outcome:
    """Gathers what a command wrote, found, and could not do.

    Parameters
    ----------
    command : its name
    as_json : words are left out; ``close`` prints the object

    Attributes
    ----------
    result : what was found, by name; anything that ``plain`` takes
    """

    def __init__(self, command: str | None, as_json: bool = False) -> None:
        self.command, self.as_json = command, as_json
        self.result: dict[str, Any] = {}
        self._wrote: list[str] = []
        self._failed: dict[str, str] = {}

    def wrote(self, *paths: str | Path, word: str = "wrote", more: str = "") -> None:
        """Say which files were written."""
        if paths:
            self._wrote += map(str, paths)
            print(f"{word} " + ", ".join(map(str, paths)) + more)

    def fail(self, failed: Mapping[str, str]) -> None:
        """One line on standard error for each run that failed: folder or name -> why."""
        for name, why in failed.items():
            self._failed[name] = lines_joined(why)
            print(f"towline: failed: {name}: {lines_joined(why)}", file=sys.stderr)

    @contextmanager
    def speaking(self) -> Iterator[None]:
        """What is printed in this block is for people: with ``as_json`` it goes nowhere."""
        if not self.as_json:
            yield
            return
        with redirect_stdout(io.StringIO()):
            yield

    def close(self, exit_code: int, error: str | None = None) -> None:
        """With ``as_json``, print the object: the error alone where there is one."""
        if not self.as_json:
            return
        found: dict[str, Any] = {"command": self.command, "exit_code": exit_code}
        if error is None:
            found |= {"wrote": self._wrote, "failed": self._failed, "result": self.result}
        else:
            found["error"] = error
            if self._failed:
                found["failed"] = self._failed
        print(json.dumps(plain(found), allow_nan=False))


def no_memory(error: Exception) -> str:
    """What a user reads where memory ran out."""
    said = lines_joined(str(error))
    return f"out of memory{f' ({said})' if said else ''}: fewer or shorter runs at once, or fewer --workers, take less"


def plain(value: Any) -> Any:
    """``value`` in JSON's own kinds; a number that is not finite becomes null.

    Takes result files (pydantic), dataclasses, numpy's arrays and numbers, paths, mappings, sequences and sets.
    """
    if isinstance(value, (str, Path)):
        return shown(str(value))
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, (int, float)):
        return value if math.isfinite(value) else None
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, Mapping):
        return {shown(str(key)): plain(inner) for key, inner in value.items()}
    if isinstance(value, (set, frozenset)):
        return [plain(inner) for inner in sorted(value)]
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    if hasattr(value, "model_dump"):
        return plain(value.model_dump(mode="json", by_alias=True))
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    raise TypeError(f"no JSON for {type(value).__name__}")
