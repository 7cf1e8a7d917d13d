"""The files beside this one: every package that ``make`` installs, of one version, with the hashes of all its files on PyPI.

    make lock

Versions are those of constraints.txt, with which the tests passed; markers say what a system or a Python does not need. A package
of which no file has one of the hashes is not installed.

| file | what | installed by |
|---|---|---|
| run.txt | the main job, and setuptools, which builds the editable install | make demo |
| test.txt | the tests | make test |
| kornia.txt | kornia and what torch needs, of what is small | make test, unless KORNIA=0 |
| torch.txt | torch as PyPI has it, with CUDA | make test where a GPU is, or where the CPU's index cannot be reached |
| release.txt | what builds wheel and sdist and lists what comes with them, into an environment of its own | make wheel, make sbom |

torch's CPU build comes from an index of its own (Makefile) and is pinned by its version alone: that index has other files than
PyPI, and other mirrors of it others.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
PYTHON = "3.11.5"
"""The least that all of test.txt is there for; run.txt is there for 3.11."""
LARGE = re.compile(r"(torch|triton|nvidia|cuda)\b")
"""Packages that only a GPU needs, and torch."""
HEAD = "# Made by `make lock` from pyproject.toml and constraints.txt: see lock.py.\n"


def compiled(*wanted: str) -> dict[str, str]:
    """Package -> its lines with hashes, for all systems and Pythons from ``PYTHON`` on.

    Parameters
    ----------
    wanted : what of pyproject.toml, as ``uv pip compile`` takes it
    """
    command = [sys.executable, "-m", "uv", "pip", "compile", "pyproject.toml", "-c", "constraints.txt", "--universal"]
    command += [
        "--python-version",
        PYTHON,
        "--generate-hashes",
        "--no-header",
        "--no-annotate",
        "--quiet",
        "--no-config",
    ]
    said = subprocess.run([*command, *wanted], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    blocks = re.findall(r"^\w.*\n(?:^ .*\n)*", said, flags=re.MULTILINE)
    return {re.split(r"[=\s]", block, maxsplit=1)[0]: block for block in blocks}


def main() -> None:
    """Write the files anew."""
    run = compiled()
    setuptools = compiled("--group", "build")
    test = compiled("--extra", "test")
    kornia = compiled("--extra", "kornia")
    release = compiled("--group", "release")
    kept = run.keys() | {"setuptools"}
    files = {
        "run.txt": run | {"setuptools": setuptools["setuptools"]},
        "test.txt": {name: lines for name, lines in test.items() if name not in kept},
        "kornia.txt": {n: lines for n, lines in kornia.items() if n not in kept | test.keys() and not LARGE.match(n)},
        "torch.txt": {name: lines for name, lines in kornia.items() if LARGE.match(name)},
        "release.txt": release,
    }
    for name, packages in files.items():
        (HERE / name).write_text(HEAD + "".join(packages[package] for package in sorted(packages)), encoding="utf-8")
        print(f"{name}: {len(packages)} packages")


if __name__ == "__main__":
    main()
