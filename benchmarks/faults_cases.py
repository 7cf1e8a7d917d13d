"""Damaged files: valid ones with keys, cells, bytes and encodings changed at random, as hypothesis strategies of bytes."""

from __future__ import annotations

import copy
import io
import json
import math
import re
from collections.abc import Sequence
from datetime import date, datetime
from typing import Any

import numpy as np
from hypothesis import strategies as st

Draw = st.DrawFn
HUGE = 1 << 70
ODD: tuple[Any, ...] = (
    math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 1e9, -1e9, 0, -1, 1, (1 << 63) - 1, HUGE, "", "x", "nan", "1,5",
    "é\u2028", "a\nb", "<b>", "\0", "../x", "a" * 400, "9" * 30, True, False, [], [[]], {}, [1, 2], [math.nan] * 9,
    {"a": {"b": [1]}}, date(2020, 1, 1), datetime(2020, 1, 1, 12), None,
)  # fmt: skip
CELLS = (
    "nan", "inf", "-inf", "", " ", "abc", "1,5", "1e400", "1e9", "-1e9", "1e300", "0x10", "1_000", '"', '"a', "\0", "é", "9" * 400,
    "#", "0:00:01:04", "2020-01-01", "True", "1.5.2", "measured", "lost", "-", "--1", "1e-320",
)  # fmt: skip
TOML_ENDS = (
    "\nx = " + "9" * 5000,
    "\nx = 0x" + "f" * 5000,
    "\nx = " + "[" * 4000,
    "\nx" + ".a" * 3000 + " = 1\n",
    "\n[tow]\n",
    "\r",
)
"""Put before and behind a whole TOML: digits and depth without end, a table twice."""
JSON = (b"[" * 5000, b'{"schema": ' + b"9" * 5000 + b"}", b"null", b"1", b"[]", b'"x"', b"")
SIDES = (0, 1, 23, 25, 4000, 70_000, (1 << 31) - 1, (1 << 32) - 1)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def pick(draw: Draw, things: Sequence[Any]) -> Any:
    """One of some things (indices shrink well, also where the things cannot be compared)."""
    return things[draw(st.integers(0, len(things) - 1))]


# bytes ---------------------------------------------------------------------------------------------------------------


@st.composite
def garbled(draw: Draw, data: bytes, most: int = 4) -> bytes:
    """Bytes changed, cut, doubled, left out, zeroed."""
    out = bytearray(data)
    for _ in range(draw(st.integers(1, most))):
        if not out:
            break
        at = draw(st.integers(0, len(out) - 1))
        end = min(len(out), at + draw(st.integers(1, 40)))
        match draw(st.integers(0, 6)):
            case 0:
                del out[at:]
            case 1:
                out[at] ^= 1 << draw(st.integers(0, 7))
            case 2:
                out[at:at] = draw(st.binary(max_size=8))
            case 3:
                del out[at:end]
            case 4:
                out[at:at] = out[at:end]
            case 5:
                out[at:end] = bytes(end - at)
            case _:
                out[at:end] = b"\xff" * (end - at)
    return bytes(out)


@st.composite
def encoded(draw: Draw, text: str) -> bytes:
    """Text in the right encoding (mostly) or another."""
    name = pick(draw, ("utf-8",) * 8 + ("utf-8-sig", "utf-16", "latin-1", "utf-32-le"))
    data = text.encode(name, errors="replace")
    return draw(garbled(data)) if draw(st.integers(0, 7)) == 7 else data


@st.composite
def tokens(draw: Draw, text: str) -> bytes:
    """Numbers of a text replaced, lines left out, doubled, swapped."""
    for _ in range(draw(st.integers(1, 4))):
        spans = [m.span() for m in NUMBER.finditer(text)]
        lines = text.split("\n")
        at = draw(st.integers(0, len(lines) - 1))
        match draw(st.integers(0, 5)):
            case 0:
                del lines[at]
                text = "\n".join(lines)
            case 1:
                lines.insert(at, lines[at])
                text = "\n".join(lines)
            case 2:
                lines[at], lines[-1] = lines[-1], lines[at]
                text = "\n".join(lines)
            case _ if spans:
                first, last = pick(draw, spans)
                text = text[:first] + pick(draw, (*CELLS, "1e17", "9" * 20, "-5", "0")) + text[last:]
            case _:
                pass
    return draw(encoded(text))


# trees: TOML and JSON ------------------------------------------------------------------------------------------------


def places(tree: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of everything in a tree of dicts and lists."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path for key, value in inner for path in [(*here, key), *places(value, (*here, key))]]


@st.composite
def changed_tree(draw: Draw, tree: Any) -> Any:
    """Keys left out, renamed, doubled, given values of another kind or size."""
    tree = copy.deepcopy(tree)
    for _ in range(draw(st.integers(1, 4))):
        found = places(tree)
        if not found:
            break
        *path, last = pick(draw, found)
        inner = tree
        for key in path:
            inner = inner[key]
        kind = draw(st.integers(0, 9))
        if kind == 0:
            del inner[last]
        elif kind == 1 and isinstance(inner, dict):
            inner[pick(draw, (f"{last}s", str(last)[:-1], "x", "", "ä b", "__proto__"))] = inner.pop(last)
        elif kind == 2 and isinstance(inner, list):
            inner.append(copy.deepcopy(inner[last]))
        elif kind == 3:
            inner[last] = [inner[last]]
        elif kind == 4 and isinstance(inner[last], (int, float)):
            inner[last] = inner[last] * pick(draw, (-1, 0, 1e-9, 1e3, 1e9, 1e300))
        elif kind == 5:
            for _ in range(draw(st.sampled_from((3, 60)))):
                inner[last] = [inner[last]]
        elif kind == 6:
            inner[last] = draw(st.one_of(st.floats(), st.integers(), st.text(max_size=5)))
        else:
            inner[last] = copy.deepcopy(pick(draw, ODD))
    return tree


def toml_text(tree: dict[str, Any]) -> str:
    """A tree as TOML, a line for each key at the top; written without recursion, lists may stand deep."""
    lines = []
    for key, value in tree.items():
        parts: list[str] = []
        left: list[Any] = [value]
        while left:
            one = left.pop()
            if isinstance(one, _Mark):
                parts.append(one.text)
            elif isinstance(one, dict):
                left.append(_Mark("}"))
                for number, (name, inner) in enumerate(reversed(one.items()), 1):
                    left += [inner, _Mark(("" if number == len(one) else ", ") + f"{_quoted(str(name))} = ")]
                left.append(_Mark("{"))
            elif isinstance(one, list):
                left.append(_Mark("]"))
                for number, inner in enumerate(reversed(one)):
                    left += [_Mark(", "), inner] if number else [inner]
                left.append(_Mark("["))
            else:
                parts.append(_scalar(one))
        lines.append(f"{_quoted(str(key))} = {''.join(parts)}")
    return "\n".join(lines) + "\n"


class _Mark:
    def __init__(self, text: str) -> None:
        self.text = text


def _quoted(text: str) -> str:
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08X}" for c in text) + '"'


def _scalar(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, (date, datetime)):
        return value.isoformat()
    return '""' if value is None else repr(value)


def toml_files(tree: dict[str, Any], text: str) -> st.SearchStrategy[bytes]:
    """Damaged TOML: of the tree, of the text (tables doubled, numbers replaced), of its bytes; digits and depth without end."""
    return st.one_of(
        changed_tree(tree).map(lambda t: toml_text(t).encode("utf-8", "surrogatepass")),
        tokens(text),
        garbled(text.encode()),
        st.sampled_from(range(len(TOML_ENDS))).map(lambda k: (TOML_ENDS[k] + text + TOML_ENDS[k]).encode()),
    )


def json_files(tree: Any) -> st.SearchStrategy[bytes]:
    """Damaged JSON."""
    whole = json.dumps(tree).encode()
    return st.one_of(
        changed_tree(tree).map(_json),
        garbled(whole),
        tokens(json.dumps(tree, indent=1)),
        st.sampled_from(range(len(JSON))).map(JSON.__getitem__),
    )


def _json(tree: Any) -> bytes:
    try:
        return json.dumps(tree, default=str).encode("utf-8", "surrogatepass")
    except RecursionError:
        return b'{"a": ' * 3000


# tables --------------------------------------------------------------------------------------------------------------


@st.composite
def csv_files(draw: Draw, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> bytes:
    """Damaged tables as text."""
    grid = [list(map(str, head)), *([str(cell) for cell in row] for row in rows)]
    for _ in range(draw(st.integers(1, 4))):
        row, column = draw(st.integers(0, len(grid) - 1)), draw(st.integers(0, len(head) - 1))
        match draw(st.integers(0, 12)):
            case 0:
                grid = [line[:column] + line[column + 1 :] for line in grid]
            case 1:
                grid[0] = [
                    *grid[0][:column],
                    pick(draw, ("", "x", grid[0][0] if grid[0] else "", "T_S")),
                    *grid[0][column + 1 :],
                ]
            case 2:
                grid.insert(row, list(grid[row]))
            case 3:
                grid = [grid[0], *draw(st.permutations(grid[1:]))]
            case 4:
                grid = grid[: 1 + draw(st.integers(0, 1))]
            case 5:
                grid[row] = grid[row][:column]
            case 6:
                grid[row] = [*grid[row], pick(draw, CELLS)]
            case 7:
                grid = [grid[0], *([*line, ""] for line in grid[1:])]
            case 8:
                grid = [grid[0], *([_scaled(c) if k == column else c for k, c in enumerate(line)] for line in grid[1:])]
            case _ if column < len(grid[row]):
                grid[row][column] = pick(draw, CELLS)
            case _:
                pass
    mark = pick(draw, (",",) * 8 + (";", "\t", " "))
    end = pick(draw, ("\n",) * 6 + ("\r\n", "\r", "\n\n"))
    if mark == ";":
        grid = [[cell.replace(".", ",") for cell in line] for line in grid]
    text = (
        pick(draw, ("",) * 8 + ("# made by hand\n", "\n\n", "# a\n\n#"))
        + end.join(mark.join(line) for line in grid)
        + end
    )
    return draw(encoded(text))


def _scaled(cell: str) -> str:
    try:
        return repr(1e9 * float(cell))
    except ValueError:
        return cell


@st.composite
def parquet_files(draw: Draw, columns: dict[str, Any]) -> bytes:
    """Damaged Parquet: columns left out or of another kind, an index of its own, no rows, bytes garbled."""
    import pandas as pd

    table = pd.DataFrame(columns)
    for _ in range(draw(st.integers(0, 3))):
        name = pick(draw, [str(c) for c in table.columns] or ["t_s"])
        count = len(table)
        odd = pick(draw, (
            ["x"] * count, [[1.0]] * count, [{"a": 1}] * count, [True] * count, [None] * count, [b"\xff"] * count,
            pd.date_range("2020-01-01", periods=count), np.full(count, np.nan), np.full(count, np.inf), np.arange(count)[::-1],
            np.full(count, 2**63 - 1), pd.Categorical(["a"] * count), 1e9 * np.arange(count), pd.timedelta_range(0, periods=count),
        ))  # fmt: skip
        match draw(st.integers(0, 5)):
            case 0:
                table = table.drop(columns=name, errors="ignore")
            case 1:
                table = table.iloc[: draw(st.integers(0, 1))]
            case 2 if name in table:
                table = table.set_index(name)
            case 3:
                table = table.iloc[::-1]
            case _:
                table = table.assign(**{name: odd})
    stream = io.BytesIO()
    table.to_parquet(stream)
    return draw(garbled(stream.getvalue())) if draw(st.integers(0, 2)) else stream.getvalue()


# pictures and clips --------------------------------------------------------------------------------------------------


@st.composite
def pictures(draw: Draw) -> bytes:
    """PNG and JPEG of 1 to 24 px, 8 and 16 bit, grey, colour, with alpha; whole, cut, garbled, with a header that lies."""
    import cv2

    size = (draw(st.sampled_from((1, 2, 24))), draw(st.sampled_from((1, 3, 24))))
    channels = draw(st.sampled_from((1, 3, 4)))
    deep = draw(st.booleans())
    values = np.arange(size[0] * size[1] * channels).reshape(*size, channels) * (97 if deep else 1)
    kind = ".png" if deep or channels == 4 else draw(st.sampled_from((".png", ".jpg")))
    data = cv2.imencode(kind, (values % (65536 if deep else 256)).astype(np.uint16 if deep else np.uint8))[1].tobytes()
    match draw(st.integers(0, 3)):
        case 0:
            return data
        case 1 if kind == ".png":  # IHDR's width and height; its checksum is made right again
            import zlib

            head = b"IHDR" + b"".join(pick(draw, SIDES).to_bytes(4, "big") for _ in range(2)) + data[24:29]
            return data[:12] + head + zlib.crc32(head).to_bytes(4, "big") + data[33:]
        case _:
            return draw(garbled(data))
