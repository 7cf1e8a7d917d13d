"""Small edits of a run.toml's text that keep its comments, its order and its layout.

A key that the template left out as a comment (``# span_s = ...  # words``) is put in where that comment stands. Every edit is
parsed again and must give exactly the wanted content, else tomlkit's own way of adding a key is taken.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import tomlkit

from ..record.template import EXAMPLE

Where = tuple[str | int, ...]
"""("tow", "speed_m_s"), or ("datum", 2, "pixel_px") with numbers from 0."""
_HEADER = re.compile(r"^\s*\[")
_ARRAY_BEFORE = {"datum": ("marker", "tow", "model", "water", "priors"), "marker": ("tow", "model", "water", "priors")}


def value_at(content: Mapping[str, Any], where: Where) -> Any:
    """The value at ``where``; None where there is none.

    Parameters
    ----------
    content : parsed TOML
    where : place of a key
    """
    here: Any = content
    for part in where:
        try:
            here = here[part]
        except (KeyError, IndexError, TypeError):
            return None
    return here


def with_value(text: str, where: Where, value: Any) -> str:
    """``text`` with ``value`` (a number, text, truth value, or sequence of numbers) at ``where``.

    Parameters
    ----------
    text : of run.toml
    where : place of a key
    value : of the key

    Raises
    ------
    KeyError : an array's table that is not there
    """
    content = tomllib.loads(text)
    plain = list(value) if isinstance(value, tuple) else value
    wanted = _changed(content, where, plain)
    if wanted == content:
        return text
    if value_at(content, where) is None:
        for new in (_in_place_of_comment(text, where, plain), _after_last_key(text, where, plain)):
            if new is not None and _gives(new, wanted):
                return new
    document = tomlkit.parse(text)
    here: Any = document
    for part in where[:-1]:
        if isinstance(part, str) and part not in here:
            here[part] = tomlkit.table()
        here = here[part]
    here[where[-1]] = _item(plain)
    return tomlkit.dumps(document)


def without(text: str, where: Where) -> str:
    """``text`` without the key or table at ``where``; a key that words stand beside becomes a comment, so that they stay.

    Parameters
    ----------
    text : of run.toml
    where : place of a key
    """
    content = tomllib.loads(text)
    if value_at(content, where) is None:
        return text
    wanted = deepcopy(content)
    del value_at(wanted, where[:-1])[where[-1]]
    if isinstance(where[-1], str) and not isinstance(value_at(content, where), (dict, list)):
        lines = text.splitlines(keepends=True)
        first, last = _block(lines, where)
        for number in range(first, last):
            if re.match(rf"\s*{re.escape(where[-1])}\s*=.*\s#", lines[number]):
                lines[number] = "# " + lines[number].lstrip()
                new = "".join(lines)
                return new if _gives(new, wanted) else _dropped(text, where)
    return _dropped(text, where)


def with_row(text: str, array: str, row: Mapping[str, Any]) -> str:
    """``text`` with one more ``[[array]]`` table at the array's end.

    Parameters
    ----------
    text : of run.toml
    array : name of the array
    row : keys and values
    """
    content = tomllib.loads(text)
    wanted = deepcopy(content)
    wanted.setdefault(array, []).append({k: list(v) if isinstance(v, tuple) else v for k, v in row.items()})
    block = f"[[{array}]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in row.items())
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    at = _row_place(lines, array, len(content.get(array, [])))
    before = "" if at == 0 or not lines[at - 1].strip() else "\n"
    after = "" if at == len(lines) or not lines[at].strip() else "\n"
    new = "".join(lines[:at]) + before + block + after + "".join(lines[at:])
    if _gives(new, wanted):
        return new
    document = tomlkit.parse(text)
    if array not in document:
        document[array] = tomlkit.aot()
    table = tomlkit.table()
    for key, value in row.items():
        table[key] = _item(list(value) if isinstance(value, tuple) else value)
    document[array].append(table)  # pyright: ignore
    return tomlkit.dumps(document)


def toml_value(value: Any) -> str:
    """``value`` as TOML writes it."""
    return _item(list(value) if isinstance(value, tuple) else value).as_string()


def _item(value: Any) -> Any:
    return tomlkit.item(value)


def _gives(text: str, wanted: Mapping[str, Any]) -> bool:
    try:
        return tomllib.loads(text) == wanted
    except tomllib.TOMLDecodeError:
        return False


def _changed(content: Mapping[str, Any], where: Where, value: Any) -> dict[str, Any]:
    wanted: Any = deepcopy(dict(content))
    here = wanted
    for part in where[:-1]:
        if isinstance(part, int):
            if not (isinstance(here, list) and 0 <= part < len(here)):
                raise KeyError(where)
            here = here[part]
        else:
            here = here.setdefault(part, {})
    here[where[-1]] = value
    return wanted


def _dropped(text: str, where: Where) -> str:
    document = tomlkit.parse(text)
    here: Any = document
    for part in where[:-1]:
        here = here[part]
    del here[where[-1]]
    if isinstance(here, list) and not len(here):
        del document[str(where[0])]
    return tomlkit.dumps(document)


def _block(lines: Sequence[str], where: Where) -> tuple[int, int]:
    """First and last + 1 line of the keys of the table that holds ``where``; (0, 0) where the table has no header."""
    tables = [part for part in where[:-1] if isinstance(part, str)]
    number = next((part for part in where if isinstance(part, int)), None)
    first = 0
    if tables:
        name = r"\s*\.\s*".join(map(re.escape, tables))
        pattern = rf"\s*\[\[\s*{name}\s*\]\]" if number is not None else rf"\s*\[\s*{name}\s*\]"
        headers = [i for i, line in enumerate(lines) if re.match(pattern, line)]
        index = number or 0
        if index >= len(headers):
            return 0, 0
        first = headers[index] + 1
    last = next((i for i in range(first, len(lines)) if _HEADER.match(lines[i])), len(lines))
    return first, last


def _in_place_of_comment(text: str, where: Where, value: Any) -> str | None:
    lines = text.splitlines(keepends=True)
    key, tables = str(where[-1]), [part for part in where[:-1] if isinstance(part, str)]
    first, last = _block(lines, where)
    if (first, last) == (0, 0) or (tables and first == 0):
        lines, first, last = _uncommented_header(lines, tables)
        if not last:
            return None
    for number in range(first, last):
        if re.match(r"#\s*\[", lines[number]):  # the comment of another table begins
            return None
        found = re.match(rf"#\s*{re.escape(key)}\s*=[^#]*(#.*)?", lines[number])
        if found:
            words = (found.group(1) or "").replace(EXAMPLE, "").rstrip()
            lines[number] = f"{f'{key} = {toml_value(value)}':36}  {words}".rstrip() + "\n"
            return "".join(lines)
    return None


def _uncommented_header(lines: Sequence[str], tables: Sequence[str]) -> tuple[list[str], int, int]:
    """The lines with the header ``# [table]`` of a table that was left out put in force, and where its keys stand."""
    name = re.escape(".".join(tables))
    new = list(lines)
    for i, line in enumerate(lines):
        if re.match(rf"#\s*\[{name}\]", line):
            new[i] = line.lstrip("# ").replace("; optional", "")
            last = next(
                (j for j in range(i + 1, len(lines)) if not lines[j].strip() or re.match(r"#?\s*\[", lines[j])),
                len(lines),
            )
            return new, i + 1, last
    return new, 0, 0


def _after_last_key(text: str, where: Where, value: Any) -> str | None:
    lines = text.splitlines(keepends=True)
    tables = [part for part in where[:-1] if isinstance(part, str)]
    first, last = _block(lines, where)
    if tables and first == 0:
        new, first, last = _uncommented_header(lines, tables)
        if not last:
            return None
        lines = new
    keys = [i for i in range(first, last) if re.match(r"\s*[A-Za-z_]\w*\s*=", lines[i])]
    at = keys[-1] + 1 if keys else first
    if at and not lines[at - 1].endswith("\n"):
        lines[at - 1] += "\n"
    lines.insert(at, f"{where[-1]} = {toml_value(value)}\n")
    return "".join(lines)


def _row_place(lines: Sequence[str], array: str, count: int) -> int:
    """The line before which a further table of the array goes."""
    if count:
        first, last = _block(lines, (array, count - 1, ""))
        keys = [i for i in range(first, last) if re.match(r"(#\s*)?[A-Za-z_]\w*\s*=", lines[i].lstrip())]
        return keys[-1] + 1 if keys else last
    for name in _ARRAY_BEFORE.get(array, ()):
        for i, line in enumerate(lines):
            if re.match(rf"\s*\[\[?\s*{name}\s*\]", line):
                while i and lines[i - 1].startswith("#"):  # words right above a table are its own
                    i -= 1
                return i
    return len(lines)
