"""Text that is no TOML, in words: the key whose line cannot be read, what stands there, and how it is written.

``tomllib`` says where it stopped. What people type (a decimal comma, a Windows path, quotes of a word processor) is recognised by
the line that it stopped in; what is not recognised keeps tomllib's own words, with the key.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

SHOWN = 60
"""Characters of a line that are shown: a choice, so that the message stays one line."""
_AT = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_HEADER = re.compile(r"^\s*\[{1,2}\s*([^\[\]#]+?)\s*\]{1,2}\s*(?:#.*)?$")
_KEY = re.compile(r"^\s*([^=:#\[\]]+?)\s*([=:])\s*(.*?)\s*$")
_SMART = "\u201c\u201d\u201e\u201f\u00ab\u00bb\u2018\u2019\u201a\u201b\u00b4`"
_BARE = re.compile(r"^[A-Za-z0-9_-]+(?:\s*\.\s*[A-Za-z0-9_-]+)*$")
_ESCAPED = re.compile(r'"([^"]*\\[^"]*)"?')
_COMMA = re.compile(r"^([+-]?\d+),(\d+)(\s*(?:#.*)?)$")
_UNIT = re.compile(r"^([+-]?\d+(?:\.\d+)?)\s*([A-Za-z%\u00b0\u00b5][^#\s]*)\s*(?:#.*)?$")
_CONTROL = {"\a": "a", "\b": "b", "\t": "t", "\n": "n", "\f": "f", "\r": "r", "\v": "v"}
"""What an escape that happens to be one has made of a path's backslash and the letter behind it."""


@dataclass(frozen=True)
class _Stop:
    """Where reading stopped: the line's number and text, its key with its table, and what stands behind it."""

    number: int
    line: str
    key: str
    sign: str
    value: str


def not_toml(text: str, error: ValueError) -> tuple[str, str]:
    """Why ``text`` is no TOML: the key ("tow.line_length_m"; "" where none is meant) and one line of words.

    Parameters
    ----------
    text : the file's
    error : that ``tomllib.loads`` raised
    """
    said = " ".join(str(error).split())[:300]
    stop = _stopped(text, said)
    if stop is None:
        return "", f"is not valid TOML: {said}"
    found = next((words for words in _known(stop, text, said) if words), None)
    plain = _AT.sub("", said)
    shown = stop.line.strip()
    shown = shown if len(shown) <= SHOWN else shown[: SHOWN - 3] + "..."
    why = found or f"is not valid TOML: {plain[:1].lower()}{plain[1:]}"
    return stop.key, f"line {stop.number}, `{shown if shown.isprintable() else repr(shown)[1:-1]}`: {why}"


def lost_backslash(name: str) -> str | None:
    r"""Words where a path holds a tab, a line feed or their like: what "C:\tank\new" between double quotes becomes; else None.

    Parameters
    ----------
    name : the path as read
    """
    if not any(letter in name for letter in _CONTROL):
        return None
    meant = "".join(f"/{_CONTROL[c]}" if c in _CONTROL else c for c in name).replace("\\", "/")
    return f"; between double quotes a backslash starts an escape: write {meant!r} with /, or put the path between single quotes"


def comma_in_list(text: str, key: str) -> str | None:
    """Words where a list of numbers was written with decimal commas ([1,25, 0,5]); None where it does not look so.

    Parameters
    ----------
    text : the file's
    key : last part of the key's name
    """
    for line in text.splitlines():
        found = re.match(rf"^\s*{re.escape(key)}\s*=\s*\[(.*)\]", line)
        if found is None:
            continue
        groups = re.split(r",\s+|;\s*", found.group(1).strip())
        if len(groups) > 1 and any(re.fullmatch(r"[+-]?\d+,\d+", group) for group in groups):
            meant = ", ".join(group.replace(",", ".") for group in groups)
            return f"{found.group(0).strip()}: are these decimal commas? TOML wants points: {key} = [{meant}]"
    return None


def _stopped(text: str, said: str) -> _Stop | None:
    """The line that is to blame; None where tomllib names none."""
    at = _AT.search(said)
    if at is None:
        return None
    lines = text.split("\n")
    number = int(at.group(1)) if at.group(1) else len(lines)
    number = min(max(number, 1), len(lines))
    while number > 1 and not lines[number - 1].strip():
        number -= 1  # the end of the document is behind its last line
    line = lines[number - 1]
    if "nclosed" in said:
        number = _opened(lines, number)
        line = lines[number - 1]
    table = _table(lines[: number - 1])
    own = _KEY.match(line)
    if own is None and not _HEADER.match(line) and (above := _opened(lines, number)) != number:
        own = _KEY.match(lines[above - 1])
        key = own.group(1) if own else ""
        return _Stop(number, line, f"{table}.{key}" if table else key, "=", line.strip())
    if own is None or not _BARE.match(own.group(1).strip("\"'")):
        head = _HEADER.match(line)
        named = head.group(1) if head else "" if line.lstrip().startswith("[") else table
        return _Stop(number, line, named, "", line.strip())
    key = own.group(1)
    return _Stop(number, line, f"{table}.{key}" if table else key, own.group(2), own.group(3))


def _opened(lines: list[str], number: int) -> int:
    """The line whose list or inline table is still open in another one; that line itself where none is."""
    for above in range(number, 0, -1):
        if above < number and _HEADER.match(lines[above - 1]):
            return number
        if re.search(r"=\s*[\[{]", lines[above - 1]):
            return above if not _closed("".join(lines[above - 1 : max(number - 1, above)])) else number
    return number


def _table(lines: list[str]) -> str:
    """The table that the lines end in; of several, with its number: "datum[2]"."""
    table, count = "", Counter[str]()
    for line in lines:
        header = _HEADER.match(line)
        if header is not None:
            table = header.group(1)
            count[table] += 1
            if line.lstrip().startswith("[["):
                table = f"{table}[{count[table]}]"
    return table


def _closed(line: str) -> bool:
    return line.count("[") <= line.count("]") and line.count("{") <= line.count("}")


def _known(stop: _Stop, text: str, said: str) -> Iterator[str | None]:
    """Words for what people type, the surest first; None where it is not this."""
    value, last = stop.value, stop.key.rpartition(".")[2]
    smart = next((c for c in value if c in _SMART), None)
    escape = _ESCAPED.search(value) if "scape" in said or "hex value" in said else None
    if escape is not None:
        path = escape.group(1)
        yield (
            f'between double quotes a backslash starts an escape; write "{path.replace(chr(92), "/")}" with /, or put the path '
            f"between single quotes: '{path}'"
        )
    if stop.line.lstrip().startswith(("//", ";", "%")):
        yield "a comment begins with #"
    if smart is not None and not re.match(r"""^(".*"|'.*')\s*(#.*)?$""", value):
        yield f"{smart} is no quote of TOML's; write it as \" (a word processor changes them)"
    if "twice" in said or "overwrite" in said:
        yield _twice(stop, text)
    if stop.sign == ":":
        yield f"a key and its value are joined by =: {last} = ..."
    if not stop.sign:
        if stop.line.lstrip().startswith("["):
            yield "a table's name stands between brackets: [tow]; one of several between two: [[datum]]"
        yield "a line is `key = value`, [table] or # comment"
        return
    comma = _COMMA.match(value)
    if comma is not None:
        yield f"a decimal comma; TOML wants a point: {last} = {comma.group(1)}.{comma.group(2)}"
    if any(c in value for c in "\u2212\u2013"):
        yield "the minus is a dash of a word processor; write it as -"
    if value in ("True", "False", "TRUE", "FALSE", "yes", "no", "Yes", "No", "on", "off"):
        yield f"write true or false: {last} = {str(value.lower() in ('true', 'yes', 'on')).lower()}"
    if not value or value.startswith("#"):
        yield "its value is missing; write one, or put # before the line"
    unit = _UNIT.match(value)
    if unit is not None and not re.match(r"^[eE][+-]?\d*$", unit.group(2)):
        yield f"a number stands alone, its unit is in the key's name: {last} = {unit.group(1)}"
    if re.match(r"^[+-]?\.\d", value) or re.match(r"^[+-]?\d+\.(?!\d)", value):
        yield "a number needs digits before and behind its point: 0.5, 5.0"
    if re.match(r"^[+-]?0\d", value):
        yield "a number must not begin with 0 unless its point follows"
    if value.startswith(('"', "'")):
        quote = value[0]
        if value.count(quote) % 2:
            yield f"its closing {quote} is missing"
        yield f"there is text behind the closing {quote}"
    if value.startswith("[") and not _closed(value):
        yield "its closing ] is missing"
    if value.endswith(","):
        yield "no comma stands at the end of a line"
    if re.match(r"^[A-Za-z/~.]", value):
        word = value.partition("#")[0].strip()
        yield f'text stands between quotes: {last} = "{word}"'


def _twice(stop: _Stop, text: str) -> str:
    """Where the other one stands."""
    lines = text.split("\n")[: stop.number - 1]
    header = _HEADER.match(stop.line)
    if header is not None:
        table = header.group(1)
        for number, line in enumerate(lines, 1):
            found = _HEADER.match(line)
            if found is None or found.group(1) != table:
                continue
            if line.strip().startswith("[[") != stop.line.strip().startswith("[["):
                return f"{line.strip()} stands in line {number}; write it with as many brackets each time"
            several = f", or write [[{table}]] each time if there are several"
            return f"[{table}] stands in line {number} already; put its keys together there{several}"
    for number in range(len(lines), 0, -1):
        if _HEADER.match(lines[number - 1]):
            break
        own = _KEY.match(lines[number - 1])
        if own is not None and own.group(1) == stop.key.rpartition(".")[2]:
            return f"the key stands in line {number} already; leave one of them"
    return "it stands in the file already; leave one of them"


__all__ = ["comma_in_list", "lost_backslash", "not_toml"]
