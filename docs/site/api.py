"""The page of the Python interface, from the public docstrings: every name in a room's ``__all__``, with its signature."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from types import ModuleType

ROOMS = (
    "towline.pipeline.front",
    "towline.record",
    "towline.record.imported",
    "towline.record.exports",
    "towline.geometry",
    "towline.geometry.checks",
    "towline.vision",
    "towline.simulate",
    "towline.identify",
    "towline.identify.methods",
    "towline.diagnose",
    "towline.diagnose.effects",
    "towline.diagnose.users",
    "towline.report",
)
HEAD = """# The Python interface

Made from the docstrings when the site is built. Arrays are numpy's, tables pandas', times s, places m, angles rad
unless a name says otherwise. What raises says so; errors are `towline.record`'s, all of them `TowlineError`.
"""
SECTION = re.compile(r"^-{3,}\s*$")
ENTRY = re.compile(r"^(\*{0,2}\w[\w, .*]*?) : (.*)$")
LONG = 96


def api_page() -> str:
    """The whole page, as Markdown."""
    parts = [HEAD]
    for room in ROOMS:
        module = importlib.import_module(room)
        first = (inspect.getdoc(module) or "").split("\n\n")[0].replace("\n", " ")
        parts.append(f"## {room}\n\n{escaped(first)}\n")
        parts += [entry(room, name, getattr(module, name)) for name in public(module)]
    return "\n".join(parts)


def public(module: ModuleType) -> list[str]:
    """Names of ``__all__``; without one, classes and functions that the module itself defines."""
    named = getattr(module, "__all__", None)
    if named is not None:
        return sorted(named, key=str.lower)
    own = [n for n, v in vars(module).items() if getattr(v, "__module__", None) == module.__name__]
    return sorted((n for n in own if not n.startswith("_")), key=str.lower)


def entry(room: str, name: str, thing: object) -> str:
    """One name: heading, signature, docstring; a class's public methods below it."""
    heading = f"### {name} {{ #{room}.{name} }}\n"
    if not callable(thing):
        shown = repr(thing)
        return f"{heading}\nA constant: `{shown if len(shown) < LONG else type(thing).__name__}`.\n"
    parts = [heading, f"```python\n{signature(name, thing)}\n```\n", described(own_docstring(thing))]
    if inspect.isclass(thing):
        for method, function in vars(thing).items():
            plain = function.fget if isinstance(function, property) else function
            if method.startswith("_") or not inspect.isfunction(plain) or not inspect.getdoc(plain):
                continue
            shown = method if isinstance(function, property) else signature(method, plain)
            words = (inspect.getdoc(plain) or "").split("\n\n")[0].replace("\n", " ")
            parts.append(f"- `{' '.join(shown.split())}`: {escaped(words)}")
    return "\n".join(parts) + "\n"


def own_docstring(thing: object) -> str:
    """The docstring that was written: not the one that dataclass makes, nor an ancestor's."""
    text = inspect.cleandoc(getattr(thing, "__doc__", None) or "")
    return "" if dataclasses.is_dataclass(thing) and text.startswith(f"{getattr(thing, '__name__', '')}(") else text


def signature(name: str, thing: object) -> str:
    """``name(arguments) -> what``, one argument a line where it is long; fields of run.toml's tables stand elsewhere."""
    if hasattr(thing, "model_fields"):
        return f"class {name}  # fields: formats, every key"
    if inspect.isclass(thing) and issubclass(thing, Exception):
        return f"class {name}({thing.__bases__[0].__name__})"
    assert callable(thing)
    try:
        plain = inspect.signature(thing)
    except ValueError:
        return f"{name}(...)"
    word = "class " if inspect.isclass(thing) else ""
    texts = [re.sub(r"'([^']*)'", r"\1", str(p)) if p.default is p.empty else str(p) for p in plain.parameters.values()]
    texts = [re.sub(r": '([^']*)'", r": \1", re.sub(r" at 0x[0-9a-f]+", "", text)) for text in texts]
    back = (
        "" if word or plain.return_annotation is plain.empty else f" -> {str(plain.return_annotation).strip(chr(39))}"
    )
    whole = f"{word}{name}({', '.join(texts)}){back}"
    if len(whole) <= LONG:
        return whole
    inner = "".join(f"    {text},\n" for text in texts)
    return f"{word}{name}(\n{inner}){back}"


def described(text: str) -> str:
    """A docstring of the house as Markdown: prose, then each section as a list of ``name : what``."""
    lines = text.split("\n")
    parts: list[str] = []
    k, section = 0, False
    while k < len(lines):
        line = lines[k]
        if k + 1 < len(lines) and SECTION.match(lines[k + 1]) and line.strip():
            parts += ["", f"**{line.strip()}**", ""]
            section, k = True, k + 2
            continue
        found = ENTRY.match(line) if section else None
        if found:
            parts.append(f"- `{found[1]}`: {escaped(found[2])}")
        elif section and line.strip() and not line.startswith(" "):
            parts.append(f"- {escaped(line)}" if parts[-1] == "" else escaped(line))
        else:
            parts.append(escaped(line.strip() if section else line))
        k += 1
    return "\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Prose whose signs are no Markdown; double backticks become code."""
    pieces = re.split(r"(``[^`]+``)", text)
    for k, piece in enumerate(pieces):
        plain = piece.replace("&", "&amp;").replace("<", "&lt;").replace("*", r"\*").replace("|", r"\|")
        pieces[k] = f"`{piece[2:-2]}`" if k % 2 else plain
    return "".join(pieces)
