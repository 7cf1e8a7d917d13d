"""The house itself: packages, imports, generated pages."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from towline.record.reference import reference_page

HEAVY = (
    "torch",
    "kornia",
    "matplotlib",
    "av",
    "dask",
    "nicegui",
    "numpy",
    "pandas",
    "scipy",
    "cv2",
    "skimage",
    "pydantic",
)


@pytest.fixture(scope="module")
def house(root: Path) -> dict[str, set[str]]:
    """Room -> rooms that it may import, from the ground floor up: the architecture page's own table."""
    text = (root / "docs" / "developer" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)/` \|[^|]*\|([^|]*)\|$", text, flags=re.MULTILINE)
    return {room: set(re.findall(r"\w+", allowed)) for room, allowed in rows}


def test_every_package_is_listed(root: Path) -> None:
    listed = set(tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {"towline"}
    for init in root.rglob("__init__.py"):
        parts = init.parent.relative_to(root).parts
        if parts and not any(p.startswith(".") or p in ("build", "tests") for p in parts):
            found.add("towline." + ".".join(parts))
    assert listed == found


def _names(root: Path, path: Path) -> Iterator[tuple[str, int]]:
    """What a file imports of towline, wherever in it: at its top, in a function, for the type checker; with the line."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found = [a.name for a in node.names if a.name.partition(".")[0] == "towline"]
        elif isinstance(node, ast.ImportFrom) and node.level:
            base = path.parents[node.level - 1].relative_to(root).parts
            names = [node.module] if node.module else [a.name for a in node.names]
            found = [".".join(("towline", *base, name)) for name in names]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "towline":
            found = [f"{node.module}.{a.name}" for a in node.names] if node.module == "towline" else [str(node.module)]
        else:
            continue
        yield from ((name, node.lineno) for name in found)


def _imports(root: Path, path: Path) -> Iterator[tuple[str, int]]:
    """Rooms that a file imports from, and the line."""
    yield from ((name.split(".")[1], line) for name, line in _names(root, path) if "." in name)


@pytest.mark.slow
def test_rooms_import_what_the_table_allows_and_nothing_else(root: Path, house: dict[str, set[str]]) -> None:
    """The table of docs/developer/architecture.md, without any exception; nothing in it goes round in a circle."""
    below: set[str] = set()
    for room, allowed in house.items():
        assert allowed <= below, f"{room} stands above what it imports"
        below.add(room)
    assert {p.parent.name for p in root.glob("*/__init__.py") if p.parent.name not in ("build", "dist")} == set(house)
    used: dict[str, set[str]] = {room: set() for room in house}
    for room, allowed in house.items():
        for path in (root / room).rglob("*.py"):
            for other, line in _imports(root, path):
                if other not in (room, "__version__"):
                    assert other in allowed, f"{path.relative_to(root)}:{line} imports {other}"
                    used[room].add(other)
    assert used == house, "the table allows what nobody needs"


def _modules(root: Path) -> dict[str, Path]:
    """Every module of the package by its name."""
    names = {}
    for path in [*root.glob("*.py"), *(p for room in root.glob("*/__init__.py") for p in room.parent.rglob("*.py"))]:
        parts = path.relative_to(root).with_suffix("").parts
        if parts[0] not in ("build", "dist"):
            names[".".join(("towline", *parts)).removesuffix(".__init__")] = path
    return names


def test_no_module_is_imported_by_what_it_imports(root: Path) -> None:
    """Module by module, lazy imports and those for type checkers included; the front door, which opens every room, is nobody's."""
    modules = _modules(root)
    needs: dict[str, set[str]] = {}
    for name, path in modules.items():
        found = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = ".".join(("towline", *path.parents[node.level - 1].relative_to(root).parts))
                base = f"{base}.{node.module}" if node.module else base
                found |= {f"{base}.{a.name}" if f"{base}.{a.name}" in modules else base for a in node.names}
        needs[name] = found & modules.keys() - {name}
    assert not any("towline" in found for found in needs.values()), "the front door is imported from inside"
    try:
        list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_what_infers_knows_no_tow(root: Path) -> None:
    """The second table of the architecture page: rooms inside ``diagnose/``."""
    text = (root / "docs" / "developer" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `diagnose/(\w+)/` \|[^|]*\|([^|]*)\|$", text, flags=re.MULTILINE)
    inside = {room: set(re.findall(r"\w+", allowed)) for room, allowed in rows}
    assert inside.keys() == {p.parent.name for p in (root / "diagnose").glob("*/__init__.py")}
    for room, allowed in inside.items():
        for path in (root / "diagnose" / room).rglob("*.py"):
            for name, line in _names(root, path):
                other = name.split(".")[2] if name.startswith("towline.diagnose.") else room
                assert other in allowed | {room}, f"{path.relative_to(root)}:{line} imports {name}"


def test_no_test_imports_what_is_private(root: Path) -> None:
    """Tests say what is promised, and so use what has a public name."""
    for path in (root / "tests").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "towline":
                names = [*str(node.module).split("."), *(a.name for a in node.names)]
                private = [n for n in names if n.startswith("_") and not n.endswith("__")]
                assert not private, f"{path.name}:{node.lineno} imports {private}"


def test_the_test_of_imports_sees_every_kind(tmp_path: Path) -> None:
    text = """
import towline.report
from ..record import errors
if TYPE_CHECKING:
    from ...pipeline.stages import compute_run_motion
def f():
    from ... import cli
    from towline import app
    from towline.blind.draw import told
"""
    path = tmp_path / "identify" / "joint" / "x.py"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    found = [room for room, _ in _imports(tmp_path, path)]
    assert sorted(found) == ["app", "blind", "cli", "identify", "pipeline", "report"]


def test_the_command_line_starts_without_anything_heavy() -> None:
    code = f"import sys, towline.cli; towline.cli.command_parser(); print(*[m for m in {HEAVY!r} if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == ""


def test_no_room_imports_heavy_packages_at_its_top(root: Path, house: dict[str, set[str]]) -> None:
    lazy = {"torch", "kornia", "matplotlib", "av", "dask", "nicegui"}
    for room in house:
        for path in (root / room).rglob("*.py"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
                own = {"nicegui"} if room == "app" else set()  # the page is made of it, and loaded by its command alone
                assert not (lazy - own) & {n.split(".")[0] for n in names}, path


def test_the_format_reference_is_up_to_date(root: Path) -> None:
    page = (root / "docs" / "formats" / "reference.md").read_text(encoding="utf-8")
    assert page == reference_page(), "run `make docs`"
