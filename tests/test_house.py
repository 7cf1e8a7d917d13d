"""The house itself: packages, imports, generated pages."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from towline.record.reference import reference_page

ROOMS = ["record", "geometry", "simulate", "vision", "identify", "diagnose", "blind", "report"]
"""From the ground floor up; a room imports only rooms before it."""
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


def test_every_package_is_listed(root: Path) -> None:
    listed = set(tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {"towline"}
    for init in root.rglob("__init__.py"):
        parts = init.parent.relative_to(root).parts
        if parts and not any(p.startswith(".") or p in ("build", "tests") for p in parts):
            found.add("towline." + ".".join(parts))
    assert listed == found


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_rooms_below_it(root: Path, room: str) -> None:
    above = set(ROOMS[ROOMS.index(room) + 1 :]) | {"cli", "stages", "analysis", "app"}
    for path in (root / room).rglob("*.py"):
        out_of_the_room = len(path.relative_to(root).parts)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or node.level != out_of_the_room:
                continue
            names = [node.module.split(".")[0]] if node.module else [a.name for a in node.names]
            assert not above & set(names), f"{path.name} imports {names}"


def test_the_command_line_starts_without_anything_heavy() -> None:
    code = f"import sys, towline.cli; towline.cli._parser(); print(*[m for m in {HEAVY!r} if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == ""


def test_no_room_imports_heavy_packages_at_its_top(root: Path) -> None:
    lazy = {"torch", "kornia", "matplotlib", "av", "dask", "nicegui"}
    for room in ROOMS:
        for path in (root / room).rglob("*.py"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
                assert not lazy & {n.split(".")[0] for n in names}, path


def test_the_format_reference_is_up_to_date(root: Path) -> None:
    page = (root / "docs" / "formats" / "reference.md").read_text(encoding="utf-8")
    assert page == reference_page(), "run `make docs`"
