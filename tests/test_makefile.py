"""What ``make`` installs: the main job without torch and kornia, the tests with them; asked of make itself, nothing is run."""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def asked(root: Path, tmp_path: Path, *arguments: str) -> str:
    """The commands that make would run, in an environment that is not there yet."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(
        ["make", "-n", f"VENV={tmp_path / 'venv'}", *arguments],
        cwd=root, env=clean, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout


def installs(commands: str) -> list[str]:
    return [line for line in commands.splitlines() if "pip install" in line and "virtualenv" not in line]


def test_the_demo_needs_neither_torch_nor_kornia(root: Path, tmp_path: Path) -> None:
    (line,) = installs(asked(root, tmp_path, "demo"))
    assert line.endswith("pip install --quiet -e .")
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert not [need for need in project["dependencies"] if need.startswith(("torch", "kornia"))]


def test_the_tests_bring_them_as_a_cpu_build_where_no_gpu_is(root: Path, tmp_path: Path) -> None:
    """The version is pyproject's own pin, which then accepts the build that is there."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (pin,) = (need for need in project["optional-dependencies"]["kornia"] if need.startswith("torch"))
    commands = asked(root, tmp_path, "lint")
    cpu, whole = installs(commands)
    assert f"'{pin}' --retries 1 --index-url https://download.pytorch.org/whl/cpu" in cpu
    assert "! command -v nvidia-smi" in commands.partition(whole)[0]
    assert whole.endswith("-e '.[test,kornia]'")


def test_kornia_0_leaves_them_out_of_the_tests(root: Path, tmp_path: Path) -> None:
    commands = asked(root, tmp_path, "lint", "KORNIA=0")
    assert installs(commands)[-1].endswith("-e '.[test]'")
    assert "[ '0' != 0 ]" in commands
