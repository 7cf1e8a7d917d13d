"""What ``make`` installs: the main job without torch and kornia, the tests with them; asked of make itself, nothing is run."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def asked(root: Path, tmp_path: Path, *arguments: str) -> str:
    """The commands that make would run, in an environment that is not there yet; what another make was told is not for this one."""
    told = ("TESTS", "KORNIA", "PYTHON", "VENV")
    clean = {name: value for name, value in os.environ.items() if not name.startswith("MAKE") and name not in told}
    done = subprocess.run(
        ["make", "-n", f"VENV={tmp_path / 'venv'}", *arguments],
        cwd=root, env=clean, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout


def installs(commands: str) -> list[str]:
    return [line for line in commands.splitlines() if "pip install" in line and "virtualenv" not in line]


def hashed(path: Path) -> dict[str, str]:
    """Package -> its version; each line that asks for one is followed by hashes of its files."""
    asks = re.findall(
        r"^([a-z0-9-]+)==(\S+)[^\n]*?\\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)",
        path.read_text(),
        re.MULTILINE,
    )
    lines = [line for line in path.read_text().splitlines() if line and line[0] not in "# "]
    assert len(asks) == len(lines), f"{path.name}: a package without a hash"
    return {name: version for name, version, _ in asks}


def bare(need: str) -> str:
    """A requirement's name as it stands in the files."""
    return re.split(r"[\[<>=;~! ]", need, maxsplit=1)[0].lower().replace("_", "-")


def test_the_demo_needs_neither_torch_nor_kornia(root: Path, tmp_path: Path) -> None:
    others, own = installs(asked(root, tmp_path, "demo"))
    assert others.endswith("--no-deps --require-hashes -r release/run.txt")
    assert own.endswith("--no-deps --no-build-isolation -e .")
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    there = hashed(root / "release" / "run.txt")
    assert {bare(need) for need in project["dependencies"]} | {"setuptools"} <= there.keys()
    assert not {name for name in there if name.startswith(("torch", "kornia", "nvidia"))}


def test_the_tests_bring_them_as_a_cpu_build_where_no_gpu_is(root: Path, tmp_path: Path) -> None:
    """The version is pyproject's own pin, which the build for CUDA has, too: it follows only where there is no torch by then."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (pin,) = (need for need in project["optional-dependencies"]["kornia"] if need.startswith("torch"))
    commands = asked(root, tmp_path, "lint")
    cpu, others, cuda, own = installs(commands)
    assert f"--no-deps '{pin}' --retries 1 --index-url https://download.pytorch.org/whl/cpu" in cpu
    assert "! command -v nvidia-smi" in cpu
    assert others.endswith("--require-hashes -r release/run.txt -r release/test.txt -r release/kornia.txt")
    assert 'find_spec("torch") is None' in cuda
    assert "--require-hashes -r release/torch.txt" in cuda
    assert own.endswith("-e .")
    assert hashed(root / "release" / "torch.txt")["torch"] == pin.partition("==")[2]
    there = {name for part in ("run", "test") for name in hashed(root / "release" / f"{part}.txt")}
    assert {bare(need) for need in project["optional-dependencies"]["test"]} <= there


def test_kornia_0_leaves_them_out_of_the_tests(root: Path, tmp_path: Path) -> None:
    cpu, others, cuda, _ = installs(asked(root, tmp_path, "lint", "KORNIA=0"))
    assert others.endswith("-r release/run.txt -r release/test.txt")
    assert "[ '0' != 0 ]" in cpu
    assert "[ '0' != 0 ]" in cuda
    assert "torch" not in hashed(root / "release" / "test.txt")


def test_pinned_files_have_the_versions_with_which_the_tests_passed(root: Path) -> None:
    passed = {}
    for line in (root / "constraints.txt").read_text().splitlines():
        name, _, version = line.partition("==")
        passed[bare(name)] = version
    for name in ("run", "test", "kornia", "torch", "release"):
        pinned = hashed(root / "release" / f"{name}.txt")
        assert {k: v for k, v in pinned.items() if k in passed} == {k: passed[k] for k in pinned if k in passed}


def test_types_are_checked_beside_the_tests(root: Path, tmp_path: Path) -> None:
    commands = asked(root, tmp_path, "test")
    assert "basedpyright --project" in commands
    assert "-m pytest tests -n auto" in commands


def test_slow_tests_are_left_out_by_test_and_by_nothing_else(root: Path, tmp_path: Path) -> None:
    (quick,), (whole,), (own,) = (
        [line for line in asked(root, tmp_path, *goal).splitlines() if "-m pytest tests" in line]
        for goal in (("test", "TESTS=-k lens"), ("test-all",), ("pytest",))
    )
    assert quick.endswith('-m "not slow" -k lens')
    assert "not slow" not in whole
    assert "not slow" not in own
