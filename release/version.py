"""A new version in every file that says it: pyproject.toml, __version__.py, CITATION.cff and the changelog, with today's date.

    make version VERSION=0.3.0

docs/developer/release.md has the steps around it; tests/test_release.py holds the files together.
"""

from __future__ import annotations

import re
import sys
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def places(version: str, day: str) -> list[tuple[str, str, str]]:
    """File, what stands in one line of it (a pattern), and what shall stand there.

    Parameters
    ----------
    version : 1.2.3
    day : 2026-12-31
    """
    return [
        ("pyproject.toml", r'^version = "[^"]*"$', f'version = "{version}"'),
        ("__version__.py", r'^__version__ = "[^"]*"$', f'__version__ = "{version}"'),
        ("CITATION.cff", r"^version: .*$", f"version: {version}"),
        ("CITATION.cff", r"^date-released: .*$", f"date-released: {day}"),
        ("CHANGELOG.md", r"^## Unreleased$", f"## {version} - {day}"),
    ]


def released(root: Path, version: str, day: str) -> None:
    """Write the version; nothing is written where a file does not say it just once.

    Parameters
    ----------
    root : of the checkout
    version : 1.2.3
    day : 2026-12-31
    """
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        raise SystemExit(f"VERSION={version!r}: expected three numbers, as in make version VERSION=0.3.0")
    texts: dict[Path, str] = {}
    for name, pattern, line in places(version, day):
        path = root / name
        text, count = re.subn(pattern, line, texts.get(path) or path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        if count != 1:
            raise SystemExit(f"{path}: {count} lines are {pattern}; expected one")
        texts[path] = text
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    released(ROOT, "".join(sys.argv[1:2]), datetime.now(UTC).date().isoformat())
