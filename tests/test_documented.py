"""What a stranger reads first: constants are explained, public names documented, arguments of what is exported described."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest


def rooms(root: Path) -> list[Path]:
    return [p.parent for p in root.glob("*/__init__.py") if p.parent.name not in ("build", "dist", "tests")]


def files(root: Path) -> list[Path]:
    return sorted(path for room in rooms(root) for path in room.rglob("*.py"))


# constants ------------------------------------------------------------------------------------------------------------


def _names(node: ast.stmt) -> list[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    parts = [part for t in targets for part in (t.elts if isinstance(t, ast.Tuple) else [t])]
    return [part.id for part in parts if isinstance(part, ast.Name)]


def _holds_number(value: ast.AST | None) -> bool:
    """A number stands in it, outside a function of its own."""
    if value is None or isinstance(value, ast.Lambda):
        return False
    if isinstance(value, ast.Constant):
        return isinstance(value.value, (int, float, complex)) and not isinstance(value.value, bool)
    return any(_holds_number(child) for child in ast.iter_child_nodes(value) if not isinstance(child, ast.arguments))


def _says_itself(value: ast.expr) -> bool:
    """An entry that carries its own sentence: an effect with its physics, a picture with its caption."""
    texts = [c.value for c in ast.walk(value) if isinstance(c, ast.Constant) and isinstance(c.value, str)]
    return any(len(text.split()) > 5 for text in texts)


def unexplained(text: str) -> Iterator[tuple[int, str]]:
    """Line and name of every constant of a module, or of a class in it, that holds a number and says nothing about it.

    It is explained by a string below it, or by a comment on its lines, above it, or above the group whose lines follow one another.
    """
    lines = text.splitlines()
    tree = ast.parse(text)
    plain = [n for n in ast.walk(tree) if isinstance(n, ast.ClassDef) and not n.decorator_list and not n.bases]
    for body in (tree.body, *(n.body for n in plain)):
        below_comment, end = False, -1
        for k, node in enumerate(body):
            names = _names(node)
            above = lines[node.lineno - 2].strip().startswith("#") if node.lineno > 1 else False
            below_comment = above or (below_comment and end == node.lineno - 1)
            end = node.end_lineno or node.lineno
            value = getattr(node, "value", None)
            if not names:
                below_comment = False
                continue
            after = body[k + 1] if k + 1 < len(body) else None
            string = (
                isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)
            )
            beside = any("#" in line for line in lines[node.lineno - 1 : end])
            if _holds_number(value) and not (string or beside or below_comment or _says_itself(value)):
                yield node.lineno, ", ".join(names)


def test_every_numeric_constant_is_explained(root: Path) -> None:
    """Unit and source, or that it is a choice: in a string below the constant or a comment on or above it."""
    found = [
        f"{path.relative_to(root)}:{line} {name}"
        for path in files(root)
        for line, name in unexplained(path.read_text(encoding="utf-8"))
    ]
    assert not found, "numbers that nobody explains:\n" + "\n".join(found)


def test_the_test_of_constants_sees_every_kind() -> None:
    text = '''
A = 1.0
B = 2.0
"""Explained."""
# explained, as a group
C = 3.0
D = {"x": 4}

E, F = 5, -6  # explained
G = ["no number", True]
H: float = 7.0
I = lambda x: x + 1


class Plain:
    j = 8
    k = 9
    """Explained."""
'''
    assert [name for _, name in unexplained(text)] == ["A", "H", "j"]


# names ----------------------------------------------------------------------------------------------------------------


def _public(root: Path) -> Iterator[tuple[str, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Modules, their classes, functions, methods and properties without a leading underscore, with where they stand."""
    for path in files(root):
        where = str(path.relative_to(root))
        tree = ast.parse(path.read_text(encoding="utf-8"))
        yield where, tree
        for node in tree.body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and not node.name.startswith(
                "_"
            ):
                yield f"{where}:{node.lineno} {node.name}", node
                for member in node.body if isinstance(node, ast.ClassDef) else ():
                    if isinstance(member, (ast.FunctionDef, ast.AsyncFunctionDef)) and not member.name.startswith("_"):
                        yield f"{where}:{member.lineno} {node.name}.{member.name}", member


def test_every_public_name_is_documented(root: Path) -> None:
    found = [where for where, node in _public(root) if not (ast.get_docstring(node) or "").strip()]
    assert not found, "without a docstring:\n" + "\n".join(found)


def exported(root: Path) -> Iterator[tuple[str, object]]:
    """What the front door, the rooms and the rooms' own packages list in ``__all__``."""
    inits = [root / "__init__.py", *(path for path in files(root) if path.name == "__init__.py")]
    for init in inits:
        module = importlib.import_module(".".join(("towline", *init.parent.relative_to(root).parts)))
        for name in getattr(module, "__all__", ()):
            yield f"{module.__name__}.{name}", getattr(module, name)


def _named(section: str, names: list[str], doc: str) -> list[str]:
    """Names that neither the section of a docstring lists nor its text has in backticks."""
    _, _, after = doc.partition(f"{section}\n{'-' * len(section)}\n")
    heads = [line.partition(" : ")[0] for line in after.partition("\n\n")[0].splitlines() if not line.startswith(" ")]
    listed = {name.strip("* ") for head in heads for name in head.split(",")}
    return [name for name in names if name not in listed and not re.search(rf"`{re.escape(name)}\b", doc)]


def _parameters(function: Callable[..., object]) -> list[str]:
    return list(inspect.signature(function).parameters)


def test_exported_functions_name_every_parameter(root: Path) -> None:
    """In a numpydoc Parameters section, or, where one line says it all, in backticks."""
    found = [
        f"{where}: {', '.join(missing)}"
        for where, function in exported(root)
        if inspect.isfunction(function)
        and (missing := _named("Parameters", _parameters(function), inspect.getdoc(function) or ""))
    ]
    assert not found, "parameters that are not described:\n" + "\n".join(found)


def test_exported_dataclasses_name_every_attribute(root: Path) -> None:
    """Each class describes the fields that it adds itself."""
    found: list[str] = []
    for where, kind in exported(root):
        if not inspect.isclass(kind) or not dataclasses.is_dataclass(kind):
            continue
        own = [name for name in inspect.get_annotations(kind) if not name.startswith("_")]
        missing = _named("Attributes", own, inspect.getdoc(kind) or "")
        if missing:
            found.append(f"{where}: {', '.join(missing)}")
    assert not found, "attributes that are not described:\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("doc", "missing"),
    [
        ("Sum.\n\nParameters\n----------\na, b : (n,)\n    more : of it\nc : m\n\nReturns\n-------\nd : m", ["d"]),
        ("Of ``a`` and ``b (n, 2)``, by `c`.", ["d"]),
        ("a b c d", ["a", "b", "c", "d"]),
    ],
)
def test_the_test_of_parameters_reads_sections_and_backticks(doc: str, missing: list[str]) -> None:
    assert _named("Parameters", ["a", "b", "c", "d"], doc) == missing
