"""What a release says of itself: one version everywhere, a changelog that begins with it."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import towline


def test_one_version(root: Path) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == towline.__version__
    assert re.search(r"^version: (\S+)$", (root / "CITATION.cff").read_text(), re.MULTILINE)[1] == towline.__version__  # pyright: ignore
    assert_told(root, towline.__version__)


def assert_told(root: Path, version: str) -> None:
    """The changelog begins with the version, at CITATION.cff's day."""
    changes = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.search(r"^## (\S+) - (\d{4}-\d\d-\d\d)$", changes, re.MULTILINE)
    assert first is not None
    assert first[1] == version
    assert f"\ndate-released: {first[2]}\n" in (root / "CITATION.cff").read_text(encoding="utf-8")


def test_make_version_writes_it_everywhere_or_nowhere(root: Path, tmp_path: Path) -> None:
    files = ("pyproject.toml", "__version__.py", "CITATION.cff", "CHANGELOG.md", "release/version.py")
    (tmp_path / "release").mkdir()
    for name in files:
        shutil.copy(root / name, tmp_path / name)
    changes = tmp_path / "CHANGELOG.md"
    if "## Unreleased" not in changes.read_text():  # of a release itself
        changes.write_text(changes.read_text().replace("\n## ", "\n## Unreleased\n\n## ", 1))

    def called(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(tmp_path / "release" / "version.py"), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    before = {name: (tmp_path / name).read_bytes() for name in files}
    for wrong in ([], ["next"], ["1.2"]):
        assert "expected three numbers" in called(*wrong).stderr
    assert {name: (tmp_path / name).read_bytes() for name in files} == before
    assert called("9.8.7").returncode == 0
    assert tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]["version"] == "9.8.7"
    assert '__version__ = "9.8.7"' in (tmp_path / "__version__.py").read_text()
    assert "\nversion: 9.8.7\n" in (tmp_path / "CITATION.cff").read_text()
    assert_told(tmp_path, "9.8.7")
    # nothing is left that a release could head
    assert "CHANGELOG.md" in called("9.8.8").stderr
    assert '"9.8.7"' in (tmp_path / "__version__.py").read_text()


def test_tests_and_examples_ask_for_nothing_that_the_wheel_lacks(root: Path) -> None:
    """They run against an installed wheel, too, and a stranger's copy of an example stands beside one."""
    declared = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    files = sorted([*(root / "tests").glob("*.py"), *(root / "examples").glob("*.py")])
    asked = {}
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "towline":
                for name in [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]:
                    asked[name] = path.name
            elif isinstance(node, ast.Import):
                asked |= {alias.name: path.name for alias in node.names if alias.name.startswith("towline.")}
    folders = {name: path for name, path in asked.items() if (root / Path(*name.split(".")[1:])).is_dir()}
    assert len(folders) > 10
    assert {name: path for name, path in folders.items() if name not in declared} == {}
