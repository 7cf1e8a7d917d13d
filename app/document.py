"""The run.toml that is being edited: its text, what the schema says of it, undo and redo, saving."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..record.errors import InputError
from ..record.files import read_bytes
from ..record.run import RUN_FILE, Run
from ..record.schema import RunFile
from ..record.template import run_text
from ..record.toml import TOO_DEEP, _key_path, _lists_to_tuples, _short, check_tables
from ..record.typed import linked, sweep, write_aside, write_typed
from .toml_text import Where, value_at, with_row, with_value, without

MOST_UNDO = 500
"""Steps that can be undone: a choice."""
MOST_BYTES = 1 << 20
"""A run.toml larger than this is no run.toml."""


class Document:
    """The text of a run.toml with its history.

    Parameters
    ----------
    folder : the run folder
    text : as it stands now
    saved : as it stands in the file; None: there is no file yet

    Attributes
    ----------
    version : goes up with every change, also by undo
    """

    def __init__(self, folder: Path, text: str, saved: str | None) -> None:
        self.folder, self._text, self._saved = folder, text, saved
        self._past: list[tuple[str, str]] = []
        self._future: list[tuple[str, str]] = []
        self._content: dict[str, Any] = tomllib.loads(text)
        self.version = 0

    @classmethod
    def open(cls, folder: Path) -> Document:
        """The document of a folder that has a run.toml.

        Raises
        ------
        InputError : it cannot be read, or is no TOML at all
        """
        path = folder / RUN_FILE
        raw = read_bytes(path, MOST_BYTES)
        try:
            text = raw.decode("utf-8")
            document = cls(folder, text, text)
        except UnicodeDecodeError:
            raise InputError(path, "", "is not UTF-8 text") from None
        except RecursionError:
            raise InputError(path, "", TOO_DEEP) from None
        except ValueError as error:  # TOMLDecodeError, and what a whole number of thousands of digits gives
            raise InputError(path, "", f"is not valid TOML: {' '.join(str(error).split())[:300]}") from None
        if document.cameras:
            document.run()  # what is missing there is not filled in here
        with suppress(InputError):  # told when it is saved
            sweep(linked(path, document.outside))
        return document

    @classmethod
    def new(cls, folder: Path, video: str) -> Document:
        """The document of a folder that holds only a video: every key of the template, none of them filled in but its name."""
        content = {
            "name": folder.resolve().name or "run",
            "kind": "tow",
            "source": {"video": video},
            "datum": [],
            "marker": [],
            "tow": {},
            "model": {},
            "water": {},
        }
        return cls(folder, run_text(content, ()), None)

    @property
    def text(self) -> str:
        """The text as it stands."""
        return self._text

    @property
    def content(self) -> Mapping[str, Any]:
        """The tables, as TOML holds them; not to be changed."""
        return self._content

    @property
    def dirty(self) -> bool:
        """Something is not saved."""
        return self._text != self._saved

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the ``[[camera]]`` of a run that two cameras film; () for one camera."""
        tables = self._content.get("camera")
        return tuple(str(table.get("name")) for table in tables) if isinstance(tables, list) else ()

    @property
    def outside(self) -> bool:
        """Files may be named outside the folder."""
        return self.get("outside") is True

    def get(self, *where: str | int) -> Any:
        """The value at a place ("tow", "speed_m_s"); None where there is none."""
        return value_at(self._content, where)

    def rows(self, array: str) -> list[dict[str, Any]]:
        """The tables of ``datum`` or ``marker``."""
        found = self._content.get(array, [])
        if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
            return []
        return [dict(row) for row in found]

    # edits ---------------------------------------------------------------------------------------------------------

    def set(self, where: Where, value: Any, what: str = "") -> None:
        """Put a value in; None takes the key out."""
        label = what or f"{'.'.join(str(p + 1) if isinstance(p, int) else p for p in where)}"
        self._change(without(self._text, where) if value is None else with_value(self._text, where, value), label)

    def set_all(self, values: Sequence[tuple[Where, Any]], what: str) -> None:
        """Several values as one step of undo."""
        text = self._text
        for where, value in values:
            text = without(text, where) if value is None else with_value(text, where, value)
        self._change(text, what)

    def add_row(self, array: str, row: Mapping[str, Any], what: str = "") -> int:
        """One more datum point or marker; returns its number, from 0."""
        self._change(with_row(self._text, array, row), what or f"add {array} {row.get('name', '')}".strip())
        return len(self.rows(array)) - 1

    def remove_row(self, array: str, number: int) -> None:
        """Take a datum point or marker out."""
        name = self.rows(array)[number].get("name", number + 1)
        self._change(without(self._text, (array, number)), f"remove {array} {name}")

    def note(self, table: str, line: str) -> None:
        """Put a comment under a table's header, as part of the last change."""
        lines = self._text.splitlines(keepends=True)
        at = next((i for i, text in enumerate(lines) if text.lstrip().startswith(f"[{table}]")), None)
        if at is not None:
            lines.insert(at + 1, f"# {line}\n")
            self._put("".join(lines))

    def _change(self, text: str, what: str) -> None:
        if text == self._text:
            return
        self._past.append((self._text, what))
        del self._past[:-MOST_UNDO]
        self._future.clear()
        self._put(text)

    def _put(self, text: str) -> None:
        self._content = tomllib.loads(text)
        self._text = text
        self.version += 1

    @property
    def undoable(self) -> str:
        """What undo would take back; "" = nothing."""
        return self._past[-1][1] if self._past else ""

    @property
    def redoable(self) -> str:
        """What redo would do again; "" = nothing."""
        return self._future[-1][1] if self._future else ""

    def undo(self) -> str:
        """Take the last change back; returns what it was, "" where there is none."""
        if not self._past:
            return ""
        text, what = self._past.pop()
        self._future.append((self._text, what))
        self._put(text)
        return what

    def redo(self) -> str:
        """Do again what was taken back; returns what it is, "" where there is none."""
        if not self._future:
            return ""
        text, what = self._future.pop()
        self._past.append((self._text, what))
        self._put(text)
        return what

    # what the schema says --------------------------------------------------------------------------------------------

    def run(self) -> Run:
        """The run as it stands, checked.

        Raises
        ------
        InputError : the first fault
        """
        return Run(self.folder, check_tables(dict(self._content), RunFile, self.folder / RUN_FILE))

    def faults(self) -> dict[str, str]:
        """All that keeps it from being a run: key ("tow.speed_m_s", "" = the whole) -> what is wrong, in the schema's words."""
        try:
            RunFile.model_validate(_lists_to_tuples(self._content))
            return {}
        except RecursionError:
            return {"": TOO_DEEP}
        except OverflowError:
            return {"": "holds a whole number beyond 64 bits"}
        except ValidationError as error:
            found: dict[str, str] = {}
            for fault in error.errors(include_url=False):
                words = fault["msg"].removeprefix("Value error, ")
                where = _key_path(fault["loc"], dict(self._content))
                if fault["type"] == "missing":
                    words = "missing key"
                elif fault["type"] == "extra_forbidden":
                    words = "unknown key"
                elif fault["type"] != "value_error":
                    words = f"{_short(fault['input'])}: {words[0].lower()}{words[1:]}"
                elif not where and (named := re.match(r"([a-z_.]+): (.+)", words)):
                    where, words = named.groups()
                found.setdefault(where, words)
            return found | {key: words for key, words in self._still_missing() if key not in found}

    def _still_missing(self) -> Iterator[tuple[str, str]]:
        """What the schema asks for only once every key by itself is right."""
        if self.get("source", "motion") is None:
            for array, least, what in (("datum", 4, "points"), ("marker", 2, "marks")):
                count = len(self.rows(array))
                if count < least:
                    yield array, f"{count} {what}, at least {least} are needed"
        if (kind := self.get("kind") or "tow") != "free":
            for key in ("line_length_m", "tow_point_m"):
                if self.get("tow", key) is None:
                    yield f"tow.{key}", f"missing key; kind = {kind!r} needs it"

    def save(self) -> Path:
        """Write run.toml, whole or not at all, to the disk; what it links to where it is a link.

        Raises
        ------
        InputError : it is a link out of the folder, and ``outside = true`` does not stand at its top
        """
        path = self.folder / RUN_FILE
        write_typed(path, self._text, self.outside)
        self._saved = self._text
        return path

    def keep_aside(self, mine: bool) -> Path | None:
        """Put the text of here (``mine``) or that of the file beside run.toml, under a name that is free.

        Returns
        -------
        Path, None : where it is; None = there is no text

        Raises
        ------
        InputError, OSError : it cannot be written
        """
        text = self._text if mine else self.on_disk()
        if text is None:
            return None
        return write_aside(self.folder / RUN_FILE, text, "mine" if mine else "theirs")

    def changed_outside(self) -> bool:
        """The file is no longer what was opened or saved here."""
        there = self.on_disk()
        if there is None:
            return self._saved is not None or os.path.lexists(self.folder / RUN_FILE)
        return there != self._saved

    def on_disk(self) -> str | None:
        """What stands in the file now; None: there is no file, or none that can be read as text."""
        try:
            return read_bytes(self.folder / RUN_FILE, MOST_BYTES).decode("utf-8")
        except (InputError, UnicodeDecodeError):
            return None


__all__ = ["Document"]
