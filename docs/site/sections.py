"""Docstrings of the house as numpydoc: ``name : what`` in a section becomes a name with its description below it.

The house writes what a parameter is beside its name; types stand in the signature. numpydoc takes that place for a type.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

SECTIONS = ("Parameters", "Other Parameters", "Attributes", "Raises", "Returns", "Yields")
NAMED = ("Parameters", "Other Parameters", "Attributes", "Raises")
"""Sections whose entries begin with one word."""
PROSE = re.compile(r"^[^\s-]\S* \S")
ENTRY = re.compile(r"^(\*{0,2}\w[\w, .*]*?) : (.*)$")


class Sections(griffe.Extension):
    """Rewrites each docstring before it is parsed."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """A class, a function, a module."""
        if obj.docstring is not None:
            obj.docstring.value = numpydoc(obj.docstring.value)


def numpydoc(text: str) -> str:
    """A docstring with each entry's words below its name, and prose that follows a section before the first one."""
    lines = text.split("\n")
    prose: list[str] = []
    made: list[str] = []
    section, first = "", None
    for number, line in enumerate(lines):
        rule = lines[number + 1] if number + 1 < len(lines) else ""
        if line.strip() and re.fullmatch(r"-{3,}", rule.strip()):
            section = line.strip()
            first = len(made) if first is None else first
            made.append(line)
            continue
        found = ENTRY.match(line) if section in SECTIONS else None
        if found is not None:
            made += [found[1] + (" :" if section in ("Returns", "Yields") else ""), f"    {found[2]}"]
        elif section in NAMED and PROSE.match(line):
            prose.append(line)
        else:
            made.append(line)
    return "\n".join([*made[:first], *prose, "", *made[first:]] if prose and first is not None else made)
