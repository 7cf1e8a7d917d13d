"""What a release says of itself: one version everywhere, a changelog that begins with it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import towline


def test_one_version(root: Path) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == towline.__version__
    assert re.search(r"^version: (\S+)$", (root / "CITATION.cff").read_text(), re.MULTILINE)[1] == towline.__version__  # pyright: ignore
    first = re.search(
        r"^## (\S+) - \d{4}-\d\d-\d\d$", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert first is not None
    assert first[1] == towline.__version__
